"""Gradients of harmonic functions by walks: known gradients, error bars, and what the variates are worth."""

from __future__ import annotations

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import queries

ANGLE = 2 * np.pi * np.arange(19) / 19
STAR = (0.7 + 0.25 * np.cos(7 * ANGLE + 0.3))[:, None] * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)
POINTS = queries(Domain.of(STAR), 20, 0)
VARIATES = ("none", "control", "antithetic", "both")


def cubic(p):
    """Re z^3 + 2x + 5."""
    return p[:, 0] ** 3 - 3 * p[:, 0] * p[:, 1] ** 2 + 2 * p[:, 0] + 5


def slope(p):
    return np.stack([3 * p[:, 0] ** 2 - 3 * p[:, 1] ** 2 + 2, -6 * p[:, 0] * p[:, 1]], axis=1)


@pytest.mark.parametrize("variates", VARIATES)
def test_gradients_of_a_cubic_within_their_error_bars(variates):
    got = ng.laplace_gradient(STAR, cubic, POINTS, n=3000, variates=variates, epsilon=1e-5, full_output=True)
    off = np.abs(got.value - slope(POINTS)) / got.stderr
    assert off.max() < 4.5  # 40 numbers
    assert 0.5 < np.sqrt((off**2).mean()) < 1.4
    assert got.counts["walks_boundary"] == 3000 * len(POINTS)


def test_what_the_variates_are_worth():
    """With 5 added to the function, taking the level off saves a factor of 50 and more in the mean squared error."""
    mse = {
        v: np.median(
            [
                (ng.laplace_gradient(STAR, cubic, POINTS, n=32, variates=v, seed=k) - slope(POINTS)) ** 2
                for k in range(8)
            ]
        )
        for v in VARIATES
    }
    assert mse["none"] > 40.0 * max(mse["control"], mse["antithetic"], mse["both"])


def test_lengths_shifts_and_rows_change_nothing():
    one = ng.laplace_gradient(STAR, cubic, POINTS, n=64)
    far = ng.laplace_gradient(100.0 * STAR + 7.0, lambda p: cubic((p - 7.0) / 100.0), 100.0 * POINTS + 7.0, n=64)
    np.testing.assert_allclose(100.0 * far, one, rtol=1e-6, atol=1e-6)
    some = ng.laplace_gradient(STAR, cubic, np.insert(POINTS, 3, [9.0, 9.0], axis=0), n=64, outside="nan")
    np.testing.assert_array_equal(some[:3], one[:3])
    assert np.isnan(some[3]).all()


def test_constants_have_no_gradient():
    for variates in ("control", "antithetic", "both"):
        got = ng.laplace_gradient(STAR, np.full(19, 1e8), POINTS, n=16, variates=variates)
        assert np.abs(got).max() == 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"variates": "some"}, "variates: expected one of both, antithetic, control, none"),
        ({"n": 1}, "n: "),
        ({"points": [[9.0, 0.0]]}, "points: expected points inside"),
        ({"points": [STAR[0]]}, "points: expected points off the edge"),
        ({"points": [[np.nan, 0.0]]}, "points: expected finite"),
    ],
)
def test_bad_input_is_refused_by_name(change, words):
    with pytest.raises(ValueError, match=words):
        ng.laplace_gradient(**{"polygon": STAR, "boundary": cubic, "points": POINTS, **change})
