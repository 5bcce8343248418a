"""Glossy reflections of lamps that nothing hides: by slopes, beside plain sums over the lamps' directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from nqr_geom import render
from nqr_geom.render.direct_known import known
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.materials import METALS, coat_table
from tests.scenes import open_floor

Floats = NDArray[np.float64]


def directions(n: int, least: float) -> Floats:
    """Random viewers whose cosine to the normal is at least that."""
    rng = np.random.default_rng(3)
    z, phi = rng.uniform(least, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])


def reflected(material: render.Material, lamp: tuple[list[float], float], views: Floats, n: int = 1) -> Floats:
    """What `known` says of a lamp of radiance 1 seen from the origin of a floor, (B, 3)."""
    there = render.SphereLight([0.0, 0.0, 9.0], 0.1, 1.0)  # hides nothing of the floor from the camera
    floor = DirectProblem.of(open_floor(material=material, lights=[there])).surfaces
    surfaces = floor[np.flatnonzero(floor["kind"] >= 0)[:1].repeat(len(views))].copy()
    surfaces["position"], surfaces["outgoing"] = 0.0, views
    lit = DirectProblem.of(open_floor(material=material, lights=[render.SphereLight(*lamp, 1.0)]))
    return known(replace(lit, surfaces=surfaces, rows=torch.arange(len(views))), n)[:, 0].numpy()


def masked(cosine: Floats, alpha: float) -> Floats:
    return 2.0 * cosine / (cosine + np.sqrt(cosine**2 + alpha**2 * (1.0 - cosine**2)))


def summed(alpha: float, metal: str, lamp: tuple[list[float], float], views: Floats, points: int) -> Floats:
    """The same as a sum over points^2 directions to the lamp, and Fresnel terms of complex numbers."""
    centre, radius = np.array(lamp[0]), lamp[1]
    distance = np.linalg.norm(centre)
    c = centre / distance
    cosine = -1.0 if radius >= distance else np.sqrt(1.0 - (radius / distance) ** 2)
    u = (np.arange(points) + 0.5) / points
    z, phi = 1.0 - (1.0 - cosine) * u, 2.0 * np.pi * u
    s = np.cross(c, [0.3, -0.5, 0.8])
    s /= np.linalg.norm(s)
    t = np.cross(c, s)
    sine = np.sqrt(1.0 - z**2)
    around = np.cos(phi)[:, None] * s + np.sin(phi)[:, None] * t
    w = (z[:, None, None] * c + sine[:, None, None] * around).reshape(-1, 3)
    w = w[w[:, 2] > 0.0]
    solid = 2.0 * np.pi * (1.0 - cosine) / points**2
    result = np.empty((len(views), 3))
    index = np.array([complex(*pair) for pair in zip(*METALS[metal], strict=True)])
    for k, out in enumerate(views):
        h = w + out
        h /= np.linalg.norm(h, axis=1, keepdims=True)
        density = alpha**2 / (np.pi * ((alpha**2 - 1.0) * h[:, 2] ** 2 + 1.0) ** 2)
        cosines = (h @ out)[:, None]
        root = np.sqrt(index**2 - 1.0 + cosines**2)
        across = np.abs((cosines - root) / (cosines + root)) ** 2
        along = np.abs((index**2 * cosines - root) / (index**2 * cosines + root)) ** 2
        both = density * masked(out[2], alpha) * masked(w[:, 2], alpha) / (4.0 * out[2])
        result[k] = solid * (both[:, None] * 0.5 * (across + along)).sum(axis=0)
    return result


LAMPS = {
    "ahead": ([0.3, 0.2, 1.0], 0.3),
    "small": ([0.3, 0.2, 1.0], 0.01),
    "huge": ([0.2, 0.0, 1.0], 0.97),
    "cut by the floor": ([0.9, 0.2, 0.1], 0.3),
    "sunk": ([0.9, 0.2, -0.1], 0.3),
    "all around": ([0.3, 0.2, 1.0], 1.5),
}


@pytest.mark.parametrize("lamp", LAMPS.values(), ids=LAMPS)
@pytest.mark.parametrize("alpha", [0.05, 0.4])
def test_slopes_agree_with_sums_over_directions(alpha: float, lamp: tuple[list[float], float]) -> None:
    views = directions(24, 0.15)
    truth = summed(alpha, "gold", lamp, views, 1200)
    fine, coarse = (reflected(render.Conductor("gold", alpha), lamp, views, n) for n in (4096, 1))
    scale = truth.mean()
    assert scale > 0.0
    np.testing.assert_allclose(fine, truth, rtol=2e-3, atol=2e-3 * scale)
    np.testing.assert_allclose(coarse, truth, rtol=0.03, atol=0.03 * scale)


@pytest.mark.parametrize("alpha", [1e-4, 1e-3, 0.02])
def test_a_sharp_lobe_inside_a_lamp_gives_all_that_it_reflects(alpha: float) -> None:
    views = np.array([[-0.6, 0.0, 0.8], [-0.28, 0.0, 0.96]])
    for view in views:
        mirror = (view * [-1.0, -1.0, 1.0]).tolist()
        metal = render.Conductor("silver", alpha)
        inside = reflected(metal, (mirror, 0.5), view[None])[0]
        whole = reflected(metal, (mirror, 1.0), view[None], 4096)[0]  # around the point
        assert (inside <= whole * (1.0 + 1e-9)).all()
        # Beyond slopes of s a lobe has less than (a / s)^2; the lamp's edge, at 30 degrees, takes s of tan 15 or more.
        np.testing.assert_allclose(inside, whole, rtol=30.0 * alpha**2 + 1e-7)


@pytest.mark.parametrize("alpha", [1e-4, 0.1, 1.0])
def test_a_plastic_surrounded_by_light_reflects_the_albedo_of_its_coat(alpha: float) -> None:
    views = directions(12, 0.3)
    albedo = coat_table(alpha, 1.5)[0]
    expected = np.interp(views[:, 2], np.linspace(0.0, 1.0, len(albedo)), albedo)
    black = render.Plastic(0.0, alpha, ior=1.5)
    np.testing.assert_allclose(
        reflected(black, ([0.1, 0.0, 0.2], 1.0), views, 4096), np.tile(expected[:, None], 3), rtol=5e-3
    )


@pytest.mark.parametrize("alpha", [1e-4, 0.03, 1.0])
@pytest.mark.parametrize("lamp", [([0.3, 0.2, 1.0], 0.3), ([0.9, 0.2, 0.1], 0.3), ([0.5, 0.0, 0.0], 0.2)])
def test_more_points_change_little(alpha: float, lamp: tuple[list[float], float]) -> None:
    views = directions(400, 0.15)
    few, many = (reflected(render.Conductor("gold", alpha), lamp, views, n) for n in (1, 1024))
    assert np.isfinite(few).all()
    assert np.median(np.abs(few - many)) < 1e-4 * many.max()
    assert np.abs(few - many).mean() < 3e-3 * many.mean()


def test_lamps_of_any_size_are_continuous() -> None:
    """From one whose cone is a plain point to one whose cone takes roots, radiance follows the solid angle."""
    views = directions(50, 0.2)
    sizes = np.array([1e-12, 1e-7, 1e-5, 1.5e-5, 1e-4])
    gold = render.Conductor("gold", 0.2)
    brightness = np.stack([reflected(gold, ([0.3, 0.2, 1.0], size), views) / size**2 for size in sizes])
    np.testing.assert_allclose(brightness, brightness[[0]].repeat(len(sizes), axis=0), rtol=2e-5)


@pytest.mark.parametrize("cosine", [1e-310, 1e-200, 1e-12, 1e-6, 1e-3, 0.05])
@pytest.mark.parametrize("alpha", [1e-4, 0.1, 1.0])
def test_grazing_viewers_see_finite_radiance_below_that_of_the_lamp(cosine: float, alpha: float) -> None:
    views = np.array([[-np.sqrt(1.0 - cosine**2), 0.0, cosine]])
    for lamp in LAMPS.values():
        for material in (render.Conductor("silver", alpha), render.Plastic(0.5, alpha)):
            seen = reflected(material, lamp, views)
            assert np.isfinite(seen).all()
            assert (seen >= 0.0).all()
            assert (seen <= 1.05).all()
