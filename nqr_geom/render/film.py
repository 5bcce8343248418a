"""Radiance as a picture: exposure, highlights rolled off, sRGB."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check

__all__ = ["exposed", "save_picture"]

Floats = NDArray[np.float64]


def exposed(image: Floats, white: float | None = None) -> Floats:
    """Linear radiance as sRGB in [0, 1].

    Parameters
    ----------
    image : (h, w, 3) float64
        Radiance >= 0; estimates below 0 become black.
    white : float, optional
        Radiance that comes out nearly white; by default the 97th percentile of the largest channel. Brighter light
        rolls off to white instead of being cut.

    Examples
    --------
    >>> exposed(np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]]), white=1.0).round(2)[0, :, 0]
    array([0.  , 0.93])
    """
    image = np.maximum(check.array("image", image, ("h", "w", 3)), 0.0)
    if white is None:
        bright = image.max(axis=2)
        lit = bright[bright > 0.0]
        white = float(np.quantile(lit, 0.97)) if len(lit) else 1.0
    x = image / check.number("white", white, low=0.0, open_low=True)
    rolled = np.where(x < 0.6, x, 0.6 + 0.4 * (1.0 - np.exp(-(x - 0.6) / 0.4)))
    encoded: Floats = np.where(rolled <= 0.0031308, 12.92 * rolled, 1.055 * rolled ** (1.0 / 2.4) - 0.055)
    return encoded


def save_picture(path: str | Path, image: Floats, white: float | None = None) -> Path:
    """Write radiance (h, w, 3) as a .png, exposed, or as it is as a .npy.

    Raises
    ------
    ValueError
        If the ending is neither.
    """
    target = Path(path)
    ending = check.choice("out", target.suffix.lower(), (".png", ".npy"))
    target.parent.mkdir(parents=True, exist_ok=True)
    if ending == ".npy":
        np.save(target, image)
        return target
    check.require("matplotlib", "plot", "pictures")
    from matplotlib.image import imsave

    imsave(target, exposed(image, white))
    return target
