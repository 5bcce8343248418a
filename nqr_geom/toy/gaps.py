"""What a gap between samples of a piecewise smooth function shows to a sampling network."""

from __future__ import annotations

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


class ToyGaps(Gaps):
    """Gaps with the quantities by which `ToySplit` chooses; `worth` is its expected squared error.

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
        self.placed = 0
        index = torch.zeros(3, *self.open.shape, dtype=torch.int64, device=self.left.device)
        self.from_, self.to, self.piece = index.unbind()
        self.score, self.idle = self.left.new_zeros(2, *self.open.shape).unbind()
        self._fill(slice(0, 1), torch.zeros_like(index[0, :, :1]), torch.ones_like(index[0, :, :1]))

    def worth(self) -> Tensor:
        used = slice(0, self.used)
        settled = self.seen.settled.gather(1, self.piece[:, used]) > 2.5
        return torch.where(settled, self.idle[:, used], self.score[:, used]).clamp_min(_FLOOR).log()

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
