"""The data of a curve: Bezier pieces, immutable, and what follows from them without any parameter."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves import bezier

__all__ = ["Pieces"]

_LARGEST = 1e300  # beyond this, differences of control points could overflow


class Pieces:
    """Bezier pieces of degree 1 to 3 in the plane. Immutable.

    Parameters
    ----------
    control : (k, 4, 2) array_like
        Control points, at most 1e300 in size; a piece of degree d uses the rows 0..d, the others are ignored.
    degree : (k,) array_like of int
        1, 2 or 3.

    Raises
    ------
    ValueError, TypeError
        If a shape is wrong or a number is not finite.

    Examples
    --------
    >>> segment = [[0, 0], [3, 4], [3, 4], [3, 4]]
    >>> Pieces([segment], [1]).length
    5.0
    """

    control: NDArray[np.float64]
    degree: NDArray[np.int64]
    n_pieces: int

    def __init__(self, control: ArrayLike, degree: ArrayLike) -> None:
        points = check.array("control", control, ("k", 4, 2)) + 0.0  # a copy; -0.0 becomes 0.0
        degrees = np.asarray(degree)
        if degrees.size == 0:
            degrees = degrees.astype(np.int64)
        if degrees.shape != points.shape[:1] or not np.issubdtype(degrees.dtype, np.integer):
            raise ValueError(
                f"degree: expected {len(points)} integers, one a piece, "
                f"got shape {degrees.shape} and dtype {degrees.dtype}"
            )
        if not np.isin(degrees, (1, 2, 3)).all():
            raise ValueError(f"degree: expected 1, 2 or 3, got {sorted(set(degrees.tolist()) - {1, 2, 3})[0]}")
        if np.abs(points).max(initial=0.0) > _LARGEST:
            raise ValueError(f"control: expected coordinates up to {_LARGEST:g} in size, got {np.abs(points).max():g}")
        rows = np.minimum(np.arange(4), degrees[:, None])
        points = np.take_along_axis(points, rows[:, :, None], axis=1)
        self._freeze(control=points, degree=degrees.astype(np.int64), n_pieces=len(points))

    def _freeze(self, **fields: Any) -> None:
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            self.__dict__[name] = value

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise AttributeError(f"{name}: a curve is immutable; make a new one")

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.control, self.degree))

    @cached_property
    def coefficients(self) -> NDArray[np.float64]:
        """Power basis (k, 4, 2): x(t) = c0 + c1 t + c2 t^2 + c3 t^3 on each piece, t in [0, 1]."""
        result = bezier.coefficients(self.control, self.degree)
        result.setflags(write=False)
        return result

    @cached_property
    def chain(self) -> NDArray[np.int64]:
        """Chain of each piece (k,): it goes on while the end of one piece is the start of the next."""
        broken = (self.control[:-1, 3] != self.control[1:, 0]).any(axis=1)
        result = np.concatenate([np.zeros(min(self.n_pieces, 1), dtype=np.int64), np.cumsum(broken)])
        result.setflags(write=False)
        return result

    @cached_property
    def is_closed(self) -> bool:
        """Whether every chain ends where it starts."""
        first = np.flatnonzero(np.diff(self.chain, prepend=-1))
        last = np.append(first[1:], self.n_pieces)[: len(first)] - 1
        return bool((self.control[first, 0] == self.control[last, 3]).all())

    @cached_property
    def piece_bounds(self) -> NDArray[np.float64]:
        """Tight box of each piece (k, 4): xmin, ymin, xmax, ymax."""
        result = bezier.boxes(self.control, self.degree)
        result.setflags(write=False)
        return result

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Tight box (xmin, ymin, xmax, ymax) of the curve itself, not of its control points."""
        if self.n_pieces == 0:
            raise ValueError("bounds: expected a curve with at least one piece, got an empty one")
        box = self.piece_bounds
        low, high = box[:, :2].min(axis=0), box[:, 2:].max(axis=0)
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    @cached_property
    def length(self) -> float:
        """Arc length: exact for lines up to rounding, to about 1e-12 relative for the other pieces."""
        return float(bezier.lengths(self.control, self.degree).sum())

    def __len__(self) -> int:
        return self.n_pieces

    def __repr__(self) -> str:
        chains = int(self.chain[-1]) + 1 if self.n_pieces else 0
        state = "closed" if self.is_closed else "open"
        return (
            f"{type(self).__name__}({self.n_pieces} piece{'s' * (self.n_pieces != 1)} "
            f"in {chains} chain{'s' * (chains != 1)}, {state})"
        )
