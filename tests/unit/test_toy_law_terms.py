"""What the network on plain weights reads of the laws of pieces: exact inside them, continued where a break hides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.learn.tokens import standard, tokenize
from nqr_geom.integrator.learn.train import draw_batch, loss
from nqr_geom.integrator.problem import Observation, Samples
from nqr_geom.integrator.rules import interval_weights
from nqr_geom.integrator.sums import row_mean
from nqr_geom.recipes import RECIPES
from nqr_geom.toy.law import propagate
from nqr_geom.toy.law_terms import LAW_TERMS, law_terms, missed_by_mean
from nqr_geom.toy.law_tokens import pieces_of
from nqr_geom.toy.tokens import CENTRED, TOY_TERMS, toy_terms

PLACES = (torch.arange(8, dtype=torch.float64) + 0.5) / 8.0
K = len(PLACES)
RIGHT, LEFT, HIGH, AREAS = 7, 8 + 2 * K, 9 + 4 * K, 9 + 6 * K  # where the terms of either gap begin, and others


RECIPE = RECIPES["toy-uniform"]


def drawn(n: int = 32, rows: int = 128) -> tuple[Batch, Samples]:
    return draw_batch(replace(RECIPE, designs=("random",)), torch.arange(rows), n, 5, "validation")


def terms(samples: Samples) -> Tensor:
    """The new quantities, (B, N, 76) float64, with the compression undone of those that have any."""
    new = law_terms(samples)[:, :, 0, TOY_TERMS.size :].double()
    return torch.cat([new[..., :4], new[..., 4:HIGH].sinh(), new[..., HIGH:]], dim=-1)


def unit_of(samples: Samples) -> Tensor:
    return standard(samples.value, CENTRED)[1][..., 0, 0]


def edges_of(samples: Samples) -> Tensor:
    return torch.nn.functional.pad(torch.nn.functional.pad(samples.x[..., 0], (1, 0)), (0, 1), value=1.0)


def test_inside_pieces_the_integral_over_each_gap_is_told_by_both_its_ends() -> None:
    batch, samples = drawn()
    told, edges = terms(samples), edges_of(samples)
    value, h = samples.value[:, :, 0, 0], edges.diff(dim=1)
    ends = torch.nn.functional.pad(value, (1, 1))
    ends[:, 0], ends[:, -1] = value[:, 0], value[:, -1]
    truth = pieces_of(batch).antiderivative(edges).diff(dim=1) - 0.5 * h * (ends[:, 1:] + ends[:, :-1])
    piece = torch.nn.functional.pad(samples.feature("piece", "test")[:, :, 0, 0], (1, 1))
    piece[:, -1] = 4
    same = piece.diff(dim=1) == 0
    known = told[..., 0] > 0.0
    for start, gaps in ((RIGHT, slice(1, None)), (LEFT, slice(None, -1))):
        sure = known & same[:, gaps]
        assert sure.double().mean() > 0.8
        got, wanted = told[..., start] * unit_of(samples) / samples.n, torch.where(sure, truth[:, gaps], 0.0)
        assert_allclose(got, wanted, atol=1e-7)


def test_where_a_break_hides_both_laws_are_continued() -> None:
    batch, samples = drawn()
    pieces, told, x = pieces_of(batch), terms(samples) * unit_of(samples)[..., None], samples.x[..., 0]
    own = samples.feature("piece", "test")[:, :, 0, 0]

    def law(piece: Tensor, at: Tensor) -> Tensor:
        names = "edges", "alpha", "value", "slope", "curvature"
        start, alpha, *rest = (getattr(pieces, name).gather(1, piece)[..., None] for name in names)
        return propagate(alpha, at - start, *rest)[0]

    known = terms(samples)[..., 0] > 0.0
    at = x[:, :-1, None] + PLACES * x.diff(dim=1)[..., None]
    hidden = (own.diff(dim=1) != 0) & known[:, 1:] & known[:, :-1]
    assert 300 < int(hidden.sum()) < 600
    left, right = law(own[:, :-1], at), law(own[:, 1:], at)
    value = samples.value[:, :, 0]
    for got, wanted in (
        (told[:, :-1, RIGHT + 1 : RIGHT + 1 + K], left - value[:, :-1]),
        (told[:, :-1, RIGHT + 1 + K : LEFT], right - left),
        (told[:, 1:, LEFT + 1 : LEFT + 1 + K].flip(-1), right - value[:, 1:]),
        (told[:, 1:, LEFT + 1 + K : HIGH].flip(-1), left - right),
    ):
        assert_allclose(got[hidden], wanted[hidden], rtol=2e-5, atol=1e-6)
    # Where in its wave the right law stands, told by both samples alike.
    high, wave = terms(samples)[..., HIGH:AREAS].split(K, dim=-1), hidden & (pieces.alpha.gather(1, own[:, 1:]) > 0.0)
    centre, height = samples.value.mean(dim=1) + told[:, 1:, 5:6], told[:, 1:, 6:7]
    assert_allclose(high[0][:, :-1][wave], ((right - centre) / height)[wave], atol=1e-4)
    assert torch.equal(high[0][:, :-1], high[1][:, 1:].flip(-1))
    assert not high[0][:, :-1][hidden & ~wave].any()
    same = own.diff(dim=1) == 0
    assert not told[:, :-1, RIGHT + 1 : LEFT][same].any()
    assert not told[:, 1:, LEFT + 1 : HIGH][same].any()


def test_omega_curvature_centre_and_height_are_those_of_the_pieces() -> None:
    batch, samples = drawn()
    pieces, told = pieces_of(batch), terms(samples)
    known, omega, bend = told[..., 0] > 0.0, told[..., 3] / 0.04, told[..., 4] / 0.04**2 * unit_of(samples)
    piece = samples.feature("piece", "test")[:, :, 0, 0]
    alpha, at_start, first = (part.gather(1, piece) for part in (pieces.alpha, pieces.curvature, pieces.value))
    wanted = at_start - alpha * (samples.value[:, :, 0, 0] - first)
    assert 0.97 < known.double().mean() < 1.0
    assert_allclose(omega[known], alpha.sqrt()[known], rtol=1e-3, atol=1e-3)
    assert_allclose(bend[known], wanted[known], rtol=1e-3, atol=0.1)
    assert not told[..., 3:7][~known].any()
    wave = known & (alpha > 0.0)
    centre = samples.value.mean(dim=1)[..., 0] + told[..., 5] * unit_of(samples)
    level = (first + at_start / alpha.clamp_min(1.0))[wave]
    assert_allclose(centre[wave], level, atol=1e-5)
    height = told[..., 6] * unit_of(samples)
    assert not height[~wave].any()
    assert_allclose(((samples.value[:, :, 0, 0] - centre).abs() / height)[wave].max(), 1.0, atol=1e-3)
    assert torch.equal(told[:, :-1, 1], told[:, 1:, 0])
    assert torch.equal(told[:, 1:, 2], told[:, :-1, 0])


def test_areas_are_parts_of_the_integral() -> None:
    batch, samples = drawn()
    told, unit, n = terms(samples), unit_of(samples), samples.n
    trapezoid, inside, ahead, behind, first_inside, first_behind = told[..., AREAS:].split([1, 1, K, K, 1, K], dim=-1)
    value, edges = samples.value[:, :, 0, 0], edges_of(samples)
    weights = interval_weights(samples.x[..., 0])
    plain = ((weights - 1.0) * value).mean(dim=1, keepdim=True)
    assert_allclose(unit * trapezoid[..., 0].mean(dim=1, keepdim=True), plain, atol=1e-6)
    # In a piece all of the part that a sample answers for is told.
    wanted = n * missed_by_mean(batch, samples) / unit
    got = (trapezoid + inside + first_inside)[..., 0]
    piece = torch.nn.functional.pad(samples.feature("piece", "test")[:, :, 0, 0], (1, 1))
    piece[:, -1] = 4
    same = piece.diff(dim=1) == 0
    sure = (told[..., 0] > 0.0) & same[:, 1:]
    sure[:, 0] &= same[:, 0]
    assert sure.double().mean() > 0.8
    assert_allclose(got[sure], wanted[sure], atol=1e-5)
    h = n * edges.diff(dim=1)[..., None] / K
    assert_allclose(ahead, told[..., RIGHT + 1 : RIGHT + 1 + K].clamp(-4.0, 4.0) * h[:, 1:], rtol=2e-5, atol=1e-5)
    from_left = told[..., LEFT + 1 : LEFT + 1 + K].flip(-1).clamp(-4.0, 4.0) * h[:, :-1]
    assert_allclose(behind[:, :-1], from_left[:, 1:], rtol=2e-5, atol=1e-5)
    assert_allclose(first_behind[:, 0], from_left[:, 0], rtol=2e-5, atol=1e-5)
    assert_allclose(first_inside[:, 0], told[:, 0, LEFT : LEFT + 1], rtol=2e-5, atol=1e-5)
    assert not first_inside[:, 1:].any()
    assert not first_behind[:, 1:].any()


def test_lessons_are_the_parts_of_the_error() -> None:
    batch, samples = drawn(rows=16)
    recipe = replace(RECIPE, huber=30.0)
    off = batch.answer - row_mean(samples.value[..., 0, :])
    assert_allclose(missed_by_mean(batch, samples).sum(dim=1, keepdim=True), off, atol=1e-13)
    net = INet(recipe.config)
    torch.nn.init.normal_(net.head.weight, std=0.01, generator=torch.Generator().manual_seed(1))
    said = net(tokenize(samples, recipe.config.tokens, recipe.extra).flatten(1, 2))[..., 0] * unit_of(samples) / 32
    error = LearnedRule(net, recipe.base_rule(), recipe.extra).combine(samples).estimate(samples) - batch.answer
    left = said.double() - missed_by_mean(batch, samples)
    assert_allclose(left.sum(dim=1, keepdim=True).detach(), error, atol=1e-6)
    got = loss(recipe, net, batch, samples)
    assert_allclose(got.detach(), left.square().sum(dim=1).mean().detach(), rtol=1e-5)
    half = replace(batch, weight=torch.arange(16) % 2 * 1.0)
    assert_allclose(loss(recipe, net, half, samples).detach(), left[1::2].square().sum().detach() / 16, rtol=1e-5)


def test_the_first_quantities_are_the_taylor_terms() -> None:
    samples = drawn(rows=4)[1]
    assert torch.equal(law_terms(samples)[..., : TOY_TERMS.size], toy_terms(samples))
    assert law_terms(samples).shape == (4, 32, 1, LAW_TERMS.size)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_samples_are_no_obstacle(n: int) -> None:
    assert law_terms(drawn(n)[1]).isfinite().all()


@pytest.mark.parametrize(("factor", "shift"), [(1e3, 0.0), (1.0, 7.0), (-2.0, 1.0)])
def test_neither_an_added_constant_nor_a_factor_is_seen(factor: float, shift: float) -> None:
    samples = drawn()[1]
    slope = {**samples.seen.features, "derivative": factor * samples.feature("derivative", "test")}
    other = replace(samples, seen=Observation(factor * samples.value + shift, slope))
    # Heights of waves have no sign.
    sign = np.array([1.0] * 4 + [np.sign(factor)] * 2 + [1.0] + [np.sign(factor)] * (len(terms(samples)[0, 0]) - 7))
    assert_allclose(terms(other), sign * terms(samples).numpy(), rtol=1e-4, atol=1e-5)
