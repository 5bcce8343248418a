"""Smoothed distances against closed forms, adaptive quadrature of another library, and the laws they obey."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import k1

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.distance import distance
from nqr_geom.curves.smooth import sd, sd_gradient

QUERIES = np.random.default_rng(5).uniform(-0.3, 1.3, (40, 2))


def random_curve(seed, degree, pieces=6):
    return Curve.bezier(np.random.default_rng(seed).random((pieces, degree + 1, 2)))


def by_quadpack(curve, point, alpha):
    """One adaptive integral a piece, told where the piece is nearest to the point."""
    shift, total = distance(curve, [point])[0], 0.0
    for piece in range(len(curve)):

        def integrand(t, piece=piece):
            s = (piece + np.clip(t, 0, 1)) / len(curve)
            x = curve.sample([s], piece=[piece])[0]
            speed = np.hypot(*curve.derivative([s], piece=[piece])[0]) / len(curve)
            return speed * np.exp(-alpha * (np.hypot(*(x - point)) - shift))

        grid = np.linspace(0, 1, 65)
        nearest = grid[np.argmax([integrand(t) for t in grid])]
        breaks = np.unique(np.clip([0.0, nearest - 0.02, nearest, nearest + 0.02, 1.0], 0, 1))
        for low, high in pairwise(breaks):
            total += quad(integrand, low, high, epsabs=1e-13, epsrel=1e-12, limit=200)[0]
    return shift - np.log(total) / alpha


@pytest.mark.parametrize("alpha", [0.5, 35.0, 400.0])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_agrees_with_quadpack(degree, alpha):
    curve = random_curve(degree, degree, pieces=2)
    expected = [by_quadpack(curve, p, alpha) for p in QUERIES[:6]]
    np.testing.assert_allclose(sd(curve, QUERIES[:6], alpha), expected, rtol=0, atol=2e-11)


@pytest.mark.parametrize("alpha", [1e-3, 1.0, 35.0, 1e4, 1e6])
def test_circle_from_its_centre(alpha):
    n, radius = 1000, 2.0
    angle = np.linspace(0, 2 * np.pi, n + 1)
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    arm = 4 / 3 * np.tan(np.pi / n / 2) * np.stack([-ring[:, 1], ring[:, 0]], axis=1)
    circle = Curve.bezier(np.stack([ring[:-1], ring[:-1] + arm[:-1], ring[1:] - arm[1:], ring[1:]], axis=1))
    expected = radius - np.log(2 * np.pi * radius) / alpha
    np.testing.assert_allclose(sd(circle, [(0, 0)], alpha), expected, rtol=1e-13, atol=1e-12)
    np.testing.assert_allclose(sd_gradient(circle, [(0, 0)], alpha), 0, atol=1e-9)


@pytest.mark.parametrize("alpha", [0.1, 35.0, 1e3])
@pytest.mark.parametrize("d", [1e-9, 1e-3, 0.2, 10.0])
def test_long_line(alpha, d):
    half = max(800.0 / alpha, 80.0 * np.sqrt(d / alpha), d)
    line = Curve.polyline([(-half, 0), (half, 0)])
    if alpha * d < 500:  # beyond that K1 underflows
        expected = -np.log(2 * d * k1(alpha * d)) / alpha
        np.testing.assert_allclose(sd(line, [(0.3, d)], alpha), expected, rtol=1e-13, atol=1e-12)
        np.testing.assert_allclose(sd(line, [(0.3, -d)], alpha), expected, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("alpha", [1e-2, 1.0, 35.0, 1e5])
def test_along_its_own_line_a_segment_is_closed_form(alpha):
    d, length = np.array([0.0, 1e-9, 1.0, 1e6]), 3.0
    points = np.stack([-d, 0 * d], axis=1)
    expected = d - np.log(-np.expm1(-alpha * length) / alpha) / alpha
    np.testing.assert_allclose(sd(Curve.polyline([(0, 0), (3, 0)]), points, alpha), expected, rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("alpha", [0.1, 35.0, 1e4])
def test_curves_agree_with_fine_chords(degree, alpha):
    curve = random_curve(9, degree, pieces=3)
    chords = curve.to_polyline(1e-9)
    np.testing.assert_allclose(sd(curve, QUERIES, alpha), sd(chords, QUERIES, alpha), rtol=0, atol=1e-7 + 1e-7 / alpha)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000), degree=st.integers(1, 3), angle=st.floats(0, 6.28), shift=st.floats(-100, 100),
    power=st.integers(-40, 40), alpha=st.floats(1e-3, 1e4),
)  # fmt: skip
@example(seed=26, degree=3, angle=1.0, shift=0.0, power=0, alpha=1.0)  # the speed all but vanishes
def test_motion_and_the_scale_law(seed, degree, angle, shift, power, alpha):
    curve, s = random_curve(seed, degree), 2.0**power
    matrix = s * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = curve.transformed(matrix, (shift * s, -shift * s))
    points = QUERIES[:20] @ matrix.T + np.array([shift, -shift]) * s
    expected = s * sd(curve, QUERIES[:20], alpha) - s * np.log(s) / alpha
    np.testing.assert_allclose(sd(moved, points, alpha / s), expected, rtol=1e-12, atol=s * (1e-12 + 1e-11 / alpha))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), degree=st.integers(1, 3), size=st.integers(1, 5), alpha=st.floats(0.1, 300))
def test_parts_add_in_the_exponential_and_reversal_changes_nothing(seed, degree, size, alpha):
    curve = random_curve(seed, degree)
    whole = sd(curve, QUERIES, alpha)
    parts = np.array([sd(part, QUERIES, alpha) for part in curve.split_pieces(size)])
    summed = -np.log(np.exp(-alpha * (parts - whole)).sum(axis=0)) / alpha
    np.testing.assert_allclose(summed, 0, atol=1e-12 + 1e-12 / alpha)
    np.testing.assert_allclose(sd(curve.reversed(), QUERIES, alpha), whole, rtol=0, atol=1e-12 + 1e-12 / alpha)


@pytest.mark.parametrize("alpha", [1e-3, 1.0, 35.0, 1e3, 1e6])
def test_bounds(alpha):
    curve = random_curve(2, 3)
    value, nearest = sd(curve, QUERIES, alpha), distance(curve, QUERIES)
    farthest = np.hypot(*(curve.sample(np.linspace(0, 1, 2001))[:, None] - QUERIES).transpose(2, 0, 1)).max(axis=0)
    offset, slack = np.log(curve.length) / alpha, 1e-9 + 1e-11 / alpha
    assert (value >= nearest - offset - slack).all()
    assert (value <= farthest - offset + slack).all()


@pytest.mark.parametrize("alpha", [1.0, 35.0, 1e3])
@pytest.mark.parametrize("degree", [1, 3])
def test_the_gradient_is_the_derivative(degree, alpha):
    curve, h = random_curve(11, degree), 1e-6
    slope = np.stack(
        [(sd(curve, QUERIES + h * e, alpha) - sd(curve, QUERIES - h * e, alpha)) / (2 * h) for e in np.eye(2)], axis=1
    )
    np.testing.assert_allclose(sd_gradient(curve, QUERIES, alpha), slope, rtol=0, atol=1e-7 * max(alpha, 10))


def test_the_gradient_on_the_curve_is_the_mean_of_both_sides():
    curve = random_curve(6, 3, pieces=1)
    s = np.array([0.1, 0.37, 0.8])
    tangent = curve.derivative(s)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.hypot(*tangent.T)[:, None]
    on = sd_gradient(curve, curve.sample(s))
    sides = [sd_gradient(curve, curve.sample(s) + h * normal) for h in (1e-9, -1e-9)]
    np.testing.assert_allclose(on, np.mean(sides, axis=0), rtol=0, atol=1e-8)
    np.testing.assert_allclose(sides[0], sides[1], rtol=0, atol=1e-5)


def test_many_queries_in_threads_equal_the_same_ones_alone():
    curve, points = random_curve(4, 3, pieces=20), np.random.default_rng(9).random((2500, 2))
    alone = np.concatenate([sd(curve, part) for part in np.array_split(points, 20)])
    np.testing.assert_array_equal(sd(curve, points), alone)


@pytest.mark.parametrize("alpha", [1e-6, 1.0, 35.0])
@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-6, 1e-3])
def test_a_cusp_and_near_cusps_whichever_way_they_are_turned(alpha, gap):
    control = np.array([[[0, 0], [1 + gap, 1], [-gap, 1], [1, 0]]])
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s], [s, c]])
    curve = Curve.bezier(control)
    halves = [Curve.bezier([_split(control[0], 0.5, side)]) for side in (0, 1)]
    parts = np.array([sd(half, QUERIES, alpha) for half in halves])
    expected = parts[0] - np.log1p(np.exp(-alpha * (parts[1] - parts[0]))) / alpha
    slack = 1e-12 + 1e-12 / alpha
    np.testing.assert_allclose(sd(curve, QUERIES, alpha), expected, rtol=0, atol=slack)
    np.testing.assert_allclose(sd(curve.transformed(turn), QUERIES @ turn.T, alpha), expected, rtol=0, atol=slack)


def _split(control, t, side):
    """Control points of one part of a piece, by de Casteljau."""
    layers = [control]
    while len(layers[-1]) > 1:
        layers.append((1 - t) * layers[-1][:-1] + t * layers[-1][1:])
    return np.array([layer[0] for layer in layers] if side == 0 else [layer[-1] for layer in layers[::-1]])


@pytest.mark.parametrize("alpha", [0.01, 1.0, 35.0, 1e3])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_cutting_the_pieces_changes_nothing(degree, alpha):
    """Other panels, the same integral: what a rule that stops too early cannot give."""
    for seed in range(8):
        whole = random_curve(seed, degree, pieces=2)
        cut = Curve.bezier(
            [
                _split(_split(c, 3 / 7, a), 0.3, b)
                for c in whole.control[:, : degree + 1]
                for a in (0, 1)
                for b in (0, 1)
            ]
        )
        np.testing.assert_allclose(sd(cut, QUERIES, alpha), sd(whole, QUERIES, alpha), rtol=1e-14, atol=3e-14 / alpha)
        np.testing.assert_allclose(
            sd_gradient(cut, QUERIES, alpha), sd_gradient(whole, QUERIES, alpha), rtol=0, atol=1e-12
        )
