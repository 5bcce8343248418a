"""Scenes that break naive renderers: tiny lights, near mirrors, grazing views, far worlds, nothing at all.

Truths are closed forms (light of spheres on a diffuse floor), limits (a point light, a mirror), bounds (a furnace), and
no change where nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch

from nqr_geom.hard_cases.case import Case, deviation, refusal
from nqr_geom.hard_cases.scenes import floor, looking_down, open_floor, two_spheres
from nqr_geom.integrator.estimate import Estimate, run
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj, Random
from nqr_geom.render.camera import Camera
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.effects import ALL
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import Checker, Conductor, Diffuse, Material, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.render.shapes import Mesh, Quad, Shape, Sphere
from nqr_geom.streams import Stream

__all__ = ["cases"]


def _picture(scene: Scene, n: int = 16) -> tuple[DirectProblem, Estimate]:
    """By both techniques under the balance heuristic, in the one variant of the kernels that serves every scene."""
    problem = DirectProblem.of(scene, effects=ALL)
    return problem, run(problem, Pmj(), BalanceHeuristic(), n, seed=0)


def _must(*conditions: object) -> float:
    """0 if all hold, else infinity."""
    return 0.0 if all(conditions) else float("inf")


def _mirrored(material: Material) -> Scene:
    camera = Camera([0, -1, 1], [0, 0, 0], width=5, height=5)
    return Scene(camera, [floor(material)], [SphereLight([0, 1, 1], 0.05, 9.0)])


def _grazing(material: Material) -> Scene:
    """A floor seen at a cosine of 1e-4 and less."""
    camera = Camera([0, -1, 1e-4], [0, 0, 0], fov=0.02, width=3, height=3)
    return Scene(camera, [floor(material, 2.0)], [SphereLight([0, 0.5, 0.2], 0.1, 9.0)])


_MATERIALS: dict[str, Callable[[float], Material]] = {
    "gold": lambda roughness: Conductor("gold", roughness),
    "plastic": lambda roughness: Plastic(0.5, roughness),
}


def _finite(scene: Scene) -> float:
    problem, got = _picture(scene, 64)
    seen = (problem.surfaces["kind"] >= 0).sum() >= 3
    return _must(seen, np.isfinite(got.value).all(), (got.value >= 0.0).all())


def _reflectance(name: str, roughness: float) -> float:
    """The mirror image of the light shines as the light does, times the reflectance."""
    share = _picture(_mirrored(_MATERIALS[name](roughness)), 256)[1].value.max() / 9.0
    return _must((0.7 if name == "gold" else 0.03) < share < 1.0)


def _balance() -> float:
    """f/p times p is f cos L whatever the technique, and weights lie in [0, 1]."""
    problem = DirectProblem.of(two_spheres(8), effects=ALL)
    x = torch.rand(problem.batch, 64, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    seen = problem.evaluate(x)
    density = seen.technique_pdf
    if density is None:
        return float("nan")
    weights = BalanceHeuristic().combine(Random().draw(problem, 64, Stream(5))).weights
    fine = torch.isfinite(density).all() and (density >= 0.0).all() and ((weights >= 0.0) & (weights <= 1.0)).all()
    cosine = seen.features["direction"][..., 2:]
    own = density.diagonal(dim1=2, dim2=3)[..., None]
    lit = seen.value > 0.0
    light = problem.world.struct.lights.numpy()["radiance"][seen.features["light"].long().clamp_min(0).numpy()[..., 0]]
    expected = seen.features["bsdf"] * cosine * torch.from_numpy(light)
    got = ((seen.value * own)[lit] / expected[lit]).numpy()
    return max(_must(fine, lit.any()), deviation(got, np.ones_like(got)))


def _moved(shift: Any, scale: float) -> float:
    """float64 loses digits of positions to the shift; the edge of a shadow may move by them, in one pixel of 100."""
    near, far = (_picture(scene)[1].value for scene in (two_spheres(), two_spheres(shift=shift, scale=scale)))
    apart = np.abs(far - near).max(axis=1) > 1e-6 * near.max()
    return max(_must(apart.mean() <= 0.01), float(np.abs(far - near).mean() / near.mean()))


def _away(problem: DirectProblem, place: Any) -> Any:
    """From the surfaces to a place, in the user's world."""
    frame = problem.world.scenes[0].frame
    return np.asarray(place) - (problem.surfaces["position"] * frame.scale + frame.centre)


def _shrunk(radius: float) -> float:
    """A light that shrinks with constant power tends to a point."""
    place, intensity = [0.4, 0.3, 0.9], 2.0
    problem, got = _picture(open_floor([SphereLight(place, radius, intensity / (np.pi * radius**2))]))
    away = _away(problem, place)
    point = 0.5 / np.pi * intensity * away[:, 2] / (away**2).sum(axis=1) ** 1.5
    return deviation(got.value[:, 0] / point, np.ones(len(point)))


def _naive_shrunk() -> float:
    """Solid angle from the cosine of its half angle, which is 1 in single precision."""
    s = np.float32(1e-4)
    return float(abs(2.0 * np.pi * (1.0 - np.sqrt(np.float32(1.0) - s * s)) / (np.pi * 1e-8) - 1.0))


def _unhidden(height: float, radius: float, aside: float, n: int = 1024) -> float:
    """A diffuse floor under one sphere, above or across its horizon: mean over pixels of reflected over closed form."""
    problem, got = _picture(open_floor([SphereLight([aside, 0.0, height], radius, 3.0)], Diffuse(0.8)), n)
    away = _away(problem, [aside, 0.0, height])
    d = np.linalg.norm(away, axis=1)
    s, cosine = radius / d, away[:, 2] / d
    truth = 0.8 / np.pi * 3.0 * _irradiance(s, cosine)
    return float(abs(got.value[:, 0].sum() / truth.sum() - 1.0))


def _irradiance(s: Any, cosine: Any) -> Any:
    """Of a sphere of radiance 1 by s = R/d and the cosine of its centre: by rings around it, 4,000 of them.

    A ring at angle t about the centre's direction is above the horizon for part of its turn: the integral of the cosine
    over that part is closed form.
    """
    at = (np.arange(4000) + 0.5) / 4000
    t = np.arcsin(s)[:, None] * at
    up, across = cosine[:, None] * np.cos(t), np.sqrt(1.0 - cosine[:, None] ** 2) * np.sin(t)
    turn = np.arccos(np.clip(-up / np.maximum(across, 1e-300), -1.0, 1.0))
    inside = 2.0 * (up * turn + across * np.sin(turn))
    return (np.maximum(inside, 0.0) * np.sin(t)).mean(axis=1) * np.arcsin(s)


def _inside_light() -> float:
    """Surfaces inside a light, and under another."""
    scene = open_floor([SphereLight([0, 0, 0], 0.5, 1.0), SphereLight([0, 0, 1], 0.1, 1.0)])
    return _must(np.isfinite(_picture(scene)[1].value).all())


def _black(shapes: list[Shape], lights: list[SphereLight]) -> float:
    return deviation(_picture(Scene(looking_down(), shapes, lights))[1].value, 0.0)


def _hidden_light() -> float:
    """A light before one a million times brighter hides it."""
    front, back = SphereLight([0, 0, 0.5], 0.2, 1.0), SphereLight([0, 0, 2.0], 0.3, 1e6)
    camera = Camera([0, -0.9, 0.05], [0, 0, 0], fov=0.1, width=1, height=1)
    alone, both = (_picture(Scene(camera, [floor()], lights), 64)[1].value for lights in ([front], [front, back]))
    return float(abs(both[0, 0] / alone[0, 0] - 1.0))


def _self_shadow() -> float:
    """A floor of a thousand coplanar triangles, tilted, lit at a grazing angle: the share of samples in shadow."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 24), [0.1]), axis=-1).reshape(-1, 3)
    corner = (np.arange(23)[:, None] * 24 + np.arange(23)).ravel()
    faces = [np.stack([corner, corner + 1, corner + 25], 1), np.stack([corner, corner + 25, corner + 24], 1)]
    tilted = grid @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    normal = np.cross(tilted[1] - tilted[0], tilted[24] - tilted[0])
    normal /= np.linalg.norm(normal)
    centre, along = tilted.mean(axis=0), tilted[23] - tilted[0]
    along /= np.linalg.norm(along)
    light = SphereLight(centre + 3.0 * along + 0.02 * normal, 0.01, 1.0)
    camera = Camera(centre + 3 * normal, centre, fov=20.0, width=16, height=16, up=along)
    problem = DirectProblem.of(Scene(camera, [Mesh(tilted, np.concatenate(faces))], [light]), effects=ALL)
    samples = Pmj().draw(problem, 16, Stream(5))
    if not (samples.seen.features["lambert"][:, :, 1, 0] > 0.0).all():
        return float("nan")
    return float((samples.value[:, :, 1, 0] <= 0.0).double().mean())


def _ball() -> float:
    """A ball is lit up to its horizon and no farther."""
    camera, light = looking_down(16, 16, 30.0), SphereLight([3, 0, 0], 0.01, 1e4)
    problem, got = _picture(Scene(camera, [Sphere([0, 0, 0], 0.7, Diffuse(1.0))], [light]))
    facing = (problem.surfaces["normal"] * [1.0, 0.0, 0.0]).sum(axis=1)
    seen = problem.surfaces["kind"] >= 0
    return _must((got.value[seen & (facing > 0.3)] > 0.0).all(), (got.value[seen & (facing < -0.01)] == 0.0).all())


def _linear() -> float:
    """Lights add up: each counts as it does alone, whichever others there are."""
    lights = [SphereLight([0.3 * k - 0.4, 1.3, 0.6 + 0.1 * k], 0.05, 1.0 + k) for k in range(4)]
    alone = sum(_picture(open_floor([light]), 256)[1].value for light in lights)
    together = _picture(open_floor(lights), 1024)[1].value
    return deviation(together / alone, np.ones_like(together))


def _furnace(material: Material) -> float:
    """Under a sky of radiance 1 (the floor inside a huge light) nothing sends back more than 1."""
    scene = Scene(looking_down(), [floor(material)], [SphereLight([0, 0, 0], 50.0, 1.0)])
    return float(max(0.0, _picture(scene, 1024)[1].value.mean() - 1.0))


_NOTHING: dict[str, tuple[list[Shape], list[SphereLight]]] = {
    "no surface": ([], [SphereLight([0, 0, 5], 0.1, 1.0)]),
    "no light": ([floor()], []),
    "nothing at all": ([], []),
    "a mesh without faces": ([Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))], []),
    "a light below the floor": ([floor()], [SphereLight([0, 0, -1], 0.1, 1.0)]),
    "dark lights": ([floor()], [SphereLight([0, 0, 1], 0.1, 0.0), SphereLight([0.2, 0, 1], 0.1, 0.0)]),
}


def _refused() -> list[tuple[str, Callable[[], object], str, type[Exception]]]:
    o, box = [0, 0, 0], Quad([0, 0, 0], [1, 0, 0], [0, 1, 0])
    triangle: Any = partial(Mesh, [[0, 0, 0]])
    table: list[tuple[str, Callable[[], object], str]] = [
        ("a light of no size", partial(SphereLight, o, 0.0), r"radius: expected a number > 0.0, got 0.0"),
        ("a light nowhere", partial(SphereLight, [0, 0, np.nan], 1.0), "center: expected finite numbers"),
        ("a light that takes light", partial(SphereLight, o, 1.0, [-1, 0, 0]), "emission: expected numbers >= 0"),
        ("an albedo above 1", partial(Diffuse, 1.5), r"albedo: expected numbers in \[0, 1\]"),
        ("no such metal", partial(Conductor, "unobtainium"), "metal: expected one of aluminium"),
        ("half an index", partial(Conductor, eta=[1, 1, 1]), "eta: expected eta and k together"),
        ("too smooth", partial(Conductor, roughness=1e-5), "roughness: expected a number >= 0.0001"),
        ("plastic of air", partial(Plastic, ior=1.0), "ior: expected a number > 1.0"),
        ("a flat centre", partial(Sphere, [0, 0], 1.0), r"center: expected shape \(3,\)"),
        ("no area", partial(Quad, o, [1, 0, 0], [2, 0, 0]), "u: expected edges that span an area"),
        ("a vertex that is not there", partial(triangle, [[0, 0, 1]]), r"faces: expected integers in \[0, 1\)"),
        ("half a vertex", partial(triangle, [[0, 0, 0.5]]), r"faces: expected integers in \[0, 1\)"),
        ("looking along up", partial(Camera, [0, 0, 1], o), "up: expected a direction that is not along"),
        ("looking nowhere", partial(Camera, [0, 1, 1], [0, 1, 1]), "up: expected a direction that is not along"),
        ("too wide a view", partial(Camera, [0, 1, 1], o, fov=180), "fov: expected a number > 0.0 and <= 170"),
        ("no pixels", partial(Camera, [0, 1, 1], o, width=0), "width: expected an integer >= 1"),
        ("no such file", partial(Mesh.from_file, "nowhere.ply", Diffuse()), "path: expected an existing mesh file"),
        ("texture without coordinates", partial(Mesh, box.vertices, box.faces, Diffuse(Checker(0.1, 0.9))),
         "uv: expected texture coordinates for a textured material"),
    ]  # fmt: skip
    sphere: Any = partial(Sphere, o, 1.0)
    scene: Any = partial(Scene, looking_down())
    word: Any = partial(Scene, "camera")  # type: ignore[arg-type]
    kinds: list[tuple[str, Callable[[], object], str]] = [
        ("a colour as material", partial(sphere, "red"), "material: expected Diffuse, Conductor or Plastic, got str"),
        ("a word as camera", partial(word, [], []), "camera: expected a Camera, got str"),
        ("a camera as shape", partial(scene, [looking_down()], []), "shapes: expected Mesh or Sphere"),
        ("one light alone", partial(scene, [], SphereLight(o, 1)), "lights: expected a sequence"),
    ]
    return [*((*row, ValueError) for row in table), *((*row, TypeError) for row in kinds)]


def cases() -> list[Case]:
    """Direct light."""
    group, made = "direct", []

    def add(name: str, run: Callable[[], float], bound: float, naive: Callable[[], float] | None = None) -> None:
        made.append(Case(group, name, run, bound, naive))

    for name, make in _MATERIALS.items():
        for roughness in (1e-2, 1e-3, 1e-4):
            add(f"near mirror [{name}, {roughness:g}]", partial(_finite, _mirrored(make(roughness))), 0.0)
            add(f"grazing view [{name}, {roughness:g}]", partial(_finite, _grazing(make(roughness))), 0.0)
            add(f"mirror image of a light [{name}, {roughness:g}]", partial(_reflectance, name, roughness), 0.0)
        add(f"furnace [{name}]", partial(_furnace, make(0.2)), 2e-3)
    add("furnace [white]", partial(_furnace, Diffuse(1.0)), 2e-3)
    add("both techniques tell of the same integrand", _balance, 1e-9)
    for shift, scale in (((1e4, -3e3, 5e2), 1.0), ((0, 0, 0), 1e5), ((1e4, 0, 0), 1e-3)):
        add(f"a world that is far, large or small [{shift[0]:g}, {scale:g}]", partial(_moved, shift, scale), 1e-3)
    for radius, close in ((1e-2, 1e-3), (1e-4, 1e-7), (1e-7, 1e-9)):
        naive = _naive_shrunk if radius == 1e-4 else None
        add(f"a light that shrinks [{radius:g}]", partial(_shrunk, radius), max(close, 2 * radius), naive)
    add("a sphere above the horizon", partial(_unhidden, 1.0, 0.3, 1.5), 1e-3)
    add("a sphere across the horizon", partial(_unhidden, 0.05, 0.4, 2.0), 5e-3)
    add("a sphere mostly below the horizon", partial(_unhidden, -0.3, 0.4, 2.0), 2e-2)
    add("a surface inside a light", _inside_light, 0.0)
    for name, (shapes, lights) in _NOTHING.items():
        add(f"black: {name}", partial(_black, shapes, lights), 0.0)
    add("a light before a brighter one", _hidden_light, 0.05)
    add("no shadow on itself", _self_shadow, 0.0)
    add("a ball up to its horizon", _ball, 0.0)
    add("lights add up", _linear, 0.02)
    made += [refusal(group, name, call, words, error) for name, call, words, error in _refused()]
    return made
