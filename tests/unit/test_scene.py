"""Scenes: what cameras see, textures, meshes from files, scenes from JSON, random scenes, and the command line."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import pyvista as pv

import nqr_geom as ng
from nqr_geom import cli, render
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.film import exposed
from nqr_geom.render.scene_file import read_scene, scene_named
from nqr_geom.render.scene_gallery import GALLERY, on_a_floor
from nqr_geom.render.world import lights_seen
from nqr_geom.streams import Stream
from tests.scenes import floor, looking_down, open_floor, two_spheres


def seen(scene, **options):
    problem = DirectProblem.of(scene, **options)
    scale, centre = scene.frame.scale, scene.frame.centre
    return problem.surfaces, problem.surfaces["position"] * scale + centre


def test_cameras_see_planes_and_spheres_where_they_are():
    ball = render.Sphere([0.3, 0.2, 0.5], 0.4)
    scene = render.Scene(looking_down(32, 24, 40.0), [floor(size=4.0), ball], [])
    rows, points = seen(scene)
    w = scene.camera.rays()
    away = ball.center - scene.camera.position
    along = w @ away
    disc = ball.radius**2 - (away @ away - along**2)
    hit = disc > 0.0
    t = np.where(hit, along - np.sqrt(np.maximum(disc, 0.0)), -scene.camera.position[2] / w[:, 2])
    np.testing.assert_allclose(points, scene.camera.position + t[:, None] * w, atol=1e-12)
    np.testing.assert_allclose(rows["normal"][~hit], [[0.0, 0.0, 1.0]] * (~hit).sum(), atol=1e-15)
    np.testing.assert_allclose(rows["normal"][hit], (points[hit] - ball.center) / ball.radius, atol=1e-12)
    assert 0.05 < hit.mean() < 0.5
    assert (rows["kind"] == 0).all()


def test_rays_go_through_the_middle_or_a_random_point_of_their_pixel():
    camera = render.Camera([0, 0, 5], [0, 0, 0], fov=90.0, width=8, height=4, up=[0, 1, 0])
    at = camera.rays() @ np.diag([1, 1, 1])
    at = at[:, :2] / -at[:, 2:]  # on a plane at distance 1
    np.testing.assert_allclose(at[0], [-1.75, 0.75], atol=1e-12)
    np.testing.assert_allclose(at[-1], [1.75, -0.75], atol=1e-12)
    moved = camera.rays(Stream(0))
    moved = moved[:, :2] / -moved[:, 2:]
    assert (np.abs(moved - at) <= 0.25).all()
    assert np.abs(moved - at).max() > 0.2


def test_smooth_normals_bend_between_vertices_and_stay_on_the_viewers_side():
    ball = render.Mesh.from_pyvista(
        pv.Sphere(radius=1.0, theta_resolution=24, phi_resolution=24), render.Diffuse(), smooth=True
    )
    flat = render.Mesh(ball.vertices, ball.faces)
    camera = looking_down(24, 24, 30.0)
    rows, points = seen(render.Scene(camera, [ball], []))
    facets = seen(render.Scene(camera, [flat], []))[0]
    on = rows["kind"] >= 0
    exact = points[on] / np.linalg.norm(points[on], axis=1, keepdims=True)
    error = [1.0 - (r["normal"][on] * exact).sum(axis=1) for r in (rows, facets)]
    assert error[0].mean() < 0.05 * error[1].mean()
    for name in ("normal", "geometric"):
        assert ((rows[name] * rows["outgoing"]).sum(axis=1)[on] > 0.0).all()


def test_textures_are_looked_up_where_rays_meet():
    pixels = np.zeros((2, 2, 3))
    pixels[0, 1] = [1.0, 0.5, 0.25]  # upper right
    image = render.Image(pixels)
    np.testing.assert_array_equal(image.at(np.array([[0.75, 0.75]])), [[1.0, 0.5, 0.25]])
    np.testing.assert_allclose(image.at(np.array([[0.5, 0.5], [0.75, 0.5]]))[:, 0], [0.25, 0.5])
    rows, points = seen(open_floor(material=render.Diffuse(render.Checker(0.9, 0.1, 4)), width=20, height=20, fov=30.0))
    even = np.floor((points[:, :2] + 1.0) * 2.0).sum(axis=1) % 2 == 0
    on = rows["kind"] >= 0  # the light covers the rest
    assert on.mean() > 0.7
    np.testing.assert_array_equal(rows["albedo"][on, 0], np.where(even, 0.9, 0.1)[on])


def test_lights_cover_what_is_behind_them_and_their_light_is_left_out():
    light = render.SphereLight([0, -0.5, 1.5], 0.2, [3, 2, 1])
    scene = open_floor([light], width=9, height=9)
    direct, emitted = render.direct(scene, spp=1), lights_seen(scene)
    assert (direct[4, 4] == 0.0).all()
    np.testing.assert_array_equal(emitted[4, 4], [3, 2, 1])
    covered = emitted[..., 0] > 0.0
    assert 0 < covered.sum() < 81
    assert (direct[covered] == 0.0).all()
    assert (direct[~covered] > 0.0).all()


def test_meshes_from_files_are_what_was_written(tmp_path):
    made = pv.Cube().triangulate()
    path = tmp_path / "cube.ply"
    made.save(path)
    mesh = render.Mesh.from_file(path, render.Diffuse(0.3))
    assert len(mesh.faces) == 12
    np.testing.assert_allclose(sorted(set(np.abs(mesh.vertices).ravel())), [0.5])
    (tmp_path / "text.ply").write_text("not a mesh")
    with pytest.raises(ValueError, match="path: expected a mesh file that PyVista reads"):
        render.Mesh.from_file(tmp_path / "text.ply", render.Diffuse())
    scene = scene_named(str(path), 8, 8)
    assert len(scene.lights) == 3
    with pytest.raises(ValueError, match="mesh: expected a Mesh with at least one face"):
        on_a_floor(render.Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)))


SCENE = {
    "camera": {"position": [0, -3, 1], "look_at": [0, 0, 0.3], "width": 6, "height": 4},
    "shapes": [
        {"type": "quad", "corner": [-1, -1, 0], "u": [2, 0, 0], "v": [0, 2, 0],
         "material": {"type": "diffuse", "albedo": {"even": 0.8, "odd": 0.2, "squares": 4}}},
        {"type": "sphere", "center": [0, 0, 0.3], "radius": 0.3, "material": {"type": "conductor", "metal": "copper"}},
        {"type": "mesh", "file": "tent.ply", "scale": 0.3, "turn": 20, "shift": [0.5, 0, 0],
         "material": {"type": "plastic", "albedo": [0.1, 0.2, 0.3]}},
    ],
    "lights": [{"center": [0, 0, 2], "radius": 0.2, "emission": [5, 4, 3]}],
}  # fmt: skip


def test_scenes_from_json(tmp_path):
    pv.Cone().save(tmp_path / "tent.ply")
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    scene = read_scene(path)
    assert scene.effects() == {"shadows", "glossy", "texture"}
    assert render.direct(scene, spp=1).shape == (4, 6, 3)
    for change, match in (
        ({"camera": 3}, "camera: expected an object"),
        ({"camera": {"position": [0, 0, 1]}}, "camera: .*look_at"),
        ({"shapes": [{"type": "blob"}]}, "shape: expected an object with type mesh, quad, sphere"),
        ({"shapes": [{"type": "sphere", "material": {"type": "gold"}}]}, "material: expected an object with type"),
        ({"lights": [{"center": [0, 0, 0]}]}, "light: .*radius"),
        ({"wind": 1}, "path: expected an object with camera, shapes and lights"),
    ):
        path.write_text(json.dumps(SCENE | change))
        with pytest.raises(ValueError, match=match):
            read_scene(path)
    path.write_text("{")
    with pytest.raises(ValueError, match="path: expected JSON"):
        read_scene(path)


def test_random_scenes_are_functions_of_their_number():
    some, more = ng.datasets.scenes(2, resolution=6), ng.datasets.scenes(3, resolution=6)
    for a, b in zip(some, more[:2], strict=True):
        np.testing.assert_array_equal(a.triangles.corners, b.triangles.corners)
        assert [light.radius for light in a.lights] == [light.radius for light in b.lights]
    lights = [
        ng.datasets.scenes(1, seed=s, split=split)[0].lights[0].radius
        for s, split in ((0, "test"), (0, "train"), (1, "test"))
    ]
    assert len(set(lights)) == 3
    for scene in more:
        assert len(scene.lights) == 3
        problem = DirectProblem.of(scene)
        assert (problem.surfaces["kind"] >= 0).mean() > 0.5
    with pytest.raises(ValueError, match="n: expected an integer >= 1"):
        ng.datasets.scenes(0)


@pytest.mark.parametrize("name", sorted(GALLERY))
def test_the_gallery_is_lit(name):
    scene = scene_named(name, 16, 12)
    image = render.direct(scene, spp=4)
    assert image.shape == (12, 16, 3)
    assert np.isfinite(image).all()
    assert ((image.sum(axis=2) > 0.0) | (lights_seen(scene).sum(axis=2) > 0.0)).mean() > 0.75


def test_exposure_keeps_order_and_range():
    image = np.linspace(0.0, 50.0, 300).reshape(10, 10, 3)
    shown = exposed(image)
    assert (np.diff(shown.ravel()) >= 0.0).all()
    assert 0.0 <= shown.min() <= shown.max() <= 1.0
    assert (exposed(np.zeros((2, 2, 3))) == 0.0).all()
    assert exposed(np.full((1, 1, 3), -1.0)).max() == 0.0


def test_rendering_from_the_command_line(tmp_path, capsys):
    out = tmp_path / "two.npy"
    assert (
        cli.main(["render", "two-spheres", "-n", "2", "--width", "8", "--height", "6", "--report", "--out", str(out)])
        == 0
    )
    said = capsys.readouterr().out
    assert "direct + shadows + gloss + light selection" in said
    assert "shadow rays, light" in said
    picture = np.load(out)
    np.testing.assert_array_equal(picture, render.direct(scene_named("two-spheres", 8, 6), spp=2, method="structured"))
    assert (
        cli.main(["render", "plates", "-n", "1", "--width", "8", "--height", "6", "--out", str(tmp_path / "p.png")])
        == 0
    )
    assert (tmp_path / "p.png").stat().st_size > 100
    for arguments in (
        ["nowhere"],
        ["nowhere.json"],
        ["two-spheres", "--out", "x.jpg"],
        ["two-spheres", "--method", "mc"],
    ):
        assert cli.main(["render", *arguments]) == 2


def test_describing_a_scene_loads_neither_warp_nor_torch():
    code = (
        "import sys; from nqr_geom import render; from nqr_geom.render.scene_gallery import gallery;"
        "gallery('teaser').effects(); print({'warp', 'torch', 'pyvista'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == "set()\n"


def test_rendering_starts_in_silence():
    code = (
        "from nqr_geom import render; from nqr_geom.render.scene_gallery import gallery;"
        "render.direct(gallery('two-spheres', 2, 2), spp=1)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert (done.stdout, done.stderr) == ("", "")


def test_fixture_room_has_every_kind_of_thing():
    assert two_spheres().effects() == {"shadows", "glossy", "texture", "light selection"}
