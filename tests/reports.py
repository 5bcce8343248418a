"""The smallest report there is, for tests of reports and of their page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from nqr_geom.reporting.report import measured
from nqr_geom.reporting.settings import MODES

TINY = replace(
    MODES["quick"],
    budgets=(4, 16),
    runs=2,
    cell_seconds=1e9,
    most_learned=4,
    toy=12,
    shapes=2,
    grid=4,
    polygons=1,
    points=6,
    volumes=1,
    rays=2,
    scenes=1,
    pixels=2,
    triangles=(60,),
    p_triangles=(20, 60),
    residuals=(),
    truth=1e-4,
    edges=40,
    bar_sizes=(8,),
    bar_runs=3,
    bar_integrals=4,
    effect_pixels=4,
    effect_repeats=1,
    hard_seconds=0.0,
)


def tiny(folder: Path, *, sizes: Any = TINY, **options: Any) -> dict[str, Any]:
    """`nqr_geom.report` with the smallest sizes."""
    given = {"mode": "quick", "apps": None, "input": None, "text": False, "seed": 0, "tick": None} | options
    return measured(folder, sizes, **given)
