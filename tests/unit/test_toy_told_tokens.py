"""The network on plain weights that is told the weights of the structured rule: what it reads and learns from."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor
from torch.nn.functional import pad

from nqr_geom.integrator.learn.inet import INet, LearnedRule, doubt
from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.learn.train import draw_batch, loss
from nqr_geom.integrator.problem import Samples
from nqr_geom.recipes import RECIPES
from nqr_geom.toy.structured import ToyHermite
from nqr_geom.toy.told_tokens import TOLD_TOKENS, missed_by_weights, weights_of

RECIPE = RECIPES["toy-told"]


def drawn(rows: int = 64, n: int = 32, design: str = "random") -> tuple[Batch, Samples]:
    return draw_batch(replace(RECIPE, designs=(design,)), torch.arange(rows), n, 3, "validation")


def edges_of(samples: Samples) -> Tensor:
    return pad(pad(samples.x[..., 0], (1, 0)), (0, 1), value=1.0)


def told_weights(samples: Samples) -> Tensor:
    gaps = ToyHermite().gaps(samples)
    return weights_of(samples, gaps.edges, gaps.integral)


def moved_by(samples: Samples, level: float | Tensor) -> Samples:
    return replace(samples, seen=replace(samples.seen, value=samples.value + level))


@pytest.mark.parametrize("n", [1, 2, 3, 32, 200])
@pytest.mark.parametrize("design", ["random", "stratified", "toy-split"])
def test_weights_answer_as_the_rule_does(n: int, design: str) -> None:
    samples = drawn(64, n, design)[1]
    weights = told_weights(samples)
    assert weights.shape == (64, n)
    estimate = (weights * samples.value[..., 0, 0]).mean(dim=1, keepdim=True)
    assert_allclose(estimate, ToyHermite().combine(samples).estimate(samples), rtol=1e-12, atol=1e-14)


def test_a_gap_that_the_trapezoid_integrates_keeps_its_weights() -> None:
    """Linear integrands between samples, constant ones beyond: nothing is to be changed."""
    samples = drawn(16)[1]
    x, value = samples.x[..., 0], samples.value[..., 0, 0]
    edges = edges_of(samples)
    ends = torch.cat([value[:, :1], value, value[:, -1:]], dim=1)
    weights = weights_of(samples, edges, 0.5 * (ends[:, :-1] + ends[:, 1:]) * edges.diff(dim=1))
    reach = 0.5 * torch.cat([x[:, :1] + x[:, 1:2], x[:, 2:] - x[:, :-2], 2.0 - x[:, -2:-1] - x[:, -1:]], dim=1)
    assert_allclose(weights, 32 * reach, atol=1e-12)


def test_no_other_weights_of_the_two_ends_are_nearer_to_the_trapezoids() -> None:
    samples = drawn(16, 2)[1]
    edges = edges_of(samples)
    value = samples.value[..., 0, 0]
    width = edges.diff(dim=1)
    trapezoid = 2.0 * torch.stack([width[:, 0] + 0.5 * width[:, 1], 0.5 * width[:, 1] + width[:, 2]], dim=1)
    level = torch.stack([value[:, 0], value.mean(dim=1), value[:, 1]], dim=1) * width
    change = weights_of(samples, edges, level + torch.tensor([0.0, 0.1, 0.0], dtype=torch.float64)) - trapezoid
    # The least change lies along the values.
    assert_allclose(change[:, 0] * value[:, 1], change[:, 1] * value[:, 0], atol=1e-12)
    assert_allclose((change * value).mean(dim=1), torch.full((16,), 0.1, dtype=torch.float64), rtol=1e-12)


@pytest.mark.parametrize("least", [0.0, 1e-300, 1e-14])
def test_weights_stay_moderate_where_values_vanish(least: float) -> None:
    """Two neighbours that are next to zero cannot carry what is missing between them; others do."""
    samples = drawn(64)[1]
    value = samples.value.clone()
    value[:, 10:12] = least
    dented = replace(samples, seen=replace(samples.seen, value=value))
    edges = edges_of(samples)
    integral = torch.full((64, 33), 0.03, dtype=torch.float64)
    weights = weights_of(dented, edges, integral)
    assert weights.isfinite().all()
    assert weights.abs().max() < 100.0
    assert_allclose((weights * value[..., 0, 0]).mean(dim=1), integral.sum(dim=1), rtol=1e-12)


def test_rows_of_zeros_keep_the_trapezoid() -> None:
    samples = drawn(8)[1]
    nothing = moved_by(samples, -samples.value)
    edges = edges_of(samples)
    weights = weights_of(nothing, edges, torch.ones(8, 33, dtype=torch.float64))
    assert_allclose(weights.mean(dim=1), torch.ones(8, dtype=torch.float64), rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 32, 200])
def test_tokens_are_finite_and_tell_the_weights(n: int) -> None:
    samples = drawn(64, n)[1]
    tokens = TOLD_TOKENS.compute(samples)
    assert tokens.shape == (64, n, 1, TOLD_TOKENS.size)
    assert tokens.dtype == torch.float32
    assert tokens.isfinite().all()
    assert tokens.abs().max() < 80.0
    more = told_weights(samples) - 1.0
    assert_allclose(tokens[:, :, 0, -1].double(), more.asinh(), atol=1e-5)
    assert_allclose(tokens[:, :, 0, -2].double(), more.clamp(-16.0, 16.0), atol=1e-5)


@pytest.mark.parametrize("n", [1, 2, 5, 32])
@pytest.mark.parametrize("design", ["random", "stratified", "toy-split"])
def test_what_is_missed_sums_to_the_error(n: int, design: str) -> None:
    batch, samples = drawn(64, n, design)
    parts = missed_by_weights(batch, samples)
    assert parts.shape == (64, n)
    assert_allclose(parts.sum(dim=1), batch.answer[:, 0] - samples.value[..., 0, 0].mean(dim=1), atol=1e-13)


def test_where_nothing_is_in_doubt_the_right_weight_is_told() -> None:
    batch, samples = drawn(256)
    known = doubt(samples, TOLD_TOKENS) == 0.0
    assert 0.5 < known.double().mean() < 0.95
    told = (told_weights(samples) - 1.0) * samples.value[..., 0, 0] / samples.n
    off = (told - missed_by_weights(batch, samples))[known].abs()
    assert off.quantile(0.9) < 1e-4  # a hundredth of what a gap in doubt misses
    assert off.max() < 0.05  # what is left where values vanish goes to the whole row


def test_doubt_is_told_in_any_order() -> None:
    samples = drawn(64)[1]
    order = torch.rand(64, 32, generator=torch.Generator().manual_seed(0)).argsort(dim=1)
    assert_allclose(doubt(samples.permuted(order), TOLD_TOKENS), doubt(samples, TOLD_TOKENS).gather(1, order))


@pytest.mark.parametrize("level", [-3.0, 3.0, 1e6, -1e30])
def test_other_levels_are_foreign(level: float) -> None:
    """Weights that do not add up to one are right for the level that they were learned at."""
    samples = drawn(2000)[1]
    assert TOLD_TOKENS.foreign is not None
    assert TOLD_TOKENS.foreign(samples).double().mean() < 1e-3
    assert TOLD_TOKENS.foreign(moved_by(samples, level)).double().mean() > 0.9


def test_reading_the_tokens_a_head_can_copy_what_is_told() -> None:
    """One weight of one of the head's inputs makes the network the structured rule."""
    samples = drawn(64)[1]
    net = INet(RECIPE.config)
    net.head.weight.data[0, -2] = 1.0
    got = LearnedRule(net, RECIPE.base_rule(), TOLD_TOKENS).combine(samples)
    assert got.offset is None
    assert_allclose(got.estimate(samples), ToyHermite().combine(samples).estimate(samples), atol=1e-6)


def test_lessons_by_parts_have_the_errors_of_the_answer() -> None:
    """With one part a row and units that are alike, the loss is that of the answer."""
    batch, samples = drawn(256, 1)
    recipe = replace(RECIPE, unit=1e3, huber=1.0)
    net = INet(recipe.config)
    torch.nn.init.normal_(net.head.weight, std=0.1, generator=torch.Generator().manual_seed(1))
    estimate = LearnedRule(net, recipe.base_rule(), TOLD_TOKENS).combine(samples).estimate(samples)
    seen = (doubt(samples, TOLD_TOKENS)[:, 0] > 0.0) | (torch.arange(256) % 8 == 0)
    expected = (estimate - batch.answer)[seen].square().mean() / 1e6
    assert_allclose(loss(recipe, net, batch, samples).item(), expected.item(), rtol=1e-4)
