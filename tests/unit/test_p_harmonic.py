"""The public door to p-harmonic functions."""

from __future__ import annotations

import numpy as np
import pytest
from shapely import Polygon

import nqr_geom as ng

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
INNER = np.random.default_rng(0).uniform(0.05, 0.95, (50, 2))


def angle(x: np.ndarray) -> np.ndarray:
    return np.arctan2(x[:, 1] + 0.2, x[:, 0] + 0.3)


def test_polygons_of_every_kind_give_the_same_answer() -> None:
    curve = ng.Curve.polyline(SQUARE, closed=True)
    for polygon in (SQUARE, SQUARE[::-1].tolist(), Polygon(SQUARE), curve):
        np.testing.assert_allclose(ng.solve_p_laplace(polygon, angle, INNER), angle(INNER), atol=2e-6)


def test_a_curve_with_a_hole() -> None:
    ring = ng.Curve.from_text("o")
    xmin, ymin, xmax, ymax = ring.bounds
    middle = np.array([[0.5 * (xmin + xmax), 0.5 * (ymin + ymax)], [xmax - 1e-6, 0.5 * (ymin + ymax)]])
    found = ng.solve_p_laplace(ring, lambda x: x[:, 1], middle, p=5.0, outside="nan")
    assert np.isnan(found).tolist() == [True, False]
    assert found[1] == pytest.approx(middle[1, 1], abs=1e-9)


def test_full_output_says_how_good_it_is() -> None:
    estimate = ng.solve_p_laplace(SQUARE, angle, INNER, 3.0, tol=1e-5, full_output=True)
    assert estimate.stderr is None
    assert estimate.plan["rule"] == "fem"
    assert estimate.plan["newton_steps"] > 2
    error = np.abs(estimate.value[:, 0] - angle(INNER)).max()
    assert error < estimate.plan["error"] <= 1e-5
    np.testing.assert_array_equal(estimate.value[:, 0], ng.solve_p_laplace(SQUARE, angle, INNER, 3.0, tol=1e-5))


def test_points_outside_are_nan_where_asked() -> None:
    places = np.concatenate([INNER, [[2.0, 2.0]]])
    estimate = ng.solve_p_laplace(SQUARE, angle, places, tol=1e-4, outside="nan", full_output=True)
    assert np.isnan(estimate.value[:, 0]).tolist() == [False] * 50 + [True]
    assert estimate.plan["error"] <= 1e-4


BAD = {
    "method": (
        lambda: ng.solve_p_laplace(SQUARE, angle, INNER, method="magic"),
        "method: expected one of fem, inet, got",
    ),
    "p": (lambda: ng.solve_p_laplace(SQUARE, angle, INNER, 1), "p: expected a number > 1"),
    "outside": (lambda: ng.solve_p_laplace(SQUARE, angle, [[0.5, 0.5], [2, 2]]), "inside the polygon.*at row 1"),
    "points": (lambda: ng.solve_p_laplace(SQUARE, angle, [[np.nan, 0]]), "points: expected finite"),
    "open curve": (lambda: ng.solve_p_laplace(ng.Curve.polyline(SQUARE), angle, INNER), "polygon: expected a closed"),
    "values on a curve": (
        lambda: ng.solve_p_laplace(ng.Curve.polyline(SQUARE, closed=True), [1, 2, 3, 4], INNER),
        "boundary: expected a callable",
    ),
    "n": (lambda: ng.solve_p_laplace(SQUARE, angle, INNER, n=0), "n: expected an integer >= 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_named(name: str) -> None:
    call, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        call()
