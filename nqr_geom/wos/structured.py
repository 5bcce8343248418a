"""A rule for walks: the boundary they have seen is rebuilt, and the solution there is an average under its measure.

A walk sees a closest boundary point with its value before every step, some ten times as many as the one it ends at.
From them the boundary is rebuilt (`rebuild`), cut into few panels as the query sees them (`panels`), and the harmonic
measure of the panels is computed (`harmonic`): the probability that Brownian motion from the query first meets each.
The mean of the values under it is the answer. What is left of the error comes from boundary that no walk came near.

The answer is an average of values, so it obeys the maximum principle and constants are exact; and it asks nothing of
how the walks are distributed, so they may be as well spread as a sampler can make them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.curves._rows import over_rows
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.integrator.sums import row_mean
from nqr_geom.wos.harmonic import harmonic_measure
from nqr_geom.wos.panels import panels_of
from nqr_geom.wos.rebuild import parts_of, room
from nqr_geom.wos.record import SEEN
from nqr_geom.wos.tokens import boundary_values

__all__ = ["Fit", "WalkFit", "fitted"]

Floats = NDArray[np.float64]

MOST_PANELS = 256
_SAME = 1e-9  # arc lengths nearer than this, relative to all, are one sample
_NEAREST = 1e-5  # no panel is shorter than this part of the farthest distance
_REACH = 3.0  # the farthest part lies at 1/2 in the frame of the system times this, so that it is positive definite

_kernel = njit(cache=True, nogil=True, error_model="numpy")


class Fit(NamedTuple):
    """Answers of the rule for B queries.

    Attributes
    ----------
    value : (B, C) float64
        The averages; NaN where there is none.
    hidden : (B,) float64
        How much of the measure lies on boundary of which shape or values are a guess.
    lost : (B,) float64
        Measure below zero that was cut off: what the rebuilt boundary asks for and no motion can have.
    panels : (B,) int64
        Size of the system.
    """

    value: Floats
    hidden: Floats
    lost: Floats
    panels: NDArray[np.int64]


@_kernel
def _collected(steps, known, end, value, loops, seen):  # type: ignore[no-untyped-def]
    """All closest points of a query's walks, unordered: arc length, x, y, value, way there; returns their number."""
    count, total = 0, loops[-1]
    for w in range(steps.shape[0]):
        for j in range(steps.shape[1] + 1):
            row = seen[count]
            if j == steps.shape[1] or steps[w, j, 9] == 0.0:
                row[0], row[1], row[2], row[3] = end[w, 3], end[w, 0], end[w, 1], value[w]
                row[4] = row[5] = 0.0
            else:
                one = steps[w, j]
                row[0], row[1], row[2], row[3] = one[3], one[5], one[6], known[w, j]
                row[4], row[5] = one[0], one[1]
            row[0] = min(max(row[0], 0.0), total)
            keep = True
            for k in range(len(loops) - 1):  # which of two loops a point between them belongs to cannot be told
                keep &= abs(row[0] - loops[k]) > _SAME * total
            count += keep
            if j < steps.shape[1] and steps[w, j, 9] == 0.0:
                break
    return count


@_kernel
def _sorted(seen, count, total, keys, ordered):  # type: ignore[no-untyped-def]
    """Samples by rising arc length without repeats."""
    # Arc length in 40 bits and the index below it: one array of integers to sort.
    for k in range(count):
        keys[k] = (np.int64(seen[k, 0] / total * 2.0**40) << 22) | k
    keys[:count].sort()
    kept = 0
    for place in range(count):
        k = keys[place] & 0x3FFFFF
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


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_rows(  # type: ignore[no-untyped-def]
    steps, known, end, value, loops, step, fade, least, low, high, answer, hidden, lost, size
):
    """Rows low .. high: geometry is the same for all boundary values, and so is the measure."""
    most = steps.shape[1] * (steps.shape[2] + 1)
    seen, ordered, keys = np.empty((most, 6)), np.empty((most, 6)), np.empty(most, dtype=np.int64)
    gap, chord, straight = np.empty(most), np.empty(most), np.empty(most, dtype=np.bool_)
    parts, panels = np.empty((room(most), 7)), np.empty((MOST_PANELS, 6))
    matrix, work, measure = np.empty((MOST_PANELS, MOST_PANELS)), np.empty((6, MOST_PANELS)), np.empty(MOST_PANELS)
    for b in range(low, high):
        answer[b], hidden[b], lost[b], size[b] = np.nan, 1.0, np.inf, 0
        for c in range(value.shape[2]):
            count = _collected(steps[b], known[b, :, c], end[b], value[b, :, c], loops[b], seen)
            count = _sorted(seen, count, loops[b, -1], keys, ordered)
            if count < 2:
                break
            made = parts_of(ordered[:count], loops[b], fade, gap, chord, straight, parts)
            if c == 0:
                reach, near = 0.0, np.inf
                for i in range(made):
                    reach = max(reach, abs(parts[i, 0]), abs(parts[i, 1]))
                    near = min(near, parts[i, 0] ** 2 + parts[i, 1] ** 2)
                shortest = max(least * np.sqrt(near), _NEAREST * reach)
            pace, m = step, -1
            while m < 0:  # longer panels until there is room
                m = panels_of(parts, made, 0.0, 0.0, shortest, pace, panels)
                pace *= 1.5
            if m < 2:
                break
            if c == 0:
                lost[b] = harmonic_measure(panels[:m], 0.0, 0.0, 0.5 / (_REACH * reach), matrix, work, measure[:m])
                if not lost[b] < np.inf:
                    break
                size[b] = m
            # From the first value on, so that a constant stays that constant to the last bit.
            level, total, guess = panels[0, 4], 0.0, 0.0
            for j in range(m):
                total += measure[j] * (panels[j, 4] - level)
                guess += measure[j] * panels[j, 5]
            answer[b, c] = level + total
            if c == 0:
                hidden[b] = guess


def fitted(
    steps: Floats, known: Floats, end: Floats, value: Floats, loops: Floats, *, step: float, fade: float, least: float
) -> Fit:
    """The rule on arrays: what `LaplaceProblem` tells of (B, N) walks of D steps.

    Parameters
    ----------
    steps : (B, N, D, 10) float64
        What was seen before every step, boundary values aside.
    known : (B, N, C, D) float64
        Boundary values of C kinds before every step.
    end, value : (B, N, 4) and (B, N, C) float64
        Where walks ended, and the boundary values there.
    loops : (B, L) float64
        Arc length at the end of each loop.
    step, fade, least : float
        See `WalkFit`.
    """
    batch = len(steps)
    result = Fit(np.empty((batch, value.shape[2])), np.empty(batch), np.empty(batch), np.empty(batch, dtype=np.int64))
    arrays = (np.ascontiguousarray(array) for array in (steps, known, end, value, loops))
    inputs: tuple[Any, ...] = (*arrays, step, fade, least)
    rows: Any = _fit_rows
    over_rows(lambda i, j: rows(*inputs, i, j, *result), batch)
    return result


@dataclass(frozen=True)
class WalkFit(Rule):
    """Mean of boundary values under the harmonic measure of the boundary that the walks have seen.

    Parameters
    ----------
    step : float
        Length of a panel over its distance from the query.
    fade : float
        Length over which values in hidden parts fall back to the mean of what was seen, as a part of the boundary.
    least : float
        Distances from the query below this part of the nearest sample's count as this.
    doubt : float
        Where more measure than this had to be cut off below zero, the mean of the walks in uniform directions is given
        instead, and flagged.

    References
    ----------
    Section 7 of the paper asks for a rule that matches its networks; the measure is that of Kakutani, 1944.

    Examples
    --------
    >>> from nqr_geom.integrator.samplers import LatinHypercube
    >>> from nqr_geom.streams import Stream
    >>> from nqr_geom.wos.problems import LaplaceProblem
    >>> problem = LaplaceProblem.family(4, points=16)
    >>> samples = LatinHypercube().draw(problem, 32, Stream(0))
    >>> error = WalkFit().combine(samples).estimate(samples).numpy() - problem.reference()
    >>> bool((error**2).mean() < 3e-5)
    True
    """

    step: float = 0.25
    fade: float = 0.07
    least: float = 0.5
    doubt: float = 0.2

    name = "walk-fit"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        batch, n = samples.x.shape[:2]
        steps = samples.feature("steps", self.name).reshape(batch, n, -1, sum(SEEN.values()))
        end, loops = samples.feature("end", self.name)[:, :, 0], samples.feature("loops", self.name)[:, 0, 0]
        value, known = samples.value[:, :, 0], boundary_values(samples)[:, :, 0]  # (B, N, C) and (B, N, C, D)
        arrays = (tensor.cpu().numpy() for tensor in (steps, known, end, value, loops))
        fit = fitted(*arrays, step=self.step, fade=self.fade, least=self.least)
        plain = torch.from_numpy(~(fit.lost <= self.doubt)).to(value.device)
        weights, answer = _plain_weights(samples), torch.from_numpy(fit.value).to(value)
        # What to add to the plain mean: nothing where that is the answer.
        offset = torch.where(plain[:, None], 0.0, answer - row_mean(weights[..., None] * value))
        doubt = torch.from_numpy(fit.hidden).to(value.device).clamp(0.0, 1.0)
        return Combination(weights[..., None, None].expand_as(samples.value), offset, plain, doubt=doubt)


def _plain_weights(samples: Samples) -> Tensor:
    """Weights (B, N) of the plain mean: of all walks, or of the uniform ones where a sampler prefers directions."""
    if samples.pdf is None:
        return torch.ones_like(samples.value[:, :, 0, 0])
    uniform = (samples.pdf[..., 0] == 1.0).double()
    share = uniform.mean(dim=1, keepdim=True)
    return torch.where(share > 0.0, uniform / share, 1.0)
