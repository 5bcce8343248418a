"""What a scene calls for, found before anything is rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nqr_geom.render.materials import Checker, Diffuse, Image

if TYPE_CHECKING:
    from nqr_geom.render.scene import Scene

__all__ = ["ALL", "found", "shadows_possible"]

ALL = frozenset(
    {"shadows", "glossy", "specular", "light selection", "texture"}
)  # what surfaces and lights can call for

_SPECULAR = 0.01  # GGX lobes narrower than this
_SLACK = 1e-9  # of the scene's size, for points that lie in a triangle's plane
_CHUNK = 2**22


def shadows_possible(scene: Scene) -> bool:
    """Whether a surface may stand between another one and a light.

    False is certain: all surfaces and lights lie on one side of every triangle, as in an empty room or on an open
    floor, or the only surface is a sphere, which hides from a light only what faces away from it.
    """
    triangles, spheres = scene.triangles, scene.spheres
    if not scene.lights or not len(triangles.faces):
        return bool(scene.lights) and len(spheres) > 1
    if spheres:
        return True
    corners = triangles.corners[triangles.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    level = (normal * corners[:, 0]).sum(axis=1)
    planes = np.unique(np.column_stack([normal, level]).round(12), axis=0)
    points = triangles.corners[np.unique(triangles.faces)]
    centre = scene.frame(np.array([light.center for light in scene.lights]))
    radius = np.array([light.radius for light in scene.lights]) / scene.frame.scale
    rows = max(1, _CHUNK // len(points))
    for first in range(0, len(planes), rows):  # the first triangle that has both sides settles it
        plane = planes[first : first + rows]
        surface = points @ plane[:, :3].T - plane[:, 3]
        light = centre @ plane[:, :3].T - plane[:, 3]
        above = np.minimum(surface.min(axis=0), (light - radius[:, None]).min(axis=0)) >= -_SLACK
        below = np.maximum(surface.max(axis=0), (light + radius[:, None]).max(axis=0)) <= _SLACK
        if not (above | below).all():
            return True
    return False


def found(scene: Scene) -> frozenset[str]:
    """The effects of a scene, see `Scene.effects`."""
    names = set()
    if shadows_possible(scene):
        names.add("shadows")
    if len(scene.lights) > 1:
        names.add("light selection")
    for material in scene.materials:
        if not isinstance(material, Diffuse):
            names.add("specular" if material.roughness < _SPECULAR else "glossy")
        if isinstance(getattr(material, "albedo", None), (Checker, Image)):
            names.add("texture")
    if scene.medium is not None and scene.medium.effects():
        names |= {"medium"} | {f"medium: {name}" for name in scene.medium.effects()}
    return frozenset(names)
