"""What p does: the same values on the edge of a square, spread inside for p = 1.5, 2, 3 and 6."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import nqr_geom as ng
from nqr_geom.pictures import Window, draw_row

EXPONENTS = (1.5, 2.0, 3.0, 6.0)


def main(out: Path = Path("out"), resolution: int = 300) -> dict[float, float]:
    """Draw the four solutions and return their values at the centre; for p = 2 it is 1/4, by symmetry."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    square = np.repeat(corners, 2, axis=0)  # corners given twice: the values may jump there
    values = [0, 0, 0, 0, 0, 1, 1, 0]  # one on the top edge
    window = Window.around((0.0, 0.0, 1.0, 1.0), resolution, margin=0.02)
    places = np.concatenate([window.points, [[0.5, 0.5]]])
    fields, centre = {}, {}
    for p in EXPONENTS:
        found = ng.solve_p_laplace(square, values, places, p, outside="nan")
        fields[f"p = {p:g}"] = found[:-1]
        centre[p] = float(found[-1])
    draw_row(out / "p_laplace_values.png", ng.Curve.polyline(corners, closed=True), window, fields, contours=9)
    return centre


if __name__ == "__main__":
    for p, value in main().items():
        print(f"p = {p:g}: {value:.6f} at the centre")
