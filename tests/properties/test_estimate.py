"""An estimate tells the truth about itself: spread, counts, merging, and the same bits whatever the tiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from nqr_geom import registry
from nqr_geom.integrator import estimate as module
from nqr_geom.integrator.estimate import Estimate, Statistics, exactly, run
from nqr_geom.integrator.problem import Link, LogLink
from tests import fixtures
from tests.integrands import GamblersRuin, Logarithm, TwoTechniques, monomial, smooth, step

E1 = float(np.expm1(1.0))


def answer(problem, n=16, sampler="random", rule="mc", **options) -> Estimate:
    return run(problem, registry.make("sampler", sampler), registry.make("rule", rule), n, **options)


# --- statistics and merging ---------------------------------------------------------------------------


def statistics_of(terms):
    mean = terms.mean(axis=0)
    return Statistics(mean, ((terms - mean) ** 2).sum(axis=0), len(terms), "samples")


@pytest.mark.parametrize("cuts", [(1,), (5,), (3, 4, 19)])
def test_merged_parts_are_one_big_set(cuts):
    terms = np.random.default_rng(0).normal(1e6, 1.0, (20, 3, 2))  # a large mean: the naive sum of squares fails here
    parts = [statistics_of(part) for part in np.split(terms, cuts)]
    total = parts[0]
    for part in parts[1:]:
        total = total.merge(part)
    assert total.count == 20
    np.testing.assert_allclose(total.mean, terms.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(total.stderr, stats.sem(terms, axis=0), rtol=1e-8)


def test_statistics_of_different_kinds_do_not_merge():
    one = Statistics(np.zeros((2, 1)), np.zeros((2, 1)), 4, "samples")
    for other in (replace(one, kind="replicates"), replace(one, mean=np.zeros((3, 1)))):
        with pytest.raises(ValueError, match=r"other: expected samples of shape \(2, 1\), got"):
            one.merge(other)


@pytest.mark.parametrize(
    ("sampler", "rule"), [("random", "mc"), ("stratified", "trapezoid"), ("random", "difference-cv")]
)
def test_merged_estimates_are_one_run_with_all_the_replicates(sampler, rule):
    one, two = (answer(smooth(), sampler=sampler, rule=rule, replicates=5, seed=s) for s in (0, 1))
    both = one.merge(two)
    np.testing.assert_allclose(both.value, (one.value + two.value) / 2.0, rtol=1e-14)
    np.testing.assert_allclose(both.inner, (one.inner + two.inner) / 2.0, rtol=1e-14)
    assert both.counts == {"samples": 480, "queries": 480}
    assert both.plan["seeds"] == (0, 1)
    assert both.seconds == one.seconds + two.seconds
    assert both.stages["draw"] == one.stages["draw"] + two.stages["draw"]
    # ten replicates are enough for a standard error, five are not
    assert (one.stderr is None) == (sampler == "stratified")
    assert both.stderr is not None


def test_merge_of_unequal_replicates_weighs_them():
    one, two = answer(smooth(), sampler="stratified"), answer(smooth(), sampler="stratified", replicates=9, seed=1)
    np.testing.assert_allclose(one.merge(two).value, 0.1 * one.value + 0.9 * two.value, rtol=1e-13)


@pytest.mark.parametrize(
    ("other", "match"),
    [
        ({"seed": 0}, "other: expected other seeds"),
        ({"seed": 1, "n": 8}, "same plan"),
        ({"seed": 1, "rule": "trapezoid"}, "same plan"),
        ({"seed": 1, "sampler": "stratified"}, "same plan"),
        ({"seed": 1, "problem": step()}, "same plan"),
        ({"seed": 1, "problem": replace(smooth(), rows=torch.arange(2))}, "shape"),
    ],
)
def test_estimates_that_do_not_belong_together_are_refused(other, match):
    problem = other.pop("problem", smooth())
    with pytest.raises(ValueError, match=match):
        answer(smooth()).merge(answer(problem, **other))


def test_merge_keeps_a_peak_memory_of_zero():
    one = replace(answer(smooth()), peak_memory=0)
    two = answer(smooth(), seed=1)
    assert one.merge(replace(two, peak_memory=None)).peak_memory == 0
    assert one.merge(replace(two, peak_memory=7)).peak_memory == 7
    assert replace(one, peak_memory=None).merge(replace(two, peak_memory=None)).peak_memory is None


# --- standard errors ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("problem", "rule", "n"),
    [
        (smooth(), "mc", 32),
        (smooth(2), "mc", 64),
        (smooth(), "difference-cv", 32),
        (TwoTechniques(), "balance-heuristic", 32),
        (Logarithm(smooth().integrand, E1), "mc", 128),
    ],
)
def test_intervals_cover(problem, rule, n):
    """95% t intervals hold the truth for 92 to 98% of 2000 independent rows."""
    many = replace(problem, rows=torch.arange(2000))
    got = answer(many, n, rule=rule)
    inside = np.abs(got.value - many.reference()) <= stats.t.ppf(0.975, n - 1) * got.stderr
    assert 0.92 <= inside.mean() <= 0.98
    # and the interval is no wider than the errors: the spread of f - h, not that of f
    assert np.sqrt((got.stderr**2).mean()) == pytest.approx((got.value - many.reference()).std(), rel=0.08)


def test_intervals_from_replicates_cover():
    many = replace(smooth(), rows=torch.arange(2000))
    got = answer(many, 8, sampler="sobol", replicates=12)
    inside = np.abs(got.value - E1) <= stats.t.ppf(0.975, 11) * got.stderr
    assert 0.92 <= inside.mean() <= 0.98


@pytest.mark.parametrize("sampler", [entry.name for entry in registry.entries("sampler") if not entry.needs])
def test_no_standard_error_without_independence(sampler):
    """Only independent samples tell their spread in one run; any design does after eight replicates."""
    rule = "trapezoid"
    assert answer(smooth(), sampler=sampler, rule=rule).stderr is None
    assert answer(smooth(), sampler=sampler, rule=rule, replicates=7).stderr is None
    assert answer(smooth(), sampler=sampler, rule=rule, replicates=8).stderr is not None
    if registry.make("sampler", sampler).uniform:
        assert (answer(smooth(), sampler=sampler).stderr is None) == (sampler != "random")
    assert answer(smooth(), 1).stderr is None  # one sample has no spread


# --- work and tiles -----------------------------------------------------------------------------------


def test_counts_and_plan():
    got = answer(TwoTechniques(), 10, rule="balance-heuristic", replicates=3, seed=4)
    assert got.counts == {"samples": 90, "queries": 180}
    assert got.plan == {
        "problem": "two-techniques",
        "sampler": "random",
        "rule": "balance-heuristic",
        "n": 10,
        "replicates": 3,
        "seeds": (4,),
    }
    assert 0.0 < sum(got.stages.values()) <= got.seconds
    assert got.n == 10
    assert got.value.dtype == got.inner.dtype == np.float64


@pytest.mark.parametrize("tile", [1, 16, 40])
@pytest.mark.parametrize("rule", fixtures.RULES, ids=lambda entry: entry.name)
def test_the_same_bits_whatever_the_tile_size(rule, tile, monkeypatch):
    name, sampler, _ = fixtures.accepted(rule, 16)[0]
    problem = fixtures.problem(name)
    whole = answer(problem, 16, sampler, rule.name, replicates=2)
    part = answer(problem.take(slice(1, 3)), 16, sampler, rule.name, replicates=2)
    monkeypatch.setattr(module, "TILE_SAMPLES", tile)
    tiled = answer(problem, 16, sampler, rule.name, replicates=2)
    for field in ("value", "inner", "fallback"):
        np.testing.assert_array_equal(getattr(whole, field), getattr(tiled, field))
        np.testing.assert_array_equal(getattr(whole, field)[1:3], getattr(part, field))
    assert whole.counts == tiled.counts
    if whole.stderr is not None:
        np.testing.assert_array_equal(whole.stderr, tiled.stderr)


def test_a_long_row_alone_is_not_split_over_threads():
    """Torch splits one sum of 2^15 and more numbers over threads, which changes its last bits."""
    pair = replace(smooth(), rows=torch.arange(2))
    both = answer(pair, 60000)
    for row in range(2):
        alone = answer(pair.take(slice(row, row + 1)), 60000)
        np.testing.assert_array_equal(alone.value, both.value[row : row + 1])
        np.testing.assert_array_equal(alone.stderr, both.stderr[row : row + 1])


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"n": 0}, ValueError, "n: expected an integer >= 1, got 0"),
        ({"n": 2.0}, TypeError, "n: expected an integer, got 2.0"),
        ({"replicates": 0}, ValueError, "replicates: expected an integer >= 1, got 0"),
        ({"seed": "x"}, TypeError, "seed: expected an integer, got 'x'"),
        ({"split": "holdout"}, ValueError, "split: expected one of"),
        ({"problem": smooth(2), "rule": "trapezoid"}, ValueError, "rule: 'trapezoid' needs a 1-D problem"),
        ({"problem": smooth(2), "sampler": "bayesian-quadrature"}, ValueError, "sampler: 'bayesian-quadrature' needs"),
        ({"sampler": "grid"}, ValueError, "rule: 'mc' needs samples with a density, 'grid' points have none"),
        ({"problem": TwoTechniques()}, ValueError, "use 'balance-heuristic'"),
    ],
)
def test_what_does_not_fit_is_refused(options, error, match):
    problem = options.pop("problem", smooth())
    with pytest.raises(error, match=match):
        answer(problem, **options)


def test_exact_answers_have_the_same_form():
    got = exactly(lambda: np.arange(3.0), "gwn")
    assert got.value.tolist() == [[0.0], [1.0], [2.0]]
    assert (got.stderr == 0.0).all()
    assert got.counts == {"samples": 0, "queries": 0}


# --- links --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", [Link(), LogLink(alpha=3.0, shift=torch.tensor([[0.5]], dtype=torch.float64))])
def test_slope_is_the_derivative(link):
    inner = torch.tensor([[0.3, 1.0, 20.0]], dtype=torch.float64)
    h = 1e-6
    np.testing.assert_allclose(link.slope(inner), (link(inner + h) - link(inner - h)) / (2 * h), rtol=1e-7)
    assert not link.clamped(inner).any()


def test_log_link_clamps_and_says_so():
    link = LogLink(alpha=2.0, floor=1e-8)
    inner = torch.tensor([[-1.0], [0.0], [1e-9], [1e-8], [1.0]], dtype=torch.float64)
    assert link.clamped(inner).ravel().tolist() == [True, True, True, False, False]
    lowest = -np.log(1e-8) / 2.0
    np.testing.assert_allclose(link(inner).ravel(), [lowest] * 4 + [0.0], atol=1e-12)
    assert torch.isfinite(link.slope(inner)).all()


def test_a_clamped_row_is_flagged_in_the_estimate():
    negative = Logarithm(lambda x: torch.where(x[..., 0] < 2.0, -1.0, 0.0).double(), 1.0)
    got = answer(negative)
    assert got.fallback.all()
    assert np.isfinite(got.value).all()
    assert not answer(Logarithm(smooth().integrand, E1)).fallback.any()


def test_the_link_is_outside_each_replicate_and_inner_is_before_it():
    problem = Logarithm(smooth().integrand, E1)
    got = answer(problem, 8, replicates=4)
    plain = answer(smooth(), 8, replicates=4)
    np.testing.assert_array_equal(got.inner, plain.inner)
    assert (
        got.value > -np.log(got.inner) / problem.alpha
    ).all()  # Jensen: the mean of -log lies above -log of the mean


# --- walks --------------------------------------------------------------------------------------------


def test_evaluate_of_a_walk_is_its_loop():
    problem = GamblersRuin()
    x = torch.from_numpy(np.random.default_rng(0).random((4, 50, problem.dim)))
    seen = problem.evaluate(x)
    for row in range(4):
        for i in range(50):
            coins = row + 1
            for u in x[row, i].tolist():
                if 0 < coins < problem.goal:
                    coins += 1 if u < problem.p else -1
            assert seen.value[row, i, 0, 0] == (coins == problem.goal)
            assert seen.features["coins"][row, i, 0, 0] == coins
    assert seen.queries == 200


@pytest.mark.parametrize("p", [0.5, 0.4])
@pytest.mark.parametrize("sampler", ["random", "latin-hypercube", "sobol", "pmj", "stratified"])
def test_a_walk_reaches_its_known_chance(sampler, p):
    problem = GamblersRuin(p=p)
    got = answer(problem, 512, sampler=sampler, replicates=16, seed=1)
    assert np.abs((got.value - problem.reference()) / got.stderr).max() < 4.5  # t of at least 15 degrees, 40 checks
    long = replace(problem, dim=300)
    np.testing.assert_allclose(long.reference(), long.in_the_long_run(), atol=1e-10)


def test_monomials_know_their_integral():
    for degree in (0, 1, 4):
        assert answer(monomial(degree), 2000).value.mean() == pytest.approx(1.0 / (degree + 1), abs=0.02)
