"""Direct light is the same from the fused kernels, the integrator, parts, and kernels made for a scene."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nqr_geom import registry, render
from nqr_geom.integrator.estimate import run
from nqr_geom.render.direct_problem import LAYOUT, DirectProblem
from nqr_geom.render.effects import ALL, shadows_possible
from nqr_geom.render.kernels_fused import EXTRA
from nqr_geom.streams import Stream
from tests.scenes import EVERYTHING, floor, looking_down, open_floor, two_spheres

PAIRS = [(s, r) for s in ("random", "pmj") for r in ("balance-heuristic", "direct-unhidden")]
PAIRS += [(s, "direct-known") for s in ("random", "pmj", "lamp-spread")]
LEARNED = [(s, "inet-direct-mis") for s in ("random", "pmj", "lamp-spread")]
LEARNED += [("snet-direct-nqr", "inet-direct-nqr")]


def pair(sampler, rule):
    return registry.make("sampler", sampler), registry.make("rule", rule)


@pytest.fixture(scope="module")
def room():
    return DirectProblem.of(two_spheres(16))


@pytest.mark.parametrize("n", [1, 5, 16])
@pytest.mark.parametrize(("sampler", "rule"), PAIRS)
def test_one_pass_is_sampler_and_rule_one_after_the_other(room, sampler, rule, n, monkeypatch):
    part = room.take(slice(70, 200))
    fused = run(part, *pair(sampler, rule), n, seed=3)
    monkeypatch.setattr(DirectProblem, "compiled", lambda *_: None)
    parts = run(part, *pair(sampler, rule), n, seed=3)
    np.testing.assert_allclose(fused.value, parts.value, rtol=1e-12, atol=1e-14)
    assert fused.counts == parts.counts
    assert (fused.stderr is None) == (parts.stderr is None or rule != "balance-heuristic")
    if fused.stderr is not None:
        np.testing.assert_allclose(fused.stderr, parts.stderr, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("n", [2, 13, 16])
@pytest.mark.parametrize(("sampler", "rule"), LEARNED)
def test_networks_in_kernels_are_sampler_and_rule_one_after_the_other(sampler, rule, n, monkeypatch):
    """Tokens are those of torch to the rounding of float32, which is what the networks compute in."""
    for problem in (DirectProblem.of(two_spheres(16)), DirectProblem.family(2, seed=3, resolution=12)):
        fused = run(problem, *pair(sampler, rule), n, seed=3)
        assert "compiled" in fused.stages
        with monkeypatch.context() as without:
            without.setattr(DirectProblem, "compiled", lambda *_: None)
            parts = run(problem, *pair(sampler, rule), n, seed=3)
        np.testing.assert_allclose(fused.value, parts.value, rtol=2e-6, atol=2e-6)
        np.testing.assert_array_equal(fused.fallback, parts.fallback)
        assert fused.counts == parts.counts


def test_a_round_of_one_and_many_passes_are_left_to_sampler_and_rule(room):
    for n in (9, 65):
        estimate = run(room.take(slice(0, 8)), *pair(*LEARNED[-1]), n, seed=3)
        assert not estimate.stages.get("compiled")
        assert np.isfinite(estimate.value).all()


@pytest.mark.parametrize(("sampler", "rule"), PAIRS + LEARNED)
def test_pixels_do_not_depend_on_the_rest_of_the_picture(room, sampler, rule, monkeypatch):
    whole = run(room, *pair(sampler, rule), 8)
    some = torch.tensor([200, 3, 77, 140])
    np.testing.assert_array_equal(run(room.take(some), *pair(sampler, rule), 8).value, whole.value[some.numpy()])
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    np.testing.assert_array_equal(run(room, *pair(sampler, rule), 8).value, whole.value)


def test_the_door_is_the_integrator():
    scene = two_spheres()
    problem = DirectProblem.of(scene)
    for method, names in {
        "random": ("random", "balance-heuristic"),
        "mis": ("pmj", "balance-heuristic"),
        "regression": ("pmj", "direct-regression-1"),
        "structured": ("lamp-spread", "direct-known"),
        "sobol+balance-heuristic": ("sobol", "balance-heuristic"),
    }.items():
        got = render.direct(scene, spp=8, method=method, seed=2)
        assert got.shape == (12, 12, 3)
        np.testing.assert_array_equal(got.reshape(-1, 3), run(problem, *pair(*names), 8, seed=2).value)
    for bad, match in (({"method": "mc"}, "balance-heuristic"), ({"method": "magic"}, "method: expected one of"),
                       ({"spp": 0}, "spp: expected an integer >= 1")):  # fmt: skip
        with pytest.raises(ValueError, match=match):
            render.direct(scene, **bad)
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        render.direct("room")


def test_features_are_the_22_of_table_5():
    assert sum(feature.size for feature in DirectProblem.schema.features) == 22
    problem = DirectProblem.of(two_spheres(8), effects=EVERYTHING)
    seen = registry.make("sampler", "pmj").draw(problem, 4, Stream(0)).seen
    for feature in DirectProblem.schema.features:
        assert seen.features[feature.name].shape == (64, 4, 2, feature.size)
        assert torch.isfinite(seen.features[feature.name]).all()
    assert max(first + size for first, size in LAYOUT.values()) == EXTRA
    length = seen.features["direction"].norm(dim=-1)
    on_surface = torch.from_numpy(problem.surfaces["kind"] >= 0)
    torch.testing.assert_close(length[on_surface][:, :, 0], torch.ones_like(length[on_surface][:, :, 0]))


# --- effects ------------------------------------------------------------------------------------------


def room_without(ceiling=True, **kwargs):
    """An empty room, seen from inside, with lights in it."""
    gray = render.Diffuse(0.6)
    walls = [
        render.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], gray),
        render.Quad([-1, 1, 0], [2, 0, 0], [0, 0, 2], gray),
        render.Quad([-1, -1, 0], [0, 2, 0], [0, 0, 2], gray),
    ]
    if ceiling:
        walls.append(render.Quad([-1, -1, 2], [2, 0, 0], [0, 2, 0], gray))
    lights = kwargs.pop("lights", [render.SphereLight([0.2, 0.3, 1.0], 0.2, 5.0)])
    return render.Scene(
        render.Camera([0.8, -3, 1], [0, 0, 1], width=12, height=12), walls + kwargs.pop("more", []), lights
    )


BALL = render.Sphere([0, 0, 0.3], 0.3, render.Diffuse(0.4))
TWO = [render.SphereLight([0.5, 0, 1], 0.1, 1.0), render.SphereLight([-0.5, 0, 1], 0.1, 1.0)]


@pytest.mark.parametrize(
    ("scene", "effects"),
    [
        (room_without(), set()),
        (open_floor(), set()),
        (render.Scene(looking_down(), [BALL], TWO[:1]), set()),
        (room_without(lights=TWO), {"light selection"}),
        (room_without(more=[BALL]), {"shadows"}),
        (room_without(lights=[render.SphereLight([0.0, 0.0, 3.0], 0.2, 5.0)]), {"shadows"}),  # above the ceiling
        (room_without(lights=[render.SphereLight([0.0, 0.0, 2.0], 0.2, 5.0)]), {"shadows"}),  # half in it
        (open_floor(material=render.Conductor("gold", 0.2)), {"glossy"}),
        (open_floor(material=render.Plastic(0.5, 0.001)), {"specular"}),
        (open_floor(material=render.Diffuse(render.Checker(0.1, 0.9))), {"texture"}),
        (two_spheres(), {"shadows", "glossy", "texture", "light selection"}),
    ],
)  # fmt: skip
def test_scenes_say_what_they_call_for(scene, effects):
    assert scene.effects() == effects
    assert shadows_possible(scene) == ("shadows" in effects)


@pytest.mark.parametrize(
    "scene",
    [room_without(), room_without(lights=TWO), room_without(more=[BALL]), two_spheres()],
    ids=["empty room", "two lights", "ball", "everything"],
)
def test_the_picture_is_that_of_kernels_with_everything(scene):
    for rule in ("balance-heuristic", "direct-unhidden", "direct-known"):
        lean, full = (DirectProblem.of(scene, effects=effects) for effects in (None, ALL | scene.effects()))
        one, other = (run(problem, *pair("pmj", rule), 4, seed=1).value for problem in (lean, full))
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)
        if rule == "balance-heuristic" and "shadows" not in scene.effects():
            assert lean.rays == {"material": 0, "light": 0, "density queries": 0}
            assert full.rays["light"] > 0


def test_a_report_counts_rays_and_names_kernels():
    empty = render.direct(room_without(), spp=4, full_output=True)
    assert empty.effects == frozenset()
    assert empty.plan["kernels"] == "direct"
    assert empty.counts["camera rays"] == 144
    assert empty.counts["shadow rays, light"] == empty.counts["shadow rays, material"] == 0
    full = render.direct(two_spheres(), spp=4, full_output=True)
    assert full.plan["kernels"] == "direct + shadows + gloss + light selection"
    assert 0 < full.counts["shadow rays, material"] < full.counts["shadow rays, light"] <= 144 * 4
    assert full.stages["scene and camera rays"] > 0.0
    assert sum(full.stages.values()) <= full.seconds


def test_fewer_effects_than_a_scene_calls_for_are_refused():
    with pytest.raises(ValueError, match="effects: expected at least"):
        DirectProblem.of(two_spheres(), effects=frozenset({"shadows"}))


def test_bright_side_of_a_shadow():
    """A wall between light and floor: behind it nothing arrives, before it the closed form."""
    wall = render.Quad([0.0, -1, 0], [0, 2, 0], [0, 0, 1.5], render.Diffuse(0.5))
    light = render.SphereLight([-0.5, 0, 0.5], 0.1, 10.0)
    camera = render.Camera([0, -0.01, 6], [0, 0, 0], fov=4, width=16, height=4)
    got, bare = (
        render.direct(render.Scene(camera, shapes, [light]), method="structured")
        for shapes in ([floor(), wall], [floor()])
    )
    assert (got[:, 9:] == 0.0).all()
    assert (bare[:, 9:] > 0.0).all()
    assert (bare[:, :7] > 0.0).mean() > 0.5  # the light itself covers the rest
    np.testing.assert_allclose(got[:, :7], bare[:, :7], rtol=1e-12)
