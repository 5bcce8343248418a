"""Optical depths that are known: fog, ramps, balls, rings, slabs; and densities against Eq. 9 written out in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.special import erf

from nqr_geom import render

X = [1.0, 0.0, 0.0]
MARCHERS = ("random", "stratified", "trapezoid", "regression", "jackknife", "structured")


def depth(volume, origin, direction, t_max=np.inf, *, method="structured", n=24, **options):
    out = render.transmittance(volume, [origin], [direction], t_max, method=method, n=n, full_output=True, **options)
    return out.inner[0, 0]


@pytest.mark.parametrize("method", [*MARCHERS, "ratio", "track-length", "unbiased-raymarching"])
def test_a_homogeneous_medium_is_closed_form_and_costs_no_query(method):
    fog = render.Homogeneous([0, 0, 0], [1, 2, 3], density=0.7)
    got = render.transmittance(fog, [[-1, 1, 1], [0.25, 1, 1]], [X, X], [9.0, 0.5], method=method, full_output=True)
    np.testing.assert_allclose(got.value[:, 0], np.exp(-0.7 * np.array([1.0, 0.5])), rtol=1e-15)
    assert got.counts["queries"] == 0
    assert (got.stderr == 0.0).all()


@pytest.mark.parametrize("method", [*MARCHERS[:-1], "unbiased-raymarching"])
def test_marching_through_it_all_the_same_has_no_variance(method):
    fog = render.Homogeneous([0, 0, 0], [1, 2, 3], density=0.7)
    got = render.transmittance(fog, [[-1, 1, 1]] * 50, [X] * 50, 9.0, method=method, everything=True)
    np.testing.assert_allclose(got, np.exp(-0.7), rtol=1e-13)


def ramp(slope=(0.3, 0.2, 0.5), base=0.1, nodes=(3, 5, 4), size=(2.0, 3.0, 4.0)):
    """A density that is linear in space, which a trilinear grid holds exactly."""
    axes = [np.linspace(0.0, s, k) for s, k in zip(size, nodes, strict=True)]
    data = base + sum(a * x for a, x in zip(slope, np.meshgrid(*axes, indexing="ij"), strict=True))
    return render.Grid(data, [0, 0, 0], size)


def test_a_cubic_is_exact_on_a_linear_density_along_any_ray():
    """From (0.1, 0.2, 0.3) along (1, 2, 2)/3 for 1.5: 0.1 t + t^2/2 slope, both from the linear function."""
    way = np.array([1.0, 2.0, 2.0]) / 3.0
    start = np.array([0.1, 0.2, 0.3])
    slope = np.array([0.3, 0.2, 0.5])
    expected = (0.1 + slope @ start) * 1.5 + 0.5 * (slope @ way) * 1.5**2
    for method in ("regression", "structured"):
        assert depth(ramp(), start, 7.0 * way, 1.5, method=method) == pytest.approx(expected, rel=1e-12)
    assert depth(ramp(), start, way, 1.5, method="stratified", n=400) == pytest.approx(expected, rel=1e-2)


def test_trilinear_values_are_scipys():
    rng = np.random.default_rng(0)
    grid = render.Grid(rng.random((4, 5, 6)), [-1, 0, 2], [1, 2, 3])
    points = rng.random((2000, 3)) * [2, 2, 1] + [-1, 0, 2]
    axes = np.linspace(-1, 1, 4), np.linspace(0, 2, 5), np.linspace(2, 3, 6)
    expected = RegularGridInterpolator(axes, grid.data)(points)
    got = grid.components(points)
    np.testing.assert_allclose(got.density, expected, atol=1e-14)
    np.testing.assert_allclose(got.geometry, 1.0 - expected / grid.data.max(), atol=1e-14)


@pytest.mark.parametrize("profile", ["gaussian", "exponential"])
def test_smooth_densities_on_a_fine_grid(profile):
    """Trilinear interpolation with 201 nodes is off by curvature h^2/12 of the integral, below 1e-4 here."""
    z = np.linspace(-3.0, 3.0, 201)
    column, expected = {
        "gaussian": (np.exp(-(z**2)), np.sqrt(np.pi) * erf(3.0)),
        "exponential": (np.exp(-(z + 3.0)), 1.0 - np.exp(-6.0)),
    }[profile]
    grid = render.Grid(np.broadcast_to(column, (2, 2, 201)), [0, 0, -3], [1, 1, 3])
    got = [depth(grid, [0.5, 0.5, -9.0], [0, 0, 1], method=m, n=2000) for m in ("trapezoid", "structured")]
    np.testing.assert_allclose(got, expected, rtol=2e-4)


@pytest.mark.parametrize("aside", [0.0, 0.3, 0.9, 0.999])
def test_the_chord_of_a_ball(aside):
    """Density 2 (1 - r^2) in the unit ball: 2 * 4/3 h^3 along a chord of half length h."""
    ball = render.Spheres([[1.0, 2.0, 3.0]], [1.0], density=2.0)
    expected = 8.0 / 3.0 * (1.0 - aside**2) ** 1.5
    ray = [1.0 - 4.0, 2.0 + aside, 3.0], X
    assert depth(ball, *ray) == pytest.approx(expected, rel=2e-3)
    assert depth(ball, *ray, n=200) == pytest.approx(expected, rel=1e-4)
    assert depth(ball, *ray, method="trapezoid", n=4000) == pytest.approx(expected, abs=1e-5)


def test_two_balls_in_a_row_and_one_inside_another():
    """Apart they add up; the denser one hides the other, and the union of chords is not counted twice."""
    two = render.Spheres([[0, 0, 0], [9, 0, 0]], [1.0, 2.0])
    assert depth(two, [-5, 0, 0], X) == pytest.approx(4.0 / 3.0 + 8.0 / 3.0, rel=1e-2)
    nested = render.Spheres([[0, 0, 0], [0, 0, 0]], [1.0, 2.0])
    assert depth(nested, [-5, 0, 0], X, n=100) == pytest.approx(8.0 / 3.0, rel=1e-3)


def test_rays_meet_only_the_stretches_where_there_can_be_density():
    import nqr_geom as ng

    balls = render.Spheres([[0, 0, 0], [1.5, 0, 0], [9, 0, 0], [0, 50, 0]], [1.0, 1.0, 2.0, 1.0])
    rays = ng.problems.transmittance(balls, [[-5, 0, 0], [0.5, 0, 0]], [X, X], [np.inf, 8.0], support="pieces").rays
    np.testing.assert_allclose(rays.total, [3.5 + 4.0, 2.0 + 1.5], rtol=1e-14)
    inside = render.Spheres([[0, 0, 0], [-2, 0, 0], [3, 0, 0]], [5.0, 1.0, 1.0])
    rays = ng.problems.transmittance(inside, [[-9, 0, 0]], [X], np.inf, support="pieces").rays
    np.testing.assert_allclose(rays.total, [10.0], rtol=1e-14)


def test_through_the_tube_of_a_ring():
    ring = render.Torus([1, 1, 1], [0, 0, 2.0], major=3.0, minor=0.5)
    for aside in (0.0, 0.2):
        half = np.sqrt(0.5**2 - aside**2)
        expected = 4.0 / 3.0 * half**3 / 0.5**2
        assert depth(ring, [1 + 3.0 + aside, 1, -9], [0, 0, 1], n=100) == pytest.approx(expected, rel=1e-2)
    assert depth(ring, [1, 1, -9], [0, 0, 1]) == 0.0
    # Aslant, through both sides of the tube, on the whole line and on what the ring can reach of it.
    ray = [1.0, -4.0, 0.7], [0.05, 1.0, 0.06]
    sparse, dense = depth(ring, *ray, n=300), depth(ring, *ray, method="trapezoid", n=20_000)
    assert dense > 0.9
    assert sparse == pytest.approx(dense, rel=1e-3)


def test_across_a_slab():
    """Density 1 in the plate, 1 - (s/R)^2 at a distance s: thickness + 4/3 R, far from the outline."""
    slab = render.Extrusion(np.full((3, 3), -9.0), 2.0, 0.5, [0, 0, 0], [1, 1, 10])
    for method in ("structured", "stratified"):
        assert depth(slab, [0.5, 0.5, -9], [0, 0, 1], method=method, n=500) == pytest.approx(
            2.0 + 4.0 / 3.0 * 0.5, rel=1e-3
        )
    thin = render.Extrusion(np.full((3, 3), -9.0), 0.0, 0.5, [0, 0, 0], [1, 1, 10])
    assert depth(thin, [0.5, 0.5, -9], [0, 0, 1], n=200) == pytest.approx(2.0 / 3.0, rel=1e-3)


def test_noise_is_clamped_as_equation_9_says():
    noise = render.Noise(amplitude=2.0, frequency=1.5, octaves=4, seed=3)
    ball = render.Spheres([[0, 0, 0], [2, 0, 0]], [1.0, 1.5], density=3.0, noise=noise)
    points = np.random.default_rng(1).uniform(-3, 5, (5000, 3))
    got = ball.components(points)
    apart = ((points[:, None] - ball.centers) ** 2).sum(-1) / ball.radii**2
    inside = ((points >= ball.low) & (points <= ball.high)).all(axis=1)
    np.testing.assert_allclose(got.geometry, apart.min(axis=1), rtol=1e-12)
    expected = np.where(inside, 3.0 * np.clip(1.0 - got.geometry + got.noise, 0.0, 1.0), 0.0)
    np.testing.assert_allclose(got.density, expected, atol=1e-12)
    assert np.abs(got.noise).max() <= noise.bound
    assert (got.noise[got.geometry >= 1.0 + noise.bound] == 0.0).all()
    assert 0.3 < got.noise[got.geometry < 1.0 + noise.bound].std() < 0.6


def test_octaves_add_up_and_seeds_differ():
    def at(**noise):
        ball = render.Spheres([[0, 0, 0]], [9.0], [-9] * 3, [9] * 3, noise=render.Noise(**noise))
        return ball.components(np.random.default_rng(0).uniform(-3, 3, (4000, 3))).noise

    one = at(octaves=1, amplitude=0.8)
    assert np.abs(one).max() < 0.8 * np.sqrt(0.75)
    np.testing.assert_allclose(at(octaves=1, amplitude=0.4), 0.5 * one, rtol=1e-12)
    more = at(octaves=2, amplitude=0.8)
    assert (more - one).std() == pytest.approx(0.5 * one.std(), rel=0.1)  # gain 1/2
    assert abs(np.corrcoef(one, at(octaves=1, amplitude=0.8, seed=1))[0, 1]) < 0.1
