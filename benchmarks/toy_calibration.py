"""Does the toy family give the baseline rows of the paper (Tables 1, 2, 6 at 32 samples)?

    python benchmarks/toy_calibration.py [--quick]

Prints our mean squared errors beside the paper's, as numbers and as ratios to Monte Carlo, with 95% bootstrap intervals
over integrands, and what hidden breaks leave to a rule that knows the pieces.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.integrator.frontier import Point, frontier
from nqr_geom.integrator.samplers import FixedDesign, Random, Stratified
from nqr_geom.streams import Stream
from nqr_geom.toy.problem import ToyProblem

N = 32
SEED = 0
# Method, and its mean squared error in the paper: Tables 1 and 2 average two runs of five integrands, Table 6 one.
ROWS = {
    "random+mc": (1.47e-2 + 1.62e-2) / 2,
    "random+trapezoid": (3.98e-3 + 4.00e-3) / 2,
    "random+regression-3": (1.35e-2 + 1.25e-2) / 2,
    "random+regression-5": (3.04e-2 + 3.48e-2) / 2,
    "stratified+mc": 1.20e-3,
    "stratified+trapezoid": 9.52e-4,
    "stratified+regression-3": 1.17e-3,
    "stratified+regression-5": 1.16e-3,
    "random+bayesian-quadrature": (0.222 + 0.284 + 0.700 + 0.239 + 0.718) / 5,
}


def row(point: Point, paper: float) -> dict[str, Any]:
    assert point.ratio is not None
    paper_ratio = ROWS["random+mc"] / paper
    return {
        "method": point.method,
        "mse": point.mse,
        "mse_interval": point.mse_interval,
        "paper_mse": paper,
        "ratio": point.ratio,
        "ratio_interval": point.ratio_interval,
        "paper_ratio": paper_ratio,
        "off": point.mse / paper - 1.0,
        "ratio_off": point.ratio / paper_ratio - 1.0,
    }


def bound(problem: ToyProblem, sampler: FixedDesign) -> float:
    """Mean squared error that breaks leave to a rule that knows the pieces."""
    x = sampler.points(problem.rows, N, 1, Stream(SEED, "test", "samples/0"))[..., 0]
    return float(problem.pieces.break_variance(x).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer integrands")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    problem = ToyProblem.family(2_000 if quick else 20_000, seed=SEED)
    points = frontier(problem, list(ROWS), [N], runs=4, seed=SEED).points
    rows = [row(point, ROWS[point.method]) for point in points]
    mc = points[0].mse
    table = Table("method", "MSE", "paper", "off", "x MC", "95%", "paper", "off", title=f"toy, {N} samples")
    for r in rows:
        low, high = r["ratio_interval"]
        table.add_row(
            r["method"],
            f"{r['mse']:.2e}",
            f"{r['paper_mse']:.2e}",
            f"{r['off']:+.0%}",
            f"{r['ratio']:.3g}",
            f"{low:.3g} .. {high:.3g}",
            f"{r['paper_ratio']:.3g}",
            f"{r['ratio_off']:+.0%}",
        )
    for sampler in (Random(), Stratified()):
        left = bound(problem, sampler)
        rows.append({"method": f"{sampler.name}, pieces known", "mse": left, "ratio": mc / left})
        table.add_row(rows[-1]["method"], f"{left:.2e}", "", "", f"{mc / left:.3g}")
    Console(width=120).print(table)
    print(write("toy_calibration", rows, seed=SEED, integrands=problem.batch, runs=4, samples=N))


if __name__ == "__main__":
    main()
