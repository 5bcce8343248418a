"""The gaps between samples that are placed one after the other on [0, 1]: what a sampler chooses among.

A cut closes its gap and opens two, each in a slot of its own, so that every gap there ever was can be looked up again
when a whole sequence is scored. An application derives from `Gaps` and says what a gap looks like and what it is worth.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Observation, Problem

__all__ = ["Gaps"]


class Gaps(ABC):
    """Gaps of B integrals in S slots, the first `start` of them open at the beginning.

    Attributes
    ----------
    size : int
        Features of a gap.
    left, right : Tensor, (B, S), float64
        Ends.
    open : Tensor, (B, S), bool
        Whether the slot holds a gap now.
    features : Tensor, (B, S, size), float32
        What a network reads of the gap; filled when it opens.
    used : int
        Slots filled so far.

    Parameters
    ----------
    problem : Problem
        B integrals in one dimension.
    n : int
        Samples that will be placed.
    """

    size: ClassVar[int]

    def __init__(self, problem: Problem, n: int) -> None:
        walls = self.walls(problem)
        self.start = walls.shape[1] - 1
        slots = self.start + 2 * n
        self.left, self.right = walls.new_zeros(2, problem.batch, slots).unbind()
        self.open = torch.zeros(problem.batch, slots, dtype=torch.bool, device=walls.device)
        self.features = torch.zeros(problem.batch, slots, self.size, device=walls.device)
        self.left[:, : self.start], self.right[:, : self.start] = walls[:, :-1], walls[:, 1:]
        self.open[:, : self.start] = walls.diff(dim=1) > 0.0
        self.used = self.start

    def walls(self, problem: Problem) -> Tensor:
        """Ends of the gaps to begin with, (B, W + 1) rising from 0 to 1; gaps of no width stay closed."""
        ends = torch.tensor([0.0, 1.0], dtype=torch.float64, device=problem.rows.device)
        return ends.expand(problem.batch, 2)

    @abstractmethod
    def worth(self) -> Tensor:
        """Logarithm of what the structured sampler expects of a sample in each used slot, (B, used) float64."""

    @abstractmethod
    def enter(self, slot: Tensor, x: Tensor, seen: Observation, new: slice) -> None:
        """Fill the features of the `new` slots left and right of x (B,), which was observed in `slot` (B,)."""

    def cut(self, slot: Tensor, x: Tensor, seen: Observation) -> Tensor:
        """Cut the gaps in `slot` (B,) at x (B,), where `seen` was observed; features of both parts, (B, 2 size)."""
        at = torch.arange(len(x), device=x.device)
        new = slice(self.used, self.used + 2)
        self.left[:, new] = torch.stack([self.left[at, slot], x], dim=1)
        self.right[:, new] = torch.stack([x, self.right[at, slot]], dim=1)
        self.open[at, slot] = False
        self.open[:, new] = self.right[:, new] > self.left[:, new]
        self.used += 2
        self.enter(slot, x, seen, new)
        return self.features[:, new].flatten(1)

    def containing(self, x: Tensor) -> Tensor:
        """Slot of the open gap that holds each x (B,)."""
        used = slice(0, self.used)
        inside = self.open[:, used] & (self.left[:, used] <= x[:, None]) & (x[:, None] < self.right[:, used])
        return inside.to(torch.uint8).argmax(dim=1)
