"""Laws of distances and smoothed distances on every curve of the catalogue."""

from __future__ import annotations

import numpy as np
import pytest

from nqr_geom.curves.distance import closest_point, distance, distance_gradient
from nqr_geom.curves.smooth import sd_gradient
from nqr_geom.hard_cases import distance as distances
from nqr_geom.hard_cases import smoothed
from nqr_geom.hard_cases.shapes import SQUARE


@pytest.mark.parametrize("row", distances.TABLE, ids=[row.name for row in distances.TABLE])
def test_closest_points_and_gradients_agree_with_the_distance(row):
    found = closest_point(row.curve, row.points)
    np.testing.assert_allclose(found.distance, distance(row.curve, row.points), rtol=1e-15)
    gap = np.hypot(*(np.array(row.points, dtype=float) - found.point).T)
    slack = max(row.tolerance * row.unit, 1e-15 * np.abs(row.points).max())
    np.testing.assert_allclose(found.distance, gap, rtol=1e-12, atol=slack)
    assert ((found.t >= 0) & (found.t <= 1) & (found.piece >= 0) & (found.piece < len(row.curve))).all()
    length = np.hypot(*distance_gradient(row.curve, row.points).T)
    np.testing.assert_allclose(length, (found.distance > 0) * 1.0, atol=1e-15)


@pytest.mark.parametrize("row", smoothed.TABLE, ids=[row.name for row in smoothed.TABLE])
def test_gradients_of_smoothed_distances_are_no_longer_than_one(row):
    assert (np.hypot(*sd_gradient(row.curve, row.points, row.alpha).T) <= 1 + 1e-12).all()


def test_no_queries():
    assert distance(SQUARE, np.empty((0, 2))).shape == (0,)


def test_the_clamped_logarithm_saturates_where_the_paper_says():
    far = smoothed.naive_sd(smoothed.SEGMENT, 35.0, np.array([[-2.0, 0.0]]))
    assert abs(far[0] - 0.526) < 1e-3
