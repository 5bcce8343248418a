"""The step-level head: a walk is chosen step by step, each from all that was seen before it (Fig. 30, Eq. 11).

The state that the transformer reached over the earlier walks starts a gated recurrent unit. Before every step it reads
what the walk sees there and gives the density of the next direction: piecewise constant on the circle, turned by
an angle that the walk names (towards the nearest boundary, say), so that it does not depend on the choice of axes. The
logarithm of the density is moreover linear in what is known of each direction, such as how many walks went there.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from nqr_geom.integrator.learn.heads import Head, floored, pick
from nqr_geom.integrator.problem import Observation, Problem, WalkProblem

__all__ = ["Look", "StepHead", "Walks"]


class Look(NamedTuple):
    """What B walks see before a step.

    Parameters
    ----------
    seen : Tensor, (B, size), float32
        Quantities of the place.
    ahead : Tensor, (B, bins, beside), float32
        Quantities of each direction.
    turn : Tensor, (B,), float64
        Where the first direction lies, in turns.
    open : Tensor, (B,), bool
        Whether the direction is the network's to choose; else it is uniform.
    """

    seen: Tensor
    ahead: Tensor
    turn: Tensor
    open: Tensor


class Walks(ABC):
    """What walks that are made one after the other show before each of their steps.

    Attributes
    ----------
    size : int
        Quantities of a place.
    base : tuple of float
        One for each quantity of a direction: what the logarithm of the density is linear in, in the untrained network.

    Parameters
    ----------
    problem : WalkProblem
        Whose walks these are.
    n : int
        Walks that will be made.
    bins : int
        Directions.
    """

    size: ClassVar[int]
    base: ClassVar[tuple[float, ...]]

    def __init__(self, problem: WalkProblem, n: int, bins: int) -> None:
        self.problem, self.n, self.bins = problem, n, bins

    @abstractmethod
    def look(self, state: Any, step: int) -> Look:
        """What is known before a step."""

    def step(self, state: Any, x: Tensor) -> Any:
        """Advance by one step with x (B, 1) in [0, 1)."""
        return self.problem.step(state, x)

    @abstractmethod
    def note(self, bins: Tensor, seen: Observation) -> None:
        """Take note of a walk that was made, in directions (B, D)."""


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
        self.logits, self.query = nn.Linear(width, bins), nn.Linear(width, len(walks.base))
        for layer in (self.logits, self.query):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.register_buffer("base", torch.tensor(walks.base, dtype=torch.float32), persistent=False)
        self.numbers = 2 * dim
        self.extra = 0

    def begin(self, problem: Problem, n: int) -> Walks:
        if not isinstance(problem, WalkProblem):
            raise ValueError(f"problem: expected one of walks, got {problem.name!r}")
        return self.walks(problem, n, self.bins)

    def _log(self, hidden: Tensor, ahead: Tensor) -> Tensor:
        """Logarithm of the probabilities of directions."""
        worth = (ahead @ (self.query(hidden).float() + self.base)[..., None])[..., 0]
        return (self.logits(hidden).float() + worth).log_softmax(dim=-1)

    def _density(self, log: Tensor, bin_: Tensor, open_: Tensor) -> Tensor:
        """Logarithm of a direction's density, which is uniform where there is nothing to choose."""
        inside = log.gather(-1, bin_[..., None])[..., 0] + math.log(self.bins)
        return torch.where(open_, floored(inside, self.floor), 0.0)

    def choose(self, kept: Walks, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        hidden, u = torch.tanh(self.begin_unit(state)), u[:, 0]
        walk = kept.problem.start(1)
        x, total = [], torch.zeros_like(u[:, 0])
        record: dict[str, list[Tensor]] = {"seen": [], "ahead": [], "bin": [], "open": []}
        for j in range(self.dim):
            seen, ahead, turn, open_ = kept.look(walk, j)
            hidden = self.unit(seen, hidden)
            log = self._log(hidden, ahead)
            bin_, rest = pick(log.exp(), u[:, 2 * j])
            # What is left of the first number is uniform again: it decides whether the direction is.
            free = (rest < self.floor) | ~open_
            v = torch.where(free, u[:, 2 * j + 1], (bin_ + u[:, 2 * j + 1]) / self.bins)
            bin_ = (v * self.bins).long().clamp_max(self.bins - 1)
            total = total + self._density(log, bin_, open_).double()
            x.append(torch.remainder(v + turn, 1.0).clamp_max(1.0 - 2.0**-53))
            walk = kept.step(walk, x[-1][:, None])
            for name, value in (("seen", seen), ("ahead", ahead), ("bin", bin_), ("open", open_)):
                record[name].append(value)
        made = {name: torch.stack(part, dim=1) for name, part in record.items()}
        return torch.stack(x, dim=1)[:, None], total.exp()[:, None, None], made

    def observe(self, kept: Walks, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        kept.note(record["bin"], seen)
        return x.new_zeros(len(x), 0).float()

    def trace(self, kept: Walks, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        return {name: torch.stack([record[name] for record in records], dim=1) for name in records[0]}

    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        batch, n = states.shape[:2]
        hidden = torch.tanh(self.begin_unit(states)).flatten(0, 1)
        total = torch.zeros(batch * n, device=states.device)
        seen, ahead, bin_, open_ = (trace[name].flatten(0, 1) for name in ("seen", "ahead", "bin", "open"))
        for j in range(self.dim):
            hidden = self.unit(seen[:, j], hidden)
            total = total + self._density(self._log(hidden, ahead[:, j]), bin_[:, j], open_[:, j])
        return total.view(batch, n, 1)
