"""Winding numbers against closed forms, libigl and flattening, and the laws they obey."""

from __future__ import annotations

from fractions import Fraction

import igl
import igl.predicates
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.tree import tree_of
from nqr_geom.curves.winding import _orientation, gwn, gwn_gradient

QUERIES = np.random.default_rng(5).uniform(-0.3, 1.3, (300, 2))


def random_curve(seed, degree=2, pieces=6):
    """Six random pieces, 0-1 and 2-3 joined, as in Fig. 38."""
    control = np.random.default_rng(seed).random((pieces, degree + 1, 2))
    control[1, 0], control[3, 0] = control[0, -1], control[2, -1]
    return Curve.bezier(control)


def star(n, seed=0):
    angle = 2 * np.pi * np.arange(n) / n
    radius = 0.8 + 0.15 * np.sin(7 * angle) + 0.05 * np.random.default_rng(seed).random(n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def spiral(n, turns=12):
    s = np.linspace(0, 1, n // 2)
    arm = (0.1 + 0.8 * s)[:, None] * np.stack([np.cos(2 * np.pi * turns * s), np.sin(2 * np.pi * turns * s)], axis=1)
    return np.concatenate([arm, 1.02 * arm[::-1]])


def zigzag(n):
    x = np.linspace(-1, 1, n)
    return np.concatenate([np.stack([x, np.where(np.arange(n) % 2, 0.9, -0.9)], axis=1), [[1, -1], [-1, -1]]])


@pytest.mark.parametrize(
    "vertices", [star(100), star(3000), spiral(2000), zigzag(999)], ids=["100", "3k", "spiral", "zigzag"]
)
@pytest.mark.parametrize("closed", [True, False])
def test_polylines_agree_with_libigl(vertices, closed):
    points = np.random.default_rng(1).uniform(-1.1, 1.1, (500, 2))
    n = len(vertices)
    edges = np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1)[: n if closed else n - 1]
    expected = igl.winding_number(vertices, edges, points)
    np.testing.assert_allclose(gwn(Curve.polyline(vertices, closed), points), expected, rtol=0, atol=1e-12)


def test_a_soup_of_open_segments_agrees_with_libigl():
    ends = np.random.default_rng(2).random((1500, 2, 2))
    points = np.random.default_rng(3).random((300, 2))
    edges = np.arange(3000).reshape(-1, 2)
    expected = igl.winding_number(ends.reshape(-1, 2), edges, points)
    np.testing.assert_allclose(gwn(Curve.bezier(ends), points), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_cubics_agree_with_libigl(seed):
    curve = random_curve(seed, degree=3)
    expected = [sum(igl.predicates.cubic_winding_number(c, q) for c in curve.control) for q in QUERIES]
    np.testing.assert_allclose(gwn(curve, QUERIES), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_curved_pieces_agree_with_4096_chords(seed, degree):
    curve = random_curve(seed, degree)
    n = 4096
    t = np.arange(n + 1) / n
    points = curve.sample((np.arange(6)[:, None] + t) / 6, piece=np.broadcast_to(np.arange(6)[:, None], (6, n + 1)))
    edges = (np.arange(6)[:, None] * (n + 1) + np.arange(n)).ravel()
    expected = igl.winding_number(points.reshape(-1, 2), np.stack([edges, edges + 1], axis=1), QUERIES)
    np.testing.assert_allclose(gwn(curve, QUERIES), expected, rtol=0, atol=1e-9)


def test_half_circle_flattened_finely():
    angle = np.linspace(0, np.pi, 20001)
    curve = Curve.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    third = np.arctan(0.5) / np.pi
    np.testing.assert_allclose(gwn(curve, [(0, 0), (0, 0.5), (0, -0.5)]), [0.5, 0.5 + third, 0.5 - third], atol=1e-12)


@pytest.mark.parametrize("degree", [2, 3])
def test_on_a_smooth_curve_the_value_lies_between_its_sides(degree):
    curve = random_curve(8, degree)
    s = np.random.default_rng(4).random(200)
    tangent = curve.derivative(s)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.hypot(*tangent.T)[:, None]
    left, on, right = (gwn(curve, curve.sample(s) + h * normal) for h in (1e-9, 0.0, -1e-9))
    np.testing.assert_allclose(left - right, 1.0, atol=1e-6)
    assert (np.minimum(np.minimum(np.abs(on - left), np.abs(on - right)), np.abs(on - (left + right) / 2)) < 1e-6).all()


def test_turning_points_of_a_curve_are_on_it():
    arch = Curve.bezier([[[0, 0], [1, 2], [2, 0]]])
    mean = 0.5 * gwn(arch, [(1, 1 + 1e-12), (1, 1 - 1e-12)]).sum()
    np.testing.assert_allclose(gwn(arch, [(1, 1)]), mean, atol=1e-11)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000), degree=st.integers(1, 3), angle=st.floats(0, 6.28), shift=st.floats(-100, 100),
    power=st.integers(-40, 40),
)  # fmt: skip
def test_motion_and_scale_change_nothing(seed, degree, angle, shift, power):
    curve = random_curve(seed, degree)
    matrix = 2.0**power * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = curve.transformed(matrix, (shift * 2.0**power, -shift * 2.0**power))
    points = QUERIES[:50] @ matrix.T + np.array([shift, -shift]) * 2.0**power
    np.testing.assert_allclose(gwn(moved, points), gwn(curve, QUERIES[:50]), rtol=0, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), degree=st.integers(1, 3), size=st.integers(1, 5))
def test_reversal_negates_and_parts_sum(seed, degree, size):
    curve = random_curve(seed, degree)
    whole = gwn(curve, QUERIES[:50])
    np.testing.assert_allclose(gwn(curve.reversed(), QUERIES[:50]), -whole, rtol=0, atol=1e-14)
    parts = sum(gwn(part, QUERIES[:50]) for part in curve.split_pieces(size))
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), row=st.integers(0, 5))
def test_degree_elevation_changes_nothing(seed, row):
    quadratic = random_curve(seed, 2)
    a, b, c = (quadratic.control[:, i] for i in range(3))
    elevated = Curve.bezier(np.stack([a, (a + 2 * b) / 3, (2 * b + c) / 3, c], axis=1))
    near = quadratic.control[row, 0] + 1e-7 * np.array([[1, 0], [0, 1], [-1, 0], [0.3, -0.6]])
    np.testing.assert_allclose(gwn(elevated, near), gwn(quadratic, near), rtol=0, atol=1e-9)


def test_the_gradient_is_the_derivative():
    curve = random_curve(11, 3)
    h = 1e-6
    for axis in np.eye(2):
        slope = (gwn(curve, QUERIES + h * axis) - gwn(curve, QUERIES - h * axis)) / (2 * h)
        smooth = np.abs(slope) < 1e3  # a jump between the two has a slope of 1 / 2h
        assert smooth.sum() > 290
        np.testing.assert_allclose((gwn_gradient(curve, QUERIES) @ axis)[smooth], slope[smooth], rtol=1e-6, atol=1e-7)


def test_the_gradient_of_a_closed_curve_is_zero():
    assert not gwn_gradient(Curve.polyline(star(20), closed=True), QUERIES).any()


def test_many_queries_in_threads_equal_the_same_ones_alone():
    curve = Curve.polyline(star(30_000), closed=True)  # large enough for sorted queries as well
    points = np.random.default_rng(9).uniform(-1.1, 1.1, (5000, 2))
    together = gwn(curve, points)
    alone = np.concatenate([gwn(curve, part) for part in np.array_split(points, 50)])
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("pieces", [1, 2, 3, 17, 64])
def test_every_node_holds_its_subtree(pieces):
    control = np.random.default_rng(pieces).random((pieces, 4, 2))
    control[1::3, 0] = control[::3, -1][: len(control[1::3])]
    tree = tree_of(Curve.bezier(control))
    box, skip, arc = tree.nodes
    for node in range(len(skip)):
        inside = slice(node, skip[node])
        assert (box[inside, :2] >= box[node, :2]).all()
        assert (box[inside, 2:4] <= box[node, 2:4]).all()
    np.testing.assert_array_equal(arc[arc >= 0], np.arange(len(tree.piece)))
    assert skip[0] == len(skip)
    assert set(tree.piece) == set(range(pieces))


def test_orientation_is_exact_where_rounding_decides():
    rng = np.random.default_rng(6)
    ulp = 2.0**-53
    for scale in (1.0, 2.0**-520):
        for _ in range(300):
            a, b, p = (
                scale * (base + ulp * rng.integers(0, 64, 2))
                for base in (np.array([12.0, 12.0]), np.array([24.0, 24.0]), np.array([0.5, 0.5]))
            )
            (ax, ay), (bx, by), (px, py) = (map(Fraction, v.tolist()) for v in (a, b, p))
            exact = (ax - px) * (by - py) - (ay - py) * (bx - px)
            assert _orientation(*a, *b, *p) == np.sign(exact.numerator)


@pytest.mark.parametrize("seed", range(8))
def test_a_handle_drawn_in_leaves_the_direction_to_the_second_derivative(seed):
    a, b, c = np.random.default_rng(seed).random((3, 2))
    first, last = (complex(*v) for v in (b - c, a - c))
    expected = np.angle(first / last) / (2 * np.pi)
    np.testing.assert_allclose(gwn(Curve.bezier([[a, b, c, c]]), [c]), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(gwn(Curve.bezier([[c, c, b, a]]), [c]), -expected, rtol=0, atol=1e-15)
