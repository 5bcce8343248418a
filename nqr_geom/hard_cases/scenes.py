"""Small scenes that hard cases of direct light share."""

from __future__ import annotations

from typing import Any

import numpy as np

from nqr_geom.render.camera import Camera
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import Checker, Conductor, Diffuse, Material, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.render.shapes import Mesh, Quad, Shape, Sphere

__all__ = ["floor", "looking_down", "open_floor", "two_spheres"]


def floor(material: Material | None = None, size: float = 1.0) -> Quad:
    """A square at height 0."""
    return Quad([-size, -size, 0], [2 * size, 0, 0], [0, 2 * size, 0], material or Diffuse(0.5))


def looking_down(width: int = 4, height: int = 4, fov: float = 20.0) -> Camera:
    """From above, slightly in front."""
    return Camera([0, -1, 3], [0, 0, 0], fov=fov, width=width, height=height)


def open_floor(lights: list[SphereLight] | None = None, material: Material | None = None, **camera: Any) -> Scene:
    """A floor with nothing on it."""
    lights = lights or [SphereLight([0.2, 0.1, 1.0], 0.3, [4.0, 2.0, 1.0])]
    return Scene(looking_down(**camera), [floor(material)], lights)


def two_spheres(resolution: int = 12, shift: Any = (0.0, 0.0, 0.0), scale: float = 1.0) -> Scene:
    """A room with every kind of shape and material, three lights and a texture."""

    def at(point: Any) -> Any:
        return scale * np.asarray(point, dtype=float) + np.asarray(shift)

    def quad(corner: Any, u: Any, v: Any, material: Material) -> Quad:
        return Quad(at(corner), scale * np.array(u), scale * np.array(v), material)

    tent = Mesh(
        [at(p) for p in ([-0.2, 0.5, 0.0], [0.3, 0.4, 0.0], [0.1, 0.8, 0.0], [0.05, 0.6, 0.9])],
        [[0, 1, 3], [1, 2, 3], [2, 0, 3]],
        Diffuse([0.3, 0.6, 0.3]),
    )
    shapes: list[Shape] = [
        quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], Diffuse(Checker(0.8, 0.3, 6))),
        quad([-1, 1, 0], [2, 0, 0], [0, 0, 2], Diffuse(0.7)),
        quad([-1, -1, 0], [0, 2, 0], [0, 0, 2], Plastic([0.7, 0.2, 0.2], 0.3)),
        tent,
        Sphere(at([-0.4, 0.1, 0.35]), 0.35 * scale, Conductor("gold", 0.15)),
        Sphere(at([0.5, -0.2, 0.3]), 0.3 * scale, Plastic([0.2, 0.3, 0.7], 0.1)),
    ]
    lights = [
        SphereLight(at([-0.5, -0.2, 1.6]), 0.1 * scale, [20.0, 15.0, 10.0]),
        SphereLight(at([0.5, 0.4, 1.5]), 0.15 * scale, [8.0, 10.0, 12.0]),
        SphereLight(at([0.1, -0.6, 0.8]), 0.05 * scale, 15.0),
    ]
    camera = Camera(at([0.4, -3.2, 1.1]), at([0, 0, 0.6]), fov=36.0, width=resolution, height=resolution)
    return Scene(camera, shapes, lights)
