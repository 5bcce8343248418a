"""Arrays that take minutes to compute, kept on disk: written aside, then renamed, and found again by a digest."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.files import cache_folder

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
    They lie in `nqr_geom.files.cache_folder()`.
    """
    folder = cache_folder() / "laplace"
    path = folder / f"{name}-{hashlib.sha256(np.ascontiguousarray(key).tobytes()).hexdigest()[:16]}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.npz")
        arrays: dict[str, Any] = dict(compute())
        np.savez(aside, **arrays)
        os.replace(aside, path)
    with np.load(path) as data:
        return dict(data)
