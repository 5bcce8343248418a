"""A harmonic function on a star by walk on spheres: its field, some walks from a point, and where they end."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import nqr_geom as ng
from nqr_geom.pictures import Window
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain

START = (0.1, 0.05)


def paths(domain: Domain, walks: int) -> list[np.ndarray]:
    """The corners of the first walks of `solve_laplace(..., seed=0)` at START, each ending on the boundary."""
    result = []
    for walk in range(walks):
        turn = 2 * np.pi * Stream(0, "test", "samples/0").uniform(np.array([0]), np.array([walk]), np.arange(60))
        corners = [np.array(START)]
        for angle in turn:
            reach = domain.closest(corners[-1][None])
            if reach.distance[0] < 1e-3:
                break
            corners.append(corners[-1] + reach.distance[0] * np.array([np.cos(angle), np.sin(angle)]))
        result.append(np.array([*corners, reach.point[0]]))
    return result


def main(out: Path = Path("out"), resolution: int = 300, walks: int = 12) -> float:
    """Draw the field with walks over it, and return the walk estimate at START less the deterministic answer."""
    import pyvista as pv

    vertices, values = (part[0] for part in ng.datasets.polygons(1, seed=3))
    domain = Domain.of(vertices)
    window = Window.around((*vertices.min(axis=0), *vertices.max(axis=0)), resolution, margin=0.05)
    field = ng.solve_laplace(vertices, values, window.points, method="boundary", outside="nan")
    step = window.x[1] - window.x[0]
    grid = pv.ImageData(dimensions=(len(window.x), len(window.y), 1), spacing=(step, step, step),
                        origin=(window.x[0], window.y[0], 0.0))  # fmt: skip
    grid["u"] = field
    plotter = pv.Plotter(off_screen=True, window_size=(900, 900))
    plotter.add_mesh(grid.contour(24), color="black", line_width=1, opacity=0.35)
    plotter.add_mesh(grid, cmap="coolwarm", nan_opacity=0.0, scalar_bar_args={"title": "u", "color": "black"})
    ring = np.column_stack([np.vstack([vertices, vertices[:1]]), np.full(len(vertices) + 1, step)])
    plotter.add_mesh(pv.lines_from_points(ring), color="black", line_width=4)
    for path in paths(domain, walks):
        corners = np.column_stack([path, np.full(len(path), 2 * step)])
        plotter.add_mesh(pv.lines_from_points(corners), color="#202020", line_width=2)
        plotter.add_mesh(pv.PolyData(corners[-1]), color="#ffd166", point_size=14, render_points_as_spheres=True)
    start = pv.PolyData(np.array([[*START, 3 * step]]))
    plotter.add_mesh(start, color="white", point_size=20, render_points_as_spheres=True)
    plotter.view_xy()
    plotter.camera.zoom(1.3)
    out.mkdir(parents=True, exist_ok=True)
    plotter.screenshot(out / "walks_from_a_point.png")
    plotter.close()
    by_walks, exact = (
        ng.solve_laplace(vertices, values, [START], method=method, n=4096)[0] for method in ("wos", "boundary")
    )
    return float(by_walks - exact)


if __name__ == "__main__":
    print(f"4096 walks less the deterministic answer: {main():+.5f}")
