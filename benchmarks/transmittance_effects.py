"""What it saves to do only what a volume calls for: the same rays with everything on and with what is needed.

    python benchmarks/transmittance_effects.py [--quick]

Both columns give the same transmittances (checked); the time saved and the work left out are told effect by effect.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import best_seconds, write

import nqr_geom as ng
from nqr_geom import render
from nqr_geom.render.volume_families import view

Made = tuple[render.Volume, tuple[Any, Any, Any]]


def scenes(resolution: int) -> dict[str, Callable[[], Made]]:
    """Effect that is absent -> a volume and rays through it."""
    cloud = ng.datasets.volumes(1, seed=0)[0]
    assert isinstance(cloud, render.Spheres)
    box = [0.0] * 3, [10.0] * 3
    rays = view(cloud, resolution)
    wide = ((rays[0] - 5.0) * [4.0, 4.0, 1.0] + 5.0, rays[1], rays[2])  # 15 of 16 rays miss the box
    return {
        "no density": lambda: (render.Homogeneous(*box, density=0.0), rays),
        "no grid: the density is constant": lambda: (render.Grid(np.full((32, 32, 32), 0.3), *box), rays),
        "no noise": lambda: (replace(cloud, noise=None), rays),
        "noise of amplitude zero": lambda: (replace(cloud, noise=render.Noise(amplitude=0.0)), rays),
        "rays that miss the box": lambda: (cloud, wide),
        "noise where it cannot matter": lambda: (cloud, rays),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rays")
    quick = parser.parse_args().quick
    resolution, repeats = (64, 2) if quick else (160, 5)
    table = Table("absent", "ms", "with everything, ms", "times", "queries", "of", "noise", "of")
    rows = []
    for name, made in scenes(resolution).items():
        volume, rays = made()

        def run(everything: bool, volume: Any = volume, rays: Any = rays) -> Any:
            return render.transmittance(volume, *rays, n=24, full_output=True, everything=everything)

        lean, full = run(False), run(True)
        np.testing.assert_allclose(lean.value, full.value, rtol=1e-12)
        seconds = [best_seconds(lambda e=e: run(e), repeats) for e in (False, True)]  # type: ignore[misc]
        work = [[e.counts.get(kind, 0) for e in (lean, full)] for kind in ("queries", "noise")]
        rows.append({"absent": name, "ms": 1e3 * seconds[0], "everything_ms": 1e3 * seconds[1],
                     "times": seconds[1] / seconds[0], "queries": work[0], "noise": work[1],
                     "kernels": list(lean.plan["kernels"])})  # fmt: skip
        table.add_row(name, f"{1e3 * seconds[0]:.1f}", f"{1e3 * seconds[1]:.1f}", f"{seconds[1] / seconds[0]:.2f}",
                      *(f"{k:,}" for pair in work for k in pair))  # fmt: skip
    Console(width=120).print(table)
    print(write("transmittance_effects", rows, rays=resolution**2, queries=24))


if __name__ == "__main__":
    main()
