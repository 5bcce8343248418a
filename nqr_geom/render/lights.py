"""Spherical lights: what they are, the irradiance they give in closed form, and the tree that chooses among many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

__all__ = ["LightTree", "SphereLight", "light_tree", "sphere_irradiance"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709


@dataclass(frozen=True, eq=False)
class SphereLight:
    """A sphere that shines the same radiance in all directions.

    Parameters
    ----------
    center : (3,) array_like
        Its centre.
    radius : float
        > 0.
    emission : (3,) array_like or float
        Radiance in red, green and blue, >= 0.

    Examples
    --------
    >>> SphereLight([0, 0, 2], 0.25, 10.0).emission
    array([10., 10., 10.])
    """

    center: Any
    radius: float
    emission: Any = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", check.array("center", self.center, (3,)))
        object.__setattr__(self, "radius", check.number("radius", self.radius, low=0.0, open_low=True))
        given = np.asarray(self.emission, dtype=object)
        emission = check.array("emission", [self.emission] * 3 if given.ndim == 0 else self.emission, (3,))
        if (emission < 0.0).any():
            raise ValueError(f"emission: expected numbers >= 0, got {emission.tolist()}")
        object.__setattr__(self, "emission", emission)


def sphere_irradiance(radius: ArrayLike, distance: ArrayLike, cosine: ArrayLike) -> Floats:
    """Irradiance on a small surface from a sphere of radiance 1 that only the surface's own horizon hides.

    Parameters
    ----------
    radius, distance : array_like
        Of the sphere, and from the surface to its centre, > 0.
    cosine : array_like
        Of the angle between the surface's normal and the direction to the centre, in [-1, 1].

    Returns
    -------
    float64 ndarray
        Of the arguments' broadcast shape, in [0, pi]; pi inside the sphere.

    References
    ----------
    Snyder, Area light sources for real-time graphics, 1996.

    Examples
    --------
    A sphere overhead, half below the horizon, and below it:

    >>> sphere_irradiance(1.0, 2.0, [1.0, 0.0, -0.6]).round(6)
    array([0.785398, 0.090586, 0.      ])
    """
    radius, distance, cosine = (np.asarray(a, dtype=np.float64) for a in (radius, distance, cosine))
    s2 = np.minimum((radius / distance) ** 2, 1.0)
    s = np.sqrt(s2)
    sine = np.sqrt(np.maximum(0.0, 1.0 - cosine**2))
    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.sqrt((1.0 - s2) / s2)
        y = np.clip(-x * cosine / sine, -1.0, 1.0)
        root = np.sqrt(1.0 - y**2)
        cut = s2 * (cosine * np.arccos(y) - x * sine * root) + np.arctan(sine * root / x)
    whole = np.pi * s2 * cosine
    above = np.where(cosine >= s, whole, np.where(cosine <= -s, 0.0, np.maximum(cut, 0.0)))
    return np.where(radius >= distance, np.pi, above)


class LightTree(NamedTuple):
    """A binary tree over spheres; the children of a node stand next to each other, a leaf has child -1.

    Attributes
    ----------
    centre, radius : (k, 3) and (k,)
        A sphere around all lights of each node.
    power : (k, 4)
        Radiance times squared radius in red, green, blue and luminance.
    child, parent, light : (k,) int64
        Left child, parent (-1 for the root) and light of a leaf (-1 for others).
    """

    centre: Floats
    radius: Floats
    power: Floats
    child: Ints
    parent: Ints
    light: Ints


def light_tree(centre: Floats, radius: Floats, emission: Floats) -> LightTree:
    """Split lights at the median of their longest axis until each is alone.

    Parameters
    ----------
    centre, radius, emission : (n, 3), (n,) and (n, 3)
        n >= 1 lights.

    Examples
    --------
    >>> tree = light_tree(np.eye(3), np.full(3, 0.1), np.ones((3, 3)))
    >>> tree.light.tolist(), tree.parent.tolist()
    ([-1, 1, -1, 2, 0], [-1, 0, 0, 2, 2])
    """
    groups: list[Ints] = [np.arange(len(centre))]
    child, parent = [-1], [-1]
    for node, group in enumerate(groups):  # grows as it goes
        if len(group) == 1:
            continue
        axis = int(np.ptp(centre[group], axis=0).argmax())
        ordered = group[np.argsort(centre[group, axis], kind="stable")]
        child[node] = len(groups)
        groups += [ordered[: len(group) // 2], ordered[len(group) // 2 :]]
        child += [-1, -1]
        parent += [node, node]
    power = emission * radius[:, None] ** 2
    power = np.column_stack([power, power @ LUMINANCE])
    middle = np.array([0.5 * (centre[g].min(axis=0) + centre[g].max(axis=0)) for g in groups])
    around = [(np.linalg.norm(centre[g] - m, axis=1) + radius[g]).max() for g, m in zip(groups, middle, strict=True)]
    return LightTree(
        middle,
        np.array(around),
        np.array([power[g].sum(axis=0) for g in groups]),
        np.array(child),
        np.array(parent),
        np.array([g[0] if len(g) == 1 else -1 for g in groups]),
    )
