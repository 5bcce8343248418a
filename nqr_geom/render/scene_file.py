"""Scenes from JSON files: the constructors' own names, nested."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from nqr_geom.render.camera import Camera
from nqr_geom.render.lights import SphereLight
from nqr_geom.render.materials import Checker, Conductor, Diffuse, Material, Plastic
from nqr_geom.render.scene import Scene
from nqr_geom.render.scene_gallery import GALLERY, gallery, on_a_floor
from nqr_geom.render.shapes import Mesh, Quad, Shape, Sphere

__all__ = ["read_scene", "scene_named"]

_MATERIALS: dict[str, Any] = {"diffuse": Diffuse, "conductor": Conductor, "plastic": Plastic}


def _made(what: str, maker: Any, given: Any) -> Any:
    """Call a constructor with the entries of a JSON object, or say what is wrong with it."""
    if not isinstance(given, dict):
        raise ValueError(f"{what}: expected an object, got {given!r}")
    try:
        return maker(**given)
    except TypeError as error:
        raise ValueError(f"{what}: {error}") from error


def _material(given: Any) -> Material:
    entries = dict(given) if isinstance(given, dict) else {}
    kind = entries.pop("type", None)
    if kind not in _MATERIALS:
        raise ValueError(f"material: expected an object with type {', '.join(_MATERIALS)}, got {given!r}")
    if isinstance(entries.get("albedo"), dict):
        entries["albedo"] = _made("albedo", Checker, entries["albedo"])
    return _made(f"material {kind}", _MATERIALS[kind], entries)


def _shape(given: Any, folder: Path) -> Shape:
    entries = dict(given) if isinstance(given, dict) else {}
    kind = entries.pop("type", None)
    entries["material"] = _material(entries.get("material", {"type": "diffuse"}))
    if kind == "mesh" and "file" in entries:
        moves = {name: entries.pop(name) for name in ("shift", "scale", "turn") if name in entries}
        path = folder / str(entries.pop("file"))
        mesh: Mesh = _made("mesh", lambda **rest: Mesh.from_file(path, **rest), entries)
        return _made("mesh", mesh.moved, moves)
    makers: dict[str, Any] = {"mesh": Mesh, "quad": Quad, "sphere": Sphere}
    if kind not in makers:
        raise ValueError(f"shape: expected an object with type {', '.join(makers)}, got {given!r}")
    return _made(kind, makers[kind], entries)


def read_scene(path: str | Path) -> Scene:
    """A scene from a JSON file.

    The file holds an object with "camera", "shapes" and "lights", whose entries are the arguments of `Camera`, `Mesh`,
    `Quad`, `Sphere`, `SphereLight` and the materials. Shapes and materials have a "type": mesh, quad or sphere;
    diffuse, conductor or plastic. A mesh may name a "file" beside the scene's, and "scale", "turn" and "shift" it. An
    albedo may be an object with "even", "odd" and "squares": a chequered texture.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    ValueError
        If the file is not there, not JSON, or an entry is wrong; the message names the entry.
    """
    file = Path(path)
    if not file.is_file():
        raise ValueError(f"path: expected an existing scene file, got {str(path)!r}")
    try:
        data = json.loads(file.read_text())
    except ValueError as error:
        raise ValueError(f"path: expected JSON, got {str(path)!r} ({error})") from error
    if not isinstance(data, dict) or not {"camera", "shapes", "lights"} >= set(data) or "camera" not in data:
        raise ValueError(f"path: expected an object with camera, shapes and lights, got {str(path)!r}")
    camera = _made("camera", Camera, data["camera"])
    shapes = [_shape(entry, file.parent) for entry in data.get("shapes", [])]
    lights = [_made("light", SphereLight, entry) for entry in data.get("lights", [])]
    return Scene(camera, shapes, lights)


def scene_named(name: str, width: int, height: int) -> Scene:
    """The scene that a user names: one of the gallery, a JSON file, or a mesh file that is put on a floor."""
    if name in GALLERY:
        return gallery(name, width, height)
    if name.lower().endswith(".json"):
        return read_scene(name)
    if not Path(name).suffix:
        raise ValueError(f"scene: expected one of {', '.join(GALLERY)}, a .json scene or a mesh file, got {name!r}")
    return on_a_floor(Mesh.from_file(name, Plastic([0.7, 0.6, 0.45], 0.15), smooth=True), width, height)
