"""Triangulations as arrays: splitting edges, flipping them until Delaunay, smoothing; boundary edges stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Edges", "areas", "circumcircles", "flip_to_delaunay", "insert", "smallest_angles", "smooth", "split"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def areas(points: Floats, triangles: Integers) -> Floats:
    """Signed areas (t,), positive for counter-clockwise triangles."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * _cross(b - a, c - a)


def _lengths(points: Floats, triangles: Integers) -> Floats:
    """Lengths (t, 3); column k is the edge opposite to vertex k."""
    ahead, behind = points[triangles[:, [1, 2, 0]]], points[triangles[:, [2, 0, 1]]]
    return np.asarray(np.hypot(*np.moveaxis(behind - ahead, -1, 0)))


def circumcircles(points: Floats, triangles: Integers) -> tuple[Floats, Floats]:
    """Centres (t, 2) and radii (t,)."""
    a = points[triangles[:, 0]]
    b, c = points[triangles[:, 1]] - a, points[triangles[:, 2]] - a
    bb, cc, twice = (b * b).sum(axis=1), (c * c).sum(axis=1), 2.0 * _cross(b, c)
    offset = np.stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb], axis=1) / twice[:, None]
    return a + offset, np.asarray(np.hypot(*offset.T))


def smallest_angles(points: Floats, triangles: Integers) -> Floats:
    """Smallest angle (t,) of each triangle in radians; it lies opposite to the shortest edge."""
    lengths = np.sort(_lengths(points, triangles), axis=1)
    sine = 2.0 * np.abs(areas(points, triangles)) / np.maximum(lengths[:, 1] * lengths[:, 2], 1e-300)
    return np.asarray(np.arcsin(np.minimum(sine, 1.0)))


class Edges:
    """The edges of a triangulation.

    Attributes
    ----------
    nodes : (e, 2) ndarray
        Smaller node first.
    of_triangle : (t, 3) ndarray
        Edge opposite to each vertex.
    inner : (i,) ndarray
        Edges between two triangles; `sides` (i, 2) are their half-edges 3 * triangle + k.
    """

    def __init__(self, triangles: Integers) -> None:
        ends = np.stack([triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]], axis=-1).reshape(-1, 2)
        ends.sort(axis=1)
        key = ends[:, 0] * (triangles.max() + 1) + ends[:, 1]
        order = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        of_half = np.empty(len(key), dtype=np.int64)
        of_half[order] = np.cumsum(np.diff(key[order], prepend=-1) != 0) - 1
        counts = np.diff(first, append=len(key))
        self.nodes = ends[order[first]]
        self.of_triangle = of_half.reshape(-1, 3)
        self.inner = np.flatnonzero(counts == 2)
        self.sides = np.stack([order[first[self.inner]], order[first[self.inner] + 1]], axis=1)
        self.outer = np.flatnonzero(counts == 1)


def flip_to_delaunay(points: Floats, triangles: Integers) -> Integers:
    """Flip inner edges (Lawson) until each pair of opposite angles sums to at most pi."""
    triangles = triangles.copy()
    for _ in range(200):
        edges = Edges(triangles)
        one, two = edges.sides.T
        tri_one, tri_two = one // 3, two // 3
        apex_one, apex_two = triangles.ravel()[one], triangles.ravel()[two]
        a, b = triangles[tri_one, (one + 1) % 3], triangles[tri_one, (one + 2) % 3]
        p, q, u, v = points[apex_one], points[apex_two], points[a], points[b]
        # sin(alpha + beta) of the two angles that look at the edge, times four lengths
        badness = -(
            _cross(u - p, v - p) * ((v - q) * (u - q)).sum(axis=1)
            + ((u - p) * (v - p)).sum(axis=1) * _cross(v - q, u - q)
        )
        scale = np.hypot(*(u - p).T) * np.hypot(*(v - p).T) * np.hypot(*(u - q).T) * np.hypot(*(v - q).T)
        flippable = np.minimum(_cross(u - p, q - p), _cross(v - q, p - q)) > 0.0
        badness = np.where(flippable, badness / np.maximum(scale, 1e-300), 0.0)
        candidates = np.flatnonzero(badness > 1e-10)
        if not len(candidates):
            break
        worst = np.zeros(len(triangles))
        np.maximum.at(worst, tri_one[candidates], badness[candidates])
        np.maximum.at(worst, tri_two[candidates], badness[candidates])
        wins = (worst[tri_one[candidates]] == badness[candidates]) & (worst[tri_two[candidates]] == badness[candidates])
        chosen = candidates[wins]
        # Equal badness in neighbouring pairs could claim one triangle twice: the first claim counts.
        claims = np.stack([tri_one[chosen], tri_two[chosen]], axis=1)
        claimant = np.full(len(triangles), len(chosen))
        np.minimum.at(claimant, claims.ravel(), np.repeat(np.arange(len(chosen)), 2))
        chosen = chosen[(claimant[claims] == np.arange(len(chosen))[:, None]).all(axis=1)]
        triangles[tri_one[chosen]] = np.stack([apex_one[chosen], a[chosen], apex_two[chosen]], axis=1)
        triangles[tri_two[chosen]] = np.stack([apex_two[chosen], b[chosen], apex_one[chosen]], axis=1)
    return triangles


def split(
    points: Floats, triangles: Integers, edges: Edges, marked: NDArray[np.bool_], *, closure: bool = True
) -> tuple[Floats, Integers, Integers]:
    """Halve the marked edges, and the longest edges of their triangles so that angles stay away from zero (Rivara).

    Without `closure` only marked edges are halved, at most one a triangle: the longest.

    Returns
    -------
    points, triangles, middle
        `middle` (e,) is the new node of each edge, or -1.
    """
    lengths = _lengths(points, triangles)
    turn = np.argmax(lengths if closure else np.where(marked[edges.of_triangle], lengths, 0.0), axis=1)[:, None]
    columns = (turn + np.arange(3)) % 3
    corner = np.take_along_axis(triangles, columns, axis=1)  # the longest edge is opposite to the first corner
    edge = np.take_along_axis(edges.of_triangle, columns, axis=1)
    marked = marked.copy()
    if not closure:
        marked[edge[:, 1:]] = False
    while True:
        needed = edge[marked[edge].any(axis=1), 0]
        if marked[needed].all():
            break
        marked[needed] = True
    middle = np.full(len(marked), -1)
    middle[marked] = len(points) + np.arange(np.count_nonzero(marked))
    points = np.concatenate([points, points[edges.nodes[marked]].mean(axis=1)])
    (v0, v1, v2), (m0, m1, m2) = corner.T, middle[edge].T
    has0, has1, has2 = m0 >= 0, m1 >= 0, m2 >= 0
    parts = [
        (~has0, (v0, v1, v2)),
        (has0 & ~has2, (v0, v1, m0)),
        (has0 & ~has1, (v0, m0, v2)),
        (has2 & ~has1, (v0, m2, m0)),
        (has2, (m2, v1, m0)),
        (has1 & ~has2, (v0, m0, m1)),
        (has1, (m1, m0, v2)),
        (has1 & has2, (v0, m2, m1)),
        (has1 & has2, (m0, m1, m2)),
    ]
    return points, np.concatenate([np.stack(nodes, axis=1)[where] for where, nodes in parts]), middle


def insert(points: Floats, triangles: Integers, new: Floats, where: Integers) -> tuple[Floats, Integers]:
    """Put one new point (k, 2) into each of the distinct triangles `where` (k,), joined to its corners."""
    number = len(points) + np.arange(len(new))
    a, b, c = triangles[where].T
    triangles = triangles.copy()
    triangles[where] = np.stack([a, b, number], axis=1)
    more = [np.stack([b, c, number], axis=1), np.stack([c, a, number], axis=1)]
    return np.concatenate([points, new]), np.concatenate([triangles, *more])


def smooth(points: Floats, triangles: Integers, fixed: NDArray[np.bool_], sweeps: int = 3) -> Floats:
    """Move free nodes to the mean of their neighbours where no smallest angle below 30 degrees gets smaller by it."""
    for _ in range(sweeps):
        nodes = Edges(triangles).nodes
        total, count = np.zeros_like(points), np.zeros(len(points))
        for here, there in (nodes.T, nodes.T[::-1]):
            np.add.at(total, here, points[there])
            np.add.at(count, here, 1.0)
        moves = ~fixed & (count > 0)
        before = np.minimum(smallest_angles(points, triangles), np.pi / 6.0)
        for _ in range(20):
            target = np.where(moves[:, None], total / np.maximum(count, 1.0)[:, None], points)
            worse = (smallest_angles(target, triangles) < before) | (areas(target, triangles) <= 0.0)
            back = np.unique(triangles[worse])
            if not moves[back].any():
                points = target
                break
            moves[back] = False
    return points
