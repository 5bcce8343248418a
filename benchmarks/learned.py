"""What learning adds: a base rule, a network on that base, and a network on the uniform base, on the same samples.

    python benchmarks/learned.py [toy gwn outside] [--quick]

Held-out integrals (split "test"): for gwn the centres of a fixed 128 x 128 grid over [-1, 1]^2, every eighth along both
axes, without those nearer than 1e-3 to the curve. Mean squared errors at 32 samples with 95% bootstrap intervals over
shapes, as ratios to plain Monte Carlo with random samples, and each learned rule's gain over its own base.

"outside" is Fig. 25: shapes that are not of the family, cut into parts of at most six pieces with 32 samples each,
against Monte Carlo with as many samples on the whole.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import check, registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.problem import Problem
from nqr_geom.integrator.rules import Rule

N = 32
SEED = 0
STRIDE = 8
NEAREST = 1e-3
DESIGNS = ("random", "stratified")
CLASSICAL = ("mc", "trapezoid")
# Structure-aware rule, network on it, network on the uniform base; the ratios that the paper reports.
LEARNED = {"toy": ("toy-hermite", "inet-toy-structured", "inet-toy-uniform"),
           "gwn": ("gwn-hermite", "inet-gwn-structured", "inet-gwn-uniform")}  # fmt: skip
PAPER = {"toy": {"random": 23.7, "stratified": 59.0}, "gwn": {"random": 15.2, "stratified": 61.0}}

Floats = NDArray[np.float64]


def grid_queries() -> Floats:
    """Every eighth centre of the 128 x 128 grid over [-1, 1]^2 along both axes, (256, 2)."""
    centre = (np.arange(STRIDE // 2, 128, STRIDE) + 0.5) / 64.0 - 1.0
    return np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1).reshape(-1, 2)


def gwn(shapes: int) -> tuple[Problem, NDArray[np.int64]]:
    """Winding numbers on held-out shapes, and the shape of each query."""
    from nqr_geom.curves.distance import distance
    from nqr_geom.curves.families import curves
    from nqr_geom.curves.problems import GwnProblem

    family, queries = curves(shapes, SEED, "test"), grid_queries()
    problem = GwnProblem.of(family, queries)
    far = np.concatenate([distance(curve, queries) >= NEAREST for curve in family])
    problem = problem.take(torch.from_numpy(np.flatnonzero(far)))
    return problem, problem.groups


def toy(integrands: int) -> tuple[Problem, NDArray[np.int64]]:
    """Held-out integrands, each its own group."""
    from nqr_geom.toy.problem import ToyProblem

    problem = ToyProblem.family(integrands, SEED, "test")
    return problem, problem.groups


def squared_errors(problem: Problem, design: str, rule: Rule, runs: int) -> tuple[Floats, float, float]:
    """Squared errors (B, runs), share of integrals that fell back, and microseconds an integral."""
    sampler, reference = registry.make("sampler", design), problem.reference()
    parts = [run(problem, sampler, rule, N, seed=SEED + r) for r in range(runs)]
    errors = np.concatenate([(part.value - reference) ** 2 for part in parts], axis=1)
    seconds = min(part.seconds for part in parts)
    return errors, float(np.mean([part.fallback.mean() for part in parts])), 1e6 * seconds / problem.batch


def rows_of(name: str, problem: Problem, groups: NDArray, runs: int, rules: dict[str, Rule]) -> list[dict[str, Any]]:
    """One row for each design and rule; the first is plain Monte Carlo, to which the ratios refer."""
    bootstrap = Bootstrap.of(groups, runs, SEED)
    bases = {f"inet-{name}-structured": LEARNED[name][0], f"inet-{name}-uniform": "mc"}
    errors: dict[tuple[str, str], Floats] = {}
    rows = []
    for design in DESIGNS:
        for label, rule in rules.items():
            e, fallback, micro = squared_errors(problem, design, rule, runs)
            errors[design, label] = e
            plain = errors["random", "mc"]
            row = {
                "problem": name,
                "design": design,
                "rule": label,
                "mse": float(e.mean()),
                "median": float(np.median(e)),
                "p99": float(np.quantile(e, 0.99)),
                "ratio": float(plain.mean() / e.mean()),
                "ratio_interval": bootstrap.ratio(plain, e),
                "fallback": fallback,
                "microseconds": micro,
            }
            if label in bases and (design, bases[label]) in errors:
                base = errors[design, bases[label]]
                row |= {"base": bases[label], "gain": float(base.mean() / e.mean())}
                row |= {"gain_interval": bootstrap.ratio(base, e), "paper": PAPER[name][design]}
            rows.append(row)
    return rows


def outside(runs: int, rules: dict[str, Rule]) -> list[dict[str, Any]]:
    """Shapes outside the family, part by part; intervals over runs."""
    from nqr_geom.curves.curve import Curve
    from nqr_geom.curves.distance import distance
    from nqr_geom.curves.families import house, impossible, knots
    from nqr_geom.curves.problems import GwnProblem

    glyph = Curve.from_text("&")
    x0, y0, x1, y1 = glyph.bounds
    fit = 1.6 / max(x1 - x0, y1 - y0)
    glyph = glyph.transformed([[fit, 0.0], [0.0, fit]], [-0.5 * fit * (x0 + x1), -0.5 * fit * (y0 + y1)])
    rows = []
    for label, curve in {"house": house(), "impossible": impossible(), "knots": knots(), "glyph &": glyph}.items():
        queries = grid_queries()
        problem = GwnProblem.of(curve, queries[distance(curve, queries) >= NEAREST])
        # Every part has its own rows, so that no two parts share their random numbers.
        parts = [
            replace(GwnProblem.of(part, problem.points.numpy()), rows=problem.rows + 2**40 * g)
            for g, part in enumerate(curve.split_pieces(6))
        ]
        reference = problem.reference()
        bootstrap = Bootstrap.of(problem.groups, runs, SEED)
        sampler = registry.make("sampler", "random")
        plain = [run(problem, sampler, rules["mc"], N * len(parts), seed=SEED + r).value for r in range(runs)]
        base = np.concatenate([(value - reference) ** 2 for value in plain], axis=1)
        for design in DESIGNS:
            for name, rule in rules.items():
                place = registry.make("sampler", design)
                answers = [[run(part, place, rule, N, seed=SEED + r) for part in parts] for r in range(runs)]
                e = np.concatenate([(sum(a.value for a in row) - reference) ** 2 for row in answers], axis=1)
                rows.append(
                    {
                        "problem": f"outside: {label}, {curve.n_pieces} pieces",
                        "design": design,
                        "rule": name,
                        "mse": float(e.mean()),
                        "median": float(np.median(e)),
                        "p99": float(np.quantile(e, 0.99)),
                        "ratio": float(base.mean() / e.mean()),
                        "ratio_interval": bootstrap.ratio(base, e),
                        "fallback": float(np.mean([[a.fallback.mean() for a in row] for row in answers])),
                    }
                )
    return rows


def show(name: str, rows: list[dict[str, Any]]) -> None:
    """Print the rows as a table."""
    table = Table(
        "problem", "samples", "rule", "MSE", "median", "p99", "x MC", "95%", "x own base", "95%", "paper", title=name
    )
    for row in rows:
        gain = [f"{row['gain']:.3g}", _span(row["gain_interval"]), f"{row['paper']}"] if "gain" in row else [""] * 3
        cells = [f"{row[key]:.2e}" for key in ("mse", "median", "p99")]
        table.add_row(
            row["problem"],
            row["design"],
            row["rule"],
            *cells,
            f"{row['ratio']:.3g}",
            _span(row["ratio_interval"]),
            *gain,
        )
    Console(width=150).print(table)


def _span(interval: tuple[float, float] | None) -> str:
    return "unbounded" if interval is None else f"{interval[0]:.3g} .. {interval[1]:.3g}"


def rules_for(name: str) -> dict[str, Rule]:
    """Classical rules, the structure-aware one, and the networks that ship."""
    known = {entry.name for entry in registry.entries("rule")}
    names = [*CLASSICAL, *(rule for rule in LEARNED[name] if rule in known)]
    return {label: registry.make("rule", label) for label in names}


def write_cards(rows: list[dict[str, Any]]) -> None:
    """Put what was measured on the networks into their cards."""
    from nqr_geom.integrator.learn.zoo import Card
    from nqr_geom.recipes import RECIPES, folder

    for row in rows:
        name = row["rule"].removeprefix("inet-")
        if name in RECIPES and row["problem"] == RECIPES[name].problem:
            path = folder(row["problem"]) / f"{name}.json"
            card = Card.from_json(path.read_text())
            kept = ("mse", "median", "p99", "ratio", "ratio_interval", "gain", "gain_interval", "fallback")
            card.table[row["design"]] = {key: row[key] for key in kept}
            path.write_text(card.to_json())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", default=["toy", "gwn", "outside"])
    parser.add_argument("--quick", action="store_true", help="a tenth of the integrals; writes nothing")
    arguments = parser.parse_args()
    less = 10 if arguments.quick else 1
    rows = []
    for name in arguments.problems:
        check.choice("problems", name, ["toy", "gwn", "outside"])
        rules = rules_for("gwn" if name == "outside" else name)
        if name == "outside":
            part = outside(16 // less + 1, rules)
        else:
            problem, groups = gwn(100 // less) if name == "gwn" else toy(20000 // less)
            part = rows_of(name, problem, groups, 1 if name == "gwn" else 2, rules)
        show(name, part)
        rows += part
    if not arguments.quick:
        write_cards(rows)
        write("learned", rows, n=N, seed=SEED, stride=STRIDE, nearest=NEAREST)


if __name__ == "__main__":
    main()
