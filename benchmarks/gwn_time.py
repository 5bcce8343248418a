"""What a winding number costs in time, method by method: the layout of Table 18.

    python benchmarks/gwn_time.py [--quick]

Milliseconds for a whole picture of one random shape, and how many times Monte Carlo's with as many samples that is.
Monte Carlo is the compiled one, on as many threads; all in one run, the best of several repetitions each (networks:
three).
"""

from __future__ import annotations

import argparse
from typing import Any

from rich.console import Console
from rich.table import Table
from shapes import best_seconds, write

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.problems import GwnProblem

SEED = 0
METHODS = ("mc", "stratified", "trapezoid", "structured")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer sizes and repetitions")
    quick = parser.parse_args().quick
    sizes = (32, 64) if quick else (32, 64, 128)
    budgets = (16, 32) if quick else (4, 8, 16, 32)
    repeats = 3 if quick else 7
    learned = [
        entry.name for entry in registry.entries("rule") if entry.name.startswith("inet") and entry.needs == "gwn"
    ]
    # A pair is timed as it works: with its own sampler.
    own = {entry.name.removeprefix("snet-") for entry in registry.entries("sampler")}
    names = [name.removeprefix("inet-") for name in learned]
    models = [f"{f'snet-{name}' if name in own else 'stratified'}+inet-{name}" for name in names]
    rows: list[dict[str, Any]] = []
    for size in sizes:
        problem = GwnProblem.family(1, seed=SEED, resolution=size)
        for n in budgets:
            plain = 0.0
            for method in (*METHODS, *models):
                often = min(3, repeats) if method in models else repeats
                seconds = best_seconds(lambda: ng.integrate(problem, n, method=method, seed=SEED), often)  # noqa: B023
                plain = plain or seconds
                rows.append(
                    {
                        "method": method,
                        "resolution": size,
                        "n": n,
                        "milliseconds": 1e3 * seconds,
                        "us_per_query": 1e6 * seconds / problem.batch,
                        "ns_per_sample": 1e9 * seconds / problem.batch / n,
                        "times_mc": seconds / plain,
                    }
                )
    table = Table(title="winding numbers: milliseconds (times Monte Carlo)")
    table.add_column("method, samples")
    for size in sizes:
        table.add_column(f"{size} x {size}", justify="right")
    for n in reversed(budgets):
        for method in (*METHODS, *models):
            cells = [r for r in rows if r["method"] == method and r["n"] == n]
            table.add_row(f"{method}, {n}", *(f"{r['milliseconds']:.3g} ({r['times_mc']:.3g})" for r in cells))
    Console().print(table)
    print(write("gwn_time", rows, seed=SEED, repeats=repeats))


if __name__ == "__main__":
    main()
