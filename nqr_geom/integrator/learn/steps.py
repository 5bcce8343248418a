"""The step-level head: a walk is chosen step by step, each from all that was seen before it (Fig. 30, Eq. 11).

The state that the transformer reached over the earlier walks starts a gated recurrent unit. Before every step it reads
what the walk sees there and gives the density of the next direction: piecewise constant on the circle, turned by
an angle that the walk names (towards the nearest boundary, say), so that it does not depend on the choice of axes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from nqr_geom.integrator.learn.heads import Head, floored, pick
from nqr_geom.integrator.problem import Observation, Problem, WalkProblem

__all__ = ["StepHead", "Walks"]


class Walks(ABC):
    """What walks show before each step.

    Attributes
    ----------
    size : int
        Quantities a step.

    Parameters
    ----------
    problem : WalkProblem
        Whose walks these are.
    """

    size: ClassVar[int]

    def __init__(self, problem: WalkProblem) -> None:
        self.problem = problem

    @abstractmethod
    def look(self, state: Any, step: int) -> tuple[Tensor, Tensor, Tensor]:
        """Quantities (B, size) float32, an angle (B,) in turns, and whether the walk goes on (B,), of one walk each."""


class StepHead(Head):
    """One coordinate of the cube after the other, each a direction in turns.

    Parameters
    ----------
    width : int
        Of the transformer's states and of the recurrent unit.
    dim : int
        Steps.
    bins : int
        Of a direction's density.
    floor : float
        Part of each direction's density that is uniform.
    walks : callable
        A problem to its `Walks`.
    """

    def __init__(self, width: int, dim: int, bins: int, floor: float, walks: type[Walks]) -> None:
        super().__init__()
        self.walks, self.dim, self.bins, self.floor = walks, dim, bins, floor
        self.begin_unit, self.unit = nn.Linear(width, width), nn.GRUCell(walks.size, width)
        self.logits = nn.Linear(width, bins)
        nn.init.zeros_(self.logits.weight)
        nn.init.zeros_(self.logits.bias)
        self.numbers = 2 * dim
        self.extra = 0

    def begin(self, problem: Problem, n: int) -> Walks:
        if not isinstance(problem, WalkProblem):
            raise ValueError(f"problem: expected one of walks, got {problem.name!r}")
        return self.walks(problem)

    def _density(self, log: Tensor, bin_: Tensor, alive: Tensor) -> Tensor:
        """Logarithm of a direction's density; that of a walk which has ended is uniform."""
        inside = log.gather(-1, bin_[..., None])[..., 0] + math.log(self.bins)
        return torch.where(alive, floored(inside, self.floor), 0.0)

    def choose(self, kept: Walks, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        hidden = torch.tanh(self.begin_unit(state))
        walk = kept.problem.start(1)
        x, total = [], torch.zeros_like(u[:, 0])
        record: dict[str, list[Tensor]] = {"seen": [], "bin": [], "alive": []}
        for j in range(self.dim):
            seen, turn, alive = kept.look(walk, j)
            hidden = self.unit(seen, hidden)
            log = self.logits(hidden).float().log_softmax(dim=-1)
            bin_, rest = pick(log.exp(), u[:, 2 * j])
            # What is left of the first number is uniform again: it decides whether the direction is.
            free = (rest < self.floor) | ~alive
            v = torch.where(free, u[:, 2 * j + 1], (bin_ + u[:, 2 * j + 1]) / self.bins)
            bin_ = (v * self.bins).long().clamp_max(self.bins - 1)
            total = total + self._density(log, bin_, alive).double()
            x.append(torch.frac(v + turn).clamp(0.0, 1.0 - 2.0**-53))
            walk = kept.problem.step(walk, x[-1][:, None])
            for name, value in (("seen", seen), ("bin", bin_), ("alive", alive)):
                record[name].append(value)
        return torch.stack(x, dim=1), total.exp(), {name: torch.stack(part, dim=1) for name, part in record.items()}

    def observe(self, kept: Walks, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        return x.new_zeros(len(x), 0).float()

    def trace(self, kept: Walks, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        return {name: torch.stack([record[name] for record in records], dim=1) for name in records[0]}

    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        batch, n = states.shape[:2]
        hidden = torch.tanh(self.begin_unit(states)).flatten(0, 1)
        total = torch.zeros(batch * n, device=states.device)
        seen, bin_, alive = (trace[name].flatten(0, 1) for name in ("seen", "bin", "alive"))
        for j in range(self.dim):
            hidden = self.unit(seen[:, j], hidden)
            total = total + self._density(self.logits(hidden).float().log_softmax(dim=-1), bin_[:, j], alive[:, j])
        return total.view(batch, n)
