"""The random families that methods are measured and trained on."""

from __future__ import annotations

from nqr_geom.curves.families import curves
from nqr_geom.problems import toy

__all__ = ["curves", "toy"]
