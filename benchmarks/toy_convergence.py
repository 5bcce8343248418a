"""How errors fall with the number of samples: Figs. 9 and 15 of the paper, N = 1 to 64, every rule and sampler.

    python benchmarks/toy_convergence.py [--quick]

Draws docs/toy-convergence.png: the mean over many held-out integrands, and four of them (the first ones) on their own.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from comparison import DESIGNS, PLAIN, SEED, pairs_for, rows_of, trained_sampler
from figures import COLOURS, DOCS, SEVERAL, figure, save
from page import NAMES
from shapes import write
from toy_scenes import scenes

from nqr_geom.toy.problem import ToyProblem

SIZES = (1, 2, 4, 8, 16, 32, 64)
SHOWN = 4
DRAWN = DOCS / "toy-convergence.png"
PANELS = ("held out", *(f"{scene + 1}" for scene in range(SHOWN)))


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """One column an integrand; random samples above (Fig. 9), stratified and adaptive ones below (Fig. 15)."""
    picture = figure(15.0, 6.4)
    axes = picture.subplots(2, len(PANELS), sharex=True, sharey="row")
    for k, case in enumerate(PANELS):
        for line, lower in enumerate((False, True)):
            panel = axes[line, k]
            mine = [r for r in rows if r["problem"] == case and (r["design"] != "random") == lower]
            for design, rule in dict.fromkeys((r["design"], r["rule"]) for r in mine):
                curve = [(r["n"], r["mse"]) for r in mine if (r["design"], r["rule"]) == (design, rule)]
                panel.loglog(*zip(*curve, strict=True), **_look(design, rule))
            if lower:
                plain = [(r["n"], r["mse"]) for r in rows if (r["problem"], r["design"], r["rule"]) == (case, *PLAIN)]
                panel.loglog(*zip(*plain, strict=True), color="0.15", ls=":", lw=1.2, label="MC, random")
            panel.axvline(32, color="0.75", lw=0.8, ls="--", zorder=0)
            panel.grid(True, which="major", alpha=0.25)
            if not line:
                panel.set_title("mean over held-out integrands" if k == 0 else f"integrand {case}", fontsize=10)
            else:
                panel.set_xlabel("samples")
    # Regression with hardly more points than terms goes off the chart, as it should.
    axes[0, 0].set_ylim(1e-5, 10.0)
    axes[1, 0].set_ylim(top=10.0)
    axes[0, 0].set_ylabel("random samples\nmean squared error")
    axes[1, 0].set_ylabel("stratified and adaptive samples\nmean squared error")
    axes[0, 0].set_xticks(SIZES, [str(n) for n in SIZES])
    axes[0, 0].minorticks_off()
    for line in (0, 1):
        axes[line, -1].legend(loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, fontsize=8.5)
    save(picture, path)


def _look(design: str, rule: str) -> dict[str, Any]:
    """Colour by rule, that of a pair its own; adaptive samplers by dashes and marks."""
    name = NAMES.get(rule, rule)
    if design in DESIGNS:
        return {"color": COLOURS.get(rule, SEVERAL[5]), "ls": "-", "marker": "o", "ms": 3.0, "lw": 1.5, "label": name}
    pair = rule.removeprefix("inet-") == design.removeprefix("snet-")
    trained = trained_sampler("toy")
    if trained is not None and design == trained[0]:
        marks = {"ls": "-.", "marker": "s"}
    else:
        marks = {"ls": ":", "marker": "^"} if design.startswith("snet-") else {"ls": "--", "marker": "D"}
    colour, name = (SEVERAL[3], "the pair's INet") if pair else (COLOURS.get(rule, "0.5"), name)
    return {"color": colour, "ms": 3.0, "lw": 1.5, "label": f"{name}, {design}", **marks}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a twentieth of the runs; writes no results")
    parser.add_argument("--out", type=Path, default=DRAWN)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    runs, integrands = (50, 250) if arguments.quick else (1000, 5000)
    pairs = pairs_for("toy")
    rows: list[dict[str, Any]] = []
    for n in SIZES:
        rows += rows_of("held out", ToyProblem.family(integrands, SEED, "test"), pairs, n=n)
        for scene in range(SHOWN):
            rows += rows_of(f"{scene + 1}", scenes(runs, scene), pairs, n=n)
    if not (arguments.quick and arguments.out == DRAWN):
        draw(rows, arguments.out)
    if not arguments.quick:
        print(write("toy_convergence", rows, sizes=SIZES, seed=SEED, runs=runs, integrands=integrands))


if __name__ == "__main__":
    main()
