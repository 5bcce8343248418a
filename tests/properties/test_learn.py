"""What every shipped model promises: its card is true, it knows its limits, and its blend beats both of its parts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.learn.recipe import Batch, draw_samples
from nqr_geom.integrator.learn.zoo import Model
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Rule
from nqr_geom.recipes import JOINT, RECIPES, folder, rule_of
from nqr_geom.streams import Stream

MODELS = [entry.name for entry in registry.entries("model")]
MOST = 1536  # integrals for a network that places samples: it takes a thousand times longer than a fixed design
MORE = {"toy": 8192}  # and where it takes least, as much more can be told


def drawn(name: str, n: int, rows: int, designs: tuple[str, ...] | None = None) -> tuple[Batch, Samples]:
    """Held-out integrals and samples."""
    recipe = rule_of(name)
    most = MORE.get(recipe.problem, MOST) if name in JOINT else rows
    batch = recipe.family(torch.arange(min(rows, most)), 1, "test")
    if name in JOINT:
        return batch, registry.make("sampler", f"snet-{name}").draw(batch.problem, n, Stream(1))
    return batch, draw_samples(batch.problem, designs or recipe.designs, n, Stream(1))


def usual(name: str) -> int:
    """Samples that a model was mostly trained with, and for which the table of its card is."""
    return max(rule_of(name).sizes, key=lambda pair: pair[1])[0]


def designs_of(name: str) -> list[str]:
    """The designs that a model was trained on."""
    return [f"snet-{name}"] if name in JOINT else sorted(set(RECIPES[name].designs))


def squared_errors(rule: Rule, batch: Batch, samples: Samples) -> Tensor:
    samples, link = batch.problem.finalize(samples)
    return (link(rule.combine(samples).estimate(samples)) - batch.answer).square().mean(dim=1)


def test_there_are_models() -> None:
    assert set(MODELS) <= set(RECIPES) | set(JOINT)
    runs = Path(__file__).parents[2] / "training"
    for name in set(RECIPES) - set(MODELS):  # what does not ship left its run, which says why
        assert (runs / name / "checkpoint.pt").exists(), name
        assert (runs / name / "loss.csv").exists(), name
    assert {f"inet-{name}" for name in MODELS} <= {entry.name for entry in registry.entries("rule")}


@pytest.mark.parametrize("name", MODELS)
def test_models_are_small_and_their_cards_complete(name: str) -> None:
    recipe = rule_of(name)
    path = folder(recipe.problem) / f"{name}.safetensors"
    assert path.stat().st_size < 2_000_000
    card = json.loads(path.with_suffix(".json").read_text())
    assert card["iterations"] * card["batch"] * card.get("group", 1) > 100_000
    assert card["hours"] > 0.0
    assert card["family"]["splits"] == {"weights": "train", "box": "train", "shares": "validation", "table": "test"}
    assert card["command"]
    assert len(card["shares"]) == len(card["sizes"])
    assert set(designs_of(name)) <= set(card["table"])


@pytest.mark.parametrize("name", MODELS)
def test_the_family_itself_is_inside_the_card(name: str) -> None:
    model: Model = registry.make("model", name)
    for design in designs_of(name):
        _, samples = drawn(name, 32, 2000, (design,))
        assert model.inside(samples).double().mean() > 0.99


@pytest.mark.parametrize("name", MODELS)
def test_the_table_of_the_card_is_what_comes_out(name: str) -> None:
    """On other integrals of the test split: within what a few thousand of them can tell."""
    model: Model = registry.make("model", name)
    for design in designs_of(name):
        batch, samples = drawn(name, usual(name), 6000, (design,))
        errors = squared_errors(model, batch, samples).numpy()
        noise = errors.std() / np.sqrt(len(errors))
        assert abs(errors.mean() - model.card.table[design]["mse"]) < 5.0 * noise + 0.15 * errors.mean()


@pytest.mark.parametrize("n", [8, 32, 64, 128, 512, 4096])
@pytest.mark.parametrize("name", MODELS)
def test_the_blend_is_no_worse_than_either_part(name: str, n: int) -> None:
    model: Model = registry.make("model", name)
    batch, samples = drawn(name, n, max(2, (2**16 if n <= 128 else 2**13) // n))
    inside = model.inside(samples)
    blend = squared_errors(model, batch, samples)[inside]
    for part in (model.learned, model.consistent):
        worse = blend - squared_errors(part, batch, samples)[inside]
        # Two sides of one test: the mean difference is not above zero beyond three standard errors.
        assert worse.mean() <= 3.0 * worse.std() / np.sqrt(len(worse)) + 1e-12


@pytest.mark.parametrize("name", MODELS)
def test_models_improve_on_their_base(name: str) -> None:
    model: Model = registry.make("model", name)
    batch, samples = drawn(name, usual(name), 6000)
    # Squared errors of Monte Carlo near a curve have no finite variance; cut at 1 they have, and it favours the base.
    mine, base = (squared_errors(rule, batch, samples).clamp_max(1.0) for rule in (model.learned, model.learned.base))
    gain = base - mine
    if name in JOINT and model.card.base == "uniform":  # which means nothing for points that were not placed uniformly
        gain = squared_errors(model.consistent, batch, samples).clamp_max(1.0) - mine
    assert gain.mean() > 3.0 * gain.std() / np.sqrt(len(gain))


@pytest.mark.parametrize("name", MODELS)
def test_answers_do_not_depend_on_the_batch(name: str) -> None:
    rule = registry.make("rule", f"inet-{name}")
    problem = rule_of(name).family(torch.arange(700), 1, "test").problem
    sampler = registry.make("sampler", f"snet-{name}" if name in JOINT else "random")
    whole = run(problem, sampler, rule, 32)
    index = torch.arange(3, 700, 31)
    part = run(problem.take(index), sampler, rule, 32)
    assert np.array_equal(part.value, whole.value[index.numpy()])
    assert whole.plan["rule"] == f"inet-{name}"
    assert whole.fallback.mean() < 0.2


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("factor", [1e-60, 1e60])
def test_any_finite_input_gives_a_finite_answer(name: str, factor: float) -> None:
    model: Model = registry.make("model", name)
    _, samples = drawn(name, 32, 20)
    features = {
        key: tensor if tensor.dtype == torch.int64 else tensor * factor for key, tensor in samples.seen.features.items()
    }
    wild = replace(samples, seen=replace(samples.seen, value=samples.value * factor, features=features))
    assert model.combine(wild).estimate(wild).isfinite().all()
