"""Dask arrays of queries: functions that treat every query by itself take them chunk by chunk, and give them back.

That works because a random number is keyed by its query's row in the whole array, so a chunk that knows its rows gives
what the whole would have given there, bit for bit, in any process and in any order. A chunk that is lost with its
worker is computed again, and comes out the same. What is decided over all rows together is refused.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from functools import partial, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["by_chunks", "keyed", "lazy"]

Given = ParamSpec("Given")
Answer = TypeVar("Answer")
Prepare = Callable[[dict[str, Any], int], Callable[..., Any]]


def lazy(value: Any) -> bool:
    """Whether `value` is a dask array; Dask is not imported to find out.

    Examples
    --------
    >>> lazy(np.zeros(3))
    False
    """
    module = sys.modules.get("dask.array")
    return module is not None and isinstance(value, module.Array)


def by_chunks(
    *queries: str, columns: int = 0, prepare: Prepare | None = None
) -> Callable[[Callable[Given, Answer]], Callable[Given, Answer]]:
    """Let a function take dask arrays of queries and give a dask array back; arrays in memory go straight through.

    Parameters
    ----------
    *queries : str
        Arguments with one row a query, aligned by chunks of rows.
    columns : int
        Of the answer: (m, columns), or (m,) for 0.
    prepare : callable, optional
        ``prepare(arguments, m)`` does what is done once for all m queries and returns what answers a chunk. By default
        that is the function itself.

    Examples
    --------
    >>> import dask.array as da
    >>> @by_chunks("points")
    ... def norm(points):
    ...     return np.hypot(*points.T)
    >>> answer = norm(da.ones((6, 2), chunks=4))
    >>> answer.chunks, answer.compute().round(3)
    (((4, 2),), array([1.414, 1.414, 1.414, 1.414, 1.414, 1.414]))
    """

    def decorate(function: Callable[Given, Answer]) -> Callable[Given, Answer]:
        signature = inspect.signature(function)

        @wraps(function)
        def door(*args: Given.args, **kwargs: Given.kwargs) -> Answer:
            if not any(map(lazy, (*args, *kwargs.values()))):
                return function(*args, **kwargs)
            given = signature.bind(*args, **kwargs)
            given.apply_defaults()
            # By the door's name, not the function's, the workers find it again.
            answers: Any = _over(door, dict(given.arguments), queries, columns, prepare)
            return answers

        return door

    return decorate


def _over(
    function: Callable[..., Any], given: dict[str, Any], queries: tuple[str, ...], columns: int, prepare: Prepare | None
) -> Any:
    """The dask array of answers; arguments are looked at now, queries when it is computed."""
    import dask.array as da
    from dask import delayed

    for name, value in given.items():
        if name not in (*queries, "rows") and lazy(value):
            raise TypeError(f"{name}: expected it in memory, got a dask array; {' and '.join(queries)} may be one")
    if given.pop("full_output", False):
        raise ValueError(
            "full_output: expected False with dask arrays, because an Estimate holds all rows in memory, got True; "
            "ask for parts with rows=..."
        )
    for name in ("budget",) if prepare else ("budget", "tol"):
        if given.get(name) is not None:
            raise ValueError(
                f"{name}: expected None with dask arrays, because what it takes is decided over all rows, "
                f"got {given[name]!r}; say n"
            )
    name = next(name for name in (*queries, "rows") if lazy(given[name]))
    rows = _chunks(name, given[name])
    arrays = {name: _aligned(name, given.pop(name), rows) for name in queries if np.ndim(given[name])}
    if "rows" in given:
        asked = given.pop("rows")
        arrays["rows"] = da.arange(sum(rows), chunks=(rows,)) if asked is None else _aligned("rows", asked, rows)
    answer = prepare(given, sum(rows)) if prepare else partial(function, **given)
    answer(**{name: np.empty((0, *array.shape[1:]), array.dtype) for name, array in arrays.items()})  # refuses now
    pairs = [part for k, a in enumerate(arrays.values(), 1) for part in (a, (0, k)[: a.ndim])]
    return da.blockwise(
        _chunk,
        (0, -1) if columns else (0,),
        *pairs,
        names=tuple(arrays),
        answer=delayed(answer, pure=False, traverse=False),  # so that it is sent to a worker once
        new_axes={-1: columns} if columns else None,
        concatenate=True,
        dtype=np.float64,
        meta=np.empty((0,) * (2 if columns else 1)),
    )


def _chunk(*arrays: NDArray[Any], names: tuple[str, ...], answer: Callable[..., Any]) -> Any:
    return answer(**dict(zip(names, arrays, strict=True)))


def _chunks(name: str, array: Any) -> tuple[int, ...]:
    """Rows of each chunk."""
    rows = array.chunks[0] if array.ndim else ()
    if not array.ndim or np.isnan(rows).any():
        raise ValueError(f"{name}: expected rows in chunks of known size (`compute_chunk_sizes()`), got {array.chunks}")
    return tuple(map(int, rows))


def _aligned(name: str, value: Any, rows: tuple[int, ...]) -> Any:
    """`value` as a dask array whose chunks hold these rows, all columns together."""
    import dask.array as da

    array: Any = value if lazy(value) else np.asarray(value)
    if len(array) != sum(rows):
        raise ValueError(f"{name}: expected {sum(rows)} rows, got {len(array)}")
    chunks = (rows, *(-1,) * (array.ndim - 1))
    return array.rechunk(chunks) if lazy(array) else da.from_array(array, chunks=chunks)


def keyed(problem: Any, rows: NDArray[np.int64]) -> Any:
    """A problem whose queries, one behind the other for each of its shapes, are these rows of a bigger array.

    Parameters
    ----------
    problem : Problem
        A dataclass with `rows`, as its `of` makes it.
    rows : (m,) int64 ndarray
        See `nqr_geom.check.rows`.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> problem = ng.problems.gwn(ng.Curve.polyline([[0, 0], [1, 0]]), [[0.5, 0.5], [2.0, 0.5]])
    >>> keyed(problem, np.array([7, 9])).rows.tolist()
    [7, 9]
    """
    from dataclasses import replace

    import torch

    moved = torch.from_numpy(rows - np.arange(len(rows)))
    shapes = problem.batch // max(1, len(rows))
    return replace(problem, rows=problem.rows + moved.repeat(shapes))
