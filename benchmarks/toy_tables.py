"""Tables 1, 2, 7 and 9 of the paper on the toy family: five test integrands, their average, and many more.

    python benchmarks/toy_tables.py [--quick]

The five are the first held-out ones of the family, with samples of their own in every run. Beside the rules stands what
hidden breaks leave to one that knows every piece (`Pieces.break_variance`): a break is uniform in its gap, so with jump
J and gap h it leaves J^2 h^2 / 12. A rule that also weighs how likely a jump is, as the structure-aware one does, can
do better, and on stratified samples does.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from comparison import DESIGNS, SEED, N, pairs_for, rows_of, show
from shapes import write
from toy_scenes import SCENES, scenes

from nqr_geom import registry
from nqr_geom.streams import Stream
from nqr_geom.toy.problem import ToyProblem

AVERAGE = "average of five"


def bounds(label: str, problem: ToyProblem, plain: float) -> list[dict[str, Any]]:
    """What breaks leave on the same samples."""
    rows = []
    for design in DESIGNS:
        x = registry.make("sampler", design).points(problem.rows, N, 1, Stream(SEED, "test", "samples/0"))[..., 0]
        left = float(problem.pieces.break_variance(x).mean())
        rows.append({"problem": label, "design": design, "rule": "pieces known", "mse": left, "ratio": plain / left})
    return rows


def average(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The mean of the five integrands' errors, as in Tables 1 and 2."""
    result = []
    plain = float(np.mean([r["mse"] for r in rows if (r["design"], r["rule"]) == ("random", "mc")]))
    for pair in dict.fromkeys((r["design"], r["rule"]) for r in rows):
        same = [r for r in rows if (r["design"], r["rule"]) == pair]
        mse = float(np.mean([r["mse"] for r in same]))
        row = {"problem": AVERAGE, "design": pair[0], "rule": pair[1], "mse": mse, "ratio": plain / mse}
        if "variance" in same[0]:
            row["variance"] = float(np.mean([r["variance"] for r in same]))
        result.append(row)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a twentieth of the runs; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    pairs = pairs_for("toy")
    rows: list[dict[str, Any]] = []
    for scene in range(SCENES):
        problem = scenes(200 if quick else 4000, scene)
        part = rows_of(f"{scene + 1}", problem, pairs, repeated=True)
        show(f"integrand {scene + 1}", part)
        rows += part + bounds(f"{scene + 1}", problem, part[0]["mse"])
    rows += average(rows)
    family = ToyProblem.family(1000 if quick else 20000, SEED, "test")
    part = rows_of("held out", family, pairs)
    show(f"{family.batch} held-out integrands", part)
    rows += part + bounds("held out", family, part[0]["mse"])
    for row in rows:
        if row["rule"] == "pieces known":
            print(f"{row['problem']}, {row['design']}, pieces known: {row['mse']:.3g} ({row['ratio']:.3g} x)")
    if not quick:
        print(write("toy_tables", rows, n=N, seed=SEED, runs=4000, integrands=family.batch))


if __name__ == "__main__":
    main()
