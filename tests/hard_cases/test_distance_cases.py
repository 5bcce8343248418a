"""Distances and smoothed distances that break naive code: name, curve, queries, expected values, tolerance."""

from __future__ import annotations

import numpy as np
import pytest

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.distance import closest_point, distance, distance_gradient, signed_distance
from nqr_geom.curves.smooth import sd, sd_gradient


def polygon(*points):
    return Curve.polyline(points, closed=True)


def scaled(curve, s, shift=0.0):
    return curve.transformed(s * np.eye(2), (shift, shift))


SQUARE = polygon((0, 0), (1, 0), (1, 1), (0, 1))
INNER = polygon((0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75))
SEGMENT = Curve.polyline([(0, 0), (4, 0)])
ARCH = Curve.bezier([[[-1, 1], [0, -1], [1, 1]]])  # the parabola y = x^2
POINT = Curve.polyline([(1, 2)])
LINE_AS_CUBIC = Curve.bezier([[[0, 0], [0, 0], [4, 0], [4, 0]]])
OVERSHOOT = Curve.bezier([[[0, 0], [4, 0], [1, 0]]])  # reaches 16/7
CUSP = Curve.bezier([[[0, 0], [1, 1], [0, 1], [1, 0]]])  # tip at (1/2, 3/4)

DISTANCES = [
    ("segment: beside, beyond, on", SEGMENT, [(1, 2), (7, 4), (-3, -4), (2, 0), (4, 0)], [2, 5, 5, 0, 0], 0),
    ("square: centre, edge, vertex", SQUARE, [(0.5, 0.5), (0.5, 0), (1, 1), (2, 2)], [0.5, 0, 0, np.sqrt(2)], 1e-15),
    ("one point", POINT, [(1, 2), (4, 6)], [0, 5], 0),
    ("all control points equal", Curve.bezier([[[1, 2]] * 4]), [(1, 2), (4, 6)], [0, 5], 0),
    ("a point beside a square", SQUARE + scaled(POINT, 10), [(10, 20), (10, 21), (0.5, 0.75)], [0, 1, 0.25], 0),
    ("parabola: on the axis below, at and above the focal point", ARCH, [(0, -1), (0, 0.25), (0, 0.5), (0, 1)],
     [1, 0.25, 0.5, np.sqrt(0.75)], 1e-12),
    ("parabola: on it", ARCH, [(0, 0), (0.5, 0.25), (-0.25, 0.0625), (1, 1)], [0] * 4, 1e-16),
    ("parabola: nearer than it can be told", ARCH, [(0, -1e-300), (0, 1e-200), (0, -1e-12)], [0, 0, 1e-12], 1e-20),
    ("a line dressed as a cubic, handles drawn in", LINE_AS_CUBIC, [(1, 2), (7, 4), (0, 0), (0, 1e-9), (2, 0)],
     [2, 5, 0, 1e-9, 0], 1e-15),
    ("collinear overshoot", OVERSHOOT, [(16 / 7, 0), (16 / 7 + 1, 0), (2, 1), (-1, 0)], [0, 1, 1, 1], 1e-15),
    ("cusp", CUSP, [(0.5, 0.75), (0.5, 1.75), (0.5, 0.75 + 1e-9)], [0, 1, 1e-9], 1e-16),
    ("shift 1e6", scaled(SQUARE, 1, 1e6), [(1e6 + 0.5, 1e6 + 0.25), (1e6 - 3, 1e6 - 4)], [0.25, 5], 1e-9),
    *((f"scale {s:g}", scaled(SQUARE, s), [(0.5 * s, 0.25 * s), (4 * s, 5 * s), (0.5 * s, 0)], [0.25 * s, 5 * s, 0],
       1e-12 * s) for s in (1e-6, 1e6, 1e-170, 1e160, 1e-300, 1e299)),
    ("absurdly far", SQUARE, [(1e200, 0), (0, -1e300), (3e307, 4e307)], [1e200, 1e300, 5e307], 1e292),
]  # fmt: skip

SIGNED = [
    ("square", SQUARE, "nonzero", [(0.5, 0.25), (2, 0.5), (0.5, 0)], [-0.25, 1, 0]),
    ("clockwise square", SQUARE.reversed(), "nonzero", [(0.5, 0.25), (2, 0.5), (0.5, 0)], [-0.25, 1, 0]),
    ("hole", SQUARE + INNER.reversed(), "nonzero", [(0.5, 0.5), (0.125, 0.5)], [0.25, -0.125]),
    ("doubled inside: nonzero", SQUARE + INNER, "nonzero", [(0.5, 0.5), (0.125, 0.5)], [-0.25, -0.125]),
    ("doubled inside: even-odd", SQUARE + INNER, "even-odd", [(0.5, 0.5), (0.125, 0.5)], [0.25, -0.125]),
    ("open: a U closed by its level set", Curve.polyline([(0, 4), (0, 0), (1, 0), (1, 4)]), "nonzero",
     [(0.5, 1), (0.5, 3.5), (0.5, 5), (0.5, -1)], [-0.5, -0.5, np.hypot(0.5, 1), 1]),
    ("open and reversed", Curve.polyline([(1, 4), (1, 0), (0, 0), (0, 4)]), "even-odd",
     [(0.5, 1), (0.5, -1)], [-0.5, 1]),
]  # fmt: skip


def ids(cases):
    return [case[0] for case in cases]


@pytest.mark.parametrize(("curve", "points", "expected", "tolerance"), [c[1:] for c in DISTANCES], ids=ids(DISTANCES))
def test_distance(curve, points, expected, tolerance):
    np.testing.assert_allclose(distance(curve, points), expected, rtol=0, atol=tolerance)
    found = closest_point(curve, points)
    gap = np.hypot(*(np.array(points, dtype=float) - found.point).T)
    np.testing.assert_allclose(found.distance, gap, rtol=1e-12, atol=max(tolerance, 1e-15 * np.abs(points).max()))
    assert ((found.t >= 0) & (found.t <= 1) & (found.piece >= 0) & (found.piece < len(curve))).all()
    length = np.hypot(*distance_gradient(curve, points).T)
    np.testing.assert_allclose(length, (found.distance > 0) * 1.0, atol=1e-15)


@pytest.mark.parametrize(("curve", "sign", "points", "expected"), [c[1:] for c in SIGNED], ids=ids(SIGNED))
def test_signed_distance(curve, sign, points, expected):
    np.testing.assert_allclose(signed_distance(curve, points, sign), expected, rtol=0, atol=1e-15)


def test_a_distance_beyond_float64_is_refused():
    with pytest.raises(ValueError, match=r"points: expected a distance below 1.8e308"):
        distance(SQUARE, [(0, 0), (1.5e308, 1.5e308)])


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="curve: expected at least one piece"):
        distance(Curve.polyline([]), [(0, 0)])
    with pytest.raises(ValueError, match="sign: expected one of nonzero, even-odd, got 'odd'"):
        signed_distance(SQUARE, [(0, 0)], sign="odd")
    with pytest.raises(ValueError, match="points: expected finite numbers"):
        closest_point(SQUARE, [(0, np.inf)])
    with pytest.raises(ValueError, match="curve: control needs the pieces"):
        distance(Curve.from_callable(lambda s: np.stack([s, s], axis=1)), [(0, 0)])
    assert distance(SQUARE, np.empty((0, 2))).shape == (0,)


SMOOTHED = [
    ("segment from its middle", SEGMENT, 35.0, [(2, 0)], [-np.log(-2 * np.expm1(-70) / 35) / 35], 1e-15),
    ("from its end, any distance", SEGMENT, 35.0, [(-d, 0) for d in (0, 1e-9, 1, 1e6)],
     [d - np.log(-np.expm1(-140) / 35) / 35 for d in (0, 1e-9, 1, 1e6)], 1e-10),
    ("a line dressed as a cubic, handles drawn in", LINE_AS_CUBIC, 35.0, [(-1, 0), (2, 0)],
     [1 - np.log(-np.expm1(-140) / 35) / 35, -np.log(-2 * np.expm1(-70) / 35) / 35], 1e-13),
    ("far beyond the paper's clamp", SEGMENT, 35.0, [(-100, 0)], [100 - np.log(-np.expm1(-140) / 35) / 35], 1e-13),
    ("alpha to 0: -ln L", SEGMENT, 1e-9, [(3, 1)], [-np.log(4) / 1e-9], 10),
    ("alpha to infinity: the distance", SEGMENT, 1e15, [(2, 1), (-3, 4)], [1, 5], 1e-12),
    ("alpha beyond the resolution of a parameter", SEGMENT, 1e30, [(2, 0), (0, 0)],
     [np.log(0.5e30) / 1e30, np.log(1e30) / 1e30], 1e-40),
    ("repeated points", Curve.polyline([(0, 0), (0, 0), (4, 0), (4, 0)]), 35.0, [(-1, 0)],
     [1 - np.log(-np.expm1(-140) / 35) / 35], 1e-15),
    ("a point of no length, however near, counts for nothing", SEGMENT + scaled(POINT, 100), 35.0, [(100, 200)],
     sd(SEGMENT, [(100, 200)]), 1e-12),
    ("there and back: twice the length", Curve.polyline([(0, 0), (4, 0), (0, 0)]), 35.0, [(-1, 0)],
     [1 - np.log(-2 * np.expm1(-140) / 35) / 35], 1e-15),
    ("shift 1e6", scaled(SEGMENT, 1, 1e6), 35.0, [(1e6 - 1, 1e6)], [1 - np.log(-np.expm1(-140) / 35) / 35], 1e-9),
    *((f"scale {s:g}", scaled(SEGMENT, s), 35.0 / s, [(-s, 0)], [s - s * np.log(-np.expm1(-140) / 35 * s) / 35],
       1e-12 * s) for s in (1e-6, 1e6, 1e-170, 1e160, 1e299)),
    ("absurdly far", SEGMENT, 35.0, [(0, 1e300), (-1e200, 0)], [1e300, 1e200], 1e285),
    ("a speck before a mountain", Curve.polyline([(0, 0), (1e-9, 0)]) + Curve.polyline([(1, -1), (1, 1)]), 1e3,
     [(0, 0)], [-np.log(-np.expm1(-1e-6) / 1e3) / 1e3], 1e-12),
]  # fmt: skip


@pytest.mark.parametrize(
    ("curve", "alpha", "points", "expected", "tolerance"), [c[1:] for c in SMOOTHED], ids=ids(SMOOTHED)
)
def test_smoothed_distance(curve, alpha, points, expected, tolerance):
    np.testing.assert_allclose(sd(curve, points, alpha), expected, rtol=0, atol=tolerance)
    assert (np.hypot(*sd_gradient(curve, points, alpha).T) <= 1 + 1e-12).all()


@pytest.mark.parametrize("alpha", [1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize(
    "curve", [SQUARE, ARCH, CUSP, OVERSHOOT, LINE_AS_CUBIC], ids=["square", "arch", "cusp", "over", "line"]
)
def test_smoothed_distance_is_finite_everywhere(curve, alpha):
    away = np.array([0.0, 1e-12, 1e-9, 1e-3, 1.0, 1e3, 1e6])
    points = np.concatenate([curve.sample([0.0, 0.3, 0.5, 1.0]) + d * np.array([0.6, 0.8]) for d in away])
    value, nearest = sd(curve, points, alpha), distance(curve, points)
    assert np.isfinite(value).all()
    assert np.isfinite(sd_gradient(curve, points, alpha)).all()
    assert (value >= nearest - np.log(curve.length) / alpha - 1e-9 - 1e-12 / alpha).all()
    assert (value <= nearest + curve.length - np.log(curve.length) / alpha + 1e-9 + 1e-12 / alpha).all()


def test_the_clamped_logarithm_saturates():
    """What log-sum-exp with the smallest distance taken out is for."""
    d, alpha = 2.0, 35.0
    s = np.linspace(0, 4, 4001)
    plain = np.trapezoid(np.exp(-alpha * (s + d)), s)
    clamped = -np.log(max(plain, 1e-8)) / alpha
    assert abs(clamped - 0.526) < 1e-3
    assert sd(SEGMENT, [(-d, 0)])[0] > 2.0


def test_bad_arguments_of_the_smoothed_distance_are_refused():
    with pytest.raises(ValueError, match="curve: expected a positive length, got 0"):
        sd(Curve.polyline([]), [(0, 0)])
    with pytest.raises(ValueError, match="curve: expected a positive length, got 0"):
        sd(POINT, [(0, 0)])
    for alpha in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="alpha: expected a number > 0"):
            sd(SEGMENT, [(0, 0)], alpha)
    with pytest.raises(ValueError, match=r"alpha: expected a smoothed distance below 1\.8e308"):
        sd(SEGMENT, [(0, 0)], 1e-320)
