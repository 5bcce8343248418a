"""Domains unlike the family that networks are trained on, with boundary values that oscillate (after Fig. 33).

The paper shows three, with 107, 96 and 286 edges, and does not give them. These have as many: a letter S drawn as a
band, a comb whose teeth are channels, and a coastline with detail at all scales.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nqr_geom.streams import Stream

__all__ = ["Outline", "Waves", "outlines"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Waves:
    """Boundary values that oscillate in both directions: size (sin(k x) + cos(k y)), k = 2 pi over the wavelength.

    Parameters
    ----------
    wavelength : float
        Of either wave, in units of length.
    size : float
        Root mean square of the values.
    """

    wavelength: float = 0.4
    size: float = 0.15

    def __call__(self, points: Floats) -> Floats:
        """Values at points (m, 2)."""
        k = 2.0 * np.pi / self.wavelength
        return np.asarray(self.size * (np.sin(k * points[:, 0]) + np.cos(k * points[:, 1])))


class Outline(NamedTuple):
    """A domain and the values on its edge.

    Attributes
    ----------
    vertices : (n, 2) float64
        Counter-clockwise, in [-1, 1].
    values : callable
        (m, 2) -> (m,).
    """

    vertices: Floats
    values: Waves


def outlines() -> dict[str, Outline]:
    """Three domains with 107, 96 and 286 edges.

    Examples
    --------
    >>> {name: len(outline.vertices) for name, outline in outlines().items()}
    {'letter': 107, 'comb': 96, 'coast': 286}
    """
    return {name: Outline(make(), Waves()) for name, make in (("letter", _letter), ("comb", _comb), ("coast", _coast))}


def _letter() -> Floats:
    """A band along two arcs that turn opposite ways."""
    radius, half = 0.45, 0.16
    upper = np.linspace(0.1 * np.pi, 1.5 * np.pi, 28)[:, None]
    lower = np.linspace(0.5 * np.pi, -0.9 * np.pi, 27)[1:, None]

    def side(out: float) -> Floats:
        over = np.hstack([np.cos(upper), np.sin(upper)]) * (radius + out) + [0.0, radius]
        under = np.hstack([np.cos(lower), np.sin(lower)]) * (radius - out) - [0.0, radius]
        return np.concatenate([over, under])

    band = np.concatenate([side(half), side(-half)[::-1]])
    return 0.98 * np.delete(band, 40, axis=0)


def _comb() -> Floats:
    """A back with 23 teeth, each a channel 0.04 wide and 0.9 long."""
    left = np.linspace(-0.95, 0.91, 23)
    tooth = np.array([[0.0, 0.0], [0.0, 0.9], [0.04, 0.9], [0.04, 0.0]])
    teeth = (np.column_stack([left, np.full(23, 0.1)])[:, None] + tooth).reshape(-1, 2)[::-1]
    return np.concatenate([teeth, [[-0.99, 0.1], [-0.99, -0.4], [0.99, -0.4], [0.99, 0.1]]])


def _coast() -> Floats:
    """A rim whose waves have random phases and sizes that fall with their number."""
    angle = 2.0 * np.pi * np.arange(286) / 286
    waves = np.arange(2, 60)
    phase = 2.0 * np.pi * Stream(0, "test", "coast").uniform(waves)
    rim = 0.66 + (0.16 / waves**0.8 * np.cos(angle[:, None] * waves + phase)).sum(axis=1)
    return rim[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
