"""Hard cases of transmittance: no NaN, no surprise, and the laws that hold whatever the medium."""

from __future__ import annotations

import numpy as np
import pytest

from nqr_geom import render
from nqr_geom.render.estimators import TRACKERS

METHODS = ("random", "stratified", "trapezoid", "regression", "jackknife", "structured", *TRACKERS)
NOISE = render.Noise(amplitude=0.8, frequency=0.9, seed=1)
X = [1.0, 0.0, 0.0]


def cloud(shift=0.0, scale=1.0, density=1.0):
    centers = shift + scale * np.array([[3.0, 5.0, 5.0], [6.0, 5.0, 4.0]])
    noise = render.Noise(amplitude=0.8, frequency=0.9 / scale, seed=1)
    box = [shift] * 3, [shift + 10.0 * scale] * 3
    return render.Spheres(centers, [1.5 * scale, 2.0 * scale], *box, density=density / scale, noise=noise)


RAYS = np.array([[-1.0, 4.5, 4.5], [2.0, 5.0, 4.2], [-3.0, 6.1, 4.0]])
WAYS = np.array([[1.0, 0.02, 0.01], [0.9, 0.1, -0.1], [1.0, -0.1, 0.1]])


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_in_the_way(method):
    """Zero length, a ray that misses, one that starts behind, one that ends before: exactly 1, and not one query."""
    origins = [[5, 5, 5], [-1, 20, 5], [11, 5, 5], [-5, 5, 5]]
    got = render.transmittance(cloud(), origins, [X] * 4, [0.0, 9.0, 9.0, 4.9], method=method, full_output=True)
    assert got.value.ravel().tolist() == [1.0] * 4
    assert got.counts["queries"] == got.counts["noise"] == 0


@pytest.mark.parametrize("method", METHODS)
def test_no_density_is_no_work(method):
    for empty in (render.Homogeneous([0] * 3, [1] * 3, 0.0), cloud(density=0.0)):
        got = render.transmittance(empty, RAYS, WAYS, 99.0, method=method, full_output=True)
        assert got.value.ravel().tolist() == [1.0] * 3
        assert got.counts["queries"] == 0
        assert got.effects == frozenset()
        assert got.plan["kernels"] == ()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("density", [1e-300, 30.0, 1e4, 1e300])
def test_any_density_gives_a_number(method, density):
    """Depths from 1e-300 to 1e300: T may underflow to 0, the depth itself is told, nothing is NaN."""
    if method in TRACKERS and density > 1e5:  # a run takes as many steps as the majorant's depth
        with pytest.raises(
            ValueError, match=f"volume: expected majorant times length up to 1e.06 for method {method!r}"
        ):
            render.transmittance(cloud(density=density), RAYS, WAYS, 99.0, method=method)
        return
    got = render.transmittance(cloud(density=density), RAYS, WAYS, 99.0, method=method, full_output=True)
    assert np.isfinite(got.value).all()
    assert np.isfinite(got.inner).all()
    if density < 1e-200:
        assert got.value.ravel().tolist() == [1.0] * 3
    if method == "structured" and density >= 30.0:
        assert (got.inner > 20.0).all()
        assert (got.value <= np.exp(-20.0)).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("shift", "scale"), [(1e6, 1.0), (0.0, 1e-6), (0.0, 1e6), (-64.0, 0.25)])
def test_moved_and_scaled_worlds_give_the_same_answer(method, shift, scale):
    options = {"method": method, "n": 16, "seed": 5}
    plain = render.transmittance(cloud(), RAYS, WAYS, 12.0, **options)
    moved = render.transmittance(cloud(shift, scale), shift + scale * RAYS, WAYS, 12.0 * scale, **options)
    np.testing.assert_allclose(moved, plain, rtol=2e-6, atol=1e-9)  # noise sees its place in single precision


def test_a_far_origin_and_long_directions():
    near = render.transmittance(cloud(), RAYS, WAYS, np.inf)
    ways = WAYS / np.linalg.norm(WAYS, axis=1, keepdims=True)
    far = render.transmittance(cloud(), RAYS - 1e7 * ways, 1e200 * ways, np.inf)
    np.testing.assert_allclose(far[[0, 2]], near[[0, 2]], rtol=1e-5)  # 1e7 away a place is known to 2e-9
    tiny = render.transmittance(cloud(), RAYS, 1e-200 * ways, np.inf)
    np.testing.assert_allclose(tiny, near, rtol=1e-12)


def test_parts_of_a_ray_multiply_and_reversal_changes_nothing():
    """T(a,c) = T(a,b) T(b,c), on a linear density where a cubic is exact."""
    axis = np.linspace(0.0, 2.0, 3)
    grid = render.Grid(0.1 + axis[:, None, None] + np.zeros((3, 2, 2)), [0] * 3, [2, 1, 1])
    start, way = np.array([0.1, 0.2, 0.3]), np.array([0.8, 0.3, 0.2])
    way /= np.linalg.norm(way)

    def through(a, b):
        return render.transmittance(grid, [start + a * way], [(b - a) * way], abs(b - a), method="regression")[0]

    assert through(0.0, 1.5) == pytest.approx(through(0.0, 0.6) * through(0.6, 1.5), rel=1e-12)
    assert through(1.5, 0.0) == pytest.approx(through(0.0, 1.5), rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_a_constant_grid_is_the_homogeneous_medium(method):
    grid = render.Grid(np.full((3, 4, 5), 0.8), [0] * 3, [1, 2, 3])
    fog = render.Homogeneous([0] * 3, [1, 2, 3], density=0.8)
    rays = [[-1, 1, 1], [0.5, 0.5, -9]], [[1, 0.1, 0], [0, 0.1, 1]], 20.0
    assert grid.effects() == fog.effects() == {"homogeneous"}
    np.testing.assert_array_equal(*(render.transmittance(v, *rays, method=method) for v in (grid, fog)))


def test_rays_along_faces_and_edges_count_as_inside():
    fog = render.Homogeneous([0] * 3, [1] * 3, density=1.0)
    got = render.transmittance(
        fog, [[-1, 0, 0.5], [-1, 1, 1], [-1, 0, 1 + 1e-9], [0, 0, 0]], [X] * 3 + [[1, 1, 1]], 9.0
    )
    np.testing.assert_allclose(got, np.exp([-1.0, -1.0, 0.0, -np.sqrt(3.0)]), rtol=1e-12)


def test_a_ray_that_touches_a_ball():
    """Tangent, within rounding, and through a ball of 1e-9: a number next to 1."""
    balls = render.Spheres([[0, 0, 0], [3, 0, 0]], [1.0, 1e-9])
    got = render.transmittance(
        balls, [[-5, 1, 0], [-5, 1 - 1e-12, 0], [-5, 0.999999, 0]], [X] * 3, 9.0, method="structured"
    )
    np.testing.assert_allclose(got, 1.0, atol=1e-8)


def test_one_sample_and_many():
    for method in METHODS:
        for n in (1, 2, 3, 257):
            got = render.transmittance(cloud(), RAYS, WAYS, 12.0, method=method, n=n, seed=1)
            assert np.isfinite(got).all(), (method, n)


def test_no_rays_at_all():
    got = render.transmittance(cloud(), np.empty((0, 3)), np.empty((0, 3)), 1.0, method="structured", full_output=True)
    assert got.value.shape == (0, 1)
    assert render.transmittance(cloud(), np.empty((0, 3)), np.empty((0, 3)), 1.0, method="ratio").shape == (0,)


FOG = render.Homogeneous([0] * 3, [1] * 3)


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: render.transmittance(1.0, [[0] * 3], [X], 1.0), TypeError, "volume: expected a Volume"),
        (lambda: render.transmittance(FOG, [[0, 0]], [X], 1.0), ValueError, r"origins: expected shape \(m, 3\)"),
        (lambda: render.transmittance(FOG, [[0, 0, np.nan]], [X], 1.0), ValueError, "origins: expected finite"),
        (
            lambda: render.transmittance(FOG, [[0] * 3], [X] * 2, 1.0),
            ValueError,
            r"directions: expected shape \(1, 3\)",
        ),
        (lambda: render.transmittance(FOG, [[0] * 3], [[0] * 3], 1.0), ValueError, "directions: expected none of zero"),
        (lambda: render.transmittance(FOG, [[0] * 3], [X], -1.0), ValueError, "t_max: expected lengths >= 0, got -1"),
        (
            lambda: render.transmittance(FOG, [[0] * 3], [X], np.nan),
            ValueError,
            "t_max: expected lengths >= 0, got nan",
        ),
        (lambda: render.transmittance(FOG, [[0] * 3], [X], [1, 2]), ValueError, r"t_max: expected shape \(1,\)"),
        (lambda: render.transmittance(FOG, [[0] * 3], [X], 1.0, n=0), ValueError, "n: expected an integer >= 1, got 0"),
        (lambda: render.transmittance(FOG, [[0] * 3], [X], 1.0, seed=0.5), TypeError, "seed: expected an integer"),
        (
            lambda: render.transmittance(FOG, [[0] * 3], [X], 1.0, method="x"),
            ValueError,
            "method: .*jackknife.*got 'x'",
        ),
        (lambda: render.Homogeneous([0] * 3, [1, 1, 0]), ValueError, "high: expected more than low"),
        (lambda: render.Homogeneous([0] * 3, [1] * 3, -1.0), ValueError, "density: expected a number >= 0"),
        (lambda: render.Homogeneous([0] * 3, [1e200] * 3), ValueError, "high: expected a box between"),
        (lambda: render.Grid(np.ones((1, 2, 2)), [0] * 3, [1] * 3), ValueError, "data: expected at least two nodes"),
        (lambda: render.Grid(-np.ones((2, 2, 2)), [0] * 3, [1] * 3), ValueError, "data: expected densities >= 0"),
        (lambda: render.Spheres([[0] * 3], [0.0]), ValueError, "radii: expected numbers > 0, got 0"),
        (lambda: render.Spheres(np.empty((0, 3)), []), ValueError, "centers: expected at least one"),
        (lambda: render.Spheres([[0] * 3], [1.0, 2.0]), ValueError, r"radii: expected shape \(1,\)"),
        (lambda: render.Spheres([[0] * 3], [1.0], noise=3), TypeError, "noise: expected a Noise or None, got 3"),
        (lambda: render.Torus([0] * 3, [0] * 3, 2, 1), ValueError, "axis: expected a direction, got zero"),
        (lambda: render.Torus([0] * 3, X, 1, 2), ValueError, "major: expected a number >= 2"),
        (
            lambda: render.Extrusion(np.ones(3), 1, 1, [0] * 3, [1] * 3),
            ValueError,
            r"distance: expected shape \(nx, ny\)",
        ),
        (
            lambda: render.Extrusion(np.ones((2, 2)), -1, 1, [0] * 3, [1] * 3),
            ValueError,
            "thickness: expected a number >= 0",
        ),
        (lambda: render.Noise(amplitude=-1), ValueError, "amplitude: expected a number >= 0"),
        (lambda: render.Noise(octaves=0), ValueError, "octaves: expected an integer >= 1"),
        (lambda: render.Noise(gain=1.5), ValueError, "gain: expected a number"),
    ],
)
def test_bad_input_is_refused_by_name(call, error, match):
    with pytest.raises(error, match=match):
        call()
