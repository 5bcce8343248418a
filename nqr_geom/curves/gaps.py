"""What a gap between samples on a curve shows to a sampling network: its size, seen from the query."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from nqr_geom.curves import hermite
from nqr_geom.curves.problems import CurveProblem, SdProblem
from nqr_geom.integrator.learn.gaps import Gaps
from nqr_geom.integrator.problem import Observation, Problem, Samples

__all__ = ["CurveGaps", "SdGaps"]

_UNSEEN = 4.0  # size over distance that a gap counts with before either end is known
_NEAREST = 0.1  # sizes over distance beyond the inverse of this are all alike
_FAR = 8.0  # units of 1/alpha beyond which gaps are alike
_TINY = 1e-280


def _log(ratio: Tensor) -> Tensor:
    return ratio.clamp(1e-12, 1e12).log() / 3.0


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _turn(a: Tensor, b: Tensor) -> Tensor:
    """Angle from a to b in turns of pi."""
    return torch.atan2(_cross(a, b), (a * b).sum(-1)) / math.pi


class CurveGaps(Gaps):
    """Gaps within the pieces of a curve; `worth` is how large a gap looks from the query.

    Lengths are measured in distances from the query and directions against the line of sight, so nothing depends on
    the place, the size or the direction of curve and query together.

    Parameters
    ----------
    problem : Problem
        On curves.
    n : int
        Samples that will be placed.

    Raises
    ------
    ValueError
        If the problem is not one on curves.
    """

    size: ClassVar[int] = 17

    def __init__(self, problem: Problem, n: int) -> None:
        if not isinstance(problem, CurveProblem):
            raise ValueError(f"sampler: expected a problem on curves, got {problem.name!r}")
        self.pieces = problem.shapes.pieces[problem.shape][:, None].double()
        super().__init__(problem, n)
        slots = self.open.shape
        self.known = torch.zeros(*slots, 2, dtype=torch.bool, device=self.left.device)
        self.r, self.t = self.left.new_zeros(2, *slots, 2, 2).unbind()
        self.looks = self.left.new_full(slots, _UNSEEN)
        self.nearest, self.length = self.left.new_zeros(2, *slots).unbind()
        self._fill(slice(0, self.start))

    def walls(self, problem: Problem) -> Tensor:
        ends = torch.arange(int(self.pieces.max()) + 1, device=problem.rows.device) / self.pieces
        return ends.clamp_max(1.0)

    def worth(self) -> Tensor:
        return self.looks[:, : self.used].log()

    def enter(self, slot: Tensor, x: Tensor, seen: Observation, new: slice) -> None:
        at = torch.arange(len(x), device=x.device)
        r = seen.features["relative"][:, 0, 0]
        t = hermite.tangents(Samples(x[:, None, None], seen, None, "snet"), "snet")[:, 0]
        for table, value in ((self.r, r), (self.t, t)):
            table[:, new] = torch.stack([table[at, slot], value[:, None].expand_as(table[at, slot])], dim=1)
            # The new sample is the right end of the left part and the left end of the right one.
            table[:, new.start, 1], table[:, new.start + 1, 0] = value, value
            table[:, new.start + 1, 1] = table[at, slot, 1]
        self.known[:, new.start, 0], self.known[:, new.start, 1] = self.known[at, slot, 0], True
        self.known[:, new.start + 1, 0], self.known[:, new.start + 1, 1] = True, self.known[at, slot, 1]
        self._fill(new)

    def _fill(self, new: slice) -> None:
        h = (self.right[:, new] - self.left[:, new]).clamp_min(0.0)
        known, r, t = self.known[:, new], self.r[:, new], self.t[:, new]
        ends, both, some = known.sum(dim=-1), known.all(dim=-1), known.any(dim=-1)
        speed = torch.linalg.vector_norm(t, dim=-1).clamp_min(_TINY)
        distance = torch.linalg.vector_norm(r, dim=-1).clamp_min(_TINY)
        length = h * (speed * known).sum(dim=-1) / ends.clamp_min(1)
        # Of an end that is not known, the tangent of the other one tells.
        h2 = h[..., None]
        start = torch.where(known[..., 0, None], r[..., 0, :], r[..., 1, :] - h2 * t[..., 1, :])
        end = torch.where(known[..., 1, None], r[..., 1, :], r[..., 0, :] + h2 * t[..., 0, :])
        guess = torch.stack([start, end], dim=-2)
        bend = h2 * (t[..., 0, :] - t[..., 1, :]) / 8.0
        middle = guess.mean(dim=-2) + torch.where(both[..., None], bend, 0.0)
        points = torch.cat([guess, middle[..., None, :]], dim=-2)
        nearest = torch.linalg.vector_norm(points, dim=-1).amin(dim=-1).clamp_min(_TINY)
        self.nearest[:, new], self.length[:, new] = nearest, length
        looks = length / (nearest + _NEAREST * length).clamp_min(_TINY) * torch.where(both, 1.0, 2.0)
        # Its share of the piece counts too: far pieces want a few samples as well.
        self.looks[:, new] = (torch.where(some, looks, _UNSEEN) + h * self.pieces).clamp_min(1e-12)
        unit_t, sight = t / speed[..., None], r / distance[..., None]
        along, across = (unit_t * sight).sum(dim=-1), _cross(sight, unit_t)
        zero = h.new_zeros(())
        parts = [
            _log(h * self.pieces),
            *known.double().unbind(dim=-1),
            torch.where(some, _log(length / nearest), zero),
            *torch.where(known, _log(length[..., None] / distance), zero).unbind(dim=-1),
            *torch.where(known, along, zero).unbind(dim=-1),
            *torch.where(known, across, zero).unbind(dim=-1),
            torch.where(both, _turn(r[..., 0, :], r[..., 1, :]), zero),
            torch.where(both, _turn(t[..., 0, :], t[..., 1, :]), zero),
            torch.where(both, _turn(r[..., 0, :], middle), zero),
            torch.where(both, _turn(middle, r[..., 1, :]), zero),
            torch.where(both, _log(distance[..., 0] / distance[..., 1]), zero),
            self.looks[:, new].log() / 3.0,
            h * self.pieces,
        ]
        self.features[:, new, : CurveGaps.size] = torch.stack(parts, dim=-1).float()


class SdGaps(CurveGaps):
    """Gaps of a smoothed distance; `worth` is what a gap may add to the integral of exp(-alpha (d - nearest)).

    Parameters
    ----------
    problem : Problem
        A smoothed distance.
    n : int
        Samples that will be placed.
    """

    size: ClassVar[int] = CurveGaps.size + 3

    def __init__(self, problem: Problem, n: int) -> None:
        if not isinstance(problem, SdProblem):
            raise ValueError(f"sampler: expected a smoothed distance, got {problem.name!r}")
        self.alpha = problem.alpha
        super().__init__(problem, n)

    def worth(self) -> Tensor:
        used = slice(0, self.used)
        some = self.known[:, used].any(dim=-1)
        best = torch.where(self.open[:, used] & some, self.nearest[:, used], math.inf).amin(dim=1, keepdim=True)
        behind = torch.where(some & best.isfinite(), self.alpha * (self.nearest[:, used] - best), 0.0)
        share = ((self.right - self.left)[:, used] * self.pieces).clamp_min(1e-12)
        # A wide gap may hide a part of the curve that is closer than its ends.
        hidden = (behind - 0.5 * self.alpha * self.length[:, used]).clamp(0.0, _FAR)
        return torch.where(some, share.log() - hidden, math.log(_UNSEEN))

    def _fill(self, new: slice) -> None:
        super()._fill(new)
        some = self.known[:, new].any(dim=-1)
        best = torch.where(self.known.any(dim=-1), self.nearest, math.inf).amin(dim=1, keepdim=True)
        behind = torch.where(some, self.alpha * (self.nearest[:, new] - best), 0.0)
        seen = torch.where(some, self.alpha * self.length[:, new], 0.0)
        own = [
            behind.clamp(0.0, 1e3).log1p(),
            seen.log1p(),
            torch.where(some, _log(self.alpha * self.nearest[:, new]), 0.0),
        ]
        self.features[:, new, CurveGaps.size :] = torch.stack(own, dim=-1).float()
