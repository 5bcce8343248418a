"""All steps of many walks in one compiled pass, with what every walk saw on its way."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.rows import over_rows
from nqr_geom.wos.nearest import BINS, Nearest, nearest, nearest_of_all

__all__ = ["ALIVE", "SEEN", "VALUE", "Record", "record"]

Floats = NDArray[np.float64]

# What a walk sees before a step, in this order; lengths in the domain's frame.
SEEN = {"closest": 2, "distance": 1, "arc_length": 1, "boundary_value": 1, "from_start": 2, "angle": 2, "alive": 1}
VALUE, ALIVE = 4, 9  # columns of the boundary value and of whether there was a step at all

_TURN = 2.0 * math.pi


class Record(NamedTuple):
    """Walks of at most D steps from B queries, N each.

    Attributes
    ----------
    steps : (B, N, D, 10) float64
        What was seen before each step, zeros once a walk has ended; boundary values are left at zero.
    edge, t : (B, N, D + 1) int64 and float64
        The closest boundary point before each step, then that of the last position; it stays there once a walk ends.
    end : (B, N, 4) float64
        The closest boundary point of the last position relative to the query, its distance and its arc length.
    made : (B, N) int64
        Steps made.
    alive : (B, N) bool
        Not in the epsilon shell yet.
    """

    steps: Floats
    edge: NDArray[np.int64]
    t: Floats
    end: Floats
    made: NDArray[np.int64]
    alive: NDArray[np.bool_]


@njit(cache=True, nogil=True, error_model="numpy")
def _rows(  # type: ignore[no-untyped-def]
    edges, size, grid, shape, first, items, arc, of, start, x, epsilon, low, high, steps, edge, t, end, made, alive
):
    """Walks low .. high of all B times N."""
    n, most = x.shape[1], x.shape[2]
    for k in range(low, high):
        i, w = k // n, k % n
        s = of[i]
        qx, qy = start[i, 0], start[i, 1]
        px, py = qx, qy
        going = True
        for j in range(most + 1):
            e, where, square = nearest(edges, grid, shape, first, items, s, px, py)
            if e < 0:  # off the grid, by rounding: ask all edges
                e, where, square = nearest_of_all(edges, shape, s, px, py)
            cx, cy = edges[e, 0] + where * edges[e, 2], edges[e, 1] + where * edges[e, 3]
            radius = math.sqrt(square)
            length = arc[e, 0] + where * arc[e, 1]
            edge[i, w, j], t[i, w, j] = e, where
            shell = max(epsilon * size[e, min(int(where * BINS), BINS - 1)], 1e-14)
            going = radius > shell
            if not going or j == most:
                end[i, w, 0], end[i, w, 1] = cx - qx, cy - qy
                end[i, w, 2], end[i, w, 3] = radius, length
                for rest in range(j + 1, most + 1):
                    edge[i, w, rest], t[i, w, rest] = e, where
                made[i, w], alive[i, w] = j, going
                break
            seen = steps[i, w, j]
            ax, ay = cx - px, cy - py
            away = math.hypot(ax, ay)
            seen[0], seen[1], seen[2], seen[3] = ax, ay, radius, length
            seen[5], seen[6] = cx - qx, cy - qy
            seen[7], seen[8] = (ax / away, ay / away) if away > 0.0 else (1.0, 0.0)
            seen[9] = 1.0
            turn = _TURN * x[i, w, j]
            px, py = px + radius * math.cos(turn), py + radius * math.sin(turn)


def record(geometry: Nearest, arc: Floats, of: NDArray[np.int64], start: Floats, x: Floats, epsilon: float) -> Record:
    """Walk from every start in the directions that x tells.

    Parameters
    ----------
    geometry : Nearest
        One or several polygons.
    arc : (E, 2) float64
        Arc length at the start of each edge, and its length.
    of, start : (B,) and (B, 2)
        Polygon and position of each query in its frame.
    x : (B, N, D) float64
        Direction of every step in turns.
    epsilon : float
        Width of the shell as a part of the local size.
    """
    x = np.ascontiguousarray(x)
    batch, n, most = x.shape
    steps = np.zeros((batch, n, most, sum(SEEN.values())))
    edge, t = np.empty((batch, n, most + 1), dtype=np.int64), np.empty((batch, n, most + 1))
    end, made = np.empty((batch, n, 4)), np.empty((batch, n), dtype=np.int64)
    alive = np.empty((batch, n), dtype=np.bool_)
    results = Record(steps, edge, t, end, made, alive)
    inputs = (*geometry, arc, of, np.ascontiguousarray(start), x, epsilon)
    over_rows(lambda i, j: _rows(*inputs, i, j, *results), batch * n)
    return results
