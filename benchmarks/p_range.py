"""p from 1.5 to 6 from walks: one network that sees p beside the exact solution for p = 2, on the same walks.

    python benchmarks/p_range.py [--quick]

32 walks of at most 12 steps that avoid each other, held-out polygons of the family; the truth comes from finite
elements. The last rows are about exponents as the network was trained on, beside plain Monte Carlo on random walks, and
go into its card.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from comparison import SEED, N
from learned import write_cards
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import registry
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.p_training import p_range_batch
from nqr_geom.streams import Stream
from nqr_geom.wos.families import polygons
from nqr_geom.wos.measures import vertex_measures
from nqr_geom.wos.problems import LaplaceProblem, PLaplaceProblem

EXPONENTS = (1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
TWO, RANGE, THREE = "inet-laplace-uniform", "inet-p-laplace-range", "inet-p-laplace"
EXACT = "exact for p = 2"

Floats = NDArray[np.float64]
Row = dict[str, Any]


def solutions(problem: LaplaceProblem, p: float, triangles: int) -> Floats:
    """By finite elements at all queries, (B,); by harmonic measures for p = 2."""
    vertices, values = polygons(len(problem.boundaries), SEED, "test")
    found = np.empty(problem.batch)
    for k in np.unique(problem.groups):
        on = problem.groups == k
        points = problem.boundaries[k].domain.from_frame(problem.points[on].numpy())
        if p == 2.0:
            found[on] = vertex_measures(vertices[k], points)[0] @ values[k]
        else:
            found[on] = p_laplace(Mesh.of(vertices[k], triangles, order=2), values[k], p, order=2)(points)
    return found


def rows_of(p: float | str, errors: dict[str, Floats], groups: NDArray[np.int64], against: str) -> list[Row]:
    """One row for each rule, with its ratio to the errors of `against`."""
    resample, rows = Bootstrap.of(groups, 1, SEED), []
    for name, e in errors.items():
        row: Row = {"problem": "p-laplace", "p": p, "n": N,
                    "design": "walk-spread-full" if name == THREE else "walk-spread", "rule": name,
                    "mse": float(e.mean()), "mse_error": resample.standard_error(e[:, None]),
                    "median": float(np.median(e)), "p99": float(np.quantile(e, 0.99)),
                    "ratio": float(errors[against].mean() / e.mean()),
                    "ratio_interval": resample.ratio(errors[against][:, None], e[:, None])}  # fmt: skip
        if name in (RANGE, THREE):
            row |= {"base": TWO, "gain": float(errors[TWO].mean() / e.mean()),
                    "gain_interval": resample.ratio(errors[TWO][:, None], e[:, None])}  # fmt: skip
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer polygons; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    shapes, points, family = (4, 32, 600) if quick else (32, 64, 8000)
    problem = LaplaceProblem.family(shapes, SEED, points=points)
    sampler, two = registry.make("sampler", "walk-spread"), solutions(problem, 2.0, 0)
    full = registry.make("sampler", "walk-spread-full")  # on which the network for p = 3 was trained
    rules = {name: registry.make("rule", name) for name in (TWO, RANGE, THREE)}
    some = problem.take(torch.from_numpy(problem.groups < 4))
    rows: list[Row] = []
    meshes: dict[str, float] = {}
    for p in EXPONENTS:
        truth, coarser = solutions(problem, p, 400), solutions(some, p, 150)
        meshes[f"{p:g}"] = float(np.mean((coarser - truth[problem.groups < 4]) ** 2))
        errors = {} if p == 2.0 else {EXACT: np.square(two - truth)}
        for name in (TWO, RANGE, *((THREE,) if p == 3.0 else ())):
            asked = PLaplaceProblem.like(problem, p) if name == RANGE else problem
            walks = full if name == THREE else sampler
            errors[name] = np.square(run(asked, walks, rules[name], N, seed=SEED).value[:, 0] - truth)
        rows += rows_of(p, errors, problem.groups, next(iter(errors)))
    batch = p_range_batch(torch.arange(family), SEED, "test")
    samples = sampler.draw(batch.problem, N, Stream(SEED))
    plain = registry.make("sampler", "random").draw(batch.problem, N, Stream(SEED)).value.mean(dim=(1, 2, 3))
    errors = {"mc": (plain - batch.answer[:, 0]).square().numpy()} | {
        name: (rules[name].combine(samples).estimate(samples) - batch.answer).square()[:, 0].numpy()
        for name in (TWO, RANGE)
    }
    groups = batch.problem.shape.numpy() % len(batch.problem.geometry.shape)
    rows += rows_of("1.5 .. 6", errors, groups, "mc")
    table = Table("p", "rule", "MSE", "median", "p99", "x exact p = 2", "95%", title=f"{N} walks")
    for row in rows:
        low, high = row["ratio_interval"]
        numbers = (f"{row[key]:.2e}" for key in ("mse", "median", "p99"))
        table.add_row(str(row["p"]), row["rule"], *numbers, f"{row['ratio']:.2f}", f"{low:.2f} .. {high:.2f}")
    Console(width=120).print(table)
    print("squared difference of two meshes", meshes)
    if not quick:
        write_cards(rows[-1:])
        write("p_range", rows, n=N, seed=SEED, shapes=shapes, points=points, squared_difference_of_meshes=meshes)


if __name__ == "__main__":
    main()
