"""Densities that light passes through: media in a box, from nothing at all to clouds.

A density is mu(x) = density * u(x). Shapes follow Eq. 9 of the paper, u = clamp(1 - u_geo + u_fBm, 0, 1): `u_geo` is 0
on a shape's core and 1 on its surface, `u_fBm` sums octaves of Warp's gradient noise. Nothing here loads Warp or torch
until a density is asked for; the kernels see a volume through `parts` and `values` alone.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

__all__ = ["PART", "Components", "Grid", "Homogeneous", "Noise", "Volume"]

Floats = NDArray[np.float64]

PART = 8  # numbers that describe one part of a shape to the kernels
_LARGEST_NOISE = math.sqrt(0.75)  # of one octave: unit gradients, weighted by a partition of unity (Jensen)


class Components(NamedTuple):
    """What a density is made of at some points, each (m,) float64.

    Attributes
    ----------
    density : ndarray
        mu, in units of one over length.
    geometry : ndarray
        u_geo of Eq. 9, >= 0; on grids and in homogeneous media 1 - mu / majorant.
    noise : ndarray
        u_fBm of Eq. 9; 0 where no value of it could change the density.
    """

    density: Floats
    geometry: Floats
    noise: Floats


@dataclass(frozen=True)
class Noise:
    """Fractal Brownian motion: octave k is ``amplitude * gain**k`` times noise of ``frequency * lacunarity**k``.

    Parameters
    ----------
    amplitude : float
        Of the first octave, >= 0. Gradient noise of amplitude 1 reaches 0.87 and has a standard deviation of 0.25.
    frequency : float
        Cells per unit of length, > 0.
    octaves : int
        1 to 16.
    gain, lacunarity : float
        From octave to octave, 0 < gain <= 1 and lacunarity >= 1.
    seed : int
        Which noise, 0 <= seed < 2^31. It is laid out from the low corner of a volume's box.

    Examples
    --------
    >>> Noise(amplitude=0.5, octaves=1).bound <= 0.5
    True
    """

    amplitude: float = 1.0
    frequency: float = 1.0
    octaves: int = 5
    gain: float = 0.5
    lacunarity: float = 2.0
    seed: int = 0

    def __post_init__(self) -> None:
        check.number("amplitude", self.amplitude, low=0.0)
        check.number("frequency", self.frequency, low=0.0, open_low=True)
        check.integer("octaves", self.octaves, low=1, high=16)
        check.number("gain", self.gain, low=0.0, high=1.0, open_low=True)
        check.number("lacunarity", self.lacunarity, low=1.0, high=1e3)
        check.integer("seed", self.seed, low=0, high=2**31 - 1)

    @property
    def bound(self) -> float:
        """No value is larger than this."""
        return _LARGEST_NOISE * self.amplitude * sum(self.gain**k for k in range(self.octaves))


def _box(low: ArrayLike, high: ArrayLike) -> tuple[Floats, Floats]:
    """Corners of a box of positive size, (3,) each."""
    bottom, top = check.array("low", low, (3,)), check.array("high", high, (3,))
    if not (bottom < top).all():
        raise ValueError(f"high: expected more than low {bottom.tolist()} on every axis, got {top.tolist()}")
    if not np.isfinite(top - bottom).all() or (top - bottom).max() > 1e100 or (top - bottom).min() < 1e-100:
        raise ValueError(f"high: expected a box between 1e-100 and 1e100 in size, got {(top - bottom).tolist()}")
    return bottom, top


class Volume(ABC):
    """A density in an axis-aligned box; outside of it there is nothing.

    Attributes
    ----------
    low, high : (3,) float64
        Corners of the box.
    density : float
        mu where u = 1, in units of one over length, >= 0.
    """

    kind: ClassVar[str] = "volume"
    low: Any
    high: Any
    density: float
    noise: Noise | None = None

    def _check_box(self) -> None:
        low, high = _box(self.low, self.high)
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        object.__setattr__(self, "density", check.number("density", self.density, low=0.0))
        if self.noise is not None and not isinstance(self.noise, Noise):
            raise TypeError(f"noise: expected a Noise or None, got {self.noise!r}")

    @property
    def majorant(self) -> float:
        """No density is larger than this."""
        return self.density

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Corners (3,) and (3,) of the box outside of which the density is zero."""
        return self.low, self.high

    def effects(self) -> frozenset[str]:
        """Names of what this volume calls for: its kind, and "noise" if there is some; empty if there is no density.

        Examples
        --------
        >>> sorted(Homogeneous([0, 0, 0], [1, 1, 1], density=0.0).effects())
        []
        >>> sorted(Homogeneous([0, 0, 0], [1, 1, 1]).effects())
        ['homogeneous']
        """
        if self.majorant == 0.0:
            return frozenset()
        rough = self.noise is not None and self.noise.amplitude > 0.0
        return frozenset({self.kind, "noise"} if rough else {self.kind})

    def components(self, points: ArrayLike) -> Components:
        """Density, u_geo and u_fBm at points (m, 3); all zero density outside the box.

        Examples
        --------
        >>> fog = Homogeneous([0, 0, 0], [1, 1, 1], density=2.0)
        >>> fog.components([[0.5, 0, 0], [3, 0, 0]]).density
        array([2., 0.])
        """
        from nqr_geom.render.medium import Medium

        return Components(*Medium.of([self]).components(check.array("points", points, ("m", 3)) - self.low))

    @abstractmethod
    def parts(self) -> Floats:
        """What describes the shape to the kernels, (k, 8), relative to `low`."""

    def values(self) -> Floats:
        """Samples on a grid, (nx, ny, nz); shapes without one have a single zero."""
        return np.zeros((1, 1, 1))

    def chords(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Where lines can meet density: distances (m, k) at which each part's reach begins and ends.

        Origins (m, 3) are relative to `low`, directions have unit length. An empty chord has its end before its
        beginning. By default the whole line, which the box then cuts.
        """
        reach = np.full((len(origins), 1), np.inf)
        return -reach, reach


@dataclass(frozen=True, eq=False)
class Homogeneous(Volume):
    """The same density everywhere in a box.

    Parameters
    ----------
    low, high : (3,) array_like
        Corners of the box.
    density : float
        >= 0, in units of one over length.

    Raises
    ------
    ValueError, TypeError
        If the box is empty or the density negative.

    Examples
    --------
    >>> fog = Homogeneous([0, 0, 0], [1, 1, 1], density=0.5)
    >>> fog.majorant, sorted(fog.effects())
    (0.5, ['homogeneous'])
    """

    low: Any
    high: Any
    density: float = 1.0

    kind: ClassVar[str] = "homogeneous"

    def __post_init__(self) -> None:
        self._check_box()

    def parts(self) -> Floats:
        return np.zeros((1, PART))


@dataclass(frozen=True, eq=False)
class Grid(Volume):
    """Densities on a regular grid, trilinear in between.

    Parameters
    ----------
    data : (nx, ny, nz) array_like
        Densities >= 0 at the grid's nodes, at least two along each axis; the first and last lie on the box.
    low, high : (3,) array_like
        Corners of the box.

    Raises
    ------
    ValueError, TypeError
        If a density is negative, an axis has one node, or the box is empty.

    Examples
    --------
    >>> ramp = Grid(np.arange(2.0)[:, None, None].repeat(2, 1).repeat(2, 2), [0, 0, 0], [1, 1, 1])
    >>> ramp.components([[0.25, 0.5, 0.5]]).density
    array([0.25])
    """

    data: Any
    low: Any
    high: Any
    density: float = field(default=0.0, init=False)

    kind: ClassVar[str] = "grid"

    def __post_init__(self) -> None:
        data = check.array("data", self.data, ("nx", "ny", "nz"))
        if min(data.shape) < 2:
            raise ValueError(f"data: expected at least two nodes along each axis, got shape {data.shape}")
        if data.min() < 0.0:
            raise ValueError(f"data: expected densities >= 0, got {data.min()}")
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "density", float(data.max()))
        self._check_box()

    def effects(self) -> frozenset[str]:
        """As for every volume; a grid of equal densities is homogeneous."""
        if self.majorant > 0.0 and self.data.min() == self.majorant:
            return frozenset({Homogeneous.kind})
        return super().effects()

    def parts(self) -> Floats:
        return np.zeros((1, PART))

    def values(self) -> Floats:
        # Relative to the majorant, as u of the shapes is.
        return self.data / self.density if self.density else self.data
