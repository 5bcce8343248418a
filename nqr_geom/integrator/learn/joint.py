"""Joint training of the sampling and the integration network (Listing 1).

Every iteration the sampler places G sequences for each integral. The integrator learns from all of them by mean
squared error; the sampler by how much better than its group each sequence did (group-relative policy optimisation).
Neither the integrand nor the choice of a sample is differentiated.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nqr_geom import check, registry
from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.learner import Learner, learning_rate
from nqr_geom.integrator.learn.recipe import Batch, Recipe
from nqr_geom.integrator.learn.run import RunFolder
from nqr_geom.integrator.learn.snet import LearnedSampler, Rollout, SNet, SNetConfig, View
from nqr_geom.integrator.learn.tokens import Extra, sort_samples
from nqr_geom.integrator.learn.train import (
    TrainConfig,
    alike,
    draw_batch,
    expected_error,
    follow,
    identity,
    launch,
    piecewise,
    residuals,
    robust,
    widen,
)
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Rule
from nqr_geom.streams import Stream

__all__ = ["JointConfig", "JointRecipe", "advantages", "train_jointly"]

_EPS = 1e-20  # of an advantage: far below any squared error worth learning from


@dataclass(frozen=True)
class JointRecipe:
    """How a pair of networks is made.

    Parameters
    ----------
    rule : Recipe
        The integrator; its name is the pair's.
    begin : str
        Recipe whose trained network the integrator begins with.
    sampler : SNetConfig
        The sampling network.
    view : type of Gaps, of Walks or of Slabs, optional
        What its head chooses among or sees.
    heads : bool
        Whether it begins with that network's heads, too: the two recipes then differ in name and sizes only. Without
        them the integrator begins as its own base rule.
    reads : Extra, optional
        The application's own quantities that the sampler reads, if they are others than the integrator's.
    credit : callable, optional
        (samples of B G rows, G) to how much denser each should have been, (B G, N, groups), where the application can
        tell: what the sampler learns from in place of how well whole sequences did.
    """

    rule: Recipe
    begin: str
    sampler: SNetConfig
    view: View | None = None
    heads: bool = True
    reads: Extra | None = None
    credit: Callable[[Samples, int], Tensor] | None = None

    @property
    def name(self) -> str:
        """Name of the pair."""
        return self.rule.name

    def snet(self) -> SNet:
        """A fresh sampling network: its base sampler."""
        extra = (self.reads or self.rule.extra) if self.sampler.tokens.extra else None
        return SNet(self.sampler, self.view, extra)


@dataclass(frozen=True)
class JointConfig(TrainConfig):
    """How long and how fast; what is not said here is as in `TrainConfig`.

    Parameters
    ----------
    batch, group : int
        Integrals an iteration (over all devices) and sequences for each.
    rate, sampler_rate : float
        Highest learning rates of the integrator and of the sampler; with 0 the sampler stays as it is.
    """

    batch: int = 32
    group: int = 8
    rate: float = 5e-4
    sampler_rate: float = 5e-4
    warmup: int = 200
    average: float = 0.998
    every: int = 250
    validation: int = 1024

    def __post_init__(self) -> None:
        super().__post_init__()
        check.integer("group", self.group, low=2)
        check.number("sampler_rate", self.sampler_rate, low=0.0)


def advantages(error: Tensor) -> Tensor:
    """How much better than its group each sequence did, in standard deviations, for squared errors (B, G).

    Examples
    --------
    >>> advantages(torch.tensor([[1.0, 3.0], [2.0, 2.0]]))
    tensor([[ 1., -1.],
            [-0., -0.]])
    """
    off = error - error[:, :1]  # equal errors of any size are equal to the last bit
    off = off - off.mean(dim=1, keepdim=True)
    return -off / (off.std(dim=1, correction=0, keepdim=True) + _EPS)


def roll_out(recipe: JointRecipe, net: SNet, rows: Tensor, n: int, config: JointConfig) -> tuple[Batch, Rollout]:
    """Integrals of the global `rows` (B,), each `group` times, and as many sequences of n samples."""
    batch = recipe.rule.family(rows, config.seed, "train")
    index = torch.arange(len(rows), device=rows.device).repeat_interleave(config.group)
    member = torch.arange(config.group, device=rows.device).repeat(len(rows))
    keys = rows[index] * config.group + member
    repeated = batch.take(index)
    with torch.no_grad():
        # Independent numbers: the likelihood of evenly spread ones is not the product of their densities.
        return repeated, net.sample(repeated.problem, n, Stream(config.seed, "train", "rollouts"), keys, even=False)


@torch.no_grad()
def validate(recipe: JointRecipe, snet: SNet, rule: Rule, config: JointConfig) -> float:
    """Mean squared error of a sampling network and a rule on the validation split."""
    sampler = LearnedSampler(snet)
    errors = []
    for rows in torch.arange(config.validation).split(1024):
        batch, samples = draw_batch(recipe.rule, rows, recipe.rule.sizes[0][0], config.seed, "validation", sampler)
        samples, link = batch.problem.finalize(samples)
        errors.append((link(rule.combine(samples).estimate(samples)) - batch.answer).square().mean(dim=1))
    return torch.cat(errors).mean().item()


def train_jointly(
    recipe: JointRecipe,
    out: str | Path,
    config: JointConfig,
    *,
    start_from: str | Path | None = None,
    devices: int = 1,
    num_nodes: int = 1,
    accelerator: str = "cpu",
    precision: str | None = None,
    progress: bool = True,
) -> tuple[INet, SNet]:
    """Train a pair, or go on with a run that was begun in the same folder.

    Parameters
    ----------
    recipe : JointRecipe
        What to train.
    out : path
        Folder of the run, as for `train`.
    config : JointConfig
        How long and how fast. A continuation may change the length and the rates, not batch, group, seed or optimiser.
    start_from : path, optional
        Run of the recipe `recipe.begin`: a new run begins with its averaged network. Or one of this pair, perhaps with
        another batch, group or optimiser: a new run begins with both its averaged networks.
    devices, num_nodes, accelerator, precision
        As for `lightning_fabric.Fabric`; by default in bfloat16 where `train` would use it for the integrator.
    progress : bool
        Show a progress bar.

    Returns
    -------
    INet, SNet
        With the averaged weights.

    Raises
    ------
    ValueError
        If the folder holds a run of another recipe, batch, group or seed, or `start_from` none of `recipe.begin` or of
        the pair.
    """
    fabric = launch(recipe.rule.config, devices, num_nodes, accelerator, precision)
    run = RunFolder(Path(out))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        inet, snet = INet(recipe.rule.config), recipe.snet()
    base = validate(recipe, recipe.snet(), registry.make("rule", recipe.rule.consistent), config)
    if start_from is not None:
        _adopt(inet, snet, RunFolder(Path(start_from)), recipe)
    common: dict[str, Any] = {"weight_decay": config.weight_decay, "keep": config.average, "clip": config.clip}
    common["optimizer"] = config.optimizer
    integrator = Learner(fabric, inet, INet(recipe.rule.config), config.rate, **common)
    sampler = Learner(fabric, snet, recipe.snet(), config.sampler_rate, **common)
    sizes = Stream(config.seed, "train", "sizes")

    def lesson(iteration: int, rows: Tensor) -> Tensor:
        batch, rollout = roll_out(recipe, snet, rows, recipe.rule.size(sizes, iteration), config)
        samples = sort_samples(rollout.samples)
        with torch.set_grad_enabled(recipe.rule.missed is None):  # else the parts teach, and these only judge
            before, behind = residuals(recipe.rule, integrator.model, batch, samples)
        expected = expected_error(recipe.rule, samples)
        if recipe.rule.missed is None:
            value = robust(recipe.rule, before, behind, expected, batch.weight)
        else:
            value = piecewise(recipe.rule, integrator.model, batch, samples)
        rate = learning_rate(config, iteration)
        integrator.step(alike(recipe.rule, value, fabric), rate, iteration)
        if config.sampler_rate == 0.0:
            return value
        outcome = (before if behind is None else behind).detach().square().mean(dim=1)
        if expected is not None:  # what is expected of the samples says the same with less noise, if it is right
            outcome = 0.5 * (outcome + expected[:, 0])
        likelihood = sampler.model(rollout)
        if recipe.credit is None:
            gain = advantages(outcome.view(len(rows), config.group)).flatten() * likelihood.sum(dim=-1).mean(dim=1)
        else:
            gain = (recipe.credit(rollout.samples, config.group).float() * likelihood).sum(dim=-1).mean(dim=1)
        sampler.step(-gain.mean(), rate * config.sampler_rate / config.rate, iteration)
        return value

    def measure() -> tuple[float, float]:
        rule = LearnedRule(integrator.average, recipe.rule.base_rule(), recipe.rule.extra)
        return validate(recipe, sampler.average, rule, config), base

    follow(fabric, run, config, _identity(recipe, config), integrator, {"sampler": sampler}, lesson, measure, progress)
    return integrator.average, sampler.average


def _adopt(inet: INet, snet: SNet, run: RunFolder, recipe: JointRecipe) -> None:
    """Take over averaged weights: those of the pair, or the integrator's alone, with or without its heads.

    A gate that it lacks begins shut.
    """
    if not run.checkpoint.exists():
        raise ValueError(f"start_from: expected a folder with a checkpoint, got {str(run.checkpoint.parent)!r}")
    state = torch.load(run.checkpoint, weights_only=True)
    identity = json.loads(state["identity"])
    found = identity["recipe"]
    weights = state["average"]
    if found == recipe.name:
        snet.load_state_dict(state["sampler"]["average"])
    elif found != recipe.begin:
        raise ValueError(f"start_from: expected a run of {recipe.begin!r} or {recipe.name!r}, found one of {found!r}")
    elif not recipe.heads:
        weights |= {key: tensor for key, tensor in inet.state_dict().items() if key.startswith("head.")}
    elif inet.config.gated and not identity["config"].get("gated"):
        for key in ("head.weight", "head.bias"):
            weights[key] = torch.cat([weights[key], torch.zeros_like(weights[key][:1])])
    widen(weights, inet)
    inet.load_state_dict(weights)


def _identity(recipe: JointRecipe, config: JointConfig) -> dict[str, Any]:
    """What must not change when a run is continued."""
    return {**identity(recipe.rule, config), "group": config.group, "sampler": recipe.sampler}
