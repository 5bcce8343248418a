"""Random star-shaped polygons with 19 vertices and linear boundary values (Fig. 41), calibrated to Table 14.

The paper leaves the constants open. With these, and queries uniform inside, the errors of random and of Latin hypercube
walks come out (2.7e-4, and 1.5 times better). The trapezoid over walks sorted by their first angle is 1.4 times as good
as random walks here and 1.1 times in the paper, which does not say how it is built (`benchmarks/wos_baselines.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain

__all__ = ["VERTICES", "PolygonFamily", "Polygons", "polygons", "queries"]

Floats = NDArray[np.float64]

VERTICES = 19
_BATCH = 8  # candidates for a query point are drawn this many at a time
_LEAST = 1e-3  # queries nearer to the edge than this are left out: they answer themselves


@dataclass(frozen=True)
class PolygonFamily:
    """The open constants of the family.

    Parameters
    ----------
    inner, outer : float
        Range of the radii, uniform.
    smooth : int
        Harmonics of the boundary values around the vertices; 0 makes the values independent.
    size : float
        Root mean square of the values.
    """

    inner: float = 0.35
    outer: float = 0.95
    smooth: int = 0
    size: float = 0.15


class Polygons(NamedTuple):
    """Random domains with their boundary values.

    Attributes
    ----------
    vertices : (n, 19, 2) float64
        Counter-clockwise, in [-1, 1].
    values : (n, 19) float64
        Boundary values at the vertices, linear between them.
    """

    vertices: Floats
    values: Floats


def polygons(n: int, seed: int = 0, split: str = "test", family: PolygonFamily | None = None) -> Polygons:
    """The first n polygons of a seed and split; the same index is the same polygon.

    Parameters
    ----------
    n : int
        How many, >= 1.
    seed : int
        Which family.
    split : {"test", "train", "validation"}
        Polygons of different splits have nothing in common.
    family : PolygonFamily, optional
        Constants; by default the calibrated ones.

    Returns
    -------
    Polygons

    References
    ----------
    Fig. 41 and Appendix A.5 of the paper.

    Examples
    --------
    >>> vertices, values = polygons(3)
    >>> vertices.shape, values.shape
    ((3, 19, 2), (3, 19))
    """
    family = family or PolygonFamily()
    rows = np.arange(check.integer("n", n, low=1))[:, None]
    stream = Stream(check.integer("seed", seed), split, "polygons")
    vertex = np.arange(VERTICES)
    angle = 2.0 * np.pi * vertex / VERTICES
    u = stream.child("radius").uniform(rows, vertex)
    radius = family.inner + (family.outer - family.inner) * u
    vertices = radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    raw = np.sqrt(12.0) * (stream.child("value").uniform(rows, vertex) - 0.5)
    if family.smooth:
        waves = np.arange(1, family.smooth + 1)
        basis = np.concatenate([np.cos(waves[:, None] * angle), np.sin(waves[:, None] * angle)])
        raw = raw[:, : len(basis)] @ basis / np.sqrt(family.smooth)
    return Polygons(vertices, family.size * raw)


def queries(domain: Domain, count: int, shape: int, seed: int = 0, split: str = "test") -> Floats:
    """Uniform points inside a domain, a function of (seed, split, number of the shape), (count, 2).

    Parameters
    ----------
    domain : Domain
        Where.
    count : int
        How many.
    shape : int
        Number of the shape in its family.
    seed, split
        As for `polygons`.
    """
    stream = Stream(seed, split, "queries")
    low, high = domain.start.min(axis=0), domain.start.max(axis=0)
    found: list[Floats] = []
    have, at = 0, 0
    while have < count:
        index = np.arange(at, at + _BATCH * count)
        u = stream.uniform(np.array([[shape]]), index[:, None], np.arange(2))
        framed = low + u * (high - low)
        kept = framed[domain.contains(framed) & (domain.search(framed)[2] * domain.unit >= _LEAST)]
        found.append(kept)
        have, at = have + len(kept), at + len(index)
    return domain.from_frame(np.concatenate(found)[:count])
