"""What the offset, the outer loss and the absolute value are worth for smoothed distances: Fig. 44 of the paper.

    python benchmarks/sd_ablation.py [--quick] [--keep FOLDER]

Short trainings of equal length and data, all from the trunk of the winding number's network in training/gwn-uniform,
with the uniform base and one thing changed each. What a variant answers where its integral comes out negative is the
plain mean, as in the model that ships. Errors on held-out shapes, by distance from the curve as well.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import SEED, N, span
from figures import DOCS, SEVERAL, figure, save
from rich.console import Console
from rich.table import Table
from shapes import write
from torch import Tensor

from nqr_geom.curves.distance import distance
from nqr_geom.curves.problems import SdProblem
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.learn.inet import INet, UniformWeights, correct
from nqr_geom.integrator.learn.recipe import Batch, draw_samples, inner_answer
from nqr_geom.integrator.learn.run import RunFolder
from nqr_geom.integrator.learn.tokens import sort_samples, tokenize
from nqr_geom.integrator.learn.train import TrainConfig, draw_batch, learning_rate, widen
from nqr_geom.integrator.problem import LogLink, Samples
from nqr_geom.integrator.sums import row_mean
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream

ROOT = Path(__file__).resolve().parents[1]
TRUNK = RECIPES["gwn-uniform"]
RECIPE = replace(RECIPES["sd-uniform"], config=replace(RECIPES["sd-uniform"].config, reach=TRUNK.config.reach))
TRAINING = TrainConfig(iterations=1000, batch=64, warmup=100, decay=400, average=0.99, every=250, validation=2048)
FLOOR = 1e-8  # epsilon of Eq. 56
NEAR = (0.0, 0.05, 0.2, 0.5, np.inf)  # of distance from the curve


@dataclass(frozen=True)
class Variant:
    """One way to train.

    Parameters
    ----------
    name : str
        For the table.
    offset : {"inside", "outside", ""}
        G(F + o), G(F) + o / alpha, or none.
    inner, outer : float
        Shares of the two losses (Eq. 53).
    absolute : bool
        Whether the outer loss sees |F| (Eq. 56); otherwise F itself is clamped.
    raw : bool
        Whether the inner loss is that of F itself, as in Eq. 54, instead of relative to F.
    """

    name: str
    offset: str = "inside"
    inner: float = 0.2
    outer: float = 0.8
    absolute: bool = True
    raw: bool = False


VARIANTS = (
    Variant("all of it"),
    Variant("offset outside the link", offset="outside"),
    Variant("no offset", offset=""),
    Variant("no absolute value", absolute=False),
    Variant("no inner loss", inner=0.0, outer=1.0),
    Variant("no outer loss", inner=1.0, outer=0.0),
    Variant("no outer loss, F as it is", inner=1.0, outer=0.0, raw=True),
)


def answers(variant: Variant, net: INet, samples: Samples, link: LogLink) -> tuple[Tensor, Tensor, Tensor]:
    """Inner integrals, their plain means, and what is added behind the link, (B, 1) each."""
    tokens = tokenize(samples, RECIPE.config.tokens, RECIPE.extra).flatten(1, 2)
    raw = net(tokens).view(*samples.value.shape[:3], -1)
    aside = row_mean(raw[..., -1].double()) / link.alpha  # (B, 1)
    if variant.offset != "inside":
        raw = torch.cat([raw[..., :-1], torch.zeros_like(raw[..., -1:])], dim=-1)
    base = UniformWeights().combine(samples)
    inner = correct(raw, base, samples, RECIPE.config).estimate(samples)
    return inner, base.estimate(samples), aside if variant.offset == "outside" else torch.zeros_like(aside)


def lesson(variant: Variant, net: INet, batch: Batch, samples: Samples) -> Tensor:
    """The loss of a batch."""
    samples, link = batch.problem.finalize(samples)
    inner, _, aside = answers(variant, net, samples, link)
    truth = inner_answer(batch.answer, link)
    seen = inner.abs() if variant.absolute else inner
    behind = link.alpha * (replace(link, floor=FLOOR)(seen) + aside - batch.answer)
    if variant.raw:
        before = (inner - truth) * torch.exp(-link.alpha * link.shift)
    else:
        before = (inner - truth) / torch.maximum(truth, inner.detach())

    def robust(error: Tensor) -> Tensor:
        knee = RECIPE.huber
        return (2.0 * knee**2 * (torch.sqrt(1.0 + (error / knee) ** 2) - 1.0)).mean()

    return variant.inner * robust(before) + variant.outer * robust(behind)


def estimate(variant: Variant, net: INet, samples: Samples, link: LogLink) -> Tensor:
    """Smoothed distances (B, 1) at inference."""
    inner, plain, aside = answers(variant, net, samples, link)
    return torch.where(inner > 0.0, link(inner) + aside, link(plain))


def fresh(start: Path, seed: int) -> INet:
    """The trunk of another network with heads that are zero; quantities that it did not know weigh nothing."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net = INet(RECIPE.config)
    trunk = torch.load(start / "checkpoint.pt", weights_only=True)["average"]
    trunk = {name: tensor for name, tensor in trunk.items() if not name.startswith("head.")}
    widen(trunk, net)
    net.load_state_dict(trunk, strict=False)
    return net


def learn(variant: Variant, config: TrainConfig, run: RunFolder) -> INet:
    """Train a variant, or load what an earlier call left in the folder."""
    net, average = (fresh(ROOT / "training" / TRUNK.name, config.seed) for _ in range(2))
    state = run.load()
    if state is not None and state["iteration"] == config.iterations:
        average.load_state_dict(state["average"])
        return average
    run.checkpoint.unlink(missing_ok=True)
    run.load()
    optimizer = torch.optim.AdamW(net.parameters(), lr=config.rate, betas=(0.9, 0.98), weight_decay=config.weight_decay)
    began, losses = time.monotonic(), []
    for iteration in range(config.iterations):
        optimizer.param_groups[0]["lr"] = learning_rate(config, iteration)
        rows = torch.arange(iteration * config.batch, (iteration + 1) * config.batch)
        batch, samples = draw_batch(RECIPE, rows, N, config.seed, "train")
        with torch.autocast("cpu", torch.bfloat16):
            loss = lesson(variant, net, batch, samples)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), config.clip)
        optimizer.step()
        keep = min(config.average, (1 + iteration) / (10 + iteration))
        with torch.no_grad():
            torch._foreach_lerp_(list(average.parameters()), list(net.parameters()), 1.0 - keep)
        losses.append(loss.item())
        if (iteration + 1) % config.every == 0:
            seconds = time.monotonic() - began
            line = (learning_rate(config, iteration), float(np.mean(losses)), *validate(variant, average, config))
            run.log((iteration + 1, seconds, *line))
            losses = []
    run.save({"iteration": config.iterations, "average": average.state_dict()})
    return average


def validation(config: TrainConfig) -> Iterator[tuple[Samples, LogLink, Tensor]]:
    """Samples, link and answers of the validation split."""
    for rows in torch.arange(config.validation).split(1024):
        batch, samples = draw_batch(RECIPE, rows, N, config.seed, "validation")
        yield (*batch.problem.finalize(samples), batch.answer)


@torch.no_grad()
def validate(variant: Variant, net: INet, config: TrainConfig) -> tuple[float, float]:
    """Mean squared error of the variant and of Monte Carlo on validation integrals."""
    errors = []
    for samples, link, answer in validation(config):
        pair = estimate(variant, net, samples, link), link(row_mean(samples.value[:, :, 0]))
        errors.append(torch.stack([(value - answer).square() for value in pair]))
    mine, plain = torch.cat(errors, dim=1).mean(dim=(1, 2)).tolist()
    return mine, plain


@torch.no_grad()
def squared_errors(problem: SdProblem, nets: dict[str, INet]) -> dict[str, np.ndarray]:
    """Squared errors (B,) of Monte Carlo and every variant on the same random samples."""
    drawn = sort_samples(draw_samples(problem, ("random",), N, Stream(SEED, "test", "samples/0")))
    samples, link = problem.finalize(drawn)
    truth = torch.from_numpy(problem.reference())
    found = {"MC": link(row_mean(samples.value[:, :, 0]))}
    for variant in VARIANTS:
        found[variant.name] = estimate(variant, nets[variant.name], samples, link)
    return {name: (value - truth).square().numpy()[:, 0] for name, value in found.items()}


def rows_of(
    errors: dict[str, np.ndarray], away: np.ndarray, groups: np.ndarray, config: TrainConfig
) -> list[dict[str, Any]]:
    """One row a variant, with its ratio to Monte Carlo on the same samples, over all and by distance."""
    bootstrap = Bootstrap.of(groups, 1, SEED)
    bins = [(away >= low) & (away < high) for low, high in pairwise(NEAR)]
    return [
        {
            "variant": name,
            "n": N,
            "iterations": config.iterations,
            "batch": config.batch,
            "mse": float(e.mean()),
            "median": float(np.median(e)),
            "p99": float(np.quantile(e, 0.99)),
            "ratio": float(errors["MC"].mean() / e.mean()),
            "ratio_interval": bootstrap.ratio(errors["MC"][:, None], e[:, None]),
            "mse_by_distance": [float(e[inside].mean()) for inside in bins],
        }
        for name, e in errors.items()
    ]


def draw(rows: list[dict[str, Any]], history: dict[str, dict[str, list[float]]], path: Path) -> None:
    """Validation error while learning, and the error by distance afterwards."""
    picture = figure(11.0, 4.4)
    left, right = picture.subplots(1, 2)
    colours = dict(zip((v.name for v in VARIANTS), (*SEVERAL, "0.3"), strict=True))
    for name, curve in history.items():
        left.plot(curve["iteration"], curve["mse"], color=colours[name], label=name, lw=1.5)
    left.set(xlabel="iteration", ylabel="mean squared error, validation", yscale="log")
    left.legend(fontsize=8)
    labels = [f"{low:g} to {high:g}" for low, high in pairwise(NEAR[:-1])] + [f"over {NEAR[-2]:g}"]
    for row in rows:
        style = {"color": "0.15", "ls": "--"} if row["variant"] == "MC" else {"color": colours[row["variant"]]}
        right.plot(labels, row["mse_by_distance"], marker="o", ms=4.0, lw=1.2, label=row["variant"], **style)
    right.set(xlabel="distance from the curve", ylabel="mean squared error, held-out shapes", yscale="log")
    right.set_title("dashed: Monte Carlo", fontsize=9)
    for panel in (left, right):
        panel.grid(color="0.92")
    save(picture, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a hundredth of the iterations; writes nothing")
    parser.add_argument("--keep", type=Path, help="folder for the networks; those that are there are not trained again")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = replace(TRAINING, iterations=10, every=5, decay=5, validation=64) if arguments.quick else TRAINING
    with tempfile.TemporaryDirectory() as aside:
        folder = arguments.keep or Path(aside)
        runs = {v.name: RunFolder(folder / v.name.replace(", ", "-").replace(" ", "-")) for v in VARIANTS}
        nets = {variant.name: learn(variant, config, runs[variant.name]) for variant in VARIANTS}
        curves = {name: np.genfromtxt(run.curve, delimiter=",", names=True) for name, run in runs.items()}
    problem = SdProblem.family(2 if arguments.quick else 16, SEED, "test", resolution=16 if arguments.quick else 32)
    points, shape = problem.points.numpy(), problem.groups
    away = np.concatenate([distance(c, points[shape == k]) for k, c in enumerate(problem.curves)])
    rows = rows_of(squared_errors(problem, nets), away, shape, config)
    table = Table(
        "variant", "MSE", "median", "p99", "x MC", "95%", title=f"{config.iterations} iterations, {N} samples"
    )
    for row in rows:
        cells = [f"{row[key]:.2e}" for key in ("mse", "median", "p99")]
        table.add_row(row["variant"], *cells, f"{row['ratio']:.3g}", span(row["ratio_interval"]))
    Console(width=120).print(table)
    history = {
        name: {"iteration": c["iteration"].astype(int).tolist(), "mse": c["validation_mse"].tolist()}
        for name, c in curves.items()
    }
    if arguments.quick:
        return
    draw(rows, history, DOCS / "sd-ablation.png")
    print(write("sd_ablation", rows, n=N, seed=SEED, curves=history))


if __name__ == "__main__":
    main()
