"""Samplers that give a density are uniform and make `mc` unbiased: hypothesis tests at a corrected level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from nqr_geom import registry
from nqr_geom.integrator.problem import Problem
from nqr_geom.streams import Stream
from tests.integrands import TwoTechniques, smooth, step

LEVEL = 0.001  # that any of the tests of this file fails by chance; all seeds are fixed
ROWS = 4000
UNIFORM = [
    entry.name
    for entry in registry.entries("sampler")
    if not entry.adaptive and entry.dims == "any" and getattr(entry.load(), "uniform", False)
]
SIZES = (1, 4, 11)
TESTS = len(UNIFORM) * len(SIZES) * 6


def many(problem: Problem, rows: int = ROWS) -> Problem:
    return replace(problem, rows=torch.arange(rows))


def check_mean(terms: np.ndarray, expected: float) -> None:
    """Two-sided t-test that independent terms (rows,) have the expected mean."""
    assert stats.ttest_1samp(terms, expected).pvalue > LEVEL / TESTS


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("name", UNIFORM)
def test_each_point_is_uniform_and_each_mean_unbiased(name, n):
    sampler, rule = registry.make("sampler", name), registry.make("rule", "mc")
    samples = sampler.draw(many(smooth(2)), n, Stream(1))
    # All points of a row together are uniform, axis by axis and jointly: one point a row, picked at random.
    pick = torch.from_numpy(np.random.default_rng(n).integers(0, n, ROWS))
    point = samples.x[torch.arange(ROWS), pick].numpy()
    for axis in range(2):
        assert stats.kstest(point[:, axis], "uniform").pvalue > LEVEL / TESTS
    counts = np.histogram2d(*point.T, bins=4, range=[[0, 1], [0, 1]])[0]
    assert stats.chisquare(counts.ravel()).pvalue > LEVEL / TESTS
    check_mean(rule.combine(samples).estimate(samples)[:, 0].numpy(), float(np.expm1(1.0)) ** 2)
    jump = sampler.draw(many(step()), n, Stream(2))
    check_mean(rule.combine(jump).estimate(jump)[:, 0].numpy(), 2.0 / 3.0)


@pytest.mark.parametrize("n", SIZES)
def test_rows_of_scrambled_nets_are_independent(n):
    """The estimates of neighbouring rows, and of the same row under other seeds, are uncorrelated."""
    for name in UNIFORM:
        sampler = registry.make("sampler", name)
        first, second = (sampler.draw(many(smooth()), n, Stream(seed)).value.mean(dim=(1, 2, 3)) for seed in (0, 1))
        for a, b in ((first[:-1], first[1:]), (first, second)):
            assert stats.pearsonr(a.numpy(), b.numpy()).pvalue > LEVEL / TESTS


def test_difference_control_variate_and_balance_heuristic_are_unbiased():
    for name, problem, expected in (
        ("difference-cv", many(smooth()), float(np.expm1(1.0))),
        ("balance-heuristic", many(TwoTechniques()), 1.0),
        ("stratification", many(smooth()), float(np.expm1(1.0))),
    ):
        sampler = registry.make("sampler", "stratified" if name == "stratification" else "random")
        samples = sampler.draw(problem, 4, Stream(3))
        check_mean(registry.make("rule", name).combine(samples).estimate(samples)[:, 0].numpy(), expected)


def test_the_test_can_tell():
    """A bias of a fiftieth of the mean, and a density that is not uniform, are seen at these sizes."""
    samples = registry.make("sampler", "random").draw(many(smooth(2)), 4, Stream(1))
    biased = 1.02 * registry.make("rule", "mc").combine(samples).estimate(samples)[:, 0].numpy()
    assert stats.ttest_1samp(biased, float(np.expm1(1.0)) ** 2).pvalue < LEVEL / TESTS
    assert stats.kstest(samples.x[:, 0, 0].numpy() ** 1.15, "uniform").pvalue < LEVEL / TESTS
