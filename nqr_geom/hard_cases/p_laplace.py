"""Finite elements where naive code breaks: p-harmonic functions and Laplace problems on meshes.

Truths are closed forms: affine functions, the polar angle about a point outside (p-harmonic for every p), powers of the
distance from there, harmonic polynomials, Bessel functions of scipy on discs, and symmetry.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from shapely import Polygon

from nqr_geom.fem.linear import laplace
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.fem.space import NotConverged
from nqr_geom.hard_cases.case import Case, deviation, refusal
from nqr_geom.hard_cases.laplace import CHANNEL, ELL, UNIT
from nqr_geom.hard_cases.shapes import Floats, ring

__all__ = ["cases"]

OUTSIDE = np.array([-0.3, -0.2])
INNER = np.random.default_rng(1).uniform(0.02, 0.98, (200, 2))
EXPONENTS = (1.05, 1.2, 2.0, 3.0, 10.0, 50.0)


def _affine(x: Floats) -> Floats:
    return np.asarray(3.0 - x[:, 0] + 2.0 * x[:, 1])


def _angle(x: Floats) -> Floats:
    return np.arctan2(x[:, 1] - OUTSIDE[1], x[:, 0] - OUTSIDE[0])


def _saddle(x: Floats) -> Floats:
    return np.asarray((x[:, 0] - 0.5) * (x[:, 1] - 0.5))


def _radial(p: float, x: Floats) -> Floats:
    away = np.hypot(*(x - OUTSIDE).T)
    return np.asarray(np.log(away) if p == 2.0 else away ** ((p - 2.0) / (p - 1.0)))


def _two_affine(p: float) -> float:
    """Exact in linear and in quadratic elements, on the square and on the L-shape with values at its vertices."""
    square, ell = p_laplace(UNIT, _affine, p, n=400), p_laplace(ELL, _affine(ELL), p, n=400, order=2)
    return max(deviation(found(INNER), _affine(INNER)) for found in (square, ell))


def _constant(p: float, value: float) -> float:
    return deviation(p_laplace(UNIT, np.full(4, value), p, n=200)(INNER), value)


def _constant_laplace(value: float, order: int) -> float:
    return deviation(laplace(ELL, lambda x: np.full(len(x), value), n=200, order=order)(INNER), value)


def _exact(truth: Callable[[Floats], Floats], p: float, order: int, unit: float = 1.0) -> float:
    return deviation(p_laplace(UNIT, truth, p, n=2000, order=order)(INNER), truth(INNER), unit)


def _linear_instead(truth: Callable[[Floats], Floats], unit: float = 1.0) -> float:
    """Laplace's equation whatever p."""
    return deviation(laplace(UNIT, truth, n=2000)(INNER), truth(INNER), unit)


def _antisymmetry(p: float, order: int) -> float:
    """The saddle xy has no gradient in the middle, changes its sign when mirrored, and is at most 1/4."""
    found = p_laplace(UNIT, _saddle, p, n=1000, order=order)
    if np.abs(found(INNER)).max() > 0.25 + 1e-12:
        return float("inf")
    return deviation(found(INNER), -found(INNER * [-1, 1] + [1, 0]))


def _overshoot(p: float) -> float:
    """How far values leave the range of boundary data that are constant on edges."""
    found = p_laplace(ELL, np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]), p, n=1000, order=1)
    values = found(np.concatenate([INNER, -INNER]), outside="nan")
    return float("nan") if np.isnan(values).any() else float(max(0.0, values.max() - 1.0, -values.min()))


def _near_two(p: float) -> float:
    return deviation(p_laplace(ELL, _angle, p, n=1000)(INNER), laplace(ELL, _angle, n=1000)(INNER))


def _moved(scale: float, shift: float) -> float:
    """Neither shift nor unit matters."""

    def at(x: Any) -> Floats:
        return np.asarray(np.asarray(x) * scale + shift * min(scale, 1.0))

    values = [0.0, 1.0, -0.5, 2.0]
    return deviation(p_laplace(at(UNIT), values, 3.0, n=400)(at(INNER)), p_laplace(UNIT, values, 3.0, n=400)(INNER))


def _polynomial(outline: Any) -> float:
    """x^2 - y^2 lies in the space of quadratic elements: any mesh of the square gives it."""
    found = laplace(outline, lambda x: x[:, 0] ** 2 - x[:, 1] ** 2, n=300)
    return deviation(found(INNER), INNER[:, 0] ** 2 - INNER[:, 1] ** 2)


def _jump(kind: str) -> float:
    """1 on the upper edge of a square: 1/4 in the middle, with the jump at two vertices and with a function."""
    middle = [[0.5, 0.5]]
    if kind == "vertices":
        return deviation(laplace(np.repeat(UNIT, 2, axis=0), [0, 0, 0, 0, 0, 1, 1, 0], n=2000)(middle), 0.25)
    found = laplace(UNIT, lambda x: np.where(x[:, 1] == 1.0, 1.0, 0.0), tol=1e-5, points=middle, n=500)
    return deviation(found(middle), 0.25)


def _annulus(m: int, turned: bool) -> float:
    hole = ring(m)[::-1] if turned else ring(m)
    found = laplace(Polygon(ring(m, 2.0), [hole]), lambda x: np.round(np.hypot(*x.T)) - 1.0, n=4000)
    r = np.array([1.1, 1.5, 1.9])
    return deviation(found(np.stack([r, 0.1 * r], axis=1) / np.hypot(1, 0.1)), np.log(r) / np.log(2.0), 1.0 / m**2)


def _disc(m: int) -> float:
    found, r = laplace(ring(m), np.zeros(m), source=1.0, n=4000), np.array([0.0, 0.5, 0.9])
    return deviation(found(np.stack([0 * r, r], axis=1)), 0.25 * (1 - r**2), 1.0 / m**2)


def _screened(screening: float) -> float:
    """In units of k/m^2 while the layer at the rim is wider than an edge of the polygon, absolute beyond."""
    from scipy.special import ive

    m, k, r = 256, np.sqrt(screening), np.array([0.0, 0.5, 0.9])
    found = laplace(ring(m), np.ones(m), screening=screening, n=8000)
    truth = ive(0, k * r) / ive(0, k) * np.exp(k * (r - 1.0))
    return deviation(found(np.stack([r, 0 * r], axis=1)), truth, 4.0 * k / m**2 if k < 50 else 1e-2)


def _channel() -> float:
    """Ten long, a hundredth wide: linear between its ends."""
    x = np.array([[0.1, 0.005], [5.0, 0.001], [9.99, 0.0099]])
    return deviation(laplace(CHANNEL, [0, 10, 10, 0], n=500)(x), x[:, 0])


def _said(call: Callable[[], object], words: str) -> float:
    """Not converging is said with numbers."""
    try:
        call()
    except NotConverged as caught:
        return 0.0 if re.search(words, str(caught)) else float("inf")
    return float("inf")


DIRTY: dict[str, Any] = {
    "clean": UNIT,
    "clockwise": UNIT[::-1],
    "repeated vertices": np.repeat(UNIT, 2, axis=0),
    "first vertex again at the end": np.concatenate([UNIT, UNIT[:1]]),
    "collinear vertices": np.array([[0, 0], [0.3, 0], [0.30001, 0], [1, 0], [1, 0.5], [1, 1], [0, 1]]),
    "shapely": Polygon(UNIT),
}

_BAD: tuple[tuple[str, Any, type[Exception], str], ...] = (
    ("two vertices", [[0, 0], [1, 0]], ValueError, "at least 3 distinct vertices"),
    ("one place", [[1, 1]] * 5, ValueError, "extent"),
    ("a line", [[0, 0], [1, 1], [2, 2]], ValueError, "polygon"),
    ("bowtie", [[0, 0], [1, 1], [1, 0], [0, 1]], ValueError, "Self-intersection"),
    ("there and back", [[0, 0], [2, 0], [1, 0], [1, 1]], ValueError, "polygon"),
    ("no number", [[0, 0], [1, 0], [np.nan, 1]], ValueError, "polygon: expected finite"),
    ("no polygon", Polygon(), TypeError, "polygon"),
    ("a shift that eats it", 1e12 + 1e-6 * UNIT, ValueError, "polygon"),
)


def cases() -> list[Case]:
    """p-harmonic functions, and Laplace problems by finite elements."""
    group, made = "p_laplace", []

    def add(name: str, run: Callable[[], float], bound: float, naive: Callable[[], float] | None = None) -> None:
        made.append(Case(group, name, run, bound, naive))

    for p in EXPONENTS:
        add(f"affine data [p {p:g}]", partial(_two_affine, p), 1e-12)
        for value in (0.0, 0.1, -1e200, 1e-300):
            add(f"constant data [{value:g}, p {p:g}]", partial(_constant, p, value), 0.0)
        add(f"polar angle [p {p:g}]", partial(_exact, _angle, p, 2), 2e-4 if p == 50.0 else 4e-5)
        add(f"saddle without a gradient in its middle [p {p:g}]", partial(_antisymmetry, p, 1), 4e-3)
        add(f"flat parts of the boundary [p {p:g}]", partial(_overshoot, p), 1e-12)
    for p in (1.2, 3.0, 10.0):
        add(f"saddle without a gradient in its middle [p {p:g}, quadratic]", partial(_antisymmetry, p, 2), 4e-3)
    for p in (1.2, 3.0, 10.0, 50.0):
        truth = partial(_radial, p)
        unit = float(np.ptp(truth(UNIT)))
        run, naive = partial(_exact, truth, p, 1, unit), partial(_linear_instead, truth, unit)
        add(f"power of the distance [p {p:g}]", run, 4e-3, naive)
    add("p = 2 is Laplace's equation", partial(_near_two, 2.0), 1e-12)
    add("p next to 2", partial(_near_two, 2.0 + 1e-9), 1e-8)
    for value in (0.1, -1e200, 1e-300):
        for order in (1, 2):
            add(
                f"constant data of Laplace's equation [{value:g}, {order}]",
                partial(_constant_laplace, value, order),
                0.0,
            )
    for scale in (1e-6, 1.0, 1e6):
        for shift in (0.0, 1e6):
            add(f"moved and scaled [{scale:g}, {shift:g}]", partial(_moved, scale, shift), 1e-9)
    for name, outline in DIRTY.items():
        add(f"outline: {name}", partial(_polynomial, outline), 1e-12)
    add("jump given at vertices", partial(_jump, "vertices"), 1e-5)
    add("jump given by a function", partial(_jump, "function"), 1e-5)
    for m in (64, 256):
        for turned in (False, True):
            add(f"annulus{', hole turned' * turned} [{m}]", partial(_annulus, m, turned), 8.0)
        add(f"source on a disc [{m}]", partial(_disc, m), 2.0)
    for screening in (1.0, 100.0, 1e4, 1e8):
        add(f"screening on a disc [{screening:g}]", partial(_screened, screening), 1.0)
    add("channel", _channel, 1e-10)
    dear = partial(laplace, UNIT, _angle, tol=1e-12, n=200, max_triangles=2000)
    words = r"estimated error \d.* > tol = 1.00e-12 with \d+ triangles"
    add("a tolerance out of reach is said", partial(_said, dear, words), 0.0)
    for p in (1.0, 0.5, -3.0, np.nan, np.inf):
        made.append(
            refusal(
                group, f"p that makes no sense [{p}]", partial(p_laplace, UNIT, _angle, p), "p: expected a number > 1"
            )
        )
    for name, outline, error, words in _BAD:
        made.append(refusal(group, f"outline: {name}", partial(laplace, outline, lambda x: x[:, 0]), words, error))
    return made
