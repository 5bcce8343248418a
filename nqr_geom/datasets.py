"""The random families that methods are measured and trained on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from nqr_geom import check
from nqr_geom.curves.families import curves
from nqr_geom.problems import toy
from nqr_geom.render.scene_families import scenes
from nqr_geom.render.volume_families import donut, volumes
from nqr_geom.wos.families import polygons
from nqr_geom.wos.outlines import outlines

if TYPE_CHECKING:
    from nqr_geom.render.clouds import Extrusion

__all__ = ["curves", "donut", "letters", "outlines", "polygons", "scenes", "toy", "volumes"]


def letters(text: str = "NQR", seed: int = 0, resolution: int = 193) -> Extrusion:
    """A word as a cloud in [0, 10]^3, seen along z; outside the training family (Fig. 28).

    Parameters
    ----------
    text : str
        What it says.
    seed : int
        Of the noise, 0 <= seed < 2^31.
    resolution : int
        Nodes per side at which the distance to the outlines is kept.

    Returns
    -------
    Extrusion
        Plates 1.5 thick in a coat 0.8 deep, with the noise of the training family.

    Examples
    --------
    >>> sorted(letters("I").effects())
    ['extrusion', 'noise']
    """
    from nqr_geom.curves.curve import Curve
    from nqr_geom.curves.distance import signed_distance
    from nqr_geom.render.clouds import Extrusion
    from nqr_geom.render.volume_families import CloudFamily

    outline = Curve.from_text(text)
    low, high = np.reshape(outline.bounds, (2, 2))
    scale = 8.4 / (high - low).max()
    line = np.linspace(0.0, 10.0, check.integer("resolution", resolution, low=2))
    points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    distance = scale * signed_distance(outline, (points - 5.0) / scale + 0.5 * (low + high))
    noise = replace(CloudFamily().noise, seed=seed)
    return Extrusion(distance.reshape(len(line), -1), 1.5, 0.8, [0.0] * 3, [10.0] * 3, noise=noise)
