"""A nonlinear equation from walks on spheres (Fig. 50): p = 3 by a network, and what the answer for p = 2 is worth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import nqr_geom as ng
from nqr_geom.pictures import Window, draw_row


def main(out: Path = Path("out"), resolution: int = 160, shape: int = 10) -> tuple[float, float]:
    """Draw the errors of both against finite elements, and return their mean squares: p = 2 exactly, p = 3 by walks."""
    vertices, values = (part[shape] for part in ng.datasets.polygons(shape + 1))
    window = Window.around((*vertices.min(axis=0), *vertices.max(axis=0)), resolution, margin=0.03)
    truth = ng.solve_p_laplace(vertices, values, window.points, 3.0, outside="nan")
    two = ng.solve_laplace(vertices, values, window.points, method="boundary", outside="nan")
    network = ng.solve_p_laplace(vertices, values, window.points, 3.0, method="inet", outside="nan")
    errors = {"exact for p = 2": np.abs(two - truth), "p = 3 from 32 walks": np.abs(network - truth)}
    draw_row(out / "p_three_from_walks.png", ng.Curve.polyline(vertices, closed=True), window, errors)
    by_two, by_walks = (float(np.nanmean(error**2)) for error in errors.values())
    return by_two, by_walks


if __name__ == "__main__":
    by_two, by_walks = main()
    print(f"mean squared error: exact solution for p = 2 {by_two:.2e}, network for p = 3 on 32 walks {by_walks:.2e}")
