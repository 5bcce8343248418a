"""Points and tangents of a curve that is only a callable, asked for inside one piece at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

__all__ = ["PointQueries", "affine_map"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_OFFSETS = np.arange(-2.0, 3.0)
# Row p holds the weights that turn five values at -2..2 into the interpolant's coefficient of r^p.
_TO_POWERS = np.linalg.inv(np.vander(_OFFSETS, increasing=True))
_STEP = 2.0**-10  # of a piece: balances h^4 truncation against rounding / h


class PointQueries:
    """A user's callable with its pieces: validated answers, never asked across a joint.

    Parameters
    ----------
    x : callable
        s (m,) in [0, 1) to points (m, 2).
    pieces : int
        How many pieces the callable has over [0, 1).
    derivative : callable, optional
        s (m,) to dx/ds (m, 2).

    Raises
    ------
    TypeError, ValueError
        If an argument is not callable, or `pieces` is not a positive integer.

    Examples
    --------
    >>> line = PointQueries(lambda s: np.stack([s, 2 * s], axis=1), 1)
    >>> line.tangents(np.array([0.3]), np.array([0]), np.array([0.3])).round(9)
    array([[1., 2.]])
    """

    def __init__(
        self,
        x: Callable[[Floats], ArrayLike],
        pieces: int,
        derivative: Callable[[Floats], ArrayLike] | None = None,
    ) -> None:
        for name, function in (("x", x), ("derivative", derivative)):
            if not callable(function) and not (name == "derivative" and function is None):
                raise TypeError(f"{name}: expected a callable, got {function!r}")
        self.x = x
        self.given_derivative = derivative
        self.total = check.integer("pieces", pieces, low=1)
        self.first, self.count = 0, self.total
        self.low, self.high = _inside(self.total)

    @property
    def per_derivative(self) -> int:
        """Point queries that one tangent costs."""
        return 0 if self.given_derivative is not None else len(_OFFSETS)

    def window(self, start: int, stop: int) -> PointQueries:
        """The pieces start..stop-1 as a curve of their own, over its own [0, 1)."""
        part = PointQueries(self.x, self.total, self.given_derivative)
        part.first, part.count = self.first + start, stop - start
        return part

    def mapped(self, points: Callable[[Floats], Floats], tangents: Callable[[Floats], Floats]) -> PointQueries:
        """The image under a map of points, with its linear part for tangents."""
        x, derivative = self.x, self.given_derivative

        def image(s: Floats) -> Floats:
            return points(_answer("x", x, s))

        def image_derivative(s: Floats) -> Floats:
            return tangents(_answer("derivative", derivative, s))

        result = PointQueries(image, self.total, None if derivative is None else image_derivative)
        result.first, result.count = self.first, self.count
        return result

    def points(self, s: Floats, piece: Ints, t: Floats) -> Floats:
        """Points (..., 2) at s in `piece` with local parameter t, all of one shape."""
        query = self._global(s, piece, t)
        return _answer("x", self.x, query.ravel()).reshape((*query.shape, 2))

    def tangents(self, s: Floats, piece: Ints, t: Floats) -> Floats:
        """dx/ds (..., 2), by the given derivative or by differences of five points of the same piece."""
        query = self._global(s, piece, t)
        scale = self.count / self.total  # a window's own s runs slower than the whole curve's
        if self.given_derivative is not None:
            result = _answer("derivative", self.given_derivative, query.ravel())
            return scale * result.reshape((*query.shape, 2))
        step = _STEP / self.total
        low, high = self.low[piece + self.first], self.high[piece + self.first]
        # The stencil is moved inside the piece, not shortened: five nodes serve at its ends as well.
        centre = np.clip(query, low + 2.0 * step, high - 2.0 * step)
        nodes = np.clip(centre[..., None] + step * _OFFSETS, low[..., None], high[..., None])
        values = _answer("x", self.x, nodes.ravel()).reshape((*nodes.shape, 2))
        # Without the middle value, which drops out, rounding is relative to the stencil and not to the place.
        powers = _TO_POWERS @ (values - values[..., 2:3, :])
        r = ((query - centre) / step)[..., None]
        slope = powers[..., 1, :] + r * (
            2 * powers[..., 2, :] + r * (3 * powers[..., 3, :] + r * 4 * powers[..., 4, :])
        )
        return slope * (scale / step)

    def _global(self, s: Floats, piece: Ints, t: Floats) -> Floats:
        """The callable's own parameter: s itself, or its place in the whole curve, kept inside the piece."""
        query = s if self.count == self.total else (self.first + piece + t) / self.total
        return np.clip(query, self.low[piece + self.first], self.high[piece + self.first])


def _inside(pieces: int) -> tuple[Floats, Floats]:
    """Where each piece is asked at the least and at the most.

    The least is the smallest float64 with floor(s * pieces) equal to its index. The end stays four roundings inside,
    because a callable may itself take a parameter within rounding of a joint for the joint.
    """
    index = np.arange(pieces)
    low = index / pieces
    low = np.where(low * pieces < index, np.nextafter(low, 1.0), low)
    return low, (index + 1) / pieces * (1.0 - 2.0**-50)


def _answer(name: str, function: Any, s: Floats) -> Floats:
    """Ask the user's callable and check what comes back."""
    result = check.array(f"{name}(s)", function(s), ("m", 2))
    if len(result) != len(s):
        raise ValueError(f"{name}(s): expected shape ({len(s)}, 2), got {result.shape}")
    return result


def affine_map(matrix: ArrayLike, shift: ArrayLike) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """The map x -> matrix x + shift of points (..., 2)."""
    m = check.array("matrix", matrix, (2, 2))
    v = check.array("shift", shift, (2,))

    def apply(points: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = points[..., 0], points[..., 1]
        # Not a matrix product: equal points must have bitwise equal images, wherever they stand in the array.
        return np.stack([m[0, 0] * x + m[0, 1] * y + v[0], m[1, 0] * x + m[1, 1] * y + v[1]], axis=-1)

    return apply
