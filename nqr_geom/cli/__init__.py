"""The command line: fields of a curve as pictures or arrays, and what their accuracy costs.

Each module holds one family of commands, which register with `app` when this package is imported.
"""

from nqr_geom.cli import curves, health, measuring, pdes, rendering, reporting, training
from nqr_geom.cli._app import app, main

__all__ = ["app", "curves", "health", "main", "measuring", "pdes", "rendering", "reporting", "training"]
