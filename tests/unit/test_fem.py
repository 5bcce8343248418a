"""Meshes and finite-element spaces: what they promise, piece by piece."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from shapely import Polygon

from nqr_geom.fem import delaunay
from nqr_geom.fem.linear import laplace
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.outline import Outline
from nqr_geom.fem.p_laplace import _remainder
from nqr_geom.fem.space import Space

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
L_SHAPE = np.array([[0.0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1]])


def star(m: int, seed: int) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(m) / m
    radius = np.random.default_rng(seed).uniform(0.6, 1.0, m)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def comb(teeth: int) -> np.ndarray:
    up = [[(i + 0.1, 1.0), (i + 0.1, 0.1), (i + 1.0, 0.1), (i + 1.0, 1.0)] for i in range(teeth)]
    return np.array([(0.0, 1.0), *np.concatenate(up).tolist(), (teeth + 0.1, 1.0), (teeth + 0.1, 0.0), (0.0, 0.0)])


SHAPES = {
    "square": (SQUARE, 25.0),
    "L": (L_SHAPE, 25.0),
    "star": (star(107, 0), 12.0),
    "comb": (comb(8), 25.0),
    "channel": (np.array([[0, 0], [10, 0], [10, 0.01], [0, 0.01]]), 25.0),
    "round hole": (Polygon(SQUARE, [0.5 + 0.2 * star(64, 1)]), 10.0),
    "hole that touches": (Polygon([[0.5, 0.0], *SQUARE[1:], [0, 0]], [[[0.5, 0.0], [0.7, 0.4], [0.3, 0.4]]]), 20.0),
    "two holes": (Polygon(4 * SQUARE, [SQUARE + 0.5, (SQUARE + np.array([2.0, 1.9]))[::-1]]), 25.0),
}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", SHAPES)
def test_meshes_cover_the_polygon_with_good_triangles(name: str, order: int) -> None:
    polygon, angle = SHAPES[name]
    mesh = Mesh.of(polygon, 400, order=order)
    areas = delaunay.areas(mesh.points, mesh.triangles)
    assert areas.min() > 0.0
    assert areas.sum() == pytest.approx(mesh.outline.polygon.area, rel=1e-12)
    outer = mesh.edges.nodes[mesh.edges.outer]
    assert {*map(tuple, outer.tolist())} == {tuple(sorted(pair)) for pair in mesh.segments.tolist()}
    assert np.degrees(delaunay.smallest_angles(mesh.points, mesh.triangles).min()) > angle


@pytest.mark.parametrize("name", SHAPES)
def test_segments_know_their_edges(name: str) -> None:
    mesh = Mesh.of(SHAPES[name][0], 200).refined()
    for side in (0, 1):
        there = mesh.outline.along_edges(mesh.segment_edge, mesh.segment_t[:, side])
        np.testing.assert_allclose(mesh.outline.to_frame(there), mesh.points[mesh.segments[:, side]], atol=1e-14)
    covered = np.bincount(mesh.segment_edge, np.diff(mesh.segment_t, axis=1)[:, 0])
    np.testing.assert_allclose(covered, 1.0, atol=1e-14)


def test_triangle_count_and_sizes() -> None:
    assert 0.8 < len(Mesh.of(SQUARE, 2000).triangles) / 2000 < 1.25
    mesh = Mesh.of(10.0 * SQUARE, size=lambda x: 0.1 + 0.2 * x[:, 0])
    lengths = mesh.outline.size * np.hypot(*np.diff(mesh.points[mesh.edges.nodes], axis=1)[:, 0].T)
    middle = (mesh.outline.centre + mesh.outline.size * mesh.points[mesh.edges.nodes].mean(axis=1))[:, 0]
    assert (lengths < 1.6 * (0.1 + 0.2 * middle)).all()
    assert lengths[middle > 9.0].mean() > 5.0 * lengths[middle < 1.0].mean()


def test_grading_shrinks_triangles_at_re_entrant_corners_only() -> None:
    mesh, plain = Mesh.of(L_SHAPE, 1000), Mesh.of(L_SHAPE, 1000, graded=False)

    def smallest(mesh: Mesh, corner: np.ndarray) -> float:
        near = np.hypot(*(mesh.points[mesh.triangles].mean(axis=1) - mesh.outline.to_frame(corner)).T)
        return float(delaunay.areas(mesh.points, mesh.triangles)[near < 0.1].min())

    assert smallest(mesh, L_SHAPE[0]) < 0.2 * smallest(plain, L_SHAPE[0])
    assert smallest(mesh, L_SHAPE[2]) == pytest.approx(smallest(plain, L_SHAPE[2]), rel=0.7)


def test_refinement() -> None:
    mesh = Mesh.of(L_SHAPE, 300)
    finer = mesh.refined()
    assert len(finer.triangles) == 4 * len(mesh.triangles)
    marked = np.zeros(len(mesh.triangles), dtype=bool)
    marked[7] = True
    local = mesh.refined(marked)
    assert len(mesh.triangles) + 3 <= len(local.triangles) < len(mesh.triangles) + 40
    assert delaunay.areas(local.points, local.triangles).sum() == pytest.approx(0.75 * 4.0, rel=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_every_point_is_found_in_its_triangle(name: str) -> None:
    import shapely

    mesh = Mesh.of(SHAPES[name][0], 300)
    frame = np.random.default_rng(2).uniform(-1.0, 1.0, (2000, 2)) * np.abs(mesh.points).max(axis=0)
    places = np.concatenate([frame, mesh.points, mesh.points[mesh.segments].mean(axis=1)])
    triangle, weights = mesh.locate_in_frame(places)
    inside = shapely.covers(mesh.outline.polygon, shapely.points(frame))
    np.testing.assert_array_equal(triangle[: len(frame)] >= 0, inside)
    assert (triangle[len(frame) :] >= 0).all()
    found = triangle >= 0
    again = (weights[found, :, None] * mesh.points[mesh.triangles[triangle[found]]]).sum(axis=1)
    np.testing.assert_allclose(again, places[found], atol=1e-14)


@pytest.mark.parametrize("order", [1, 2])
def test_spaces_hold_polynomials_and_their_gradients(order: int) -> None:
    inner = np.random.default_rng(0).uniform(0.0, 1.0, (500, 2))
    x, y = inner.T
    harmonic = [lambda p: 2 * p[:, 0] - 3 * p[:, 1] + 1, lambda p: p[:, 0] ** 2 - p[:, 1] ** 2 + p[:, 0] * p[:, 1]]
    slopes = [np.stack([2 + 0 * x, -3 + 0 * x], axis=1), np.stack([2 * x + y, x - 2 * y], axis=1)]
    found = laplace(3.0 * SQUARE - 1.0, harmonic[order - 1], n=300, order=order)
    np.testing.assert_allclose(found(inner), harmonic[order - 1](inner), atol=1e-11)
    np.testing.assert_allclose(found.gradient(inner), slopes[order - 1], atol=1e-9)
    assert found.error < 1e-10


def test_operators_agree_with_closed_forms() -> None:
    space = Space(Mesh.of(SQUARE, 100), 2)
    unit = space.mesh.outline.size**2
    assert unit * space.weights.sum() == pytest.approx(1.0)
    x = space.source_points
    assert unit * (space.source_weights * x[:, 0] ** 2 * x[:, 1] ** 3).sum() == pytest.approx(1 / 12)


def test_values_jump_at_vertices_given_twice() -> None:
    outline = Outline.of(np.repeat(SQUARE, 2, axis=0))
    assert outline.edges.tolist() == [[1, 2], [3, 4], [5, 6], [7, 0]]
    np.testing.assert_allclose(outline.angles, np.pi / 2)
    mesh = Mesh.of(outline, 50)
    nodes, _ = mesh.boundary_values([0, 0, 0, 0, 0, 1, 1, 0], 1)
    where = mesh.outline.centre + mesh.outline.size * mesh.points
    top = where[:, 1] == 1.0
    corner = top & np.isin(where[:, 0], [0.0, 1.0])
    assert (nodes[corner] == 0.5).all()
    assert (nodes[top & ~corner] == 1.0).all()
    assert (nodes[~top] == 0.0).all()


@pytest.mark.parametrize("turned", [False, True])
def test_angles_are_those_inside(turned: bool) -> None:
    corners = L_SHAPE[::-1] if turned else L_SHAPE
    angles = np.degrees(Outline.of(corners).angles)
    np.testing.assert_allclose(angles, [90, 90, 90, 90, 90, 270] if turned else [270, 90, 90, 90, 90, 90])
    hole = Outline.of(Polygon(4 * SQUARE, [SQUARE + 1 if turned else SQUARE[::-1] + 1]))
    np.testing.assert_allclose(np.degrees(hole.angles), [90] * 4 + [270] * 4)


def test_points_outside() -> None:
    found = laplace(L_SHAPE, L_SHAPE[:, 0], n=200)
    places = np.array([[0.5, 0.5], [0.5, -0.5], [1.0, 1.0], [1.0 + 1e-16, 0.5], [1.0 + 1e-9, 0.5]])
    with pytest.raises(ValueError, match=r"points: expected points inside the polygon.*at row 1"):
        found(places)
    np.testing.assert_allclose(found(places, outside="nan"), [0.5, np.nan, 1.0, 1.0, np.nan], atol=1e-12)
    assert np.isnan(found.gradient(places, outside="nan")).any(axis=1).tolist() == [False, True, False, False, True]
    assert found(np.zeros((0, 2))).shape == (0,)


def test_the_error_estimate_bounds_the_error() -> None:
    def wave(x: np.ndarray) -> np.ndarray:
        return np.exp(x[:, 0]) * np.sin(x[:, 1])

    inner = np.random.default_rng(0).uniform(0.02, 0.98, (500, 2))
    for order in (1, 2):
        found = laplace(SQUARE, wave, n=500, order=order)
        actual, estimated = np.abs(found(inner) - wave(inner)), found.error_at(inner)
        assert actual.max() < estimated.max() <= 1.5 * found.error
        assert found.error < 40.0 * actual.max()


def test_tolerance_is_met_by_local_refinement() -> None:
    def corner(x: np.ndarray) -> np.ndarray:
        angle = np.arctan2(x[:, 1], x[:, 0]) % (2.0 * np.pi)
        return np.hypot(*x.T) ** (2.0 / 3.0) * np.sin(2.0 / 3.0 * angle)

    points = np.array([[0.5, 0.5], [-0.1, -0.1], [1e-3, 1e-3]])
    found = laplace(L_SHAPE, corner, n=100, graded=False, tol=1e-4, points=points)
    assert found.error_at(points).max() <= 1e-4
    np.testing.assert_allclose(found(points), corner(points), atol=1e-4)
    areas = delaunay.areas(found.space.mesh.points, found.space.mesh.triangles)
    assert areas.max() > 1000.0 * areas.min()


@pytest.mark.parametrize("a", [0.525, 0.6, 1.5, 5.0, 25.0])
def test_the_rest_of_a_power_keeps_its_digits(a: float) -> None:
    """(1 + x)^a - 1 - a x, of order x^2, against fifty digits."""
    from decimal import Decimal, localcontext

    x = np.array([-0.9, -0.3, -1e-4, -1e-9, 1e-12, 1e-7, 3e-5, 1e-3, 0.1, 7.0])
    with localcontext() as context:
        context.prec = 50
        truth = [float((1 + Decimal(v)) ** Decimal(a) - 1 - Decimal(a) * Decimal(v)) for v in x]
    np.testing.assert_allclose(_remainder(x, a), truth, rtol=1e-7, atol=1e-300)


BAD = {
    "short values": (lambda: laplace(SQUARE, [1, 2, 3]), ValueError, r"one value a vertex \(4\), got 3"),
    "callable of wrong shape": (lambda: laplace(SQUARE, lambda x: x), ValueError, r"boundary\(points\)"),
    "NaN values": (lambda: laplace(SQUARE, lambda x: x[:, 0] / 0.0), ValueError, "expected finite"),
    "source of wrong shape": (lambda: laplace(SQUARE, [0] * 4, source=lambda x: x), ValueError, r"source\(points\)"),
    "negative screening": (lambda: laplace(SQUARE, [0] * 4, screening=-1), ValueError, "screening: expected"),
    "a hole that touches an edge": (
        lambda: Mesh.of(Polygon(SQUARE, [[[0.5, 0.0], [0.7, 0.4], [0.3, 0.4]]])),
        ValueError,
        "rings that touch at a place which is not a vertex of both",
    ),
    "order": (lambda: laplace(SQUARE, [0] * 4, order=3), ValueError, "order: expected an integer >= 1 and <= 2"),
    "size": (lambda: Mesh.of(SQUARE, size=0.0), ValueError, "size: expected a number > 0"),
    "size by place": (lambda: Mesh.of(SQUARE, size=lambda x: x[:, 0] - 0.5), ValueError, r"size\(points\)"),
    "points": (lambda: laplace(SQUARE, [0] * 4, n=10)([1.0, 2.0]), ValueError, "points: expected shape"),
    "outside": (lambda: laplace(SQUARE, [0] * 4, n=10)([[9, 9]], outside="x"), ValueError, "outside: expected one of"),
    "tol": (lambda: laplace(SQUARE, [0] * 4, tol=0.0), ValueError, "tol: expected a number > 0"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bad_arguments_are_named(name: str) -> None:
    call, error, message = BAD[name]
    with pytest.raises(error, match=message):
        call()


def test_importing_the_package_loads_no_finite_elements() -> None:
    code = "import sys, nqr_geom, nqr_geom.api; sys.exit(any(m in sys.modules for m in ('skfem', 'shapely', 'torch')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
