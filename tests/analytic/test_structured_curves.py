"""Rules that rebuild a curve from point queries: exact where the pieces are polynomials, honest where they doubt."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad

import nqr_geom as ng
from nqr_geom.curves import hermite
from nqr_geom.curves.problems import GwnProblem, SdProblem
from nqr_geom.curves.structured import CurveRefine, GwnHermite
from nqr_geom.integrator.problem import Samples
from nqr_geom.streams import Stream

RANDOM = np.random.default_rng(5)


def grid(resolution: int, half: float = 1.0) -> np.ndarray:
    line = (np.arange(resolution) + 0.5) * (2.0 * half / resolution) - half
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def black_box(curve: ng.Curve):
    """The same curve with nothing but its points left."""
    return ng.Curve.from_callable(curve.sample, pieces=curve.n_pieces)


def lissajous(s: np.ndarray) -> np.ndarray:
    return 0.8 * np.stack([np.sin(6.0 * np.pi * s + 0.5), np.sin(8.0 * np.pi * s)], axis=-1)


@pytest.mark.parametrize(("alpha", "least"), [(0.5, 1e-12), (35.0, 1e-9), (4000.0, 1e-5)])
def test_smoothed_distances_of_quadratics_with_cusps(alpha: float, least: float) -> None:
    """Any three points make a quadratic, most of them with a sharp turn where the speed all but vanishes."""
    p = np.random.default_rng(0).uniform(-1, 1, (6, 3, 2))
    curve = ng.Curve.bezier(np.stack([p[:, 0], (p[:, 0] + 2 * p[:, 1]) / 3, (p[:, 2] + 2 * p[:, 1]) / 3, p[:, 2]], 1))
    points = grid(20, 1.2)
    found = ng.sd(curve, points, alpha=alpha, method="structured", n=32)
    assert alpha * np.abs(found - ng.sd(curve, points, alpha=alpha)).max() < least  # of the integral, relative


def test_black_box_quadratics_are_exact_and_failures_are_flagged() -> None:
    points = grid(32)
    wrong, total = 0, 0
    for curve in ng.datasets.curves(12, seed=3):
        far = ng.distance(curve, points) > 1e-3
        estimate = ng.gwn(black_box(curve), points, method="structured", n=32, full_output=True)
        miss = (np.abs(estimate.value[:, 0] - ng.gwn(curve, points)) > 1e-10) & far
        assert not (miss & ~estimate.fallback).any()
        wrong, total = wrong + int(miss.sum()), total + int(far.sum())
    assert wrong <= 1e-3 * total


def test_random_samples_are_exact_wherever_no_piece_is_missing() -> None:
    problem = GwnProblem.family(6, seed=1, resolution=24)
    estimate = ng.integrate(problem, n=32, sampler="random", rule="gwn-hermite", seed=2)
    error = np.abs(estimate.value - problem.reference())[:, 0]
    assert 0.02 < estimate.fallback.mean() < 0.3
    assert error[~estimate.fallback].max() < 1e-7
    assert error.max() > 1e-2  # a piece unseen is a guess, and shows


def test_smooth_black_boxes_beat_monte_carlo_and_the_same_rule_without_refinement() -> None:
    curve = ng.Curve.from_callable(lissajous)
    polygon = ng.Curve.polyline(lissajous(np.arange(200_000) / 200_000), closed=True)
    points = grid(48)
    points = points[ng.distance(polygon, points) > 1e-3]
    truth = ng.gwn(polygon, points)

    def mse(method: str, n: int, seed: int = 0) -> float:
        return float(np.mean((ng.gwn(curve, points, method=method, n=n, seed=seed) - truth) ** 2))

    assert np.mean([mse("mc", 32, k) for k in range(8)]) > 300.0 * mse("structured", 32)
    assert mse("stratified+gwn-hermite", 24) > 5.0 * mse("structured", 24)


def test_sampler_asks_ends_and_middles_first() -> None:
    samples = CurveRefine().draw(GwnProblem.of(ng.Curve.from_callable(lissajous), [[0.1, 0.2]]), 9, Stream(0))
    first = samples.x[0, :3, 0].tolist()
    assert first[0] == 0.0
    assert first[1] == pytest.approx(1.0, abs=1e-9)
    assert 0.4 <= first[2] <= 0.6
    assert samples.pdf is None
    assert samples.seen.queries == 9 * 6  # a tangent costs five more points


def test_few_samples_fall_back_to_jittered_points() -> None:
    problem = GwnProblem.family(2, resolution=4)
    estimate = ng.integrate(problem, n=5, method="structured")
    assert np.isfinite(estimate.value).all()
    assert estimate.fallback.all()


def test_shapes_with_different_numbers_of_pieces_share_a_batch() -> None:
    small = ng.Curve.polyline([[0, 0], [1, 0], [0, 1]], closed=True)
    large = ng.Curve.polyline(RANDOM.uniform(-1, 1, (9, 2)), closed=True)
    points = grid(8) + 0.01
    both = ng.integrate(GwnProblem.of([small, large], points), n=32, method="structured").value[:, 0]
    alone = [ng.gwn(curve, points) for curve in (small, large)]
    np.testing.assert_allclose(both, np.concatenate(alone), atol=1e-9)


@pytest.mark.parametrize("alpha", [1.0, 35.0, 1e3, 1e6])
def test_smoothed_distance_of_quadratics(alpha: float) -> None:
    curve = ng.Curve.bezier([[[-1.0, 0.0], [0.0, 1.2], [1.0, 0.0]], [[0.2, -0.4], [0.9, -1.0], [1.0, 0.9]]])
    points = grid(12)
    estimate = ng.sd(black_box(curve), points, alpha=alpha, method="structured", n=24)
    np.testing.assert_allclose(estimate, ng.sd(curve, points, alpha=alpha), atol=1e-6)


@pytest.mark.parametrize("alpha", [35.0, 200.0, 1e3, 4e3])
def test_sharp_distances_between_nearest_points_are_exact(alpha: float) -> None:
    """Where several parts of a curve are nearest, each is a peak exp(-c s^2) inside a panel, not at its end."""
    square = ng.Curve.polyline([[-1.0, -0.5], [1.0, -0.5], [1.0, 0.5], [-1.0, 0.5]], closed=True)
    points = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.49], [0.1, 2.0], [0.7, -0.2]])
    estimate = ng.sd(square, points, alpha=alpha, method="structured", n=32)
    assert alpha * np.abs(estimate - ng.sd(square, points, alpha=alpha)).max() < 1e-12


def test_log_integral_against_adaptive_quadrature() -> None:
    control = torch.tensor([[[0.3, -1.0], [0.1, 0.2], [-0.2, 0.1], [0.4, 1.0]]], dtype=torch.float64)
    segments = hermite.Segments(control, torch.tensor([0]), torch.zeros(1), torch.tensor([False]))
    zero = torch.zeros(1, dtype=torch.float64)

    def integrand(t: float) -> float:
        p = control[0].numpy()
        u = 1.0 - t
        x = u**3 * p[0] + 3 * t * u**2 * p[1] + 3 * t**2 * u * p[2] + t**3 * p[3]
        v = 3 * (u**2 * (p[1] - p[0]) + 2 * t * u * (p[2] - p[1]) + t**2 * (p[3] - p[2]))
        return math.exp(-20.0 * math.hypot(*x)) * math.hypot(*v)

    expected, _ = quad(integrand, 0.0, 1.0, points=[0.3, 0.5, 0.7], epsabs=1e-14, epsrel=1e-12, limit=200)
    exponent, total = hermite.log_integral(segments, zero + 20.0, zero)
    assert (total * exponent.exp()).item() == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
def test_sharp_distances_of_large_shapes_stay_cheap(size: float) -> None:
    """alpha times the size is what counts: 3.5e9 of them must not mean as many panels."""
    curve = ng.Curve.bezier(
        size * np.array([[[-1.0, 0.0], [0.0, 1.2], [1.0, 0.0]], [[0.2, -0.4], [0.9, -1.0], [1.0, 0.9]]])
    )
    points = size * grid(6)
    estimate = ng.sd(curve, points, alpha=35.0, method="structured", n=24, full_output=True)
    np.testing.assert_allclose(estimate.value[:, 0], ng.sd(curve, points), atol=1e-7, rtol=1e-12)
    assert estimate.seconds < 20.0


def test_errors_name_what_is_missing() -> None:
    toy = ng.problems.toy(2)
    with pytest.raises(ValueError, match=r"sampler: 'curve-refine' needs a problem on curves"):
        ng.integrate(toy, sampler="curve-refine")
    with pytest.raises(ValueError, match=r"rule: 'gwn-hermite' needs the feature 'relative'"):
        ng.integrate(toy, rule="gwn-hermite")
    with pytest.raises(ValueError, match=r"rule: 'sd-hermite' needs the feature 'alpha'"):
        ng.integrate(GwnProblem.family(1, resolution=4), rule="sd-hermite")


@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_sizes_that_squares_cannot_hold_are_refused(size: float) -> None:
    square = ng.Curve.polyline(size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), closed=True)
    with pytest.raises(ValueError, match="curve: expected coordinates between"):
        ng.gwn(square, [[0.5, 0.5]], method="mc")
    with pytest.raises(ValueError, match="points: expected coordinates between"):
        ng.sd(ng.Curve.polyline([[0, 0], [1, 0]]), [[size, size]], method="mc")


def test_mean_of_sd_values_never_overflows() -> None:
    curve = ng.Curve.polyline([[-1.0, 0.0], [1.0, 0.0]])
    for alpha in (1e-3, 1.0, 1e6):
        for method in ("mc", "stratified", "trapezoid", "structured", "random+regression-3"):
            value = ng.integrate(SdProblem.of(curve, [[0.0, 1e-9], [0.0, 1e6], [3.0, 0.0]], alpha), method=method).value
            assert np.isfinite(value).all(), (alpha, method)


@pytest.mark.parametrize("places", [[0.1, 0.9], [0.2, 0.3, 0.75], [0.45]])
def test_a_sample_alone_on_a_straight_piece_is_followed_along_its_tangent(places):
    """Whatever lies on the next piece: a segment is known from any one of its points."""
    curve = ng.Curve.polyline([[1.0, -0.5], [0.4, 0.8], [-1.0, 0.3]])
    points = np.random.default_rng(8).uniform(-1, 1, (50, 2))
    problem = GwnProblem.of(curve, points)
    x = torch.tensor(places, dtype=torch.float64).expand(50, -1)[..., None]
    samples = Samples(x, problem.evaluate(x), None, "placed")
    combination = GwnHermite().combine(samples)
    seen = curve if max(places) > 0.5 else ng.Curve.polyline([[1.0, -0.5], [0.4, 0.8]])
    np.testing.assert_allclose(combination.estimate(samples)[:, 0], ng.gwn(seen, points), atol=1e-12)
    assert combination.fallback.all()  # fewer than two samples on a piece
