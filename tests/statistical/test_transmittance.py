"""Unbiased estimators of transmittance agree with the truth and with each other, and have the variance they should."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nqr_geom import render
from nqr_geom.integrator.samplers import JitterPair
from nqr_geom.render.estimators import optical_depth, reference
from nqr_geom.render.jackknife import Jackknife
from nqr_geom.render.kernels_track import track
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.unbiased import _series, march
from nqr_geom.streams import Stream

RUNS = 4000
NOISE = render.Noise(amplitude=0.8, frequency=0.9, seed=1)


def repeated(volume, ray, **options):
    """One ray, as RUNS integrals with random numbers of their own."""
    return TransmittanceProblem.of(volume, [ray[0]] * RUNS, [ray[1]] * RUNS, 20.0, **options)


def ball(density):
    """Depth 4/3 density along the diameter; `everything` puts it through the kernels for noisy balls."""
    return render.Spheres([[0, 0, 0]], [1.0], density=density)


def within(values, truth, sigmas=4.0):
    error = values.std(ddof=1) / np.sqrt(len(values))
    assert abs(values.mean() - truth) < sigmas * error, (values.mean(), truth, error)


@pytest.mark.parametrize(("ratio", "density"), [(True, 0.3), (True, 1.5), (True, 4.0), (False, 0.3), (False, 1.5)])
def test_single_tracked_runs_have_the_right_mean_and_variance(density, ratio):
    """Var = e^-2tau (e^V - 1) with V the integral of mu^2 / majorant (ratio), T (1 - T) (track length)."""
    problem = repeated(ball(density), ([-2, 0, 0], [1, 0, 0]), everything=True)
    out, work = track(problem.medium, problem.rays, problem.rows, Stream(3).key, ratio=ratio, enough=0, most=1)
    values, depth = out[:, 0].numpy(), 4.0 / 3.0 * density
    within(values, np.exp(-depth))
    spread = np.exp(-2.0 * depth) * np.expm1(density * 16.0 / 15.0) if ratio else np.exp(-depth) * -np.expm1(-depth)
    assert values.var() == pytest.approx(spread, rel=0.2)
    assert set(work[:, 0].tolist()) == {1}
    if ratio:  # no run ends early: collisions are Poisson with the majorant's depth
        within(work[:, 1].double().numpy(), 2.0 * density)


def test_marching_without_bias():
    """A short march through a dense cloud, where the series matters: plain exp(-mean) is off by far more."""
    problem = repeated(ball(4.0), ([-2, 0.2, 0], [1, 0, 0]))
    truth = np.exp(-4.0 * 4.0 / 3.0 * (1.0 - 0.04) ** 1.5)
    marched = march(problem, 3, Stream(0))
    within(marched.value.numpy(), truth)
    shift = Stream(0, name="plain").uniform(problem.rows[:, None], torch.arange(1))
    plain = torch.exp(-problem.evaluate(((torch.arange(2) + shift) / 2)[..., None]).value[..., 0, 0].mean(dim=1))
    assert abs(plain.mean() - truth) > 10.0 * plain.std() / np.sqrt(RUNS)
    assert marched.queries / RUNS == pytest.approx(2.0 * 1.32, rel=0.05)


def test_the_series_is_exact_for_equal_depths_and_for_one():
    depths = torch.full((1, 5), 1.7, dtype=torch.float64)
    assert _series(depths).item() == pytest.approx(np.exp(-1.7), rel=1e-14)
    assert _series(depths[:, :1]).item() == pytest.approx(np.exp(-1.7), rel=1e-14)
    # two depths: e^-a (1 + (a - b)/0.1) and the same with a and b exchanged
    a, b = 1.0, 1.3
    expected = 0.5 * (np.exp(-a) * (1 + (a - b) / 0.1) + np.exp(-b) * (1 + (b - a) / 0.1))
    assert _series(torch.tensor([[a, b]], dtype=torch.float64)).item() == pytest.approx(expected, rel=1e-13)


def test_unbiased_estimators_agree_on_a_cloud():
    cloud = render.Spheres([[3, 5, 5], [6, 5, 4]], [1.5, 2.0], [0] * 3, [10] * 3, noise=NOISE)
    problem = repeated(cloud, ([-1.0, 4.5, 4.5], [1, 0.02, 0.01]))
    truth = reference(problem.take(slice(0, 1)), runs=200_000)
    fine = problem.take(slice(0, 1)).reference()[0, 0]
    assert abs(truth[0][0] - fine) < 4.0 * truth[1][0] + 1e-4
    for ratio in (True, False):
        out, _ = track(problem.medium, problem.rays, problem.rows, Stream(5).key, ratio=ratio, enough=0, most=1)
        within(out[:, 0].numpy(), fine)
    within(march(problem, 12, Stream(1)).value.numpy(), fine)
    within(optical_depth(problem, n=16), -np.log(fine), sigmas=5.0)


def test_the_jackknife_removes_most_of_the_bias():
    """Against exp(-mean) of the same samples, on a coarse march."""
    problem = repeated(ball(4.0), ([-2, 0.2, 0], [1, 0, 0]))
    truth = np.exp(-4.0 * 4.0 / 3.0 * (1.0 - 0.04) ** 1.5)
    samples = JitterPair().draw(problem, 4, Stream(0))
    combination = Jackknife().combine(samples)
    inner = combination.estimate(samples)
    plain = torch.exp(-inner).mean().item() - truth
    corrected = combination.link(inner).mean().item() - truth
    assert abs(corrected) < 0.3 * abs(plain)
    one, two = samples.value[:, :2, 0, 0].mean(dim=1), samples.value[:, 2:, 0, 0].mean(dim=1)
    peters = torch.exp(-(one + two) / 2) * torch.cos((one - two) / 2)
    torch.testing.assert_close(combination.link(inner)[:, 0], peters, rtol=1e-12, atol=1e-15)


def test_trackers_spend_what_the_paper_says():
    """Table 12: until more than 24 queries are spent takes 30 on average (ratio) and 29 (track length)."""
    problem = TransmittanceProblem.family(4, seed=2, resolution=24)
    for ratio, expected in ((True, 30.0), (False, 29.0)):
        _, work = track(problem.medium, problem.rays, problem.rows, Stream(0).key, ratio=ratio, enough=24, most=24)
        queries = work[:, 1].double().numpy()
        assert queries.min() > 24
        assert queries.mean() == pytest.approx(expected, abs=1.0)
