"""What learned winding numbers cost in time.

    python benchmarks/learned_time.py [--quick]

The layout of Table 18: a picture of one random shape, method by method, at 32, 64 and 128 squared pixels and 4 to 32
samples; medians of repetitions that take turns, as wall time over that of Monte Carlo (which is the compiled one, on as
many threads) and, less disturbed where others use the machine, as processor time over Monte Carlo's. What is best in
equal time is `equal_time.py`'s question.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import write

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.problems import GwnProblem

SEED = 0
SLOW = 0.4  # processor seconds
BUSY = 1.5  # load above which times are no longer this script's alone

Row = dict[str, Any]


def learned_methods() -> dict[str, str]:
    """Name and method of everything that is not classical, as far as the registry has it."""
    rules = {entry.name for entry in registry.entries("rule")}
    wanted = {
        "structured": "structured",
        "structured, stratified": "stratified+gwn-hermite",
        "student": "student",
        "student, uniform base": "stratified+inet-gwn-student-uniform",
        "INet, structured base": "stratified+inet-gwn-structured",
        "INet, uniform base": "stratified+inet-gwn-uniform",
        "SNet + INet": "nqr",
    }
    return {
        name: method
        for name, method in wanted.items()
        if (method.partition("+")[2] or "gwn-hermite") in rules
        and ("+" in method or f"gwn:{method}" in registry.ALIASES)
    }


def interleaved(jobs: dict[str, Callable[[], Any]], repeats: int) -> dict[str, tuple[float, float]]:
    """Median wall and processor seconds of jobs that take turns, after a first round that is not counted.

    A job that is slow in the first round, where compilation and caches no longer tell, is not repeated.
    """
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in jobs}
    for turn in range(repeats + 1):
        for name, job in jobs.items():
            if turn and spent[name] and spent[name][0][1] > SLOW:
                continue
            wall, processor = time.perf_counter(), time.process_time()
            job()
            spent[name].append((time.perf_counter() - wall, time.process_time() - processor))
    medians = {name: np.median(np.array(times[1:] or times), axis=0) for name, times in spent.items()}
    return {name: (float(wall), float(processor)) for name, (wall, processor) in medians.items()}


def times(sizes: tuple[int, ...], budgets: tuple[int, ...], repeats: int) -> list[Row]:
    """Rows of the layout of Table 18."""
    methods, rows = {"Monte Carlo": "mc", **learned_methods()}, []
    for size in sizes:
        problem = GwnProblem.family(1, seed=SEED, resolution=size)
        for n in budgets:
            jobs = {
                name: (lambda method=method, n=n, problem=problem: ng.integrate(problem, n, method=method, seed=SEED))
                for name, method in methods.items()
            }
            spent = interleaved(jobs, repeats)
            plain = spent["Monte Carlo"]
            rows += [
                {
                    "method": name,
                    "resolution": size,
                    "n": n,
                    "us_per_integral": 1e6 * wall / problem.batch,
                    "ns_per_sample": 1e9 * wall / problem.batch / n,
                    "times_mc": wall / plain[0],
                    "processor_us_per_integral": 1e6 * processor / problem.batch,
                    "processor_times_mc": processor / plain[1],
                }
                for name, (wall, processor) in spent.items()
            ]
    return rows


def show(rows: list[Row]) -> None:
    """Print the table."""
    table = Table(title="times Monte Carlo's, wall (processor)")
    table.add_column("method, samples")
    sizes = sorted({row["resolution"] for row in rows})
    for size in sizes:
        table.add_column(f"{size} x {size}", justify="right")
    for n in sorted({row["n"] for row in rows}):
        for method in dict.fromkeys(row["method"] for row in rows):
            cells = [row for row in rows if row["method"] == method and row["n"] == n]
            told = (f"{row['times_mc']:.3g} ({row['processor_times_mc']:.3g})" for row in cells)
            table.add_row(f"{method}, {n}", *told)
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small picture; writes nothing")
    quick = parser.parse_args().quick
    load = os.getloadavg()[0]
    rows = times((32,) if quick else (32, 64, 128), (8, 32) if quick else (4, 8, 16, 32), 1 if quick else 5)
    show(rows)
    if not quick:
        print(write("learned_time", rows, seed=SEED, repeats=5, load=round(load, 1), busy=load > BUSY))


if __name__ == "__main__":
    main()
