"""A rule for walks: the boundary they have seen is rebuilt, and the solution there is an average under its measure.

A walk sees a closest boundary point with its value before every step, some ten times as many as the one it ends at.
From them the boundary is rebuilt (`rebuild`), cut into few panels as the query sees them (`panels`), and the harmonic
measure of the panels is computed (`harmonic`): the probability that Brownian motion from the query first meets each.
The mean of the values under it is the answer. What is left of the error comes from boundary that no walk came near.

The answer is an average of values, so it obeys the maximum principle and constants are exact; and it asks nothing of
how the walks are distributed, so they may be as well spread as a sampler can make them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.integrator.sums import row_mean
from nqr_geom.rows import over_rows
from nqr_geom.wos.average import average, room_for
from nqr_geom.wos.explore import NUMBERS
from nqr_geom.wos.record import ALIVE, SEEN
from nqr_geom.wos.tokens import boundary_values

__all__ = ["Fit", "WalkFit", "fitted"]

Floats = NDArray[np.float64]

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
def _collected(steps, known, end, value, rim, seen):  # type: ignore[no-untyped-def]
    """Closest points of a query's walks until each comes within the rim, as `explored` finds them; their number."""
    count = 0
    for w in range(steps.shape[0]):
        for j in range(steps.shape[1] + 1):
            row = seen[count]
            count += j > 0 or w == 0  # all walks begin with the same point
            if j == steps.shape[1] or steps[w, j, ALIVE] == 0.0:
                row[0], row[1], row[2], row[3] = end[w, 3], end[w, 0], end[w, 1], value[w]
                row[4] = row[5] = 0.0
                break
            one = steps[w, j]
            row[0], row[1], row[2], row[3] = one[3], one[5], one[6], known[w, j]
            row[4], row[5] = one[0], one[1]
            if one[2] <= rim * math.sqrt(one[5] * one[5] + one[6] * one[6]):
                break
    return count


@_kernel
def _fit_rows(  # type: ignore[no-untyped-def]
    steps, known, end, value, loops, rim, step, fade, least, low, high, answer, hidden, lost, size
):
    """Rows low .. high: geometry is the same for all boundary values, and so is the measure."""
    most = steps.shape[1] * (steps.shape[2] + 1)
    seen, space = np.empty((most, NUMBERS)), room_for(most)
    for b in range(low, high):
        answer[b], hidden[b], lost[b], size[b] = np.nan, 1.0, np.inf, 0
        for c in range(value.shape[2]):
            count = _collected(steps[b], known[b, :, c], end[b], value[b, :, c], rim, seen)
            found, guess, cut, m = average(seen, count, loops[b], step, fade, least, c > 0, space)
            if m == 0:
                break
            answer[b, c] = found
            if c == 0:
                hidden[b], lost[b], size[b] = guess, cut, m


def fitted(
    steps: Floats,
    known: Floats,
    end: Floats,
    value: Floats,
    loops: Floats,
    *,
    rim: float,
    step: float,
    fade: float,
    least: float,
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
    rim, step, fade, least : float
        See `WalkFit`.
    """
    batch = len(steps)
    result = Fit(np.empty((batch, value.shape[2])), np.empty(batch), np.empty(batch), np.empty(batch, dtype=np.int64))
    arrays = (np.ascontiguousarray(array) for array in (steps, known, end, value, loops))
    inputs: tuple[Any, ...] = (*arrays, rim, step, fade, least)
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
    rim : float
        Of a walk counts what it saw until the boundary was nearer to it than this times the distance between query and
        boundary there: what comes later lies in one place as the query sees it.

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
    rim: float = 0.02

    name = "walk-fit"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        batch, n = samples.x.shape[:2]
        steps = samples.feature("steps", self.name).reshape(batch, n, -1, sum(SEEN.values()))
        end, loops = samples.feature("end", self.name)[:, :, 0], samples.feature("loops", self.name)[:, 0, 0]
        value, known = samples.value[:, :, 0], boundary_values(samples)[:, :, 0]  # (B, N, C) and (B, N, C, D)
        arrays = (tensor.cpu().numpy() for tensor in (steps, known, end, value, loops))
        fit = fitted(*arrays, rim=self.rim, step=self.step, fade=self.fade, least=self.least)
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
