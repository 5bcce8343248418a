"""Compiled integral of exp(-alpha (|x - p| - d_min)) over a curve: the kernel behind `smooth.py`.

Everything is measured from the closest point x*: with y = x - x* and q = x* - p,

    E = |x - p|^2 - |q|^2 = y . (y + 2 q),    |x - p| - |q| = E / (|x - p| + |q|),

which loses no digits however far the query is. On a panel of an arc, E and the squared speed are polynomials; the
range of their Bernstein coefficients bounds them. A panel is halved until

- alpha times the distance varies little, or hardly otherwise than linearly: the exponential is tame,
- the panel is shorter than its distance: the square root in that has no branch point nearby,
- its velocities differ by no more than the smallest of them: nor has the square root in the arc length,

and Gauss-Legendre then converges to rounding, without any error estimate that could be fooled (`gauss`). Panels, arcs
and whole subtrees whose bound is below rounding are dropped.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from nqr_geom.curves.gauss import BEND, BENT, COUNT, LONGEST, NODES, STRAIGHT, WEIGHTS, exponentials

__all__ = ["exponential_rows"]

_PRUNE = 1e-17  # relative to the integral: what is dropped in all
_LEFT_OVER = 1e-14  # relative, a panel: where a kink is no longer worth halving for
_DEPTH, _DEEPEST = 60, 1000
_SMALLEST = 1e-300


@njit(cache=True, nogil=True, error_model="numpy")
def exponential_rows(
    box, skip, arc, start, end, coefficients, points, closest, where, alpha, length, with_gradient, log, gradient
):
    """Logarithm of the integral for every query, given its closest arc and u; its mean unit vector p - x, too."""
    total, query = np.empty(3), np.empty(8)
    part, speed, ux, uy, scale = np.empty(COUNT), np.empty(COUNT), np.empty(COUNT), np.empty(COUNT), np.empty(COUNT)
    room = (part, speed, ux, uy, scale, scale.view(np.int64))
    for i in range(points.shape[0]):
        px, py, a, u = points[i, 0], points[i, 1], closest[i], where[i]
        c = coefficients[a]
        if u == 1.0:
            fx, fy = end[a, 0], end[a, 1]
        else:
            fx = start[a, 0] + u * (c[0, 0] + u * (c[1, 0] + u * c[2, 0]))
            fy = start[a, 1] + u * (c[0, 1] + u * (c[1, 1] + u * c[2, 1]))
        qx, qy = fx - px, fy - py
        nearest = math.hypot(qx, qy)
        chord = math.hypot(end[a, 0] - start[a, 0], end[a, 1] - start[a, 1])
        # From the closest point on, the distance grows no faster than the arc length: a lower bound.
        floor = -math.expm1(-0.5 * alpha * chord) / alpha if alpha * chord > 1e-8 else 0.5 * chord
        query[0], query[1], query[2], query[3], query[4] = qx, qy, nearest, alpha, floor
        total[:] = 0.0
        # The closest arc about its closest point, so that the neighbourhood of that point is resolved at any alpha.
        x1, y1 = c[0, 0] + u * (2.0 * c[1, 0] + 3.0 * u * c[2, 0]), c[0, 1] + u * (2.0 * c[1, 1] + 3.0 * u * c[2, 1])
        x2, y2 = c[1, 0] + 3.0 * u * c[2, 0], c[1, 1] + 3.0 * u * c[2, 1]
        for s0, s1 in ((0.0, 1.0 - u), (-u, 0.0)):
            if s1 > s0:
                _arc_integral(0.0, 0.0, x1, y1, x2, y2, c[2, 0], c[2, 1], s0, s1, query, with_gradient, room, total)
        node = 0
        while node < skip.shape[0]:
            dx = max(box[node, 0] - px, 0.0, px - box[node, 2])
            dy = max(box[node, 1] - py, 0.0, py - box[node, 3])
            gap = math.hypot(dx, dy) * (1.0 - 2.0**-50) - nearest
            if gap > 0.0 and math.exp(-alpha * gap) * length < _PRUNE * max(total[0], floor):
                node = skip[node]
                continue
            b = arc[node]
            if b < 0:
                node += 1
                continue
            if b != a:
                c = coefficients[b]
                _arc_integral(
                    start[b, 0] - fx, start[b, 1] - fy, c[0, 0], c[0, 1], c[1, 0], c[1, 1], c[2, 0], c[2, 1],
                    0.0, 1.0, query, with_gradient, room, total,
                )  # fmt: skip
            node = skip[node]
        log[i] = math.log(total[0])
        gradient[i, 0], gradient[i, 1] = total[1] / total[0], total[2] / total[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _arc_integral(x0, y0, x1, y1, x2, y2, x3, y3, s0, s1, query, with_gradient, room, total):
    """Add the integral over y(s) = (x0, y0) + s (x1, y1) + s^2 (x2, y2) + s^3 (x3, y3), s in [s0, s1]."""
    qx, qy, nearest, alpha, floor = query[0], query[1], query[2], query[3], query[4]
    part, speed, ux, uy, power, bits = room
    square = nearest * nearest
    depth = 0
    low = 0  # the panel is [low, low + 1] / 2**depth of [s0, s1], from the closest point outwards
    outwards = s1 > 0.0
    while True:
        width = (s1 - s0) * 0.5**depth
        s = s0 + low * width if outwards else s1 - (low + 1) * width
        # y on the panel over [0, 1].
        k0x, k0y = x0 + s * (x1 + s * (x2 + s * x3)), y0 + s * (y1 + s * (y2 + s * y3))
        k1x, k1y = width * (x1 + s * (2.0 * x2 + 3.0 * s * x3)), width * (y1 + s * (2.0 * y2 + 3.0 * s * y3))
        k2x, k2y = width * width * (x2 + 3.0 * s * x3), width * width * (y2 + 3.0 * s * y3)
        k3x, k3y = width * width * width * x3, width * width * width * y3
        e_low, e_high = _range_of_excess(k0x, k0y, k1x, k1y, k2x, k2y, k3x, k3y, qx, qy)
        v_high = _largest_speed(k1x, k1y, k2x, k2y, k3x, k3y)
        e_low = max(e_low, -square)
        far_low, far_high = math.sqrt(square + e_low), math.sqrt(max(square + e_high, 0.0))
        d_low = e_low / (far_low + nearest) if far_low + nearest > 0.0 else 0.0
        d_high = e_high / (far_high + nearest) if far_high + nearest > 0.0 else 0.0
        spread = alpha * (d_high - d_low)
        bound = math.sqrt(v_high) * math.exp(-alpha * max(d_low, 0.0))
        scale = max(total[0], floor)
        # Control points of the velocity.
        bx, by, cx, cy = k1x + k2x, k1y + k2y, k1x + 2.0 * k2x + 3.0 * k3x, k1y + 2.0 * k2y + 3.0 * k3y
        apart = max(_square(k2x, k2y), _square(cx - bx, cy - by), _square(cx - k1x, cy - k1y))
        even = apart <= min(_square(k1x, k1y), _square(bx, by), _square(cx, cy))
        # What a non-smooth panel can be off by: all of it, or what exp turns the kink of the distance into.
        kink = 1.0 if with_gradient or not even else min(1.0, spread)
        # Next to the closest point panels may shrink to the smallest numbers, elsewhere to the last bit of s.
        last = depth >= _DEPTH and (low > 1 or depth >= _DEEPEST)
        unseen = bound < 1e-3 * _PRUNE * scale
        turn = math.sqrt(max(_square(k2x, k2y), _square(k2x + 3.0 * k3x, k2y + 3.0 * k3y)))
        bend = alpha * (0.125 * v_high / max(far_low, _SMALLEST) + 0.25 * turn)
        tame = spread <= BENT or spread + BEND * bend <= STRAIGHT
        smooth = tame and even and v_high <= LONGEST * (square + e_low)
        if not (unseen or smooth or last or bound * kink <= _LEFT_OVER * scale):
            depth, low = depth + 1, 2 * low
            continue
        if not unseen:
            for j in range(COUNT):
                t = NODES[j]
                yx, yy = k0x + t * (k1x + t * (k2x + t * k3x)), k0y + t * (k1y + t * (k2y + t * k3y))
                vx, vy = k1x + t * (2.0 * k2x + 3.0 * t * k3x), k1y + t * (2.0 * k2y + 3.0 * t * k3y)
                rx, ry = yx + qx, yy + qy
                far = math.sqrt(rx * rx + ry * ry)
                rise = (yx * (yx + 2.0 * qx) + yy * (yy + 2.0 * qy)) / max(far + nearest, _SMALLEST)
                part[j] = -alpha * rise
                speed[j] = math.sqrt(vx * vx + vy * vy) * WEIGHTS[j]
                if with_gradient:
                    ux[j], uy[j] = rx / max(far, _SMALLEST), ry / max(far, _SMALLEST)
            exponentials(part, power, bits)
            for j in range(COUNT):
                part[j] *= speed[j]
                total[0] += part[j]
            if with_gradient:
                for j in range(COUNT):
                    total[1] -= part[j] * ux[j]
                    total[2] -= part[j] * uy[j]
        while depth > 0 and low % 2 == 1:
            depth, low = depth - 1, low // 2
        if depth == 0:
            return
        low += 1


@njit(inline="always", error_model="numpy")
def _square(x, y):
    return x * x + y * y


@njit(cache=True, nogil=True, error_model="numpy")
def _range_of_excess(k0x, k0y, k1x, k1y, k2x, k2y, k3x, k3y, qx, qy):
    """Least and largest Bernstein coefficient of y . (y + 2 q), degree six."""
    mx, my = k0x + qx, k0y + qy
    e0 = k0x * (k0x + 2.0 * qx) + k0y * (k0y + 2.0 * qy)
    e1 = 2.0 * (k1x * mx + k1y * my)
    e2 = k1x * k1x + k1y * k1y + 2.0 * (k2x * mx + k2y * my)
    e3 = 2.0 * (k1x * k2x + k1y * k2y + k3x * mx + k3y * my)
    e4 = k2x * k2x + k2y * k2y + 2.0 * (k1x * k3x + k1y * k3y)
    e5 = 2.0 * (k2x * k3x + k2y * k3y)
    e6 = k3x * k3x + k3y * k3y
    low, high = e0, e0
    for b in (
        e0 + e1 / 6.0,
        e0 + e1 / 3.0 + e2 / 15.0,
        e0 + e1 / 2.0 + e2 / 5.0 + e3 / 20.0,
        e0 + e1 * (2.0 / 3.0) + e2 * 0.4 + e3 * 0.2 + e4 / 15.0,
        e0 + e1 * (5.0 / 6.0) + e2 * (2.0 / 3.0) + e3 * 0.5 + e4 / 3.0 + e5 / 6.0,
        e0 + e1 + e2 + e3 + e4 + e5 + e6,
    ):
        low, high = min(low, b), max(high, b)
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _largest_speed(k1x, k1y, k2x, k2y, k3x, k3y):
    """Largest Bernstein coefficient of |y'|^2, degree four."""
    v0 = k1x * k1x + k1y * k1y
    v1 = 4.0 * (k1x * k2x + k1y * k2y)
    v2 = 4.0 * (k2x * k2x + k2y * k2y) + 6.0 * (k1x * k3x + k1y * k3y)
    v3 = 12.0 * (k2x * k3x + k2y * k3y)
    v4 = 9.0 * (k3x * k3x + k3y * k3y)
    high = v0
    for b in (
        v0 + v1 * 0.25,
        v0 + v1 * 0.5 + v2 / 6.0,
        v0 + v1 * 0.75 + v2 * 0.5 + v3 * 0.25,
        v0 + v1 + v2 + v3 + v4,
    ):
        high = max(high, b)
    return high
