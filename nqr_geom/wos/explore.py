"""Walks with the boundary they see, compiled: nothing of them is kept but closest points.

A walk may be directed towards boundary that earlier walks of the query have not met (`WalkSpread`). It ends within the
rim, where what it would still see lies in one place as the query sees it: well before the epsilon shell.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.integrator.samplers import BELOW_ONE
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows
from nqr_geom.streams import Stream
from nqr_geom.wos.nearest import BINS, nearest, nearest_of_all

if TYPE_CHECKING:
    from nqr_geom.wos.problems import LaplaceProblem
    from nqr_geom.wos.spread import WalkSpread

__all__ = ["AVOID", "UNIFORM", "directions", "explored", "space_for", "spread_directions", "table_of"]

Floats = NDArray[np.float64]

AVOID = 4  # power of 1 + the number of ends, or of starts, in a direction
UNIFORM = 4  # the first of so many walks is uniform
NUMBERS = 6  # numbers of a point that was seen

_TURN = 2.0 * math.pi
_SMALL, _LARGE = 1e-2, 1e2  # a landing place's distance from an end counts between these, in radii

# Angles in turns by an odd polynomial on [0, 1], to 2e-6: which sector an end lies in asks for no more.
_A1, _A3, _A5, _A7, _A9 = 0.15913366875, -0.05256963747, 0.02867323149, -0.01355303552, 0.00331759303

_inline = njit(inline="always", error_model="numpy")
# Sums may be taken in any order and no number is NaN: loops over ends and sectors fill vector registers.
_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nnan", "nsz"})


def table_of(bins: int) -> Floats:
    """Cosines and sines of the middles of equal sectors, (2, bins)."""
    middle = _TURN * (np.arange(bins) + 0.5) / bins
    return np.stack([np.cos(middle), np.sin(middle)])


@_inline
def _turns(x, y):  # type: ignore[no-untyped-def]
    """The direction of (x, y) in turns, between -1/2 and 1/2."""
    a, b = abs(x), abs(y)
    low, high = (a, b) if a < b else (b, a)
    r = low / (high + 1e-300)
    s = r * r
    t = r * (_A1 + s * (_A3 + s * (_A5 + s * (_A7 + s * _A9))))
    t = 0.25 - t if b > a else t
    t = 0.5 - t if x < 0.0 else t
    return -t if y < 0.0 else t


@_inline
def _land(radius, ux, uy, cosines, sines, xs, ys, occupied, near):  # type: ignore[no-untyped-def]
    """Where steps along the middles of the sectors land, the first sector at (ux, uy); no end is met yet."""
    vx, vy = radius * ux, radius * uy
    for b in range(len(near)):
        xs[b], ys[b] = vx * cosines[b] - vy * sines[b], vy * cosines[b] + vx * sines[b]
        occupied[b], near[b] = 0.0, 1e300


@_kernel
def _meet(px, py, ux, uy, ends_x, ends_y, low, high, at, xs, ys, occupied, near):  # type: ignore[no-untyped-def]
    """Count the ends low .. high in sectors and into the squared distances of the nearest ones from landing places."""
    bins = len(near)
    for k in range(low, high):
        dx, dy = ends_x[k] - px, ends_y[k] - py
        at[k] = _turns(ux * dx + uy * dy, ux * dy - uy * dx) * bins + (bins - 0.5)  # in sectors, and above zero
    for k in range(low, high):
        below = int(at[k])
        part = at[k] - below
        below = below - bins if below >= bins else below
        above = below + 1 if below + 1 < bins else 0
        occupied[below] += 1.0 - part
        occupied[above] += part
    for k in range(low, high):
        ex, ey = ends_x[k] - px, ends_y[k] - py
        for b in range(bins):
            dx, dy = ex - xs[b], ey - ys[b]
            square = dx * dx + dy * dy
            near[b] = square if square < near[b] else near[b]


@_inline
def _in_radii(square, inverse):  # type: ignore[no-untyped-def]
    """A squared distance as what it counts, in radii."""
    return min(max(math.sqrt(square) * inverse, _SMALL), _LARGE)


@_kernel
def directions(px, py, radius, ux, uy, ends, count, table, occupied, near):  # type: ignore[no-untyped-def]
    """What the first `count` ends (2, n) say of equal sectors of directions from (px, py), the first at (ux, uy).

    Writes how many ends lie in each sector, an end between two middles shared by both, and how far the nearest end is
    from where a step along the middle lands, in radii (the same everywhere where there is no end). `table` comes from
    `table_of`.
    """
    at, xs, ys = np.empty(ends.shape[1]), np.empty(len(near)), np.empty(len(near))
    _land(radius, ux, uy, table[0], table[1], xs, ys, occupied, near)
    _meet(px, py, ux, uy, ends[0], ends[1], 0, count, at, xs, ys, occupied, near)
    for b in range(len(near)):
        near[b] = _in_radii(near[b], 1.0 / radius)


@_inline
def _weigh(occupied, near, started, inverse, worth):  # type: ignore[no-untyped-def]
    """What each sector is worth; the sum."""
    total = 0.0
    for b in range(len(worth)):
        around = (1.0 + occupied[b]) * (1.0 + started[b])
        around *= around
        worth[b] = _in_radii(near[b], inverse) / (around * around)
        total += worth[b]
    return total


@njit(nogil=True, error_model="numpy", cache=True)
def space_for(n, bins):  # type: ignore[no-untyped-def]
    """Room for `explored`: of n ends three numbers, of the sectors of a walk six and of those of the query five."""
    ends, walk, query = np.empty((3, n)), np.empty((6, bins)), np.empty((5, bins))
    return (
        ends[0], ends[1], ends[2], walk[0], walk[1], walk[2], walk[3], walk[4], walk[5],
        query[0], query[1], query[2], query[3], query[4],
    )  # fmt: skip


@_kernel
def explored(  # type: ignore[no-untyped-def]
    edges, size, grid, shape, first, items, arc, linear, s, qx, qy, epsilon, rim, x, key, spread, floor, smallest,
    table, space, chosen, density, seen,
):  # fmt: skip
    """Walk from one query, every walk until it comes within the rim.

    Parameters
    ----------
    edges, ..., items : arrays
        `Nearest`.
    arc, linear : (E, 2) float64
        Arc length at the start of each edge and its length; boundary values at its ends.
    s : int
        Polygon.
    qx, qy : float
        Query.
    epsilon, rim : float
        A walk ends in the shell of the one, or where the boundary is nearer than the other times the distance of the
        closest point from the query.
    x : (n, D) float64
        Turns of the steps; where a walk is directed, uniform numbers that decide, replaced by turns if `chosen`.
    key : uint64
        Of the query's other numbers.
    spread : bool
        Whether walks are directed; else the next three say nothing.
    floor, smallest, table
        See `WalkSpread` and `table_of`.
    space : tuple of arrays
        See `space_for`.
    chosen : bool
        Whether turns are asked for.
    density : (n,) float64
        Result: density of each walk given those before it.
    seen : (n * (D + 1), 6) float64
        Result: arc length, x and y from the query, value, and the way there (zeros where it is not known).

    Returns
    -------
    count, steps, capped : int
        Points seen, steps made, and walks that ran out of steps.
    """
    n, most = x.shape
    ends_x, ends_y, at, xs, ys, occupied, near, worth, none, home_xs, home_ys, home_occupied, home_near, started = space
    bins = len(worth)
    cosines, sines = table[0], table[1]
    started[:], none[:] = 0.0, 0.0
    count, steps, capped = 0, 0, 0
    begin, begin_at, begin_square = nearest(edges, grid, shape, first, items, s, qx, qy)
    if begin < 0:
        begin, begin_at, begin_square = nearest_of_all(edges, shape, s, qx, qy)
    known = 0  # ends that the sectors of the query tell of
    for w in range(n):
        px, py = qx, qy
        directed, own = spread and w % UNIFORM != 0, mixed(key, w)
        likely, reach = 1.0, 0.0
        for j in range(most + 1):
            e, where, square = begin, begin_at, begin_square
            if j > 0:
                e, where, square = nearest(edges, grid, shape, first, items, s, px, py)
                if e < 0:
                    e, where, square = nearest_of_all(edges, shape, s, px, py)
            cx, cy = edges[e, 0] + where * edges[e, 2], edges[e, 1] + where * edges[e, 3]
            radius = math.sqrt(square)
            fx, fy = cx - qx, cy - qy
            one = seen[count]
            one[0], one[1], one[2] = arc[e, 0] + where * arc[e, 1], fx, fy
            a, b = linear[e, 0], linear[e, 1]
            one[3] = a if a == b else a * (1.0 - where) + b * where
            count += j > 0 or w == 0  # all walks begin with the same point
            inside = radius > max(epsilon * size[e, min(int(where * BINS), BINS - 1)], 1e-14)
            if j == most or not inside:
                one[4] = one[5] = 0.0
                capped += inside
                break
            ax, ay = cx - px, cy - py
            one[4], one[5] = ax, ay
            if radius <= rim * math.sqrt(fx * fx + fy * fy):
                break
            steps += 1
            if j == 0:
                reach = smallest * radius
            if directed and radius >= reach:
                ux, uy = ax / radius, ay / radius
                if j == 0:  # from where all walks begin the ends that were met before are known
                    if known == 0:
                        _land(radius, ux, uy, cosines, sines, home_xs, home_ys, home_occupied, home_near)
                    _meet(
                        px, py, ux, uy, ends_x, ends_y, known, w, at, home_xs, home_ys, home_occupied, home_near
                    )  # fmt: skip
                    known = w
                    total = _weigh(home_occupied, home_near, started, 1.0 / radius, worth)
                else:
                    _land(radius, ux, uy, cosines, sines, xs, ys, occupied, near)
                    _meet(px, py, ux, uy, ends_x, ends_y, 0, w, at, xs, ys, occupied, near)
                    total = _weigh(occupied, near, none, 1.0 / radius, worth)
                # One number decides whether the direction is uniform and, if it is not, for a sector.
                u, place = x[w, j], unit(mixed(own, most + j))
                if u < floor:
                    b = min(int(place * bins), bins - 1)
                    place = place * bins - b
                else:
                    level, b = total * (u - floor) / (1.0 - floor), 0
                    while b < bins - 1 and level >= worth[b]:
                        level -= worth[b]
                        b += 1
                if j == 0:
                    started[b] += 1.0
                likely *= floor + (1.0 - floor) * bins * worth[b] / total
                angle = _TURN * ((b + place) / bins)
                c, h = math.cos(angle), math.sin(angle)
                hx, hy = ux * c - uy * h, uy * c + ux * h
                if chosen:
                    turn = math.atan2(hy, hx) / _TURN
                    x[w, j] = min(turn - math.floor(turn), BELOW_ONE)
            else:
                angle = _TURN * x[w, j]
                hx, hy = math.cos(angle), math.sin(angle)
                if spread and j == 0:
                    b = int((_turns(ax * hx + ay * hy, ax * hy - ay * hx) + 1.0) * bins)
                    started[b - bins if b >= bins else b] += 1.0
            px, py = px + radius * hx, py + radius * hy
        ends_x[w], ends_y[w] = cx, cy
        density[w] = likely
    return count, steps, capped


@_kernel
def _spread_rows(  # type: ignore[no-untyped-def]
    edges, size, grid, shape, first, items, arc, of, start, rows, epsilon, rim, key, floor, smallest, table, low, high,
    x, density,
):  # fmt: skip
    n, most = x.shape[1], x.shape[2]
    space, seen = space_for(n, table.shape[1]), np.empty((n * (most + 1), NUMBERS))
    linear = np.zeros((len(edges), 2))  # values are not asked for
    for i in range(low, high):
        own = mixed(key, rows[i])
        for w in range(n):
            walk = mixed(own, w)
            for j in range(most):
                x[i, w, j] = unit(mixed(walk, j))
        explored(
            edges, size, grid, shape, first, items, arc, linear, of[i], start[i, 0], start[i, 1], epsilon, rim, x[i],
            own, True, floor, smallest, table, space, True, density[i], seen,
        )  # fmt: skip


def spread_directions(problem: LaplaceProblem, sampler: WalkSpread, n: int, stream: Stream) -> tuple[Floats, Floats]:
    """Turns (B, n, D) of all steps and densities (B, n) of the walks that a sampler makes."""
    x, density = np.empty((problem.batch, n, problem.dim)), np.empty((problem.batch, n))
    start, rows = (np.ascontiguousarray(t.numpy()) for t in (problem.points, problem.rows))
    walks: tuple[Any, ...] = (*problem.geometry, problem.arcs, problem.outline, start, rows, problem.epsilon)
    how = (sampler.rim, unsigned(stream.key), sampler.floor, sampler.smallest, table_of(sampler.bins))
    kernel: Any = _spread_rows
    over_rows(lambda i, j: kernel(*walks, *how, i, j, x, density), problem.batch)
    return x, density
