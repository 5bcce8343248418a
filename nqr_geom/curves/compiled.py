"""Sampler and rule in one compiled pass, for winding numbers of polynomial pieces on a CPU.

Each by itself, too, for points that a callable gave.

The same points, the same formulas and the same answer (to rounding) as `samplers`, `structured` and `hermite`, which
stay the reference: what is compiled here is what error-against-time charts must not be unfair to.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows, with_term

__all__ = ["placed", "refined", "sampled", "winding"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A division by zero gives infinity, as everywhere else, and does not raise.
_inline = njit(inline="always", error_model="numpy")
_function = njit(error_model="numpy")
_kernel = njit(cache=True, nogil=True, error_model="numpy")

_TINY = 1e-280
_QUADRATIC = 1e-9
_LEVELS = 60
_STEP = 2.0**-52


@_inline
def _locate(s, k):
    """Piece and local parameter, as `shapes.locate`."""
    u = s * k
    joint = np.rint(u)
    if abs(u - joint) <= _STEP * joint:
        u = joint
    piece = min(np.int64(u), k - 1)
    return piece, min(max(u - piece, 0.0), 1.0)


@_inline
def _at(c, k, s):
    """Position, tangent dx/ds and piece at s of a shape with coefficients c (K, 4, 2)."""
    piece, t = _locate(s, k)
    p = c[piece]
    x = p[0, 0] + t * (p[1, 0] + t * (p[2, 0] + t * p[3, 0]))
    y = p[0, 1] + t * (p[1, 1] + t * (p[2, 1] + t * p[3, 1]))
    tx = k * (p[1, 0] + t * (2.0 * p[2, 0] + t * (3.0 * p[3, 0])))
    ty = k * (p[1, 1] + t * (2.0 * p[2, 1] + t * (3.0 * p[3, 1])))
    return x, y, tx, ty, piece


@_kernel
def _sample_rows(coefficients, pieces, shape, points, rows, key, n, jittered, moments, start, stop):
    for b in range(start, stop):
        c, k = coefficients[shape[b]], pieces[shape[b]]
        px, py = points[b, 0], points[b, 1]
        row = mixed(key, rows[b])
        total, squares, cubes, fourths = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            s = unit(mixed(mixed(row, i), 0))
            if jittered:
                s = (i + s) / n
            x, y, tx, ty, _ = _at(c, k, s)
            x -= px
            y -= py
            f = (x * ty - y * tx) / (2.0 * math.pi * max(x * x + y * y, _TINY))
            total, squares, cubes, fourths = with_term(f, i, total, squares, cubes, fourths)
        moments[0, b], moments[1, b], moments[2, b], moments[3, b] = total, squares, cubes, fourths


def sampled(
    coefficients: Floats, pieces: Ints, shape: Ints, points: Floats, rows: Ints, key: int, n: int, jittered: bool
) -> Floats:
    """Plain Monte Carlo on random or jittered points: the mean, and sums of powers 2 to 4 of the deviations, (4, B).

    Parameters
    ----------
    coefficients : ndarray, (S, K, 4, 2)
        Power basis of the pieces of all shapes.
    pieces, shape, rows : ndarray, (S,), (B,), (B,), int64
        Pieces of each shape; shape and global row of each query.
    points : ndarray, (B, 2)
        Queries.
    key : int
        Of the stream, see `Stream.key`.
    n : int
        Samples a query.
    jittered : bool
        One sample in each of n equal cells.
    """
    moments = np.empty((4, len(points)))
    fixed = (coefficients, pieces, shape, points, rows, unsigned(key), n, jittered, moments)
    over_rows(lambda start, stop: _sample_rows(*fixed, start, stop), len(points))
    return moments


@_inline
def _norm(x, y):
    """Length of a vector, fast where no square is out of range."""
    most = max(abs(x), abs(y))
    return math.sqrt(x * x + y * y) if 1e-140 < most < 1e140 else math.hypot(x, y)


@_inline
def _miss(s0, s1, s, a, b, m, r, t):
    """Errors of the cubics left and right of sample m, from how far the one from a to b missed it."""
    h = s1 - s0
    v = (s - s0) / h
    w = 1.0 - v
    p, q = (1.0 + 2.0 * v) * w * w, v * v * (1.0 + 2.0 * w)
    g = v * w * h
    dx = p * r[a, 0] + q * r[b, 0] + g * (w * t[a, 0] - v * t[b, 0]) - r[m, 0]
    dy = p * r[a, 1] + q * r[b, 1] + g * (w * t[a, 1] - v * t[b, 1]) - r[m, 1]
    miss = math.sqrt(dx * dx + dy * dy) / 4.0
    return miss * (v / w) ** 2, miss * (w / v) ** 2


@_inline
def _gain(s0, s1, a, b, error, r, t):
    """What a cut of a gap may gain: its error against the distance of its ends and middle from the query."""
    h = (s1 - s0) / 8.0
    mx = 0.5 * (r[a, 0] + r[b, 0]) + h * (t[a, 0] - t[b, 0])
    my = 0.5 * (r[a, 1] + r[b, 1]) + h * (t[a, 1] - t[b, 1])
    near = min(r[a, 0] ** 2 + r[a, 1] ** 2, r[b, 0] ** 2 + r[b, 1] ** 2, mx * mx + my * my)
    dx, dy = r[b, 0] - r[a, 0], r[b, 1] - r[a, 1]
    slack = error + 1e-9 * math.sqrt(dx * dx + dy * dy)
    return slack / max(math.sqrt(near) + slack, 1e-300)


@_inline
def _open(j, s, r, t, left, right, gain):
    """The gap between both ends of piece j: nothing is known of it, so its error is its whole size."""
    a, b = 2 * j, 2 * j + 1
    left[j], right[j] = a, b
    length = 0.5 * (_norm(t[a, 0], t[a, 1]) + _norm(t[b, 0], t[b, 1])) * (s[b] - s[a])
    gain[j] = _gain(s[a], s[b], a, b, length, r, t)


@_inline
def _choose(row, i, used, spread, s, left, right, gain):
    """The gap that matters most, and where sample i cuts it."""
    chosen = 0
    for g in range(1, used):
        if gain[g] > gain[chosen]:
            chosen = g
    cut = 0.5 + spread * (unit(mixed(row, i)) - 0.5)
    return chosen, s[left[chosen]] * (1.0 - cut) + s[right[chosen]] * cut


@_inline
def _cut(chosen, i, used, s, r, t, left, right, gain):
    """The chosen gap becomes the one before sample i, and the one behind it is new."""
    a, b = left[chosen], right[chosen]
    before, after = _miss(s[a], s[b], s[i], a, b, i, r, t)
    left[chosen], right[chosen], left[used], right[used] = a, i, i, b
    gain[chosen] = _gain(s[a], s[i], a, i, before, r, t)
    gain[used] = _gain(s[i], s[b], i, b, after, r, t)


@_function
def _place(c, k, px, py, row, n, spread, end, s, r, t, piece, left, right, gain):
    """Ends, then the gap that matters most again and again: fills s, r, t, piece (n, ...)."""
    for j in range(k):
        for e in range(2):
            i = 2 * j + e
            s[i] = (j + e * (1.0 - end)) / k
            x, y, t[i, 0], t[i, 1], piece[i] = _at(c, k, s[i])
            r[i, 0], r[i, 1] = x - px, y - py
        if n > 2 * k:
            _open(j, s, r, t, left, right, gain)
    for i in range(2 * k, n):
        used = i - k
        chosen, s[i] = _choose(row, i, used, spread, s, left, right, gain)
        x, y, t[i, 0], t[i, 1], piece[i] = _at(c, k, s[i])
        r[i, 0], r[i, 1] = x - px, y - py
        _cut(chosen, i, used, s, r, t, left, right, gain)


@_function
def _sort(s, order):
    """Order of s: by insertion where that is the shortest way, keeping equal ones as they are."""
    n = len(s)
    if n > 64:
        order[:] = np.argsort(s, kind="mergesort")
        return
    for i in range(n):
        j = i
        while j > 0 and s[order[j - 1]] > s[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i


@_inline
def _turn(x0, y0, x3, y3):
    """How often the shorter way from one point to the other around the origin crosses the negative x axis, signed."""
    up0, up3 = y0 >= 0.0, y3 >= 0.0
    if up0 == up3:
        return 0
    cross = x0 * y3 - y0 * x3
    if up0:
        return 1 if cross > 0.0 else 0
    return -1 if cross < 0.0 else 0


@_function
def _between(x0, y0, x1, y1):
    """The angle of one point minus that of another, each in (-pi, pi]; without arc tangents where they are close."""
    cross, dot = x0 * y1 - y0 * x1, x0 * x1 + y0 * y1
    size = abs(cross) + abs(dot)
    if not 1e-280 < size < 1e280 or (cross == 0.0 and dot < 0.0):
        return math.atan2(y1 + 0.0, x1) - math.atan2(y0 + 0.0, x0)
    if abs(cross) < 1e-4 * dot:
        tangent = cross / dot
        square = tangent * tangent
        short = tangent * (1.0 - square * (1.0 / 3.0 - 0.2 * square))
    else:
        short = math.atan2(cross, dot)
    return short - 2.0 * math.pi * _turn(x0, y0, x1, y1)


@_inline
def _holds(q):
    """Whether the box of a cubic's control points holds the origin, and the box's longer side."""
    x0, y0, x1, y1, x2, y2, x3, y3 = q
    xl, xh = min(min(x0, x1), min(x2, x3)), max(max(x0, x1), max(x2, x3))
    yl, yh = min(min(y0, y1), min(y2, y3)), max(max(y0, y1), max(y2, y3))
    return xl <= 0.0 and xh >= 0.0 and yl <= 0.0 and yh >= 0.0, max(xh - xl, yh - yl)


@_inline
def _halves(q):
    """Control points of both halves of a cubic."""
    x0, y0, x1, y1, x2, y2, x3, y3 = q
    ax, ay, bx, by = (x0 + x1) / 2.0, (y0 + y1) / 2.0, (x1 + x2) / 2.0, (y1 + y2) / 2.0
    cx, cy = (x2 + x3) / 2.0, (y2 + y3) / 2.0
    dx, dy, ex, ey = (ax + bx) / 2.0, (ay + by) / 2.0, (bx + cx) / 2.0, (by + cy) / 2.0
    mx, my = (dx + ex) / 2.0, (dy + ey) / 2.0
    return (x0, y0, ax, ay, dx, dy, mx, my), (mx, my, ex, ey, cx, cy, x3, y3)


@_function
def _descend(q, error, stack, levels):
    """Signed crossings of a cubic whose box holds the origin, by halving, and whether its side is in doubt."""
    turns, doubtful = 0, False
    stack[0] = q
    levels[0] = 0
    top = 1
    while top > 0:
        top -= 1
        x0, y0, x1, y1, x2, y2, x3, y3 = stack[top]
        level = levels[top]
        holds, extent = _holds((x0, y0, x1, y1, x2, y2, x3, y3))
        small = holds and (extent <= error or level == _LEVELS)
        if small or not holds:
            doubtful |= small
            turns += _turn(x0, y0, x3, y3)
            continue
        stack[top], stack[top + 1] = _halves((x0, y0, x1, y1, x2, y2, x3, y3))
        levels[top] = levels[top + 1] = level + 1
        top += 2
    return turns, doubtful


@_inline
def _terms(r0, r1, t0, t1, rate):
    """Coefficients c2 and c3 of one coordinate of the cubic through a neighbour at signed distance 1 / `rate`."""
    mean = (r1 - r0) * rate
    return (3.0 * mean - 2.0 * t0 - t1) * rate, (t0 + t1 - 2.0 * mean) * rate * rate


@_function
def _reach(s, r, t, i, j, to):
    """Bezier control points between sample i and the end `to` of its piece, by the cubic through sample j (or none).

    Written from i outwards.
    """
    u = to - s[i]
    gap = s[j] - s[i] if j >= 0 else 0.0
    c2x = c2y = c3x = c3y = 0.0
    if abs(u) > 1e-9 * abs(gap) and j >= 0:  # nearer, bends are below rounding
        rate = 1.0 / gap
        c2x, c3x = _terms(r[i, 0], r[j, 0], t[i, 0], t[j, 0], rate)
        c2y, c3y = _terms(r[i, 1], r[j, 1], t[i, 1], t[j, 1], rate)
        pace = _norm(t[i, 0], t[i, 1]) + _norm(t[j, 0], t[j, 1])
        quadratic = _norm(c3x, c3y) * gap * gap <= _QUADRATIC * pace
        far = abs(u * rate)
        if quadratic or far > 1.0:
            c3x = c3y = 0.0
        if not quadratic and far > 3.0:
            c2x = c2y = 0.0
    ex = r[i, 0] + u * (t[i, 0] + u * (c2x + u * c3x))
    ey = r[i, 1] + u * (t[i, 1] + u * (c2y + u * c3y))
    sx = t[i, 0] + u * (2.0 * c2x + u * (3.0 * c3x))
    sy = t[i, 1] + u * (2.0 * c2y + u * (3.0 * c3y))
    third = u * (1.0 / 3.0)
    return (
        r[i, 0], r[i, 1], r[i, 0] + third * t[i, 0], r[i, 1] + third * t[i, 1],
        ex - third * sx, ey - third * sy, ex, ey,
    )  # fmt: skip


@_inline
def _through(s, r, t, i, j):
    """Bezier control points of the cubic from sample i to sample j."""
    third = (s[j] - s[i]) / 3.0
    return (
        r[i, 0], r[i, 1], r[i, 0] + third * t[i, 0], r[i, 1] + third * t[i, 1],
        r[j, 0] - third * t[j, 0], r[j, 1] - third * t[j, 1], r[j, 0], r[j, 1],
    )  # fmt: skip


@_function
def _gap_error(s, r, t, piece, order, g):
    """Estimated distance of the true curve from the cubic in gap g of a piece: `hermite._errors`."""
    n = len(s)
    a, b = order[g], order[g + 1]
    error = -1.0
    if g > 0 and piece[order[g - 1]] == piece[a] and s[a] > s[order[g - 1]]:
        z = order[g - 1]
        error = _miss(s[z], s[b], s[a], z, b, a, r, t)[1]
    if g + 2 < n and piece[order[g + 2]] == piece[b] and s[order[g + 2]] > s[b]:
        z = order[g + 2]
        error = max(error, _miss(s[a], s[z], s[b], a, z, b, r, t)[0])
    if error >= 0.0:
        return error
    gap = s[b] - s[a]
    rate = 1.0 / gap
    cx, cy = _terms(r[a, 0], r[b, 0], t[a, 0], t[b, 0], rate)[1], _terms(r[a, 1], r[b, 1], t[a, 1], t[b, 1], rate)[1]
    cubic = math.hypot(cx, cy) * gap * gap
    pace = math.hypot(t[a, 0], t[a, 1]) + math.hypot(t[b, 0], t[b, 1])
    return cubic * gap / 4.0 if cubic > _QUADRATIC * pace else 0.0


@_function
def _rebuilt(s, r, t, piece, k, order, stack, levels):
    """Winding number of the rebuilt curve and whether it is in doubt: `hermite.reconstruct` and `hermite.winding`.

    From one end of a piece to the other the angles add up to the difference of the ends' directions and whole turns,
    which are counted where the negative x axis is crossed.
    """
    n = len(s)
    total, turns, seen, run, doubtful = 0.0, 0, 0, 0, False
    start_x, start_y, end_x, end_y = 0.0, 0.0, 0.0, 0.0
    for g in range(n):
        i = order[g]
        first = g == 0 or piece[order[g - 1]] != piece[i]
        last = g == n - 1 or piece[order[g + 1]] != piece[i]
        after = not last and s[order[g + 1]] > s[i]
        if first:
            run, low = 0, piece[i] / k
            x, y = r[i, 0], r[i, 1]
            if s[i] > low:
                q = _reach(s, r, t, i, order[g + 1] if after else -1, low)
                x, y = q[6], q[7]
                if _holds(q)[0]:
                    error = math.hypot(t[i, 0], t[i, 1]) * (s[i] - low)
                    count, doubt = _descend(q, _gap_error(s, r, t, piece, order, g) if after else error, stack, levels)
                    turns -= count
                    doubtful |= doubt
                else:
                    turns += _turn(x, y, r[i, 0], r[i, 1])
            # Where a piece ends the next one begins, if both are seen and the curve has no gap there.
            if g > 0:
                total += _between(x, y, end_x, end_y)
            else:
                start_x, start_y = x, y
        run += 1
        if after:
            j = order[g + 1]
            q = _through(s, r, t, i, j)
            if _holds(q)[0]:
                count, doubt = _descend(q, _gap_error(s, r, t, piece, order, g), stack, levels)
                turns += count
                doubtful |= doubt
            else:
                turns += _turn(q[0], q[1], q[6], q[7])
        if last:
            high = (piece[i] + 1) / k
            x, y = r[i, 0], r[i, 1]
            if s[i] < high:
                before = not first and s[i] > s[order[g - 1]]
                q = _reach(s, r, t, i, order[g - 1] if before else -1, high)
                x, y = q[6], q[7]
                if _holds(q)[0]:
                    error = math.hypot(t[i, 0], t[i, 1]) * (high - s[i])
                    before_error = _gap_error(s, r, t, piece, order, g - 1) if before else error
                    count, doubt = _descend(q, before_error, stack, levels)
                    turns += count
                    doubtful |= doubt
                else:
                    turns += _turn(r[i, 0], r[i, 1], x, y)
            end_x, end_y = x, y
            seen += run >= 2
    total += _between(start_x, start_y, end_x, end_y)
    return total / (2.0 * math.pi) + turns, doubtful or seen < k


@_kernel
def _refine_rows(coefficients, pieces, shape, points, rows, key, n, spread, end, value, doubtful, start, stop):
    s, r, t = np.empty(n), np.empty((n, 2)), np.empty((n, 2))
    piece, left, right = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    gain, order = np.empty(n), np.empty(n, np.int64)
    stack, levels = np.empty((2 * _LEVELS + 4, 8)), np.empty(2 * _LEVELS + 4, np.int64)
    for b in range(start, stop):
        c, k = coefficients[shape[b]], pieces[shape[b]]
        row = mixed(key, rows[b])
        _place(
            c, k, points[b, 0], points[b, 1], row, n, spread, end,
            s, r, t, piece, left, right, gain,
        )  # fmt: skip
        _sort(s, order)
        value[b], doubtful[b] = _rebuilt(s, r, t, piece, k, order, stack, levels)


def refined(
    coefficients: Floats,
    pieces: Ints,
    shape: Ints,
    points: Floats,
    rows: Ints,
    key: int,
    n: int,
    spread: float,
    end: float,
) -> tuple[Floats, NDArray[np.bool_]]:
    """`CurveRefine` and `GwnHermite` together: winding number (B,) and which are in doubt (B,).

    Parameters are those of `sampled`, and `spread` and `end` those of the sampler. Every shape must have at most
    n / 2 pieces.
    """
    value, doubtful = np.empty(len(points)), np.empty(len(points), dtype=np.bool_)
    fixed = (coefficients, pieces, shape, points, rows, unsigned(key), n, spread, end, value, doubtful)
    over_rows(lambda start, stop: _refine_rows(*fixed, start, stop), len(points))
    return value, doubtful


@_kernel
def _seen_rows(s, r, t, piece, pieces, value, doubtful, start, stop):
    n = s.shape[1]
    order, stack, levels = np.empty(n, np.int64), np.empty((2 * _LEVELS + 4, 8)), np.empty(2 * _LEVELS + 4, np.int64)
    for b in range(start, stop):
        _sort(s[b], order)
        value[b], doubtful[b] = _rebuilt(s[b], r[b], t[b], piece[b], pieces[b], order, stack, levels)


def winding(s: Floats, r: Floats, t: Floats, piece: Ints, pieces: Ints) -> tuple[Floats, NDArray[np.bool_]]:
    """`GwnHermite` on samples that are there: winding number (B,) and which are in doubt (B,).

    Parameters
    ----------
    s : ndarray, (B, N)
        Parameters of the samples, in any order.
    r, t : ndarray, (B, N, 2)
        Position minus the query, and dx/ds.
    piece : ndarray, (B, N), int64
        Piece that each sample lies on.
    pieces : ndarray, (B,), int64
        How many there are.
    """
    value, doubtful = np.empty(len(s)), np.empty(len(s), dtype=np.bool_)
    over_rows(lambda start, stop: _seen_rows(s, r, t, piece, pieces, value, doubtful, start, stop), len(s))
    return value, doubtful


@_kernel
def _next_rows(rows, key, k, i, spread, s, r, t, left, right, gain, chosen):
    """Open the gaps of every row, or cut those chosen before, and choose where sample i goes."""
    for b in range(len(s)):
        if i == 2 * k:
            for j in range(k):
                _open(j, s[b], r[b], t[b], left[b], right[b], gain[b])
        else:
            _cut(chosen[b], i - 1, i - 1 - k, s[b], r[b], t[b], left[b], right[b], gain[b])
        chosen[b], s[b, i] = _choose(mixed(key, rows[b]), i, i - k, spread, s[b], left[b], right[b], gain[b])


def placed(
    look: Callable[[Floats], tuple[Floats, Floats, Ints]],
    points: Floats,
    rows: Ints,
    key: int,
    k: int,
    n: int,
    spread: float,
    end: float,
) -> tuple[Floats, Floats, Floats, Ints]:
    """The samples of `CurveRefine` on curves that only tell points, asked for a sample of every query at a time.

    Parameters
    ----------
    look : callable
        s (B, m) to positions and dx/ds (B, m, 2) and pieces (B, m).
    points, rows, key, n, spread, end
        As for `refined`.
    k : int
        Pieces of every curve, at most n / 2.

    Returns
    -------
    s, position, tangent, piece : ndarray, (B, n), (B, n, 2) twice, (B, n)
    """
    batch, keyed = len(points), unsigned(key)
    s, gain = np.empty((batch, n)), np.empty((batch, n))
    position, r, t = (np.empty((batch, n, 2)) for _ in range(3))
    piece, left, right = (np.empty((batch, n), np.int64) for _ in range(3))
    chosen = np.empty(batch, np.int64)
    pair = np.array([0.0, 1.0 - end])
    s[:, : 2 * k] = ((np.arange(k)[:, None] + pair) / k).ravel()
    asked = slice(0, 2 * k)
    for i in range(2 * k, n + 1):
        position[:, asked], t[:, asked], piece[:, asked] = look(s[:, asked])
        np.subtract(position[:, asked], points[:, None], out=r[:, asked])
        if i < n:
            _next_rows(rows, keyed, k, i, spread, s, r, t, left, right, gain, chosen)
            asked = slice(i, i + 1)
    return s, position, t, piece
