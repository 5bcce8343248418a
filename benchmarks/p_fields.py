"""The picture of Fig. 50: p = 3 by 32 walks a pixel, beside the exact solution for p = 2, against finite elements.

    python benchmarks/p_fields.py [--out FOLDER]

Draws docs/p-fields.png, a held-out polygon in each row: the solution for p = 3 by finite elements, that for p = 2, the
network's answer for p = 3 from 32 walks, and the absolute errors of the last two with their mean squares.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import SEED, N
from figures import DOCS, figure, outlined, save
from shapes import write
from walk_fields import framed

from nqr_geom import registry
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.integrator.estimate import run
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import polygons
from nqr_geom.wos.measures import vertex_measures
from nqr_geom.wos.problems import LaplaceProblem

SHAPES = (10, 3, 7)
METHOD = ("walk-spread-full", "inet-p-laplace")
TRIANGLES = 250
RESOLUTION = 56


def draw(path: Path) -> list[dict[str, Any]]:
    """All panels; returns a row of results for each polygon."""
    vertices, values = polygons(max(SHAPES) + 1, SEED)
    made = figure(11.5, 2.3 * len(SHAPES) + 0.9)
    axes = made.subplots(len(SHAPES), 5)
    rows = []
    for line, shape in zip(axes, SHAPES, strict=True):
        domain = Domain.of(vertices[shape])
        grid, inside, extent = framed(domain, RESOLUTION)
        points = domain.from_frame(grid[inside])
        truth = p_laplace(Mesh.of(vertices[shape], TRIANGLES, order=2), values[shape], 3.0, order=2)(points)
        two = vertex_measures(vertices[shape], points)[0] @ values[shape]
        problem = LaplaceProblem.of(vertices[shape], values[shape], points)
        made_of = registry.make("sampler", METHOD[0]), registry.make("rule", METHOD[1])
        three = run(problem, *made_of, N, seed=SEED).value[:, 0]
        most, worst = float(np.abs(truth).max()), float(np.abs(two - truth).max())
        shown = {"finite elements, p = 3": truth, "exact, p = 2": two, f"INet, p = 3, {N} walks": three}
        errors = {"error of p = 2": two - truth, "error of INet": three - truth}
        for axis, (title, field) in zip(line, (shown | errors).items(), strict=True):
            whole = np.full(RESOLUTION**2, np.nan)
            whole[inside] = np.abs(field) if title in errors else field
            look = {"cmap": "viridis", "vmin": 0.0, "vmax": worst} if title in errors else {
                "cmap": "RdBu_r", "vmin": -most, "vmax": most}  # fmt: skip
            image = axis.imshow(whole.reshape(RESOLUTION, -1), origin="lower", extent=extent, **look)
            outlined(axis, domain.start)
            note = f"{title}: {np.square(field).mean():.1e}" if title in errors else title
            axis.set_title(note, fontsize=9)
        bar = made.colorbar(image, ax=line, shrink=0.85, pad=0.01, format="%.2g")
        bar.set_label("absolute error")
        mse = {name: float(np.square(field).mean()) for name, field in errors.items()}
        rows.append({"polygon": shape, "n": N, "pixels": int(inside.sum()), "mse_two": mse["error of p = 2"],
                     "mse": mse["error of INet"]})  # fmt: skip
    save(made, path)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    rows = draw(out / "p-fields.png")
    for row in rows:
        print(row | {"ratio": row["mse_two"] / row["mse"]})
    if out == DOCS:
        print(write("p_fields", rows, n=N, seed=SEED, triangles=TRIANGLES, resolution=RESOLUTION))


if __name__ == "__main__":
    main()
