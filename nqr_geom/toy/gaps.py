"""What a gap between samples of a piecewise smooth function shows to a sampling network."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from nqr_geom.integrator.learn.gaps import Gaps
from nqr_geom.integrator.learn.tokens import compress
from nqr_geom.integrator.problem import Observation, Problem
from nqr_geom.toy.family import PIECES, Shape
from nqr_geom.toy.split import Gap, Seen

__all__ = ["ToyGaps"]

_FLOOR = 1e-24  # of an expected squared error
_MUST = 1e3  # added to a logarithm of worth: more than any network takes away
# Samples to keep for a piece with 0, 1 or 2 of them: a cut beside a hidden break lands on either side of it. Where a
# gap is known to lie in the piece, every cut lands in it.
_KEPT, _KEPT_SURE = (10.0, 8.0, 1.0), (3.0, 2.0, 1.0)


class ToyGaps(Gaps):
    """Gaps with the quantities by which `ToySplit` chooses; `worth` is its expected squared error.

    A piece whose law stays unknown costs 10^5 times what a break does. So no network may put it off for too long: when
    only as many samples are left as the unknown laws need, gaps in those pieces come before all others.

    Parameters
    ----------
    problem : Problem
        With the features of `ToyProblem`.
    n : int
        Samples that will be placed.
    """

    size: ClassVar[int] = 13

    def __init__(self, problem: Problem, n: int) -> None:
        super().__init__(problem, n)
        self.shape = Shape()
        self.seen = Seen.empty(self.left, n)
        self.n, self.placed = n, 0
        index = torch.zeros(3, *self.open.shape, dtype=torch.int64, device=self.left.device)
        self.from_, self.to, self.piece = index.unbind()
        self.ends = torch.zeros(2, *self.open.shape, dtype=torch.int64, device=self.left.device)  # pieces at both ends
        # Whether a piece has a gap that lies in it, and two samples that tell its law by themselves.
        self.sure, self.told = self.left.new_zeros(2, self.left.shape[0], PIECES + 1).unbind()
        self.score, self.idle = self.left.new_zeros(2, *self.open.shape).unbind()
        self._fill(slice(0, 1), torch.zeros_like(index[0, :, :1]), torch.ones_like(index[0, :, :1]))

    def worth(self) -> Tensor:
        used = slice(0, self.used)
        settled = self.seen.settled.gather(1, self.piece[:, used]) > 2.5
        worth = torch.where(settled, self.idle[:, used], self.score[:, used]).clamp_min(_FLOOR).log()
        count = self.seen.settled[:, :PIECES].long().clamp_max(3)
        sure = self.sure[:, :PIECES] > 0.0
        kept = torch.where(sure, worth.new_tensor([*_KEPT_SURE, 0.0])[count], worth.new_tensor([*_KEPT, 0.0])[count])
        kept = torch.where((count == 2) & (self.told[:, :PIECES] > 0.0), 0.0, kept)
        late = self.n - self.placed <= kept.sum(dim=1)
        if not bool(late.any()):
            return worth
        wanted = (kept > 0.0) & late[:, None]
        piece = torch.arange(PIECES, device=kept.device)
        low, high = (ends[:, used, None] for ends in self.ends)
        inside = (low == piece) & (high == piece)
        must = (torch.where(sure[:, None], inside, (low <= piece) & (piece <= high)) & wanted[:, None]).any(dim=-1)
        return torch.where(must, worth + _MUST, worth)

    def enter(self, slot: Tensor, x: Tensor, seen: Observation, new: slice) -> None:
        at = torch.arange(len(x), device=x.device)
        middle = torch.full_like(slot, self.placed + 2)
        self.seen.enter(self.placed + 2, x[:, None], seen)
        self.placed += 1
        left = torch.stack([self.from_[at, slot], middle], dim=1)
        self._fill(new, left, torch.stack([middle, self.to[at, slot]], dim=1))

    def _fill(self, new: slice, left: Tensor, right: Tensor) -> None:
        gap = Gap.between(self.seen, left, right, self.shape)
        self.seen.settled.scatter_add_(1, gap.piece, 3.0 * gap.parabola.to(gap.width.dtype))
        self.from_[:, new], self.to[:, new] = left, right
        self.ends[0, :, new], self.ends[1, :, new] = gap.piece, gap.piece + gap.breaks
        smooth = (gap.breaks == 0).to(gap.width.dtype)
        near = smooth * gap.known.all(dim=-1) * (gap.width * self.shape.frequency[1] < math.tau)
        self.sure.scatter_reduce_(1, gap.piece, smooth, "amax")
        self.told.scatter_reduce_(1, gap.piece, near, "amax")
        self.piece[:, new] = torch.where(gap.breaks == 0, gap.piece, PIECES)
        self.score[:, new], self.idle[:, new] = gap.score, gap.idle
        unit = self.shape.jump
        parts = [
            gap.width.clamp_min(1e-15).log() / 4.0,
            *(2.0 * gap.known - 1.0).unbind(dim=-1),
            *(((gap.breaks == k) if k < 2 else (gap.breaks >= k)).double() for k in range(3)),
            gap.parabola.double(),
            *(compress(part, unit) for part in (gap.rise, gap.ahead, gap.behind, gap.off)),
            gap.score.clamp_min(_FLOOR).log() / 16.0,
            gap.piece / PIECES,
        ]
        self.features[:, new] = torch.stack(parts, dim=-1).float()
