"""Domains: what is accepted, where the nearest point lies, and that shift and scale do not matter."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

import nqr_geom as ng
from nqr_geom.wos.domain import Domain

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
RNG = np.random.default_rng(0)


def rough(n: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(n) / n
    radius = 0.8 + 0.15 * np.sin(7 * angle) + 0.05 * RNG.random(n)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("n", [3, 19, 286, 1500])
@pytest.mark.parametrize("hole", [False, True])
def test_closest_points_and_inside_are_shapelys(n, hole):
    ring = rough(n)
    shape = shapely.Polygon(ring, [0.2 * ring[::-1] + 0.01] if hole else [])
    points = RNG.uniform(-1.3, 1.3, (2000, 2))
    domain = Domain.of(shape)
    found = domain.closest(points)
    np.testing.assert_allclose(found.distance, shapely.distance(shape.boundary, shapely.points(points)), atol=1e-14)
    np.testing.assert_allclose(np.hypot(*(found.point - points).T), found.distance, atol=1e-14)
    np.testing.assert_array_equal(domain.inside(points), shapely.contains_xy(shape, points))
    at = domain.from_frame(domain.at(found.edge, found.t))
    np.testing.assert_allclose(at, found.point, atol=1e-15)


def test_arc_length_runs_along_the_outline():
    found = Domain.of(SQUARE).closest([[0.25, 0.01], [0.99, 0.5], [0.01, 0.75]])
    np.testing.assert_allclose(found.arc_length, [0.25, 1.5, 3.25])


@pytest.mark.parametrize("shift", [0.0, 1e6])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_shift_and_scale_do_not_matter(shift, scale):
    ring, points = rough(19), RNG.uniform(-1, 1, (200, 2))
    plain = Domain.of(ring).closest(points)
    moved = Domain.of(scale * ring + shift * scale).closest(scale * points + shift * scale)
    np.testing.assert_allclose(moved.distance / scale, plain.distance, atol=1e-9)


def test_repeats_and_either_orientation():
    for ring in (SQUARE, SQUARE[::-1], [[0, 0], [0, 0], [0.5, 0], [1, 0], [1, 1], [1, 1], [0, 1], [0, 0]]):
        domain = Domain.of(ring)
        assert (domain.lengths > 0).all()
        assert domain.inside([[0.5, 0.5]]).all()
        cross = np.linalg.det(np.stack([domain.start, domain.start[domain.following]], axis=1)).sum()
        assert cross > 0  # the domain is on the left
    for hole in ([[0.4, 0.4], [0.6, 0.4], [0.5, 0.6]], [[0.5, 0.6], [0.6, 0.4], [0.4, 0.4]]):
        assert Domain.of(shapely.Polygon(SQUARE, [hole])).inside([[0.5, 0.5], [0.1, 0.1], [0.5, 0.4]]).tolist() == [
            False,
            True,
            True,
        ]


def test_values_follow_their_vertices():
    values = np.array([1.0, 2.0, 3.0, 4.0])
    for ring, given in ((SQUARE, values), (SQUARE[::-1], values[::-1])):
        domain = Domain.of(ring)
        boundary = domain.boundary(given)
        found = domain.closest([[0.5, 0.0], [1.0, 0.25], [0.0, 0.5]])
        np.testing.assert_allclose(boundary.at(found.edge, found.t), [1.5, 2.25, 2.5])
    # A vertex given twice may jump.
    jump = Domain.of([[0, 0], [1, 0], [1, 0], [1, 1], [0, 1]])
    boundary = jump.boundary([0.0, 0.0, 8.0, 8.0, 0.0])
    found = jump.closest([[0.75, 0.0], [1.0, 0.25]])
    np.testing.assert_allclose(boundary.at(found.edge, found.t), [0.0, 8.0])


def test_a_curve_is_flattened_to_what_is_stated():
    k = 4 / 3 * np.tan(np.pi / 8)
    arcs = np.array([[[1, 0], [1, k], [k, 1], [0, 1]]])
    turn = np.array([[0, -1], [1, 0]])
    circle = ng.Curve.bezier(np.concatenate([arcs @ np.linalg.matrix_power(turn, i).T for i in range(4)]))
    domain = Domain.of(circle)
    edge = np.linspace(0, 2 * np.pi, 1000)
    assert domain.closest(np.stack([np.cos(edge), np.sin(edge)], axis=1)).distance.max() < 2e-4 + 3e-4
    with pytest.raises(ValueError, match="boundary: expected a callable"):
        domain.boundary(np.ones(domain.given))


def test_the_local_size_is_that_of_the_channel():
    domain = Domain.of([[0, 0], [10, 0], [10, 0.01], [0, 0.01]])
    assert np.median(domain.nearest.size) * domain.unit == pytest.approx(0.005, rel=0.1)
    assert Domain.of(SQUARE).nearest.size.max() * Domain.of(SQUARE).unit == pytest.approx(0.5, rel=0.2)


@pytest.mark.parametrize(
    ("polygon", "error", "words"),
    [
        ([[0, 0], [1, 0]], ValueError, "polygon: expected at least three"),
        ([[0, 0], [1, 0], [1, 0], [0, 0]], ValueError, "polygon: expected at least three"),
        ([[0, 0], [1, 1], [2, 2]], ValueError, "polygon: "),
        ([[0, 0], [1, 0], [np.nan, 1]], ValueError, "polygon: expected finite"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], ValueError, "polygon: expected an outline that does not cross"),
        ([[0, 0], [2, 0], [2, 2], [2, 0.5]], ValueError, "polygon: expected an outline that does not cross"),
        (np.zeros((4, 3)), ValueError, "polygon: expected shape"),
        ("square", TypeError, "polygon: "),
        (shapely.LineString([[0, 0], [1, 0]]), TypeError, "polygon: expected a shapely Polygon"),
        (ng.Curve.polyline([[0, 0], [1, 0], [1, 1]]), ValueError, "polygon: expected a closed curve"),
    ],
)
def test_bad_polygons_are_refused_by_name(polygon, error, words):
    with pytest.raises(error, match=words):
        Domain.of(polygon)


def test_bad_values_are_refused_by_name():
    domain = Domain.of(SQUARE)
    with pytest.raises(ValueError, match="boundary: expected 4 values"):
        domain.boundary([1.0, 2.0])
    with pytest.raises(ValueError, match="boundary: expected finite"):
        domain.boundary(lambda p: np.full(len(p), np.nan)).at(np.zeros(2, int), np.zeros(2))
    with pytest.raises(ValueError, match="boundary: expected a callable that gives shape"):
        domain.boundary(lambda p: p).at(np.zeros(2, int), np.zeros(2))
