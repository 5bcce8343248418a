"""How fast this machine is beside the one on which the shipped cost models were measured, found out once.

Three short loops stand for what methods spend time on: small calls, element-wise numbers, and matrix products. They are
measured on first use (about a fifth of a second), and kept in the user's cache under a fingerprint of machine, package
and library versions, so that another machine or an update measures anew.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from functools import cache

import numpy as np

from nqr_geom.files import cache_folder, write_whole
from nqr_geom.machine import machine, versions

__all__ = ["KINDS", "fingerprint", "measured", "speed"]

KINDS = ("calls", "numbers", "matrices")

_REPEATS = 10
_LEAST = 1e-7  # seconds; no loop here takes less


def _calls() -> None:
    small = np.ones(8)
    for _ in range(2000):
        small = np.add(small, 1.0)


def _numbers() -> None:
    many = np.linspace(0.1, 1.0, 50_000)
    for _ in range(10):
        many = np.sqrt(np.exp(many) * 0.3)


def _matrices() -> None:
    square = np.full((60, 60), 0.5)  # so small that it stays on one core, whatever else runs
    for _ in range(256):
        square = square @ square * 1e-3


_LOOPS: tuple[Callable[[], None], ...] = (_calls, _numbers, _matrices)


def measured() -> dict[str, float]:
    """Seconds that each of the loops takes now: the shortest of a few, taken in turns, is the one least disturbed.

    Examples
    --------
    >>> sorted(measured()) == sorted(KINDS)
    True
    """
    found = dict.fromkeys(KINDS, math.inf)
    for _ in range(_REPEATS):
        for kind, loop in zip(KINDS, _LOOPS, strict=True):
            start = time.perf_counter()
            loop()
            found[kind] = max(min(found[kind], time.perf_counter() - start), _LEAST)
    return found


def fingerprint() -> str:
    """Names this machine and the libraries that run on it, as 16 hexadecimal digits."""
    told = {key: value for key, value in machine().items() if key != "torch_threads"}
    text = json.dumps([told, versions("numpy", "numba", "torch", "scipy")], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _kept(name: str) -> dict[str, float] | None:
    """What an earlier process measured, or None where nothing usable is kept."""
    try:
        found = json.loads((cache_folder() / name).read_text())
        kept = {kind: float(found[kind]) for kind in KINDS}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return kept if all(_LEAST <= seconds < 60.0 for seconds in kept.values()) else None


@cache
def speed() -> dict[str, float]:
    """Seconds of the loops on this machine, from the cache or measured now.

    Returns
    -------
    dict
        Seconds by kind. Where the cache cannot be written the figures are good for this process alone.

    Examples
    --------
    >>> all(seconds > 0.0 for seconds in speed().values())
    True
    """
    name = f"speed-{fingerprint()}.json"
    kept = _kept(name)
    if kept is not None:
        return kept
    found = measured()
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        write_whole(cache_folder() / name, json.dumps(found))
    except OSError:
        pass
    return found
