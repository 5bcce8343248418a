"""The random numbers of `nqr_geom.streams` inside compiled kernels, bit for bit the same."""

from __future__ import annotations

import numpy as np
from numba import njit

from nqr_geom import streams

__all__ = ["mixed", "unit", "unsigned"]

_GOLDEN = np.uint64(streams._GOLDEN & (2**64 - 1))
_M1 = np.uint64(streams._M1 & (2**64 - 1))
_M2 = np.uint64(streams._M2 & (2**64 - 1))
_ONE, _S12, _S27, _S30, _S31 = (np.uint64(k) for k in (1, 12, 27, 30, 31))


def unsigned(key: int) -> np.uint64:
    """A stream's key as kernels take it."""
    return np.uint64(key & (2**64 - 1))


@njit(inline="always")
def mixed(state: np.uint64, counter: int) -> np.uint64:
    """Take one counter into the state; start from a stream's key, and unsigned."""
    z = (np.uint64(counter) + _ONE) * _GOLDEN + state
    z = (z ^ (z >> _S30)) * _M1
    z = (z ^ (z >> _S27)) * _M2
    return z ^ (z >> _S31)


@njit(inline="always")
def unit(state: np.uint64) -> float:
    """The number in (0, 1) that a state stands for."""
    return (np.float64(state >> _S12) + 0.5) * 2.0**-52
