"""Keyed randomness: a random number is a pure function of (seed, split, stream, row, sample, dimension).

Nothing here has state, so an answer does not depend on tiles, threads or workers, and the seeds of training and
test cannot meet: they differ in `split`. The arithmetic is that of 64-bit integers with wrap-around and uses
operators only, so the same lines serve NumPy arrays and torch tensors (and mirror kernels bit for bit).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

__all__ = ["SPLITS", "Stream", "bits", "to_unit"]

SPLITS = ("test", "train", "validation")

Integers = TypeVar("Integers", bound=Any)  # int64 NumPy array or torch tensor


def _signed(value: int) -> int:
    """The two's-complement int64 with the bits of `value`."""
    value &= (1 << 64) - 1
    return value - (1 << 64) if value >> 63 else value


# The finaliser of SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
_GOLDEN = _signed(0x9E3779B97F4A7C15)
_M1 = _signed(0xBF58476D1CE4E5B9)
_M2 = _signed(0x94D049BB133111EB)


def _mix(z: Integers) -> Integers:
    """SplitMix64's finaliser, element by element; `& mask` makes the arithmetic shift a logical one."""
    z = (z ^ ((z >> 30) & 0x3FFFFFFFF)) * _M1
    z = (z ^ ((z >> 27) & 0x1FFFFFFFFF)) * _M2
    return z ^ ((z >> 31) & 0x1FFFFFFFF)


def _mix_scalar(z: int) -> int:
    return int(_mix(np.array([_signed(z)], dtype=np.int64))[0])


def bits(key: int, *counters: Integers) -> Integers:
    """Hash a key and broadcastable int64 counters to 64 random bits each.

    Parameters
    ----------
    key : int
        A 64-bit key, as held by `Stream`.
    *counters : int64 ndarray or tensor
        Broadcastable index arrays; their order matters.

    Returns
    -------
    int64 ndarray or tensor
        The broadcast shape; all 64 bits are usable.

    Examples
    --------
    >>> bool((bits(1, np.arange(3)) == bits(1, np.arange(3))).all())
    True
    """
    state: Any = _signed(key)
    for counter in counters:
        state = _mix((counter + 1) * _GOLDEN + state)
    return state


def to_unit(random_bits: Integers) -> Any:
    """Map 64 random bits to float64 in (0, 1): 52 bits, centred, so that 0 and 1 never come.

    Examples
    --------
    >>> u = to_unit(bits(7, np.arange(1000)))
    >>> bool(u.min() > 0 and u.max() < 1)
    True
    """
    mantissa = (random_bits >> 12) & 0xFFFFFFFFFFFFF
    # Torch would promote int64 + 0.5 to float32.
    real = mantissa.double() if hasattr(mantissa, "double") else mantissa.astype(np.float64)
    return (real + 0.5) * 2.0**-52


@dataclass(frozen=True)
class Stream:
    """A named source of random numbers.

    Parameters
    ----------
    seed : int
        The user's seed.
    split : {"test", "train", "validation"}
        Which world the numbers belong to; public functions use "test".
    name : str
        What they are for ("samples", "shapes", ...); different names are independent.

    Examples
    --------
    >>> stream = Stream(seed=0, name="demo")
    >>> u = stream.uniform(np.arange(2)[:, None], np.arange(3))
    >>> u.shape
    (2, 3)
    >>> bool((u == stream.uniform(np.arange(2)[:, None], np.arange(3))).all())
    True
    """

    seed: int
    split: str = "test"
    name: str = "samples"

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {self.split!r}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)):
            raise TypeError(f"seed: expected an integer, got {self.seed!r}")

    @property
    def key(self) -> int:
        """The 64-bit key of this stream."""
        key = _mix_scalar(int(self.seed) + _GOLDEN)
        key = _mix_scalar(key + SPLITS.index(self.split) + 1)
        return _mix_scalar(key ^ zlib.crc32(self.name.encode()))

    def child(self, name: str) -> Stream:
        """An independent stream derived from this one by name."""
        return Stream(self.seed, self.split, f"{self.name}/{name}")

    def bits(self, *counters: Integers) -> Integers:
        """64 random bits for every combination of the broadcastable int64 counters."""
        return bits(self.key, *counters)

    def uniform(self, *counters: Integers) -> Any:
        """Float64 in (0, 1) for every combination of the broadcastable int64 counters."""
        return to_unit(self.bits(*counters))
