"""p = 3 from walks (Fig. 50): the network beside the exact solution for p = 2 and the network for p = 2, same walks.

    python benchmarks/p_walks.py [--quick]

32 walks of at most 12 steps that avoid each other, held-out polygons of the family. The truth comes
from finite elements; how far a coarser mesh is from it is told. "Bent" are the polygons where the exact solution for
p = 2 errs by more than 1e-4 in the mean square.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from comparison import SEED, N
from learned import write_cards
from p_range import solutions
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.wos.problems import LaplaceProblem

DESIGNS = ("walk-spread-full",)
RULES = ("mc", "inet-laplace-uniform", "inet-p-laplace")
BENT = 1e-4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer polygons; writes nothing")
    quick = parser.parse_args().quick
    shapes, points = (6, 32) if quick else (48, 64)
    problem = LaplaceProblem.family(shapes, SEED, points=points)
    truth, two = solutions(problem, 3.0, 250), solutions(problem, 2.0, 0)
    coarser = solutions(problem.take(torch.from_numpy(problem.groups < 4)), 3.0, 120)
    mesh = float(np.mean((coarser - truth[problem.groups < 4]) ** 2))
    gap = np.array([np.square(two - truth)[problem.groups == k].mean() for k in range(shapes)])
    rows: list[dict[str, Any]] = []
    for design in DESIGNS:
        errors = {"exact for p = 2": np.square(two - truth)}
        for rule in RULES:
            made = registry.make("sampler", design), registry.make("rule", rule)
            errors[rule] = np.square(run(problem, *made, N, seed=SEED).value[:, 0] - truth)
        for label, chosen in (("all", gap >= 0.0), ("bent", gap > BENT)):
            on = chosen[problem.groups]
            resample = Bootstrap.of(problem.groups[on], 1, 0)
            exact, base = (errors[name][on, None] for name in ("exact for p = 2", "inet-laplace-uniform"))
            for name, error in errors.items():
                e = error[on, None]
                row = {"problem": "p-laplace", "polygons": f"{label}, {int(chosen.sum())}",
                       "design": design, "rule": name,
                       "mse": float(e.mean()), "mse_error": resample.standard_error(e),
                       "median": float(np.median(e)), "p99": float(np.quantile(e, 0.99)),
                       "ratio": float(exact.mean() / e.mean()), "ratio_interval": resample.ratio(exact, e)}  # fmt: skip
                if name == "inet-p-laplace":
                    row |= {"base": "inet-laplace-uniform", "gain": float(base.mean() / e.mean()),
                            "gain_interval": resample.ratio(base, e)}  # fmt: skip
                rows.append(row)
    head = ("polygons", "samples", "rule", "MSE", "median", "p99", "x exact p = 2", "95%")
    table = Table(*head, title="p = 3, 32 walks")
    for row in rows:
        low, high = row["ratio_interval"]
        numbers = (f"{row[key]:.2e}" for key in ("mse", "median", "p99"))
        table.add_row(
            row["polygons"], row["design"], row["rule"], *numbers, f"{row['ratio']:.2f}", f"{low:.2f} .. {high:.2f}"
        )
    Console(width=120).print(table)
    print(f"squared difference of two meshes {mesh:.1e}")
    if not quick:
        write_cards([row for row in rows if row["polygons"].startswith("all")])
        write("p_walks", rows, n=N, seed=SEED, shapes=shapes, points=points, squared_difference_of_meshes=mesh)


if __name__ == "__main__":
    main()
