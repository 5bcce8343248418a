"""What makes the network on plain weights learn: what it reads, what it is taught, the optimiser.

    python benchmarks/learning_speed.py [--quick] [--keep FOLDER] [--only NAME ...]

Trainings of equal length on the same integrals of the toy family in the same order: toy-uniform; the same, taught the
error of the sum and not its parts; the network before, with heads for every weight, which knows no laws of pieces; that
without one thing after the other, and without any, heads that read the tokens included: the paper's transformer by
AdamW. Errors are those of the averaged weights on validation integrals, random and stratified samples half and half,
from before any decay of the learning rate. What is not run anew is taken from the last report.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from figures import DOCS
from joint_training import curve, draw
from rich.console import Console
from rich.table import Table
from shapes import RESULTS, write

from nqr_geom.integrator.learn.inet import INetConfig
from nqr_geom.integrator.learn.learner import Optimizer
from nqr_geom.integrator.learn.recipe import Recipe
from nqr_geom.integrator.learn.tokens import Extra
from nqr_geom.integrator.learn.train import TrainConfig, draw_batch, train
from nqr_geom.integrator.sums import row_mean
from nqr_geom.recipes import RECIPES
from nqr_geom.toy.tokens import TOY_TERMS, TOY_TOKENS

WHOLE = replace(RECIPES["toy-uniform"], designs=("random", "stratified"))
KEPT = RESULTS / "learning_speed.json"
TRAINING = TrainConfig(iterations=700, batch=512, warmup=250, every=70)


def _before(extra: Extra = TOY_TERMS, **options: Any) -> Recipe:
    """The network that knows no laws of pieces."""
    tokens = replace(WHOLE.config.tokens, extra=extra.size)
    return replace(WHOLE, config=INetConfig(tokens, unit_mass=True, **options), extra=extra, missed=None)


_BEFORE = _before(direct=True, reach=1)
VARIANTS: dict[str, tuple[Recipe, Optimizer]] = {
    "as it ships": (WHOLE, "muon"),
    "taught the error of the sum": (replace(WHOLE, missed=None), "muon"),
    "no laws of pieces": (_BEFORE, "muon"),
    "nor Muon": (_BEFORE, "adamw"),
    "nor iterations that count alike": (replace(_BEFORE, alike=False), "muon"),
    "nor blocks that read neighbours": (_before(direct=True), "muon"),
    "nor Taylor terms": (_before(TOY_TOKENS, direct=True, reach=1), "muon"),
    "none of them": (replace(_before(TOY_TOKENS), alike=False), "adamw"),
}


def trained(name: str, config: TrainConfig, keep: Path) -> list[tuple[int, float]]:
    """The loss curve of a variant."""
    made, optimizer = VARIANTS[name]
    folder = keep / f"speed-{list(VARIANTS).index(name)}"
    train(made, folder, replace(config, optimizer=optimizer))
    return curve(folder)


def monte_carlo(config: TrainConfig) -> float:
    """Squared error of the plain mean of the same samples."""
    batch, samples = draw_batch(WHOLE, torch.arange(config.validation), 32, config.seed, "validation")
    return (row_mean(samples.value[:, :, 0, 0])[:, None] - batch.answer).square().mean().item()


def sooner(points: list[tuple[int, float]], mse: float) -> float | None:
    """Iterations until the error is no larger than `mse`, None if it never is."""
    return next((float(at) for at, error in points if error <= mse), None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few iterations, to see that it runs; writes nothing")
    parser.add_argument("--keep", type=Path, help="folder of the runs, which are continued")
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    arguments = parser.parse_args()
    config = replace(TRAINING, iterations=4, batch=16, every=2, validation=64) if arguments.quick else TRAINING
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        new = {name: trained(name, config, arguments.keep or Path(folder)) for name in arguments.only}
    kept = {} if len(new) == len(VARIANTS) else json.loads(KEPT.read_text())["settings"]["curves"]
    curves = {name: new.get(name, kept.get(name)) for name in VARIANTS if name in new or name in kept}
    plain = monte_carlo(config)
    first = next(iter(curves.values()))
    ends = {name: points[-1][1] for name, points in curves.items()}
    rows = [
        {"variant": name, "mse": mse, "ratio": plain / mse, "as_good_at": sooner(first, mse)}
        for name, mse in ends.items()
    ]
    table = Table("variant", f"MSE after {config.iterations}", "x", "the first is there at", title="toy-uniform")
    for row in rows:
        table.add_row(row["variant"], f"{row['mse']:.2e}", f"{row['ratio']:.1f}", str(row["as_good_at"]))
    Console().print(table)
    if arguments.quick:
        return
    draw(curves, plain, DOCS / "learning-speed.png", "iteration of training", "Monte Carlo's error over the network's")
    print(write("learning_speed", rows, iterations=config.iterations, batch=config.batch, every=config.every,
                monte_carlo=plain, curves=curves))  # fmt: skip


if __name__ == "__main__":
    main()
