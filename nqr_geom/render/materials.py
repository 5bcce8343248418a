"""How surfaces look: diffuse, rough metals with measured optical constants, rough plastic, textures."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check

__all__ = ["METALS", "Checker", "Conductor", "Diffuse", "Image", "Material", "Plastic", "Texture", "coat_table"]

Floats = NDArray[np.float64]

ROUGHEST, SMOOTHEST = 1.0, 1e-4
COAT_NODES = 128

# Refractive index and extinction at 650, 550 and 450 nm, on straight lines between what is tabulated (in the database
# refractiveindex.info): Johnson and Christy, Optical constants of the noble metals, 1972 (silver, gold, copper), and
# Optical constants of transition metals, 1974 (chromium); for aluminium the Brendel-Bormann model of Rakic, Djurisic,
# Elazar, Majewski, Optical properties of metallic films for vertical-cavity optoelectronic devices, 1998.
METALS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "aluminium": ((1.3455, 0.96521, 0.61722), (7.4746, 6.3995, 5.3031)),
    "chromium": ((3.1071, 3.1812, 2.3230), (3.3314, 3.3291, 3.1350)),
    "copper": ((0.23780, 1.0066, 1.2404), (3.6264, 2.5823, 2.3929)),
    "gold": ((0.15557, 0.42415, 1.3831), (3.6024, 2.4721, 1.9155)),
    "silver": ((0.052225, 0.059582, 0.040000), (4.4094, 3.5974, 2.6484)),
}


def _colour(name: str, value: Any, high: float = 1.0) -> Floats:
    """Three numbers in [0, high]; one number is grey."""
    given = np.asarray(value, dtype=object)
    colour = check.array(name, [value] * 3 if given.ndim == 0 else value, (3,))
    if (colour < 0.0).any() or (colour > high).any():
        raise ValueError(f"{name}: expected numbers in [0, {high:g}], got {colour.tolist()}")
    return colour


@dataclass(frozen=True, eq=False)
class Checker:
    """A chequered texture.

    Parameters
    ----------
    even, odd : (3,) array_like or float
        Reflectances in [0, 1].
    squares : float
        Squares along each unit of u and v, > 0.

    Examples
    --------
    >>> Checker(0.9, 0.1, squares=2).at(np.array([[0.1, 0.1], [0.6, 0.1]]))[:, 0]
    array([0.9, 0.1])
    """

    even: Any
    odd: Any
    squares: float = 8.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "even", _colour("even", self.even))
        object.__setattr__(self, "odd", _colour("odd", self.odd))
        object.__setattr__(self, "squares", check.number("squares", self.squares, low=0.0, open_low=True))

    def at(self, uv: Floats) -> Floats:
        """Reflectance at texture coordinates (m, 2), (m, 3)."""
        cell = np.floor(uv * self.squares).sum(axis=1) % 2.0
        chosen: Floats = np.where(cell[:, None] == 0.0, self.even, self.odd)
        return chosen


@dataclass(frozen=True, eq=False)
class Image:
    """A picture as texture: bilinear, repeated outside [0, 1], v running upwards.

    Parameters
    ----------
    pixels : (h, w, 3) array_like
        Linear reflectances in [0, 1].

    Examples
    --------
    >>> Image(np.full((2, 2, 3), 0.25)).at(np.array([[0.3, 7.0]]))
    array([[0.25, 0.25, 0.25]])
    """

    pixels: Any

    def __post_init__(self) -> None:
        pixels = check.array("pixels", self.pixels, ("h", "w", 3))
        if not pixels.size or pixels.min() < 0.0 or pixels.max() > 1.0:
            raise ValueError(f"pixels: expected reflectances in [0, 1], got shape {pixels.shape} with others")
        object.__setattr__(self, "pixels", pixels)

    def at(self, uv: Floats) -> Floats:
        """Reflectance at texture coordinates (m, 2), (m, 3)."""
        pixels = self.pixels
        high, wide = pixels.shape[:2]
        x, y = uv[:, 0] * wide - 0.5, (1.0 - uv[:, 1]) * high - 0.5
        i, j = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
        s, t = (y - i)[:, None], (x - j)[:, None]
        low = (1.0 - t) * pixels[i % high, j % wide] + t * pixels[i % high, (j + 1) % wide]
        up = (1.0 - t) * pixels[(i + 1) % high, j % wide] + t * pixels[(i + 1) % high, (j + 1) % wide]
        blended: Floats = (1.0 - s) * low + s * up
        return blended


Texture = Checker | Image


def _albedo(value: Any) -> Floats | Texture:
    return value if isinstance(value, (Checker, Image)) else _colour("albedo", value)


def _roughness(value: Any) -> float:
    return check.number("roughness", value, low=SMOOTHEST, high=ROUGHEST)


@dataclass(frozen=True, eq=False)
class Diffuse:
    """Lambert's law.

    Parameters
    ----------
    albedo : (3,) array_like, float, Checker or Image
        Reflectance in [0, 1].

    Examples
    --------
    >>> Diffuse(0.5).albedo
    array([0.5, 0.5, 0.5])
    """

    albedo: Any = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "albedo", _albedo(self.albedo))


@dataclass(frozen=True, eq=False)
class Conductor:
    """A rough metal: GGX microfacets with Smith's masking and the Fresnel terms of a complex refractive index.

    Parameters
    ----------
    metal : str
        One of `METALS`; not read where `eta` and `k` are given.
    roughness : float
        Width alpha of the GGX distribution in [1e-4, 1].
    eta, k : (3,) array_like, optional
        Refractive index, > 0, and extinction, >= 0, in red, green and blue.

    References
    ----------
    Walter, Marschner, Li, Torrance, Microfacet models for refraction through rough surfaces, 2007. Constants of metals
    at 650, 550 and 450 nm: Johnson and Christy, 1972 (silver, gold, copper) and 1974 (chromium); Rakic, Djurisic,
    Elazar, Majewski, 1998, by the model of Brendel and Bormann (aluminium).

    Examples
    --------
    >>> Conductor("gold", roughness=0.1).k
    array([3.6024, 2.4721, 1.9155])
    """

    metal: str = "aluminium"
    roughness: float = 0.1
    eta: Any = None
    k: Any = None

    def __post_init__(self) -> None:
        if (self.eta is None) != (self.k is None):
            raise ValueError("eta: expected eta and k together, or neither")
        eta, k = METALS[check.choice("metal", self.metal, METALS)] if self.eta is None else (self.eta, self.k)
        eta, k = check.array("eta", eta, (3,)), check.array("k", k, (3,))
        if (eta <= 0.0).any() or (k < 0.0).any():
            raise ValueError(f"eta: expected eta > 0 and k >= 0, got {eta.tolist()} and {k.tolist()}")
        object.__setattr__(self, "eta", eta)
        object.__setattr__(self, "k", k)
        object.__setattr__(self, "roughness", _roughness(self.roughness))


@dataclass(frozen=True, eq=False)
class Plastic:
    """A diffuse base under a rough, clear coat.

    Parameters
    ----------
    albedo : (3,) array_like, float, Checker or Image
        Reflectance of the base in [0, 1].
    roughness : float
        GGX width of the coat in [1e-4, 1].
    ior : float
        Refractive index of the coat in (1, 3].

    References
    ----------
    Kelemen and Szirmay-Kalos, A microfacet based coupled specular-matte BRDF model with importance sampling, 2001: the
    base gets the energy that the coat does not reflect, so that a white base reflects all of it.
    """

    albedo: Any = 0.5
    roughness: float = 0.1
    ior: float = 1.5
    coat: tuple[Floats, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "albedo", _albedo(self.albedo))
        object.__setattr__(self, "roughness", _roughness(self.roughness))
        object.__setattr__(self, "ior", check.number("ior", self.ior, low=1.0, high=3.0, open_low=True))
        object.__setattr__(self, "coat", coat_table(self.roughness, self.ior))


Material = Diffuse | Conductor | Plastic


@lru_cache(maxsize=1024)
def coat_table(roughness: float, ior: float) -> tuple[Floats, float]:
    """Directional albedo of a dielectric GGX coat, and how much light gets through it on the whole.

    The albedo is the mean of Fresnel's term times Smith's masking over visible microfacets, by a product rule.

    Returns
    -------
    albedo : (128,) float64
        At equally spaced cosines from 0 to 1.
    transmitted : float
        1 less its mean over the hemisphere, of the interpolant exactly.
    """
    cosine = np.linspace(0.0, 1.0, COAT_NODES)[:, None, None]
    sine = np.sqrt(1.0 - cosine**2)
    node, weight = np.polynomial.legendre.leggauss(48)
    v, weight = 0.5 * (node + 1.0)[None, :, None], 0.5 * weight[None, :, None]
    phi = np.pi * (np.arange(48) + 0.5) / 48.0  # half a turn: the other half mirrors it
    # The stretched view direction, a uniform point on the cap around it, and the microfacet that belongs to the point.
    length = np.sqrt((roughness * sine) ** 2 + cosine**2)
    sx, sz = roughness * sine / np.maximum(length, 1e-300), cosine / np.maximum(length, 1e-300)
    z = (1.0 - v) * (1.0 + sz) - sz
    radius = np.sqrt(np.maximum(0.0, 1.0 - z**2))
    hx, hy, hz = roughness * (radius * np.cos(phi) + sx), roughness * radius * np.sin(phi), np.maximum(z + sz, 1e-300)
    norm = np.sqrt(hx**2 + hy**2 + hz**2)
    hx, hy, hz = hx / norm, hy / norm, hz / norm
    c = np.clip(hx * sine + hz * cosine, 0.0, 1.0)
    wz = 2.0 * c * hz - cosine
    up = np.maximum(wz, 0.0)
    seen = 2.0 * up / np.maximum(up + np.sqrt(up**2 + roughness**2 * (1.0 - np.minimum(up, 1.0) ** 2)), 1e-300)
    inner = np.sqrt(1.0 - (1.0 - c**2) / ior**2)
    fresnel = 0.5 * (((ior * c - inner) / (ior * c + inner)) ** 2 + ((c - ior * inner) / (c + ior * inner)) ** 2)
    albedo = (weight * (fresnel * seen).mean(axis=2, keepdims=True)).sum(axis=(1, 2))
    step, edge = 1.0 / (COAT_NODES - 1), cosine[:, 0, 0]
    # Simpson's rule is exact for the cosine times a linear function.
    middle = 0.5 * (edge[1:] + edge[:-1]) * 0.5 * (albedo[1:] + albedo[:-1])
    mean = 2.0 * step * ((edge * albedo)[1:] + (edge * albedo)[:-1] + 4.0 * middle).sum() / 6.0
    albedo.setflags(write=False)
    return albedo, float(1.0 - mean)
