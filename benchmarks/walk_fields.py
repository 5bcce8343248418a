"""Pictures of errors by 32 walks a pixel: held-out polygons (Fig. 32) and domains unlike the training's (Fig. 33).

    python benchmarks/walk_fields.py [--out FOLDER]

Draws docs/walk-fields.png and docs/walk-fields-outside.png, a domain in each row: the solution by the boundary solver,
then the absolute error of every method on one logarithmic scale, with its mean square over the pixels. The squared
errors of Table 14 are means over many more polygons: `learned_walks.py`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import SEED, N, Pair
from figures import DOCS, figure, outlined, save
from numpy.typing import NDArray
from shapes import write

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from nqr_geom.wos.boundary import solve
from nqr_geom.wos.domain import Boundary, Domain
from nqr_geom.wos.families import polygons
from nqr_geom.wos.outlines import outlines
from nqr_geom.wos.problems import LaplaceProblem

Floats = NDArray[np.float64]

RESOLUTION = 40
SHOWN = 5
TOLERANCE = 1e-3
SCALE = (1e-5, 1e-1)  # of absolute errors


def methods() -> dict[str, Pair]:
    """What is compared: a title, a sampler and a rule."""
    return {
        "MC": ("random", "mc"),
        "LHS": ("latin-hypercube", "mc"),
        "INet on LHS": ("latin-hypercube", "inet-laplace-uniform"),
        "structured": registry.method("structured", "laplace"),
        "INet": registry.method("inet", "laplace"),
    } | ({"SNet + INet": registry.method("nqr", "laplace")} if "laplace:nqr" in registry.ALIASES else {})


def framed(domain: Domain, resolution: int) -> tuple[Floats, NDArray[np.bool_], tuple[float, ...]]:
    """Pixel centres of a square around a domain, in its frame, which of them lie inside, and the square."""
    low, high = domain.start.min(axis=0), domain.start.max(axis=0)
    middle, half = 0.5 * (low + high), 0.51 * float((high - low).max())
    line = half * ((2.0 * np.arange(resolution) + 1.0) / resolution - 1.0)
    grid = (np.stack(np.meshgrid(line, line), axis=-1) + middle).reshape(-1, 2)
    return (
        grid,
        domain.contains(grid),
        (*(middle[0] + half * np.array([-1, 1])), *(middle[1] + half * np.array([-1, 1]))),
    )


def row(axes: Any, name: str, boundary: Boundary) -> tuple[list[dict[str, Any]], Any]:
    """One domain: its panels, and a row of results for each method."""
    domain = boundary.domain
    grid, inside, extent = framed(domain, RESOLUTION)
    problem = LaplaceProblem.joined([boundary], [grid[inside]], 12, 1e-3)
    truth = solve(domain, boundary, TOLERANCE).at(grid[inside])
    most = float(np.abs(truth).max())
    rows, shown = [], None

    def panel(axis: Any, values: Floats, title: str, **look: Any) -> Any:
        field = np.full(RESOLUTION**2, np.nan)
        field[inside] = values
        image = axis.imshow(field.reshape(RESOLUTION, -1), origin="lower", extent=extent, **look)
        outlined(axis, domain.start)
        axis.set_title(title, fontsize=9)
        return image

    panel(axes[0], truth, f"{name}, {len(domain.start)} edges", cmap="RdBu_r", vmin=-most, vmax=most)
    for axis, (method, pair) in zip(axes[1:], methods().items(), strict=True):
        made = registry.make("sampler", pair[0]), registry.make("rule", pair[1])
        error = run(problem, *made, N, seed=SEED).value[:, 0] - truth
        mse = float(np.square(error).mean())
        norm = {"norm": _log_norm(), "cmap": "viridis"}
        shown = panel(axis, np.abs(error), f"{method}: {mse:.1e}", **norm)
        rows.append({"problem": name, "method": method, "n": N, "pixels": int(inside.sum()), "mse": mse})
    return rows, shown


def _log_norm() -> Any:
    from matplotlib.colors import LogNorm

    return LogNorm(*SCALE, clip=True)


def draw(named: dict[str, Boundary], path: Path) -> list[dict[str, Any]]:
    """A picture of some domains; returns what was measured."""
    across = 1 + len(methods())
    made = figure(2.0 * across, 2.2 * len(named) + 0.6)
    axes = made.subplots(len(named), across, squeeze=False)
    rows = []
    for line, (name, boundary) in zip(axes, named.items(), strict=True):
        found, image = row(line, name, boundary)
        rows += found
    bar = made.colorbar(image, ax=axes, location="bottom", shrink=0.5, aspect=50, pad=0.01)
    bar.set_label(f"absolute error, {N} walks a pixel; titles tell its mean square")
    save(made, path)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    vertices, values = polygons(SHOWN, SEED)
    family = {f"test {k + 1}": Domain.of(vertices[k]).boundary(values[k]) for k in range(SHOWN)}
    rows = draw(family, out / "walk-fields.png")
    foreign = {name: Domain.of(outline.vertices).boundary(outline.values) for name, outline in outlines().items()}
    rows += draw(foreign, out / "walk-fields-outside.png")
    for line in rows:
        print(line)
    if out == DOCS:
        print(write("walk_fields", rows, n=N, seed=SEED, resolution=RESOLUTION))


if __name__ == "__main__":
    main()
