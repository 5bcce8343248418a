"""Independent walks on spheres from given points, and answers of solvers without walks, as estimates."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate, Statistics
    from nqr_geom.wos.domain import Boundary

__all__ = ["by_walks", "deterministic", "walked"]

Floats = NDArray[np.float64]

_TILE = 2**18  # walks held at a time


def walked(
    value: Floats,
    statistics: Statistics,
    stderr: Floats | None,
    n: int,
    counts: dict[str, int],
    seconds: float,
    **plan: Any,
) -> Estimate:
    """An estimate that no sampler and rule made."""
    from nqr_geom.integrator.estimate import Estimate

    return Estimate(
        value=value,
        stderr=stderr,
        n=n,
        inner=value,
        counts=counts,
        seconds=seconds,
        stages={"all": seconds},
        peak_memory=None,
        effects=frozenset(),
        fallback=np.zeros(len(value), dtype=bool),
        plan={"problem": "laplace", "n": n, "replicates": 1, **plan},
        statistics=statistics,
    )


def deterministic(value: Floats, seconds: float, **plan: Any) -> Estimate:
    """A deterministic answer (m,) as an estimate without spread."""
    from nqr_geom.integrator.estimate import Statistics

    column = value[:, None]
    statistics = Statistics(column, np.zeros_like(column), 1, "replicates")
    counts = {"samples": 0, "queries": 0}
    return walked(column, statistics, None, 0, counts, seconds, sampler="none", seeds=(), **plan)


def by_walks(
    values: Boundary, framed: Floats, rows: NDArray[np.int64], n: int, seed: int, settings: dict[str, Any], first: int
) -> Estimate:
    """n independent walks from each query; repetition `first` has walks of its own."""
    start = time.perf_counter()
    counts: dict[str, int] = {}
    total = _batch(values, framed, rows, np.arange(n), Stream(seed, "test", f"samples/{first}"), settings, counts)
    counts = {"samples": n * len(framed), "queries": counts.get("steps", 0), **counts}
    seconds = time.perf_counter() - start
    what = {"sampler": "random", "rule": "mc", "seeds": (seed,)}
    return walked(total.mean, total, total.stderr, n, counts, seconds, **what)


def _batch(
    values: Boundary,
    framed: Floats,
    rows: NDArray[np.int64],
    walks: NDArray[np.int64],
    stream: Stream,
    settings: dict[str, Any],
    counts: dict[str, int],
) -> Statistics:
    """Statistics of some walks from every query, held a tile of queries and walks at a time."""
    from nqr_geom.integrator.estimate import Statistics
    from nqr_geom.wos.walk import walk

    moments = np.zeros((4, len(framed), 1))
    of = np.zeros(len(framed), dtype=np.int64)
    height = max(1, _TILE // len(walks))
    for low in range(0, len(framed), height):
        part = slice(low, low + height)
        whole: Statistics | None = None
        for first in range(0, len(walks), _TILE):
            some = walks[first : first + _TILE]
            ended = walk(values.domain.nearest, of[part], framed[part], rows[part], some, stream, **settings)
            terms = values.at(ended.edge, ended.t)
            if ended.weight is not None:
                terms = terms * ended.weight
            if ended.gained is not None:
                terms = terms + ended.gained
            for key, count in ended.counts().items():
                counts[key] = counts.get(key, 0) + count
            piece = Statistics.of(terms[..., None])
            whole = piece if whole is None else whole.merge(piece)
        if whole is not None:
            moments[:, part] = whole.mean, whole.m2, whole.m3, whole.m4
    mean, m2, m3, m4 = moments
    return Statistics(mean, m2, len(walks), "samples", m3, m4)
