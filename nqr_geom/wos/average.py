"""The mean of boundary values under the harmonic measure of boundary that was seen, for one query, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from nqr_geom.wos.harmonic import harmonic_measure
from nqr_geom.wos.panels import panels_of
from nqr_geom.wos.rebuild import parts_of, room

__all__ = ["average", "room_for"]

MOST_PANELS = 256
_SAME = 1e-9  # arc lengths nearer than this, relative to all, are one sample
_NEAREST = 1e-5  # no panel is shorter than this part of the farthest distance
_REACH = 3.0  # the farthest part lies at 1/2 in the frame of the system times this, so that it is positive definite
_PLACES = 40  # bits of an arc length in a key, above _INDEX bits that tell which sample it is
_INDEX = 22
_MOVES = 16  # a sample moves by fewer places on average, or the samples are sorted the general way

_kernel = njit(cache=True, nogil=True, error_model="numpy")


@_kernel
def room_for(most):  # type: ignore[no-untyped-def]
    """Room for `average` of at most so many samples."""
    keys, spare, heads = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(2 * most + 2, np.int64)
    gap, chord, straight = np.empty(most), np.empty(most), np.empty(most, np.bool_)
    parts, panels = np.empty((room(most), 7)), np.empty((MOST_PANELS, 6))
    matrix, work, measure = np.empty((MOST_PANELS, MOST_PANELS)), np.empty((8, MOST_PANELS)), np.empty(MOST_PANELS)
    return np.empty((most, 6)), keys, spare, heads, gap, chord, straight, parts, panels, matrix, work, measure


@_kernel
def _sort(keys, spare, heads, count):  # type: ignore[no-untyped-def]
    """Rising keys: into buckets by their first bits, then by insertion, which has little left to do."""
    bits = 0
    while (1 << bits) < count:
        bits += 1
    shift = _PLACES + _INDEX - bits
    buckets = (1 << bits) + 1  # the last for an arc length of all
    heads[: buckets + 1] = 0
    for k in range(count):
        heads[(keys[k] >> shift) + 1] += 1
    for b in range(buckets):
        heads[b + 1] += heads[b]
    for k in range(count):
        b = keys[k] >> shift
        spare[heads[b]] = keys[k]
        heads[b] += 1
    moves = _MOVES * count
    for k in range(count):
        key, place = spare[k], k
        while place > 0 and keys[place - 1] > key:
            keys[place] = keys[place - 1]
            place -= 1
        keys[place] = key
        moves -= k - place
        if moves < 0:
            keys[:count] = spare[:count]
            keys[:count].sort()
            return


@_kernel
def _sorted(seen, count, loops, keys, spare, heads, ordered):  # type: ignore[no-untyped-def]
    """Samples by rising arc length without repeats, and without those of which the loop cannot be told."""
    total, used = loops[-1], 0
    for k in range(count):
        arc = min(max(seen[k, 0], 0.0), total)
        if len(loops) == 1 and arc >= total * (1.0 - _SAME):
            arc = 0.0  # the loop's first vertex by way of its last edge
        seen[k, 0] = arc
        keep = True
        for loop in range(len(loops) - 1):
            keep &= abs(arc - loops[loop]) > _SAME * total
        keys[used] = (np.int64(arc / total * 2.0**_PLACES) << _INDEX) | k
        used += keep
    _sort(keys, spare, heads, used)
    kept = 0
    for place in range(used):
        k = keys[place] & ((1 << _INDEX) - 1)
        if kept and seen[k, 0] - ordered[kept - 1, 0] <= _SAME * total:
            here = ordered[kept - 1]  # of several ways the same one, in whatever order the walks came
            unknown = here[4] == 0.0 and here[5] == 0.0
            if (seen[k, 4] != 0.0 or seen[k, 5] != 0.0) and (
                unknown or seen[k, 4] > here[4] or (seen[k, 4] == here[4] and seen[k, 5] > here[5])
            ):
                here[4], here[5] = seen[k, 4], seen[k, 5]
            for axis in range(4):  # and of several places that are the same but for rounding
                if seen[k, axis] != here[axis]:
                    if seen[k, axis] < here[axis]:
                        here[:4] = seen[k, :4]
                    break
            continue
        ordered[kept] = seen[k]
        kept += 1
    return kept


@_kernel
def average(seen, count, loops, step, fade, least, again, space):  # type: ignore[no-untyped-def]
    """Mean of the values that were seen under the harmonic measure of the boundary that was.

    Parameters
    ----------
    seen : (k, 6) float64
        Samples in any order: arc length, x and y from the query, value, and the way that led there (zeros where it is
        not known). Arc lengths are brought into the boundary's range.
    count : int
        How many of them there are.
    loops : (l,) float64
        Arc length at the end of each loop.
    step, fade, least : float
        See `WalkFit`.
    again : bool
        The same places as in the last call with other values, so that the measure is known.
    space : tuple of arrays
        See `room_for`.

    Returns
    -------
    value, hidden, lost : float
        The mean; the part of the measure on boundary of which shape or values are a guess; measure below zero that was
        cut off.
    panels : int
        Size of the system; 0 where there is no answer.
    """
    ordered, keys, spare, heads, gap, chord, straight, parts, panels, matrix, work, measure = space
    nothing = (np.nan, 1.0, np.inf, 0)
    count = _sorted(seen, count, loops, keys, spare, heads, ordered)
    if count < 2:
        return nothing
    made = parts_of(ordered[:count], loops, fade, gap, chord, straight, parts)
    reach, near = 0.0, np.inf
    for i in range(made):
        reach = max(reach, abs(parts[i, 0]), abs(parts[i, 1]))
        near = min(near, parts[i, 0] ** 2 + parts[i, 1] ** 2)
    shortest = max(least * math.sqrt(near), _NEAREST * reach)
    pace, m = step, -1
    while m < 0:  # longer panels until there is room
        m = panels_of(parts, made, 0.0, 0.0, shortest, pace, panels)
        pace *= 1.5
    if m < 2:
        return nothing
    lost = 0.0
    if not again:
        lost = harmonic_measure(panels[:m], 0.0, 0.0, 0.5 / (_REACH * reach), matrix, work, measure[:m])
    if not lost < np.inf:
        return nothing
    # From the first value on, so that a constant stays that constant to the last bit.
    level, total, hidden = panels[0, 4], 0.0, 0.0
    for j in range(m):
        total += measure[j] * (panels[j, 4] - level)
        hidden += measure[j] * panels[j, 5]
    return level + total, hidden, lost, m
