"""Closest boundary points of polygons, compiled: a grid whose cells know which edges can be closest.

Every query of a walk lies inside the polygon, so a grid over its box answers where a tree would have to search: a cell
lists the edges that are closest to at least one of its points (a superset: closest to the cell's centre within its
diameter), two to five for most cells, and one look there is exact. Several polygons lie behind one another in the same
arrays, so that a batch of queries on many of them is one call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["BINS", "Nearest", "build", "join", "nearest", "nearest_of_all", "nearest_rows"]

BINS = 8  # parts of an edge that have their own local size

_BLOCK = 16  # cells of a side that share one search over all edges


class Nearest(NamedTuple):
    """Edges and grids of S polygons, in the frames of the polygons.

    Parameters
    ----------
    edges : (E, 5) float64
        x and y of the start, dx and dy to the end, one over the squared length.
    size : (E, BINS) float64
        Radius of the largest ball inside that touches each part of the edge: the local size of the domain.
    grid : (S, 3) float64
        x and y of the lower left corner, one over the side of a cell.
    shape : (S, 4) int64
        Cells along x and y, the first of the polygon's cells in `first`, the first of its edges in `edges`.
    first : (cells + 1,) int64
        Where the candidates of a cell begin in `items`.
    items : (k,) int32
        Candidate edges, rising within a cell, so that of equally close edges the first one wins.
    """

    edges: NDArray[np.float64]
    size: NDArray[np.float64]
    grid: NDArray[np.float64]
    shape: NDArray[np.int64]
    first: NDArray[np.int64]
    items: NDArray[np.int32]


@njit(cache=True, nogil=True, inline="always")
def _to_edge(edges, e, x, y):  # type: ignore[no-untyped-def]
    """Parameter in [0, 1] and squared distance of the point of edge e that is closest to (x, y)."""
    ax, ay, dx, dy = x - edges[e, 0], y - edges[e, 1], edges[e, 2], edges[e, 3]
    t = min(max((ax * dx + ay * dy) * edges[e, 4], 0.0), 1.0)
    if t > 0.5:  # from the nearer end: exactly zero there
        ax, ay, s = ax - dx, ay - dy, 1.0 - t
        ax, ay = ax + s * dx, ay + s * dy
    else:
        ax, ay = ax - t * dx, ay - t * dy
    return t, ax * ax + ay * ay


@njit(cache=True, nogil=True)
def nearest(edges, grid, shape, first, items, s, x, y):  # type: ignore[no-untyped-def]
    """Closest edge, parameter and squared distance on polygon s; edge -1 for a point off its grid."""
    u, v = (x - grid[s, 0]) * grid[s, 2], (y - grid[s, 1]) * grid[s, 2]
    nx, ny = shape[s, 0], shape[s, 1]
    if not (0.0 <= u <= nx and 0.0 <= v <= ny):
        return -1, 0.0, 0.0
    cell = shape[s, 2] + min(int(v), ny - 1) * nx + min(int(u), nx - 1)
    best, at, where = np.inf, -1, 0.0
    for k in range(first[cell], first[cell + 1]):
        e = np.int64(items[k])
        t, d = _to_edge(edges, e, x, y)
        if d < best:
            best, at, where = d, e, t
    return at, where, best


@njit(cache=True, nogil=True)
def nearest_of_all(edges, shape, s, x, y):  # type: ignore[no-untyped-def]
    """The same by asking every edge of polygon s: for points off its grid."""
    best, at, where = np.inf, -1, 0.0
    last = shape[s + 1, 3] if s + 1 < shape.shape[0] else edges.shape[0]
    for e in range(shape[s, 3], last):
        t, d = _to_edge(edges, e, x, y)
        if d < best:
            best, at, where = d, e, t
    return at, where, best


@njit(cache=True, nogil=True)
def nearest_rows(edges, grid, shape, first, items, of, points, which, where, square):  # type: ignore[no-untyped-def]
    """`nearest` for points (m, 2), each on its polygon of[i]; points off the grid ask all edges."""
    for i in range(points.shape[0]):
        s, x, y = of[i], points[i, 0], points[i, 1]
        e, t, d = nearest(edges, grid, shape, first, items, s, x, y)
        if e < 0:
            e, t, d = nearest_of_all(edges, shape, s, x, y)
        which[i], where[i], square[i] = e, t, d


@njit(cache=True, nogil=True)
def _reach(edges, candidates, x, y, half):  # type: ignore[no-untyped-def]
    """Which of the candidates may be closest to some point within `half` of (x, y)."""
    square = np.empty(len(candidates))
    for k in range(len(candidates)):
        square[k] = _to_edge(edges, candidates[k], x, y)[1]
    bound = (np.sqrt(square.min()) + 2.0 * half) * (1.0 + 1e-9)
    return candidates[square <= bound * bound]


@njit(cache=True, nogil=True)
def _fill(edges, x0, y0, side, nx, ny):  # type: ignore[no-untyped-def]
    """Candidates of every cell: first per block of cells, then of those per cell."""
    everything = np.arange(len(edges), dtype=np.int32)
    cells = [everything[:0]]
    for _ in range(nx * ny - 1):
        cells.append(everything[:0])
    half = side * np.sqrt(0.5)
    for by in range(0, ny, _BLOCK):
        for bx in range(0, nx, _BLOCK):
            middle_x, middle_y = x0 + side * (bx + 0.5 * _BLOCK), y0 + side * (by + 0.5 * _BLOCK)
            block = _reach(edges, everything, middle_x, middle_y, _BLOCK * half)
            for iy in range(by, min(by + _BLOCK, ny)):
                for ix in range(bx, min(bx + _BLOCK, nx)):
                    x, y = x0 + side * (ix + 0.5), y0 + side * (iy + 0.5)
                    cells[iy * nx + ix] = _reach(edges, block, x, y, half)
    first = np.zeros(nx * ny + 1, dtype=np.int64)
    for c in range(nx * ny):
        first[c + 1] = first[c] + len(cells[c])
    items = np.empty(first[-1], dtype=np.int32)
    for c in range(nx * ny):
        items[first[c] : first[c + 1]] = cells[c]
    return first, items


@njit(cache=True, nogil=True)
def _touching_balls(edges, grid, shape, first, items, size):  # type: ignore[no-untyped-def]
    """Radius of the largest ball inside that touches the middle of each part of each edge: it shrinks until empty."""
    for e in range(len(edges)):
        length = np.sqrt(edges[e, 2] ** 2 + edges[e, 3] ** 2)
        nx, ny = -edges[e, 3] / length, edges[e, 2] / length
        for b in range(BINS):
            t = (b + 0.5) / BINS
            px, py = edges[e, 0] + t * edges[e, 2], edges[e, 1] + t * edges[e, 3]
            radius = 4.0
            for _ in range(60):
                cx, cy = px + radius * nx, py + radius * ny
                # The centre may lie off the grid while the ball is large: brought in along the normal first.
                k, s, d = nearest(edges, grid, shape, first, items, 0, cx, cy)
                if k < 0:
                    radius *= 0.5
                    continue
                if d >= radius * radius * 0.98:
                    break
                qx, qy = edges[k, 0] + s * edges[k, 2] - px, edges[k, 1] + s * edges[k, 3] - py
                along = qx * nx + qy * ny
                shrunk = (qx * qx + qy * qy) / (2.0 * along) if along > 0.0 else 0.5 * radius
                radius = min(shrunk, 0.999 * radius)
            size[e, b] = radius


@njit(cache=True, nogil=True)
def _gaps_at_vertices(edges, following, size):  # type: ignore[no-untyped-def]
    """Where a re-entrant corner comes close to the middle of an edge, that part of the edge is as narrow as the gap."""
    n = len(edges)
    for e in range(n):
        f = following[e]
        if edges[e, 2] * edges[f, 3] - edges[e, 3] * edges[f, 2] >= 0.0:
            continue
        x, y = edges[f, 0], edges[f, 1]
        for k in range(n):
            if k in (e, f):
                continue
            # Seen from inside only: the corner lies to the left of the edge.
            if edges[k, 2] * (y - edges[k, 1]) - edges[k, 3] * (x - edges[k, 0]) <= 0.0:
                continue
            t, d = _to_edge(edges, k, x, y)
            b = min(int(t * BINS), BINS - 1)
            size[k, b] = min(size[k, b], 0.5 * np.sqrt(d))


def build(start: NDArray[np.float64], end: NDArray[np.float64], following: NDArray[np.int64]) -> Nearest:
    """Grid and local sizes of one polygon.

    Parameters
    ----------
    start, end : (n, 2) float64
        Ends of the edges in [-1, 1], the domain on their left.
    following : (n,) int64
        The edge that begins where each edge ends.
    """
    along = end - start
    edges = np.column_stack([start, along, 1.0 / (along**2).sum(axis=1)])
    low, high = start.min(axis=0), start.max(axis=0)
    low, high = low - 1e-12, high + 1e-12
    extent = high - low
    cells = float(np.clip(32 * len(edges), 1024, 2**17))
    side = max(np.sqrt(extent.prod() / cells), extent.max() / 8192.0)
    nx, ny = np.maximum(1, np.ceil(extent / side).astype(np.int64)).tolist()
    first, items = _fill(edges, low[0], low[1], side, nx, ny)
    grid = np.array([[low[0], low[1], 1.0 / side]])
    shape = np.array([[nx, ny, 0, 0]], dtype=np.int64)
    size = np.empty((len(edges), BINS))
    _touching_balls(edges, grid, shape, first, items, size)
    _gaps_at_vertices(edges, following, size)
    return Nearest(edges, size, grid, shape, first, items)


def join(parts: list[Nearest]) -> Nearest:
    """Several polygons behind one another.

    Parameters
    ----------
    parts : list of Nearest
        One polygon each.
    """
    cells = np.cumsum([0] + [len(p.first) for p in parts])
    edges = np.cumsum([0] + [len(p.edges) for p in parts])
    items = np.cumsum([0] + [len(p.items) for p in parts])
    return Nearest(
        np.concatenate([p.edges for p in parts]),
        np.concatenate([p.size for p in parts]),
        np.concatenate([p.grid for p in parts]),
        np.concatenate(
            [p.shape + np.array([0, 0, c, e]) for p, c, e in zip(parts, cells[:-1], edges[:-1], strict=True)]
        ),
        np.concatenate([p.first + i for p, i in zip(parts, items[:-1], strict=True)]),
        np.concatenate([p.items + np.int32(e) for p, e in zip(parts, edges[:-1], strict=True)]),
    )
