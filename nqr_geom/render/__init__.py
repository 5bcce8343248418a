"""Light through volumes and onto surfaces, on NVIDIA Warp; only what a scene calls for runs.

Importing this package loads neither Warp nor torch; each name below arrives with its module when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# Public name -> module that defines it.
_PUBLIC = {
    "Camera": "nqr_geom.render.camera",
    "Checker": "nqr_geom.render.materials",
    "Conductor": "nqr_geom.render.materials",
    "Diffuse": "nqr_geom.render.materials",
    "Extrusion": "nqr_geom.render.clouds",
    "Grid": "nqr_geom.render.volume",
    "Homogeneous": "nqr_geom.render.volume",
    "Image": "nqr_geom.render.materials",
    "Mesh": "nqr_geom.render.shapes",
    "Noise": "nqr_geom.render.volume",
    "Plastic": "nqr_geom.render.materials",
    "Quad": "nqr_geom.render.shapes",
    "Scene": "nqr_geom.render.scene",
    "Sphere": "nqr_geom.render.shapes",
    "SphereLight": "nqr_geom.render.lights",
    "Spheres": "nqr_geom.render.clouds",
    "Torus": "nqr_geom.render.clouds",
    "Volume": "nqr_geom.render.volume",
    "direct": "nqr_geom.render.direct_light",
    "transmittance": "nqr_geom.render.estimators",
}

__all__ = [
    "Camera",
    "Checker",
    "Conductor",
    "Diffuse",
    "Extrusion",
    "Grid",
    "Homogeneous",
    "Image",
    "Mesh",
    "Noise",
    "Plastic",
    "Quad",
    "Scene",
    "Sphere",
    "SphereLight",
    "Spheres",
    "Torus",
    "Volume",
    "direct",
    "transmittance",
]

if TYPE_CHECKING:
    from nqr_geom.render.camera import Camera
    from nqr_geom.render.clouds import Extrusion, Spheres, Torus
    from nqr_geom.render.direct_light import direct
    from nqr_geom.render.estimators import transmittance
    from nqr_geom.render.lights import SphereLight
    from nqr_geom.render.materials import Checker, Conductor, Diffuse, Image, Plastic
    from nqr_geom.render.scene import Scene
    from nqr_geom.render.shapes import Mesh, Quad, Sphere
    from nqr_geom.render.volume import Grid, Homogeneous, Noise, Volume


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'nqr_geom.render' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
