"""A medium weakens light on its way to surfaces and to the camera; without one no density is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from nqr_geom import render
from tests.scenes import floor, looking_down

LIGHT = render.SphereLight([0.2, 0.1, 1.5], 1e-4, 1e9)  # a point, nearly: all its rays have one length
BOX = ([-0.5, -0.4, 0.2], [0.6, 0.5, 1.1])


def pictures(medium):
    scene = render.Scene(looking_down(10, 10, 25.0), [floor()], [LIGHT])
    foggy = render.Scene(scene.camera, scene.shapes, scene.lights, medium)
    return scene, render.direct(scene, method="structured"), foggy


def depth(origin, target, low, high, slope):
    """Integral of 1 + slope * height inside a box along segments, by fine sampling."""
    t = (np.arange(20000) + 0.5) / 20000
    p = origin[:, None] + t[:, None] * (target - origin)[:, None]
    inside = ((p >= low) & (p <= high)).all(axis=-1)
    return (inside * (1.0 + slope * (p[..., 2] - low[2]))).mean(axis=1) * np.linalg.norm(target - origin, axis=-1)


@pytest.mark.parametrize("kind", ["homogeneous", "grid"])
def test_both_legs_lose_light_by_the_law_of_beer_and_lambert(kind):
    medium, slope = render.Homogeneous(*BOX, density=1.7), 0.0
    if kind == "grid":
        layers = 1.7 * (1.0 + 2.0 * np.linspace(0.0, BOX[1][2] - BOX[0][2], 5))
        medium, slope = render.Grid(np.broadcast_to(layers, (3, 4, 5)), *BOX), 2.0
    scene, clear, foggy = pictures(medium)
    estimate = render.direct(foggy, method="structured", full_output=True)
    w = scene.camera.rays()
    points = scene.camera.position - w * (scene.camera.position[2] / w[:, 2])[:, None]
    ends = (np.broadcast_to(end, points.shape) for end in (LIGHT.center, scene.camera.position))
    kept = np.exp(-1.7 * sum(depth(points, end, *BOX, slope) for end in ends))
    assert kept.max() > 5.0 * kept.min()
    np.testing.assert_allclose(estimate.value, clear.reshape(-1, 3) * kept[:, None], rtol=2e-3)
    assert {"medium", f"medium: {kind}"} <= estimate.effects
    assert (estimate.counts["density queries"] == 0) == (kind == "homogeneous")
    assert f"{kind} medium" in estimate.plan["kernels"]


def test_rays_that_miss_the_box_ask_for_no_density():
    far = render.Grid(np.arange(8.0).reshape(2, 2, 2), [5, 5, 5], [6, 6, 6])
    _, clear, foggy = pictures(far)
    estimate = render.direct(foggy, method="structured", full_output=True)
    assert estimate.counts["density queries"] == 0
    np.testing.assert_array_equal(estimate.value, clear.reshape(-1, 3))


def test_no_medium_and_an_empty_one_are_the_same_scene():
    _, clear, foggy = pictures(render.Homogeneous(*BOX, density=0.0))
    assert foggy.effects() == frozenset()
    estimate = render.direct(foggy, method="structured", full_output=True)
    assert estimate.plan["kernels"] == "direct"
    np.testing.assert_array_equal(estimate.value, clear.reshape(-1, 3))
    with pytest.raises(TypeError, match="medium: expected a volume or None, got str"):
        render.Scene(foggy.camera, [], [], "fog")
