"""As few panels as a point needs to see a boundary with: short where it is near, long where it is far, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["panels_of"]

_BEND = 0.95  # cosine of the turn at which a panel ends, if it is long enough already
_PART = 0.3  # long enough, in lengths of a panel

_inline = njit(inline="always", error_model="numpy")
_kernel = njit(cache=True, nogil=True, error_model="numpy")


@_inline
def _length(x, y):  # type: ignore[no-untyped-def]
    return math.sqrt(x * x + y * y)  # coordinates are of size one: no need of the care that hypot takes


@_inline
def _close(open_, panels, count):  # type: ignore[no-untyped-def]
    """Write the open panel: both ends, mean value, hidden share; -1 where there is no room."""
    length = open_[5]
    across = (open_[2] - open_[0]) ** 2 + (open_[3] - open_[1]) ** 2
    if length > 0.0 and count >= 0 and across > 1e-24:  # a detour back to where it began is no panel
        if count >= len(panels):
            return -1
        panel = panels[count]
        panel[0], panel[1], panel[2], panel[3] = open_[0], open_[1], open_[2], open_[3]
        panel[4], panel[5] = open_[6] / length, open_[7] / length
        count += 1
    open_[4] = open_[5] = open_[6] = open_[7] = 0.0
    return count


@_inline
def _append(open_, x0, y0, g0, x1, y1, g1, hidden, size):  # type: ignore[no-untyped-def]
    """Add a straight part to the open panel."""
    length = _length(x1 - x0, y1 - y0)
    if open_[5] == 0.0:
        open_[0], open_[1] = x0, y0
    open_[2], open_[3] = x1, y1
    open_[4] += size
    open_[5] += length
    open_[6] += 0.5 * length * (g0 + g1)
    open_[7] += length * hidden


@_kernel
def panels_of(parts, count, x, y, least, step, panels):  # type: ignore[no-untyped-def]
    """Panels that stand for parts, none longer than about `step` times its distance from (x, y).

    Parameters
    ----------
    parts : (p, 7) float64
        Straight parts of the boundary, loop after loop: x, y and value at both ends, and whether it is a guess.
    count : int
        How many of them.
    x, y : float
        From where they are seen.
    least : float
        Distances below this count as this.
    step : float
        Length of a panel over its distance.
    panels : (m, 6) float64
        Result: both ends, mean value, hidden share.

    Returns
    -------
    made : int
        Panels that were made, or -1 where there is no room.
    """
    made = 0
    open_ = np.zeros(8)
    for i in range(count):
        x0, y0, g0 = parts[i, 0], parts[i, 1], parts[i, 2]
        x1, y1, g1, hidden = parts[i, 3], parts[i, 4], parts[i, 5], parts[i, 6]
        dx, dy = x1 - x0, y1 - y0
        length = _length(dx, dy)
        dx, dy = dx / length, dy / length
        # Size: the part in a measure in which steps grow with the distance.
        away = max(_length(0.5 * (x0 + x1) - x, 0.5 * (y0 + y1) - y), least)
        size = length / (step * away)
        if length > 0.4 * away:
            along, off = (x - x0) * dx + (y - y0) * dy, abs((x - x0) * dy - (y - y0) * dx)
            off = max(off, least)
            low, high = math.asinh(-along / off), math.asinh((length - along) / off)
            size = (high - low) / step
        if open_[5] > 0.0:
            px, py = open_[2] - open_[0], open_[3] - open_[1]
            bent = px * dx + py * dy < _BEND * _length(px, py)
            apart = x0 != open_[2] or y0 != open_[3]
            if apart or open_[4] + size > 1.0 or (bent and open_[4] > _PART):
                made = _close(open_, panels, made)
        if size <= 1.0 or length <= 0.4 * away:
            _append(open_, x0, y0, g0, x1, y1, g1, hidden, size)
            continue
        pieces = math.ceil(size)
        s0 = 0.0
        for k in range(1, pieces + 1):
            s1 = length if k == pieces else along + off * math.sinh(low + (high - low) * k / pieces)
            a, b = s0 / length, s1 / length
            _append(
                open_, x0 + s0 * dx, y0 + s0 * dy, g0 + a * (g1 - g0), x0 + s1 * dx, y0 + s1 * dy, g0 + b * (g1 - g0),
                hidden, 1.0,
            )  # fmt: skip
            made = _close(open_, panels, made)
            s0 = s1
    return _close(open_, panels, made)
