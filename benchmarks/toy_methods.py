"""How do rules and samplers compare on the toy family (Tables 1 and 2), from 8 to 64 samples?

    python benchmarks/toy_methods.py [--quick]

Ratios are of mean squared errors, Monte Carlo's over the method's at equal samples, on integrands of the test split.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict

import torch
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.integrator.frontier import frontier
from nqr_geom.toy.problem import ToyProblem

SEED = 0
METHODS = (
    "mc",
    "stratified",
    "random+trapezoid",
    "trapezoid",
    "random+regression-3",
    "bayesian-quadrature",
    "random+toy-hermite",
    "stratified+toy-hermite",
    "structured",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer integrands")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    problem = ToyProblem.family(1_024 if quick else 8_192, seed=SEED)
    measured = frontier(problem, METHODS, [8, 16, 32, 64], runs=3, seed=SEED)
    table = Table("method", "n", "MSE", "x MC", "95%", "median", "p99", "bias^2", "us", title="toy")
    for p in measured.points:
        assert p.ratio is not None
        low, high = p.ratio_interval or (float("nan"), float("nan"))
        table.add_row(
            p.method,
            str(p.n),
            f"{p.mse:.2e}",
            f"{p.ratio:,.3g}",
            f"{low:,.3g} .. {high:,.3g}",
            f"{p.median:.1e}",
            f"{p.p99:.1e}",
            f"{p.squared_bias:.1e}",
            f"{1e6 * p.seconds:.1f}",
        )
    Console(width=120).print(table)
    rows = [asdict(point) for point in measured.points]
    print(write("toy_methods", rows, seed=SEED, integrands=problem.batch, runs=3, torch_threads=1))


if __name__ == "__main__":
    main()
