"""Smoothed distances that break naive code: name, curve, alpha, queries, expected values, unit, tolerance in that unit.

Values are closed forms (segments seen from their own line, circles from their centre, long lines by Bessel functions of
scipy) or scipy's adaptive quadrature of the distance along a curve.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.distance import distance
from nqr_geom.curves.smooth import sd, sd_gradient
from nqr_geom.hard_cases.case import Case, deviation, refusal
from nqr_geom.hard_cases.distance import ARCH, CUSP, LINE_AS_CUBIC, OVERSHOOT, POINT, SEGMENT
from nqr_geom.hard_cases.shapes import SQUARE, Floats, circle_of_cubics, joined, pieces, scaled

__all__ = ["TABLE", "Row", "cases"]


class Row(NamedTuple):
    """One curve with its queries."""

    name: str
    curve: Curve
    alpha: float
    points: Any
    expected: Any
    tolerance: float
    unit: float = 1.0


_BEYOND = -np.log(-np.expm1(-140) / 35) / 35  # of a segment of length 4, from its end, alpha = 35
_MIDDLE = -np.log(-2 * np.expm1(-70) / 35) / 35  # from its middle
_AWAY = (0, 1e-9, 1, 1e6)

_ROWS: list[tuple[Any, ...]] = [
    ("segment from its middle", SEGMENT, 35.0, [(2, 0)], [_MIDDLE], 1e-15),
    ("from its end, any distance", SEGMENT, 35.0, [(-d, 0) for d in _AWAY], [d + _BEYOND for d in _AWAY], 1e-10),
    ("a line dressed as a cubic, handles drawn in", LINE_AS_CUBIC, 35.0, [(-1, 0), (2, 0)], [1 + _BEYOND, _MIDDLE],
     1e-13),
    ("far beyond the paper's clamp", SEGMENT, 35.0, [(-100, 0)], [100 + _BEYOND], 1e-13),
    ("a circle from its centre", circle_of_cubics(256, radius=2.0), 35.0, [(0, 0)],
     [2 - np.log(4 * np.pi) / 35], 1e-11),
    ("alpha to 0: -ln L", SEGMENT, 1e-9, [(3, 1)], [-np.log(4) / 1e-9], 1e-8, 1e9),
    ("alpha to infinity: the distance", SEGMENT, 1e15, [(2, 1), (-3, 4)], [1, 5], 1e-12),
    ("alpha beyond the resolution of a parameter", SEGMENT, 1e30, [(2, 0), (0, 0)],
     [np.log(0.5e30) / 1e30, np.log(1e30) / 1e30], 1e-10, 1e-30),
    ("repeated points", Curve.polyline([(0, 0), (0, 0), (4, 0), (4, 0)]), 35.0, [(-1, 0)], [1 + _BEYOND], 1e-15),
    ("there and back: twice the length", Curve.polyline([(0, 0), (4, 0), (0, 0)]), 35.0, [(-1, 0)],
     [1 - np.log(-2 * np.expm1(-140) / 35) / 35], 1e-15),
    ("a thousand segments in one place", joined(*[SEGMENT] * 1000), 35.0, [(-1, 0)], [1 + _BEYOND - np.log(1000) / 35],
     1e-13),
    ("a segment one bit long", Curve.polyline([(1, 0), (np.nextafter(1, 2), 0)]), 35.0, [(0, 0)],
     [1 - np.log(np.spacing(1.0)) / 35], 1e-15),
    ("shift 1e6", scaled(SEGMENT, 1, 1e6), 35.0, [(1e6 - 1, 1e6)], [1 + _BEYOND], 1e-9),
    *((f"segment [scale {s:g}]", scaled(SEGMENT, s), 35.0 / s, [(-s, 0)],
       [s - s * np.log(-np.expm1(-140) / 35 * s) / 35], 1e-12, s) for s in (1e-6, 1e6, 1e-170, 1e160, 1e299)),
    ("absurdly far", SEGMENT, 35.0, [(0, 1e300), (-1e200, 0)], [1e300, 1e200], 1e-15, 1e300),
    ("a speck before a mountain", Curve.polyline([(0, 0), (1e-9, 0)]) + Curve.polyline([(1, -1), (1, 1)]), 1e3,
     [(0, 0)], [-np.log(-np.expm1(-1e-6) / 1e3) / 1e3], 1e-12),
]  # fmt: skip
TABLE = [Row(*row) for row in _ROWS]


def naive_sd(curve: Curve, alpha: float, points: Floats) -> Floats:
    """Points along the curve, exponentials as they are, and the paper's clamp before the logarithm (Eq. 56)."""
    s = (np.arange(4096) + 0.5) / 4096
    with np.errstate(all="ignore"):
        x, speed = curve.sample(s), np.hypot(*curve.derivative(s).T)
        values = [np.mean(np.exp(-alpha * np.hypot(*(x - p).T)) * speed) for p in points]
    return np.array(-np.log(np.maximum(values, 1e-8)) / alpha)


def _error(row: Row, formula: Any) -> float:
    return deviation(formula(row.curve, row.alpha, np.array(row.points, dtype=float)), row.expected, row.unit)


def _exact(curve: Curve, alpha: float, points: Floats) -> Floats:
    return sd(curve, points, alpha)


def _long_line(part: str) -> float:
    """Of a line: I = 2 d K1(alpha d), and the derivative of sd is K0 / K1."""
    from scipy.special import kve

    line, alpha = Curve.polyline([(-1e3, 0), (1e3, 0)]), 35.0
    d = np.array([1e-6, 1e-3, 0.03, 1.0, 30.0])
    points = np.stack([np.zeros(5), d], axis=1)
    if part == "gradient":
        return deviation(sd_gradient(line, points, alpha)[:, 1], kve(0, alpha * d) / kve(1, alpha * d))
    return deviation(sd(line, points, alpha), d - np.log(2 * d * kve(1, alpha * d)) / alpha)


def _by_quadrature(control: Any, alpha: float) -> float:
    """One curved piece against scipy's quadrature, the smallest distance taken out."""
    from scipy.integrate import quad

    curve = pieces([control])
    points = np.random.default_rng(4).uniform(-1, 2, (8, 2))
    truth = []
    for p, nearest in zip(points, distance(curve, points), strict=True):

        def density(t: float, p: Floats = p, nearest: float = nearest) -> float:
            away = np.hypot(*(curve.sample([t])[0] - p)) - nearest
            return float(np.exp(-alpha * away) * np.hypot(*curve.derivative([t])[0]))

        mass = sum(quad(density, a, b, epsabs=0.0, epsrel=1e-11, limit=400)[0] for a, b in ((0, 0.5), (0.5, 1 - 1e-16)))
        truth.append(nearest - np.log(mass) / alpha)
    return deviation(sd(curve, points, alpha), truth)


_CURVES = {"square": SQUARE, "arch": ARCH, "cusp": CUSP, "overshoot": OVERSHOOT, "line as cubic": LINE_AS_CUBIC}


def _between_bounds(curve: Curve, alpha: float) -> float:
    """How far d_min - ln(L)/alpha <= sd <= d_max - ln(L)/alpha is missed by more than 1e-9 + 1e-12/alpha."""
    away = np.array([0.0, 1e-12, 1e-9, 1e-3, 1.0, 1e3, 1e6])
    points = np.concatenate([curve.sample([0.0, 0.3, 0.5, 1.0]) + d * np.array([0.6, 0.8]) for d in away])
    value, nearest = sd(curve, points, alpha), distance(curve, points)
    gradient = sd_gradient(curve, points, alpha)
    if not (np.isfinite(value).all() and np.isfinite(gradient).all()):
        return float("nan")
    low = nearest - np.log(curve.length) / alpha
    missed = np.maximum(low - value, value - low - curve.length) - 1e-9 - 1e-12 / alpha
    return float(max(0.0, missed.max(), np.hypot(*gradient.T).max() - 1.0 - 1e-12))


_SPREAD = np.random.default_rng(9).uniform(-2, 3, (60, 2))


def _union() -> float:
    """exp(-alpha sd) of a union is the sum of its parts'."""
    alpha = 5.0
    parts = [np.exp(-alpha * sd(part, _SPREAD, alpha)) for part in (SQUARE, CUSP, ARCH)]
    return deviation(np.exp(-alpha * sd(joined(SQUARE, CUSP, ARCH), _SPREAD, alpha)) / sum(parts), np.ones(60))


def _scaling() -> float:
    """Scaled by s: s sd_{alpha s} - ln(s) / alpha."""
    s, alpha = 1e3, 0.035
    return deviation(sd(scaled(CUSP, s), s * _SPREAD, alpha), s * sd(CUSP, _SPREAD, alpha * s) - np.log(s) / alpha, s)


def _reversed() -> float:
    curve = joined(ARCH, CUSP, OVERSHOOT)
    return deviation(sd(curve.reversed(), _SPREAD, 35.0), sd(curve, _SPREAD, 35.0))


def _specks() -> float:
    """A point of no length, however near, counts for nothing."""
    query = [(100, 200)]
    return deviation(sd(SEGMENT + scaled(POINT, 100), query, 35.0), sd(SEGMENT, query, 35.0))


_NAIVE = {
    "from its end, any distance",
    "far beyond the paper's clamp",
    "alpha to infinity: the distance",
    "alpha beyond the resolution of a parameter",
    "absurdly far",
    "a speck before a mountain",
    "segment [scale 1e299]",
}


def cases() -> list[Case]:
    """Smoothed distances and their gradients."""
    group = "smoothed"
    made = []
    for row in TABLE:
        naive = partial(_error, row, naive_sd) if row.name in _NAIVE else None
        made.append(Case(group, row.name, partial(_error, row, _exact), row.tolerance, naive))
    for alpha in (1e-3, 1.0, 1e3, 1e6):
        for name, curve in _CURVES.items():
            words = f"bounds from 0 to 1e6 away: {name} [alpha {alpha:g}]"
            made.append(Case(group, words, partial(_between_bounds, curve, alpha), 0.0))
    for name, run, bound in (
        ("long line: Bessel functions", partial(_long_line, "value"), 1e-12),
        ("long line: gradient", partial(_long_line, "gradient"), 1e-9),
        ("cusp by quadrature", partial(_by_quadrature, [[0, 0], [1, 1], [0, 1], [1, 0]], 35.0), 1e-9),
        ("loop by quadrature", partial(_by_quadrature, [[0, 0], [3, 2], [-2, 2], [1, 0]], 35.0), 1e-9),
        ("overshoot by quadrature", partial(_by_quadrature, [[0, 0], [4, 0], [1, 0]], 35.0), 1e-9),
        ("a union adds up", _union, 1e-9),
        ("scaling law", _scaling, 1e-12),
        ("reversal changes nothing", _reversed, 1e-10),
        ("a point of no length counts for nothing", _specks, 1e-12),
    ):
        made.append(Case(group, name, run, bound))
    for name, curve in (("no curve", Curve.polyline([])), ("a curve of no length", POINT)):
        made.append(refusal(group, name, partial(sd, curve, [(0, 0)]), "curve: expected a positive length, got 0"))
    for alpha in (0.0, -1.0, np.nan, np.inf):
        call = partial(sd, SEGMENT, [(0, 0)], alpha)
        made.append(refusal(group, f"alpha that makes no sense [{alpha}]", call, "alpha: expected a number > 0"))
    call = partial(sd, SEGMENT, [(0, 0)], 1e-320)
    made.append(refusal(group, "a value beyond float64", call, r"alpha: expected a smoothed distance below 1\.8e308"))
    return made
