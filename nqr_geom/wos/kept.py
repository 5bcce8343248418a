"""Arrays that take minutes to compute, kept on disk: written aside, then renamed, and found again by a digest."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["kept"]

Arrays = Mapping[str, NDArray[Any]]


def kept(name: str, key: NDArray[Any], compute: Callable[[], Arrays]) -> Arrays:
    """What `compute` gives, from disk where it has been computed before.

    Parameters
    ----------
    name : str
        Of the kind of arrays; another way to compute them is another name.
    key : ndarray
        What they depend on.
    compute : callable
        Arrays by name.

    Notes
    -----
    The folder is the environment's `NQR_GEOM_CACHE`, or `nqr_geom` in the user's cache.
    """
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("NQR_GEOM_CACHE") or Path(home) / "nqr_geom") / "laplace"
    path = folder / f"{name}-{hashlib.sha256(np.ascontiguousarray(key).tobytes()).hexdigest()[:16]}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.npz")
        arrays: dict[str, Any] = dict(compute())
        np.savez(aside, **arrays)
        os.replace(aside, path)
    with np.load(path) as data:
        return dict(data)
