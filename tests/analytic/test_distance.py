"""Distances against libigl, dense sampling and the laws they obey."""

from __future__ import annotations

import igl
import igl.cycodebase
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.distance import closest_point, distance, distance_gradient, signed_distance

QUERIES = np.random.default_rng(5).uniform(-0.3, 1.3, (300, 2))


def random_curve(seed, degree, pieces=6):
    return Curve.bezier(np.random.default_rng(seed).random((pieces, degree + 1, 2)))


@pytest.mark.parametrize("seed", range(4))
def test_cubics_agree_with_libigl(seed):
    curve = random_curve(seed, 3)
    corners, pieces = curve.control.reshape(-1, 2), np.arange(24).reshape(6, 4)
    square, piece, t, point = igl.cycodebase.point_spline_squared_distance(QUERIES, corners, pieces)
    found = closest_point(curve, QUERIES)
    np.testing.assert_allclose(found.distance, np.sqrt(square), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(found.piece, piece)
    np.testing.assert_allclose(found.point, point, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.t, t, rtol=0, atol=1e-6)


@pytest.mark.parametrize("n", [3, 40, 3000])
def test_segments_agree_with_libigl(n):
    ends = np.random.default_rng(n).random((n, 2, 2))
    square, piece, point = igl.point_mesh_squared_distance(
        QUERIES, ends.reshape(-1, 2), np.arange(2 * n).reshape(-1, 2)
    )
    found = closest_point(Curve.bezier(ends), QUERIES)
    np.testing.assert_allclose(found.distance, np.sqrt(square), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(found.piece, piece)
    np.testing.assert_allclose(found.point, point, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [2, 3])
def test_no_sample_of_the_curve_is_nearer(degree):
    for seed in range(20):
        curve = random_curve(seed, degree, pieces=2)
        samples = curve.sample(np.linspace(0, 1, 4001))
        nearest = cKDTree(samples).query(QUERIES)[0]
        found = distance(curve, QUERIES)
        assert (found <= nearest + 1e-15).all()
        np.testing.assert_allclose(found, nearest, rtol=0, atol=1e-2)


def test_points_of_the_curve_are_at_distance_zero():
    curve = random_curve(7, 3)
    s = np.random.default_rng(1).random(500)
    found = closest_point(curve, curve.sample(s))
    assert found.distance.max() < 5e-16
    points = curve.sample((found.piece + found.t) / 6, piece=found.piece)
    np.testing.assert_allclose(points, curve.sample(s), rtol=0, atol=1e-15)


@pytest.mark.parametrize("h", [1e-3, 1e-8, 1e-12])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_near_the_curve_the_gradient_is_its_normal(degree, h):
    curve = random_curve(3, degree, pieces=1)
    s = np.random.default_rng(2).random(100)
    tangent = curve.derivative(s)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.hypot(*tangent.T)[:, None]
    queries = curve.sample(s) + h * normal
    single = np.abs(distance(curve, queries) - h) < 1e-2 * h  # no other part of the curve is nearer
    assert single.sum() > 90
    np.testing.assert_allclose(distance_gradient(curve, queries)[single], normal[single], rtol=0, atol=1e-7)


def test_the_gradient_is_the_derivative():
    curve, h = random_curve(11, 3), 1e-6
    slope = np.stack(
        [(distance(curve, QUERIES + h * e) - distance(curve, QUERIES - h * e)) / (2 * h) for e in np.eye(2)], axis=1
    )
    np.testing.assert_allclose(distance_gradient(curve, QUERIES), slope, rtol=0, atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000), degree=st.integers(1, 3), angle=st.floats(0, 6.28), shift=st.floats(-100, 100),
    power=st.integers(-40, 40),
)  # fmt: skip
def test_distance_follows_motion_and_scale(seed, degree, angle, shift, power):
    curve, scale = random_curve(seed, degree), 2.0**power
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = curve.transformed(matrix, (shift * scale, -shift * scale))
    points = QUERIES[:50] @ matrix.T + np.array([shift, -shift]) * scale
    expected = scale * distance(curve, QUERIES[:50])
    np.testing.assert_allclose(distance(moved, points), expected, rtol=0, atol=1e-12 * scale)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), degree=st.integers(1, 3), size=st.integers(1, 5))
def test_the_nearest_part_decides(seed, degree, size):
    curve = random_curve(seed, degree)
    parts = [distance(part, QUERIES[:50]) for part in curve.split_pieces(size)]
    np.testing.assert_array_equal(distance(curve, QUERIES[:50]), np.min(parts, axis=0))


def test_signed_distance_of_a_circle():
    angle = np.linspace(0, 2 * np.pi, 4001)
    circle = Curve.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1)[:-1], closed=True)
    points = 3 * (QUERIES - 0.5)
    expected = np.hypot(*points.T) - 1
    np.testing.assert_allclose(signed_distance(circle, points), expected, rtol=0, atol=1e-6)


def test_many_queries_in_threads_equal_the_same_ones_alone():
    curve = Curve.bezier(np.random.default_rng(0).random((12_000, 1, 2)) + np.zeros((1, 3, 1)))  # a cloud of points
    curve = curve + random_curve(4, 3, pieces=500)
    points = np.random.default_rng(9).random((5000, 2))
    together = closest_point(curve, points)
    alone = [closest_point(curve, part) for part in np.array_split(points, 20)]
    for field, parts in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_array_equal(field, np.concatenate(parts))
