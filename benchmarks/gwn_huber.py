"""Does it help that errors beyond 1 count linearly in training (`Recipe.huber`), instead of squared?

    python benchmarks/gwn_huber.py [--quick] [--keep FOLDER]

Both networks go on from the checkpoint in training/gwn-uniform, from before its decay, on the same integrals for the
same short time with the decay at the end: once with the pseudo-Huber loss (knee 1), once with the plain square (knee
10^6). Mean squared errors on validation integrals that neither has seen.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import SEED, N, span
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.learn.inet import LearnedRule
from nqr_geom.integrator.learn.train import TrainConfig, draw_batch, train
from nqr_geom.recipes import RECIPES

START = Path(__file__).resolve().parents[1] / "training" / "gwn-uniform"
RECIPE = RECIPES["gwn-uniform"]
KNEES = (1.0, 1e6)
MORE, DECAY = 1000, 500


def continued(knee: float, folder: Path, more: int, decay: int) -> LearnedRule:
    """The network after `more` iterations with a knee, as a rule."""
    run = folder / f"huber-{knee:g}"
    if not run.exists():
        shutil.copytree(START, run)
    state = torch.load(START / "checkpoint.pt", weights_only=True)
    before = TrainConfig(**json.loads(state["train"]))
    config = replace(before, iterations=state["iteration"] + more, decay=decay, every=500)
    recipe = replace(RECIPE, huber=knee)
    return LearnedRule(train(recipe, run, config, progress=False).eval(), recipe.base_rule(), recipe.extra)


@torch.no_grad()
def squared_errors(rule: LearnedRule, integrals: int) -> np.ndarray:
    """On fresh validation integrals, (B, 1): random samples for even rows, stratified ones for odd."""
    parts = []
    for rows in (10**6 + torch.arange(integrals)).split(4096):
        batch, samples = draw_batch(RECIPE, rows, N, SEED, "validation")
        parts.append((rule.combine(samples).estimate(samples) - batch.answer).square().numpy())
    return np.concatenate(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a hundredth of the iterations; writes nothing")
    parser.add_argument("--keep", type=Path, help="folder for the runs; those that are there go on")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    less = 100 if arguments.quick else 1
    integrals = 4096 if arguments.quick else 65536
    with tempfile.TemporaryDirectory() as aside:
        folder = arguments.keep or Path(aside)
        rules = {knee: continued(knee, folder, MORE // less, DECAY // less) for knee in KNEES}
    errors = {knee: squared_errors(rule, integrals) for knee, rule in rules.items()}
    bootstrap = Bootstrap.of(np.arange(integrals), 1, SEED)
    rows: list[dict[str, Any]] = [
        {
            "knee": knee,
            "mse": float(e.mean()),
            "mse_interval": bootstrap.mean(e),
            "median": float(np.median(e)),
            "p99": float(np.quantile(e, 0.99)),
            "largest": float(e.max()),
            "ratio": float(errors[KNEES[1]].mean() / e.mean()),
            "ratio_interval": bootstrap.ratio(errors[KNEES[1]], e),
        }
        for knee, e in errors.items()
    ]
    table = Table("knee", "MSE", "95%", "median", "p99", "largest", "plain loss's over its", "95%")
    for row in rows:
        middle = [f"{row[key]:.2e}" for key in ("median", "p99", "largest")]
        last = [f"{row['ratio']:.3g}", span(row["ratio_interval"])]
        table.add_row(f"{row['knee']:g}", f"{row['mse']:.3e}", span(row["mse_interval"]), *middle, *last)
    Console(width=120).print(table)
    if not arguments.quick:
        print(write("gwn_huber", rows, n=N, seed=SEED, iterations=MORE, decay=DECAY, integrals=integrals))


if __name__ == "__main__":
    main()
