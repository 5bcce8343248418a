"""What does the learned integrator need: weights or values (Fig. 8), and more than x and f (Fig. 10)?

    python benchmarks/toy_ablation.py [--quick] [--keep FOLDER]

Transformers of one size see the same integrals in the same order, 32 random samples each, for a short time: 2,500
iterations of 256 (the plain ones 1,000), well under a percent of the paper's 800,000, so the curves matter, not where
they end. Weights and values are compared twice:

- as in all of our networks: f counts from its row's mean in the row's unit. Weights W = e^g + h of mean 1, against
  values: the row's mean plus the mean of what the network predicts;
- "plain", the paper's: W = 1 + h and no more, against the mean of predicted values, both from f as it is.

Without information, derivative and piece index are zero for every sample, in training and in the test.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from figures import COLOURS, DOCS, SEVERAL, figure, save
from rich.console import Console
from rich.table import Table
from shapes import write
from torch import Tensor
from toy_scenes import blinded, scenes

from nqr_geom import registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.learn.inet import INet, INetConfig, UniformWeights, correct
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.integrator.learn.run import RunFolder
from nqr_geom.integrator.learn.tokens import sort_samples, standard, tokenize
from nqr_geom.integrator.learn.train import TrainConfig, draw_batch, learning_rate
from nqr_geom.integrator.problem import Problem, Samples
from nqr_geom.integrator.sums import row_mean
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.tokens import TOY_TOKENS

N = 32
SEED = 0
_ROW = INetConfig(replace(RECIPES["toy-uniform"].config.tokens, extra=TOY_TOKENS.size), unit_mass=True)
RECIPE = replace(RECIPES["toy-uniform"], designs=("random",), sizes=((N, 1.0),), config=_ROW, extra=TOY_TOKENS)
TRAINING = TrainConfig(iterations=2500, batch=256, warmup=250, decay=500, every=125, validation=4096, seed=SEED)
SHORTER = replace(TRAINING, iterations=1000, decay=200)
_PLAIN = replace(_ROW, tokens=replace(_ROW.tokens, unit=1.0, centred=False), weights="additive", unit_mass=False)


@dataclass(frozen=True)
class Variant:
    """A network and what is made of its outputs.

    Parameters
    ----------
    name : str
        In the figure.
    config : INetConfig
        Tokens and architecture; every variant has as many parameters, but for the head.
    values : bool
        Whether the outputs are values to be averaged instead of weights.
    blind : bool
        Whether derivative and piece index are hidden.
    training : TrainConfig
        How long it learns.
    """

    name: str
    config: INetConfig
    values: bool = False
    blind: bool = False
    training: TrainConfig = TRAINING

    def estimate(self, net: INet, samples: Samples) -> Tensor:
        """Integrals (B, C) from sorted samples."""
        if self.blind:
            samples = blinded(samples)
        tokens = tokenize(samples, self.config.tokens, RECIPE.extra).flatten(1, 2)  # (B, N T, width)
        raw = net(tokens).view(*samples.value.shape[:3], -1)
        if not self.values:
            return correct(raw, UniformWeights().combine(samples), samples, self.config).estimate(samples)
        centred, unit = standard(samples.value, self.config.tokens)
        centre = row_mean((samples.value - centred).mean(dim=2))
        return centre + unit[:, 0, 0] * row_mean(raw[..., -1:].double().mean(dim=2))


VARIANTS = (
    Variant("weights", _ROW),
    Variant("weights from x and f alone", _ROW, blind=True),
    Variant("values", _ROW, values=True),
    Variant("weights, plain", _PLAIN, training=SHORTER),
    Variant("values, plain", _PLAIN, values=True, training=SHORTER),
)


def learn(variant: Variant, config: TrainConfig, run: RunFolder) -> INet:
    """Train a variant, or load what an earlier call left in the folder."""
    net, average = _fresh(variant.config, config.seed), _fresh(variant.config, config.seed)
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
            loss = (variant.estimate(net, samples) - batch.answer).square().mean()
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


def _fresh(config: INetConfig, seed: int) -> INet:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return INet(config)


def _validation(config: TrainConfig) -> Iterator[tuple[Samples, Tensor]]:
    for rows in torch.arange(config.validation).split(1024):
        batch, samples = draw_batch(RECIPE, rows, N, config.seed, "validation")
        yield samples, batch.answer


@torch.no_grad()
def validate(variant: Variant, net: INet, config: TrainConfig) -> tuple[float, float]:
    """Mean squared error of the variant and of Monte Carlo on validation integrals."""
    errors = [
        torch.stack([variant.estimate(net, samples) - answer, row_mean(samples.value[:, :, 0]) - answer])
        for samples, answer in _validation(config)
    ]
    mine, plain = torch.cat(errors, dim=1).square().mean(dim=(1, 2)).tolist()
    return mine, plain


@torch.no_grad()
def errors_on(problem: Problem, nets: dict[str, INet]) -> dict[str, np.ndarray]:
    """Squared errors (B, 1) of Monte Carlo, the trapezoid and every variant on the same random samples."""
    samples = draw_samples(problem, ("random",), N, Stream(SEED, "test", "samples/0"))
    samples = sort_samples(samples)
    truth = torch.from_numpy(problem.reference())
    answers = {name: registry.make("rule", name).combine(samples).estimate(samples) for name in ("mc", "trapezoid")}
    for variant in VARIANTS:
        answers[variant.name] = variant.estimate(nets[variant.name], samples)
    return {name: (answer - truth).square().numpy() for name, answer in answers.items()}


def rows_of(errors: dict[str, np.ndarray], where: str) -> list[dict[str, Any]]:
    """One row a rule, with its ratio to Monte Carlo on the same samples."""
    bootstrap = Bootstrap.of(np.arange(len(errors["mc"])), 1, SEED)
    return [
        {
            "problem": where,
            "rule": name,
            "n": N,
            "mse": float(e.mean()),
            "median": float(np.median(e)),
            "p99": float(np.quantile(e, 0.99)),
            "ratio": float(errors["mc"].mean() / e.mean()),
            "ratio_interval": bootstrap.ratio(errors["mc"], e),
        }
        for name, e in errors.items()
    ]


def draw(history: dict[str, dict[str, list]], rows: list[dict[str, Any]], path: Path) -> None:
    """Fig. 8 twice and Fig. 10: error as a share of Monte Carlo's while the networks learn."""
    panels = {
        "weights against values": ("weights", "values"),
        "the same in the paper's plain form": ("weights, plain", "values, plain"),
        "with f' and I, and from x and f alone": ("weights", "weights from x and f alone"),
    }
    trapezoid = next(row["mse"] / rows[0]["mse"] for row in rows if row["rule"] == "trapezoid")
    picture = figure(12.5, 3.7)
    axes = picture.subplots(1, len(panels), sharey=True)
    for panel, (title, names) in zip(axes, panels.items(), strict=True):
        for name, colour in zip(names, (SEVERAL[0], SEVERAL[1]), strict=True):
            curve = history[name]
            panel.semilogy(curve["iteration"], 1.0 / np.array(curve["ratio"]), color=colour, lw=1.8, label=name)
        panel.axhline(1.0, color=COLOURS["mc"], lw=1.0, ls=":", label="Monte Carlo")
        panel.axhline(trapezoid, color=COLOURS["trapezoid"], lw=1.2, ls="--", label="trapezoid")
        panel.set_title(title, fontsize=10)
        panel.set_xlabel("iterations of 256 integrals")
        panel.grid(True, which="major", alpha=0.25)
        panel.legend(frameon=False, fontsize=8.5)
    axes[0].set_ylabel("validation MSE, Monte Carlo = 1")
    axes[0].set_ylim(0.07, 4.0)
    save(picture, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a hundredth of the iterations; writes nothing")
    parser.add_argument("--keep", type=Path, help="folder for the networks; those that are there are not trained again")
    parser.add_argument("--out", type=Path, help="the picture, by default docs/toy-ablation.png; none with --quick")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    shorter = {"iterations": 25, "every": 5, "validation": 512} if arguments.quick else {}
    with tempfile.TemporaryDirectory() as aside:
        folder = arguments.keep or Path(aside)
        runs = {v.name: RunFolder(folder / v.name.replace(", ", "-").replace(" ", "-")) for v in VARIANTS}
        nets = {v.name: learn(v, replace(v.training, **shorter), runs[v.name]) for v in VARIANTS}
        curves = {name: np.genfromtxt(run.curve, delimiter=",", names=True) for name, run in runs.items()}
    family = ToyProblem.family(1000 if arguments.quick else 20000, SEED, "test")
    rows = rows_of(errors_on(family, nets), "held-out integrands")
    for scene in range(5):
        rows += rows_of(errors_on(scenes(200 if arguments.quick else 4000, scene), nets), f"integrand {scene + 1}")
    table = Table("integrands", "rule", "MSE", "median", "p99", "x MC", "95%", title="short trainings")
    for row in rows:
        low, high = row["ratio_interval"]
        cells = [f"{row[key]:.2e}" for key in ("mse", "median", "p99")]
        table.add_row(row["problem"], row["rule"], *cells, f"{row['ratio']:.3g}", f"{low:.3g} .. {high:.3g}")
    Console(width=120).print(table)
    history = {}
    for name, c in curves.items():
        ratio = c["base_mse"] / c["validation_mse"]
        history[name] = {"iteration": c["iteration"].astype(int).tolist(), "ratio": ratio.tolist()}
    if arguments.out is not None or not arguments.quick:
        draw(history, rows, arguments.out or DOCS / "toy-ablation.png")
    if arguments.quick:
        return
    lengths = {variant.name: variant.training.iterations for variant in VARIANTS}
    print(write("toy_ablation", rows, n=N, seed=SEED, iterations=lengths, batch=TRAINING.batch, curves=history))


if __name__ == "__main__":
    main()
