"""Who is best in equal time: classical rules against structured and learned ones, application by application.

    cd benchmarks && python equal_time.py [--quick] [--only toy,gwn]

Held-out integrals, processor time on one thread, which a busy machine does not stretch much. "equal time": the smallest
mean squared error that a classical rule, and any other that sees only point queries or walks, reaches within the time
of 4 to 256 Monte Carlo samples. "break-even": from which cost of an integrand query on a rule with 32 samples (16 for
direct light) wins against the best classical one (`nqr_geom.integrator.break_even`). Exact answers and finite elements
stand apart: they know more than samples do. Draws docs/equal-time.png.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from comparison import SEED, Floats, Pair
from figures import DOCS, SEVERAL, figure, save
from learned import gwn, toy
from learned_time import interleaved
from learned_transmittance import answered
from learned_walks import solved
from rich.console import Console
from sd_methods import held_out
from shapes import RESULTS, write
from walks_time import plain as bare_walks

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.break_even import break_even, samples_to_match
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.problem import Problem
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.wos.problems import LaplaceProblem

Row = dict[str, Any]
MonteCarlo = Callable[[Any, int], Floats]

BUDGETS = (4, 8, 16, 32, 64, 128, 256)  # Monte Carlo samples
MOST = 1024  # of a classical rule, so that there is something to compare good rules with
TOO_LONG = 4e6  # microseconds; a method that takes these is far beyond what is compared
LEAST = 1e-12  # squared error that counts as none


@dataclass(frozen=True)
class Study:
    """One application.

    Parameters
    ----------
    problem : callable
        Held-out integrals with their answers; ``problem(less)`` has `less` times fewer.
    classical, others : tuple of str
        Methods, "mc" among the classical ones.
    other_sizes : tuple of int
        Samples of the others.
    at : int
        Those whose break-even is told.
    plain : callable, optional
        The fastest Monte Carlo there is, where it is not the problem's own.
    """

    problem: Callable[[int], tuple[Problem, Floats]]
    classical: tuple[str, ...]
    others: tuple[str, ...]
    other_sizes: tuple[int, ...] = (8, 12, 16, 24, 32, 40, 48, 64, 128)
    at: int = 32
    plain: MonteCarlo | None = None


def with_reference(problem: Problem) -> tuple[Problem, Floats]:
    """A problem that knows its answers, and these."""
    truth = problem.reference()
    if truth is None:
        raise ValueError(f"problem: expected one with a reference, got {problem.name!r}")
    return problem, truth


def rooms(less: int) -> tuple[Problem, Floats]:
    """A held-out room."""
    scene = ng.datasets.scenes(1, seed=SEED, split="test", resolution=32 // less)[0]
    return with_reference(DirectProblem.of(scene))


POINTS = ("mc", "stratified", "trapezoid", "grid+trapezoid", "sobol+mc", "gauss-legendre")
STUDIES: dict[str, Study] = {
    "toy": Study(
        lambda less: with_reference(toy(2000 // less)),
        POINTS,
        ("structured", "stratified+toy-hermite", "inet", "stratified+inet-toy-uniform", "nqr"),
    ),
    "gwn": Study(
        lambda less: with_reference(gwn(12 // less)),
        POINTS,
        ("structured", "stratified+gwn-hermite", "student", "inet", "stratified+inet-gwn-uniform", "nqr"),
    ),
    "sd": Study(
        lambda less: with_reference(held_out(12 // less)),
        POINTS,
        ("structured", "stratified+sd-hermite", "inet", "nqr"),
    ),
    "laplace": Study(
        lambda less: with_reference(solved(LaplaceProblem.family(20 // less, SEED, points=96))),
        ("mc", "wos-lhs", "wos-rqmc"),
        ("structured", "latin-hypercube+walk-fit", "inet", "latin-hypercube+inet-laplace-uniform", "nqr"),
        (4, 8, 16, 32, 64),
        plain=bare_walks,
    ),
    "transmittance": Study(
        lambda less: with_reference(answered(ng.datasets.volumes(8 // less, seed=SEED), 24)["pieces"]),
        ("mc", "stratified", "trapezoid", "regression", "jackknife"),
        ("structured", "inet", "nqr"),
    ),
    "direct": Study(
        rooms,
        ("random", "mis", "random+direct-regression-1"),
        ("structured", "inet", "nqr"),
        (4, 8, 16, 32, 64),
        16,
    ),
}


def known(name: str, method: str) -> Pair | None:
    """Sampler and rule of a method, None where the application has no such method (yet)."""
    if "+" not in method and method in ("inet", "nqr", "student", "structured"):
        return registry.method(method, name) if f"{name}:{method}" in registry.ALIASES else None
    sampler, rule = registry.method(method, name)
    return (sampler, rule) if rule in {entry.name for entry in registry.entries("rule")} else None


def point(name: str, method: str, n: int, problem: Problem, truth: Floats, plain: MonteCarlo | None) -> Row:
    """Mean squared error of a method and its processor microseconds an integral."""
    found: list[Floats] = []

    def job(problem: Problem = problem) -> None:
        if plain is not None:
            found.append(plain(problem, n))
        else:
            found.append(run(problem, sampler, rule, n, seed=SEED).value)

    sampler, rule = (
        registry.make(*named) for named in zip(("sampler", "rule"), registry.method(method, name), strict=True)
    )
    job(problem.take(slice(0, 2)))  # imports and compilation
    found.clear()
    _, processor = interleaved({method: job}, 3)[method]
    mse = float(np.mean((found[0] - truth) ** 2))
    return {"method": method, "n": n, "mse": max(mse, LEAST), "us": 1e6 * processor / problem.batch}


def points(name: str, study: Study, methods: Iterable[str], sizes: Iterable[int], less: int) -> list[Row]:
    """Every method with every number of samples, none that takes longer than what is compared."""
    problem, truth = study.problem(less)
    rows = []
    for method in methods:
        for n in sizes:
            plain = study.plain if method == "mc" else None
            if rows and rows[-1]["method"] == method and rows[-1]["us"] * problem.batch > TOO_LONG and n > study.at:
                break
            rows.append(point(name, method, n, problem, truth, plain))
            print(name, rows[-1], flush=True)
    return rows


def best(rows: list[Row], within: float) -> Row | None:
    """The most accurate of those that fit."""
    return min((row for row in rows if row["us"] <= within), key=lambda row: row["mse"], default=None)


def compared(name: str, study: Study, less: int) -> list[Row]:
    """Rows of one application."""
    mc = study.classical[0]
    sizes = [4 * 2**k for k in range(9) if 4 * 2**k <= MOST]
    classical = points(name, study, study.classical, sizes, less)
    others = [method for method in study.others if known(name, method) is not None]
    learned = points(name, study, others, study.other_sizes, less)
    rows: list[Row] = []
    for n in BUDGETS:
        within = next(row["us"] for row in classical if row["method"] == mc and row["n"] == n)
        plain, other = best(classical, within), best(learned, within)
        ratio = plain["mse"] / other["mse"] if plain and other else 0.0
        row = {"application": name, "kind": "equal time", "n": n, "us": within}
        rows.append({**row, "classical": plain, "other": other, "ratio": ratio})
    # The fewest queries that a classical rule needs, whatever its own cost.
    curve = [min(row["mse"] for row in classical if row["n"] == n) for n in sizes]
    query = next(row["us"] for row in classical if row["method"] == mc and row["n"] == MOST) / MOST
    for row in learned:
        if row["n"] == study.at:
            overhead = max(0.0, row["us"] - study.at * query)
            needed = samples_to_match(sizes, curve, row["mse"])
            cost = break_even(sizes, curve, study.at, row["mse"], overhead) or overhead / (MOST - study.at)
            rows.append({"application": name, "kind": "break-even", **row, "overhead_us": overhead,
                         "classical_samples": needed if np.isfinite(needed) else None, "most_samples": MOST,
                         "cost_us": cost if np.isfinite(cost) else None, "query_us": query})  # fmt: skip
    rows += [{"application": name, "kind": "curve", "classical": row["method"] in study.classical, **row}
             for row in classical + learned]  # fmt: skip
    return rows


def draw(rows: list[Row]) -> None:
    """Error against time, a panel an application; dashed lines are classical rules."""
    names = list(dict.fromkeys(row["application"] for row in rows))
    columns = min(3, len(names))
    lines = -(-len(names) // columns)
    whole = figure(4.6 * columns, 4.3 * lines)
    for k, name in enumerate(names):
        panel = whole.add_subplot(lines, columns, k + 1)
        curves = [row for row in rows if row["application"] == name and row["kind"] == "curve"]
        greys = iter(("0.0", "0.25", "0.45", "0.6", "0.7", "0.8"))
        colours = iter(SEVERAL)
        for method in dict.fromkeys(row["method"] for row in curves):
            of = [row for row in curves if row["method"] == method]
            style, colour = ("--", next(greys)) if of[0]["classical"] else ("-", next(colours))
            panel.plot([row["us"] for row in of], [row["mse"] for row in of], style, color=colour, marker=".", lw=1.2,
                       label=method)  # fmt: skip
        panel.set(xscale="log", yscale="log", title=name)
        panel.set(xlabel="processor microseconds an integral", ylabel="mean squared error")
        panel.grid(alpha=0.3)
        panel.legend(fontsize=6, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    save(whole, DOCS / "equal-time.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a quarter of the integrals; writes nothing")
    parser.add_argument("--only", default=",".join(STUDIES))
    options = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = "1"
    torch.set_num_threads(1)
    kept = RESULTS / "equal_time.json"
    rows: list[Row] = json.loads(kept.read_text())["rows"] if kept.exists() else []
    for name in options.only.split(","):
        found = compared(name, STUDIES[name], 4 if options.quick else 1)
        rows = [row for row in rows if row["application"] != name] + found
        for row in found:
            if row["kind"] != "curve":
                Console().print(row)
        if not options.quick:
            print(write("equal_time", rows, seed=SEED, budgets=BUDGETS, most=MOST))
    if not options.quick:
        draw(rows)


if __name__ == "__main__":
    main()
