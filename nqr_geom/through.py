"""Pictures of the light that gets through a volume; what `nqr-geom transmittance` does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.render.volume import Volume

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate

__all__ = ["AXES", "named_volume", "save_image", "see_through"]

Floats = NDArray[np.float64]

AXES = ("x", "y", "z")


def named_volume(source: str, *, text: bool = False, density: float = 1.0, seed: int = 0) -> Volume:
    """The volume a user names: cloud, donut, a word, or a .npy file with densities (nx, ny, nz) on a unit of length.

    Parameters
    ----------
    source : str
        "cloud", "donut", a file, or what letters say.
    text : bool
        Take `source` as letters.
    density : float
        Times the densities, >= 0.
    seed : int
        Which cloud, or which noise.

    Raises
    ------
    ValueError
        If there is no such file or volume.

    Examples
    --------
    >>> named_volume("cloud", density=2.0).majorant
    2.0
    """
    from nqr_geom import datasets
    from nqr_geom.render.clouds import Extrusion, Spheres, Torus
    from nqr_geom.render.volume import Grid

    density = check.number("density", density, low=0.0)
    if not text and source.lower().endswith(".npy"):
        if not Path(source).is_file():
            raise ValueError(f"source: expected an existing file, got {source!r}")
        data = check.array("source", np.load(source, allow_pickle=False), ("nx", "ny", "nz"))
        size = np.array(data.shape, dtype=np.float64) - 1.0
        return Grid(density * data, np.zeros(3), size / max(size.max(), 1.0))
    made: Spheres | Torus | Extrusion
    if text:
        made = datasets.letters(source, seed=seed)
    elif check.choice("source", source, ("cloud", "donut")) == "cloud":
        made = datasets.volumes(1, seed=seed)[0]
    else:
        made = datasets.donut(seed=seed)
    return replace(made, density=density)


def see_through(
    volume: Volume,
    *,
    axis: str = "z",
    resolution: int = 256,
    method: str = "stratified",
    n: int = 24,
    tol: float | None = None,
    budget: float | None = None,
    seed: int = 0,
) -> tuple[Floats, Estimate]:
    """Transmittance of parallel rays along an axis, one a pixel, and the estimate behind it.

    Parameters
    ----------
    volume : Volume
        What is in the way.
    axis : {"x", "y", "z"}
        Direction of the rays; the other two axes go right and up.
    resolution : int
        Pixels of the picture's longer side.
    method, n, tol, budget, seed
        As for `nqr_geom.render.transmittance`.

    Returns
    -------
    image : (h, w) float64 ndarray
        First row at the top.
    estimate : Estimate

    Examples
    --------
    >>> from nqr_geom import render
    >>> image, _ = see_through(render.Homogeneous([0, 0, 0], [2, 1, 1], 1.0), axis="x", resolution=4)
    >>> image.shape, float(image[0, 0].round(6))
    ((4, 4), 0.135335)
    """
    from nqr_geom.render.estimators import transmittance

    along = AXES.index(check.choice("axis", axis, AXES))
    right, up = ((1, 2), (0, 2), (0, 1))[along]
    low, high = volume.bounds
    size = high - low
    step = max(size[right], size[up]) / check.integer("resolution", resolution, low=1)
    columns, lines = (max(1, round(size[k] / step)) for k in (right, up))
    origins = np.empty((lines, columns, 3))
    origins[..., along] = low[along]
    origins[..., right] = low[right] + (np.arange(columns) + 0.5) / columns * size[right]
    origins[..., up] = (high[up] - (np.arange(lines) + 0.5) / lines * size[up])[:, None]
    ways = np.zeros((lines * columns, 3))
    ways[:, along] = 1.0
    asked: dict[str, Any] = {"n": n, "method": method, "tol": tol, "budget": budget, "seed": seed}
    estimate: Any = transmittance(volume, origins.reshape(-1, 3), ways, size[along], full_output=True, **asked)
    return estimate.value.reshape(lines, columns), estimate


def save_image(path: str | Path, image: Floats) -> Path:
    """Write transmittances (h, w) as a .png, black where nothing gets through, or as they are as a .npy."""
    target = Path(path)
    ending = check.choice("out", target.suffix.lower(), (".png", ".npy"))
    target.parent.mkdir(parents=True, exist_ok=True)
    if ending == ".npy":
        np.save(target, image)
        return target
    check.require("matplotlib", "plot", "pictures")
    from matplotlib.image import imsave

    imsave(target, np.clip(image, 0.0, 1.0), cmap="gray", vmin=0.0, vmax=1.0)
    return target
