"""Shapes and bookkeeping that the exact-answer benchmarks share."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

Floats = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results"


def star(n: int, seed: int = 0) -> Floats:
    """A rough star: n vertices at random radii around seven waves."""
    angle = 2 * np.pi * np.arange(n) / n
    radius = 0.8 + 0.15 * np.sin(7 * angle) + 0.05 * np.random.default_rng(seed).random(n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def spiral(n: int, turns: int = 20) -> Floats:
    """A thin band wound `turns` times: every box of half a turn holds most queries."""
    s = np.linspace(0, 1, n // 2)
    angle = 2 * np.pi * turns * s
    ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    radius = (0.1 + 0.8 * s)[:, None]
    return np.concatenate([radius * ray, (ray * (radius + 0.01))[::-1]])


def zigzag(n: int) -> Floats:
    """Teeth as high as the shape: no edge is short."""
    x = np.linspace(-1, 1, n - 2)
    teeth = np.stack([x, np.where(np.arange(n - 2) % 2, 0.9, -0.9)], axis=1)
    return np.concatenate([teeth, [[1.0, -1.0], [-1.0, -1.0]]])


def soup(n: int, seed: int = 1) -> Floats:
    """n short segments (n, 2, 2) without any connection."""
    rng = np.random.default_rng(seed)
    middle, half = rng.uniform(-1, 1, (n, 1, 2)), rng.normal(0, 0.02, (n, 1, 2))
    return np.concatenate([middle - half, middle + half], axis=1)


def best_seconds(function: Callable[[], Any], repeats: int) -> float:
    """Smallest wall time of `repeats` calls, after one that is not counted."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def show_beside_libigl(rows: list[dict[str, Any]]) -> None:
    """Print what was measured against libigl, one line a case."""
    table = Table("case", "build ms", "us / query", "libigl us / query", "times faster", "largest difference")
    for row in rows:
        table.add_row(
            row["case"],
            *(f"{row[key]:.3g}" for key in ("build_ms", "us_per_query", "libigl_us_per_query")),
            f"{row['ratio']:,.2f}",
            f"{row['largest_difference']:.1e}",
        )
    Console().print(table)


def write(name: str, rows: list[dict[str, Any]], **settings: Any) -> Path:
    """Write rows with machine, versions and settings to results/<name>.json."""
    packages = ("nqr-geom", "numpy", "numba", "libigl")
    report: Mapping[str, Any] = {
        "benchmark": name,
        "machine": {
            "processor": platform.machine(),
            "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
            "system": platform.system(),
        },
        "versions": {"python": platform.python_version()} | {p: version(p) for p in packages},
        "settings": settings,
        "rows": rows,
    }
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(report, indent=1) + "\n")
    return path
