"""Compiled closest-point search on a curve's tree: the kernels behind `distance.py` and `smooth.py`."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["STACK", "closest_arc", "closest_rows"]

STACK = 192  # nodes waiting at once, one a level: 32 bits of a Morton code and halving of what shares one
_HALVINGS = 40


@njit(cache=True, nogil=True, error_model="numpy")
def closest_rows(box, skip, arc, start, end, coefficients, curved, points, with_points, which, where, square):
    """Closest arc, its parameter u and the squared distance for every query; `with_points`: arcs of length zero too."""
    nodes, gaps = np.empty(STACK, np.int64), np.empty(STACK)
    bound = np.inf
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        if i > 0:  # some point of the curve is this near: the last answer, seen from here
            step = np.sqrt((px - points[i - 1, 0]) ** 2 + (py - points[i - 1, 1]) ** 2)
            bound = (np.sqrt(square[i - 1]) + step) * 1.000001
            bound = bound * bound
        a, u, d = closest_arc(box, skip, arc, start, end, coefficients, curved, px, py, with_points, bound, nodes, gaps)
        which[i], where[i], square[i] = a, u, d


@njit(cache=True, nogil=True, error_model="numpy")
def closest_arc(box, skip, arc, start, end, coefficients, curved, px, py, with_points, bound, nodes, gaps):
    """Branch and bound, nearer child first: (arc, u, squared distance), or arc -1 if nothing is within `bound`."""
    best, best_arc, best_u = bound, -1, 0.0
    if skip.shape[0] == 0:
        return best_arc, best_u, best
    top = 1
    nodes[0], gaps[0] = 0, _gap(box, 0, px, py)
    while top > 0:
        top -= 1
        node = nodes[top]
        if gaps[top] > best or (gaps[top] == best and best_arc >= 0):
            continue
        while arc[node] < 0:  # down the nearer side, the other one waits
            near, far = node + 1, skip[node + 1]
            near_gap, far_gap = _gap(box, near, px, py), _gap(box, far, px, py)
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            if far_gap < best:
                nodes[top], gaps[top] = far, far_gap
                top += 1
            node = near
        a = arc[node]
        if curved[a]:
            u, d = _on_curve(start[a], end[a], coefficients[a], px, py, best)
        else:
            u, d = _on_segment(start[a, 0], start[a, 1], end[a, 0], end[a, 1], px, py)
        if (d < best or (d == best and best_arc < 0)) and (
            with_points or start[a, 0] != end[a, 0] or start[a, 1] != end[a, 1]
        ):
            best, best_arc, best_u = d, a, u
    return best_arc, best_u, best


@njit(cache=True, nogil=True, error_model="numpy")
def _gap(box, node, px, py):
    """Squared distance to a box."""
    dx, dx_far = box[node, 0] - px, px - box[node, 2]
    dy, dy_far = box[node, 1] - py, py - box[node, 3]
    dx, dy = dx if dx > dx_far else dx_far, dy if dy > dy_far else dy_far
    dx, dy = dx if dx > 0.0 else 0.0, dy if dy > 0.0 else 0.0
    return dx * dx + dy * dy


@njit(cache=True, nogil=True, error_model="numpy")
def _on_segment(ax, ay, bx, by, px, py):
    """Nearest parameter on a segment; between the ends the squared distance comes from the cross product."""
    ex, ey, wx, wy = bx - ax, by - ay, px - ax, py - ay
    along, length = wx * ex + wy * ey, ex * ex + ey * ey
    if along <= 0.0 or length == 0.0:
        return 0.0, wx * wx + wy * wy
    if along >= length:
        return 1.0, (px - bx) ** 2 + (py - by) ** 2
    cross = ex * wy - ey * wx
    return along / length, cross * (cross / length)


@njit(cache=True, nogil=True, error_model="numpy")
def _on_curve(start, end, c, px, py, bound):
    """Nearest parameter on a curved arc.

    At an interior minimum g(u) = (x(u) - p) . x'(u), of degree five, rises through zero. Its Bernstein coefficients on
    a part of [0, 1] change sign at least as often as g does: no change means no minimum, one means a simple root,
    which Newton's method in a bracket finds; otherwise the part is halved.
    """
    x0, y0 = start[0] - px, start[1] - py
    x1, x2, x3, y1, y2, y3 = c[0, 0], c[1, 0], c[2, 0], c[0, 1], c[1, 1], c[2, 1]
    best_u, best = 0.0, x0 * x0 + y0 * y0
    at_end = (end[0] - px) ** 2 + (end[1] - py) ** 2
    if at_end < best:
        best_u, best = 1.0, at_end
    g0 = x0 * x1 + y0 * y1
    g1 = x1 * x1 + y1 * y1 + 2.0 * (x0 * x2 + y0 * y2)
    g2 = 3.0 * (x1 * x2 + y1 * y2 + x0 * x3 + y0 * y3)
    g3 = 2.0 * (x2 * x2 + y2 * y2) + 4.0 * (x1 * x3 + y1 * y3)
    g4, g5 = 5.0 * (x2 * x3 + y2 * y3), 3.0 * (x3 * x3 + y3 * y3)
    low, depth = 0, 0  # the part is [low, low + 1] / 2**depth, in depth-first order
    while True:
        width = 0.5**depth
        t = low * width
        # g on the part as a polynomial over [0, 1], then in Bernstein form.
        h5 = g5 * width**5
        h4 = (g4 + 5.0 * t * g5) * width**4
        h3 = (g3 + t * (4.0 * g4 + t * 10.0 * g5)) * width**3
        h2 = (g2 + t * (3.0 * g3 + t * (6.0 * g4 + t * 10.0 * g5))) * width**2
        h1 = (g1 + t * (2.0 * g2 + t * (3.0 * g3 + t * (4.0 * g4 + t * 5.0 * g5)))) * width
        h0 = g0 + t * (g1 + t * (g2 + t * (g3 + t * (g4 + t * g5))))
        b1 = h0 + h1 / 5.0
        b2 = h0 + (2.0 * h1) / 5.0 + h2 / 10.0
        b3 = h0 + (3.0 * h1) / 5.0 + (3.0 * h2) / 10.0 + h3 / 10.0
        b4 = h0 + (4.0 * h1) / 5.0 + (6.0 * h2) / 10.0 + (4.0 * h3) / 10.0 + h4 / 5.0
        b5 = h0 + h1 + h2 + h3 + h4 + h5
        changes, first, last = 0, 0.0, 0.0
        for b in (h0, b1, b2, b3, b4, b5):
            if b * last < 0.0:
                changes += 1
            if b != 0.0:
                last = b
                first = b if first == 0.0 else first
        # A zero at an end of the part would blind the bracket; the ends of parts are candidates themselves.
        split = depth < _HALVINGS and (changes > 1 or (changes == 1 and (h0 == 0.0 or b5 == 0.0)))
        candidate = -1.0
        if split or changes > 1:
            candidate = t + 0.5 * width
        elif changes == 1 and first < 0.0:
            candidate = _rising_root(g0, g1, g2, g3, g4, g5, t, t + width)
        if candidate >= 0.0:
            u = candidate
            for _ in range(3):
                x, y = x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))
                d = x * x + y * y
                if d < best:
                    best_u, best = u, d
                elif u != candidate:
                    break
                # Near the curve g loses its digits in the expansion above, and x(u) - p does not.
                vx, vy = x1 + u * (2.0 * x2 + 3.0 * u * x3), y1 + u * (2.0 * y2 + 3.0 * u * y3)
                speed = vx * vx + vy * vy
                u = u - (x * vx + y * vy) / speed if speed > 0.0 else u
                if not 0.0 < u < 1.0:
                    break
        if split:
            depth, low = depth + 1, 2 * low
            continue
        while depth > 0 and low % 2 == 1:  # this right half was the last of its parent
            depth, low = depth - 1, low // 2
        if depth == 0:
            return best_u, best
        low += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _rising_root(g0, g1, g2, g3, g4, g5, low, high):
    """The root of a quintic that is negative at `low` and positive at `high`: Newton, halving where it leaves."""
    u = 0.5 * (low + high)
    for _ in range(80):
        g = g0 + u * (g1 + u * (g2 + u * (g3 + u * (g4 + u * g5))))
        if g == 0.0:
            return u
        if g < 0.0:
            low = u
        else:
            high = u
        slope = g1 + u * (2.0 * g2 + u * (3.0 * g3 + u * (4.0 * g4 + u * 5.0 * g5)))
        following = u - g / slope if slope != 0.0 else low
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - u) <= 2.0**-53 * following:
            return following
        u = following
    return u
