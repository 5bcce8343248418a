"""The polygon a problem lives on: what people bring, cleaned and moved to a frame of size one around the origin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

if TYPE_CHECKING:
    from shapely import Polygon

__all__ = ["BoundaryValues", "Outline"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
BoundaryValues = Callable[[Floats], ArrayLike] | ArrayLike


@dataclass(frozen=True)
class Outline:
    """Edges of a polygon with holes.

    Attributes
    ----------
    vertices : (n, 2) float64 ndarray
        As given: the outer ring, then the holes, no ring's first vertex repeated by shapely's closing one.
    edges : (e, 2) int64 ndarray
        Vertex indices at the start and end of each edge of positive length. Where vertices coincide, the edge before
        ends at the first of them and the edge after starts at the last: their values may jump there.
    rings : (r + 1,) int64 ndarray
        Edges of ring i are ``rings[i] : rings[i + 1]``, the outer one first.
    centre : (2,) float64 ndarray
    size : float
        Half the longer side of the box. Frame coordinates are ``(x - centre) / size``, within [-1, 1].

    Examples
    --------
    >>> outline = Outline.of([[0, 0], [2, 0], [2, 0], [2, 2], [0, 2], [0, 0]])
    >>> outline.edges.tolist()
    [[0, 1], [2, 3], [3, 4], [4, 5]]
    """

    vertices: Floats
    edges: Integers
    rings: Integers
    centre: Floats
    size: float

    @classmethod
    def of(cls, polygon: Any) -> Outline:
        """Clean a shapely Polygon or (n, 2) vertices: duplicates go, crossings are refused, orientation is free."""
        rings = _rings(polygon)
        vertices = np.concatenate(rings)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        with np.errstate(over="ignore"):
            extent = float((high - low).max())
        if not 1e-150 < extent < 1e150:
            raise ValueError(f"polygon: expected an extent between 1e-150 and 1e150, got {extent}")
        centre = low + 0.5 * (high - low)
        rounding = 4.0 * np.finfo(float).eps * float(np.abs(vertices).max())
        if rounding > 1e-6 * extent:
            raise ValueError(f"polygon: expected an extent that coordinates near {vertices[0]} resolve, got {extent}")
        edges, counts, first = [], [0], 0
        for ring in rings:
            edges.append(first + _edges_of_ring(ring, rounding))
            counts.append(len(edges[-1]))
            first += len(ring)
        outline = cls(vertices, np.concatenate(edges), np.cumsum(counts), centre, 0.5 * extent)
        outline._refuse_invalid()
        return outline

    @cached_property
    def polygon(self) -> Polygon:
        """The cleaned polygon in frame coordinates."""
        from shapely import Polygon

        points = self.to_frame(self.vertices)[self.edges[:, 0]]
        outer, *holes = (points[a:b] for a, b in zip(self.rings[:-1], self.rings[1:], strict=True))
        return Polygon(outer, holes)

    @cached_property
    def resolution(self) -> float:
        """How far a given coordinate may be off in the frame by rounding alone."""
        return 8.0 * np.finfo(float).eps * (1.0 + float(np.abs(self.vertices).max()) / self.size)

    @cached_property
    def angles(self) -> Floats:
        """Interior angle at the start of each edge, in (0, 2 pi)."""
        points = self.to_frame(self.vertices)
        along = points[self.edges[:, 1]] - points[self.edges[:, 0]]
        before = np.concatenate(
            [np.roll(np.arange(a, b), 1) for a, b in zip(self.rings[:-1], self.rings[1:], strict=True)]
        )
        back = -along[before]
        turn = np.arctan2(along[:, 0] * back[:, 1] - along[:, 1] * back[:, 0], (along * back).sum(axis=1)) % (
            2.0 * np.pi
        )
        shapes = [self.polygon.exterior, *self.polygon.interiors]
        inner = np.repeat([ring.is_ccw == (i == 0) for i, ring in enumerate(shapes)], np.diff(self.rings))
        return np.where(inner, turn, 2.0 * np.pi - turn)

    def to_frame(self, points: Floats) -> Floats:
        """Frame coordinates of points given in the user's."""
        return (points - self.centre) / self.size

    def along_edges(self, edge: Integers, t: Floats) -> Floats:
        """Points at parameters t in [0, 1] of edges, in the user's coordinates; t = 0 and 1 give the very vertices."""
        start, end = self.vertices[self.edges[edge, 0]], self.vertices[self.edges[edge, 1]]
        return np.where(t[:, None] == 1.0, end, start + t[:, None] * (end - start))

    def values(self, boundary: BoundaryValues, edge: Integers, t: Floats) -> Floats:
        """Boundary values at parameters t of edges: of a callable, or linear between values at the vertices."""
        if callable(boundary):
            result = boundary(self.along_edges(edge, t))
            return check.array("boundary(points)", result, (len(edge),))
        given = check.array("boundary", boundary, ("n",))
        if len(given) != len(self.vertices):
            raise ValueError(
                f"boundary: expected a callable or one value a vertex ({len(self.vertices)}), got {len(given)}"
            )
        start, end = given[self.edges[edge, 0]], given[self.edges[edge, 1]]
        return np.where(t == 1.0, end, start + t * (end - start))

    def _refuse_invalid(self) -> None:
        from shapely import is_valid_reason

        reason = is_valid_reason(self.polygon)
        if reason != "Valid Geometry":
            raise ValueError(f"polygon: expected one without crossings, got {reason} in the frame of size one")
        if not self.polygon.area > 0.0:
            raise ValueError("polygon: expected a positive area, got 0")


def _rings(polygon: Any) -> list[Floats]:
    """Vertices of the outer ring and the holes."""
    if type(polygon).__module__.partition(".")[0] == "shapely":
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise TypeError(f"polygon: expected a Polygon or (n, 2) vertices, got {polygon.geom_type}")
        rings = [np.asarray(ring.coords)[:-1, :2] for ring in (polygon.exterior, *polygon.interiors)]
    else:
        rings = [polygon]
    checked = [check.array("polygon", ring, ("n", 2)) for ring in rings]
    if any(len(ring) < 3 for ring in checked):
        raise ValueError(f"polygon: expected at least 3 distinct vertices a ring, got {min(map(len, checked))}")
    return checked


def _edges_of_ring(ring: Floats, rounding: float) -> Integers:
    """Index pairs of the edges of positive length."""
    ahead = np.roll(ring, -1, axis=0)
    starts = np.flatnonzero(np.abs(ahead - ring).max(axis=1, initial=0.0) > rounding)
    if len(starts) < 3:
        raise ValueError(f"polygon: expected at least 3 distinct vertices a ring, got {len(starts)}")
    # An edge ends where it was cut off, at the first vertex of a run of equal ones; the next one starts at the last.
    return np.stack([starts, (starts + 1) % len(ring)], axis=1)
