"""Your own integral: perimeters of ellipses, by every rule that fits, with what their accuracy costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import tau
from pathlib import Path

import numpy as np
import torch
from scipy.integrate import quad
from scipy.special import ellipe
from torch import Tensor

import nqr_geom as ng
from nqr_geom.integrator.problem import Observation, Problem


@dataclass(frozen=True)
class Perimeters(Problem):
    """Perimeters of B ellipses: the mean speed along one turn, an integral over [0, 1] for each."""

    axes: Tensor  # half axes (B, 2), float64
    rows: Tensor  # number of each ellipse, (B,): it keys the random numbers

    name = "perimeter"
    dim = 1

    @classmethod
    def of(cls, axes: np.ndarray) -> Perimeters:
        """The problem for half axes (B, 2) > 0."""
        return cls(torch.from_numpy(axes), torch.arange(len(axes)))

    def evaluate(self, x: Tensor) -> Observation:
        """The speed at x (B, N, 1) of a turn, as value (B, N, techniques, channels)."""
        a, b = self.axes[:, None, :].unbind(-1)
        angle = tau * x[..., 0]
        speed = tau * torch.hypot(a * torch.sin(angle), b * torch.cos(angle))
        return Observation(speed[:, :, None, None], queries=speed.numel())

    def take(self, index: slice | Tensor) -> Perimeters:
        """Some of the ellipses."""
        return replace(self, axes=self.axes[index], rows=self.rows[index])

    def reference(self) -> np.ndarray:
        """The truth (B, 1), where it is known: frontiers and tests ask for it."""
        large, small = np.sort(self.axes.numpy(), axis=1).T[::-1]
        return 4.0 * (large * ellipe(1.0 - (small / large) ** 2))[:, None]

    def peers(self) -> dict[str, Callable[[], np.ndarray]]:
        """Another library on the same job, a star in the chart."""

        def one(a: float, b: float) -> float:
            return quad(lambda angle: np.hypot(a * np.sin(angle), b * np.cos(angle)), 0.0, tau)[0]

        return {"scipy.integrate.quad": lambda: np.array([[one(a, b)] for a, b in self.axes.tolist()])}


def main(out: Path = Path("out"), ellipses: int = 2000) -> dict[str, float]:
    """Draw error against samples and time; return the mean squared errors at 32 samples."""
    axes = np.random.default_rng(0).uniform(0.2, 1.0, (ellipses, 2))
    problem = Perimeters.of(axes)

    estimate = ng.integrate(problem, n=32, sampler="stratified", rule="trapezoid", replicates=8)
    print(f"first ellipse: {estimate.value[0, 0]:.4f} +- {estimate.stderr[0, 0]:.4f}")
    print(estimate.counts)

    methods = ["mc", "stratified", "trapezoid", "sobol+regression-3", "gauss-legendre"]
    measured = ng.frontier(problem, [*methods, "grid+trapezoid"], [4, 8, 16, 32], runs=4)
    out.mkdir(parents=True, exist_ok=True)
    measured.plot(out / "own_integral.png")
    return {row["method"]: row["mse"] for row in measured.table if row["n"] == 32}


if __name__ == "__main__":
    for method, error in main().items():
        print(f"{method:20} {error:.1e}")
