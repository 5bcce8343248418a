"""Tables 1, 2, 7 and 9 of the paper on the toy family: five test integrands, their average, and many more.

    python benchmarks/toy_tables.py [--quick]

The five are the first held-out ones of the family, with samples of their own in every run. Beside the rules stands what
hidden breaks leave to one that knows every piece (`Pieces.break_variance`): a break is uniform in its gap, so with jump
J and gap h it leaves J^2 h^2 / 12. A rule that also weighs how likely a jump is, as the structure-aware one does, can
do better, and on stratified samples does. A piece with fewer than three samples cannot be known, so integrands whose
random samples give every piece three are listed apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from comparison import DESIGNS, SEED, N, pairs_for, rows_of, show
from shapes import write
from torch import Tensor
from toy_scenes import SCENES, scenes

from nqr_geom import registry
from nqr_geom.streams import Stream
from nqr_geom.toy.family import PIECES
from nqr_geom.toy.problem import ToyProblem

AVERAGE = "average of five"
DETERMINED = "held out, three samples in every piece"
LAW = 3  # samples that determine a piece


def points(problem: ToyProblem, design: str) -> Tensor:
    """Where a design samples the first run, (B, N)."""
    x: Tensor = registry.make("sampler", design).points(problem.rows, N, 1, Stream(SEED, "test", "samples/0"))
    return x[..., 0]


def determined(problem: ToyProblem) -> ToyProblem:
    """The integrands of which random samples see every piece often enough to know it."""
    piece = problem.pieces.evaluate(points(problem, "random"))[2]
    seen = torch.nn.functional.one_hot(piece, PIECES).sum(dim=1)
    return problem.take((seen >= LAW).all(dim=1).nonzero()[:, 0])


def bounds(label: str, problem: ToyProblem, plain: float, designs: Sequence[str] = DESIGNS) -> list[dict[str, Any]]:
    """What breaks leave on the same samples."""
    rows = []
    for design in designs:
        x = points(problem, design)
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
    part = rows_of(DETERMINED, determined(family), [pair for pair in pairs if pair[0] == "random"])
    show(DETERMINED, part)
    rows += part + bounds(DETERMINED, determined(family), part[0]["mse"], ("random",))
    part = rows_of("held out", family, pairs)
    show(f"{family.batch} held-out integrands", part)
    rows += part + bounds("held out", family, part[0]["mse"])
    for row in rows:
        if row["rule"] == "pieces known":
            print(f"{row['problem']}, {row['design']}, pieces known: {row['mse']:.3g} ({row['ratio']:.3g} x)")
    if not quick:
        print(
            write(
                "toy_tables",
                rows,
                n=N,
                seed=SEED,
                runs=4000,
                integrands=family.batch,
                determined=determined(family).batch,
            )
        )


if __name__ == "__main__":
    main()
