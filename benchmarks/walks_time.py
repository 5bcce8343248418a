"""What weighing walks costs in time: the layout of Table 19, milliseconds an image.

    python benchmarks/walks_time.py [--quick]

One polygon of the family, pixel centres of a square image of which those inside are queries; 4 to 32 walks of at most
12 steps. Monte Carlo is the fastest there is, compiled walks that record nothing. Best of three runs, all cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import best_seconds, write

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import polygons
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.walk import walk

Floats = NDArray[np.float64]

METHODS = {"wos-lhs": ("latin-hypercube", "mc"), "walk-fit on LHS": ("latin-hypercube", "walk-fit"),
           "INet on LHS": ("latin-hypercube", "inet-laplace-uniform"),
           **{name: registry.method(name, "laplace") for name in ("structured", "inet", "nqr")
              if f"laplace:{name}" in registry.ALIASES}}  # fmt: skip


def plain(problem: LaplaceProblem, n: int) -> Floats:
    """Means of n random walks from every query, walks that record nothing, (B, 1)."""
    inputs = (part.numpy() for part in (problem.shape, problem.points, problem.rows))
    ended = walk(problem.geometry, *inputs, np.arange(n), Stream(0), epsilon=problem.epsilon, max_steps=problem.dim)
    mean = np.empty((problem.batch, 1))
    for k, boundary in enumerate(problem.boundaries):
        on = problem.groups == k
        mean[on, 0] = boundary.at(ended.edge[on], ended.t[on]).mean(axis=1)
    return mean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small image; writes nothing")
    quick = parser.parse_args().quick
    vertices, values = (part[0] for part in polygons(1))
    domain, known = Domain.of(vertices), {entry.name for entry in registry.entries("rule")}
    rows: list[dict[str, Any]] = []
    for resolution in (16,) if quick else (32, 64, 128):
        centre = (2.0 * np.arange(resolution) + 1.0) / resolution - 1.0
        grid = np.stack(np.meshgrid(centre, centre), axis=-1).reshape(-1, 2)
        points = grid[domain.inside(grid)]
        problem = LaplaceProblem.of(vertices, values, points)
        for n in (4, 32) if quick else (4, 8, 16, 32):
            jobs: dict[str, Callable[[], Any]] = {"wos": lambda n=n, problem=problem: plain(problem, n)}
            for name, (sampler, rule) in METHODS.items():
                if rule in known:
                    made = registry.make("sampler", sampler), registry.make("rule", rule)
                    jobs[name] = lambda n=n, made=made, problem=problem: run(problem, *made, n)
            seconds = {name: best_seconds(job, 3) for name, job in jobs.items()}
            for name, taken in seconds.items():
                rows.append(
                    {
                        "method": name,
                        "resolution": resolution,
                        "n": n,
                        "queries": len(points),
                        "milliseconds": 1e3 * taken,
                        "us_per_query": 1e6 * taken / len(points),
                        "ns_per_walk": 1e9 * taken / len(points) / n,
                        "times_mc": taken / seconds["wos"],
                    }
                )
    table = Table("method", "image", "walks", "ms", "us / query", "ns / walk", "times MC")
    for row in rows:
        numbers = (f"{row[key]:.3g}" for key in ("milliseconds", "us_per_query", "ns_per_walk", "times_mc"))
        table.add_row(row["method"], f"{row['resolution']}^2", str(row["n"]), *numbers)
    Console(width=110).print(table)
    if not quick:
        write("walks_time", rows, polygon=0, steps=12)


if __name__ == "__main__":
    main()
