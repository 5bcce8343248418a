"""`method="inet"` of the smoothed distance: its doors, curves of many pieces, and what it does beyond its card."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.special import logsumexp

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.cli import main
from nqr_geom.integrator.estimate import Estimate, Statistics, exactly, folded
from nqr_geom.integrator.learn import publish
from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream

POINTS = np.random.default_rng(7).uniform(-0.9, 0.9, (40, 2))


@pytest.fixture(scope="module")
def shape() -> ng.Curve:
    return ng.datasets.curves(1, 3)[0]


def estimate_of(value: list[float], m2: list[float], fallback: list[bool]) -> Estimate:
    """An estimate of one channel, as the integrator gives it."""
    column = np.array(value)[:, None]
    plain = exactly(lambda: column[:, 0], "sd")
    statistics = Statistics(column, np.array(m2)[:, None], 20, "replicates")
    return replace(plain, value=column, fallback=np.array(fallback), statistics=statistics)


def test_the_doors_lead_to_the_same_answer(shape: ng.Curve) -> None:
    assert registry.method("inet", "sd") == ("stratified", "inet-sd-uniform")
    direct = ng.integrate(ng.problems.sd(shape, POINTS), 32, method="inet", seed=5)
    np.testing.assert_array_equal(ng.sd(shape, POINTS, method="inet", seed=5), direct.value[:, 0])
    error = direct.value[:, 0] - ng.sd(shape, POINTS)
    plain = ng.sd(shape, POINTS, method="stratified", seed=5) - ng.sd(shape, POINTS)
    assert np.mean(error**2) < 0.3 * np.mean(plain**2)
    assert not direct.fallback.any()


def test_parts_of_a_long_curve_add_up_before_the_logarithm(shape: ng.Curve) -> None:
    other = ng.datasets.curves(2, 3)[1].transformed([[0.9, 0.1], [0.0, 0.8]])
    whole = shape + other
    assert whole.n_pieces == 12
    estimate = ng.sd(whole, POINTS, method="inet", seed=2, full_output=True)
    assert estimate.plan["parts"] == 2
    assert estimate.value.shape == (40, 1)
    parts = ng.integrate(ng.problems.sd(whole.split_pieces(6), POINTS), 32, method="inet", seed=2).value.reshape(2, 40)
    np.testing.assert_allclose(estimate.value[:, 0], -logsumexp(-35.0 * parts, axis=0) / 35.0, rtol=1e-13)
    assert np.median(np.abs(estimate.value[:, 0] - ng.sd(whole, POINTS))) < 0.01
    assert estimate.counts["samples"] == 40 * 64


def test_folding_takes_the_nearest_part_out() -> None:
    """Exponents of -35e3 and more, and spreads weighed with each part's share of the sum."""
    near, far = [1000.0, 2.0, 1.0], [1000.01, 1e6, 1.0]
    estimate = estimate_of(near + far, [4.0] * 6, [False, False, False, True, True, False])
    result = folded(estimate, 2, 35.0)
    expected = -logsumexp(-35.0 * np.array([near, far]), axis=0) / 35.0
    np.testing.assert_allclose(result.value[:, 0], expected, rtol=1e-14)
    share = np.exp(-35.0 * (np.array([near, far]) - expected))
    np.testing.assert_allclose(result.statistics.m2[:, 0], 4.0 * (share**2).sum(axis=0), rtol=1e-9)
    np.testing.assert_allclose(result.stderr, np.sqrt(result.statistics.m2 / 380.0))
    assert result.fallback.tolist() == [True, False, False]  # a doubt about a part that nobody sees is none
    assert np.isfinite(result.inner).all()


def test_without_a_logarithm_parts_add_up() -> None:
    result = folded(estimate_of([1.0, 2.0, 3.0, 4.0], [1.0] * 4, [False, True, False, False]), 2)
    np.testing.assert_array_equal(result.value, [[4.0], [6.0]])
    np.testing.assert_array_equal(result.statistics.m2, [[2.0], [2.0]])
    assert result.fallback.tolist() == [False, True]


@pytest.mark.parametrize("alpha", [0.01, 1e4])
def test_another_sharpness_gives_way_to_the_trapezoid(shape: ng.Curve, alpha: float) -> None:
    estimate = ng.sd(shape, POINTS, alpha=alpha, method="inet", full_output=True)
    assert estimate.fallback.all()
    safe = ng.sd(shape, POINTS, alpha=alpha, method="trapezoid")
    np.testing.assert_array_equal(estimate.value[:, 0], safe)


@pytest.mark.parametrize("alpha", [35.0 / 4.0, 70.0])
def test_sharpness_within_the_card_is_answered(shape: ng.Curve, alpha: float) -> None:
    estimate = ng.sd(shape, POINTS, alpha=alpha, method="inet", full_output=True)
    assert estimate.fallback.mean() < 0.1
    truth = ng.sd(shape, POINTS, alpha=alpha)
    plain = ng.sd(shape, POINTS, alpha=alpha, method="stratified")
    assert np.mean((estimate.value[:, 0] - truth) ** 2) < 0.5 * np.mean((plain - truth) ** 2)


def test_scale_and_sharpness_go_together(shape: ng.Curve) -> None:
    here = ng.sd(shape, POINTS, method="inet", seed=1)
    there = ng.sd(shape.transformed(np.eye(2) * 8.0), 8.0 * POINTS, alpha=35.0 / 8.0, method="inet", seed=1)
    np.testing.assert_allclose(there, 8.0 * here - np.log(8.0) * 8.0 / 35.0, atol=0.02)


@pytest.mark.parametrize("alpha", [1e-3, 35.0, 1e6])
def test_queries_on_the_curve_and_far_away_are_finite(shape: ng.Curve, alpha: float) -> None:
    points = np.concatenate([shape.sample([0.1, 0.5, 0.9]), [[1e3, -1e3], [1e9, 0.0]], POINTS[:5]])
    for n in (1, 8, 32, 4096):
        assert np.isfinite(ng.sd(shape, points, alpha=alpha, method="inet", n=n)).all()


def test_the_share_behind_a_logarithm_is_the_best_of_the_blends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a network that only says too much: on fresh integrals no other share does better by more than noise."""
    monkeypatch.setattr(publish, "_BLEND_SAMPLES", 2**16)
    recipe = RECIPES["sd-uniform"]
    net = INet(recipe.config)
    torch.nn.init.constant_(net.head.bias[:1], 2.5)
    (share,) = publish.fit_shares(recipe, net, (32,))
    assert 0.05 < share < 0.95
    batch = recipe.family(torch.arange(4000), 0, "test")
    samples, link = batch.problem.finalize(draw_samples(batch.problem, recipe.designs, 32, Stream(0)))
    learned = LearnedRule(net, recipe.base_rule(), recipe.extra)
    mine, safe = (r.combine(samples).estimate(samples) for r in (learned, registry.make("rule", "trapezoid")))

    def error(s: float) -> float:
        return (link(s * mine + (1.0 - s) * safe) - batch.answer).square().mean().item()

    assert error(share) < 1.02 * min(error(s) for s in np.linspace(0.0, 1.0, 11))
    assert error(share) < min(error(0.0), error(1.0))


def test_the_command_line_knows_the_network(tmp_path: Path) -> None:
    points, out = tmp_path / "points.npy", tmp_path / "sd.npy"
    np.save(points, np.array([[-0.6, -0.5], [0.6, -0.4], [0.1, 0.7]]))
    words = ["sd", str(points), "--method", "inet", "--resolution", "8", "--out", str(out)]
    assert main(words) == 0
    field = np.load(out)
    assert np.isfinite(field).all()
    assert field.size == 64
