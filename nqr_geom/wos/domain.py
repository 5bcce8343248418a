"""Where a Laplace problem lives: a polygon, perhaps with holes, in a normalised frame, and the values on its edge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves.curve import Curve
from nqr_geom.rows import over_rows

if TYPE_CHECKING:
    from nqr_geom.wos.nearest import Nearest

__all__ = ["FLATNESS", "Boundary", "BoundaryPoint", "Domain"]

Floats = NDArray[np.float64]

FLATNESS = 1e-4  # a curved outline is flattened to within this part of the longer side of its box
_SAME = 1e-14  # in the frame: vertices nearer than this are one
_ON = 4e-15  # in the frame: nearer than this is on the edge


class BoundaryPoint(NamedTuple):
    """Where the edge of a domain comes nearest to each query.

    Attributes
    ----------
    point : (m, 2) float64 array
        The nearest point of the boundary.
    distance : (m,) float64 array
        In the polygon's units.
    edge : (m,) int64 array
        The edge it lies on.
    t : (m,) float64 array
        Where on that edge, in [0, 1].
    arc_length : (m,) float64 array
        Length along the boundary from the first vertex of the outline; holes follow the outline.
    """

    point: Floats
    distance: Floats
    edge: NDArray[np.int64]
    t: Floats
    arc_length: Floats


@dataclass(frozen=True, eq=False)
class Domain:
    """The inside of a polygon with holes.

    Coordinates are kept in a frame: the middle of the box is the origin and a power of two scales it into [-1, 1], so
    that neither a shift nor the unit of length matters.

    Attributes
    ----------
    start, end : (n, 2) float64 arrays
        Ends of the edges in the frame, the domain on their left; loop after loop, the outline first.
    loop : (n,) int64 array
        0 for the outline, 1, 2, ... for the holes.
    vertex : (n, 2) int64 array
        Which given vertices the edge starts and ends at; they name the values.
    given : int
        How many vertices were given.
    centre : (2,) float64 array
        The frame's origin in the polygon's units.
    exponent : int
        Coordinates in the frame are the polygon's, less the centre, times 2**-exponent.
    curved : bool
        Whether the vertices come from flattening a curve, so that no value can be given for each.

    Examples
    --------
    >>> square = Domain.of([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> square.inside([[0.5, 0.5], [2.0, 0.5], [1.0, 0.5]])
    array([ True, False,  True])
    >>> square.closest([[0.5, 0.25]]).point
    array([[0.5, 0. ]])
    """

    start: Floats
    end: Floats
    loop: NDArray[np.int64]
    vertex: NDArray[np.int64]
    given: int
    centre: Floats
    exponent: int
    curved: bool = False

    @classmethod
    def of(cls, polygon: Any, flatness: float = FLATNESS) -> Domain:
        """The domain a user means.

        Parameters
        ----------
        polygon : (n, 2) array_like, shapely Polygon, Curve or Domain
            Vertices in either order, the last joined to the first; a polygon with holes of either orientation; or a
            closed curve, whose outermost chain is the outline and whose others are holes.
        flatness : float
            How far a curved outline may be from the polygon that replaces it, as a part of its longer side.

        Raises
        ------
        ValueError, TypeError
            If there are fewer than three different vertices, a number that is not finite, an outline that crosses or
            touches itself, a hole outside, or a curve that is open.
        """
        if isinstance(polygon, Domain):
            return polygon
        loops, curved = _loops(polygon, flatness)
        low = np.min([loop.min(axis=0) for loop in loops], axis=0)
        high = np.max([loop.max(axis=0) for loop in loops], axis=0)
        centre = 0.5 * low + 0.5 * high
        exponent = int(np.frexp(0.5 * float((high - low).max()))[1])
        if not (high > low).all() or exponent < -1000:
            raise ValueError("polygon: expected at least three vertices that enclose an area, got none or a line")
        framed = [np.ldexp(loop - centre, -exponent) for loop in loops]
        return cls._assemble(framed, centre, exponent, curved)

    @classmethod
    def _assemble(cls, loops: list[Floats], centre: Floats, exponent: int, curved: bool) -> Domain:
        counted = np.cumsum([0] + [len(loop) for loop in loops])
        kept = []
        for loop, offset in zip(loops, counted[:-1], strict=True):
            corners, before, after = _without_repeats(loop)
            if len(corners) < 3:
                raise ValueError(
                    f"polygon: expected at least three different vertices in a loop, got {len(corners)} of {len(loop)}"
                )
            kept.append((corners, before + offset, after + offset))
        _simple([corners for corners, _, _ in kept])
        columns = []
        for index, (corners, before, after) in enumerate(kept):
            start, end = corners, np.roll(corners, -1, axis=0)
            vertex = np.column_stack([after, np.roll(before, -1)])
            if (_area(corners) > 0.0) != (index == 0):  # the domain belongs on the left
                start, end, vertex = end[::-1], start[::-1], vertex[::-1, ::-1]
            columns.append((start, end, np.full(len(start), index), vertex))
        start, end, number, vertex = (np.concatenate(column) for column in zip(*columns, strict=True))
        return cls(start, end, number, vertex, int(counted[-1]), centre, exponent, curved)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def unit(self) -> float:
        """Length of the frame's unit in the polygon's units."""
        return float(np.ldexp(1.0, self.exponent))

    @cached_property
    def lengths(self) -> Floats:
        """Length of each edge in the frame, (n,)."""
        return np.hypot(*(self.end - self.start).T)

    @cached_property
    def arc(self) -> Floats:
        """Length along the boundary in the frame up to the start of each edge, (n,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)[:-1]])

    @cached_property
    def following(self) -> NDArray[np.int64]:
        """The edge that starts where each edge ends, (n,)."""
        result = np.arange(1, len(self) + 1)
        first = np.flatnonzero(np.diff(self.loop, prepend=-1))
        result[np.append(first[1:], len(self)) - 1] = first
        return result

    @cached_property
    def nearest(self) -> Nearest:
        """Compiled search for closest points and the local sizes."""
        from nqr_geom.wos import nearest

        return nearest.build(self.start, self.end, self.following)

    @cached_property
    def outline(self) -> Curve:
        """The edges in the frame as a curve."""
        control = np.stack([self.start, self.end, self.end, self.end], axis=1)
        return Curve(control, np.ones(len(self), dtype=np.int64))

    def to_frame(self, points: ArrayLike) -> Floats:
        """Points (m, 2) of the polygon's plane in the frame."""
        return np.ldexp(check.array("points", points, ("m", 2)) - self.centre, -self.exponent)

    def from_frame(self, points: Floats) -> Floats:
        """Points (m, 2) of the frame in the polygon's plane."""
        return np.ldexp(points, self.exponent) + self.centre

    def search(self, framed: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Closest edge, parameter and distance of points in the frame."""
        from nqr_geom.wos.nearest import nearest_rows

        edges, _, grid, shape, first, items = self.nearest
        m = len(framed)
        edge, t, square, of = np.empty(m, np.int64), np.empty(m), np.empty(m), np.zeros(m, np.int64)

        def rows(i: int, j: int) -> None:
            out = (edge[i:j], t[i:j], square[i:j])
            nearest_rows(edges, grid, shape, first, items, of[i:j], framed[i:j], *out)

        over_rows(rows, m)
        return edge, t, np.sqrt(square)

    def contains(self, framed: Floats) -> NDArray[np.bool_]:
        """Whether points in the frame lie inside or on the edge, (m,)."""
        from nqr_geom.curves.winding import gwn

        reach = np.abs(framed).max(axis=1, initial=0.0) < 2.0
        within = np.where(reach[:, None], framed, 2.0)
        return (np.abs(gwn(self.outline, within)) > 0.5) | (self.search(within)[2] <= _ON)

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point (m, 2) lies inside or on the edge, (m,)."""
        return self.contains(self.to_frame(points))

    def closest(self, points: ArrayLike) -> BoundaryPoint:
        """The nearest point of the boundary to each point (m, 2)."""
        edge, t, distance = self.search(self.to_frame(points))
        point = self.from_frame(self.at(edge, t))
        arc = self.arc[edge] + t * self.lengths[edge]
        return BoundaryPoint(point, np.ldexp(distance, self.exponent), edge, t, np.ldexp(arc, self.exponent))

    def at(self, edge: NDArray[np.int64], t: Floats) -> Floats:
        """Points (m, 2) on edges in the frame; ends bit for bit."""
        a, b, s = self.start[edge], self.end[edge], t[..., None]
        return np.where(s > 0.5, b - (1.0 - s) * (b - a), a + s * (b - a))

    def boundary(self, values: Any) -> Boundary:
        """What a user gives on the edge, ready to be evaluated.

        Parameters
        ----------
        values : callable, or (k,) array_like, or Boundary
            ``values(points (m, 2)) -> (m,)``, or one number a given vertex, linear along the edges. A vertex given
            twice may carry two values: there the boundary values jump.
        """
        if isinstance(values, Boundary):
            return values
        if callable(values):
            return Boundary(self, function=values)
        if self.curved:
            raise ValueError("boundary: expected a callable on a curved outline, which has no vertices, got an array")
        numbers = check.array("boundary", values, ("n",))
        if len(numbers) != self.given:
            raise ValueError(f"boundary: expected {self.given} values, one a vertex, got {len(numbers)}")
        return Boundary(self, linear=numbers[self.vertex])


@dataclass(frozen=True, eq=False)
class Boundary:
    """Values on the edge of a domain.

    Parameters
    ----------
    domain : Domain
        Whose edge.
    linear : (n, 2) float64 array, optional
        Values at the two ends of each edge, linear between them.
    function : callable, optional
        ``function(points (m, 2)) -> (m,)`` in the polygon's units.
    """

    domain: Domain
    linear: Floats | None = None
    function: Callable[[Floats], ArrayLike] | None = None

    def at(self, edge: NDArray[np.int64], t: Floats) -> Floats:
        """Values at t of each edge; any shape, the same for both."""
        if self.linear is not None:
            a, b = self.linear[edge, 0], self.linear[edge, 1]
            return np.where(a == b, a, a * (1.0 - t) + b * t)
        return evaluated("boundary", self.function, self.domain.from_frame(self.domain.at(edge, t).reshape(-1, 2))
                         ).reshape(t.shape)  # fmt: skip

    def less(self, level: float) -> Boundary:
        """The same values less a number."""
        if self.linear is not None:
            return Boundary(self.domain, linear=self.linear - level)
        function = self.function
        return Boundary(self.domain, function=lambda points: evaluated("boundary", function, points) - level)


def evaluated(name: str, function: Callable[[Floats], ArrayLike] | None, points: Floats) -> Floats:
    """A user's function at points (m, 2), held to its promise."""
    if function is None:
        raise TypeError(f"{name}: expected a callable, got None")
    if len(points) == 0:
        return np.zeros(0)
    result = np.asarray(function(points))
    if result.ndim == 0:
        result = np.broadcast_to(result, len(points))
    if result.shape != (len(points),):
        raise ValueError(f"{name}: expected a callable that gives shape ({len(points)},), got {result.shape}")
    return check.array(name, result, ("m",))


def _loops(polygon: Any, flatness: float) -> tuple[list[Floats], bool]:
    """Outline and holes as vertices, and whether they were flattened."""
    if isinstance(polygon, Curve):
        return _chains(polygon, flatness)
    if hasattr(polygon, "geom_type"):
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise TypeError(f"polygon: expected a shapely Polygon that is not empty, got {polygon.geom_type}")
        rings = [np.asarray(ring.coords)[:-1, :2] for ring in (polygon.exterior, *polygon.interiors)]
        return [check.array("polygon", ring, ("n", 2)) for ring in rings], False
    vertices = check.array("polygon", polygon, ("n", 2))
    if len(vertices) < 3:
        raise ValueError(f"polygon: expected at least three vertices, got {len(vertices)}")
    return [vertices], False


def _chains(curve: Curve, flatness: float) -> tuple[list[Floats], bool]:
    """Chains of a closed curve as loops, the one of the largest box first."""
    flatness = check.number("flatness", flatness, low=0.0, open_low=True)
    if len(curve) == 0 or not curve.is_closed:
        raise ValueError("polygon: expected a closed curve, got an empty or open one")
    xmin, ymin, xmax, ymax = curve.bounds
    flat = curve.to_polyline(flatness * max(xmax - xmin, ymax - ymin))
    loops = [flat.control[flat.chain == k, 0] for k in range(int(flat.chain[-1]) + 1)]
    spans = [float(np.ptp(loop, axis=0).prod()) for loop in loops]
    outer = int(np.argmax(spans))
    return [loops[outer], *loops[:outer], *loops[outer + 1 :]], bool((curve.degree > 1).any())


def _without_repeats(loop: Floats) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Corners without repeats, and at each the first and the last given vertex: where an edge arrives and leaves.

    Vertices far closer together than rounding allows are one; an edge between them would have no direction.
    """
    n = len(loop)
    new = np.abs(loop - np.roll(loop, 1, axis=0)).max(axis=1) > _SAME
    if not new.any():
        return loop[:1], np.zeros(1, np.int64), np.zeros(1, np.int64)
    first = np.flatnonzero(new)
    last = (np.append(first[1:], first[0] + n) - 1) % n
    return loop[first], first, last


def _area(corners: Floats) -> float:
    """Signed area, counter-clockwise positive."""
    x, y = (corners - corners[0]).T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _simple(loops: list[Floats]) -> None:
    """Refuse outlines that cross themselves and holes that are not inside."""
    import shapely

    shape = shapely.Polygon(loops[0], loops[1:])
    if not shape.is_valid:
        raise ValueError(
            "polygon: expected an outline that does not cross or touch itself, with its holes inside, got "
            f"{shapely.is_valid_reason(shape).split('[')[0].lower()}"
        )
