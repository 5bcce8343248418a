"""The boundary that walks have seen, rebuilt from closest points, arc lengths and values, compiled.

Between neighbouring closest points of a loop the arc length tells what the boundary does: as long as the chord, it is
straight; as long as the way along both tangents, it has one corner, and where; longer, it hides, and a circular arc of
that length stands for it, bent as the loop turns. Values are linear along the arc; into a corner those of a straight
run are continued where they have proved linear; in hidden parts they fall back to the mean of what was seen.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["parts_of", "room"]

_STRAIGHT = 1e-7  # relative excess of the arc over the chord that rounding may cause
_CORNER = 1e-6  # the same for the way along two tangents
_FLAT = 1.02  # arcs that are hardly longer than their chord are their chord
_PIECES = 64  # chords for an arc as long as the whole boundary, beside three for any arc
_TURN = 0.45  # radians of an arc that one chord stands for
_FULL = 3.1  # half angle of the largest arc; beyond, chord and arc no longer tell it apart from a circle

_inline = njit(inline="always", error_model="numpy")
_kernel = njit(cache=True, nogil=True, error_model="numpy")


@_inline
def _length(x, y):  # type: ignore[no-untyped-def]
    return math.sqrt(x * x + y * y)  # coordinates are of size one: no need of the care that hypot takes


@_inline
def room(samples):  # type: ignore[no-untyped-def]
    """Parts that so many samples can make at most."""
    return 4 * samples + _PIECES + 4


@_inline
def _put(parts, count, x0, y0, g0, x1, y1, g1, hidden):  # type: ignore[no-untyped-def]
    """Append a straight part with linear values; parts without length are left out."""
    if (x1 - x0) ** 2 + (y1 - y0) ** 2 > 1e-26:
        part = parts[count]
        part[0], part[1], part[2] = x0, y0, g0
        part[3], part[4], part[5] = x1, y1, g1
        part[6] = hidden
        count += 1
    return count


@_kernel
def _half_angle(ratio):  # type: ignore[no-untyped-def]
    """The half angle of a circular arc that is `ratio` times as long as its chord: phi / sin(phi) = ratio."""
    if ratio > 60.0:
        return _FULL
    phi = min(math.sqrt(6.0 * (ratio - 1.0)), 2.0) if ratio < 2.0 else math.pi * ratio / (1.0 + ratio)
    for _ in range(8):
        sine, cosine = math.sin(phi), math.cos(phi)
        phi -= (phi / sine - ratio) * sine * sine / (sine - phi * cosine)
        phi = min(max(phi, 1e-3), _FULL)
    return phi


@_kernel
def _continued(seen, gap, straight, low, n, i, step, ahead):  # type: ignore[no-untyped-def]
    """Value `ahead` beyond sample i, continued from the run behind it, and how far that may be off; else infinity.

    `step` is -1 where the run comes before the sample and 1 where it comes after.
    """
    j = low + (i - low + step) % n
    k = low + (j - low + step) % n
    first, second = (j, k) if step < 0 else (i, j)
    if n < 3 or not (straight[first] and straight[second]):
        return 0.0, np.inf
    one = (seen[i, 3] - seen[j, 3]) / gap[first]
    two = (seen[j, 3] - seen[k, 3]) / gap[second]
    off = abs(one - two) * ahead * (1.0 + ahead / (gap[first] + gap[second]))
    slope = (seen[i, 3] - seen[k, 3]) / (gap[first] + gap[second])
    return seen[i, 3] + slope * ahead, off


@_inline
def _blended(plain, value, off):  # type: ignore[no-untyped-def]
    """A continued value as far as it can be trusted beside a plain one."""
    if not off < np.inf:
        return plain
    step = value - plain
    if off < 1e-9 * abs(step):
        return value
    return plain + step * (step * step) / (step * step + 4.0 * off * off) if step != 0.0 else plain


@_inline
def _tangent(seen, chord, straight, i, j, at):  # type: ignore[no-untyped-def]
    """Unit tangent at sample `at`: along the straight gap i .. j, or square to the way to the closest point."""
    if straight[i]:
        return (seen[j, 1] - seen[i, 1]) / chord[i], (seen[j, 2] - seen[i, 2]) / chord[i]
    x, y = -seen[at, 5], seen[at, 4]
    length = _length(x, y)
    return (x / length, y / length) if length > 0.0 else (0.0, 0.0)


@_kernel
def _surrounded(seen, low, n):  # type: ignore[no-untyped-def]
    """Whether chords between the samples low .. low + n of a loop enclose the query: they cross a ray an odd number
    of times."""
    inside = False
    for i in range(low, low + n):
        j = i + 1 if i + 1 < low + n else low
        x0, y0, x1, y1 = seen[i, 1], seen[i, 2], seen[j, 1], seen[j, 2]
        if (y0 > 0.0) != (y1 > 0.0):
            inside ^= (x0 * y1 - x1 * y0 > 0.0) == (y1 > y0)
    return inside


@_kernel
def _bulge(parts, count, seen, i, j, arc, side, around, whole, mean, fade):  # type: ignore[no-untyped-def]
    """A guess of the given length from sample i to sample j, on the right of the chord (side 1) or the left.

    Where it may have to go `around` the query it is a circular arc, else an isosceles triangle: a pocket that
    stays behind its chord however deep it is, so that it hides nothing that was seen.
    """
    x0, y0, g0 = seen[i, 1], seen[i, 2], seen[i, 3]
    x1, y1, g1 = seen[j, 1], seen[j, 2], seen[j, 3]
    dx, dy = x1 - x0, y1 - y0
    chord = _length(dx, dy)
    phi = _half_angle(arc / chord) if chord > 1e-9 * arc else math.pi
    pocket = phi < math.pi and not (around and (side < 0.0 or x0 * y1 < x1 * y0))
    if phi < math.pi:
        dx, dy = dx / chord, dy / chord
    else:  # a loop seen in one place: a circle behind it if it is a hole, around the query if it is the outline
        ax, ay = seen[i, 4], seen[i, 5]
        if ax == 0.0 and ay == 0.0:
            ax, ay = x0, y0
        size = max(_length(ax, ay), 1e-300)
        dx, dy = ay / size, -ax / size
    radius = 0.5 * arc / phi
    outx, outy = side * dy, -side * dx
    # From the middle of the chord; an arc longer than its share of the circle keeps its length, not its ends.
    cx, cy = 0.5 * (x0 + x1) - radius * math.cos(phi) * outx, 0.5 * (y0 + y1) - radius * math.cos(phi) * outy
    pieces = min(max(2, math.ceil(2.0 * phi / _TURN)), 3 + int(_PIECES * arc / whole))
    rate = min(arc / (fade * whole), 300.0)
    full = math.sinh(rate)
    deep = math.sqrt(max(arc * arc - chord * chord, 0.0))
    if pocket:
        pieces += pieces % 2
    x, y, g = x0, y0, g0
    for k in range(1, pieces + 1):
        t = k / pieces
        if k == pieces:
            nx, ny, ng = x1, y1, g1
        else:
            if pocket:
                off = deep * min(t, 1.0 - t)
                nx, ny = x0 + t * (x1 - x0) + off * outx, y0 + t * (y1 - y0) + off * outy
            else:
                turn = phi * (2.0 * t - 1.0)
                nx = cx + radius * (math.cos(turn) * outx + math.sin(turn) * dx)
                ny = cy + radius * (math.cos(turn) * outy + math.sin(turn) * dy)
            a, b = math.sinh(rate * (1.0 - t)) / full, math.sinh(rate * t) / full
            ng = mean + a * (g0 - mean) + b * (g1 - mean)
        count = _put(parts, count, x, y, g, nx, ny, ng, 1.0)
        x, y, g = nx, ny, ng
    return count


@_kernel
def _across(parts, count, seen, gap, chord, straight, low, n, i, j, side, around, whole, mean, fade):  # type: ignore[no-untyped-def]
    """Parts from sample i to the next one, j, of the loop low .. low + n, where the boundary is not straight."""
    x0, y0, g0 = seen[i, 1], seen[i, 2], seen[i, 3]
    x1, y1, g1 = seen[j, 1], seen[j, 2], seen[j, 3]
    before, after = low + (i - low - 1) % n, low + (j - low + 1) % n
    ax, ay = _tangent(seen, chord, straight, before, i, i)
    bx, by = _tangent(seen, chord, straight, j, after, j)
    sine = ax * by - ay * bx
    if abs(sine) > 1e-9:
        s = ((x1 - x0) * by - (y1 - y0) * bx) / sine
        x, y = x0 + s * ax, y0 + s * ay
        t = (x1 - x) * bx + (y1 - y) * by
        if s > 0.0 and t > 0.0 and abs(s + t - gap[i]) <= _CORNER * gap[i]:
            plain = g0 + (g1 - g0) * s / (s + t)
            one, off_one = _continued(seen, gap, straight, low, n, i, -1, s)
            two, off_two = _continued(seen, gap, straight, low, n, j, 1, t)
            left, right = _blended(plain, one, off_one), _blended(plain, two, off_two)
            if off_one == np.inf:
                left = right
            elif off_two == np.inf:
                right = left
            g = 0.5 * (left + right)
            guess = 1.0 if off_one == np.inf and off_two == np.inf else 0.0  # the corner is known, its value is not
            count = _put(parts, count, x0, y0, g0, x, y, g, guess)
            return _put(parts, count, x, y, g, x1, y1, g1, guess)
    if gap[i] <= _FLAT * chord[i] and n > 1:
        return _put(parts, count, x0, y0, g0, x1, y1, g1, 1.0)
    return _bulge(parts, count, seen, i, j, gap[i], side, around, whole, mean, fade)


@_kernel
def parts_of(seen, loops, fade, gap, chord, straight, parts):  # type: ignore[no-untyped-def]
    """Straight parts with linear values that stand for the boundary.

    Parameters
    ----------
    seen : (k, 6) float64
        Samples by rising arc length, no two at the same: arc length, x, y, value, and the way that led to it (x, y),
        zeros where it is not known.
    loops : (l,) float64
        Arc length at the end of each loop.
    fade : float
        Length over which values in hidden parts fall back to the mean, as a part of the whole boundary.
    gap, chord, straight : (k,) float64, float64 and bool
        Room.
    parts : (p, 7) float64
        Result: x, y and value at both ends, and whether it is a guess; `room(k)` of them are enough.

    Returns
    -------
    count : int
        Parts that were made.
    """
    total, covered, level = len(seen), 0.0, 0.0
    low, loop = 0, 0
    start = 0.0
    first = np.zeros(len(loops) + 1, dtype=np.int64)
    for loop in range(len(loops)):
        high = low
        while high < total and (seen[high, 0] <= loops[loop] or loop == len(loops) - 1):
            high += 1
        for i in range(low, high):
            j = i + 1 if i + 1 < high else low
            gap[i] = seen[j, 0] - seen[i, 0] + (loops[loop] - start if j <= i else 0.0)
            chord[i] = _length(seen[j, 1] - seen[i, 1], seen[j, 2] - seen[i, 2])
            straight[i] = chord[i] > 0.0 and gap[i] - chord[i] <= 1e-12 + _STRAIGHT * chord[i]
            if straight[i]:
                covered += gap[i]
                level += 0.5 * gap[i] * (seen[i, 3] + seen[j, 3])
        first[loop + 1] = high
        low, start = high, loops[loop]
    mean = level / covered if covered > 0.0 else seen[:, 3].mean()
    count = 0
    for loop in range(len(loops)):
        low, n = first[loop], first[loop + 1] - first[loop]
        side = 1.0 if loop == 0 else -1.0  # the outline turns left on the whole, holes turn right
        around = loop > 0 or not _surrounded(seen, low, n)
        for i in range(low, low + n):
            j = i + 1 if i + 1 < low + n else low
            if straight[i]:
                a, b = seen[i], seen[j]
                count = _put(parts, count, a[1], a[2], a[3], b[1], b[2], b[3], 0.0)
                continue
            count = _across(parts, count, seen, gap, chord, straight, low, n, i, j, side, around, loops[-1], mean, fade)
    return count
