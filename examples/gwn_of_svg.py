"""The winding number of a drawing: which points lie inside, how many times, and how sure an open stroke can be."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

import nqr_geom as ng
from nqr_geom.pictures import Window, draw_field


def main(out: Path = Path("out"), resolution: int = 400) -> float:
    """Draw the field and return the area that it calls inside, in the drawing's units."""
    with as_file(files("nqr_geom") / "data" / "fish.svg") as path:
        fish = ng.Curve.from_svg(path, flip_y=True)
    window = Window.around(fish.bounds, resolution)
    field = ng.gwn(fish, window.points)
    draw_field(out / "gwn_of_svg.png", fish, window, field, name="winding number", signed=True)
    cell = (window.x[1] - window.x[0]) ** 2
    return float(np.count_nonzero(field > 0.5) * cell)


if __name__ == "__main__":
    print(f"area inside: {main():.4g}")
