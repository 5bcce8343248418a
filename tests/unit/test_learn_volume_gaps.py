"""Gaps along rays: what they show, what they are worth, and the sampler that begins with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom.integrator.learn.snet import LearnedSampler, SNet
from nqr_geom.integrator.problem import Observation, Samples
from nqr_geom.recipes import JOINT
from nqr_geom.render.clamped import ClampedNoise, between, in_order, over_nodes
from nqr_geom.render.gaps import VolumeGaps
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.training import transmittance_batch
from nqr_geom.streams import Stream

ROWS = torch.arange(300)


def rays(split: str = "validation") -> TransmittanceProblem:
    problem = transmittance_batch(ROWS, 4, split).problem
    assert isinstance(problem, TransmittanceProblem)
    return problem


def cut_at(problem: TransmittanceProblem, x: torch.Tensor) -> tuple[VolumeGaps, Samples]:
    """Gaps after samples at x (B, N), and the samples."""
    gaps, seen = VolumeGaps(problem, x.shape[1]), []
    for k in range(x.shape[1]):
        seen.append(problem.evaluate(x[:, k, None, None]))
        gaps.cut(gaps.containing(x[:, k]), x[:, k], seen[-1])
    return gaps, Samples(x[..., None], Observation.join(seen), None, "test")


def test_gaps_show_what_the_structured_rule_makes_of_them() -> None:
    problem = rays("train")
    x = Stream(1, "validation").uniform(ROWS[:, None], torch.arange(9))
    gaps, samples = cut_at(problem, x)
    ordered, features = in_order(samples, "test")
    expected = between(ordered, features, 4)
    where = gaps.left[:, : gaps.used].masked_fill(~gaps.open[:, : gaps.used], 2.0).argsort(dim=1)[:, :10]
    shown = gaps.features[:, : gaps.used].double().gather(1, where[..., None].expand(-1, -1, gaps.size))
    np.testing.assert_allclose((gaps.right - gaps.left).gather(1, where), expected.width, atol=1e-15)
    np.testing.assert_allclose(shown[..., 4:6].mean(dim=-1), over_nodes(expected.mean), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(shown[..., 6], over_nodes(expected.variance).sqrt(), rtol=1e-5, atol=1e-6)
    assert gaps.features.isfinite().all()


def test_the_worth_is_in_the_density_that_is_in_doubt() -> None:
    """One dark cloud and nothing else: what is in doubt lies where cloud and noise can reach."""
    noise = ng.render.Noise(amplitude=0.5)
    ball = ng.render.Spheres([[2.0, 5.0, 5.0]], [1.0], [0.0] * 3, [10.0] * 3, noise=noise)
    problem = TransmittanceProblem.of(ball, [[0.0, 5.0, 5.0]], [[1.0, 0.0, 0.0]], 10.0)
    gaps, _ = cut_at(problem, torch.tensor([[0.05, 0.1, 0.2, 0.4, 0.7, 0.85]], dtype=torch.float64))
    open_ = gaps.open[0, : gaps.used]
    error = gaps.worth()[0].exp()[open_]
    worst = gaps.left[0, : gaps.used][open_][error.argsort(descending=True)[:2]]
    assert sorted(worst.tolist()) == [0.1, 0.2]  # the gaps that meet in its middle, though others are wider


def test_the_untrained_sampler_is_a_good_one_already() -> None:
    problem = transmittance_batch(ROWS, 4, "validation")
    net = SNet(JOINT["transmittance-nqr"].sampler, VolumeGaps).eval()
    samples = LearnedSampler(net, "transmittance").draw(problem.problem, 24, Stream(2, "validation"))
    error = torch.exp(-ClampedNoise().combine(samples).estimate(samples)) - problem.answer
    plain = ng.integrate(problem.problem, 24, sampler="uniform-jitter", rule="mc").value - problem.answer.numpy()
    assert error.square().mean() < np.mean(plain**2) / 6.0
    # Densities are those of the points: their inverse integrates a constant.
    assert samples.pdf is not None
    assert abs(float((1.0 / samples.pdf[:, 0]).mean()) - 1.0) < 0.15


def test_other_problems_are_refused() -> None:
    with pytest.raises(ValueError, match="sampler: expected a transmittance, got 'toy'"):
        VolumeGaps(ng.problems.toy(2), 4)


def test_gaps_stay_finite_where_there_is_nothing() -> None:
    problem = rays()
    nothing = replace(problem, rays=replace(problem.rays, total=torch.zeros_like(problem.rays.total)))
    x = Stream(1, "validation").uniform(ROWS[:, None], torch.arange(5))
    gaps, _ = cut_at(nothing, x)
    assert gaps.features.isfinite().all()
    assert gaps.worth().isfinite().all()
