"""Random scenes after Fig. 39: five template rooms, 1 to 4 generated objects, random materials, three sphere lights.

The paper's objects come from a collection of models; here they are PyVista's parametric surfaces and solids. The
constants that the paper leaves open are such that its baselines come out (`benchmarks/direct_light.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.render.camera import Camera
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import METALS, Conductor, Diffuse, Material, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.render.shapes import Mesh, Quad, Shape
from nqr_geom.streams import Stream

__all__ = ["TEMPLATES", "scenes"]

Floats = NDArray[np.float64]


class Dice:
    """Random numbers of one scene, one after the other: a function of (seed, split, number of the scene)."""

    def __init__(self, stream: Stream, row: int) -> None:
        self._stream, self._row, self._count = stream, row, 0

    def uniform(self, low: float = 0.0, high: float = 1.0, size: int | None = None) -> Any:
        """One number or `size` of them in (low, high)."""
        many = 1 if size is None else size
        u = self._stream.uniform(np.array([self._row]), self._count + np.arange(many))
        self._count += many
        numbers = low + (high - low) * u
        return float(numbers[0]) if size is None else numbers

    def log_uniform(self, low: float, high: float) -> float:
        """A number whose logarithm is uniform."""
        return float(np.exp(self.uniform(np.log(low), np.log(high))))

    def pick(self, options: Any) -> Any:
        """One of a sequence."""
        return options[int(self.uniform() * len(options))]


def _material(dice: Dice) -> Material:
    """Diffuse half of the time, else metal or plastic."""
    kind = dice.uniform()
    if kind < 0.5:
        return Diffuse(dice.uniform(0.1, 0.9, 3))
    roughness = dice.log_uniform(0.05, 0.5)
    if kind < 0.75:
        return Conductor(dice.pick(sorted(METALS)), roughness)
    return Plastic(dice.uniform(0.1, 0.9, 3), roughness)


def _surface(dice: Dice) -> Any:
    """A PyVista surface, about as large as the unit sphere."""
    pv = check.require("pyvista", "plot", "generated objects")
    makers: tuple[Callable[[], Any], ...] = (
        lambda: pv.ParametricEllipsoid(
            1.0, dice.uniform(0.4, 1.0), dice.uniform(0.4, 1.0), u_res=40, v_res=40, w_res=2
        ),
        lambda: pv.ParametricSuperEllipsoid(
            n1=dice.log_uniform(0.3, 2.0), n2=dice.log_uniform(0.3, 2.0), u_res=40, v_res=40, w_res=2
        ),
        lambda: pv.ParametricTorus(1.0, dice.uniform(0.2, 0.5), u_res=48, v_res=24, w_res=2),
        lambda: pv.ParametricSuperToroid(
            n1=dice.log_uniform(0.4, 2.0), n2=dice.log_uniform(0.4, 2.0), u_res=40, v_res=24, w_res=2
        ),
        lambda: pv.ParametricConicSpiral(a=0.3, b=1.0, c=0.1, n=2.0, u_res=60, v_res=24, w_res=2),
        lambda: pv.ParametricBour(u_res=40, v_res=40, w_res=2),
        lambda: pv.Box((-0.7, 0.7, -dice.uniform(0.3, 0.9), 0.6, -0.5, dice.uniform(0.3, 1.2))),
        lambda: pv.Cone(direction=(0, 0, 1), height=1.6, radius=0.8, resolution=32),
        lambda: pv.Cylinder(direction=(0, 0, 1), height=dice.uniform(0.6, 2.0), radius=0.5, resolution=32),
        lambda: pv.PlatonicSolid(dice.pick(["tetrahedron", "octahedron", "icosahedron", "dodecahedron"])),
    )
    return dice.pick(makers)()


def _object(dice: Dice) -> Mesh:
    """A generated object of random size and turn that stands on the floor or floats a little above it."""
    surface = _surface(dice)
    mesh = Mesh.from_pyvista(surface, _material(dice), smooth=True)
    points = mesh.vertices
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * float((high - low).max())
    mesh = mesh.moved(-0.5 * (low + high)).moved(scale=dice.uniform(0.2, 0.45) / half, turn=dice.uniform(0.0, 360.0))
    bottom = float(mesh.vertices[:, 2].min())
    lift = max(0.0, dice.uniform(-0.3, 0.3))
    return mesh.moved([dice.uniform(-0.6, 0.6), dice.uniform(-0.6, 0.6), lift - bottom])


FLOOR = ((-1, -1, 0), (2, 0, 0), (0, 2, 0))
BACK = ((-1, 1, 0), (2, 0, 0), (0, 0, 2))
LEFT = ((-1, -1, 0), (0, 2, 0), (0, 0, 2))
RIGHT = ((1, -1, 0), (0, 2, 0), (0, 0, 2))
CEILING = ((-1, -1, 2), (2, 0, 0), (0, 2, 0))

# Quads of each template: corner and two edges, in a room of [-1, 1] x [-1, 1] x [0, 2].
TEMPLATES = (
    (FLOOR, BACK, LEFT, RIGHT, CEILING),
    (FLOOR, BACK, LEFT),
    (FLOOR, BACK, ((-0.9, 0.4, 0.5), (0.8, 0, 0), (0, 0.55, 0)), ((0.1, 0.4, 1.0), (0.8, 0, 0), (0, 0.55, 0))),
    (FLOOR, LEFT, RIGHT, CEILING, ((-0.5, 0.9, 0), (1.0, 0, 0), (0, 0.1, 1.4))),
    (FLOOR, BACK, ((-0.35, 0.2, 0), (0.7, 0, 0), (0, 0, 0.4)), ((-0.35, 0.2, 0.4), (0.7, 0, 0), (0, 0.8, 0)), RIGHT),
)


def _lights(dice: Dice) -> list[SphereLight]:
    """Three spheres of random size and strength under the ceiling."""
    made = []
    for _ in range(3):
        radius = dice.log_uniform(0.04, 0.2)
        strength = dice.log_uniform(0.2, 1.5) / radius**2
        colour = dice.uniform(0.5, 1.0, 3)
        place = [dice.uniform(-0.75, 0.75), dice.uniform(-0.75, 0.75), dice.uniform(1.1, 1.75)]
        made.append(SphereLight(place, radius, strength * colour / colour.max()))
    return made


def _scene(dice: Dice, resolution: int) -> Scene:
    shapes: list[Shape] = [Quad(corner, u, v, _material(dice)) for corner, u, v in dice.pick(TEMPLATES)]
    shapes += [_object(dice) for _ in range(1 + int(dice.uniform(0.0, 4.0)))]
    lights = _lights(dice)
    turn = dice.uniform(-0.35, 0.35)
    distance = dice.uniform(2.4, 3.4)
    position = [distance * np.sin(turn), -distance * np.cos(turn), dice.uniform(0.6, 1.6)]
    look = [dice.uniform(-0.2, 0.2), 0.0, dice.uniform(0.4, 0.8)]
    camera = Camera(position, look, fov=dice.uniform(35.0, 50.0), width=resolution, height=resolution)
    return Scene(camera, shapes, lights)


def scenes(n: int, seed: int = 0, split: str = "test", resolution: int = 128) -> list[Scene]:
    """The first n scenes of a seed and split; the same index is the same scene.

    Parameters
    ----------
    n : int
        How many, >= 1.
    seed : int
        Which family.
    split : {"test", "train", "validation"}
        Scenes of different splits have nothing in common.
    resolution : int
        Pixels along each side.

    Returns
    -------
    list of Scene

    References
    ----------
    Fig. 39 and Appendix A.3 of the paper.

    Examples
    --------
    >>> scene = scenes(1, resolution=16)[0]
    >>> len(scene.lights), scene.camera.width
    (3, 16)
    """
    stream = Stream(check.integer("seed", seed), split, "scenes")
    resolution = check.integer("resolution", resolution, low=1)
    return [_scene(Dice(stream, k), resolution) for k in range(check.integer("n", n, low=1))]
