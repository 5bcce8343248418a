"""Smoothed distances in one compiled pass, for polynomial pieces on a CPU: plain Monte Carlo and the rebuilt curve.

The same points, formulas and answers (to rounding) as `samplers`, `structured` and `hermite`, which stay the reference.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.curves.compiled import Floats, Ints, _at, _halves, _place, _reach, _sort, _through
from nqr_geom.curves.gauss import BEND, BENT, COUNT, LONGEST, NODES, STRAIGHT, WEIGHTS, exponentials
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows, with_term

__all__ = ["integral", "rebuilt", "sampled"]

_TINY = 1e-280
_SHORTEST = 1e-300
_LEVELS = 60  # as in `hermite`, as all that follows
_UNSEEN = 36.0
_KINK = 1e-5

_inline = njit(inline="always", error_model="numpy")
_function = njit(error_model="numpy")
_kernel = njit(cache=True, nogil=True, error_model="numpy")


@_function
def _points(row, n, jittered, s):  # type: ignore[no-untyped-def]
    """Random points, or one in each of n equal cells."""
    for i in range(n):
        u = unit(mixed(mixed(row, i), 0))
        s[i] = (i + u) / n if jittered else u


@_kernel
def _sample_rows(coefficients, pieces, shape, points, rows, key, n, jittered, alpha, moments, nearest, start, stop):  # type: ignore[no-untyped-def]
    s, distance, speed = np.empty(n), np.empty(n), np.empty(n)
    for b in range(start, stop):
        c, k = coefficients[shape[b]], pieces[shape[b]]
        px, py = points[b, 0], points[b, 1]
        _points(mixed(key, rows[b]), n, jittered, s)
        shift = np.inf
        for i in range(n):
            x, y, tx, ty, _ = _at(c, k, s[i])
            x -= px
            y -= py
            distance[i], speed[i] = math.sqrt(max(x * x + y * y, _TINY)), math.sqrt(tx * tx + ty * ty)
            shift = min(shift, distance[i])
        total, squares, cubes, fourths = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            f = math.exp(-alpha * (distance[i] - shift)) * speed[i]
            total, squares, cubes, fourths = with_term(f, i, total, squares, cubes, fourths)
        moments[0, b], moments[1, b], moments[2, b], moments[3, b] = total, squares, cubes, fourths
        nearest[b] = shift


def sampled(
    coefficients: Floats,
    pieces: Ints,
    shape: Ints,
    points: Floats,
    rows: Ints,
    key: int,
    n: int,
    jittered: bool,
    alpha: float,
) -> tuple[Floats, Floats]:
    """Plain Monte Carlo on random or jittered points: mean and sums of powers 2 to 4 of the deviations, (4, B).

    Parameters are those of `compiled.sampled`, and the sharpness. What is averaged has the distance of the nearest
    sample taken out, which comes too, (B,).
    """
    moments, nearest = np.empty((4, len(points))), np.empty(len(points))
    fixed = (coefficients, pieces, shape, points, rows, unsigned(key), n, jittered, alpha, moments, nearest)
    over_rows(lambda start, stop: _sample_rows(*fixed, start, stop), len(points))
    return moments, nearest


@_inline
def _square(x, y):  # type: ignore[no-untyped-def]
    return x * x + y * y


@_function
def _add(q, alpha, shift, so_far, room):  # type: ignore[no-untyped-def]
    """One cubic's part of the integral: `hermite.log_integral` on a stack.

    `so_far` holds the squared distance of the closest point that has been seen, the largest exponent, and the sum
    over it.
    """
    stack, levels, power, speed, scale, bits = room
    stack[0] = q
    levels[0] = 0
    top = 1
    while top > 0:
        top -= 1
        x0, y0, x1, y1, x2, y2, x3, y3 = stack[top]
        level = levels[top]
        first, last = _square(x0, y0), _square(x3, y3)
        so_far[0] = min(so_far[0], first, last)
        cx, cy = x3 - x0, y3 - y0
        along = min(max(-(x0 * cx + y0 * cy) / max(cx * cx + cy * cy, _SHORTEST), 0.0), 1.0)
        off = math.sqrt(
            max(
                _square(x1 - x0 - cx / 3.0, y1 - y0 - cy / 3.0),
                _square(x2 - x0 - cx * (2.0 / 3.0), y2 - y0 - cy * (2.0 / 3.0)),
            )
        )
        near = max(math.sqrt(_square(x0 + along * cx, y0 + along * cy)) - off, 0.0)
        beyond = near - _UNSEEN / alpha
        if beyond > 0.0 and beyond * beyond >= so_far[0]:
            continue
        ax, ay, bx, by, dx, dy = x1 - x0, y1 - y0, x2 - x1, y2 - y1, x3 - x2, y3 - y2
        a, b, d = _square(ax, ay), _square(bx, by), _square(dx, dy)
        legs = 3.0 * (a + b + d)  # no less than the square of their sum
        if level < _LEVELS - 1 and legs > (_KINK / alpha) ** 2:
            spread = alpha * (math.sqrt(max(first, last)) + off - near)
            farther = 1.0 + max(alpha * (near - shift), 0.0) / (2.0 * COUNT)
            turn = max(_square(bx - ax, by - ay), _square(dx - bx, dy - by))
            even = max(turn, _square(dx - ax, dy - ay)) <= min(a, b, d)
            bend = alpha * (0.125 * legs / max(near, _SHORTEST) + 0.75 * math.sqrt(turn))
            tame = spread <= BENT * farther or spread + BEND * bend <= STRAIGHT * farther
            if not (tame and even and legs <= LONGEST * near * near):
                stack[top + 1], stack[top] = _halves((x0, y0, x1, y1, x2, y2, x3, y3))
                levels[top] = levels[top + 1] = level + 1
                top += 2
                continue
        ax, ay, bx, by, dx, dy = 3.0 * ax, 3.0 * ay, 3.0 * bx, 3.0 * by, 3.0 * dx, 3.0 * dy
        bx, by = bx - ax, by - ay
        dx, dy = (dx - ax) / 3.0 - bx * (2.0 / 3.0), (dy - ay) / 3.0 - by * (2.0 / 3.0)
        for j in range(COUNT):
            u = NODES[j]
            x, y = x0 + u * (ax + u * (bx + u * dx)), y0 + u * (ay + u * (by + u * dy))
            vx, vy = ax + u * (2.0 * bx + u * (3.0 * dx)), ay + u * (2.0 * by + u * (3.0 * dy))
            power[j] = -alpha * (math.sqrt(x * x + y * y) - shift)
            speed[j] = math.sqrt(vx * vx + vy * vy) * WEIGHTS[j]
        most = so_far[1]
        for j in range(COUNT):
            most = max(most, power[j])
        if most > so_far[1]:
            so_far[2] *= math.exp(so_far[1] - most)
            so_far[1] = most
        for j in range(COUNT):
            power[j] -= most
        exponentials(power, scale, bits)
        for j in range(COUNT):
            so_far[2] += power[j] * speed[j]


@_function
def _rooms(n):  # type: ignore[no-untyped-def]
    """Memory that every row uses anew: the order of its samples, and what one cubic needs."""
    stack, levels = np.empty((_LEVELS + 4, 8)), np.empty(_LEVELS + 4, np.int64)
    power, speed, scale = np.empty(COUNT), np.empty(COUNT), np.empty(COUNT)
    return np.empty(n, np.int64), np.empty(3), (stack, levels, power, speed, scale, scale.view(np.int64))


@_function
def _integral(s, r, t, piece, k, alpha, order, so_far, room):  # type: ignore[no-untyped-def]
    """`hermite.reconstruct` and `hermite.log_integral` on one row: exponent, sum, nearest sample, piece unseen."""
    n = len(s)
    _sort(s, order)
    shift = np.inf
    for i in range(n):
        shift = min(shift, math.sqrt(max(r[i, 0] * r[i, 0] + r[i, 1] * r[i, 1], _TINY)))
    so_far[0], so_far[1], so_far[2] = shift * shift, -np.inf, 0.0
    run, seen = 0, 0
    for g in range(n):
        i = order[g]
        first = g == 0 or piece[order[g - 1]] != piece[i]
        last = g == n - 1 or piece[order[g + 1]] != piece[i]
        after = not last and s[order[g + 1]] > s[i]
        low, high = piece[i] / k, (piece[i] + 1) / k
        run = 1 if first else run + 1
        if first and s[i] > low:
            _add(_reach(s, r, t, i, order[g + 1] if after else -1, low), alpha, shift, so_far, room)
        if after:
            _add(_through(s, r, t, i, order[g + 1]), alpha, shift, so_far, room)
        if last:
            if s[i] < high:
                before = not first and s[i] > s[order[g - 1]]
                _add(_reach(s, r, t, i, order[g - 1] if before else -1, high), alpha, shift, so_far, room)
            seen += run >= 2
    return so_far[1], so_far[2], shift, seen < k


@_kernel
def _rebuilt_rows(  # type: ignore[no-untyped-def]
    coefficients, pieces, shape, points, rows, key, n, refine, jittered, spread, end, alpha, exponent, total, nearest,
    missing, start, stop,
):  # fmt: skip
    s, r, t = np.empty(n), np.empty((n, 2)), np.empty((n, 2))
    piece, left, right = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    gain = np.empty(n)
    order, so_far, room = _rooms(n)
    for b in range(start, stop):
        c, k = coefficients[shape[b]], pieces[shape[b]]
        px, py, row = points[b, 0], points[b, 1], mixed(key, rows[b])
        if refine:
            _place(c, k, px, py, row, n, spread, end, s, r, t, piece, left, right, gain)
        else:
            _points(row, n, jittered, s)
            for i in range(n):
                x, y, t[i, 0], t[i, 1], piece[i] = _at(c, k, s[i])
                r[i, 0], r[i, 1] = x - px, y - py
        found = _integral(s, r, t, piece, k, alpha, order, so_far, room)
        exponent[b], total[b], nearest[b], missing[b] = found


@_kernel
def _seen_rows(s, r, t, piece, pieces, alpha, exponent, total, nearest, missing, start, stop):  # type: ignore[no-untyped-def]
    order, so_far, room = _rooms(s.shape[1])
    for b in range(start, stop):
        found = _integral(s[b], r[b], t[b], piece[b], pieces[b], alpha[b], order, so_far, room)
        exponent[b], total[b], nearest[b], missing[b] = found


def integral(
    s: Floats, r: Floats, t: Floats, piece: Ints, pieces: Ints, alpha: Floats
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """`SdHermite` on samples that are there, as `rebuilt` returns it.

    Parameters are those of `compiled.winding`, and the sharpness of each query.
    """
    exponent, total, nearest = (np.empty(len(s)) for _ in range(3))
    out = (exponent, total, nearest, np.empty(len(s), dtype=np.bool_))
    over_rows(lambda start, stop: _seen_rows(s, r, t, piece, pieces, alpha, *out, start, stop), len(s))
    return out


def rebuilt(
    coefficients: Floats,
    pieces: Ints,
    shape: Ints,
    points: Floats,
    rows: Ints,
    key: int,
    n: int,
    *,
    refine: bool,
    jittered: bool,
    spread: float,
    end: float,
    alpha: float,
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """The integral over the curve rebuilt from n samples: exponent, sum, distance of the nearest sample, and where a
    piece was not seen, (B,) each.

    Parameters are those of `compiled.refined`, the sharpness, and whether points are those of `CurveRefine`, or else
    `jittered` or random. For the first every shape must have at most n / 2 pieces.
    """
    exponent, total, nearest = (np.empty(len(points)) for _ in range(3))
    missing = np.empty(len(points), dtype=np.bool_)
    fixed = (coefficients, pieces, shape, points, rows, unsigned(key), n, refine, jittered, spread, end, alpha)
    out = (exponent, total, nearest, missing)
    over_rows(lambda start, stop: _rebuilt_rows(*fixed, *out, start, stop), len(points))
    return out
