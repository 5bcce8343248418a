"""Triangle meshes of polygons with holes: Delaunay, graded towards corners, refined where asked, searched fast."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.fem import delaunay
from nqr_geom.fem.outline import BoundaryValues, Outline

__all__ = ["Mesh"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Size = float | Callable[[Floats], ArrayLike]


@dataclass(frozen=True)
class Mesh:
    """A triangulation of a polygon, in frame coordinates (see `Outline`).

    Attributes
    ----------
    outline : Outline
        The polygon and its frame.
    points : (n, 2) float64 ndarray
    triangles : (t, 3) int64 ndarray
        Counter-clockwise.
    segments : (b, 2) int64 ndarray
        Nodes of the boundary's pieces; piece i covers parameters ``segment_t[i]`` of edge ``segment_edge[i]``.
    segment_edge : (b,) int64 ndarray
    segment_t : (b, 2) float64 ndarray

    Examples
    --------
    >>> mesh = Mesh.of([[0, 0], [1, 0], [1, 1], [0, 1]], n=500)
    >>> 250 < len(mesh.triangles) < 1000
    True
    >>> finer = mesh.refined()
    >>> len(finer.triangles) == 4 * len(mesh.triangles)
    True
    """

    outline: Outline
    points: Floats
    triangles: Integers
    segments: Integers
    segment_edge: Integers
    segment_t: Floats

    @classmethod
    def of(cls, polygon: Any, n: int = 4000, *, size: Size | None = None, order: int = 1, graded: bool = True) -> Mesh:
        """Mesh a polygon.

        Parameters
        ----------
        polygon : shapely Polygon, (n, 2) array_like, or Outline
            Vertices in either orientation; duplicate and collinear ones are fine, holes too.
        n : int
            About how many triangles there would be without grading; ignored when `size` is given.
        size : float or callable, optional
            Longest edge allowed, in the polygon's unit; a callable (m, 2) -> (m,) gives it by place.
        order : {1, 2}
            Which elements will be used: quadratic ones call for grading at more corners.
        graded : bool
            Let triangles shrink towards corners where solutions are singular, like r^(pi / angle), so fast that
            the order of convergence is that of smooth solutions.

        Raises
        ------
        ValueError, TypeError
            If the polygon has fewer than three distinct vertices, crosses itself, or a size is not positive.
        """
        outline = polygon if isinstance(polygon, Outline) else Outline.of(polygon)
        order = check.integer("order", order, low=1, high=2)
        if size is None:
            # Edges end up somewhat shorter than the bound: equilateral ones of 0.86 of it fit the count.
            area = outline.polygon.area
            size = outline.size * float(np.sqrt(area / check.integer("n", n, low=1) * 4.0 / np.sqrt(3.0)) / 0.86)
        elif not callable(size):
            size = check.number("size", size, low=0.0, open_low=True)
        from nqr_geom.fem.fill import Grading, filled

        corners = Grading(outline, order) if graded else None

        def bound(points: Floats) -> Floats:
            if callable(size):
                there = outline.centre + outline.size * points
                allowed = check.array("size(points)", size(there), (len(points),))
                if not (allowed > 0.0).all():
                    raise ValueError(f"size(points): expected numbers > 0, got {allowed.min()}")
            else:
                allowed = np.full(len(points), size)
            allowed = allowed / outline.size
            return allowed if corners is None else corners.shrink(points, allowed)

        return filled(_coarsest(outline), bound)

    @cached_property
    def boundary(self) -> NDArray[np.bool_]:
        """Which nodes lie on the boundary, (n,)."""
        result = np.zeros(len(self.points), dtype=bool)
        result[self.segments] = True
        return result

    @cached_property
    def edges(self) -> delaunay.Edges:
        """The edges; their numbers are those of quadratic elements' mid-edge nodes."""
        return delaunay.Edges(self.triangles)

    @cached_property
    def segment_number(self) -> Integers:
        """Index in `edges` of each boundary segment."""
        count = len(self.points)
        low, high = self.segments.min(axis=1), self.segments.max(axis=1)
        return np.searchsorted(self.edges.nodes @ [count, 1], low * count + high)

    def refined(self, marked: NDArray[np.bool_] | None = None) -> Mesh:
        """Split all triangles in four, or the marked (t,) ones and what it takes to stay without hanging nodes."""
        if marked is None:
            return self._split(np.ones(len(self.edges.nodes), dtype=bool), keep=True)
        chosen = np.zeros(len(self.edges.nodes), dtype=bool)
        chosen[self.edges.of_triangle[marked]] = True
        return self._split(chosen)

    def halved(self, segments: NDArray[np.bool_]) -> Mesh:
        """Split marked boundary segments (b,) and nothing else; of two in one triangle only the longer."""
        chosen = np.zeros(len(self.edges.nodes), dtype=bool)
        chosen[self.segment_number[segments]] = True
        return self._split(chosen, closure=False)

    def with_points(self, new: Floats, triangles: Integers) -> Mesh:
        """Put a new node (k, 2), in frame coordinates, into each of the given triangles (k,)."""
        points, made = delaunay.insert(self.points, self.triangles, new, triangles)
        return replace(self, points=points, triangles=delaunay.flip_to_delaunay(points, made))

    def locate(self, points: Floats) -> tuple[Integers, Floats]:
        """Triangle (m,) that holds each point given in the user's coordinates, -1 outside, and barycentric (m, 3).

        Points outside by no more than the rounding of their coordinates count as on the boundary.
        """
        return self.locate_in_frame(self.outline.to_frame(points))

    def locate_in_frame(self, queries: Floats) -> tuple[Integers, Floats]:
        """As `locate`, for points in frame coordinates."""
        import shapely

        slack = self.outline.resolution + 1e-13
        which, candidate = self._tree.query(shapely.points(queries))
        a, b, c = (self.points[self.triangles[candidate, k]] for k in range(3))
        p, twice = queries[which], 2.0 * self._areas[candidate]
        weights = np.stack([_cross(c - b, p - b), _cross(a - c, p - c), _cross(b - a, p - a)], axis=1) / twice[:, None]
        lengths = np.stack([np.hypot(*(c - b).T), np.hypot(*(a - c).T), np.hypot(*(b - a).T)], axis=1)
        depth = (weights * (twice[:, None] / lengths)).min(axis=1)  # signed distance to the nearest edge line
        order = np.lexsort((-depth, which))
        which, candidate, weights, depth = which[order], candidate[order], weights[order], depth[order]
        best = np.flatnonzero(np.diff(which, prepend=-1))
        best = best[depth[best] >= -slack]
        triangle, found = np.full(len(queries), -1), np.zeros((len(queries), 3))
        triangle[which[best]] = candidate[best]
        clipped = np.maximum(weights[best], 0.0)
        found[which[best]] = clipped / clipped.sum(axis=1, keepdims=True)
        return triangle, found

    def boundary_values(self, boundary: BoundaryValues, order: int) -> tuple[Floats, Floats]:
        """Values at the nodes (n,), 0 inside, and at the middles of the segments (b,) for quadratic elements.

        Where the values jump at a vertex, its node takes the mean of both sides.
        """
        ends = self.outline.values(boundary, np.repeat(self.segment_edge, 2), self.segment_t.ravel())
        total, count = np.zeros(len(self.points)), np.zeros(len(self.points))
        np.add.at(total, self.segments.ravel(), ends)
        np.add.at(count, self.segments.ravel(), 1.0)
        middles = (
            self.outline.values(boundary, self.segment_edge, self.segment_t.mean(axis=1)) if order == 2 else ends[:0]
        )
        return total / np.maximum(count, 1.0), middles

    @cached_property
    def _areas(self) -> Floats:
        return delaunay.areas(self.points, self.triangles)

    @cached_property
    def _tree(self) -> Any:
        import shapely

        corners = self.points[self.triangles]
        slack = 2.0 * self.outline.resolution + 2e-13
        low, high = corners.min(axis=1) - slack, corners.max(axis=1) + slack
        return shapely.STRtree(shapely.box(*low.T, *high.T))

    def _split(self, marked: NDArray[np.bool_], *, keep: bool = False, closure: bool = True) -> Mesh:
        """Halve the marked edges; flip to Delaunay unless the triangles are to keep their shapes."""
        points, triangles, middle = delaunay.split(self.points, self.triangles, self.edges, marked, closure=closure)
        new = middle[self.segment_number]
        cut = new >= 0
        (a, b), (s, t), mid = self.segments.T, self.segment_t.T, 0.5 * self.segment_t.sum(axis=1)
        halves = [np.where(cut, new, b), np.where(cut, mid, t)]
        segments = np.concatenate([np.stack([a, halves[0]], axis=1), np.stack([new, b], axis=1)[cut]])
        segment_t = np.concatenate([np.stack([s, halves[1]], axis=1), np.stack([mid, t], axis=1)[cut]])
        edge = np.concatenate([self.segment_edge, self.segment_edge[cut]])
        if not keep:
            triangles = delaunay.flip_to_delaunay(points, triangles)
        return Mesh(self.outline, points, triangles, segments, edge, segment_t)

    def smoothed(self) -> Mesh:
        """Free nodes moved to better places, Delaunay again."""
        points = delaunay.smooth(self.points, self.triangles, self.boundary)
        return replace(self, points=points, triangles=delaunay.flip_to_delaunay(points, self.triangles))


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _coarsest(outline: Outline) -> Mesh:
    """The constrained Delaunay triangulation of the polygon without further nodes."""
    import shapely

    found = shapely.constrained_delaunay_triangles(outline.polygon)
    corners = shapely.get_coordinates(found).reshape(-1, 4, 2)[:, :3]
    start = outline.to_frame(outline.vertices)[outline.edges[:, 0]]
    points, node_of_edge = np.unique(start, axis=0, return_inverse=True)
    place = {tuple(point): i for i, point in enumerate(points.tolist())}
    triangles = np.array([[place[tuple(p)] for p in corner] for corner in corners.tolist()], dtype=np.int64)
    clockwise = delaunay.areas(points, triangles) < 0.0
    triangles[clockwise] = triangles[clockwise, ::-1]
    following = np.concatenate(
        [np.roll(np.arange(a, b), -1) for a, b in zip(outline.rings[:-1], outline.rings[1:], strict=True)]
    )
    node_of_edge = node_of_edge.reshape(-1)
    segments = np.stack([node_of_edge, node_of_edge[following]], axis=1)
    edge = np.arange(len(outline.edges))
    mesh = Mesh(outline, points, triangles, segments, edge, np.tile([0.0, 1.0], (len(edge), 1)))
    area = outline.polygon.area
    outer = {tuple(pair) for pair in mesh.edges.nodes[mesh.edges.outer].tolist()}
    if abs(mesh._areas.sum() - area) > 1e-9 * area or outer != {tuple(sorted(pair)) for pair in segments.tolist()}:
        raise ValueError(
            "polygon: expected one that can be triangulated, got parts thinner than rounding, or rings that touch at a "
            "place which is not a vertex of both"
        )
    return replace(mesh, triangles=delaunay.flip_to_delaunay(points, triangles))
