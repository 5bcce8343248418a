"""The network that shifts what the rule for pieces leaves open: what it reads, what it learns from, what it skips."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.integrate import quad_vec
from torch import Tensor

from nqr_geom import registry
from nqr_geom.integrator.learn import joint
from nqr_geom.integrator.learn.inet import INet, LearnedRule, doubt
from nqr_geom.integrator.learn.joint import JointConfig, train_jointly
from nqr_geom.integrator.learn.recipe import Batch, draw_samples
from nqr_geom.integrator.learn.tokens import sort_samples, tokenize
from nqr_geom.integrator.learn.train import draw_batch, fitting_precision, loss, piecewise
from nqr_geom.integrator.problem import Samples
from nqr_geom.recipes import JOINT, RECIPES
from nqr_geom.streams import Stream
from nqr_geom.toy.law_tokens import LAW_TOKENS, missed
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.structured import ToyHermite

RECIPE = RECIPES["toy-structured"]


def drawn(rows: int = 256, n: int = 32, design: str = "random") -> tuple[Batch, Samples]:
    return draw_batch(replace(RECIPE, designs=(design,)), torch.arange(rows), n, 3, "validation")


def shaken(std: float = 0.1) -> INet:
    """A network whose head is not zero."""
    net = INet(RECIPE.config)
    torch.nn.init.normal_(net.head.weight, std=std, generator=torch.Generator().manual_seed(1))
    return net


def test_the_antiderivative_is_the_integral_from_zero() -> None:
    pieces = ToyProblem(6, 2, "validation").pieces
    ends = torch.tensor([[0.13, 0.5, 0.991]], dtype=torch.float64).expand(6, 3)

    def values(t: float) -> np.ndarray:
        return (pieces.evaluate(t * ends)[0] * ends).numpy()

    assert_allclose(pieces.antiderivative(ends), quad_vec(values, 0.0, 1.0, epsabs=1e-9, limit=4000)[0], atol=1e-7)
    whole = pieces.antiderivative(torch.tensor([[0.0, 1.0]], dtype=torch.float64).expand(6, 2))
    assert_allclose(whole, torch.stack([torch.zeros(6), pieces.integral()], dim=1), atol=1e-14)


@pytest.mark.parametrize("n", [1, 2, 5, 32])
@pytest.mark.parametrize("design", ["random", "stratified", "toy-split"])
def test_what_is_missed_sums_to_the_error(n: int, design: str) -> None:
    batch, samples = drawn(64, n, design)
    parts = missed(batch, samples)
    assert parts.shape == (64, n)
    off = batch.answer - ToyHermite().combine(samples).estimate(samples)
    assert_allclose(parts.sum(dim=1), off[:, 0], atol=1e-13)


def test_where_the_rule_leaves_nothing_open_nothing_is_missed() -> None:
    batch, samples = drawn()
    left, off = doubt(samples, LAW_TOKENS), missed(batch, samples)
    assert 0.05 < (left > 0.0).double().mean() < 0.3
    assert off[left == 0.0].abs().max() < 1e-9
    assert 0.3 < off.square().mean() / (left / samples.n).square().mean() < 3.0


def test_only_integrals_with_a_known_answer_beside_each_sample_teach() -> None:
    batch, samples = drawn(4)
    with pytest.raises(TypeError, match=r"batch: expected integrals of ToyProblem, got OneOf"):
        missed(replace(batch, problem=type("OneOf", (), {})()), samples)
    with pytest.raises(ValueError, match="recipe: expected one that tells what its base rule misses, got 'x'"):
        piecewise(replace(RECIPE, name="x", missed=None), INet(RECIPE.config), batch, samples)
    deep = replace(RECIPE, config=replace(RECIPE.config, layers=2))
    with pytest.raises(ValueError, match="recipe: expected layers that give an offset alone, in units of the row, got"):
        piecewise(deep, INet(deep.config), batch, samples)


@pytest.mark.parametrize("n", [1, 2, 3, 32, 200])
def test_tokens_are_finite_and_moderate(n: int) -> None:
    tokens = LAW_TOKENS.compute(drawn(64, n)[1])
    assert tokens.shape == (64, n, 1, LAW_TOKENS.size)
    assert tokens.dtype == torch.float32
    assert tokens.isfinite().all()
    assert tokens.abs().max() < 80.0


def test_tokens_do_not_see_an_added_constant() -> None:
    samples = drawn(64)[1]
    moved = replace(samples, seen=replace(samples.seen, value=samples.value + 7.0))
    tokens, others = (tokenize(one, RECIPE.config.tokens, LAW_TOKENS) for one in (samples, moved))
    assert_allclose(tokens, others, atol=2e-4)


def test_the_range_is_told_in_any_order() -> None:
    samples = drawn(64)[1]
    order = torch.rand(64, 32, generator=torch.Generator().manual_seed(0)).argsort(dim=1)
    assert LAW_TOKENS.check is not None
    whole = LAW_TOKENS.compute(samples)[..., list(LAW_TOKENS.checked)]
    assert_allclose(LAW_TOKENS.check(samples), whole, rtol=1e-6)
    mixed = LAW_TOKENS.check(samples.permuted(order))
    assert_allclose(mixed, whole.gather(1, order[..., None, None].expand_as(whole)), rtol=1e-5)


def test_skipped_tokens_change_nothing() -> None:
    """All tokens through the network, those beside which nothing is left open too, give the same answer."""
    samples = drawn(64)[1]
    net, base = shaken(), RECIPE.base_rule()
    got = LearnedRule(net, base, LAW_TOKENS).combine(samples).estimate(samples)
    with torch.no_grad():
        raw = net(tokenize(samples, RECIPE.config.tokens, LAW_TOKENS).flatten(1, 2))[..., 0].double()
    shift = (raw * doubt(samples, LAW_TOKENS)).mean(dim=1, keepdim=True)
    assert_allclose(got, base.combine(samples).estimate(samples) + shift, atol=1e-7)
    assert shift.abs().max() > 1e-3


def test_weights_are_the_base_rules_own() -> None:
    samples = drawn(64)[1]
    base = RECIPE.base_rule()
    assert torch.equal(LearnedRule(shaken(), base, LAW_TOKENS).combine(samples).weights, base.combine(samples).weights)


def test_lessons_by_parts_have_the_errors_of_the_answer() -> None:
    """With one open part a row, the loss is that of the whole answer in units of its doubt."""
    batch, samples = drawn(256)

    def alone(part: Samples) -> Tensor:
        """The doubt of a row's largest part only."""
        whole = doubt(part, LAW_TOKENS)
        return torch.where(whole == whole.amax(dim=1, keepdim=True), whole, 0.0)

    extra = replace(LAW_TOKENS, doubt=alone)
    recipe = replace(RECIPE, extra=extra, huber=1e3)
    net = shaken()
    estimate = LearnedRule(net, recipe.base_rule(), extra).combine(samples).estimate(samples)
    others = torch.where(alone(samples) > 0.0, 0.0, missed(batch, samples)).sum(dim=1, keepdim=True)
    unit = alone(samples).amax(dim=1, keepdim=True) / samples.n
    expected = ((estimate + others - batch.answer) / unit).square().mean()
    assert_allclose(loss(recipe, net, batch, samples).item(), expected.item(), rtol=1e-5)


def test_rows_that_leave_little_open_teach_as_much() -> None:
    """Of two designs, the one whose errors are ten thousand times smaller is not lost in the sum."""
    recipe, net = replace(RECIPE, designs=("random", "toy-split")), shaken()
    batch, samples = draw_batch(recipe, torch.arange(512), 32, 3, "validation")
    both = loss(recipe, net, batch, samples)
    halves = torch.arange(512).view(-1, 2).unbind(dim=1)
    apart = [loss(recipe, net, batch.take(half), samples.take(half)) for half in halves]
    assert_allclose(both.item(), 0.5 * (apart[0] + apart[1]).item(), rtol=0.1)


def test_a_design_without_a_density_takes_it_from_the_others() -> None:
    problem = ToyProblem(8)
    assert draw_samples(problem, ("random", "stratified"), 8, Stream(0)).pdf is not None
    mixed = draw_samples(problem, ("random", "toy-split"), 8, Stream(0))
    assert mixed.pdf is None
    alone = registry.make("sampler", "toy-split").draw(problem.take(torch.tensor([1, 3, 5, 7])), 8, Stream(0))
    assert_allclose(sort_samples(mixed.take(torch.tensor([1, 3, 5, 7]))).x, sort_samples(alone).x)


def test_pairs_learn_by_parts_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lessons: list[float] = []

    def noted(*arguments: Any) -> Tensor:
        value = piecewise(*arguments)
        lessons.append(value.item())
        return value

    monkeypatch.setattr(joint, "piecewise", noted)
    config = JointConfig(iterations=3, batch=4, group=2, every=3, validation=8, warmup=1)
    net, _ = train_jointly(JOINT["toy-nqr"], tmp_path, config, progress=False)
    assert len(lessons) == 3
    assert net.head.weight.abs().max() > 0.0
    told = float((tmp_path / "loss.csv").read_text().splitlines()[-1].split(",")[3])
    assert told == pytest.approx(np.mean(lessons), rel=1e-4)


def test_only_attention_gains_from_bfloat16() -> None:
    assert fitting_precision(RECIPE.config, "gpu") == "32-true"
    assert fitting_precision(RECIPES["toy-uniform"].config, "gpu") == "bf16-mixed"
