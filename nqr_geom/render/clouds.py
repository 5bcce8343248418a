"""Shapes filled with density and noise: balls, a ring, extruded outlines (Eq. 9, Figs. 28 and 40)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.render.volume import PART, Noise, Volume

__all__ = ["Extrusion", "Spheres", "Torus", "reach_of", "through_balls"]

Floats = NDArray[np.float64]


def _count(name: str, array: Floats) -> None:
    if not len(array):
        raise ValueError(f"{name}: expected at least one, got none")


def _default_box(shape: Volume, low: Floats, high: Floats) -> None:
    """Take the given corners, or those just outside of the shape's reach."""
    object.__setattr__(shape, "low", low if shape.low is None else shape.low)
    object.__setattr__(shape, "high", high if shape.high is None else shape.high)


def reach_of(noise: Any) -> float:
    """How far density can reach, in radii: u_geo is a squared distance and u_fBm has a bound."""
    return math.sqrt(1.0 + (noise.bound if isinstance(noise, Noise) else 0.0))


def _across(height: Floats, slope: Floats, reach: float) -> tuple[Floats, Floats]:
    """Distances (m,) at which lines enter and leave a slab |height| < reach."""
    flat, inside = slope == 0.0, np.abs(height) < reach
    safe = np.where(flat, 1.0, slope)
    ends = np.sort(np.stack([(-reach - height) / safe, (reach - height) / safe]), axis=0)
    near = np.where(flat, np.where(inside, -np.inf, np.inf), ends[0])
    return near, np.where(flat, np.where(inside, np.inf, -np.inf), ends[1])


def through_balls(offset: Floats, directions: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Distances (m, k) at which lines enter and leave balls at `offset` (m, k, 3) of their origins."""
    middle = np.einsum("mkd,md->mk", offset, directions)
    # The distance between line and centre from the perpendicular itself: |offset|^2 - middle^2 would cancel.
    aside = offset - middle[..., None] * directions[:, None]
    square = reach**2 - (aside**2).sum(axis=-1)
    half = np.sqrt(np.maximum(square, 0.0))
    return np.where(square > 0.0, middle - half, np.inf), np.where(square > 0.0, middle + half, -np.inf)


@dataclass(frozen=True, eq=False)
class Spheres(Volume):
    """Balls that are densest in the middle, `u_geo = min |x - c|^2 / r^2`, with noise on top.

    Parameters
    ----------
    centers : (k, 3) array_like
        Centres, k >= 1.
    radii : (k,) array_like
        > 0.
    low, high : (3,) array_like, optional
        Corners of the box; by default just around what the balls and their noise can reach.
    density : float
        mu where u = 1.
    noise : Noise, optional
        u_fBm of Eq. 9.

    Raises
    ------
    ValueError, TypeError
        If a radius is not positive, or counts differ.

    References
    ----------
    Eq. 9, Fig. 40 and Appendix A.4 of the paper.

    Examples
    --------
    >>> cloud = Spheres([[5, 5, 5]], [2.0], [0, 0, 0], [10, 10, 10], noise=Noise(amplitude=0.5))
    >>> cloud.majorant
    1.0
    """

    centers: Any
    radii: Any
    low: Any = None
    high: Any = None
    density: float = 1.0
    noise: Noise | None = None

    kind: ClassVar[str] = "spheres"

    def __post_init__(self) -> None:
        centers = check.array("centers", self.centers, ("k", 3))
        _count("centers", centers)
        radii = check.array("radii", self.radii, (len(centers),))
        if radii.min() <= 0.0:
            raise ValueError(f"radii: expected numbers > 0, got {radii.min()}")
        object.__setattr__(self, "centers", centers)
        object.__setattr__(self, "radii", radii)
        reach = (radii * reach_of(self.noise))[:, None]
        _default_box(self, (centers - reach).min(axis=0), (centers + reach).max(axis=0))
        self._check_box()

    def parts(self) -> Floats:
        rest = np.zeros((len(self.radii), PART - 4))
        return np.concatenate([self.centers - self.low, self.radii[:, None], rest], axis=1)

    def chords(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        return through_balls(
            (self.centers - self.low) - origins[:, None], directions, self.radii * reach_of(self.noise)
        )


@dataclass(frozen=True, eq=False)
class Torus(Volume):
    """A ring, u_geo = (distance to the ring's circle / radius of the tube)^2; the donut outside the training family.

    Parameters
    ----------
    center : (3,) array_like
        Centre of the ring.
    axis : (3,) array_like
        Direction that the ring turns around, any length but zero.
    major, minor : float
        Radii of the circle and of the tube, major >= minor > 0.
    low, high, density, noise
        As for `Spheres`.

    References
    ----------
    Fig. 28 of the paper.

    Examples
    --------
    >>> ring = Torus([0, 0, 0], [0, 0, 1], major=3.0, minor=1.0)
    >>> ring.components([[3, 0, 0], [3, 0, 0.5], [0, 0, 0]]).density
    array([1.  , 0.75, 0.  ])
    """

    center: Any
    axis: Any
    major: float
    minor: float
    low: Any = None
    high: Any = None
    density: float = 1.0
    noise: Noise | None = None

    kind: ClassVar[str] = "torus"

    def __post_init__(self) -> None:
        center, axis = check.array("center", self.center, (3,)), check.array("axis", self.axis, (3,))
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise ValueError("axis: expected a direction, got zero")
        check.number("minor", self.minor, low=0.0, open_low=True)
        check.number("major", self.major, low=float(self.minor))
        object.__setattr__(self, "center", center)
        object.__setattr__(self, "axis", axis / length)
        tube = self.minor * reach_of(self.noise)
        reach = tube + self.major * np.sqrt(np.maximum(1.0 - self.axis**2, 0.0))
        _default_box(self, center - reach, center + reach)
        self._check_box()

    def parts(self) -> Floats:
        return np.concatenate([self.center - self.low, self.axis, [self.major, self.minor]])[None]

    def chords(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """The ball and the slab around the ring that its tube and noise can reach."""
        tube = self.minor * reach_of(self.noise)
        offset = (self.center - self.low) - origins
        near, far = through_balls(offset[:, None], directions, np.array([self.major + tube]))
        low, high = _across(-offset @ self.axis, directions @ self.axis, tube)
        return np.maximum(near, low[:, None]), np.minimum(far, high[:, None])


@dataclass(frozen=True, eq=False)
class Extrusion(Volume):
    """A plate of any outline in a coat of cloud, u_geo = (distance to the plate / radius)^2; letters are made of these.

    Parameters
    ----------
    distance : (nx, ny) array_like
        Signed distance to the outline, negative inside, at the nodes of a grid over the box's x and y, bilinear in
        between.
    thickness : float
        Of the plate along z, >= 0, in the middle of the box.
    radius : float
        Distance from the plate, > 0, at which u_geo is 1.
    low, high : (3,) array_like
        Corners of the box.
    density, noise
        As for `Spheres`.

    References
    ----------
    Fig. 28 of the paper.

    Examples
    --------
    >>> x, y = np.meshgrid(np.linspace(-1, 1, 65), np.linspace(-1, 1, 65), indexing="ij")
    >>> coin = Extrusion(np.hypot(x, y) - 0.5, 0.25, 0.5, [-1, -1, -1], [1, 1, 1])
    >>> coin.components([[0, 0, 0], [0.75, 0, 0], [0, 0, 0.625]]).density.round(6)
    array([1.  , 0.75, 0.  ])
    """

    distance: Any
    thickness: float
    radius: float
    low: Any
    high: Any
    density: float = 1.0
    noise: Noise | None = None

    kind: ClassVar[str] = "extrusion"

    def __post_init__(self) -> None:
        distance = check.array("distance", self.distance, ("nx", "ny"))
        if min(distance.shape) < 2:
            raise ValueError(f"distance: expected at least two nodes along each axis, got shape {distance.shape}")
        object.__setattr__(self, "distance", distance)
        check.number("thickness", self.thickness, low=0.0)
        check.number("radius", self.radius, low=0.0, open_low=True)
        self._check_box()

    def parts(self) -> Floats:
        part = np.zeros((1, PART))
        part[0, :3] = 0.5 * (self.high[2] - self.low[2]), 0.5 * self.thickness, self.radius
        return part

    def values(self) -> Floats:
        return self.distance[:, :, None]

    def chords(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """The slab around the plate that its coat and noise can reach."""
        height = origins[:, 2] - 0.5 * (self.high[2] - self.low[2])
        near, far = _across(height, directions[:, 2], 0.5 * self.thickness + self.radius * reach_of(self.noise))
        return near[:, None], far[:, None]
