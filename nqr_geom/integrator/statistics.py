"""Mean, spread and shape of independent terms, mergeable; and whether the interval that they give can be trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check

__all__ = ["Statistics"]

Floats = NDArray[np.float64]

_LEAST_SAMPLES, _LEAST_REPLICATES = 2, 8  # terms below which a standard error means nothing
# An interval is trusted from this many terms on, where the third moment moves its coverage by a point at most and where
# no few terms make up the spread. What `coverage` measures on winding numbers near curves set them.
_TRUSTED = 64
_SKEW, _TAIL = 0.04, 0.1  # skewness^2 / count, kurtosis / count


@dataclass(frozen=True)
class Statistics:
    """Mean and central moments of independent terms, mergeable (Chan, Golub, LeVeque 1983; Pebay 2008).

    Parameters
    ----------
    mean, m2 : ndarray, (B, C), float64
        Mean of the terms and sum of their squared deviations from it.
    count : int, or ndarray (B, 1) of int
        Number of terms; one each where integrals have had different numbers of them.
    kind : {"samples", "replicates"}
        What a term is: one independent sample, or a whole replicate of a design.
    m3, m4 : ndarray, (B, C), or None
        Sums of third and fourth powers of the deviations, where they were kept.

    Examples
    --------
    >>> terms = np.arange(6.0).reshape(1, 6, 1)
    >>> both = Statistics.of(terms[:, :2]).merge(Statistics.of(terms[:, 2:]))
    >>> both.mean, both.kurtosis.round(3)
    (array([[2.5]]), array([[1.731]]))
    """

    mean: Floats
    m2: Floats
    count: Any
    kind: str
    m3: Floats | None = None
    m4: Floats | None = None

    @classmethod
    def of(cls, terms: Floats, kind: str = "samples") -> Statistics:
        """Statistics of terms (B, N, C); equal terms have exactly that mean."""
        off = terms - terms[:, :1]
        average = off.mean(axis=1)
        off -= average[:, None]
        square = off * off
        with np.errstate(over="ignore"):
            m3, m4 = (square * off).sum(axis=1), (square * square).sum(axis=1)
        return cls(terms[:, 0] + average, square.sum(axis=1), terms.shape[1], kind, m3, m4)

    def _moments(self) -> tuple[Floats, Floats] | None:
        """Third and fourth; a single term has none to deviate by."""
        if np.all(np.equal(self.count, 1)):
            return np.zeros_like(self.m2), np.zeros_like(self.m2)
        return None if self.m3 is None or self.m4 is None else (self.m3, self.m4)

    def merge(self, other: Statistics) -> Statistics:
        """Statistics of both sets of terms together."""
        if self.kind != other.kind or self.mean.shape != other.mean.shape:
            raise ValueError(
                f"other: expected {self.kind} of shape {self.mean.shape}, got {other.kind} of {other.mean.shape}"
            )
        a, b = self.count, other.count
        n = a + b
        delta = other.mean - self.mean
        mean = self.mean + delta * (b / n)
        with np.errstate(over="ignore", invalid="ignore"):
            m2 = self.m2 + other.m2 + delta**2 * (a * b / n)
            mine, others = self._moments(), other._moments()
            if mine is None or others is None:
                return Statistics(mean, m2, n, self.kind)
            step = delta / n
            m3 = mine[0] + others[0] + 3.0 * step * (a * other.m2 - b * self.m2) + a * b * (a - b) * n * step**3
            m4 = mine[1] + others[1] + 4.0 * step * (a * others[0] - b * mine[0])
            m4 += 6.0 * step**2 * (a * a * other.m2 + b * b * self.m2) + a * b * (a * a - a * b + b * b) * n * step**4
        return Statistics(mean, m2, n, self.kind, m3, m4)

    @property
    def stderr(self) -> Floats | None:
        """Standard error of the mean, or None where too few terms make it meaningless."""
        least = _LEAST_SAMPLES if self.kind == "samples" else _LEAST_REPLICATES
        if np.size(self.count) == 0 or np.min(self.count) < least:
            return None
        return np.asarray(np.sqrt(self.m2 / (self.count - 1) / self.count))

    @property
    def kurtosis(self) -> Floats | None:
        """Fourth central moment over the squared variance, 3 for a normal law; None where it was not kept.

        Where all terms are equal it is infinite: they say nothing of a tail.
        """
        moments = self._moments()
        return None if moments is None else self._standard(self.count * moments[1], self.m2, self.m2)

    @property
    def skewness(self) -> Floats | None:
        """Third central moment over the cubed standard deviation; infinite where all terms are equal."""
        moments = self._moments()
        if moments is None:
            return None
        return self._standard(np.sqrt(self.count) * moments[0], self.m2, np.sqrt(self.m2))

    @staticmethod
    def _standard(above: Floats, one: Floats, two: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ratio = above / one / two
        return np.where((one > 0.0) & np.isfinite(ratio), ratio, np.inf)

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Where an interval of two standard errors covers the truth about as often as it says, (B, C) bool.

        It takes 64 terms, and a skewness and a kurtosis (of the terms that were seen) that are small for their number:
        skewness moves the coverage of the interval by about a quarter of its square over the count (Hall 1988), and
        a kurtosis that is of the order of the count says that a few terms make up the spread, so that others like
        them may not have been seen yet. Equal terms are not trusted either: nothing tells what they have missed.
        """
        skewness, kurtosis = self.skewness, self.kurtosis
        if self.stderr is None or skewness is None or kurtosis is None:
            return np.zeros(self.mean.shape, dtype=bool)
        with np.errstate(over="ignore"):
            alike = (skewness**2 <= _SKEW * self.count) & (kurtosis <= _TAIL * self.count)
        return np.asarray(alike & (self.count >= _TRUSTED))

    def interval(self, level: float = 0.95) -> tuple[Floats, Floats] | None:
        """Ends of Student's interval about the mean, (B, C) each, or None where there is no standard error.

        Parameters
        ----------
        level : float
            Between 0 and 1. Whether the interval covers as often as that is what `trusted` says.
        """
        level = check.number("level", level, low=0.0, high=1.0, open_low=True)
        stderr = self.stderr
        if stderr is None:
            return None
        from scipy.special import stdtrit

        half = stdtrit(self.count - 1, 0.5 + 0.5 * level) * stderr
        return self.mean - half, self.mean + half

    def take(self, rows: NDArray[np.int64]) -> Statistics:
        """The statistics of the integrals `rows`."""

        def part(array: Any) -> Any:
            return array if array is None or np.ndim(array) == 0 else array[rows]

        names = ("mean", "m2", "count", "m3", "m4")
        return replace(self, **{name: part(getattr(self, name)) for name in names})
