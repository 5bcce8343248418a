"""Small named scenes that many tests share: those of the hard cases, under the kernels that serve every scene."""

from __future__ import annotations

from nqr_geom.hard_cases.scenes import floor, looking_down, open_floor, two_spheres
from nqr_geom.render.effects import ALL

__all__ = ["EVERYTHING", "floor", "looking_down", "open_floor", "two_spheres"]

EVERYTHING = ALL  # the one variant of the kernels that serves every scene
