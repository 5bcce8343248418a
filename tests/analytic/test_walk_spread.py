"""Walks that avoid each other: their density is exact, the network begins as they do, and answers need fewer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal
from scipy import stats

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.learn.snet import LearnedSampler, SNet, SNetConfig
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.streams import Stream
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.spread import FullWalkSpread, WalkSpread
from nqr_geom.wos.steps import LaplaceWalks
from nqr_geom.wos.structured import WalkFit

STREAM = Stream(2, "validation")
SHAPE = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
STEP = SNetConfig(TokenConfig(dim=12, unit=1.0, frequencies=1), head="step", bins=24, floor=0.05)


def many(rows: int, max_steps: int) -> LaplaceProblem:
    """One query again and again, with random numbers of its own each time."""
    problem = ng.problems.laplace(SHAPE, [0.0, 1.0, 0.5, 2.0, -1.0, 0.0], [[0.7, 0.6]], max_steps=max_steps)
    return replace(problem.take(torch.zeros(rows, dtype=torch.int64)), rows=torch.arange(rows))


def test_the_density_is_that_of_the_walks():
    """Weights of 1/p give what independent walks give, for every walk in the sequence; so do those of a constant."""
    rows = 20_000
    samples = WalkSpread().draw(many(rows, 3), 5, STREAM)
    plain = registry.make("sampler", "random").draw(many(rows, 3), 64, STREAM).value.mean(dim=(1, 2, 3)).numpy()
    assert samples.pdf is not None
    assert_array_equal(samples.pdf[:, [0, 4]], 1.0)  # one in four is uniform
    for k in range(1, 4):
        weight = 1.0 / samples.pdf[:, k, 0].numpy()
        assert 1.0 < weight.std() < 4.0  # the densities do differ from uniform ones
        assert stats.ttest_1samp(weight, 1.0).pvalue > 1e-3
        assert stats.ttest_ind(weight * samples.value[:, k, 0, 0].numpy(), plain, equal_var=False).pvalue > 1e-3


def test_an_untrained_network_makes_the_same_walks():
    problem = LaplaceProblem.family(6, 3, "validation", points=16)
    net = LearnedSampler(SNet(STEP, LaplaceWalks).eval())
    first, second = (sampler.draw(problem, 24, STREAM).pdf for sampler in (FullWalkSpread(), net))
    assert first is not None
    assert second is not None
    spread = [p.log()[..., 0].sum(dim=1).numpy() for p in (first, second)]
    assert abs(spread[0].mean() - spread[1].mean()) < 4.0 * np.hypot(*(s.std() / np.sqrt(len(s)) for s in spread))
    assert spread[0].mean() > 5.0


def test_a_network_without_a_base_walks_uniformly():
    """Whatever the direction that its sectors are counted from."""

    class Plain(LaplaceWalks):
        base = (0.0, 0.0, 0.0)

    x = LearnedSampler(SNet(STEP, Plain).eval()).draw(LaplaceProblem.family(8, 3, "validation", points=32), 4, STREAM).x
    for j in (0, 1, 5, 11):
        assert stats.kstest(x[..., j].flatten().numpy(), "uniform").pvalue > 1e-3


def test_a_hundred_times_monte_carlo():
    problem = LaplaceProblem.family(12, points=48, seed=5)
    truth = problem.reference()[:, 0]
    plain = registry.make("sampler", "random").draw(problem, 32, STREAM).value.mean(dim=(1, 2, 3)).numpy()
    samples = WalkSpread().draw(problem, 32, STREAM)
    error = WalkFit().combine(samples).estimate(samples)[:, 0].numpy() - truth
    assert np.mean((plain - truth) ** 2) > 100.0 * np.mean(error**2)


def test_rows_do_not_depend_on_the_batch_and_many_walks_stay_cheap():
    problem = LaplaceProblem.family(2, points=5)
    whole, part = (WalkSpread().draw(p, 12, STREAM) for p in (problem, problem.take(torch.tensor([7, 2]))))
    assert_array_equal(whole.x[[7, 2]], part.x)
    assert whole.pdf is not None
    assert part.pdf is not None
    assert_array_equal(whole.pdf[[7, 2]], part.pdf)
    more = WalkSpread(most=8).draw(problem, 20, STREAM)
    assert more.pdf is not None
    assert more.n == 20
    assert_array_equal(more.pdf[:, 8:], 1.0)
    assert_array_equal((more.x[0, 8:, 3] * 12).long().sort().values, np.arange(12))  # a Latin hypercube
    assert_array_equal(more.x[:, :8], WalkSpread(most=8).draw(problem, 8, STREAM).x)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="sampler: 'walk-spread' needs the problem 'laplace', got 'toy'"):
        WalkSpread().draw(ToyProblem(torch.arange(1)), 4, STREAM)
    for name, value in (("bins", 1), ("floor", 0.0), ("floor", 1.5), ("most", 0), ("smallest", -1.0), ("rim", -0.1)):
        with pytest.raises(ValueError, match=f"{name}: expected"):
            WalkSpread(**{name: value})
