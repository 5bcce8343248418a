"""Error bars: moments that merge, intervals that hold where the kurtosis is bounded, flags where they do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.coverage import coverage
from nqr_geom.integrator.estimate import Statistics, run
from nqr_geom.streams import Stream
from tests.integrands import smooth

SQUARE = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)


@pytest.mark.parametrize("cuts", [(1,), (5,), (3, 4, 19), tuple(range(1, 20))])
def test_merged_moments_are_those_of_all_terms(cuts):
    terms = np.random.default_rng(0).exponential(2.0, (3, 20, 2)) + 1e3
    parts = [Statistics.of(part) for part in np.split(terms, cuts, axis=1)]
    total = parts[0]
    for part in parts[1:]:
        total = total.merge(part)
    np.testing.assert_allclose(total.skewness, stats.skew(terms, axis=1), rtol=1e-9)
    np.testing.assert_allclose(total.kurtosis, stats.kurtosis(terms, axis=1, fisher=False), rtol=1e-9)
    low, high = total.interval(0.9)
    expected = stats.t.interval(0.9, 19, terms.mean(axis=1), stats.sem(terms, axis=1))
    np.testing.assert_allclose([low, high], expected, rtol=1e-9)


def test_moments_of_the_compiled_pass_are_those_of_its_samples():
    points = np.random.default_rng(1).uniform(-1, 2, (40, 2))
    problem = ng.problems.gwn(SQUARE, points)
    got = ng.integrate(problem, 300, sampler="random", rule="mc", seed=4).statistics
    terms = registry.make("sampler", "random").draw(problem, 300, Stream(4, "test", "samples/0")).value[:, :, 0].numpy()
    np.testing.assert_allclose(got.skewness, stats.skew(terms, axis=1), rtol=1e-8)
    np.testing.assert_allclose(got.kurtosis, stats.kurtosis(terms, axis=1, fisher=False), rtol=1e-8)


def test_moments_pass_through_the_link():
    """Behind a logarithm the skewness changes its sign with the slope, the kurtosis does not."""
    problem = ng.problems.sd(SQUARE, [[0.5, 0.5], [2.0, 0.3]], alpha=2.0)
    got = ng.integrate(problem, 400, sampler="random", rule="mc", seed=4).statistics
    drawn = registry.make("sampler", "random").draw(problem, 400, Stream(4, "test", "samples/0"))
    terms = drawn.value[:, :, 0].numpy()
    np.testing.assert_allclose(got.skewness, -stats.skew(terms, axis=1), rtol=1e-6)
    np.testing.assert_allclose(got.kurtosis, stats.kurtosis(terms, axis=1, fisher=False), rtol=1e-6)


def test_walks_keep_their_moments_across_tiles_and_batches():
    """Walks that end on the top edge or not: a share p of ones, whose moments are known."""
    top = lambda x: (x[:, 1] > 0.9999).astype(float)  # noqa: E731
    square, point = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0.3, 0.4], [0.5, 0.9]]
    got = ng.solve_laplace(square, top, point, method="wos", n=2**18 + 100, full_output=True)
    p = got.value
    np.testing.assert_allclose(got.statistics.kurtosis, (1 - 3 * p * (1 - p)) / (p * (1 - p)), rtol=1e-9)
    np.testing.assert_allclose(got.statistics.skewness, (1 - 2 * p) / np.sqrt(p * (1 - p)), rtol=1e-9)
    assert got.trusted.all()


def test_intervals_hold_where_the_kurtosis_is_bounded_and_are_flagged_elsewhere():
    """500 runs on winding numbers, some of them of queries so near to the curve that no interval can be believed."""
    near = np.column_stack([np.linspace(0.2, 0.8, 12), np.full(12, 2e-3)])
    far = np.random.default_rng(0).uniform(1.2, 2.0, (12, 2))
    rows = coverage(ng.problems.gwn(SQUARE, np.concatenate([near, far])), sizes=[64, 256], runs=500)
    bounded = [row for row in rows if row.high <= row.n / 16]
    assert {row.n for row in bounded} == {64, 256}
    for row in bounded:
        assert 0.92 < row.covered < 0.98
        assert row.trusted > 0.9
        assert 0.92 < row.covered_trusted < 0.98
    wild = [row for row in rows if row.low >= row.n]
    assert {row.n for row in wild} == {64, 256}
    for row in wild:
        assert row.covered < 0.9
        assert row.trusted < 0.5


def test_few_terms_and_equal_terms_are_not_trusted_and_exact_answers_are():
    problem = smooth()
    few = run(problem, registry.make("sampler", "random"), registry.make("rule", "mc"), 32)
    assert few.stderr is not None
    assert not few.trusted.any()
    plain = run(problem, registry.make("sampler", "stratified"), registry.make("rule", "mc"), 32)
    assert plain.stderr is None
    assert not plain.trusted.any()
    assert not Statistics.of(np.ones((2, 100, 1))).trusted.any()
    assert ng.gwn(SQUARE, [[0.5, 0.5]], full_output=True).trusted.all()


def test_coverage_refuses_what_has_no_interval():
    problem = ng.problems.gwn(SQUARE, [[0.5, 0.5]])
    with pytest.raises(ValueError, match="sampler: expected independent samples"):
        coverage(problem, sampler="stratified", runs=2, sizes=[8])
    with pytest.raises(ValueError, match="sizes: expected an integer >= 2"):
        coverage(problem, sizes=[1])
