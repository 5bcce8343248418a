"""How a sampler is best begun: from nothing or on a base sampler, by gaps or by a grid; and what it adds at all.

    python benchmarks/joint_training.py [--quick] [--keep FOLDER]

Joint trainings of equal length and data on the toy family, all beginning with the network in training/toy-uniform as
their integrator. "frozen" leaves the sampler as it began: what remains is the integrator's own adaptation.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from figures import DOCS, SEVERAL, figure, save
from matplotlib.ticker import LogLocator
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.integrator.learn.joint import JointConfig, JointRecipe, train_jointly
from nqr_geom.integrator.learn.snet import SNetConfig
from nqr_geom.recipes import JOINT

ROOT = Path(__file__).resolve().parents[1]
PAPER, WARM = JOINT["toy-nqr-uniform"], JOINT["toy-nqr"].sampler
TRAINING = JointConfig(iterations=300, batch=16, every=50, warmup=50, average=0.98, validation=1024)
FROZEN = 0.0
VARIANTS: dict[str, tuple[SNetConfig, float]] = {
    "grid of 32 cells (the paper's head)": (
        SNetConfig(PAPER.sampler.tokens, head="grid", grid=((32,),)),
        TRAINING.sampler_rate,
    ),
    "gaps, from the uniform density": (PAPER.sampler, TRAINING.sampler_rate),
    "gaps, on the structured sampler": (WARM, TRAINING.sampler_rate),
    "uniform density, frozen": (PAPER.sampler, FROZEN),
    "structured sampler, frozen": (WARM, FROZEN),
}


def curve(folder: Path) -> list[tuple[int, float]]:
    """Iteration and validation error of a run."""
    with (folder / "loss.csv").open(newline="") as file:
        return [(int(line["iteration"]), float(line["validation_mse"])) for line in csv.DictReader(file)]


def trained(name: str, config: JointConfig, keep: Path) -> list[tuple[int, float]]:
    """The loss curve of a variant."""
    sampler, rate = VARIANTS[name]
    rule = replace(PAPER.rule, name=f"toy-{list(VARIANTS).index(name)}", sizes=((32, 1.0),))
    recipe = JointRecipe(rule, PAPER.begin, sampler, None if sampler.head == "grid" else PAPER.view)
    folder = keep / rule.name
    train_jointly(recipe, folder, replace(config, sampler_rate=rate), start_from=ROOT / "training" / PAPER.begin)
    return curve(folder)


def draw(
    curves: dict[str, list[tuple[int, float]]],
    monte_carlo: float,
    path: Path,
    xlabel: str = "iteration of joint training",
    ylabel: str = "Monte Carlo's error over the pair's",
) -> None:
    """Error against iteration, one line a variant; dots where colours come round again, dashes where it is frozen."""
    made = figure(7.0, 4.4)
    axes = made.add_subplot(xlabel=xlabel, ylabel=ylabel, yscale="log")
    for i, (name, points) in enumerate(curves.items()):
        at, mse = np.array(points).T
        line = "--" if "frozen" in name else "-" if i < len(SEVERAL) else ":"
        axes.plot(at, monte_carlo / mse, color=SEVERAL[i % len(SEVERAL)], label=name, linestyle=line)
    axes.yaxis.set_minor_locator(LogLocator(subs=[2, 3, 5]))
    for part in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        part("{x:g}")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14), frameon=False)
    save(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few iterations, to see that it runs; writes nothing")
    parser.add_argument("--keep", type=Path, help="folder of the runs, which are continued")
    arguments = parser.parse_args()
    config = replace(TRAINING, iterations=4, every=2, validation=64) if arguments.quick else TRAINING
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        keep = arguments.keep or Path(folder)
        curves = {name: trained(name, config, keep) for name in VARIANTS}
    batch = PAPER.rule.family(torch.arange(config.validation), config.seed, "validation")
    x = torch.rand(config.validation, 32, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    plain = (batch.problem.evaluate(x).value.mean(dim=1)[:, 0] - batch.answer).square().mean().item()
    rows = [
        {"variant": name, "mse": points[-1][1], "first": points[0][1], "ratio": plain / points[-1][1]}
        for name, points in curves.items()
    ]
    table = Table(
        "variant", f"MSE after {config.every}", f"after {config.iterations}", "x", title="joint training, toy"
    )
    for row in rows:
        table.add_row(row["variant"], f"{row['first']:.2e}", f"{row['mse']:.2e}", f"{row['ratio']:.0f}")
    Console().print(table)
    if arguments.quick:
        return
    draw(curves, plain, DOCS / "joint-training.png")
    print(write("joint_training", rows, iterations=config.iterations, batch=config.batch, group=config.group,
                every=config.every, monte_carlo=plain, curves=curves))  # fmt: skip


if __name__ == "__main__":
    main()
