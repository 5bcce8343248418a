"""What learned winding numbers cost in time, and what they give for it.

    python benchmarks/learned_time.py [--quick]

Three questions, all in one run. "time", the layout of Table 18: a picture of one random shape, method by method, at
32, 64 and 128 squared pixels and 4 to 32 samples; medians of repetitions that take turns, as wall time over that of
Monte Carlo (which is the compiled one, on as many threads) and, less disturbed where others use the machine, as
processor time over Monte Carlo's. "equal time": the best classical rule against the best of the others within the time
of so many Monte Carlo samples, on held-out shapes. "break-even": from which cost of an integrand query on a learned
rule wins against the best classical one (`nqr_geom.integrator.break_even`).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from comparison import Floats, Pair
from learned import gwn
from rich.console import Console
from rich.table import Table
from shapes import write

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator.break_even import break_even, samples_to_match
from nqr_geom.integrator.estimate import Estimate
from nqr_geom.integrator.problem import Problem

SEED = 0
SLOW = 0.4  # processor seconds
BUSY = 1.5  # load above which times are no longer this script's alone
SHAPES = 20
CLASSICAL = ("mc", "stratified", "trapezoid", "grid+trapezoid", "sobol+mc", "gauss-legendre")
SIZES = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
OTHERS = (8, 16, 32)
LEARNED_AT = 32

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
                    "kind": "time",
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


def measured(problem: Problem, truth: Floats, pair: Pair, n: int, repeats: int) -> tuple[float, float]:
    """Mean squared error, and median processor microseconds an integral."""
    answers: list[Estimate] = []

    def job() -> None:
        answers.append(ng.integrate(problem, n, sampler=pair[0], rule=pair[1], seed=SEED))

    _, processor = interleaved({"it": job}, repeats)["it"]
    return float(np.mean((answers[0].value - truth) ** 2)), 1e6 * processor / problem.batch


def equal_time(shapes: int, sizes: tuple[int, ...], repeats: int) -> list[Row]:
    """Best classical and best other method within the time of so many Monte Carlo samples, and break-even costs."""
    problem = gwn(shapes)
    truth = problem.reference()
    assert truth is not None
    methods = {**{name: name for name in CLASSICAL}, **learned_methods()}
    points = []
    for name, method in methods.items():
        pair = registry.method(method, "gwn")
        for n in sizes if name in CLASSICAL else [n for n in sizes if n in OTHERS]:
            mse, micro = measured(problem, truth, pair, n, repeats)
            points.append({"method": name, "n": n, "mse": mse, "us": micro})
    classical = [p for p in points if p["method"] in CLASSICAL]
    others = [p for p in points if p["method"] not in CLASSICAL]
    rows: list[Row] = []
    for n in (m for m in sizes if m <= 256):
        within = next(p["us"] for p in classical if p["method"] == "mc" and p["n"] == n)
        row: Row = {"kind": "equal time", "n": n, "us": within}
        for label, group in (("classical", classical), ("other", others)):
            best = min((p for p in group if p["us"] <= within), key=lambda p: p["mse"], default=None)
            row[label] = best and {key: best[key] for key in ("method", "n", "mse")}
        rows.append(row)
    curve = [min(p["mse"] for p in classical if p["n"] == n) for n in sizes]
    query = next(p["us"] for p in classical if p["method"] == "mc" and p["n"] == max(sizes)) / max(sizes)
    for point in others:
        if point["n"] != LEARNED_AT:
            continue
        overhead = max(0.0, point["us"] - LEARNED_AT * query)
        needed = samples_to_match(sizes, curve, point["mse"])
        rows.append(
            {
                "kind": "break-even",
                "method": point["method"],
                "n": LEARNED_AT,
                "mse": point["mse"],
                "overhead_us": overhead,
                "classical_samples": needed if np.isfinite(needed) else None,
                "most_samples": max(sizes),
                "cost_us": break_even(sizes, curve, LEARNED_AT, point["mse"], overhead)
                or overhead / (max(sizes) - LEARNED_AT),
                "query_us": query,
            }
        )
    return rows


def show(rows: list[Row]) -> None:
    """Print the three answers."""
    timed = [row for row in rows if row["kind"] == "time"]
    table = Table(title="times Monte Carlo's, wall (processor)")
    table.add_column("method, samples")
    sizes = sorted({row["resolution"] for row in timed})
    for size in sizes:
        table.add_column(f"{size} x {size}", justify="right")
    for n in sorted({row["n"] for row in timed}):
        for method in dict.fromkeys(row["method"] for row in timed):
            cells = [row for row in timed if row["method"] == method and row["n"] == n]
            told = (f"{row['times_mc']:.3g} ({row['processor_times_mc']:.3g})" for row in cells)
            table.add_row(f"{method}, {n}", *told)
    Console().print(table)
    for row in rows:
        if row["kind"] != "time":
            Console().print(row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small picture, few shapes; writes nothing")
    quick = parser.parse_args().quick
    load = os.getloadavg()[0]
    rows = times((32,) if quick else (32, 64, 128), (8, 32) if quick else (4, 8, 16, 32), 1 if quick else 5)
    rows += equal_time(2 if quick else SHAPES, SIZES[:6] if quick else SIZES, 1 if quick else 3)
    show(rows)
    if not quick:
        print(write("learned_time", rows, seed=SEED, shapes=SHAPES, repeats=5, load=round(load, 1), busy=load > BUSY))


if __name__ == "__main__":
    main()
