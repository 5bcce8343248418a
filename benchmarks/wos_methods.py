"""What rules and samplers make of the same number of walks: Table 14, domains far from the family (Fig. 33), and times.

    python benchmarks/wos_methods.py [--quick]

The family is that of Fig. 41, test split, against the boundary solver. The others are a letter, a comb and a coastline
with boundary values that oscillate; there the truth is 20,000 walks a query to a shell of 1e-4, whose own squared error
stands beside. Times are processor time of one thread; Monte Carlo's is that of the compiled walks that need no torch.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from shapes import write

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import queries
from nqr_geom.wos.outlines import outlines
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.walk import walk

WALKS = 32
METHODS = ("random+mc", "latin-hypercube+mc", "array-rqmc+mc", "random+walk-fit", "latin-hypercube+walk-fit",
           "walk-spread+walk-fit")  # fmt: skip
LEARNED = ("inet", "nqr")


def methods() -> list[str]:
    """The classical rows, and the learned ones that are there."""
    return [*METHODS, *(registry.ALIASES[f"laplace:{k}"] for k in LEARNED if f"laplace:{k}" in registry.ALIASES)]


def measured(problem: LaplaceProblem, method: str, truth: np.ndarray, runs: int) -> tuple[np.ndarray, float, float]:
    """Squared errors (B, runs), the share of flagged rows, and microseconds a query."""
    sampler, rule = (
        registry.make(kind, name) for kind, name in zip(("sampler", "rule"), method.split("+"), strict=True)
    )
    errors, flagged, seconds = [], 0.0, np.inf
    for run in range(runs):
        start = time.thread_time()
        samples = sampler.draw(problem, WALKS, Stream(run))
        combined = rule.combine(samples)
        value = combined.estimate(samples)[:, 0].numpy()
        seconds = min(seconds, time.thread_time() - start)
        errors.append((value - truth) ** 2)
        flagged += 0.0 if combined.fallback is None else float(combined.fallback.double().mean()) / runs
    return np.stack(errors, axis=1), flagged, 1e6 * seconds / problem.batch


def monte_carlo_time(problem: LaplaceProblem) -> float:
    """Microseconds a query of compiled walks alone."""
    seconds = np.inf
    for _ in range(4):
        start = time.thread_time()
        walk(problem.geometry, problem.shape.numpy(), problem.points.numpy(), problem.rows.numpy(), np.arange(WALKS),
             Stream(0), epsilon=problem.epsilon, max_steps=problem.dim)  # fmt: skip
        seconds = min(seconds, time.thread_time() - start)
    return 1e6 * seconds / problem.batch


def rows_of(name: str, problem: LaplaceProblem, truth: np.ndarray, runs: int, groups: np.ndarray) -> list[dict]:
    """One row a method."""
    resample, base, result = Bootstrap.of(groups, runs, 0), None, []
    plain = monte_carlo_time(problem)
    for method in methods():
        errors, flagged, micro = measured(problem, method, truth, runs)
        base = errors if base is None else base
        low, high = resample.ratio(base, errors)
        result.append({
            "problem": name, "method": method, "n": WALKS, "mse": errors.mean(), "median": np.median(errors),
            "p99": np.quantile(errors, 0.99), "ratio": base.mean() / errors.mean(), "ratio_interval": [low, high],
            "fallback": flagged, "us_per_query": micro, "us_per_query_mc": plain, "times_mc": micro / plain,
        })  # fmt: skip
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer shapes and queries")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    shapes, points, runs = (10, 16, 2) if quick else (100, 64, 2)
    problem = LaplaceProblem.family(shapes, seed=0, points=points)
    rows = rows_of("family of Fig. 41", problem, problem.reference()[:, 0], runs, problem.groups)
    far, settings = (
        (40 if quick else 200),
        {"method": "wos", "n": 20_000, "epsilon": 1e-4, "seed": 77, "full_output": True},
    )
    for name, outline in outlines().items():
        at = queries(Domain.of(outline.vertices), far, 0)
        truth = ng.solve_laplace(outline.vertices, outline.values, at, **settings)
        made = LaplaceProblem.of(outline.vertices, outline.values, at)
        found = rows_of(f"{name}, {len(outline.vertices)} edges", made, truth.value[:, 0], runs, np.arange(far))
        rows += [{**row, "truth_mse": float((truth.stderr**2).mean())} for row in found]
    table = Table("problem", "method", "MSE", "x MC", "95%", "median", "flagged", "us", "times MC")
    for row in rows:
        low, high = row["ratio_interval"]
        table.add_row(
            row["problem"],
            row["method"],
            f"{row['mse']:.2e}",
            f"{row['ratio']:.1f}",
            f"{low:.1f} .. {high:.1f}",
            f"{row['median']:.1e}",
            f"{row['fallback']:.1%}",
            f"{row['us_per_query']:.0f}",
            f"{row['times_mc']:.1f}",
        )
    Console(width=140).print(table)
    if not quick:
        print(write("wos_methods", rows, shapes=shapes, points=points, runs=runs, walks=WALKS, far=far))


if __name__ == "__main__":
    main()
