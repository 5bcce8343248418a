"""Where the nodes of a mesh go: size by place, Delaunay boundary, circumcentres inside (Ruppert 1995)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nqr_geom.fem import delaunay

if TYPE_CHECKING:
    from nqr_geom.fem.mesh import Mesh
    from nqr_geom.fem.outline import Outline

__all__ = ["Grading", "filled"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_ROUNDS = 60
_GROWTH = 0.4  # how much larger triangles may get by unit of distance from short boundary segments
_LARGE = 0.65  # circumradius over allowed edge length from which on a triangle gets a node; 0.58 if equilateral
_THIN = 1.4  # circumradius over shortest edge: angles below 20 degrees
_SHARP = np.radians(45.0)


class Grading:
    """How far triangles shrink towards corners where the solution is like r^e, e = pi / angle, e < order."""

    def __init__(self, outline: Outline, order: int) -> None:
        from scipy.spatial import cKDTree

        vertices = outline.to_frame(outline.vertices)
        start, end = vertices[outline.edges[:, 0]], vertices[outline.edges[:, 1]]
        lengths = np.hypot(*(end - start).T)
        before = np.concatenate(
            [np.roll(lengths[a:b], 1) for a, b in zip(outline.rings[:-1], outline.rings[1:], strict=True)]
        )
        exponent = np.pi / np.maximum(outline.angles, 1e-9)
        # Collinear vertices, and right angles for quadratic elements, are smooth in spite of rounding.
        singular = exponent < order * (1.0 - 1e-6)
        if order == 2:
            singular &= np.abs(exponent - 1.0) > 1e-6
        self.reach = np.minimum(lengths, before)[singular]
        self.power = 0.9 * exponent[singular] / order
        self.tree = cKDTree(start[singular]) if singular.any() else None

    def shrink(self, points: Floats, allowed: Floats) -> Floats:
        """The size allowed (m,) at points (m, 2), less near singular corners."""
        if self.tree is None:
            return allowed
        distance, which = self.tree.query(points, k=min(4, len(self.reach)))
        distance, which = distance.reshape(len(points), -1), which.reshape(len(points), -1)
        reach, power = self.reach[which], self.power[which]
        least = reach * (allowed[:, None] / reach) ** (1.0 / power)  # where a triangle is as large as it is far away
        near = np.minimum(np.maximum(distance, least) / reach, 1.0)
        return np.asarray(allowed * (near ** (1.0 - power)).min(axis=1))


def filled(mesh: Mesh, bound: Callable[[Floats], Floats]) -> Mesh:
    """Add nodes until no edge is much longer than the bound at its place and few triangles are thin."""
    mesh = _boundary(mesh, bound)
    for _ in range(_ROUNDS):
        new, where = _centres(mesh, bound)
        if not len(new):
            break
        mesh = _boundary(mesh.with_points(new, where), bound)
    for _ in range(3):
        mesh = mesh.smoothed()
    return mesh


def _lengths(mesh: Mesh) -> Floats:
    return np.asarray(np.hypot(*(mesh.points[mesh.segments[:, 1]] - mesh.points[mesh.segments[:, 0]]).T))


def _sharp_nodes(mesh: Mesh) -> NDArray[np.bool_]:
    """Nodes at corners of the polygon that are too sharp for triangles without thin angles."""
    sharp = np.zeros(len(mesh.points), dtype=bool)
    first = mesh.segment_t[:, 0] == 0.0
    sharp[mesh.segments[first, 0]] = mesh.outline.angles[mesh.segment_edge[first]] < _SHARP
    return sharp


def _boundary(mesh: Mesh, bound: Callable[[Floats], Floats]) -> Mesh:
    """Halve segments that are too long, or that a node looks at under an obtuse angle."""
    for _ in range(_ROUNDS):
        middles = mesh.points[mesh.segments].mean(axis=1)
        marked = _lengths(mesh) > bound(middles)
        apex = np.full(len(mesh.edges.nodes), -1)
        apex[mesh.edges.of_triangle.ravel()] = mesh.triangles.ravel()
        sight = mesh.points[mesh.segments] - mesh.points[apex[mesh.segment_number]][:, None]
        obtuse = (sight[:, 0] * sight[:, 1]).sum(axis=1) < -1e-6 * (sight**2).sum(axis=(1, 2))
        marked |= obtuse & ~_sharp_nodes(mesh)[mesh.segments].any(axis=1)
        if not marked.any():
            break
        mesh = mesh.halved(marked)
    return mesh


def _centres(mesh: Mesh, bound: Callable[[Floats], Floats]) -> tuple[Floats, Integers]:
    """Circumcentres of triangles that are too large or thin, apart from each other, and the triangles they lie in."""
    from scipy.spatial import cKDTree

    centres, radii = delaunay.circumcircles(mesh.points, mesh.triangles)
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    shortest = np.minimum(np.minimum(np.hypot(*(b - a).T), np.hypot(*(c - b).T)), np.hypot(*(a - c).T))
    allowed = _LARGE * _graded(mesh, mesh.points[mesh.triangles].mean(axis=1), bound)
    blunt = ~_sharp_nodes(mesh)[mesh.triangles].any(axis=1)
    excess = np.maximum(radii / allowed, np.where(blunt, radii / (_THIN * shortest), 0.0))
    wanted = np.flatnonzero(excess > 1.0)
    wanted = wanted[np.argsort(-excess[wanted], kind="stable")]
    where, weights = mesh.locate_in_frame(centres[wanted])
    inside = (where >= 0) & (weights.min(axis=1) > 1e-9)
    # The centre of a large triangle may lie beyond the boundary: its centroid serves as well.
    places = np.where(inside[:, None], centres[wanted], mesh.points[mesh.triangles[wanted]].mean(axis=1))
    where = np.where(inside, where, wanted)
    good = ~_encroaches(mesh, places, where)
    nearest = cKDTree(mesh.points).query(places)[0]
    good &= nearest > 0.5 * np.minimum(radii, np.maximum(allowed, shortest))[wanted]
    places, where, reach = places[good], where[good], radii[wanted][good]
    if not len(places):
        return places, where
    gaps, rivals = cKDTree(places).query(places, k=min(12, len(places)))
    gaps, rivals = gaps.reshape(len(places), -1), rivals.reshape(len(places), -1)
    beaten = (rivals < np.arange(len(places))[:, None]) & (gaps < np.minimum(reach[:, None], reach[rivals]))
    keep = np.flatnonzero(~beaten.any(axis=1))
    keep = keep[np.sort(np.unique(where[keep], return_index=True)[1])]
    return places[keep], where[keep]


def _graded(mesh: Mesh, points: Floats, bound: Callable[[Floats], Floats]) -> Floats:
    """The bound, less near short segments so that sizes change gently."""
    from scipy.spatial import cKDTree

    distance, which = cKDTree(mesh.points[mesh.segments].mean(axis=1)).query(points, k=min(6, len(mesh.segments)))
    return np.asarray(np.minimum(bound(points), (1.2 * _lengths(mesh)[which] + _GROWTH * distance).min(axis=1)))


def _encroaches(mesh: Mesh, places: Floats, where: Integers) -> NDArray[np.bool_]:
    """Whether a place (k, 2) in triangle `where` (k,) would look at a boundary edge of it under an obtuse angle."""
    outer = np.zeros(len(mesh.edges.nodes), dtype=bool)
    outer[mesh.segment_number] = True
    result = np.zeros(len(places), dtype=bool)
    for k in range(3):
        u, v = (mesh.points[mesh.triangles[where, (k + i) % 3]] - places for i in (1, 2))
        result |= outer[mesh.edges.of_triangle[where, k]] & ((u * v).sum(axis=1) < 0.0)
    return result
