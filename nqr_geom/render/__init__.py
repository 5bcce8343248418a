"""Light through volumes and onto surfaces, on NVIDIA Warp; only what a scene calls for runs.

Importing this package loads neither Warp nor torch; each name below arrives with its module when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# Public name -> module that defines it.
_PUBLIC = {
    "Extrusion": "nqr_geom.render.clouds",
    "Grid": "nqr_geom.render.volume",
    "Homogeneous": "nqr_geom.render.volume",
    "Noise": "nqr_geom.render.volume",
    "Spheres": "nqr_geom.render.clouds",
    "Torus": "nqr_geom.render.clouds",
    "Volume": "nqr_geom.render.volume",
    "transmittance": "nqr_geom.render.estimators",
}

__all__ = ["Extrusion", "Grid", "Homogeneous", "Noise", "Spheres", "Torus", "Volume", "transmittance"]

if TYPE_CHECKING:
    from nqr_geom.render.clouds import Extrusion, Spheres, Torus
    from nqr_geom.render.estimators import transmittance
    from nqr_geom.render.volume import Grid, Homogeneous, Noise, Volume


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'nqr_geom.render' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
