"""Finite elements where naive code breaks: name, problem, truth, tolerance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ive
from shapely import Polygon

from nqr_geom.fem.linear import laplace
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.fem.space import NotConverged

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
L_SHAPE = np.array([[0.0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1]])
OUTSIDE = np.array([-0.3, -0.2])
INNER = np.random.default_rng(1).uniform(0.02, 0.98, (200, 2))
P = (1.05, 1.2, 2.0, 3.0, 10.0, 50.0)


def ngon(m, r=1.0):
    angle = 2.0 * np.pi * np.arange(m) / m
    return r * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def angle(x):
    return np.arctan2(x[:, 1] - OUTSIDE[1], x[:, 0] - OUTSIDE[0])


def saddle(x):
    return (x[:, 0] - 0.5) * (x[:, 1] - 0.5)


@pytest.mark.parametrize("p", P)
def test_affine_data_are_exact(p):
    def affine(x):
        return 3.0 - x[:, 0] + 2.0 * x[:, 1]

    found = p_laplace(SQUARE, affine, p, n=400)
    np.testing.assert_allclose(found(INNER), affine(INNER), atol=1e-12)
    found = p_laplace(L_SHAPE, affine(L_SHAPE), p, n=400, order=2)
    np.testing.assert_allclose(found(INNER), affine(INNER), atol=1e-12)


@pytest.mark.parametrize("p", P)
@pytest.mark.parametrize("value", [0.0, 0.1, -1e200, 1e-300])
def test_constant_data_are_exact(p, value):
    assert (p_laplace(SQUARE, np.full(4, value), p, n=200)(INNER) == value).all()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("value", [0.1, -1e200, 1e-300])
def test_constant_data_are_exact_for_laplace(value, order):
    assert (laplace(L_SHAPE, lambda x: np.full(len(x), value), n=200, order=order)(INNER) == value).all()


@pytest.mark.parametrize("p", P)
def test_polar_angle_is_p_harmonic_for_every_p(p):
    found = p_laplace(SQUARE, angle, p, n=2000, order=2)
    np.testing.assert_allclose(found(INNER), angle(INNER), atol=2e-4 if p == 50.0 else 4e-5)


def radial(p):
    return lambda x: np.hypot(*(x - OUTSIDE).T) ** ((p - 2.0) / (p - 1.0))


@pytest.mark.parametrize("p", [1.2, 3.0, 10.0, 50.0])
def test_radial_solution(p):
    truth = radial(p)
    found = p_laplace(SQUARE, truth, p, n=2000, order=1)
    np.testing.assert_allclose(found(INNER), truth(INNER), atol=4e-3 * np.ptp(truth(SQUARE)))


@pytest.mark.parametrize(("p", "order"), [*((p, 1) for p in P), (1.2, 2), (3.0, 2), (10.0, 2)])
def test_vanishing_gradient(p, order):
    """The saddle xy has none in the middle, and keeps its symmetry for every p."""
    found = p_laplace(SQUARE, saddle, p, n=1000, order=order)
    values = found(INNER)
    assert np.isfinite(values).all()
    np.testing.assert_allclose(values, -found(INNER * [-1, 1] + [1, 0]), atol=4e-3)
    assert np.abs(values).max() <= 0.25 + 1e-12


@pytest.mark.parametrize("p", P)
def test_flat_parts_of_the_boundary(p):
    """No maximum inside: linear elements on a Delaunay mesh keep to it."""
    found = p_laplace(L_SHAPE, np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]), p, n=1000, order=1)
    values = found(np.concatenate([INNER, -INNER]), outside="nan")
    inside = np.isfinite(values)
    assert inside.all()
    assert values.min() >= -1e-12
    assert values.max() <= 1.0 + 1e-12


def test_p_2_equals_laplace():
    one, two = p_laplace(L_SHAPE, angle, 2.0, n=1000), laplace(L_SHAPE, angle, n=1000)
    np.testing.assert_allclose(one(INNER), two(INNER), atol=1e-12)
    near = p_laplace(L_SHAPE, angle, 2.0 + 1e-9, n=1000)
    np.testing.assert_allclose(near(INNER), two(INNER), atol=1e-8)


@pytest.mark.parametrize("p", [1.0, 0.5, -3.0, np.nan, np.inf])
def test_p_that_makes_no_sense_is_refused(p):
    with pytest.raises(ValueError, match="p: expected a number > 1"):
        p_laplace(SQUARE, angle, p)


def test_no_convergence_is_said_with_numbers(monkeypatch):
    monkeypatch.setattr("nqr_geom.fem.p_laplace._NEWTON_STEPS", 2)
    with pytest.raises(NotConverged, match=r"on the way to 50 in 2 steps; its last one was \d"):
        p_laplace(SQUARE, angle, 50.0, n=200)
    with pytest.raises(NotConverged, match=r"estimated error \d.* > tol = 1.00e-12 with \d+ triangles"):
        laplace(SQUARE, angle, tol=1e-12, n=200, max_triangles=2000)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_neither_shift_nor_unit_matters(scale, shift):
    def moved(x):
        return np.asarray(x) * scale + shift * min(scale, 1.0)

    values = [0.0, 1.0, -0.5, 2.0]
    here = p_laplace(SQUARE, values, 3.0, n=400)
    there = p_laplace(moved(SQUARE), values, 3.0, n=400)
    np.testing.assert_allclose(there(moved(INNER)), here(INNER), atol=1e-9)


DIRTY = {
    "clean": SQUARE,
    "clockwise": SQUARE[::-1],
    "duplicates": np.repeat(SQUARE, 2, axis=0),
    "closed": np.concatenate([SQUARE, SQUARE[:1]]),
    "collinear": np.array([[0, 0], [0.3, 0], [0.30001, 0], [1, 0], [1, 0.5], [1, 1], [0, 1]]),
    "shapely": Polygon(SQUARE),
}


@pytest.mark.parametrize("name", DIRTY)
def test_dirty_outlines(name):
    """The harmonic x^2 - y^2 lies in the space of quadratic elements: any mesh of the square gives it exactly."""
    found = laplace(DIRTY[name], lambda x: x[:, 0] ** 2 - x[:, 1] ** 2, n=300)
    np.testing.assert_allclose(found(INNER), INNER[:, 0] ** 2 - INNER[:, 1] ** 2, atol=1e-12)


def test_one_on_the_top_edge():
    middle = [[0.5, 0.5]]
    jump = np.repeat(SQUARE, 2, axis=0)
    found = laplace(jump, [0, 0, 0, 0, 0, 1, 1, 0], n=2000)
    np.testing.assert_allclose(found(middle), 0.25, atol=1e-5)
    called = laplace(SQUARE, lambda x: np.where(x[:, 1] == 1.0, 1.0, 0.0), tol=1e-5, points=middle, n=500)
    np.testing.assert_allclose(called(middle), 0.25, atol=1e-5)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("m", [64, 256])
def test_annulus(m, turned):
    hole = ngon(m)[::-1] if turned else ngon(m)
    found = laplace(Polygon(ngon(m, 2.0), [hole]), lambda x: np.round(np.hypot(*x.T)) - 1.0, n=4000)
    r = np.array([1.1, 1.5, 1.9])
    truth = np.log(r) / np.log(2.0)
    np.testing.assert_allclose(found(np.stack([r, 0.1 * r], axis=1) / np.hypot(1, 0.1)), truth, atol=8.0 / m**2)


@pytest.mark.parametrize("m", [64, 256])
def test_source_on_a_disc(m):
    found = laplace(ngon(m), np.zeros(m), source=1.0, n=4000)
    r = np.array([0.0, 0.5, 0.9])
    np.testing.assert_allclose(found(np.stack([0 * r, r], axis=1)), 0.25 * (1 - r**2), atol=2.0 / m**2)


@pytest.mark.parametrize("screening", [1.0, 100.0, 1e4, 1e8])
def test_screening_on_a_disc(screening):
    m, k = 256, np.sqrt(screening)
    found = laplace(ngon(m), np.ones(m), screening=screening, n=8000)
    r = np.array([0.0, 0.5, 0.9])
    truth = ive(0, k * r) / ive(0, k) * np.exp(k * (r - 1.0))
    np.testing.assert_allclose(found(np.stack([r, 0 * r], axis=1)), truth, atol=4.0 * k / m**2 if k < 50 else 1e-2)


def test_channel():
    """Ten long, a hundredth wide: linear between its ends."""
    x = np.array([[0.1, 0.005], [5.0, 0.001], [9.99, 0.0099]])
    found = laplace([[0, 0], [10, 0], [10, 0.01], [0, 0.01]], [0, 10, 10, 0], n=500)
    np.testing.assert_allclose(found(x), x[:, 0], atol=1e-10)


BAD = {
    "two vertices": ([[0, 0], [1, 0]], ValueError, "at least 3 distinct vertices"),
    "one place": ([[1, 1]] * 5, ValueError, "extent"),
    "a line": ([[0, 0], [1, 1], [2, 2]], ValueError, "polygon"),
    "bowtie": ([[0, 0], [1, 1], [1, 0], [0, 1]], ValueError, "Self-intersection"),
    "there and back": ([[0, 0], [2, 0], [1, 0], [1, 1]], ValueError, "polygon"),
    "NaN": ([[0, 0], [1, 0], [np.nan, 1]], ValueError, "polygon: expected finite"),
    "no polygon": (Polygon(), TypeError, "polygon"),
    "a shift that eats it": (1e12 + 1e-6 * SQUARE, ValueError, "polygon"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_polygons_are_refused(name):
    polygon, error, message = BAD[name]
    with pytest.raises(error, match=message):
        laplace(polygon, lambda x: x[:, 0])
