"""The slabs of a grid: what is known of where to look, before each round of samples.

A slab is all cells of a group that share their place on the group's first axis. An application that knows something
of slabs (which light lies there, and how much it could bring) derives from `Slabs`; the plain ones know nothing.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Observation, Problem

__all__ = ["Slabs"]


class Slabs:
    """What a grid head sees beside its state; these slabs know nothing.

    Attributes
    ----------
    size : int
        Quantities of a slab.
    context : int
        Quantities of an integral, which every token holds.

    Parameters
    ----------
    problem : Problem
        B integrals.
    n : int
        Samples that will be placed.
    counts : tuple of int
        Slabs of each group.
    """

    size: ClassVar[int] = 0
    context: ClassVar[int] = 0

    def __init__(self, problem: Problem, n: int, counts: tuple[int, ...]) -> None:
        self.problem, self.n, self.counts = problem, n, counts

    def ahead(self) -> Tensor:
        """Quantities of all slabs, group after group, (B, sum(counts), size) float32."""
        return torch.zeros(self.problem.batch, sum(self.counts), self.size, device=self.problem.rows.device)

    def seen(self) -> Tensor:
        """Quantities of the integrals, (B, context) float32."""
        return torch.zeros(self.problem.batch, self.context, device=self.problem.rows.device)

    def evaluate(self, x: Tensor) -> Observation:
        """Observe the problem at x (B, k, D)."""
        return self.problem.evaluate(x)

    def note(self, seen: Observation) -> None:
        """Take note of a round of samples."""
