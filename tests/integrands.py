"""Integrands with known answers, as small problems that every rule and sampler can be run on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nqr_geom.integrator.problem import LogLink, Observation, Problem, Samples, WalkProblem


@dataclass
class Known(Problem):
    """`batch` copies of one integrand with a known integral; a linear function is its control variate."""

    integrand: Callable[[Tensor], Tensor]  # (B, N, D) -> (B, N)
    exact: float
    dim: int = 1
    batch_size: int = 3
    name: str = "known"
    rows: Tensor = field(default_factory=lambda: torch.arange(0))

    def __post_init__(self) -> None:
        if not len(self.rows):
            self.rows = torch.arange(self.batch_size)

    def evaluate(self, x: Tensor) -> Observation:
        value = self.integrand(x)[..., None, None]
        control = 1.0 + x.sum(dim=-1)[..., None, None]
        integral = torch.full((x.shape[0], 1), 1.0 + 0.5 * self.dim, dtype=torch.float64)
        return Observation(value, control=(control, integral), queries=value.numel())

    def take(self, index: slice | Tensor) -> Known:
        return replace(self, rows=self.rows[index])

    def reference(self) -> np.ndarray:
        return np.full((self.batch, 1), self.exact)


@dataclass
class TwoTechniques(Problem):
    """The integral of f(y) = 3 y^2 over [0,1] by y = x and by y = sqrt(x) (density 2y): each alone estimates 1."""

    batch_size: int = 3
    techniques: int = 2
    name: str = "two-techniques"
    rows: Tensor = field(default_factory=lambda: torch.arange(0))

    def __post_init__(self) -> None:
        if not len(self.rows):
            self.rows = torch.arange(self.batch_size)

    def evaluate(self, x: Tensor) -> Observation:
        y = torch.cat([x, x.sqrt()], dim=-1)
        technique_pdf = torch.stack([torch.ones_like(y), 2.0 * y], dim=-1)
        value = 3.0 * y**2 / technique_pdf.diagonal(dim1=2, dim2=3)
        return Observation(value[..., None], technique_pdf=technique_pdf, queries=y.numel())

    def take(self, index: slice | Tensor) -> TwoTechniques:
        return replace(self, rows=self.rows[index])

    def reference(self) -> np.ndarray:
        return np.ones((self.batch, 1))


def monomial(degree: int, dim: int = 1) -> Known:
    """Mean of x_d^degree over the axes: integral 1 / (degree + 1)."""
    return Known(lambda x: (x**degree).mean(dim=-1), 1.0 / (degree + 1), dim, name=f"x^{degree}")


def smooth(dim: int = 1) -> Known:
    """prod exp(x_d): integral (e - 1)^dim."""
    return Known(lambda x: x.sum(dim=-1).exp(), float(np.expm1(1.0)) ** dim, dim, name="exp")


def step() -> Known:
    """1 right of 1/3: integral 2/3."""
    return Known(lambda x: (x[..., 0] > 1.0 / 3.0).double(), 2.0 / 3.0, name="step")


@dataclass
class Logarithm(Known):
    """-ln(integral of the integrand) / alpha, the same integral behind a link."""

    alpha: float = 2.0

    def finalize(self, samples: Samples) -> tuple[Samples, LogLink]:
        return samples, LogLink(alpha=self.alpha)

    def reference(self) -> np.ndarray:
        return np.full((self.batch, 1), -np.log(self.exact) / self.alpha)


@dataclass
class GamblersRuin(WalkProblem):
    """A gambler with k coins bets one a step on a coin that falls right with probability p, until 0 or `goal`.

    Row r starts with r + 1 coins. The value is whether the goal was reached, the feature "coins" what is left. Within
    `dim` steps the chance is known by the powers of the transition matrix, and in the long run in closed form.
    """

    p: float = 0.5
    goal: int = 5
    dim: int = 12
    name: str = "gambler"
    rows: Tensor = field(default_factory=lambda: torch.arange(4))

    def start(self, n: int) -> Any:
        return (self.rows + 1)[:, None].expand(self.batch, n)

    def observe(self, state: Any) -> dict[str, Tensor]:
        return {"coins": state[..., None].double()}

    def step(self, state: Any, x: Tensor) -> Any:
        playing = (state > 0) & (state < self.goal)
        return torch.where(playing, state + torch.where(x < self.p, 1, -1), state)

    def finish(self, state: Any) -> Observation:
        won = (state == self.goal).double()
        coins = state[:, :, None, None].double()
        return Observation(won[:, :, None, None], {"coins": coins}, queries=won.numel())

    def take(self, index: slice | Tensor) -> GamblersRuin:
        return replace(self, rows=self.rows[index])

    def reference(self) -> np.ndarray:
        move = np.zeros((self.goal + 1, self.goal + 1))
        move[0, 0] = move[-1, -1] = 1.0
        for k in range(1, self.goal):
            move[k, k + 1], move[k, k - 1] = self.p, 1.0 - self.p
        return np.linalg.matrix_power(move, self.dim)[self.rows.numpy() + 1, -1:]

    def in_the_long_run(self) -> np.ndarray:
        """Feller 1968, XIV.2."""
        k = self.rows.numpy()[:, None] + 1.0
        if self.p == 0.5:
            return k / self.goal
        odds = (1.0 - self.p) / self.p
        return (1.0 - odds**k) / (1.0 - odds**self.goal)
