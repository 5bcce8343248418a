"""What it saves to compute only the effects that a scene calls for: direct light, effect by effect.

    python benchmarks/effects.py [--quick]

The same scene by kernels with everything on and by those made for it, in turns, the best of several repetitions; both
give the same picture. Times are processor time of the passes alone, 128 x 128 pixels, 16 passes.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import render
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.effects import ALL
from nqr_geom.render.scene_gallery import gallery

LIGHTS = [render.SphereLight([-0.5, 0.2, 1.5], 0.2, 6.0), render.SphereLight([0.6, -0.3, 1.2], 0.1, 9.0)]


def room(size: int, *things: Any, lights: int = 1, gloss: bool = False) -> render.Scene:
    """An open room with some things in it."""
    floor = render.Plastic(0.5, 0.2) if gloss else render.Diffuse(0.6)
    walls = [
        render.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], floor),
        render.Quad([-1, 1, 0], [2, 0, 0], [0, 0, 2], render.Diffuse(0.6)),
        render.Quad([-1, -1, 0], [0, 2, 0], [0, 0, 2], render.Diffuse(0.6)),
    ]
    camera = render.Camera([0.8, -3, 1], [0, 0, 0.8], width=size, height=size)
    return render.Scene(camera, walls + list(things), LIGHTS[:lights])


def seconds(problem: DirectProblem) -> float:
    """Processor time of all threads: the machine may be busy."""
    start = time.process_time()
    run(problem, Pmj(), BalanceHeuristic(), 16)
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller pictures; nothing is written")
    quick = parser.parse_args().quick
    size, repeats = (32, 3) if quick else (128, 9)
    ball = render.Sphere([0.2, 0.1, 0.4], 0.4, render.Diffuse(0.5))
    scenes = {
        "nothing: an empty room, one light": room(size),
        "choice of lights": room(size, lights=2),
        "gloss": room(size, gloss=True),
        "shadows": room(size, ball),
        "shadows and choice of lights": room(size, ball, lights=2),
        "everything": gallery("two-spheres", size, size),
    }
    rows: list[dict[str, Any]] = []
    for name, scene in scenes.items():
        lean, full = (DirectProblem.of(scene, effects=effects) for effects in (None, ALL | scene.effects()))
        pictures = [run(problem, Pmj(), BalanceHeuristic(), 16).value for problem in (lean, full)]
        turns = [(seconds(lean), seconds(full)) for _ in range(repeats)]
        best = np.min(turns, axis=0)
        for problem in (lean, full):
            problem.rays.update(dict.fromkeys(problem.rays, 0))
            run(problem, Pmj(), BalanceHeuristic(), 16)
        rows.append(
            {
                "case": name,
                "effects": sorted(scene.effects()),
                "ms": 1e3 * best[0],
                "ms_with_everything": 1e3 * best[1],
                "saved": 1.0 - best[0] / best[1],
                "rays": lean.rays["material"] + lean.rays["light"],
                "rays_with_everything": full.rays["material"] + full.rays["light"],
                "largest_difference": float(np.abs(pictures[0] - pictures[1]).max()),
            }
        )
    table = Table(
        "the scene calls for", "ms", "with everything", "time saved", "shadow rays", "with everything", "differs by"
    )
    for row in rows:
        table.add_row(
            row["case"], f"{row['ms']:.3g}", f"{row['ms_with_everything']:.3g}", f"{row['saved']:.0%}",
            f"{row['rays']:,}", f"{row['rays_with_everything']:,}", f"{row['largest_difference']:.0e}",
        )  # fmt: skip
    Console().print(table)
    if not quick:
        print(write("effects", rows, resolution=size, repeats=repeats, passes=16))


if __name__ == "__main__":
    main()
