"""Winding numbers, distances and integrals on curves people bring: one integrator, many rules.

Importing this package loads neither torch nor VTK; each name below arrives with its module when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public name -> module that defines it; a module's own name gives the module.
_PUBLIC = {
    "Curve": "nqr_geom.curves.curve",
    "closest_point": "nqr_geom.api",
    "datasets": "nqr_geom.datasets",
    "distance": "nqr_geom.api",
    "distance_gradient": "nqr_geom.api",
    "frontier": "nqr_geom.api",
    "gwn": "nqr_geom.api",
    "gwn_gradient": "nqr_geom.api",
    "integrate": "nqr_geom.api",
    "laplace_gradient": "nqr_geom.gradients",
    "models": "nqr_geom.api",
    "problems": "nqr_geom.problems",
    "report": "nqr_geom.reporting.report",
    "rules": "nqr_geom.api",
    "samplers": "nqr_geom.api",
    "sd": "nqr_geom.api",
    "sd_gradient": "nqr_geom.api",
    "signed_distance": "nqr_geom.api",
    "solve_laplace": "nqr_geom.api",
    "solve_p_laplace": "nqr_geom.api",
}

__all__ = [
    "Curve",
    "__version__",
    "closest_point",
    "datasets",
    "distance",
    "distance_gradient",
    "frontier",
    "gwn",
    "gwn_gradient",
    "integrate",
    "laplace_gradient",
    "models",
    "problems",
    "report",
    "rules",
    "samplers",
    "sd",
    "sd_gradient",
    "signed_distance",
    "solve_laplace",
    "solve_p_laplace",
]

if TYPE_CHECKING:
    from nqr_geom import datasets as datasets
    from nqr_geom import problems as problems
    from nqr_geom.api import (
        closest_point,
        distance,
        distance_gradient,
        frontier,
        gwn,
        gwn_gradient,
        integrate,
        models,
        rules,
        samplers,
        sd,
        sd_gradient,
        signed_distance,
        solve_laplace,
        solve_p_laplace,
    )
    from nqr_geom.curves.curve import Curve
    from nqr_geom.gradients import laplace_gradient
    from nqr_geom.reporting.report import report


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'nqr_geom' has no attribute {name!r}")
    module = import_module(_PUBLIC[name])
    value = module if _PUBLIC[name] == f"nqr_geom.{name}" else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
