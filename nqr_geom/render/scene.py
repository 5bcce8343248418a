"""A scene: a camera, surfaces, lights, and perhaps a medium; and what it calls for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nqr_geom.render import effects
from nqr_geom.render.camera import Camera
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import Material
from nqr_geom.render.shapes import Mesh, Shape, Sphere
from nqr_geom.render.volume import Volume

__all__ = ["Frame", "Scene"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Frame(NamedTuple):
    """Surfaces of a scene moved and scaled so that they fit into [-1, 1]^3."""

    centre: Floats
    scale: float

    def __call__(self, points: Any) -> Floats:
        """Points of the world in the frame."""
        return (np.asarray(points, dtype=np.float64) - self.centre) / self.scale


class Triangles(NamedTuple):
    """All triangles of a scene, one mesh behind the other.

    Attributes
    ----------
    corners : (n, 3) float64
        Vertices in the frame.
    faces : (m, 3) int64
    material : (m,) int64
        Index into `Scene.materials`.
    uv : (n, 2)
        Zero where a mesh has none.
    normals : (n, 3)
        NaN where a mesh is not smooth.
    """

    corners: Floats
    faces: Ints
    material: Ints
    uv: Floats
    normals: Floats


@dataclass(frozen=True, eq=False)
class Scene:
    """Surfaces under spherical lights before a camera.

    Light that the camera sees directly is not part of direct illumination and left out: a pixel in which a light
    stands is black. Lights hide surfaces and one another.

    Parameters
    ----------
    camera : Camera
    shapes : sequence of Mesh, Quad or Sphere
        May be empty.
    lights : sequence of SphereLight
        May be empty.
    medium : volume, optional
        A volume of `nqr_geom.render` that weakens light on its way to surfaces and to the camera.

    Examples
    --------
    >>> from nqr_geom import render
    >>> floor = render.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], render.Diffuse(0.8))
    >>> camera = render.Camera([0, -3, 1], [0, 0, 0], width=4, height=4)
    >>> scene = render.Scene(camera, [floor], [render.SphereLight([0, 0, 1], 0.1, 10.0)])
    >>> sorted(scene.effects())
    []
    """

    camera: Camera
    shapes: Sequence[Shape]
    lights: Sequence[SphereLight]
    medium: Any = None

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise TypeError(f"camera: expected a Camera, got {type(self.camera).__name__}")
        object.__setattr__(self, "shapes", self._all("shapes", self.shapes, (Mesh, Sphere)))
        object.__setattr__(self, "lights", self._all("lights", self.lights, (SphereLight,)))
        if self.medium is not None and not isinstance(self.medium, Volume):
            raise TypeError(f"medium: expected a volume or None, got {type(self.medium).__name__}")

    @staticmethod
    def _all(name: str, given: Any, kinds: tuple[type[Any], ...]) -> tuple[Any, ...]:
        try:
            items = tuple(given)
        except TypeError as error:
            raise TypeError(f"{name}: expected a sequence, got {type(given).__name__}") from error
        for item in items:
            if not isinstance(item, kinds):
                wanted = " or ".join(kind.__name__ for kind in kinds)
                raise TypeError(f"{name}: expected {wanted} objects, got {type(item).__name__}")
        return items

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """Shapes made of triangles."""
        return tuple(shape for shape in self.shapes if isinstance(shape, Mesh) and len(shape.faces))

    @property
    def spheres(self) -> tuple[Sphere, ...]:
        """Shapes that are exact spheres."""
        return tuple(shape for shape in self.shapes if isinstance(shape, Sphere))

    @property
    def materials(self) -> tuple[Material, ...]:
        """Materials of the meshes, then of the spheres, one a shape."""
        shapes: tuple[Shape, ...] = (*self.meshes, *self.spheres)
        return tuple(shape.material for shape in shapes)

    @cached_property
    def frame(self) -> Frame:
        """Where the surfaces lie: moved and scaled in float64 before any kernel sees them."""
        points = [mesh.vertices[np.unique(mesh.faces)] for mesh in self.meshes]
        points += [np.add(s.center, k * s.radius)[None] for s in self.spheres for k in (-1.0, 1.0)]
        if not points:
            return Frame(np.zeros(3), 1.0)
        low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
        return Frame(0.5 * (low + high), float(0.5 * (high - low).max()) or 1.0)

    @cached_property
    def triangles(self) -> Triangles:
        """All meshes as one, in the frame."""
        meshes = self.meshes
        if not meshes:
            empty = np.zeros((0, 3))
            return Triangles(empty, empty.astype(np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), empty)
        counts = [len(mesh.vertices) for mesh in meshes]
        before = np.concatenate([[0], np.cumsum(counts)[:-1]])
        return Triangles(
            self.frame(np.concatenate([mesh.vertices for mesh in meshes])),
            np.concatenate([mesh.faces + first for mesh, first in zip(meshes, before, strict=True)]),
            np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes]),
            np.concatenate(
                [np.zeros((n, 2)) if mesh.uv is None else mesh.uv for mesh, n in zip(meshes, counts, strict=True)]
            ),
            np.concatenate(
                [
                    np.full((n, 3), np.nan) if mesh.normals is None else mesh.normals
                    for mesh, n in zip(meshes, counts, strict=True)
                ]
            ),
        )

    def effects(self) -> frozenset[str]:
        """What this scene calls for; nothing else is computed.

        "shadows" (a surface may stand between another one and a light), "glossy" and "specular" (lobes wider and
        narrower than 0.01), "light selection" (more than one light), "texture", "medium" and what
        the medium says of itself.

        Returns
        -------
        frozenset of str
        """
        return self._effects

    @cached_property
    def _effects(self) -> frozenset[str]:
        return effects.found(self)
