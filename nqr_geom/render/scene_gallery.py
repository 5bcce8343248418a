"""Scenes outside the training family, rebuilt from simple shapes after those of Section 6.1, and any mesh in a room."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nqr_geom import check
from nqr_geom.render.camera import Camera
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import Checker, Conductor, Diffuse, Material, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.render.shapes import Mesh, Quad, Shape, Sphere

__all__ = ["GALLERY", "gallery", "on_a_floor"]

Point = tuple[float, float, float]


def _box(low: Point, high: Point, material: Material) -> Mesh:
    """An axis-aligned box."""
    corners = [[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)]
    faces = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6],
             [0, 6, 2], [1, 3, 7], [1, 7, 5]]  # fmt: skip
    return Mesh(corners, faces, material)


def _room(floor: Material, walls: Material, wide: float = 2.0, deep: float = 2.0, high: float = 2.4) -> list[Shape]:
    """Floor, ceiling, back and side walls; open to the viewer at negative y."""
    return [
        Quad([-wide, -deep, 0], [2 * wide, 0, 0], [0, 2 * deep, 0], floor),
        Quad([-wide, -deep, high], [2 * wide, 0, 0], [0, 2 * deep, 0], walls),
        Quad([-wide, deep, 0], [2 * wide, 0, 0], [0, 0, high], walls),
        Quad([-wide, -deep, 0], [0, 2 * deep, 0], [0, 0, high], walls),
        Quad([wide, -deep, 0], [0, 2 * deep, 0], [0, 0, high], walls),
    ]


def _column(x: float, y: float, radius: float, high: float, material: Material, sides: int = 24) -> Mesh:
    """A closed cylinder with smooth sides: every vertex once for the side and once for the lid."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(sides)], axis=1)
    low, up = radius * ring + [x, y, 0.0], radius * ring + [x, y, high]
    k = np.arange(sides)
    following = (k + 1) % sides
    side = np.concatenate(
        [np.stack([k, following, following + sides], 1), np.stack([k, following + sides, k + sides], 1)]
    )
    lid = np.stack([np.full(sides, 3 * sides), k + 2 * sides, following + 2 * sides], axis=1)
    vertices = np.concatenate([low, up, up, [[x, y, high]]])
    normals = np.concatenate([ring, ring, np.tile([0.0, 0.0, 1.0], (sides + 1, 1))])
    return Mesh(vertices, np.concatenate([side, lid]), material, normals=normals)


def _two_spheres(width: int, height: int) -> Scene:
    """A metal and a plastic ball in a corner."""
    shapes = _room(Diffuse(Checker(0.8, 0.3, 8)), Diffuse([0.7, 0.68, 0.62]), 1.4, 1.4, 2.0)
    shapes.append(Sphere([-0.5, 0.3, 0.4], 0.4, Conductor("gold", 0.15)))
    shapes.append(Sphere([0.5, -0.1, 0.35], 0.35, Plastic([0.2, 0.3, 0.7], 0.1)))
    lights = [
        SphereLight([-0.6, -0.2, 1.6], 0.1, [20, 15, 10]),
        SphereLight([0.6, 0.4, 1.5], 0.15, [8, 10, 12]),
        SphereLight([0.0, -0.7, 0.9], 0.05, 15.0),
    ]
    return Scene(Camera([0, -3.6, 1.1], [0, 0, 0.8], 40.0, width, height), shapes, lights)


def _teaser(width: int, height: int) -> Scene:
    """Shiny and matt things on a chequered floor under small, coloured, strong lights."""
    shapes = _room(Diffuse(Checker([0.75, 0.7, 0.6], [0.25, 0.2, 0.2], 10)), Diffuse([0.65, 0.7, 0.75]))
    shapes += [
        Sphere([-0.9, 0.5, 0.45], 0.45, Conductor("copper", 0.08)),
        Sphere([0.1, 0.9, 0.6], 0.6, Plastic([0.75, 0.2, 0.15], 0.05)),
        Sphere([0.9, 0.1, 0.35], 0.35, Conductor("silver", 0.25)),
        Sphere([-0.15, -0.5, 0.25], 0.25, Diffuse([0.2, 0.6, 0.3])),
        _box((-1.8, -0.3, 0.0), (-1.3, 0.2, 1.1), Diffuse([0.8, 0.6, 0.3])),
        _column(1.45, 0.9, 0.3, 1.3, Plastic([0.25, 0.35, 0.7], 0.15)),
    ]
    lights = [
        SphereLight([-1.0, -0.6, 1.9], 0.06, [120, 60, 30]),
        SphereLight([1.1, -0.5, 1.7], 0.08, [20, 45, 80]),
        SphereLight([0.3, 0.4, 2.0], 0.05, [60, 60, 50]),
    ]
    return Scene(Camera([0.3, -4.4, 1.5], [0, 0.2, 0.75], 36.0, width, height), shapes, lights)


def _white_room(width: int, height: int) -> Scene:
    """Pale, matt furniture in a bright room."""
    white = Diffuse(0.85)
    shapes = _room(Diffuse([0.7, 0.62, 0.52]), white, 2.2, 2.2, 2.6)
    shapes += [
        _box((-1.5, 0.6, 0.0), (-0.1, 1.5, 0.45), Diffuse([0.8, 0.8, 0.78])),
        _box((-1.5, 1.3, 0.45), (-0.1, 1.5, 1.0), Diffuse([0.8, 0.8, 0.78])),
        _box((0.5, -0.1, 0.5), (1.5, 0.7, 0.56), Plastic(0.75, 0.2)),
        *(_column(x, y, 0.04, 0.5, white, 12) for x in (0.58, 1.42) for y in (0.0, 0.6)),
        _column(1.7, 1.7, 0.18, 0.9, Diffuse([0.5, 0.6, 0.5])),
        Sphere([1.0, 0.3, 0.71], 0.15, Diffuse([0.75, 0.5, 0.4])),
        Quad([-1.2, 2.19, 1.3], [0.9, 0, 0], [0, 0, 0.7], Diffuse(Checker([0.7, 0.3, 0.2], [0.2, 0.3, 0.5], 3))),
    ]
    lights = [
        SphereLight([0.0, 0.0, 2.2], 0.25, [9.0, 8.6, 8.0]),
        SphereLight([1.7, 1.7, 1.25], 0.14, [12.0, 9.0, 6.0]),
        SphereLight([-1.9, -0.8, 1.6], 0.2, [5.0, 6.0, 8.0]),
    ]
    return Scene(Camera([0.4, -4.6, 1.4], [0, 0.4, 0.9], 38.0, width, height), shapes, lights)


def _living_room(width: int, height: int) -> Scene:
    """Sofa, table and shelf in wood, cloth and brass, under three lamps."""
    wood, cloth = Plastic([0.45, 0.27, 0.14], 0.2), Diffuse([0.3, 0.35, 0.5])
    shapes = _room(
        Diffuse(Checker([0.55, 0.4, 0.28], [0.45, 0.32, 0.22], 12)), Diffuse([0.75, 0.7, 0.6]), 2.4, 2.0, 2.5
    )
    shapes += [
        _box((-2.0, 0.9, 0.15), (0.2, 1.8, 0.5), cloth),
        _box((-2.0, 1.6, 0.5), (0.2, 1.8, 1.05), cloth),
        _box((-0.9, -0.3, 0.4), (0.5, 0.4, 0.46), wood),
        *(_box((x, y, 0.0), (x + 0.08, y + 0.08, 0.4), wood) for x in (-0.85, 0.37) for y in (-0.25, 0.27)),
        *(_box((1.5, 1.0, z), (2.38, 1.4, z + 0.05), wood) for z in (0.4, 0.9, 1.4, 1.9)),
        _column(-0.3, 0.0, 0.12, 0.7, Conductor("copper", 0.2)),
        Sphere([1.9, 1.2, 1.1], 0.15, Conductor("gold", 0.1)),
        Sphere([0.25, 0.1, 0.55], 0.09, Plastic([0.7, 0.1, 0.1], 0.08)),
        _box((1.65, 1.05, 0.45), (1.8, 1.35, 0.75), Diffuse([0.6, 0.2, 0.2])),
    ]
    lights = [
        SphereLight([-0.2, 0.2, 2.1], 0.16, [18, 15, 11]),
        SphereLight([-2.1, 1.5, 1.5], 0.12, [16, 11, 6]),
        SphereLight([1.2, -0.9, 1.6], 0.08, [14, 16, 20]),
    ]
    return Scene(Camera([0.2, -4.6, 1.5], [0, 0.3, 0.85], 38.0, width, height), shapes, lights)


def _staircase(width: int, height: int) -> Scene:
    """Steps up a wall with a rail: many edges, soft shadows of thin bars."""
    stone = Diffuse([0.6, 0.58, 0.54])
    shapes = _room(Diffuse([0.45, 0.4, 0.36]), Diffuse([0.72, 0.7, 0.66]), 2.0, 2.0, 3.0)
    for k in range(9):
        x = -1.7 + 0.38 * k
        shapes.append(_box((x, 0.9, 0.0), (x + 0.38, 1.98, 0.2 * (k + 1)), stone))
        shapes.append(_column(x + 0.19, 0.95, 0.025, 0.2 * (k + 1) + 0.7, Conductor("aluminium", 0.2), 12))
    lights = [
        SphereLight([-0.9, 0.1, 2.6], 0.18, [12, 11, 9]),
        SphereLight([1.2, -0.4, 2.3], 0.1, [14, 16, 19]),
        SphereLight([-1.5, -0.9, 0.9], 0.12, [10, 6, 3]),
    ]
    return Scene(Camera([0.3, -5.0, 1.6], [0, 0.4, 1.15], 38.0, width, height), shapes, lights)


def _plates(width: int, height: int) -> Scene:
    """Metal plates of four roughnesses, each tilted to mirror a row of lights from tiny to large, after Veach 1997."""
    eye = np.array([0.0, -6.0, 2.2])
    row = np.array([0.0, 1.2, 2.6])
    shapes: list[Shape] = [
        Quad([-4, -4, 0], [8, 0, 0], [0, 8, 0], Diffuse(0.35)),
        Quad([-4, 2.4, 0], [8, 0, 0], [0, 0, 5], Diffuse(0.35)),
    ]
    for k, roughness in enumerate((0.005, 0.02, 0.05, 0.1)):
        middle = np.array([0.0, 1.5 - 0.75 * k, 1.25 - 0.3 * k])
        normal = [v / np.linalg.norm(v) for v in (eye - middle, row - middle)]
        halfway = normal[0] + normal[1]
        halfway = halfway / np.linalg.norm(halfway)
        along, across = np.array([3.6, 0.0, 0.0]), 0.6 * np.cross(halfway, [1.0, 0.0, 0.0])
        metal = Conductor("aluminium", roughness)
        shapes.append(Quad(middle - 0.5 * along - 0.5 * across, along, across, metal))
    lights = [
        SphereLight(row + np.array([x, 0.0, 0.0]), radius, 0.16 / radius**2 * np.array(tint))
        for x, radius, tint in (
            (-1.35, 0.02, (1.0, 0.8, 0.6)),
            (-0.45, 0.06, (0.7, 1.0, 0.7)),
            (0.45, 0.16, (0.6, 0.8, 1.0)),
            (1.35, 0.4, (1.0, 0.7, 0.9)),
        )
    ]
    return Scene(Camera(eye, [0, 0.5, 1.1], 34.0, width, height), shapes, lights)


GALLERY: dict[str, Callable[[int, int], Scene]] = {
    "two-spheres": _two_spheres,
    "teaser": _teaser,
    "white-room": _white_room,
    "living-room": _living_room,
    "staircase": _staircase,
    "plates": _plates,
}


def gallery(name: str, width: int = 128, height: int = 128) -> Scene:
    """A scene by name: "two-spheres", "teaser", "white-room", "living-room", "staircase" or "plates".

    Parameters
    ----------
    name : str
    width, height : int
        Pixels.

    Examples
    --------
    >>> sorted(gallery("plates", 8, 8).effects())
    ['glossy', 'light selection', 'shadows', 'specular']
    """
    return GALLERY[check.choice("name", name, GALLERY)](width, height)


def on_a_floor(mesh: Any, width: int = 128, height: int = 128) -> Scene:
    """A mesh of any size on a floor under three lights, seen from a little above.

    Parameters
    ----------
    mesh : Mesh
    width, height : int
        Pixels.
    """
    if not isinstance(mesh, Mesh) or not len(mesh.faces):
        raise ValueError("mesh: expected a Mesh with at least one face")
    used = mesh.vertices[np.unique(mesh.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    half = 0.5 * float((high - low).max())
    base = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])

    def at(x: float, y: float, z: float) -> Any:
        return base + half * np.array([x, y, z])

    floor = Quad(at(-4, -4, 0), [8 * half, 0, 0], [0, 8 * half, 0], Diffuse(0.6))
    lights = [
        SphereLight(at(-1.8, -1.8, 3.0), 0.5 * half, [11.0, 9.5, 8.0]),
        SphereLight(at(2.4, -0.8, 2.2), 0.3 * half, [7.0, 9.0, 12.0]),
        SphereLight(at(0.6, 2.2, 3.2), 0.4 * half, 6.0),
    ]
    camera = Camera(at(1.2, -4.6, 2.4), at(0, 0, 0.8), 36.0, width, height)
    return Scene(camera, [floor, mesh], lights)
