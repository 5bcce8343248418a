"""Does the family of polygons give the baseline rows of the paper (Table 14: 32 walks of at most 12 steps)?

    python benchmarks/wos_baselines.py [--quick]

The trapezoid over walks sorts the walks of a query by their first direction and weights each by half the gap between
its neighbours, periodic on the circle; it runs on Latin hypercube walks, as in the paper.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.streams import Stream
from nqr_geom.wos.problems import LaplaceProblem

WALKS = 32
PAPER = {"random": 2.62e-4, "latin-hypercube": 1.71e-4, "trapezoid": 2.42e-4}


def trapezoid(x: torch.Tensor, value: torch.Tensor) -> np.ndarray:
    """Periodic trapezoid over the first coordinate, (B, N) and (B, N) -> (B,)."""
    first, order = x.sort(dim=1)
    value = value.gather(1, order)
    gap = torch.cat([first[:, 1:], first[:, :1] + 1.0], dim=1) - first
    return (0.5 * (gap + gap.roll(1, dims=1)) * value).sum(dim=1).numpy()


def squared_errors(problem: LaplaceProblem, truth: np.ndarray, runs: int) -> dict[str, np.ndarray]:
    """Squared errors (B, runs) of the three rows."""
    result: dict[str, list[np.ndarray]] = {name: [] for name in PAPER}
    for run in range(runs):
        for design in ("random", "latin-hypercube"):
            samples = registry.make("sampler", design).draw(problem, WALKS, Stream(run))
            value = samples.value[:, :, 0, 0]
            result[design].append((value.mean(dim=1).numpy() - truth) ** 2)
        result["trapezoid"].append((trapezoid(samples.x[..., 0], value) - truth) ** 2)
    return {name: np.stack(errors, axis=1) for name, errors in result.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer shapes")
    quick = parser.parse_args().quick
    shapes, runs = (20, 2) if quick else (100, 4)
    problem = LaplaceProblem.family(shapes, seed=0, points=128)
    errors = squared_errors(problem, problem.reference()[:, 0], runs)
    resample = Bootstrap.of(problem.groups, runs, 0)
    table = Table("walks", "MSE", "paper", "x MC", "95%", "paper", title=f"{WALKS} walks, {problem.dim} steps")
    rows = []
    for name, paper in PAPER.items():
        mse, ratio = errors[name].mean(), errors["random"].mean() / errors[name].mean()
        low, high = resample.ratio(errors["random"], errors[name])
        rows.append({"method": name, "mse": mse, "paper_mse": paper, "ratio": ratio, "ratio_interval": [low, high],
                     "paper_ratio": PAPER["random"] / paper})  # fmt: skip
        table.add_row(name, f"{mse:.2e}", f"{paper:.2e}", f"{ratio:.2f}", f"{low:.2f} .. {high:.2f}",
                      f"{PAPER['random'] / paper:.2f}")  # fmt: skip
    Console(width=100).print(table)
    print(write("wos_baselines", rows, shapes=shapes, points=128, runs=runs, walks=WALKS))


if __name__ == "__main__":
    main()
