"""What the offset and the two losses are worth for transmittance: Fig. 27 of the paper.

    python benchmarks/transmittance_ablation.py [--quick]

Short trainings from the same weights on the same batches, 12 queries a ray, with the uniform base and one thing changed
each; one more row is the whole network asked without its offset. Errors and squared biases (the mean of 32 runs less
the truth, without what is left of noise) are of held-out clouds.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from figures import DOCS, SEVERAL, figure, save
from learned_transmittance import answered
from page import span
from rich.console import Console
from rich.table import Table
from sd_ablation import Variant
from shapes import write
from torch import Tensor

import nqr_geom as ng
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.learn.inet import INet, UniformWeights, correct
from nqr_geom.integrator.learn.recipe import inner_answer, training_link
from nqr_geom.integrator.learn.tokens import sort_samples, tokenize
from nqr_geom.integrator.learn.train import TrainConfig, draw_batch, learning_rate
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.samplers import UniformJitter
from nqr_geom.integrator.sums import row_mean
from nqr_geom.recipes import RECIPES
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.streams import Stream

N = 12  # queries, as in the paper's figure
RECIPE = replace(RECIPES["transmittance-uniform"], designs=("uniform-jitter",))
TRAINING = TrainConfig(iterations=500, batch=96, warmup=50, decay=200, average=0.99, every=50, validation=1024)
CLOUDS, RESOLUTION, RUNS = 16, 24, 32
WITHOUT = "all of it, asked without its offset"
VARIANTS = (
    Variant("all of it"),
    Variant("offset outside the link", offset="outside"),
    Variant("no offset", offset=""),
    Variant("no inner loss", inner=0.0, outer=1.0),
    Variant("no outer loss", inner=1.0, outer=0.0),
    Variant("no offset, no outer loss", offset="", inner=1.0, outer=0.0),
)


def corrected(offset: str, net: INet, samples: Samples) -> tuple[Tensor, Tensor, Tensor]:
    """Depths by the network and by plain means, and what is added behind the exponential, (B, 1) each."""
    tokens = tokenize(samples, RECIPE.config.tokens, RECIPE.extra).flatten(1, 2)
    raw = net(tokens).view(*samples.value.shape[:3], -1)
    aside = row_mean(raw[..., -1].double())  # (B, 1)
    if offset != "inside":
        raw = torch.cat([raw[..., :-1], torch.zeros_like(raw[..., -1:])], dim=-1)
    base = UniformWeights().combine(samples)
    inner = correct(raw, base, samples, RECIPE.config).estimate(samples)
    return inner, base.estimate(samples), aside if offset == "outside" else torch.zeros_like(aside)


def transmittance(offset: str, net: INet, samples: Samples) -> Tensor:
    """Estimates (B, 1) as a model gives them: the plain mean where a depth comes out negative."""
    inner, plain, aside = corrected(offset, net, samples)
    return torch.exp(-torch.where(inner > 0.0, inner, plain)) + aside


def learn(config: TrainConfig) -> tuple[dict[str, INet], list[dict[str, Any]]]:
    """All variants side by side, and their validation errors on the way."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        start = INet(RECIPE.config).state_dict()
    nets, averages, optimizers = {}, {}, {}
    for variant in VARIANTS:
        nets[variant.name], averages[variant.name] = INet(RECIPE.config), INet(RECIPE.config)
        for net in (nets[variant.name], averages[variant.name]):
            net.load_state_dict(start)
        weights = nets[variant.name].parameters()
        decay = config.weight_decay
        optimizers[variant.name] = torch.optim.AdamW(weights, lr=config.rate, betas=(0.9, 0.98), weight_decay=decay)
    seen, seen_samples = draw_batch(RECIPE, torch.arange(config.validation), N, config.seed, "validation")
    seen_samples, _ = seen.problem.finalize(seen_samples)
    curve, began = [], time.monotonic()
    for iteration in range(config.iterations):
        rows = torch.arange(iteration * config.batch, (iteration + 1) * config.batch)
        batch, samples = draw_batch(RECIPE, rows, N, config.seed, "train")
        samples, link = batch.problem.finalize(samples)
        truth = inner_answer(batch.answer, link)
        for variant in VARIANTS:
            net, optimizer = nets[variant.name], optimizers[variant.name]
            inner, _, aside = corrected(variant.offset, net, samples)
            before = (inner - truth) / truth.clamp_min(1.0)
            behind = training_link(link, inner) + aside - batch.answer
            value = variant.inner * before.square().mean() + variant.outer * behind.square().mean()
            optimizer.param_groups[0]["lr"] = learning_rate(config, iteration)
            optimizer.zero_grad()
            value.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), config.clip)
            optimizer.step()
            keep = min(config.average, (1 + iteration) / (10 + iteration))
            with torch.no_grad():
                torch._foreach_lerp_(
                    list(averages[variant.name].parameters()), list(net.parameters()), 1.0 - keep
                )  # fmt: skip
        if (iteration + 1) % config.every == 0 or iteration + 1 == config.iterations:
            with torch.no_grad():
                errors = {
                    v.name: float(
                        (transmittance(v.offset, averages[v.name], seen_samples) - seen.answer).square().mean()
                    )
                    for v in VARIANTS
                }
            curve.append({"iteration": iteration + 1, "seconds": time.monotonic() - began, **errors})
    return averages, curve


@torch.no_grad()
def errors_of(problem: TransmittanceProblem, nets: dict[str, INet], runs: int) -> dict[str, np.ndarray]:
    """Estimates less the truth (B, runs) of stratified means and every variant on the same queries."""
    truth = torch.from_numpy(problem.reference())
    asked = {variant.name: (variant.offset, variant.name) for variant in VARIANTS} | {WITHOUT: ("", VARIANTS[0].name)}
    found: dict[str, list[Tensor]] = {"MC, stratified": [], **{name: [] for name in asked}}
    for run in range(runs):
        drawn = UniformJitter().draw(problem, N, Stream(run, "test", "samples/0"))
        samples, link = problem.finalize(sort_samples(drawn))
        found["MC, stratified"].append(link(row_mean(samples.value[:, :, 0])) - truth)
        for name, (offset, net) in asked.items():
            found[name].append(transmittance(offset, nets[net], samples) - truth)
    return {name: torch.cat(parts, dim=1).numpy() for name, parts in found.items()}


def rows_of(errors: dict[str, np.ndarray], groups: np.ndarray, config: TrainConfig) -> list[dict[str, Any]]:
    """One row a variant, with its ratio to stratified means on the same queries."""
    runs = errors["MC, stratified"].shape[1]
    bootstrap = Bootstrap.of(groups, runs, 0)
    plain, rows = errors["MC, stratified"] ** 2, []
    for name, e in errors.items():
        square = e**2
        bias2 = e.mean(axis=1) ** 2 - e.var(axis=1, ddof=1) / runs
        rows.append(
            {
                "variant": name,
                "n": N,
                "iterations": config.iterations,
                "batch": config.batch,
                "mse": float(square.mean()),
                "median": float(np.median(square)),
                "p99": float(np.quantile(square, 0.99)),
                "ratio": float(plain.mean() / square.mean()),
                "ratio_interval": bootstrap.ratio(plain, square),
                "bias2": float(bias2.mean()),
                "bias_noise": float((e.var(axis=1, ddof=1) / runs).mean()),
            }
        )
    return rows


def draw(rows: list[dict[str, Any]], curve: list[dict[str, Any]], path: Path) -> None:
    """Validation error while learning, and what is left of it in the mean."""
    picture = figure(11.0, 4.2)
    left, right = picture.subplots(1, 2)
    colours = dict(zip((v.name for v in VARIANTS), SEVERAL, strict=True)) | {WITHOUT: "0.45", "MC, stratified": "0.15"}
    for variant in VARIANTS:
        at, values = zip(*((point["iteration"], point[variant.name]) for point in curve), strict=True)
        left.plot(at, values, color=colours[variant.name], label=variant.name, lw=1.5)
    left.set(xlabel="iteration", ylabel="mean squared error, validation", yscale="log")
    left.legend(fontsize=8)
    names = [row["variant"] for row in rows]
    right.barh(names, [row["mse"] for row in rows], color=[colours[name] for name in names], alpha=0.55)
    right.plot([max(row["bias2"], row["bias_noise"]) for row in rows], names, "k|", ms=14, label="squared bias")
    right.set(xlabel="mean squared error, held-out clouds", xscale="log")
    right.invert_yaxis()
    right.legend(fontsize=8, loc="lower left")
    for panel in (left, right):
        panel.grid(color="0.92")
    save(picture, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few iterations and clouds; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    config = replace(TRAINING, iterations=10, decay=5, every=5, validation=128) if quick else TRAINING
    clouds, resolution, runs = (2, 12, 2) if quick else (CLOUDS, RESOLUTION, RUNS)
    nets, curve = learn(config)
    problem = answered(ng.datasets.volumes(clouds, seed=0), resolution)["bounds"]
    rows = rows_of(errors_of(problem, nets, runs), problem.groups, config)
    table = Table("variant", "MSE", "x stratified", "95%", "squared bias", title=f"{curve[-1]['seconds']:.0f} s")
    for row in rows:
        table.add_row(
            row["variant"], f"{row['mse']:.3g}", f"{row['ratio']:.3g}", span(row["ratio_interval"]),
            f"{row['bias2']:.2g} (noise {row['bias_noise']:.1g})",
        )  # fmt: skip
    Console(width=120).print(table)
    if not quick:
        draw(rows, curve, DOCS / "transmittance-ablation.png")
        settings = {"n": N, "clouds": clouds, "resolution": resolution, "runs": runs, "curve": curve}
        print(write("transmittance_ablation", rows, **settings))


if __name__ == "__main__":
    main()
