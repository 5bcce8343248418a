"""The random families that methods are measured and trained on."""

from __future__ import annotations

from nqr_geom.curves.families import curves
from nqr_geom.problems import toy
from nqr_geom.render.scene_families import scenes
from nqr_geom.wos.families import polygons

__all__ = ["curves", "polygons", "scenes", "toy"]
