"""Winding numbers that break naive code: name, curve, queries, expected values, tolerance.

Values are closed forms, or `None` for the angle sum over 4,096 chords a piece: away from the curve its integer part is
right and its fraction comes from the ends alone, so that it is exact without roots, boxes or crossings. Snowflake and
corridor are held against shapely.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.winding import gwn, gwn_gradient
from nqr_geom.hard_cases.case import Case, deviation, refusal
from nqr_geom.hard_cases.shapes import (
    INNER,
    SQUARE,
    Floats,
    circle_of_cubics,
    closed,
    joined,
    koch,
    pieces,
    ring,
    scaled,
)

__all__ = ["TABLE", "Row", "cases"]


class Row(NamedTuple):
    """One curve with its queries; `expected` None asks for the sum over chords."""

    name: str
    curve: Curve
    points: Any
    expected: Any
    tolerance: float


TIP = np.stack([np.sin(np.arange(5) * 4 * np.pi / 5), np.cos(np.arange(5) * 4 * np.pi / 5)], axis=1)
PENTAGRAM = closed(*TIP[::-1])
BOWTIE = closed((-1, -1), (1, 1), (1, -1), (-1, 1))  # right lobe clockwise, left lobe counter-clockwise
HALF_CIRCLE = circle_of_cubics(64, np.pi)
LOOP = pieces([[[0, 0], [3, 2], [-2, 2], [1, 0]]])  # a cubic with a loop, its ends below
CUSP = pieces([[[0, 0], [1, 1], [0, 1], [1, 0]]])  # the cubic's cusp at (1/2, 3/4)
NONE = Curve.bezier(np.empty((0, 2, 2)))
SEGMENT = Curve.polyline([(1, -1), (1, 1)])
OVERSHOOT = pieces([[[0, 0], [4, 0], [1, 0]]])
LENS = pieces([[[0, 0], [1, -2], [2, 0]], [[2, 0], [1, 2], [0, 0]]])
BLADE = joined(pieces([[[0, 0], [1, 2e-12], [2, 0]]]), Curve.polyline([(2, 0), (0, 0)]))
COMB = closed(
    *[(k + d, h) for k in range(10_000) for d, h in ((0.0, 0.0), (0.0, 1.0), (0.5, 1.0), (0.5, 0.0))],
    (10_000.0, 0.0), (10_000.0, -1.0), (0.0, -1.0),
).reversed()  # fmt: skip


_ROWS: list[tuple[Any, ...]] = [
    ("square: centre, outside", SQUARE, [(0.5, 0.5), (1.5, 0.5), (-0.5, 0.5), (0.5, 2)], [1, 0, 0, 0], 0),
    ("square: clockwise", SQUARE.reversed(), [(0.5, 0.5), (2, 2), (0.5, 0), (0, 0)], [-1, 0, -0.5, -0.25], 1e-16),
    ("square: middle of each edge", SQUARE, [(0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)], [0.5] * 4, 0),
    ("square: vertices", SQUARE, [(0, 0), (1, 0), (1, 1), (0, 1)], [0.25] * 4, 1e-16),
    ("square: beside an edge", SQUARE, [(0.5, 1e-9), (0.5, -1e-9), (1 - 1e-9, 0.5), (1 + 1e-9, 0.5)], [1, 0, 1, 0], 0),
    ("square: level with edges, outside", SQUARE, [(-1, 0), (2, 0), (-1, 1), (2, 1)], [0] * 4, 0),
    ("square: one bit beside", SQUARE, [(np.nextafter(1, 0), 0.5), (np.nextafter(1, 2), 0.5)], [1, 0], 0),
    ("diamond: corners and edges", closed((1, 0), (0, 1), (-1, 0), (0, -1)), [(1, 0), (0, 1), (0.5, 0.5), (0, 0)],
     [0.25, 0.25, 0.5, 1], 1e-16),
    ("reflex corner", closed((0, 0), (2, 0), (2, 2), (1, 2), (1, 1), (0, 1)), [(1, 1), (2, 2)], [0.75, 0.25], 1e-16),
    ("repeated points", closed((0, 0), (0, 0), (1, 0), (1, 0), (1, 0), (1, 1), (0, 1), (0, 0)),
     [(0.5, 0.5), (0, 0), (1, 0), (0.5, 0), (3, 3)], [1, 0.25, 0.25, 0.5, 0], 1e-16),
    ("all control points equal", pieces([[[1, 1]] * 4, [[1, 1]] * 4]), [(1, 1), (0, 0), (2, 1)], [0] * 3, 0),
    ("one point", Curve.polyline([(1, 1)]), [(1, 1), (0, 1)], [0, 0], 0),
    ("everything at the origin", Curve.polyline([(0, 0), (0, 0)]), [(0, 0), (1, 0), (1e300, 0)], [0] * 3, 0),
    ("empty curve", NONE, [(0, 0), (1, 1)], [0, 0], 0),
    ("open segment", SEGMENT, [(0, 0), (2, 0)], [0.25, -0.25], 1e-16),
    ("open segment: on it, at its ends", SEGMENT, [(1, 0), (1, 1), (1, -1), (1, 2)], [0] * 4, 0),
    ("open segment: the smallest step beside it", Curve.polyline([(0, 0), (1, 0)]), [(0.5, 1e-320), (0.5, -1e-320)],
     [0.5, -0.5], 1e-16),
    ("open segment: one bit long", Curve.polyline([(1, 1), (1, np.nextafter(1, 2))]), [(0.5, 1), (1.5, 1)],
     [np.spacing(1.0) / np.pi, -np.spacing(1.0) / np.pi], 1e-28),
    ("far from a segment", Curve.polyline([(0, 0), (1, 0)]), [(0.5, 1e3), (0.5, -1e3)],
     [np.arctan(0.5e-3) / np.pi, -np.arctan(0.5e-3) / np.pi], 1e-16),
    ("absurdly far", joined(SQUARE, SEGMENT), [(1e300, 0), (-1e308, 1e308), (0, -1.7e308)], [0] * 3, 1e-16),
    ("half circle", HALF_CIRCLE, [(0, 0), (0, 0.5), (0, -0.5)],
     [0.5, 0.5 + np.arctan(0.5) / np.pi, 0.5 - np.arctan(0.5) / np.pi], 1e-15),
    ("half circle: at its ends", HALF_CIRCLE, [(1, 0)], [0.25], 1e-15),
    ("pentagram", PENTAGRAM, [(0, 0), (0, 0.9), (0, -0.9)], [2, 1, 0], 0),
    ("pentagram: tip and crossing", PENTAGRAM, [TIP[0]], [0.1], 1e-15),
    ("star of 17 tips that goes round 8 times", Curve.polyline(ring(17, turns=8), closed=True),
     [(0, 0), (0.05, 0.01), (1.1, 0), (0, -2)], [8, 8, 0, 0], 0),
    ("circle gone round 7 times", Curve.polyline(ring(7 * 60, turns=7), closed=True), [(0, 0), (0.9, 0.1), (1.5, 0)],
     [7, 7, 0], 0),
    ("200 nested squares", joined(*(scaled(SQUARE, s, -0.5 * s) for s in np.arange(1, 201) / 200)),
     [(0, 0), (0.4901, 0), (0.6, 0.6), (0.25, 0)], [200, 4, 0, 100.5], 0),
    ("bowtie", BOWTIE, [(-0.5, 0), (0.5, 0), (0, 0.5), (0, 0)], [1, -1, 0, 0], 0),
    ("hourglass pinched at a vertex", closed((0, 0), (-1, -1), (1, -1), (0, 0), (1, 1), (-1, 1)),
     [(0, 0), (0, 0.5), (0, -0.5), (0.5, 0)], [0.5, 1, 1, 0], 1e-16),
    ("hole", joined(SQUARE, INNER.reversed()), [(0.5, 0.5), (0.1, 0.5), (0.5, 0.25)], [0, 1, 0.5], 0),
    ("hole that touches the rim", joined(SQUARE, closed((0, 0.5), (0.5, 0.25), (0.5, 0.75)).reversed()),
     [(0.3, 0.5), (0, 0.5), (0.1, 0.1), (0, 0.25)], [0, 0.5 - np.arctan(0.5) / np.pi, 1, 0.5], 1e-16),
    ("no hole: same orientation", joined(SQUARE, INNER), [(0.5, 0.5), (0.1, 0.5), (0.25, 0.25)], [2, 1, 1.25], 0),
    ("neighbours with one edge in common", joined(SQUARE, SQUARE.transformed(np.eye(2), (1, 0))),
     [(1, 0.5), (1, 0), (0.5, 0.5), (1.5, 0.5)], [1, 0.5, 1, 1], 1e-16),
    ("neighbours with a corner in common", joined(SQUARE, SQUARE.transformed(np.eye(2), (1, 1))),
     [(1, 1), (1, 1.5), (0.5, 1)], [0.5, 0.5, 0.5], 1e-16),
    ("edge there and back", Curve.polyline([(0, 0), (1, 1), (0, 0)]),
     [(0.5, 0.5), (1, 1), (0, 0), (0.5, 0)], [0] * 4, 0),
    ("spike on a square", closed((0, 0), (1, 0), (1, 0.5), (2, 0.5), (1, 0.5), (1, 1), (0, 1)),
     [(1.5, 0.5), (2, 0.5), (1.5, 0.5 + 1e-12), (0.5, 0.5), (1, 0.5)], [0, 0, 0, 1, 0.5], 0),
    ("sliver", closed((0, 0), (1, 0), (1, 1e-8), (0, 1e-8)), [(0.5, 5e-9), (0.5, 2e-8), (0.5, -1e-9)], [1, 0, 0], 0),
    ("tilted sliver, 1e-15 wide", closed((0, 0), (1, 1), (1, 1 + 2e-15)), [(0.75, 0.75 + 5e-16), (0.75, 0.75 + 1e-14)],
     [1, 0], 0),
    ("comb of 10,000 teeth, level with its vertices", COMB, [(4711.25, 1), (4711.25, 0.5), (4711.75, 0.5), (-1, 1),
     (5000.25, 0), (5000.75, 0), (5000.75, 1)], [0.5, 1, 0, 0, 1, 0.5, 0], 0),
    ("circle of 100,000 edges, 1e-9 beside a vertex", Curve.polyline(ring(100_000), closed=True),
     [(1 - 1e-9, 0), (1 + 1e-9, 0), (0, 0)], [1, 0, 1], 0),
    ("doubled", joined(SQUARE, SQUARE), [(0.5, 0.5), (0.5, 0), (1, 1)], [2, 1, 0.5], 0),
    ("shift 1e6", scaled(SQUARE, 1, 1e6),
     [(1e6 + 0.5, 1e6 + 0.5), (1e6 + 0.5, 1e6), (1e6, 1e6), (1e6 + 0.5, 1e6 - 1e-9)],
     [1, 0.5, 0.25, 0], 1e-9),
    *((f"square [scale {s:g}]", scaled(SQUARE, s), [(0.5 * s, 0.5 * s), (0.5 * s, 0), (s, s), (0.5 * s, -1e-9 * s)],
       [1, 0.5, 0.25, 0], 1e-12) for s in (1e-6, 1e6, 1e-170, 1e160, 1e-300, 1e300)),
    *((f"lens [scale {s:g}]", scaled(LENS, s), [(s, 0), (s, 0.9 * s), (s, 1.1 * s), (0, 0)],
       [1, 1, 0, np.arctan(2) / np.pi], 1e-12) for s in (1, 1e-170, 1e160)),
    ("a speck beside a mountain", joined(SQUARE, scaled(SQUARE.transformed(np.eye(2), (-2, -2)), 1e-170)),
     [(-1.5e-170, -1.5e-170), (-1.5e-170, -1.5e-169), (0.5, 0.5)], [1, 0, 1], 0),
    ("collinear overshoot", OVERSHOOT, [(0.5, 0.5), (0.5, -0.5)], [0.25, -0.25], 1e-16),
    ("collinear overshoot: on it", OVERSHOOT, [(0.5, 0), (1.2, 0), (0, 0), (1, 0)], [0] * 4, 0),
    ("arc 1e-12 high over its chord", BLADE, [(1, 5e-13), (1, 2e-12), (1, -1e-13), (0.5, 2e-13)], [-1, 0, 0, -1], 0),
    ("loop: in it, beside it, below it", LOOP, [(0.5, 1.3), (0.5, 2), (0.5, 0)], None, 1e-12),
    ("loop: at its waist and far beside", LOOP, [(0.5, 1.25), (-0.3, 1.4), (1.3, 1.4)], None, 1e-12),
    ("inside a loop that the control polygon winds the other way", pieces([[[2, 3], [-3, 6], [-1, 4], [3, 4]]]),
     [(-0.914, 4.631)], None, 1e-12),
    ("handles of length 1e8", pieces([[[0, 0], [1e8, 1e8], [-1e8, 1e8], [1, 0]]]),
     [(0.5, 1), (0.5, 1e7), (0.5, 7e7), (1e7, 5e7)], None, 1e-9),
    ("cusp: above, below, beside", CUSP, [(0.5, 0.76), (0.5, 0.7), (0.4, 0.74)], None, 1e-12),
    ("cusp: on it", CUSP, [(0.5, 0.75)], [np.arctan2(0.5, 0.75) / np.pi], 1e-9),
    ("double point", pieces([[[0, 0], [2, 2], [-1, 2], [1, 0]]]),
     [(0.5, 1.0), (0.5, 1.2), (0.5, 1.6)], None, 1e-12),
    ("anti-parallel end tangents", pieces([[[0, 0], [0, 1], [1, 1], [1, 0]]]),
     [(0.5, 0), (0, 0), (1, 0), (0.5, 0.75), (0.5, 1)],
     [-0.5, -0.25, -0.25, np.arctan2(0.5, 0.75) / np.pi - 0.5, np.arctan(0.5) / np.pi], 1e-15),
    ("handles drawn in", pieces([[[0, 0], [0, 0], [2, 1], [2, 1]]]), [(1, 0), (1, 1), (0, 0), (2, 1)],
     [-0.375, 0.375, 0, 0], 1e-15),
    ("degree one dressed as two and three", pieces([[[1, -1], [1, -1 / 3], [1, 1 / 3], [1, 1]]]) + pieces(
        [[[1, -1], [1, 0], [1, 1]]]), [(0, 0), (2, 0)], [0.5, -0.5], 1e-15),
    ("nearly vanishing leading coefficient", pieces([[[1, -1], [1, -1 / 3], [1 + 1e-17, 1 / 3 + 1e-17], [1, 1]]]),
     [(0, 0)], [0.25], 1e-12),
]  # fmt: skip
TABLE = [Row(*row) for row in _ROWS]


def by_chords(curve: Curve, points: Floats, n: int = 4096) -> Floats:
    """Angle sum over n chords a piece."""
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


def naive_angles(curve: Curve, points: Floats) -> Floats:
    """The textbook's sum of angles between control points, by cross and dot products."""
    total = np.zeros(len(points))
    with np.errstate(all="ignore"):
        for control, degree in zip(curve.control, curve.degree, strict=True):
            for i, p in enumerate(points):
                a, b = (control[: degree + 1] - p)[:-1].T, (control[: degree + 1] - p)[1:].T
                cross, dot = a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]
                total[i] += np.arctan2(cross, dot).sum() / (2.0 * np.pi)
    return total


def naive_roots(curve: Curve, points: Floats) -> Floats:
    """The exact formula piece by piece: a sum of root arguments, nothing shared at the joints."""
    total = np.zeros(len(points))
    for control in curve.control:
        c = control @ [1, 1j]
        a = [c[3] - 3 * c[2] + 3 * c[1] - c[0], 3 * (c[2] - 2 * c[1] + c[0]), 3 * (c[1] - c[0])]
        for i, p in enumerate(points):
            roots = np.roots([*a, c[0] - complex(*p)])
            total[i] += np.angle((roots - 1) / roots).sum() / (2 * np.pi)
    return total


def naive_crossings(curve: Curve, points: Floats) -> Floats:
    """Crossings of a ray to the right, each counted closed at both ends."""
    total = np.zeros(len(points))
    for control in curve.control:
        (ax, ay), (bx, by) = control[0], control[1]
        for i, (x, y) in enumerate(points):
            if ay != by and min(ay, by) <= y <= max(ay, by) and ax + (y - ay) / (by - ay) * (bx - ax) >= x:
                total[i] += 1.0 if by > ay else -1.0
    return total


Formula = Callable[[Curve, Floats], Floats]

_NAIVE: dict[str, Formula] = {
    "square: middle of each edge": naive_crossings,
    "pentagram: tip and crossing": naive_crossings,
    "square [scale 1e-170]": naive_angles,
    "square [scale 1e160]": naive_angles,
    "absurdly far": naive_angles,
    "a speck beside a mountain": naive_angles,
    "inside a loop that the control polygon winds the other way": naive_angles,
    "arc 1e-12 high over its chord": naive_angles,
}


def _error(row: Row, formula: Formula) -> float:
    points = np.array(row.points, dtype=float)
    expected = by_chords(row.curve, points) if row.expected is None else row.expected
    return deviation(formula(row.curve, points), expected)


def _beside_joints(offset: float, formula: Formula) -> float:
    """A closed chain gives an integer, also next to where two of its pieces meet."""
    circle = circle_of_cubics(4)
    direction = np.array([np.cos(2.3), np.sin(2.3)])
    points = circle.control[:, 0] + offset * direction * [[-1], [1], [-1], [1]]
    return deviation(formula(circle, points), np.hypot(*points.T) < 1)


def _against_shapely(vertices: Floats, seed: int) -> float:
    """A simple polygon and 4,000 queries; those within 1e-12 of the rim are nobody's."""
    import shapely

    points = np.random.default_rng(seed).uniform(vertices.min(axis=0), vertices.max(axis=0), (4000, 2))
    polygon = shapely.Polygon(vertices)
    points = points[shapely.distance(polygon.exterior, shapely.points(points)) > 1e-12]
    return deviation(gwn(Curve.polyline(vertices, closed=True), points), shapely.contains_xy(polygon, *points.T))


def _corridor() -> Floats:
    """A spiral corridor of 20 turns, as wide as its walls are apart."""
    angle = np.linspace(0, 40 * np.pi, 2000)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    radius = (1 + angle / (2 * np.pi))[:, None]
    return np.concatenate([(radius + 0.5) * way, (radius * way)[::-1]])


_SPREAD = np.random.default_rng(7).uniform(-0.5, 1.5, (200, 2))
_PIECES = Curve.bezier(np.random.default_rng(8).random((6, 3, 2)))


def _elevated() -> float:
    """The same quadratics written as cubics."""
    a, b, c = _PIECES.control[:, 0], _PIECES.control[:, 1], _PIECES.control[:, 2]
    cubics = Curve.bezier(np.stack([a, (a + 2 * b) / 3, (2 * b + c) / 3, c], axis=1))
    return deviation(gwn(cubics, _SPREAD), gwn(_PIECES, _SPREAD))


def _rotated() -> float:
    turn = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
    return deviation(gwn(_PIECES.transformed(turn), _SPREAD @ turn.T), gwn(_PIECES, _SPREAD))


def _split() -> float:
    """Two halves of every quadratic, by de Casteljau."""
    a, b, c = _PIECES.control[:, 0], _PIECES.control[:, 1], _PIECES.control[:, 2]
    ab, bc = (a + b) / 2, (b + c) / 2
    middle = (ab + bc) / 2
    parts = [Curve.bezier(np.stack(part, axis=1)) for part in ((a, ab, middle), (middle, bc, c))]
    return deviation(sum(gwn(part, _SPREAD) for part in parts), gwn(_PIECES, _SPREAD))


def _reversed() -> float:
    return deviation(gwn(_PIECES.reversed(), _SPREAD), -gwn(_PIECES, _SPREAD))


def _gradient_of_a_segment() -> float:
    """Of (0,0) to (1,0) above its middle, down to 1e-12 beside the line: Biot and Savart."""
    y = np.array([1e3, 1.0, 1e-3, 1e-9, 1e-12])
    points = np.stack([np.full(5, 0.5), y], axis=1)
    truth = -0.5 / (0.25 + y**2) / np.pi
    return deviation(gwn_gradient(Curve.polyline([(0, 0), (1, 0)]), points)[:, 1] / truth, np.ones(5))


def cases() -> list[Case]:
    """Winding numbers."""
    box = Curve.from_callable(lambda s: np.stack([s, s], axis=1))
    made = []
    for row in TABLE:
        naive = partial(_error, row, _NAIVE[row.name]) if row.name in _NAIVE else None
        made.append(Case("winding", row.name, partial(_error, row, gwn), row.tolerance, naive))
    for offset in (1e-7, 1e-9, 1e-12):
        naive = partial(_beside_joints, offset, naive_roots) if offset == 1e-9 else None
        name = f"beside the joints of a closed chain [{offset:g}]"
        made.append(Case("winding", name, partial(_beside_joints, offset, gwn), 0.0, naive))
    for name, run, bound in (
        ("snowflake of 12,288 edges", partial(_against_shapely, koch(6), 1), 0.0),
        ("spiral corridor of 20 turns", partial(_against_shapely, _corridor(), 2), 0.0),
        ("degree elevation changes nothing", _elevated, 1e-12),
        ("rotation changes nothing", _rotated, 1e-12),
        ("halves of split pieces add up", _split, 1e-12),
        ("reversal changes the sign", _reversed, 1e-15),
        ("gradient of a segment, 1e-12 beside it", _gradient_of_a_segment, 1e-12),
    ):
        made.append(Case("winding", name, run, bound))
    for point in ((1, 1), (1, 1 + 1e-320)):
        call = partial(gwn_gradient, SEGMENT, [(0, 0), point])
        words = "points: expected points off the ends of open chains"
        made.append(refusal("winding", f"gradient at an open end [{point[1]}]", call, words))
    made += [
        refusal("winding", "a black box", partial(gwn, box, [(0, 0)]), "curve: control needs the pieces"),
        refusal("winding", "a query that is no number", partial(gwn, SQUARE, [(0, 0), (np.nan, 0)]),
                "points: expected finite numbers, got nan"),
        refusal("winding", "a query of the wrong shape", partial(gwn, SQUARE, (0.5, 0.5)),
                r"points: expected shape \(m, 2\)"),
    ]  # fmt: skip
    return made
