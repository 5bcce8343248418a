"""Random, degenerate and huge inputs: every public function gives finite numbers or refuses by the argument's name."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import nqr_geom as ng

QUICK = settings(derandomize=True, deadline=None, max_examples=40, database=None)
FEW = settings(QUICK, max_examples=12)
ARGUMENTS = "curve|points|alpha|control|polygon|boundary|source|screening|n|p|tol|epsilon|origins|directions|t_max"
NAMED = re.compile(f"^({ARGUMENTS}): ")

SIZES = st.sampled_from([0.0, 5e-324, 1e-300, 1e-160, 1e-9, 1e-3, 0.5, 1.0, 3.0, 1e6, 1e150, 1e300, 1.7e308])
NUMBERS = st.one_of(
    st.floats(-4.0, 4.0), st.builds(lambda size, sign: sign * size, SIZES, st.sampled_from([-1.0, 1.0]))
)
TAME = st.floats(-4.0, 4.0).map(lambda x: round(x, 3))


def places(number: st.SearchStrategy, least: int, most: int) -> st.SearchStrategy:
    """Arrays (m, 2)."""
    pair = st.tuples(number, number)
    return st.lists(pair, min_size=least, max_size=most).map(lambda rows: np.array(rows, dtype=float).reshape(-1, 2))


def control(number: st.SearchStrategy) -> st.SearchStrategy:
    """Control points (k, degree + 1, 2)."""
    return st.integers(1, 3).flatmap(
        lambda degree: st.integers(1, 4).flatmap(
            lambda k: places(number, k * (degree + 1), k * (degree + 1)).map(lambda rows: rows.reshape(k, -1, 2))
        )
    )


def finite_or_named(call):
    """The finite answer, or None where the call was refused by the name of an argument."""
    try:
        got = call()
    except (ValueError, TypeError) as refused:
        if not NAMED.match(str(refused)):
            raise
        return None
    assert np.isfinite(np.asarray(got)).all()
    return got


EXACT = {
    "gwn": ng.gwn,
    "gwn_gradient": ng.gwn_gradient,
    "distance": ng.distance,
    "signed_distance": ng.signed_distance,
    "distance_gradient": ng.distance_gradient,
    "closest_point": lambda curve, points: ng.closest_point(curve, points).point,
    "sd": ng.sd,
    "sd_gradient": ng.sd_gradient,
}
SAMPLED = ("mc", "stratified", "trapezoid", "structured")


@pytest.mark.parametrize("name", EXACT)
@QUICK
@given(rows=control(NUMBERS), points=places(NUMBERS, 0, 4))
def test_exact_answers_about_any_curve(name, rows, points):
    finite_or_named(lambda: EXACT[name](ng.Curve.bezier(rows), points))


@pytest.mark.parametrize("method", SAMPLED)
@pytest.mark.parametrize("name", ["gwn", "sd"])
@FEW
@given(rows=control(NUMBERS), points=places(NUMBERS, 0, 3), n=st.integers(1, 9), seed=st.integers(-5, 2**70))
def test_sampled_answers_about_any_curve(name, method, rows, points, n, seed):
    ask = lambda: getattr(ng, name)(ng.Curve.bezier(rows), points, method=method, n=n, seed=seed)  # noqa: E731
    first = finite_or_named(ask)
    if first is not None:
        np.testing.assert_array_equal(ask(), first)


@QUICK
@given(rows=control(TAME), points=places(TAME, 1, 5), turn=st.floats(0.0, 6.3), power=st.integers(-60, 60))
def test_motion_scale_and_reversal(rows, points, turn, power):
    curve, s = ng.Curve.bezier(rows), 2.0**power
    matrix = s * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = curve.transformed(matrix)
    near = ng.distance(curve, points)
    np.testing.assert_allclose(ng.distance(moved, points @ matrix.T) / s, near, atol=1e-7)
    np.testing.assert_array_equal(ng.gwn(curve.transformed(s * np.eye(2)), s * points), ng.gwn(curve, points))
    off = near > 1e-6
    np.testing.assert_allclose(ng.gwn(curve.reversed(), points)[off], -ng.gwn(curve, points)[off], atol=1e-9)
    np.testing.assert_allclose(ng.gwn(moved, points @ matrix.T)[off], ng.gwn(curve, points)[off], atol=1e-6)


@QUICK
@given(rows=control(TAME), points=places(TAME, 2, 6))
def test_rows_do_not_know_each_other(rows, points):
    curve = ng.Curve.bezier(rows)
    for ask in (ng.gwn, ng.distance, ng.signed_distance):
        alone = np.concatenate([ask(curve, point[None]) for point in points])
        np.testing.assert_array_equal(ask(curve, points), alone)


@pytest.mark.parametrize("method", ["boundary", "wos", "structured"])
@FEW
@given(polygon=places(NUMBERS, 0, 6), points=places(NUMBERS, 0, 3), seed=st.integers(0, 9))
def test_laplace_on_any_polygon(method, polygon, points, seed):
    values = np.arange(len(polygon), dtype=float)
    solve = lambda: ng.solve_laplace(polygon, values, points, method=method, n=4, seed=seed)  # noqa: E731
    got = finite_or_named(solve)
    if got is not None:
        np.testing.assert_array_equal(solve(), got)


@FEW
@given(polygon=places(NUMBERS, 0, 6), points=places(NUMBERS, 0, 3))
def test_p_laplace_and_gradients_on_any_polygon(polygon, points):
    values = np.arange(len(polygon), dtype=float)
    finite_or_named(lambda: ng.solve_p_laplace(polygon, values, points))
    finite_or_named(lambda: ng.laplace_gradient(polygon, values, points, n=4))


@pytest.mark.parametrize("method", ["stratified", "structured", "ratio"])
@FEW
@given(rows=st.lists(st.tuples(*[NUMBERS] * 6), min_size=0, max_size=3), length=SIZES)
def test_transmittance_along_any_ray(method, rows, length):
    from nqr_geom import render

    rays = np.array(rows, dtype=float).reshape(-1, 6)
    ball = render.Spheres([[0, 0, 0]], [1.0])
    got = finite_or_named(lambda: render.transmittance(ball, rays[:, :3], rays[:, 3:], length, method=method, n=4))
    assert got is None or ((got >= 0.0) & (got <= 1.0)).all()
