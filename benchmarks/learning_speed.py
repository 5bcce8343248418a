"""What makes the network on plain weights learn: the optimiser, how iterations count, what it reads of neighbours.

    python benchmarks/learning_speed.py [--quick] [--keep FOLDER]

Trainings of equal length on the same integrals of the toy family in the same order, each without one of the things
that toy-uniform has, and one without any, heads that read the tokens included: the paper's transformer by AdamW. Errors
are those of the averaged weights on validation integrals, random and stratified samples half and half, from before any
decay of the learning rate.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import torch
from figures import DOCS
from joint_training import curve, draw
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.integrator.learn.learner import Optimizer
from nqr_geom.integrator.learn.recipe import Recipe
from nqr_geom.integrator.learn.train import TrainConfig, draw_batch, train
from nqr_geom.integrator.sums import row_mean
from nqr_geom.recipes import RECIPES
from nqr_geom.toy.tokens import TOY_TOKENS

WHOLE = RECIPES["toy-uniform"]
TRAINING = TrainConfig(iterations=700, batch=512, warmup=250, every=70)
ALONE = replace(WHOLE.config, reach=0)
_SHORT = replace(WHOLE.config.tokens, extra=TOY_TOKENS.size)


_PLAIN = replace(ALONE, tokens=_SHORT, direct=False)
VARIANTS: dict[str, tuple[Recipe, Optimizer]] = {
    "as it ships": (WHOLE, "muon"),
    "by AdamW": (WHOLE, "adamw"),
    "iterations of few samples count more": (replace(WHOLE, alike=False), "muon"),
    "blocks that read no neighbours": (replace(WHOLE, config=ALONE), "muon"),
    "no Taylor terms": (replace(WHOLE, config=replace(WHOLE.config, tokens=_SHORT), extra=TOY_TOKENS), "muon"),
    "none of them": (replace(WHOLE, config=_PLAIN, extra=TOY_TOKENS, alike=False), "adamw"),
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
    arguments = parser.parse_args()
    config = replace(TRAINING, iterations=4, batch=16, every=2, validation=64) if arguments.quick else TRAINING
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        curves = {name: trained(name, config, arguments.keep or Path(folder)) for name in VARIANTS}
    plain = monte_carlo(config)
    whole = curves["as it ships"]
    ends = {name: points[-1][1] for name, points in curves.items()}
    rows = [
        {"variant": name, "mse": mse, "ratio": plain / mse, "as_good_at": sooner(whole, mse)}
        for name, mse in ends.items()
    ]
    table = Table("variant", f"MSE after {config.iterations}", "x", "as it ships is there at", title="toy-uniform")
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
