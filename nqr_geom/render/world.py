"""Scenes as kernels see them: trees, lights and balls in Warp's memory, and what every pixel sees as plain rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom._warp import array, launch, wp
from nqr_geom.render import kernels_bsdf, kernels_direct, kernels_light
from nqr_geom.render.kernels_camera import meet
from nqr_geom.render.lights import light_tree
from nqr_geom.render.materials import COAT_NODES, Checker, Conductor, Diffuse, Image, Material, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.streams import Stream

__all__ = ["Assembled", "assemble", "lights_seen", "rows_of", "see"]

Floats = NDArray[np.float64]
Rows = NDArray[Any]


def _empty(struct: Any, count: int) -> Rows:
    """Zeroed rows in the layout of a Warp struct."""
    return np.zeros(count, struct.numpy_dtype())


@dataclass(frozen=True, eq=False)
class Assembled:
    """Scenes in Warp's memory.

    Parameters
    ----------
    scenes : tuple of Scene
        What was assembled.
    struct : Warp struct
        The `World` that kernels take.
    meshes : tuple
        Warp's meshes, kept alive.
    coats : dict
        Row of the table of coats for (roughness, index of refraction).
    balls : tuple of int
        Number of each scene's first ball.
    medium : Medium or None
        All media of the scenes.
    """

    scenes: tuple[Scene, ...]
    struct: Any
    meshes: tuple[Any, ...]
    coats: dict[tuple[float, float], int]
    balls: tuple[int, ...]
    medium: Any


def rows_of(dtype: Any, rows: Rows) -> Any:
    """A Warp array of structs over the memory of a structured NumPy array."""
    return wp.array(np.ascontiguousarray(rows), dtype=dtype, device="cpu", copy=False)


def _mesh(scene: Scene) -> Any:
    """Warp's tree over the triangles of a scene, in float32, or None."""
    triangles = scene.triangles
    if not len(triangles.faces):
        return None
    points = wp.array(triangles.corners.astype(np.float32), dtype=wp.vec3, device="cpu")
    return wp.Mesh(points, wp.array(triangles.faces.astype(np.int32).ravel(), dtype=wp.int32, device="cpu"))


def assemble(scenes: Sequence[Scene]) -> Assembled:
    """Put scenes into Warp's memory, one behind the other."""
    places = _empty(kernels_direct.Place, len(scenes))
    meshes: list[Any] = []
    balls: list[Rows] = []
    lights: list[Rows] = []
    nodes: list[Rows] = []
    volumes: list[Any] = []
    n_balls = n_lights = n_nodes = 0
    for k, scene in enumerate(scenes):
        meshes.append(_mesh(scene))
        ball = _empty(kernels_direct.Ball, len(scene.spheres))
        light = _empty(kernels_light.Light, len(scene.lights))
        # Without lights there is one leaf that holds none: a walk down the tree must find its end.
        node = _empty(kernels_light.Node, max(1, 2 * len(light) - 1))
        node["child"] = node["parent"] = node["light"] = -1
        for one, sphere in zip(ball, scene.spheres, strict=True):
            one["centre"], one["radius"] = scene.frame(sphere.center), sphere.radius / scene.frame.scale
        for one, source in zip(light, scene.lights, strict=True):
            one["centre"], one["radius"] = scene.frame(source.center), source.radius / scene.frame.scale
            one["radiance"] = source.emission
        if len(light):
            tree = light_tree(light["centre"], light["radius"], light["radiance"])
            leaf = np.flatnonzero(tree.light >= 0)
            light["leaf"][tree.light[leaf]] = leaf + n_nodes
            node["centre"], node["radius"], node["power"] = tree.centre, tree.radius, tree.power
            for name, first in (("child", n_nodes), ("parent", n_nodes), ("light", n_lights)):
                of = getattr(tree, name)
                node[name] = np.where(of >= 0, of + first, -1)
        places[k]["mesh"] = meshes[-1].id if meshes[-1] is not None else 0
        places[k]["balls"], places[k]["balls_end"] = n_balls, n_balls + len(ball)
        places[k]["lights"], places[k]["lights_end"] = n_lights, n_lights + len(light)
        places[k]["root"] = n_nodes
        places[k]["volume"] = -1
        if "medium" in scene.effects():
            places[k]["volume"], places[k]["scale"] = len(volumes), scene.frame.scale
            places[k]["corner"] = scene.frame.centre - scene.medium.low
            volumes.append(scene.medium)
        for parts, part in ((balls, ball), (lights, light), (nodes, node)):
            parts.append(part)
        n_balls, n_lights, n_nodes = n_balls + len(ball), n_lights + len(light), n_nodes + len(node)
    plastics = [m for scene in scenes for m in scene.materials if isinstance(m, Plastic)]
    coats = {(m.roughness, m.ior): m.coat[0] for m in plastics}
    world = kernels_direct.World()
    world.places = rows_of(kernels_direct.Place, places)
    world.balls = rows_of(kernels_direct.Ball, np.concatenate(balls))
    world.lights = rows_of(kernels_light.Light, np.concatenate(lights))
    world.nodes = rows_of(kernels_light.Node, np.concatenate(nodes))
    world.coat = array(np.array(list(coats.values())) if coats else np.zeros((1, COAT_NODES)), wp.float64)
    medium = None
    if volumes:
        from nqr_geom.render.medium import Medium

        medium = Medium.of(volumes)
        world.medium = medium.packed
    first = np.cumsum([0, *(len(ball) for ball in balls)]).tolist()
    rows_of_coats = {key: k for k, key in enumerate(coats)}
    return Assembled(tuple(scenes), world, tuple(meshes), rows_of_coats, tuple(first[:-1]), medium)


def _material_rows(materials: Sequence[Material], coats: dict[tuple[float, float], int]) -> Rows:
    """The part of a surface's row that its material decides; textures come later."""
    rows = _empty(kernels_bsdf.Surface, len(materials))
    for row, material in zip(rows, materials, strict=True):
        if isinstance(material, Conductor):
            row["kind"], row["eta"], row["k"] = kernels_bsdf.CONDUCTOR, material.eta, material.k
        else:
            row["kind"] = kernels_bsdf.DIFFUSE if isinstance(material, Diffuse) else kernels_bsdf.PLASTIC
            row["albedo"] = 0.0 if isinstance(material.albedo, (Checker, Image)) else material.albedo
        if isinstance(material, Plastic):
            row["eta"] = material.ior
            row["table"], row["transmitted"] = coats[material.roughness, material.ior], material.coat[1]
        row["roughness"] = 1.0 if isinstance(material, Diffuse) else material.roughness
    return rows


def _textured(rows: Rows, materials: Sequence[Material], of: NDArray[np.int64], uv: Floats) -> None:
    """Look up the textures of the materials that have one."""
    for k, material in enumerate(materials):
        texture = getattr(material, "albedo", None)
        if isinstance(texture, (Checker, Image)):
            rows["albedo"][of == k] = texture.at(uv[of == k])


def _on_triangles(rows: Rows, scene: Scene, face: NDArray[np.int64], origin: Floats, w: Floats) -> Floats:
    """Positions and normals on triangles, and texture coordinates: once more and in float64, on the triangle itself."""
    triangles = scene.triangles
    corner = triangles.faces[face]
    a, b, c = (triangles.corners[corner[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    across = np.cross(w, c - a)
    determinant = (across * (b - a)).sum(axis=1)
    safe = np.where(determinant == 0.0, 1.0, determinant)
    s = (across * (origin - a)).sum(axis=1) / safe
    t = (np.cross(origin - a, b - a) * w).sum(axis=1) / safe
    weights = np.clip(np.stack([1.0 - s - t, s, t], axis=1), 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    rows["position"] = np.einsum("mk,mkd->md", weights, triangles.corners[corner])
    geometric = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    geometric *= np.where((geometric * w).sum(axis=1, keepdims=True) > 0.0, -1.0, 1.0)
    shading = np.einsum("mk,mkd->md", weights, triangles.normals[corner])
    length = np.linalg.norm(shading, axis=1, keepdims=True)
    shading = shading / np.where(length > 0.0, length, 1.0)
    shading *= np.where((shading * geometric).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    # A smooth normal that looks away from the viewer (or is NaN: there is none) gives way to the triangle's.
    sound = (length > 0.0) & ((shading * w).sum(axis=1, keepdims=True) < -1e-9)
    rows["geometric"], rows["normal"] = geometric, np.where(sound, shading, geometric)
    return np.einsum("mk,mkd->md", weights, triangles.uv[corner])


def _on_spheres(rows: Rows, scene: Scene, ball: NDArray[np.int64], origin: Floats, w: Floats, t: Floats) -> Floats:
    """Positions and normals on spheres, and texture coordinates."""
    centre = scene.frame(np.array([s.center for s in scene.spheres]))[ball]
    radius = np.array([s.radius for s in scene.spheres])[ball, None] / scene.frame.scale
    outward = origin + t[:, None] * w - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    rows["position"] = centre + radius * outward
    facing = outward * np.where((outward * w).sum(axis=1, keepdims=True) > 0.0, -1.0, 1.0)
    rows["geometric"] = rows["normal"] = facing
    turn = np.arctan2(outward[:, 1], outward[:, 0]) / (2.0 * np.pi)
    return np.column_stack([turn + 0.5, np.arcsin(np.clip(outward[:, 2], -1.0, 1.0)) / np.pi + 0.5])


def _met(world: Assembled, k: int, origin: Floats, w: Floats) -> tuple[Rows, Rows, Floats]:
    """Kind, number and distance of what rays from one point meet first, see `kernels_camera.meet`."""
    kind, index, distance = np.empty(len(w), np.int32), np.empty(len(w), np.int32), np.empty(len(w))
    out = [array(kind, wp.int32), array(index, wp.int32), array(distance, wp.float64)]
    launch(meet, len(w), [world.struct, k, wp.vec3d(*origin), array(w, wp.vec3d), *out])
    return kind, index, distance


def lights_seen(scene: Scene) -> Floats:
    """Radiance of the lights that the camera sees directly, (h, w, 3): the part that `direct` leaves out."""
    camera = scene.camera
    kind, index, _ = _met(assemble([scene]), 0, scene.frame(camera.position), camera.rays())
    emission = np.array([light.emission for light in scene.lights]).reshape(-1, 3)
    seen = np.zeros((len(kind), 3))
    seen[kind == 2] = emission[index[kind == 2]]
    return seen.reshape(camera.height, camera.width, 3)


def see(world: Assembled, k: int, jitter: Stream | None = None) -> Rows:
    """What the pixels of scene `k` see, row by row from the top left: a structured array (height * width,).

    Parameters
    ----------
    world : Assembled
    k : int
        Which scene.
    jitter : Stream, optional
        Look through a random point of each pixel.
    """
    scene = world.scenes[k]
    w = np.ascontiguousarray(scene.camera.rays(jitter))
    origin = scene.frame(scene.camera.position)
    kind, index, distance = _met(world, k, origin, w)
    rows = _empty(kernels_bsdf.Surface, len(w))
    rows["kind"] = -1
    materials = _material_rows(scene.materials, world.coats)
    for shape in (0, 1):
        at = np.flatnonzero(kind == shape)
        if not len(at):
            continue
        which = index[at].astype(np.int64) - (world.balls[k] if shape else 0)
        of = which + len(scene.meshes) if shape else scene.triangles.material[which]
        part = materials[of]
        if shape:
            uv = _on_spheres(part, scene, which, origin, w[at], distance[at])
        else:
            uv = _on_triangles(part, scene, which, origin, w[at])
        _textured(part, scene.materials, of, uv)
        rows[at] = part
    rows["outgoing"] = -w
    rows["scene"] = k
    rows["through"] = 1.0
    level = (rows["normal"] * rows["outgoing"]).sum(axis=1)
    rows["kind"][~(level > 0.0)] = -1  # seen from the edge: no side
    if "medium" in scene.effects():
        from nqr_geom.render.kernels_fog import camera_fog

        weaken = camera_fog(world.medium.kind, world.medium.noisy)
        launch(weaken, len(rows), [world.struct, rows_of(kernels_bsdf.Surface, rows), wp.vec3d(*origin)])
    return rows
