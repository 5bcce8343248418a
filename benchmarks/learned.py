"""What learning adds: a base rule, a network on that base, and a network on the uniform base, on the same samples.

    python benchmarks/learned.py [toy gwn] [--quick | --samplers]

Held-out integrals (split "test"): for gwn the centres of a fixed 128 x 128 grid over [-1, 1]^2, every eighth along both
axes, without those nearer than 1e-3 to the curve. Mean squared errors at 32 samples with 95% bootstrap intervals over
shapes, as ratios to plain Monte Carlo with random samples, and each learned rule's gain over its own base.

What is measured on networks that ship goes into their cards.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import PLAIN, SEED, N, pairs_for, rows_of, show
from numpy.typing import NDArray
from shapes import write

from nqr_geom import check, registry
from nqr_geom.integrator.problem import Problem

KEPT = Path(__file__).parent / "results" / "learned.json"
STRIDE = 8
NEAREST = 1e-3
ROUNDING = 1e-20  # of squared errors: below, one query decides the mean, and a card keeps the one it has
# Ratios that the paper reports for its networks (Tables 1, 2 and 11).
PAPER = {"toy": {"random": 23.7, "stratified": 59.0}, "gwn": {"random": 15.2, "stratified": 61.0}}

Floats = NDArray[np.float64]


def grid_queries() -> Floats:
    """Every eighth centre of the 128 x 128 grid over [-1, 1]^2 along both axes, (256, 2)."""
    centre = (np.arange(STRIDE // 2, 128, STRIDE) + 0.5) / 64.0 - 1.0
    return np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1).reshape(-1, 2)


def gwn(shapes: int) -> Problem:
    """Winding numbers on held-out shapes."""
    from nqr_geom.curves.distance import distance
    from nqr_geom.curves.families import curves
    from nqr_geom.curves.problems import GwnProblem

    family, queries = curves(shapes, SEED, "test"), grid_queries()
    problem = GwnProblem.of(family, queries)
    far = np.concatenate([distance(curve, queries) >= NEAREST for curve in family])
    return problem.take(torch.from_numpy(np.flatnonzero(far)))


def toy(integrands: int) -> Problem:
    """Held-out integrands, each its own group."""
    from nqr_geom.toy.problem import ToyProblem

    return ToyProblem.family(integrands, SEED, "test")


def structured(name: str) -> tuple[str, str]:
    """Sampler and rule of the problem's structured method."""
    return registry.method("structured", name)


def write_cards(rows: list[dict[str, Any]]) -> None:
    """Put what was measured on the networks into their cards."""
    from nqr_geom.integrator.learn.zoo import Card, write_card
    from nqr_geom.recipes import JOINT, RECIPES, folder, rule_of

    kept = ("mse", "mse_error", "median", "p99", "ratio", "ratio_interval", "base", "gain", "gain_interval", "fallback")
    for row in rows:
        name = row["rule"].removeprefix("inet-")
        if name not in (*RECIPES, *JOINT) or row["rule"] == name or row["problem"] != rule_of(name).problem:
            continue
        if row["design"].startswith("snet-") == (name in JOINT):  # a network is at home on what it was trained on
            card = Card.from_json((folder(row["problem"]) / f"{name}.json").read_text())
            known = card.table.get(row["design"])
            if known is not None and max(known["mse"], row["mse"]) < ROUNDING:
                continue
            card.table[row["design"]] = {key: row[key] for key in kept if key in row}
            write_card(folder(row["problem"]), card)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", default=["toy", "gwn"])
    parser.add_argument("--quick", action="store_true", help="a tenth of the integrals; writes nothing")
    parser.add_argument("--samplers", action="store_true", help="sampling networks alone, on a fifth of the integrals")
    arguments = parser.parse_args()
    less = 10 if arguments.quick else 5 if arguments.samplers else 1
    rows: list[dict[str, Any]] = []
    for name in arguments.problems:
        check.choice("problems", name, ["toy", "gwn"])
        problem = gwn(100 // less) if name == "gwn" else toy(20000 // less)
        pairs = pairs_for(name, ("mc", "trapezoid"))
        if arguments.samplers:
            pairs = [PLAIN, *(pair for pair in pairs if pair[0].startswith("snet-") or pair == structured(name))]
        part = rows_of(name, problem, pairs, runs=1 if name == "gwn" or arguments.samplers else 2)
        for row in part:
            if "gain" in row and row["design"] in PAPER[name]:
                row["paper"] = PAPER[name][row["design"]]
        show(name, part)
        rows += part
    if not arguments.quick:
        write_cards(rows)
        others = json.loads(KEPT.read_text())["rows"] if KEPT.exists() else []
        if arguments.samplers:  # the other rows stay; so does Monte Carlo's, on all integrals
            rows = [row for row in rows if row["design"] != "random"]
            new = {(row["problem"], row["design"], row["rule"]) for row in rows}
            old = [row for row in others if (row["problem"], row["design"], row["rule"]) not in new]
            rows = [row for row in old if row["problem"] in arguments.problems] + rows
            others = [row for row in old if row["problem"] not in arguments.problems]
        rows += [row for row in others if arguments.samplers or row["problem"] not in arguments.problems]
        write("learned", rows, n=N, seed=SEED, stride=STRIDE, nearest=NEAREST)


if __name__ == "__main__":
    main()
