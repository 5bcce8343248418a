"""What a hard case is: a call, the truth that its error is counted from, and the bound that the error must keep."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["Case", "Result", "deviation", "refusal", "sigmas"]


@dataclass(frozen=True)
class Case:
    """One hard case of one application.

    Parameters
    ----------
    group : str
        Application, a key of `groups()`.
    name : str
        What is hard, in words. What stands in brackets behind it is a variant (another scale, method or exponent) of
        the same case: "square [scale 1e-6]" counts as "square".
    run : callable
        Computes, and returns the error against the truth, >= 0; NaN counts as a failure.
    bound : float
        What the error must not exceed.
    naive : callable, optional
        The error that the textbook's formula makes on the same case: why it is hard. It exceeds the bound.
    refused : bool
        Whether a refusal by name is what must happen; `run` then returns 0 for the right words and inf otherwise.

    Examples
    --------
    >>> third = Case("sums", "a third [float64]", lambda: abs(sum([0.1] * 3) - 0.3), 1e-15)
    >>> third.measure().holds, third.base
    (True, 'a third')
    """

    group: str
    name: str
    run: Callable[[], float]
    bound: float
    naive: Callable[[], float] | None = None
    refused: bool = False

    @property
    def base(self) -> str:
        """The name without its variant."""
        return self.name.partition(" [")[0]

    def measure(self) -> Result:
        """Run the case; an error on the way is a failure with its words, not the end of the catalogue."""
        from time import perf_counter

        begin, words = perf_counter(), ""
        try:
            error = float(self.run())
        except Exception as caught:
            error, words = float("inf"), f"{type(caught).__name__}: {caught}"
        return Result(self.group, self.name, error, self.bound, perf_counter() - begin, words)


@dataclass(frozen=True)
class Result:
    """What a case gave on this machine.

    Parameters
    ----------
    group, name : str
        As in the case.
    error, bound : float
        Measured, and allowed. An exception gives inf, a missing value NaN.
    seconds : float
        Wall time, the first use of a kernel included.
    words : str
        Of an exception, else empty.
    """

    group: str
    name: str
    error: float
    bound: float
    seconds: float
    words: str = ""

    @property
    def holds(self) -> bool:
        """Whether the error keeps its bound; NaN does not."""
        return bool(self.error <= self.bound)


def deviation(got: ArrayLike, truth: ArrayLike, unit: float = 1.0) -> float:
    """Largest |got - truth| / unit; NaN if any is missing or the shapes differ.

    Examples
    --------
    >>> deviation([1.0, 2.5], [1.0, 2.0], unit=10.0)
    0.05
    """
    got, truth = np.asarray(got, dtype=float), np.asarray(truth, dtype=float)
    if got.shape != np.broadcast_shapes(got.shape, truth.shape):
        return float("nan")
    apart = np.where(got == truth, 0.0, np.abs(got - truth) / unit)  # equal infinities are equal
    return float(apart.max()) if apart.size else 0.0


def sigmas(got: ArrayLike, stderr: ArrayLike, truth: ArrayLike, bias: float = 0.0) -> float:
    """Largest distance from the truth in standard errors, after an allowance for a known bias.

    Examples
    --------
    >>> sigmas([1.3], [0.1], [1.0], bias=0.1).__round__(6)
    2.0
    """
    apart = np.abs(np.asarray(got, dtype=float) - truth) - bias
    with np.errstate(divide="ignore", invalid="ignore"):
        units = np.where(apart <= 0.0, 0.0, apart / np.asarray(stderr, dtype=float))
    return float("nan") if np.isnan(apart).any() else float(units.max())


def refusal(group: str, name: str, call: Callable[[], object], words: str, error: type[Exception] = ValueError) -> Case:
    """A case that must be refused with an error of that class whose message matches `words`, a regular expression."""

    def run() -> float:
        try:
            call()
        except Exception as caught:
            return 0.0 if type(caught) is error and re.search(words, str(caught)) else float("inf")
        return float("inf")

    return Case(group, name, run, 0.0, refused=True)
