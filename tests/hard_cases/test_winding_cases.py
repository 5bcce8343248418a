"""Winding numbers that break naive code: one table of name, curve, queries, expected values, tolerance."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.winding import gwn, gwn_gradient


def polygon(*points):
    return Curve.polyline(points, closed=True)


def joined(*parts):
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def circle_of_cubics(n, turn=2 * np.pi, radius=1.0):
    """A circle (or a part of one) as n cubics that share ends bitwise."""
    angle = np.linspace(0, turn, n + 1)
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if turn == 2 * np.pi:
        ring[-1] = ring[0]
    arm = 4 / 3 * np.tan(turn / n / 4)
    tangent = np.stack([-ring[:, 1], ring[:, 0]], axis=1) * arm
    return Curve.bezier(np.stack([ring[:-1], ring[:-1] + tangent[:-1], ring[1:] - tangent[1:], ring[1:]], axis=1))


SQUARE = polygon((0, 0), (1, 0), (1, 1), (0, 1))
CLOCKWISE = SQUARE.reversed()
TIP = np.stack([np.sin(np.arange(5) * 4 * np.pi / 5), np.cos(np.arange(5) * 4 * np.pi / 5)], axis=1)
PENTAGRAM = polygon(*TIP[::-1])
BOWTIE = polygon((-1, -1), (1, 1), (1, -1), (-1, 1))  # right lobe clockwise, left lobe counter-clockwise
INNER = polygon((0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75))
HALF_CIRCLE = circle_of_cubics(64, np.pi)
LOOP = Curve.bezier([[[0, 0], [3, 2], [-2, 2], [1, 0]]])  # a cubic with a loop, its ends below
CUSP = Curve.bezier([[[0, 0], [1, 1], [0, 1], [1, 0]]])  # the cubic's cusp at (1/2, 3/4)
DOUBLED = joined(SQUARE, SQUARE)
NONE = Curve.bezier(np.empty((0, 2, 2)))
SEGMENT = Curve.polyline([(1, -1), (1, 1)])
OVERSHOOT = Curve.bezier([[[0, 0], [4, 0], [1, 0]]])
LENS = Curve.bezier([[[0, 0], [1, -2], [2, 0]], [[2, 0], [1, 2], [0, 0]]])


def scaled(curve, s, shift=0.0):
    return curve.transformed(s * np.eye(2), (shift, shift))


CASES = [
    ("square: centre, outside", SQUARE, [(0.5, 0.5), (1.5, 0.5), (-0.5, 0.5), (0.5, 2)], [1, 0, 0, 0], 0),
    ("square: clockwise", CLOCKWISE, [(0.5, 0.5), (2, 2), (0.5, 0), (0, 0)], [-1, 0, -0.5, -0.25], 1e-16),
    ("square: middle of each edge", SQUARE, [(0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)], [0.5] * 4, 0),
    ("square: vertices", SQUARE, [(0, 0), (1, 0), (1, 1), (0, 1)], [0.25] * 4, 1e-16),
    ("square: beside an edge", SQUARE, [(0.5, 1e-9), (0.5, -1e-9), (1 - 1e-9, 0.5), (1 + 1e-9, 0.5)], [1, 0, 1, 0], 0),
    ("square: level with edges, outside", SQUARE, [(-1, 0), (2, 0), (-1, 1), (2, 1)], [0] * 4, 0),
    ("square: one bit beside", SQUARE, [(np.nextafter(1, 0), 0.5), (np.nextafter(1, 2), 0.5)], [1, 0], 0),
    ("diamond: corners and edges", polygon((1, 0), (0, 1), (-1, 0), (0, -1)), [(1, 0), (0, 1), (0.5, 0.5), (0, 0)],
     [0.25, 0.25, 0.5, 1], 1e-16),
    ("reflex corner", polygon((0, 0), (2, 0), (2, 2), (1, 2), (1, 1), (0, 1)), [(1, 1), (2, 2)], [0.75, 0.25], 1e-16),
    ("repeated points", polygon((0, 0), (0, 0), (1, 0), (1, 0), (1, 0), (1, 1), (0, 1), (0, 0)),
     [(0.5, 0.5), (0, 0), (1, 0), (0.5, 0), (3, 3)], [1, 0.25, 0.25, 0.5, 0], 1e-16),
    ("all control points equal", Curve.bezier([[[1, 1]] * 4, [[1, 1]] * 4]), [(1, 1), (0, 0), (2, 1)], [0] * 3, 0),
    ("one point", Curve.polyline([(1, 1)]), [(1, 1), (0, 1)], [0, 0], 0),
    ("everything at the origin", Curve.polyline([(0, 0), (0, 0)]), [(0, 0), (1, 0), (1e300, 0)], [0] * 3, 0),
    ("empty curve", NONE, [(0, 0), (1, 1)], [0, 0], 0),
    ("open segment", SEGMENT, [(0, 0), (2, 0)], [0.25, -0.25], 1e-16),
    ("open segment: on it, at its ends", SEGMENT, [(1, 0), (1, 1), (1, -1), (1, 2)], [0] * 4, 0),
    ("far from a segment", Curve.polyline([(0, 0), (1, 0)]), [(0.5, 1e3), (0.5, -1e3)],
     [np.arctan(0.5e-3) / np.pi, -np.arctan(0.5e-3) / np.pi], 1e-16),
    ("absurdly far", joined(SQUARE, SEGMENT), [(1e300, 0), (-1e308, 1e308), (0, -1.7e308)], [0] * 3, 1e-16),
    ("half circle", HALF_CIRCLE, [(0, 0), (0, 0.5), (0, -0.5)],
     [0.5, 0.5 + np.arctan(0.5) / np.pi, 0.5 - np.arctan(0.5) / np.pi], 1e-15),
    ("half circle: at its ends", HALF_CIRCLE, [(1, 0)], [0.25], 1e-15),
    ("pentagram", PENTAGRAM, [(0, 0), (0, 0.9), (0, -0.9)], [2, 1, 0], 0),
    ("bowtie", BOWTIE, [(-0.5, 0), (0.5, 0), (0, 0.5), (0, 0)], [1, -1, 0, 0], 0),
    ("hole", joined(SQUARE, INNER.reversed()), [(0.5, 0.5), (0.1, 0.5), (0.5, 0.25)], [0, 1, 0.5], 0),
    ("no hole: same orientation", joined(SQUARE, INNER), [(0.5, 0.5), (0.1, 0.5), (0.25, 0.25)], [2, 1, 1.25], 0),
    ("edge there and back", Curve.polyline([(0, 0), (1, 1), (0, 0)]),
     [(0.5, 0.5), (1, 1), (0, 0), (0.5, 0)], [0] * 4, 0),
    ("spike on a square", polygon((0, 0), (1, 0), (1, 0.5), (2, 0.5), (1, 0.5), (1, 1), (0, 1)),
     [(1.5, 0.5), (2, 0.5), (1.5, 0.5 + 1e-12), (0.5, 0.5), (1, 0.5)], [0, 0, 0, 1, 0.5], 0),
    ("sliver", polygon((0, 0), (1, 0), (1, 1e-8), (0, 1e-8)), [(0.5, 5e-9), (0.5, 2e-8), (0.5, -1e-9)], [1, 0, 0], 0),
    ("tilted sliver, 1e-15 wide", polygon((0, 0), (1, 1), (1, 1 + 2e-15)), [(0.75, 0.75 + 5e-16), (0.75, 0.75 + 1e-14)],
     [1, 0], 0),
    ("doubled", DOUBLED, [(0.5, 0.5), (0.5, 0), (1, 1)], [2, 1, 0.5], 0),
    ("shift 1e6", scaled(SQUARE, 1, 1e6),
     [(1e6 + 0.5, 1e6 + 0.5), (1e6 + 0.5, 1e6), (1e6, 1e6), (1e6 + 0.5, 1e6 - 1e-9)],
     [1, 0.5, 0.25, 0], 1e-9),
    *((f"scale {s:g}", scaled(SQUARE, s), [(0.5 * s, 0.5 * s), (0.5 * s, 0), (s, s), (0.5 * s, -1e-9 * s)],
       [1, 0.5, 0.25, 0], 1e-12) for s in (1e-6, 1e6, 1e-170, 1e160, 1e-300, 1e300)),
    *((f"lens, scale {s:g}", scaled(LENS, s), [(s, 0), (s, 0.9 * s), (s, 1.1 * s), (0, 0)],
       [1, 1, 0, np.arctan(2) / np.pi], 1e-12) for s in (1, 1e-170, 1e160)),
    ("a speck beside a mountain", joined(SQUARE, scaled(SQUARE.transformed(np.eye(2), (-2, -2)), 1e-170)),
     [(-1.5e-170, -1.5e-170), (-1.5e-170, -1.5e-169), (0.5, 0.5)], [1, 0, 1], 0),
    ("collinear overshoot", OVERSHOOT, [(0.5, 0.5), (0.5, -0.5)], [0.25, -0.25], 1e-16),
    ("collinear overshoot: on it", OVERSHOOT, [(0.5, 0), (1.2, 0), (0, 0), (1, 0)], [0] * 4, 0),
    ("loop: in it, beside it, below it", LOOP, [(0.5, 1.3), (0.5, 2), (0.5, 0)], None, 1e-12),
    ("loop: at its waist and far beside", LOOP, [(0.5, 1.25), (-0.3, 1.4), (1.3, 1.4)], None, 1e-12),
    ("cusp: above, below, beside", CUSP, [(0.5, 0.76), (0.5, 0.7), (0.4, 0.74)], None, 1e-12),
    ("cusp: on it", CUSP, [(0.5, 0.75)], [np.arctan2(0.5, 0.75) / np.pi], 1e-9),
    ("double point", Curve.bezier([[[0, 0], [2, 2], [-1, 2], [1, 0]]]),
     [(0.5, 1.0), (0.5, 1.2), (0.5, 1.6)], None, 1e-12),
    ("anti-parallel end tangents", Curve.bezier([[[0, 0], [0, 1], [1, 1], [1, 0]]]),
     [(0.5, 0), (0, 0), (1, 0), (0.5, 0.75), (0.5, 1)],
     [-0.5, -0.25, -0.25, np.arctan2(0.5, 0.75) / np.pi - 0.5, np.arctan(0.5) / np.pi], 1e-15),
    ("handles drawn in", Curve.bezier([[[0, 0], [0, 0], [2, 1], [2, 1]]]), [(1, 0), (1, 1), (0, 0), (2, 1)],
     [-0.375, 0.375, 0, 0], 1e-15),
    ("degree one dressed as two and three", Curve.bezier([[[1, -1], [1, -1 / 3], [1, 1 / 3], [1, 1]]]) + Curve.bezier(
        [[[1, -1], [1, 0], [1, 1]]]), [(0, 0), (2, 0)], [0.5, -0.5], 1e-15),
    ("nearly vanishing leading coefficient", Curve.bezier([[[1, -1], [1, -1 / 3], [1 + 1e-17, 1 / 3 + 1e-17], [1, 1]]]),
     [(0, 0)], [0.25], 1e-12),
]  # fmt: skip


def by_flattening(curve, points, n=4096):
    """Angle sum over 4,096 chords a piece: independent of roots, boxes and crossings."""
    total = np.zeros(len(points))
    for control, degree in zip(curve.control, curve.degree, strict=True):
        t = np.linspace(0, 1, n + 1)[:, None]
        layer = [row[None] for row in control[: degree + 1]]
        while len(layer) > 1:
            layer = [(1 - t) * a + t * b for a, b in pairwise(layer)]
        for i, p in enumerate(points):
            z = (layer[0] - p) @ [1, 1j]
            good = np.abs(z) > 0
            total[i] += np.angle(z[good][1:] / z[good][:-1]).sum() / (2 * np.pi)
    return total


@pytest.mark.parametrize(
    ("curve", "points", "expected", "tolerance"), [c[1:] for c in CASES], ids=[c[0] for c in CASES]
)
def test_value(curve, points, expected, tolerance):
    if expected is None:
        expected = by_flattening(curve, np.array(points, dtype=float))
    np.testing.assert_allclose(gwn(curve, points), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize(("curve", "points"), [c[1:3] for c in CASES], ids=[c[0] for c in CASES])
def test_reversal_changes_the_sign(curve, points):
    np.testing.assert_allclose(gwn(curve.reversed(), points), -gwn(curve, points), rtol=0, atol=1e-15)


@pytest.mark.parametrize("curve", [c[1] for c in CASES], ids=[c[0] for c in CASES])
def test_gradient_is_finite_off_the_open_ends(curve):
    assert np.isfinite(gwn_gradient(curve, [(0.31, 0.77), (-1e5, 3.0), (1e200, -1e300)])).all()


def plain_root_formula(curve, points):
    """The naive exact answer: one sum of root arguments a piece, nothing shared at the joints."""
    total = np.zeros(len(points))
    for control in curve.control:
        c = control @ [1, 1j]
        a = [c[3] - 3 * c[2] + 3 * c[1] - c[0], 3 * (c[2] - 2 * c[1] + c[0]), 3 * (c[1] - c[0])]
        for i, p in enumerate(points):
            roots = np.roots([*a, c[0] - complex(*p)])
            total[i] += np.angle((roots - 1) / roots).sum() / (2 * np.pi)
    return total


@pytest.mark.parametrize("offset", [1e-7, 1e-9, 1e-12])
def test_beside_a_joint_a_closed_chain_gives_an_integer(offset):
    circle = circle_of_cubics(4)
    direction = np.array([np.cos(2.3), np.sin(2.3)])
    points = circle.control[:, 0] + offset * direction * [[-1], [1], [-1], [1]]
    inside = np.hypot(*points.T) < 1
    np.testing.assert_array_equal(gwn(circle, points), inside)
    if offset == 1e-9:  # what sharing the ends is for
        assert np.abs(plain_root_formula(circle, points) - inside).max() > 1e-9


def test_a_black_box_and_a_bad_query_are_refused():
    box = Curve.from_callable(lambda s: np.stack([s, s], axis=1))
    with pytest.raises(ValueError, match="curve: control needs the pieces"):
        gwn(box, [(0, 0)])
    with pytest.raises(ValueError, match="points: expected finite numbers, got nan"):
        gwn(SQUARE, [(0, 0), (np.nan, 0)])
    with pytest.raises(ValueError, match=r"points: expected shape \(m, 2\)"):
        gwn(SQUARE, (0.5, 0.5))
    assert gwn(SQUARE, np.empty((0, 2))).shape == (0,)


@pytest.mark.parametrize("point", [(1, 1), (1, 1 + 1e-320)])
def test_gradient_at_an_open_end_is_refused(point):
    segment = Curve.polyline([(1, -1), (1, 1)])
    with pytest.raises(ValueError, match="points: expected points off the ends of open chains"):
        gwn_gradient(segment, [(0, 0), point])
