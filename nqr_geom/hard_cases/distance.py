"""Distances that break naive code: name, curve, queries, expected values, unit, tolerance in that unit.

Values are closed forms; parabolas and cubics are held against numpy's roots of the equation of their feet, snowflakes
and swarms of segments against shapely.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.distance import closest_point, distance, distance_gradient, signed_distance
from nqr_geom.hard_cases.case import Case, deviation, refusal
from nqr_geom.hard_cases.shapes import INNER, SQUARE, Floats, joined, koch, pieces, ring, scaled

__all__ = ["TABLE", "Row", "cases"]


class Row(NamedTuple):
    """One curve with its queries."""

    name: str
    curve: Curve
    points: Any
    expected: Any
    tolerance: float
    unit: float = 1.0


SEGMENT = Curve.polyline([(0, 0), (4, 0)])
ARCH = pieces([[[-1, 1], [0, -1], [1, 1]]])  # the parabola y = x^2
POINT = Curve.polyline([(1, 2)])
LINE_AS_CUBIC = pieces([[[0, 0], [0, 0], [4, 0], [4, 0]]])
OVERSHOOT = pieces([[[0, 0], [4, 0], [1, 0]]])  # reaches 16/7
CUSP = pieces([[[0, 0], [1, 1], [0, 1], [1, 0]]])  # tip at (1/2, 3/4)
U = Curve.polyline([(0, 4), (0, 0), (1, 0), (1, 4)])

_ROWS: list[tuple[Any, ...]] = [
    ("segment: beside, beyond, on", SEGMENT, [(1, 2), (7, 4), (-3, -4), (2, 0), (4, 0)], [2, 5, 5, 0, 0], 0),
    ("segment: 1e-150 beside", SEGMENT, [(1, 1e-150), (3, -1e-150)], [1e-150, 1e-150], 1e-15, 1e-150),
    ("square: centre, edge, vertex", SQUARE, [(0.5, 0.5), (0.5, 0), (1, 1), (2, 2)], [0.5, 0, 0, np.sqrt(2)], 1e-15),
    ("one point", POINT, [(1, 2), (4, 6)], [0, 5], 0),
    ("all control points equal", pieces([[[1, 2]] * 4]), [(1, 2), (4, 6)], [0, 5], 0),
    ("a point beside a square", SQUARE + scaled(POINT, 10), [(10, 20), (10, 21), (0.5, 0.75)], [0, 1, 0.25], 0),
    ("a thousand edges equally near", Curve.polyline(ring(1000), closed=True), [(0, 0)], [np.cos(np.pi / 1000)], 1e-15),
    ("parabola: on the axis below, at and above the focal point", ARCH, [(0, -1), (0, 0.25), (0, 0.5), (0, 1)],
     [1, 0.25, 0.5, np.sqrt(0.75)], 1e-12),
    ("parabola: on it", ARCH, [(0, 0), (0.5, 0.25), (-0.25, 0.0625), (1, 1)], [0] * 4, 1e-16),
    ("parabola: nearer than it can be told", ARCH, [(0, -1e-300), (0, 1e-200), (0, -1e-12)], [0, 0, 1e-12], 1e-20),
    ("a line dressed as a cubic, handles drawn in", LINE_AS_CUBIC, [(1, 2), (7, 4), (0, 0), (0, 1e-9), (2, 0)],
     [2, 5, 0, 1e-9, 0], 1e-15),
    ("collinear overshoot", OVERSHOOT, [(16 / 7, 0), (16 / 7 + 1, 0), (2, 1), (-1, 0)], [0, 1, 1, 1], 1e-15),
    ("cusp", CUSP, [(0.5, 0.75), (0.5, 1.75), (0.5, 0.75 + 1e-9)], [0, 1, 1e-9], 1e-16),
    ("shift 1e6", scaled(SQUARE, 1, 1e6), [(1e6 + 0.5, 1e6 + 0.25), (1e6 - 3, 1e6 - 4)], [0.25, 5], 1e-9),
    *((f"square [scale {s:g}]", scaled(SQUARE, s), [(0.5 * s, 0.25 * s), (4 * s, 5 * s), (0.5 * s, 0)],
       [0.25 * s, 5 * s, 0], 1e-12, s) for s in (1e-6, 1e6, 1e-170, 1e160, 1e-300, 1e299)),
    ("absurdly far", SQUARE, [(1e200, 0), (0, -1e300), (3e307, 4e307)], [1e200, 1e300, 5e307], 1e-8, 1e300),
]  # fmt: skip
TABLE = [Row(*row) for row in _ROWS]

SIGNED: list[tuple[str, Curve, str, Any, Any]] = [
    ("square", SQUARE, "nonzero", [(0.5, 0.25), (2, 0.5), (0.5, 0)], [-0.25, 1, 0]),
    ("clockwise square", SQUARE.reversed(), "nonzero", [(0.5, 0.25), (2, 0.5), (0.5, 0)], [-0.25, 1, 0]),
    ("hole", SQUARE + INNER.reversed(), "nonzero", [(0.5, 0.5), (0.125, 0.5)], [0.25, -0.125]),
    ("doubled inside, nonzero", SQUARE + INNER, "nonzero", [(0.5, 0.5), (0.125, 0.5)], [-0.25, -0.125]),
    ("doubled inside, even-odd", SQUARE + INNER, "even-odd", [(0.5, 0.5), (0.125, 0.5)], [0.25, -0.125]),
    ("open: a U closed by its level set", U, "nonzero", [(0.5, 1), (0.5, 3.5), (0.5, 5), (0.5, -1)],
     [-0.5, -0.5, np.hypot(0.5, 1), 1]),
    ("open and reversed", U.reversed(), "even-odd", [(0.5, 1), (0.5, -1)], [-0.5, 1]),
]  # fmt: skip


def naive_distance(curve: Curve, points: Floats) -> Floats:
    """The textbook's projection on every chord between control points, by squares."""
    best = np.full(len(points), np.inf)
    with np.errstate(all="ignore"):
        for control, degree in zip(curve.control, curve.degree, strict=True):
            for a, b in pairwise(control[: degree + 1]):
                t = np.clip(((points - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
                best = np.minimum(best, np.sqrt(((points - a - t[:, None] * (b - a)) ** 2).sum(axis=1)))
    return best


def _by_roots(control: Floats, points: Floats) -> Floats:
    """Distance to one Bezier piece: the real roots of (z(t) - p) . z'(t), and the ends."""
    from math import comb

    degree = len(control) - 1
    axes = [np.polynomial.Polynomial([0.0])] * 2
    t = np.polynomial.Polynomial([0.0, 1.0])
    for k, place in enumerate(control):
        weight = comb(degree, k) * t**k * (1.0 - t) ** (degree - k)
        axes = [axis + weight * float(at) for axis, at in zip(axes, place, strict=True)]
    found = []
    for p in points:
        stationary = sum(((axis - at) * axis.deriv() for axis, at in zip(axes, p, strict=True)), start=0.0 * t)
        roots = np.append(np.clip(stationary.roots().real, 0.0, 1.0), [0.0, 1.0])
        found.append(np.hypot(*(axis(roots) - at for axis, at in zip(axes, p, strict=True))).min())
    return np.array(found)


def _piece(control: Any, reach: float, unit: float = 1.0) -> float:
    """One curved piece and 300 queries around it, in a unit."""
    points = np.random.default_rng(3).uniform(-reach, reach, (300, 2))
    return deviation(distance(pieces([control]), points), _by_roots(np.array(control, float), points), unit)


def _merging_feet() -> float:
    """On the evolute of the parabola two of the three feet are one."""
    t = np.linspace(-0.35, 0.35, 15)
    points = np.stack([-4.0 * t**3, 3.0 * t**2 + 0.5], axis=1)
    return deviation(distance(ARCH, points), _by_roots(ARCH.control[0, :3], points))


def _snowflake(formula: Callable[[Curve, Floats], Floats]) -> float:
    import shapely

    vertices = koch(5)
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (500, 2))
    truth = shapely.distance(shapely.LinearRing(vertices), shapely.points(points))
    inside = shapely.contains_xy(shapely.Polygon(vertices), *points.T)
    return deviation(formula(Curve.polyline(vertices, closed=True), points), np.where(inside, -truth, truth))


def _swarm() -> float:
    """20,000 segments from 1e-6 to 1 long."""
    import shapely

    random = np.random.default_rng(5)
    start = random.uniform(-1, 1, (20_000, 2))
    end = start + random.normal(size=start.shape) * 10.0 ** random.uniform(-6, 0, (20_000, 1))
    points = random.uniform(-3, 3, (300, 2))
    truth = shapely.distance(
        shapely.multilinestrings(shapely.linestrings(np.stack([start, end], axis=1))), shapely.points(points)
    )
    return deviation(distance(pieces(np.stack([start, end], axis=1)), points), truth)


def _feet() -> float:
    """Closest points lie where their parameter says, at the distance that is given."""
    points = np.random.default_rng(2).uniform(-2, 2, (400, 2))
    curve = joined(ARCH, CUSP, OVERSHOOT, SQUARE)
    found = closest_point(curve, points)
    gap = np.hypot(*(points - found.point).T)
    place = [_at(curve, piece, t) for piece, t in zip(found.piece, found.t, strict=True)]
    return max(deviation(found.distance, gap), deviation(found.point, np.array(place)))


def _at(curve: Curve, piece: int, t: float) -> Floats:
    layer: Floats = curve.control[piece, : curve.degree[piece] + 1]
    while len(layer) > 1:
        layer = (1.0 - t) * layer[:-1] + t * layer[1:]
    return layer[0]


def _gradient() -> float:
    """Beyond, beside and 1e-12 from a segment, and on it: unit vectors away from it, zero on it."""
    points = [(7, 4), (1, 1e-12), (1, -1e3), (2, 0)]
    return deviation(distance_gradient(SEGMENT, points), [(0.6, 0.8), (0, 1), (0, -1), (0, 0)])


def _reversed() -> float:
    points = np.random.default_rng(2).uniform(-2, 2, (400, 2))
    curve = joined(ARCH, CUSP, OVERSHOOT, LINE_AS_CUBIC)
    return deviation(distance(curve.reversed(), points), distance(curve, points))


_NAIVE = {"all control points equal", "parabola: on it", "square [scale 1e-170]",
          "square [scale 1e160]", "absurdly far"}  # fmt: skip


def _signed(curve: Curve, points: Any, sign: str, expected: Any) -> float:
    return deviation(signed_distance(curve, points, sign), expected)


def cases() -> list[Case]:
    """Distances, signed distances, closest points and gradients."""
    group = "distance"

    def error(row: Row, formula: Callable[[Curve, Floats], Floats]) -> float:
        return deviation(formula(row.curve, np.array(row.points, dtype=float)), row.expected, row.unit)

    made = []
    for row in TABLE:
        naive = partial(error, row, naive_distance) if row.name in _NAIVE else None
        made.append(Case(group, row.name, partial(error, row, distance), row.tolerance, naive))
    for name, curve, sign, points, expected in SIGNED:
        made.append(Case(group, f"signed: {name}", partial(_signed, curve, points, sign, expected), 1e-15))
    for name, run, bound in (
        ("parabola: where two feet merge", _merging_feet, 1e-12),
        ("a parabola and 300 queries", partial(_piece, [[-1, 1], [0, -1], [1, 1]], 2.0), 1e-9),
        ("a cubic with a loop and 300 queries", partial(_piece, [[0, 0], [3, 2], [-2, 2], [1, 0]], 2.0), 1e-9),
        ("a cubic with an inflection and 300 queries", partial(_piece, [[0, 0], [1, 0], [0, 1], [1, 1]], 2.0), 1e-9),
        ("handles of length 1e8", partial(_piece, [[0, 0], [1e8, 1e8], [-1e8, 1e8], [1, 0]], 1e8, 1e8), 1e-9),
        ("snowflake: signed", partial(_snowflake, signed_distance), 1e-14),
        ("swarm of 20,000 segments", _swarm, 1e-14),
        ("feet lie where they say", _feet, 1e-14),
        ("gradient: of unit length, zero on the curve", _gradient, 1e-15),
        ("reversal changes nothing", _reversed, 1e-15),
    ):
        made.append(Case(group, name, run, bound))
    box = Curve.from_callable(lambda s: np.stack([s, s], axis=1))
    for name, call, words in (
        ("a distance beyond float64", partial(distance, SQUARE, [(0, 0), (1.5e308, 1.5e308)]),
         r"points: expected a distance below 1.8e308"),
        ("no curve", partial(distance, Curve.polyline([]), [(0, 0)]), "curve: expected at least one piece"),
        ("no such sign", partial(signed_distance, SQUARE, [(0, 0)], sign="odd"),
         "sign: expected one of nonzero, even-odd, got 'odd'"),
        ("a query that is infinite", partial(closest_point, SQUARE, [(0, np.inf)]), "points: expected finite numbers"),
        ("a black box", partial(distance, box, [(0, 0)]), "curve: control needs the pieces"),
    ):  # fmt: skip
        made.append(refusal(group, name, call, words))
    return made
