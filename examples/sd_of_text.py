"""Smoothed distance to a text: a soft minimum over the whole outline, with level lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import nqr_geom as ng
from nqr_geom.pictures import Window, draw_field


def main(out: Path = Path("out"), resolution: int = 400, alpha: float = 35.0) -> float:
    """Draw the field and return the most that it lies below the true distance, at most ln(L)/alpha."""
    text = ng.Curve.from_text("nqr")
    window = Window.around(text.bounds, resolution)
    smooth = ng.sd(text, window.points, alpha=alpha)
    draw_field(out / "sd_of_text.png", text, window, smooth, name="smoothed distance", contours=14)
    return float(np.max(ng.distance(text, window.points) - smooth))


if __name__ == "__main__":
    print(f"largest distance - sd: {main():.4f}, at most ln(L)/alpha")
