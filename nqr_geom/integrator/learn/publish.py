"""From a training run to a model: its box, its shares, its card."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from nqr_geom import registry
from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.joint import JointRecipe
from nqr_geom.integrator.learn.recipe import Recipe
from nqr_geom.integrator.learn.run import RunFolder
from nqr_geom.integrator.learn.snet import LearnedSampler
from nqr_geom.integrator.learn.train import draw_batch
from nqr_geom.integrator.learn.zoo import BLEND_SIZES, Card, checked, load, load_sampler, save, trusted, write_card
from nqr_geom.integrator.samplers import Sampler

__all__ = ["fit_shares", "fit_trust", "measure_box", "publish", "refit"]

_BLEND_SAMPLES = 2**18  # validation samples spent on each size
_CANDIDATES = 21
_LEAST_SHARE = 0.02  # below it the network is not worth its time
_LEAST_GAIN = 0.1  # of the consistent rule's error, beyond the trained sizes: nor is it below that


def measure_box(
    recipe: Recipe, integrals: int = 2**15, seed: int = 0, sampler: Sampler | None = None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Range of the checked quantities over training integrals, at all trained sizes."""
    low, high = [], []
    for n, _ in recipe.sizes:
        for rows in torch.arange(integrals).split(2**12):
            seen = checked(draw_batch(recipe, rows, n, seed, "train", sampler)[1], recipe.extra)
            low.append(seen.amin(dim=(0, 1)))
            high.append(seen.amax(dim=(0, 1)))
    ends = torch.stack(low).amin(dim=0), torch.stack(high).amax(dim=0)
    return tuple(ends[0].tolist()), tuple(ends[1].tolist())


def faded(share: float, before: float) -> float:
    """A share beyond the trained sizes: not above the one before, and 0 where it is negligible.

    Examples
    --------
    >>> faded(0.9, 0.5), faded(0.3, 0.5), faded(0.01, 0.5)
    (0.5, 0.3, 0.0)
    """
    return min(share, before) if share >= _LEAST_SHARE else 0.0


@torch.no_grad()
def fit_shares(
    recipe: Recipe,
    net: INet,
    sizes: Sequence[int] = BLEND_SIZES,
    seed: int = 0,
    sampler: Sampler | None = None,
    trust: float = 0.0,
) -> tuple[float, ...]:
    """Share of the network at each N that minimises the squared error on validation integrals.

    Behind a link the error is no parabola in the share, so the best of `_CANDIDATES` is taken. Beyond the trained sizes
    shares only fall, and from the first one on that is negligible, or takes little off the consistent rule's error,
    they are 0. Shares count beside `trust`, see `Card`.
    """
    learned = LearnedRule(net, recipe.base_rule(), recipe.extra)
    safe = registry.make("rule", recipe.consistent)
    trained = max(n for n, _ in recipe.sizes)
    shares: list[float] = []
    for n in sizes:
        if n > recipe.largest or (n > trained and shares and shares[-1] == 0.0):
            shares.append(0.0)
            continue
        gain, total, plain = 0.0, 0.0, 0.0
        tried = torch.zeros(_CANDIDATES)
        least = max(64, _BLEND_SAMPLES // trained if n > trained else 0)  # few integrals would decide the mean
        for rows in torch.arange(max(least, _BLEND_SAMPLES // n)).split(max(1, 2**15 // n)):
            batch, samples = draw_batch(recipe, rows, n, seed, "validation", sampler)
            samples, link = batch.problem.finalize(samples)
            combined = [rule.combine(samples) for rule in (learned, safe)]
            link = combined[0].link or link
            mine, theirs = (part.estimate(samples) for part in combined)
            if trust and combined[1].doubt is not None:
                mine = theirs + torch.as_tensor(trusted(combined[1].doubt, trust)).reshape(-1, 1) * (mine - theirs)
            if link.name == "identity":
                gain += float(((theirs - batch.answer) * (theirs - mine)).sum())
                total += float((theirs - mine).square().sum())
                plain += float((theirs - batch.answer).square().sum())
                continue
            blends = [torch.lerp(theirs, mine, share) for share in torch.linspace(0.0, 1.0, _CANDIDATES).tolist()]
            tried += torch.stack([(link(blend) - batch.answer).square().sum() for blend in blends])
        share, before, left = float(tried.argmin()) / (_CANDIDATES - 1), float(tried[0]), float(tried.min())
        if total > 0.0:  # no link: a parabola
            share = min(1.0, max(0.0, gain / total))
            before, left = plain, plain - share * (2.0 * gain - share * total)
        if n > trained:
            worth = left < (1.0 - _LEAST_GAIN) * before
            share = faded(share if worth else 0.0, shares[-1] if shares else 1.0)
        shares.append(share)
    return tuple(shares)


@torch.no_grad()
def fit_trust(recipe: Recipe, net: INet, seed: int = 0, sampler: Sampler | None = None) -> float:
    """Which of the recipe's `trusts` leaves the least squared error on validation integrals, each at its best share.

    Measured at the size that the network is mostly trained for. A consistent rule that tells no doubt, and an integral
    behind a link, have none to choose: 0.
    """
    if len(recipe.trusts) == 1:
        return recipe.trusts[0]
    n = max(recipe.sizes, key=lambda pair: pair[1])[0]
    learned, safe = LearnedRule(net, recipe.base_rule(), recipe.extra), registry.make("rule", recipe.consistent)
    sums = torch.zeros(3, len(recipe.trusts), dtype=torch.float64)  # of squares, of products and of squared steps
    for rows in torch.arange(max(64, _BLEND_SAMPLES // n)).split(max(1, 2**15 // n)):
        batch, samples = draw_batch(recipe, rows, n, seed, "validation", sampler)
        samples, link = batch.problem.finalize(samples)
        combined = [rule.combine(samples) for rule in (learned, safe)]
        if link.name != "identity" or combined[1].doubt is None:
            return 0.0
        mine, theirs = (part.estimate(samples) for part in combined)
        off = theirs - batch.answer
        for k, trust in enumerate(recipe.trusts):
            step = torch.as_tensor(trusted(combined[1].doubt, trust)).reshape(-1, 1) * (mine - theirs)
            sums[:, k] += torch.stack([off.square().sum(), (off * step).sum(), step.square().sum()])
    square, product, size = sums
    share = (-product / size).clamp(0.0, 1.0)
    return recipe.trusts[int((square + 2.0 * share * product + share.square() * size).argmin())]


def refit(recipe: Recipe | JointRecipe, folder: str | Path, seed: int = 0) -> Card:
    """Choose trust and shares of a model that ships again, as its consistent rule has changed; its weights stay.

    Parameters
    ----------
    recipe : Recipe or JointRecipe
        Of the model.
    folder : path
        Where its weights and its card lie.
    seed : int
        Of the validation integrals.
    """
    rule = recipe.rule if isinstance(recipe, JointRecipe) else recipe
    model = load(folder, rule)
    sampler = load_sampler(folder, rule.name, recipe.snet()) if isinstance(recipe, JointRecipe) else None
    net = model.learned.net
    trust = fit_trust(rule, net, seed, sampler)
    shares = fit_shares(rule, net, model.card.sizes, seed, sampler, trust)
    card = replace(model.card, trust=trust, shares=shares)
    write_card(folder, card)
    return card


def _name(function: Callable[..., Any]) -> str:
    """Where a function is defined."""
    return f"{function.__module__}.{function.__qualname__}"


def publish(recipe: Recipe | JointRecipe, run: str | Path, folder: str | Path, command: str = "") -> Card:
    """Make a model of a run's averaged weights; of joint training it holds both networks.

    Parameters
    ----------
    recipe : Recipe or JointRecipe
        What was trained.
    run : path
        Folder of the run.
    folder : path
        Where the weights and the card go.
    command : str
        What trained them, for the card.

    Returns
    -------
    Card
        Without a table of errors: that is measured on the model as it ships.

    Raises
    ------
    ValueError
        If the folder holds no run of this recipe.
    """
    path = RunFolder(Path(run)).checkpoint
    if not path.exists():
        raise ValueError(f"run: expected a folder with a checkpoint, got {str(run)!r}")
    state = torch.load(path, weights_only=True)
    identity, trained = json.loads(state["identity"]), json.loads(state["train"])
    if identity["recipe"] != recipe.name:
        raise ValueError(f"run: expected a run of {recipe.name!r}, got one of {identity['recipe']!r}")
    rule = recipe.rule if isinstance(recipe, JointRecipe) else recipe
    snet, sampler = None, None
    if isinstance(recipe, JointRecipe):
        snet = recipe.snet()
        snet.load_state_dict(state["sampler"]["average"])
        sampler = LearnedSampler(snet.eval(), rule.problem)
    net = INet(rule.config)
    net.load_state_dict(state["average"])
    low, high = measure_box(rule, seed=trained["seed"], sampler=sampler, integrals=2**15 if snet is None else 2**12)
    trust = fit_trust(rule, net, trained["seed"], sampler)
    card = Card(
        name=rule.name,
        problem=rule.problem,
        base=rule.base,
        consistent=rule.consistent,
        config=rule.config,
        iterations=state["iteration"],
        batch=trained["batch"],
        seed=trained["seed"],
        hours=round(state["seconds"] / 3600.0, 3),
        family={
            "integrals": _name(rule.family),
            **({} if rule.extra is None else {"tokens": _name(rule.extra.compute)}),
            "samples": {str(n): share for n, share in rule.sizes},
            "designs": list(rule.designs) if snet is None else ["the sampling network"],
            "splits": {"weights": "train", "box": "train", "shares": "validation", "table": "test"},
        },
        low=low,
        high=high,
        shares=fit_shares(rule, net, seed=trained["seed"], sampler=sampler, trust=trust),
        command=command,
        sampler=None if snet is None else snet.config,
        group=trained.get("group", 0),
        trust=trust,
    )
    return save(folder, net, card, snet)
