"""Scenes that break naive renderers: tiny lights, near mirrors, grazing views, far worlds, nothing at all."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj, Random
from nqr_geom.render.camera import Camera
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import Conductor, Diffuse, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.render.shapes import Mesh, Quad, Sphere
from tests.scenes import EVERYTHING, floor, looking_down, open_floor, two_spheres


def picture(scene, n=16, sampler=None, seed=0):
    problem = DirectProblem.of(scene, effects=EVERYTHING)
    return problem, run(problem, sampler or Pmj(), BalanceHeuristic(), n, seed=seed)


def grazing(material, lights=None):
    """A floor seen at a cosine of 1e-4 and less."""
    camera = Camera([0, -1, 1e-4], [0, 0, 0], fov=0.02, width=3, height=3)
    return Scene(camera, [floor(material, 2.0)], lights or [SphereLight([0, 0.5, 0.2], 0.1, 9.0)])


@pytest.mark.parametrize("roughness", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("make", [lambda r: Conductor("gold", r), lambda r: Plastic(0.5, r)], ids=["gold", "plastic"])
def test_near_mirrors_and_grazing_views_are_finite(make, roughness):
    mirrored = Scene(
        Camera([0, -1, 1], [0, 0, 0], width=5, height=5), [floor(make(roughness))], [SphereLight([0, 1, 1], 0.05, 9.0)]
    )
    for scene in (mirrored, grazing(make(roughness))):
        problem, got = picture(scene, 64)
        assert np.isfinite(got.value).all()
        assert (got.value >= 0.0).all()
        assert (problem.surfaces["kind"] >= 0).sum() >= 3
    # The mirror image of the light shines as the light does, times the reflectance.
    reflectance = picture(mirrored, 256)[1].value.max() / 9.0
    assert (0.7 if isinstance(make(roughness), Conductor) else 0.03) < reflectance < 1.0


def test_balance_weights_of_the_two_techniques_sum_to_one_wherever_both_can_sample():
    problem = DirectProblem.of(two_spheres(8), effects=EVERYTHING)
    x = torch.rand(problem.batch, 64, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    seen = problem.evaluate(x)
    density = seen.technique_pdf
    assert torch.isfinite(density).all()
    assert (density >= 0.0).all()
    weights = BalanceHeuristic().combine(Random().draw(problem, 64, _stream())).weights
    assert ((weights >= 0.0) & (weights <= 1.0)).all()
    # f / p times p is f cos L whatever the technique: recover it from both and hold it to the features.
    cosine = seen.features["direction"][..., 2:]
    own = density.diagonal(dim1=2, dim2=3)[..., None]
    lit = seen.value > 0.0
    light = problem.world.struct.lights.numpy()["radiance"][seen.features["light"].long().clamp_min(0).numpy()[..., 0]]
    expected = seen.features["bsdf"] * cosine * torch.from_numpy(light)
    assert lit.any()
    torch.testing.assert_close((seen.value * own)[lit], expected[lit], rtol=1e-9, atol=0.0)


def _stream():
    from nqr_geom.streams import Stream

    return Stream(5)


@pytest.mark.parametrize(("shift", "scale"), [((1e4, -3e3, 5e2), 1.0), ((0, 0, 0), 1e5), ((1e4, 0, 0), 1e-3)])
def test_a_world_that_is_far_or_large_or_small_gives_the_same_picture(shift, scale):
    near = picture(two_spheres())[1].value
    far = picture(two_spheres(shift=shift, scale=scale))[1].value
    # float64 loses digits of positions to the shift, and a shadow's edge may move by them
    apart = np.abs(far - near).max(axis=1) > 1e-6 * near.max()
    assert apart.mean() <= 0.01
    assert np.abs(far - near).mean() < 1e-3 * near.mean()


def test_a_light_that_shrinks_tends_to_a_point():
    place, intensity = np.array([0.4, 0.3, 0.9]), 2.0
    for radius, close in ((1e-2, 1e-3), (1e-4, 1e-7), (1e-7, 1e-9)):
        light = SphereLight(place, radius, intensity / (np.pi * radius**2))
        problem, got = picture(open_floor([light]), 16)
        p = problem.surfaces["position"] * problem.world.scenes[0].frame.scale + problem.world.scenes[0].frame.centre
        away = place - p
        d2 = (away**2).sum(axis=1)
        point = 0.5 / np.pi * intensity * away[:, 2] / d2**1.5
        np.testing.assert_allclose(got.value[:, 0], point, rtol=max(close, 2 * radius))


def test_a_surface_inside_a_light():
    got = picture(open_floor([SphereLight([0, 0, 0], 0.5, 1.0), SphereLight([0, 0, 1], 0.1, 1.0)]))[1]
    assert np.isfinite(got.value).all()


@pytest.mark.parametrize(
    ("shapes", "lights"),
    [
        ([], [SphereLight([0, 0, 5], 0.1, 1.0)]),
        ([floor()], []),
        ([], []),
        ([Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))], []),
        ([floor()], [SphereLight([0, 0, -1], 0.1, 1.0)]),
        ([floor()], [SphereLight([0, 0, 1], 0.1, 0.0), SphereLight([0.2, 0, 1], 0.1, 0.0)]),
    ],
    ids=["no surface", "no light", "nothing", "empty mesh", "light below", "dark lights"],
)
def test_where_there_is_nothing_to_see_the_picture_is_black(shapes, lights):
    got = picture(Scene(looking_down(), shapes, lights))[1]
    assert (got.value == 0.0).all()


def test_a_light_before_another_hides_it():
    front, back = SphereLight([0, 0, 0.5], 0.2, 1.0), SphereLight([0, 0, 2.0], 0.3, 1e6)
    camera = Camera([0, -0.9, 0.05], [0, 0, 0], fov=0.1, width=1, height=1)
    alone, both = (picture(Scene(camera, [floor()], lights), 64)[1].value for lights in ([front], [front, back]))
    assert both[0, 0] == pytest.approx(alone[0, 0], rel=0.05)


def test_surfaces_cast_no_shadow_on_themselves():
    """A floor of a thousand coplanar triangles and a ball in many flat facets, lit at grazing angles."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 24), [0.1]), axis=-1).reshape(-1, 3)
    corner = (np.arange(23)[:, None] * 24 + np.arange(23)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 25], 1), np.stack([corner, corner + 25, corner + 24], 1)]
    )
    tilted = grid @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    normal = np.cross(tilted[1] - tilted[0], tilted[24] - tilted[0])
    normal /= np.linalg.norm(normal)
    centre = tilted.mean(axis=0)
    along = (tilted[23] - tilted[0]) / np.linalg.norm(tilted[23] - tilted[0])
    light = SphereLight(centre + 3.0 * along + 0.02 * normal, 0.01, 1.0)
    camera = Camera(centre + 3 * normal, centre, fov=20.0, width=16, height=16, up=along)
    scene = Scene(camera, [Mesh(tilted, faces)], [light])
    problem = DirectProblem.of(scene, effects=EVERYTHING)
    samples = Pmj().draw(problem, 16, _stream())
    unhidden = samples.seen.features["lambert"][:, :, 1, 0] > 0.0
    assert unhidden.all()
    assert (samples.value[:, :, 1, 0] > 0.0).all()


def test_a_ball_is_lit_up_to_its_horizon():
    ball = Scene(
        looking_down(16, 16, 30.0), [Sphere([0, 0, 0], 0.7, Diffuse(1.0))], [SphereLight([3, 0, 0], 0.01, 1e4)]
    )
    problem, got = picture(ball)
    facing = (problem.surfaces["normal"] * [1.0, 0.0, 0.0]).sum(axis=1)
    seen = problem.surfaces["kind"] >= 0
    assert (got.value[seen & (facing > 0.3)] > 0.0).all()
    assert (got.value[seen & (facing < -0.01)] == 0.0).all()


BOX = Quad([0, 0, 0], [1, 0, 0], [0, 1, 0])


@pytest.mark.parametrize(
    ("make", "error", "match"),
    [
        (lambda: SphereLight([0, 0, 0], 0.0), ValueError, r"radius: expected a number > 0.0, got 0.0"),
        (lambda: SphereLight([0, 0, np.nan], 1.0), ValueError, "center: expected finite numbers"),
        (lambda: SphereLight([0, 0, 0], 1.0, [-1, 0, 0]), ValueError, "emission: expected numbers >= 0"),
        (lambda: Diffuse(1.5), ValueError, r"albedo: expected numbers in \[0, 1\]"),
        (lambda: Conductor("unobtainium"), ValueError, "metal: expected one of aluminium"),
        (lambda: Conductor(eta=[1, 1, 1]), ValueError, "eta: expected eta and k together"),
        (lambda: Conductor(roughness=1e-5), ValueError, "roughness: expected a number >= 0.0001"),
        (lambda: Plastic(ior=1.0), ValueError, "ior: expected a number > 1.0"),
        (lambda: Sphere([0, 0], 1.0), ValueError, r"center: expected shape \(3,\)"),
        (lambda: Sphere([0, 0, 0], 1.0, "red"), TypeError, "material: expected Diffuse, Conductor or Plastic, got str"),
        (lambda: Quad([0, 0, 0], [1, 0, 0], [2, 0, 0]), ValueError, "u: expected edges that span an area"),
        (lambda: Mesh([[0, 0, 0]], [[0, 0, 1]]), ValueError, r"faces: expected integers in \[0, 1\)"),
        (lambda: Mesh([[0, 0, 0]], [[0, 0, 0.5]]), ValueError, r"faces: expected integers in \[0, 1\)"),
        (lambda: Camera([0, 0, 1], [0, 0, 0]), ValueError, "up: expected a direction that is not along"),
        (lambda: Camera([0, 1, 1], [0, 1, 1]), ValueError, "up: expected a direction that is not along"),
        (lambda: Camera([0, 1, 1], [0, 0, 0], fov=180), ValueError, "fov: expected a number > 0.0 and <= 170"),
        (lambda: Camera([0, 1, 1], [0, 0, 0], width=0), ValueError, "width: expected an integer >= 1"),
        (lambda: Scene("camera", [], []), TypeError, "camera: expected a Camera, got str"),
        (lambda: Scene(looking_down(), [looking_down()], []), TypeError, "shapes: expected Mesh or Sphere"),
        (lambda: Scene(looking_down(), [], SphereLight([0, 0, 0], 1)), TypeError, "lights: expected a sequence"),
        (lambda: Mesh.from_file("nowhere.ply", Diffuse()), ValueError, "path: expected an existing mesh file"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_by_name(make, error, match):
    with pytest.raises(error, match=match):
        make()


def test_textures_need_coordinates():
    from nqr_geom.render.materials import Checker

    with pytest.raises(ValueError, match="uv: expected texture coordinates for a textured material"):
        Mesh(BOX.vertices, BOX.faces, Diffuse(Checker(0.1, 0.9)))
