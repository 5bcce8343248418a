"""Tokens and the integration network: base rule at the start, bounded corrections, no memory of order or batch."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.integrator.learn import inet
from nqr_geom.integrator.learn.inet import INet, INetConfig, LearnedRule, correct, has_bfloat16, least_change
from nqr_geom.integrator.learn.recipe import Recipe, draw_samples
from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, compress, sort_samples, standard, tokenize
from nqr_geom.integrator.learn.train import robust
from nqr_geom.integrator.problem import Feature, Observation, Samples
from nqr_geom.integrator.rules import Combination
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream

NAMES = sorted(RECIPES)


def seen(recipe: Recipe, rows: int = 20, n: int = 16) -> Samples:
    """Samples of the first integrals of a recipe's family."""
    problem = recipe.family(torch.arange(rows), 3, "validation").problem
    return problem.finalize(draw_samples(problem, recipe.designs, n, Stream(3, "validation")))[0]


def shaken(config: INetConfig, scale: float = 0.3) -> INet:
    """A network whose heads are not zero."""
    net = INet(config)
    stream = Stream(11, "validation", "heads")
    with torch.no_grad():
        for k, parameter in enumerate(net.head.parameters()):
            index = torch.arange(parameter.numel()) + 10000 * k
            parameter.copy_(scale * (2.0 * stream.uniform(index) - 1.0).view_as(parameter))
    return net


def sample(value: list[float], x: list[float]) -> Samples:
    """One row of plain samples without features."""
    f = torch.tensor(value, dtype=torch.float64)[None, :, None, None]
    at = torch.tensor(x, dtype=torch.float64)[None, :, None]
    return Samples(at, Observation(f), torch.ones_like(at), "test")


@pytest.mark.parametrize("name", NAMES)
def test_untrained_is_its_base_bit_for_bit(name: str) -> None:
    recipe = RECIPES[name]
    samples = seen(recipe)
    base = recipe.base_rule().combine(samples)
    learned = LearnedRule(INet(recipe.config), recipe.base_rule(), recipe.extra).combine(samples)
    assert torch.equal(learned.estimate(samples), base.estimate(samples))
    assert torch.equal(learned.weights.expand_as(samples.value), base.weights.expand_as(samples.value))


@pytest.mark.parametrize("name", NAMES)
def test_order_of_samples_changes_nothing(name: str) -> None:
    recipe = RECIPES[name]
    samples = seen(recipe)
    order = Stream(5, "validation").uniform(torch.arange(20)[:, None], torch.arange(16)).argsort(dim=1)
    mixed = samples.permuted(order)
    rule = LearnedRule(shaken(recipe.config), recipe.base_rule(), recipe.extra)
    a, b = rule.combine(samples), rule.combine(mixed)
    weights = a.weights.expand_as(samples.value)[..., 0, 0]
    # The network sees sorted samples and answers alike bit for bit; only float64 row means round differently.
    np.testing.assert_allclose(
        weights.gather(1, order), b.weights.expand_as(samples.value)[..., 0, 0], rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(a.estimate(samples), b.estimate(mixed), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("half", sorted({False, has_bfloat16()}))  # as models run on this processor, and plainly
@pytest.mark.parametrize("name", NAMES)
def test_rows_do_not_depend_on_their_batch(name: str, half: bool) -> None:
    recipe = RECIPES[name]
    rule = LearnedRule(shaken(recipe.config), recipe.base_rule(), recipe.extra, half)
    problem = recipe.family(torch.arange(600), 3, "validation").problem

    def answers(index: torch.Tensor) -> torch.Tensor:
        part = problem.take(index)
        samples = part.finalize(registry.make("sampler", "random").draw(part, 16, Stream(3, "validation")))[0]
        return rule.combine(samples).estimate(samples)

    whole = answers(torch.arange(600))
    for index in (torch.arange(1), torch.arange(590, 600), torch.arange(0, 600, 7), torch.arange(600).flip(0)):
        assert torch.equal(answers(index), whole[index])


@pytest.mark.parametrize("name", NAMES)
def test_bfloat16_changes_weights_by_its_rounding_only(name: str) -> None:
    recipe = RECIPES[name]
    samples, net = seen(recipe, 50), shaken(recipe.config)
    single, half, double = (
        LearnedRule(n, recipe.base_rule(), recipe.extra, h)._raw(samples)
        for n, h in ((net, False), (net, True), (copy.deepcopy(net).double(), True))
    )
    assert (single.dtype, half.dtype, double.dtype) == (torch.float32, torch.float32, torch.float64)
    size = double.square().mean().sqrt()
    assert 0.0 < (single - double).square().mean().sqrt() < 1e-5 * size
    assert 1e-5 * size < (half - double).square().mean().sqrt() < 0.03 * size


def test_bfloat16_is_used_where_the_processor_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = RECIPES["toy-uniform"]
    samples, net = seen(recipe), shaken(recipe.config)
    known = {h: LearnedRule(net, recipe.base_rule(), recipe.extra, h)._raw(samples) for h in (False, True)}
    for has in (False, True):
        monkeypatch.setattr(inet, "has_bfloat16", lambda has=has: has)
        assert torch.equal(LearnedRule(net, recipe.base_rule(), recipe.extra)._raw(samples), known[has])
    for told, expected in (({}, False), ({"avx512_bf16": True}, False), ({"amx_bf16": True}, True)):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda told=told: told, raising=False)
        assert has_bfloat16.__wrapped__() is expected


def test_a_network_for_doubtful_integrals_sees_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = RECIPES["gwn-structured"]
    samples = seen(recipe, 300, 32)
    flagged = recipe.base_rule().combine(samples).fallback
    assert flagged is not None
    assert 0 < flagged.sum() < 100
    rule = LearnedRule(shaken(recipe.config), recipe.base_rule(), recipe.extra)
    read = []

    def watched(*arguments: Any) -> torch.Tensor:
        read.append(len(arguments[0].value))
        return tokenize(*arguments)

    monkeypatch.setattr(inet, "tokenize", watched)
    whole = rule.combine(samples).estimate(samples)
    assert sum(read) == int(flagged.sum())
    base = recipe.base_rule().combine(samples).estimate(samples)
    assert torch.equal(whole[~flagged], base[~flagged])
    assert not torch.equal(whole[flagged], base[flagged])


@pytest.mark.parametrize("name", [name for name in NAMES if RECIPES[name].extra and RECIPES[name].extra.check])
def test_checked_quantities_alone_are_those_of_the_tokens(name: str) -> None:
    extra, samples = RECIPES[name].extra, seen(RECIPES[name])
    assert extra is not None
    assert extra.check is not None
    alone = extra.check(sort_samples(samples))
    tokens = extra.compute(sort_samples(samples))[..., list(extra.checked)]
    # Some tokens are rounded to single precision on the way, which is nothing beside the margin of a card's range.
    np.testing.assert_allclose(alone, tokens, rtol=1e-5, atol=1e-7)


def test_the_network_always_sees_tiles_of_one_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Float32 products may change with the number of rows, on some machines."""
    recipe = RECIPES["toy-uniform"]
    rule = LearnedRule(shaken(recipe.config), recipe.base_rule(), recipe.extra)
    shapes = set()
    forward = INet.forward

    def watched(self: INet, tokens: torch.Tensor) -> torch.Tensor:
        shapes.add(tuple(tokens.shape))
        return forward(self, tokens)

    monkeypatch.setattr(INet, "forward", watched)
    for rows in (1, 300, 600):
        rule.combine(seen(recipe, rows))
    assert shapes == {(256 * 32 // 16, 16, recipe.config.tokens.width)}


@pytest.mark.parametrize("techniques", [1, 3])
def test_the_least_change_moves_the_integral_and_keeps_constants(techniques: int) -> None:
    generator = torch.Generator().manual_seed(0)
    value = torch.randn(7, 5, techniques, 2, generator=generator, dtype=torch.float64) + 4.0
    shift = torch.randn(7, 2, generator=generator, dtype=torch.float64)
    change = least_change(shift, value)
    np.testing.assert_allclose((change * value).sum(dim=2).mean(dim=1), shift, atol=1e-12)
    np.testing.assert_allclose(change.sum(dim=(1, 2)), torch.zeros(7, 2), atol=1e-11)
    # Any other change that does both is larger.
    for index in np.ndindex(7, 2):
        row, channel = index
        both = np.stack([np.ones(5 * techniques), value[row, :, :, channel].numpy().ravel()])
        smallest = np.linalg.lstsq(both, [0.0, 5.0 * shift[index].item()], rcond=None)[0]
        np.testing.assert_allclose(change[row, :, :, channel].ravel(), smallest, atol=1e-10)
    assert not least_change(shift, torch.full_like(value, 1e6)).any()


def test_an_offset_that_is_spread_is_one_of_weights() -> None:
    recipe = RECIPES["toy-uniform"]
    samples, base = seen(recipe), recipe.base_rule().combine(seen(recipe))
    raw = torch.zeros(*samples.value.shape[:3], recipe.config.outputs)
    raw[..., -1] = torch.linspace(-1.0, 2.0, samples.n)[None, :, None]
    spread = correct(raw, base, samples, recipe.config)
    added = correct(raw, base, samples, replace(recipe.config, spread=False))
    assert spread.offset is None
    assert added.offset is not None
    np.testing.assert_allclose(spread.estimate(samples), added.estimate(samples), atol=1e-12)
    np.testing.assert_allclose(spread.weights.mean(dim=1), torch.ones(len(samples.value), 1, 1), atol=1e-12)
    with pytest.raises(ValueError, match="spread: expected False for a network without an offset, got True"):
        INetConfig(spread=True)


@pytest.mark.parametrize("reach", [0, 2])
def test_padding_changes_nothing(reach: int) -> None:
    config = INetConfig(TokenConfig(), layers=2, width=16, reach=reach)
    net = shaken(config)
    tokens = torch.linspace(-1.0, 1.0, 3 * 5 * config.tokens.width).view(3, 5, -1)
    padded = torch.cat([tokens, torch.full((3, 4, config.tokens.width), 7.0)], dim=1)
    padding = torch.arange(9).expand(3, 9) >= 5
    np.testing.assert_allclose(net(padded, padding)[:, :5].detach(), net(tokens).detach(), atol=2e-6)


def test_blocks_that_reach_know_which_samples_are_neighbours() -> None:
    config = INetConfig(TokenConfig(), layers=1, width=16, reach=1)
    net = shaken(config)
    with torch.no_grad():
        net.blocks[0].qkv.weight.zero_()  # all keys alike: attention sees the mean of values that are zero
        net.blocks[0].qkv.bias.zero_()
    tokens = torch.linspace(-1.0, 1.0, 7 * config.tokens.width).sin().view(1, 7, -1)
    other = tokens.clone()
    other[0, 3] = 2.0
    changed = (net(tokens) != net(other))[0].any(dim=-1)
    assert changed.tolist() == [False, False, True, True, True, False, False]


def test_samples_without_an_order_have_no_neighbours() -> None:
    with pytest.raises(ValueError, match="reach: expected 0 for samples in 2 dimensions, got 1"):
        INetConfig(TokenConfig(dim=2), reach=1)


def test_network_is_equivariant_to_token_order() -> None:
    config = INetConfig(TokenConfig(dim=2), layers=2, width=16)
    net = shaken(config)
    tokens = torch.linspace(-1.0, 1.0, 3 * 6 * config.tokens.width).sin().view(3, 6, -1)
    order = torch.tensor([4, 0, 5, 2, 1, 3])
    np.testing.assert_allclose(net(tokens[:, order]).detach(), net(tokens)[:, order].detach(), atol=2e-6)


def test_relative_weights_are_bounded_where_the_integrand_is_not() -> None:
    config = INetConfig(TokenConfig(unit=1.0), offset=True)
    samples = sample([1e12, -0.5], [0.3, 0.7])
    raw = torch.tensor([[-30.0, 0.2, 0.1], [0.0, 0.2, 0.1]])[None, :, None]  # g, h, o
    base = Combination(torch.ones(1, 2, 1, 1, dtype=torch.float64))
    result = correct(raw, base, samples, config)
    # W f: 1e12 e^-30 + 0.2 from the singular sample, -0.5 * 1.2 from the other.
    expected = 0.5 * (1e12 * np.exp(-30.0) + np.float32(0.2) - 0.5 * (1.0 + np.float32(0.2))) + np.float32(0.1)
    np.testing.assert_allclose(result.estimate(samples).item(), expected, rtol=1e-5)


def test_additive_weights_are_the_plain_form() -> None:
    config = INetConfig(TokenConfig(unit=1.0), weights="additive")
    samples = sample([100.0, 3.0], [0.3, 0.7])
    base = Combination(torch.ones(1, 1, 1, 1, dtype=torch.float64))
    result = correct(torch.tensor([0.5, -0.25])[None, :, None, None], base, samples, config)
    np.testing.assert_allclose(result.weights.flatten(), [1.5, 0.75])
    assert result.offset is None


def test_unit_mass_keeps_constants() -> None:
    config = INetConfig(TokenConfig(unit=1.0, centred=True), unit_mass=True)
    samples = sample([7.0, 7.0, 7.0], [0.1, 0.2, 0.8])
    raw = torch.tensor([[0.3, 1.0], [-2.0, 0.4], [0.1, 0.1]])[None, :, None]
    base = Combination(torch.ones(1, 1, 1, 1, dtype=torch.float64))
    np.testing.assert_allclose(correct(raw, base, samples, config).estimate(samples).item(), 7.0, rtol=1e-14)


def test_only_doubtful_rows_are_corrected() -> None:
    config = INetConfig(TokenConfig(unit=1.0), offset=True, doubtful_only=True)
    two = sample([1.0, 2.0], [0.1, 0.9])
    samples = replace(two, x=two.x.repeat(2, 1, 1), seen=Observation(two.value.repeat(2, 1, 1, 1)))
    flags = torch.tensor([True, False])
    base = Combination(torch.ones(1, 1, 1, 1, dtype=torch.float64), torch.zeros(2, 1, dtype=torch.float64), flags)
    result = correct(torch.full((2, 2, 1, 3), 0.5), base, samples, config)
    assert result.estimate(samples)[1].item() == 1.5
    assert result.estimate(samples)[0].item() > 2.0


def test_a_gate_leaves_the_base_or_puts_plain_weights_in_its_place() -> None:
    config = INetConfig(TokenConfig(unit=1.0), weights="additive", unit_mass=True, gated=True)
    samples = sample([2.0, 6.0], [0.3, 0.7])
    base = Combination(torch.full((1, 2, 1, 1), 3.0).double(), torch.full((1, 1), -1.0).double())
    raw = torch.tensor([[0.25, 0.0], [-0.25, 0.0]])[None, :, None]  # h and the gate of each sample
    shut = correct(raw, base, samples, config)
    assert torch.equal(shut.weights, base.weights)
    assert torch.equal(shut.offset, base.offset)
    raw[..., 1] = torch.tensor([[1.0], [3.0]])
    part = np.tanh(2.0)
    own = 0.5 * (2.0 * 1.25 + 6.0 * 0.75)
    expected = (1.0 - part) * base.estimate(samples).item() + part * own
    np.testing.assert_allclose(correct(raw, base, samples, config).estimate(samples).item(), expected, rtol=1e-12)
    assert config.outputs == 2
    assert INetConfig.from_dict(config.to_dict()) == config


def test_errors_may_count_in_a_unit_of_their_own() -> None:
    recipe = replace(RECIPES["toy-uniform"], unit=1e-3, huber=1e4)
    assert robust(recipe, torch.full((2, 1), 3e-3, dtype=torch.float64), None).item() == pytest.approx(9.0, rel=1e-5)


@pytest.mark.parametrize("base_offset", [(2, 1), (2, 4, 1)])
def test_offset_joins_either_form_of_the_base_offset(base_offset: tuple[int, ...]) -> None:
    config = INetConfig(TokenConfig(unit=2.0), offset=True)
    one = sample([1.0, 1.0, 1.0, 1.0], [0.1, 0.2, 0.5, 0.9])
    samples = replace(one, x=one.x.repeat(2, 1, 1), seen=Observation(one.value.repeat(2, 1, 1, 1)))
    base = Combination(torch.ones(1, 1, 1, 1, dtype=torch.float64), torch.full(base_offset, 10.0).double())
    raw = torch.tensor([0.0, 0.0, 0.25]).expand(2, 4, 1, 3)
    np.testing.assert_allclose(correct(raw, base, samples, config).estimate(samples).flatten(), [11.5, 11.5])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-30, 1e30, 1e150])
def test_tokens_are_finite_for_any_finite_values(name: str, size: float) -> None:
    recipe = RECIPES[name]
    samples = seen(recipe, 4)
    features = {
        key: value if value.dtype == torch.int64 else value * size for key, value in samples.seen.features.items()
    }
    wild = replace(samples, seen=replace(samples.seen, value=samples.value * size, features=features))
    tokens = tokenize(sort_samples(wild), recipe.config.tokens, recipe.extra)
    assert tokens.shape == (*samples.value.shape[:3], recipe.config.tokens.width)
    assert tokens.dtype == torch.float32
    assert tokens.isfinite().all()
    assert tokens.abs().max() <= 16.0


def test_a_spoilt_row_stays_alone() -> None:
    recipe = RECIPES["gwn-uniform"]
    samples = seen(recipe, 4)
    rule = LearnedRule(shaken(recipe.config), recipe.base_rule(), recipe.extra)
    clean = rule.combine(samples).estimate(samples)
    value = samples.value.clone()
    value[1] = torch.nan
    spoilt = replace(samples, seen=replace(samples.seen, value=value))
    answer = rule.combine(spoilt).estimate(spoilt)
    assert answer[1].isnan().all()
    assert torch.equal(answer[[0, 2, 3]], clean[[0, 2, 3]])


def test_indices_are_taken_modulo_their_levels() -> None:
    config = TokenConfig((Feature("piece", "index", levels=3),))
    plain = sample([1.0, 2.0], [0.2, 0.6])

    def with_piece(piece: list[int]) -> Samples:
        features = {"piece": torch.tensor(piece)[None, :, None, None]}
        return replace(plain, seen=replace(plain.seen, features=features))

    one_hot = slice(12 + 1 + 6, 12 + 1 + 6 + 3)  # behind the position, the value and the neighbours
    tokens = tokenize(with_piece([4, 5]), config)[0, :, 0, one_hot]
    assert tokens.tolist() == [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def test_row_unit_makes_a_rule_homogeneous() -> None:
    config = INetConfig(TokenConfig(), layers=1, width=16)
    rule = LearnedRule(shaken(config), registry.make("rule", "trapezoid"))
    samples = sample([1.0, -3.0, 0.5, 2.0], [0.1, 0.4, 0.6, 0.8])
    one = rule.combine(samples).estimate(samples)
    for factor in (2.0**-300, 2.0**300):
        scaled = replace(samples, seen=replace(samples.seen, value=factor * samples.value))
        np.testing.assert_allclose(rule.combine(scaled).estimate(scaled).item(), factor * one.item(), rtol=1e-6)


def test_the_unit_of_extreme_rows_is_finite() -> None:
    value = torch.tensor([[1.7e308, 1.7e308], [0.0, 0.0], [5e-324, 0.0]], dtype=torch.float64)[:, :, None, None]
    unit = standard(value, TokenConfig())[1]
    assert unit.isfinite().all()
    assert (unit > 0.0).all()
    assert unit[1].item() == 1.0


def test_compress_is_odd_and_monotone() -> None:
    value = torch.linspace(-50.0, 50.0, 101, dtype=torch.float64)
    assert torch.equal(compress(-value), -compress(value))
    assert (compress(value, 3.0).diff() > 0.0).all()


def test_extra_must_fit_the_configuration() -> None:
    with pytest.raises(ValueError, match="extra: expected 0 quantities, got 2"):
        tokenize(sample([1.0], [0.5]), TokenConfig(), Extra(2, lambda samples: samples.value))


def test_missing_feature_is_named() -> None:
    with pytest.raises(ValueError, match="'inet' needs the feature 'piece'"):
        tokenize(sample([1.0], [0.5]), TokenConfig((Feature("piece", "index", levels=3),)))


@pytest.mark.parametrize("name", NAMES)
def test_configurations_survive_their_card(name: str) -> None:
    config = RECIPES[name].config
    assert INetConfig.from_dict(config.to_dict()) == config
