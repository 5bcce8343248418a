"""How sure a measured error is: resample shapes, not queries, because queries on one shape err together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bootstrap", "Interval"]

Interval = tuple[float, float]
Floats = NDArray[np.float64]

_CHUNK = 100  # resamplings weighed at a time


@dataclass(frozen=True)
class Bootstrap:
    """The same resamplings for everything measured on one problem, so that ratios are resampled jointly.

    Where all integrals belong to one shape, that shape is all that is asked about, and the runs are resampled.

    Parameters
    ----------
    member : ndarray, (B,), int64
        Group number of each integral, 0 .. G-1.
    times : ndarray, (resamplings, U)
        How often each unit (group, or run where there is one group) was drawn.
    """

    member: NDArray[np.int64]
    times: NDArray

    @classmethod
    def of(cls, groups: NDArray, runs: int, seed: int, resamplings: int = 1000) -> Bootstrap:
        """Draw the resamplings for integrals of the given groups (B,)."""
        names, member = np.unique(groups, return_inverse=True)
        units = len(names) if len(names) > 1 else runs
        random = np.random.default_rng([seed % 2**63, 0xB00])
        times = np.empty((resamplings, units), dtype=np.uint16)
        for row in times:
            row[:] = np.bincount(random.integers(0, units, units), minlength=units)
        return cls(member.astype(np.int64), times)

    @property
    def over(self) -> str:
        """What is resampled: "groups" or "runs"."""
        return "groups" if self.member.max(initial=0) > 0 else "runs"

    def _resampled(self, errors: Floats) -> tuple[Floats, Floats]:
        """Sum and number of the errors (B, R) in every resampling."""
        if self.over == "runs":
            totals, counts = errors.sum(axis=0), np.full(errors.shape[1], float(errors.shape[0]))
        else:
            totals = np.bincount(self.member, errors.sum(axis=1))
            counts = np.bincount(self.member) * float(errors.shape[1])
        both = np.stack([totals, counts], axis=1)
        chunks = range(0, len(self.times), _CHUNK)
        summed = np.concatenate([self.times[i : i + _CHUNK].astype(np.float64) @ both for i in chunks])
        return summed[:, 0], summed[:, 1]

    def mean(self, errors: Floats) -> Interval:
        """95% interval of the mean of errors (B, R)."""
        total, count = self._resampled(errors)
        return _percentiles(total / count)

    def standard_error(self, errors: Floats) -> float:
        """Standard error of the mean of errors (B, R)."""
        total, count = self._resampled(errors)
        return float((total / count).std())

    def ratio(self, numerator: Floats, denominator: Floats) -> Interval | None:
        """95% interval of the ratio of two means of errors (B, R), both resampled alike; None where it is unbounded."""
        above, below = self._resampled(numerator)[0], self._resampled(denominator)[0]
        return None if (below <= 0.0).any() else _percentiles(above / below)

    def squared_bias(self, deviations: Floats) -> tuple[float, Interval]:
        """Mean squared bias from deviations (B, R, C), without the bias of squaring, and its 95% interval.

        The product of two different runs' deviations has the squared bias as its mean.
        """
        runs = deviations.shape[1]
        total, squares = deviations.sum(axis=1), (deviations**2).sum(axis=1)
        bias = ((total**2 - squares) / (runs * (runs - 1))).mean(axis=1)
        value = float(bias.mean())
        if self.over == "groups":
            return value, self.mean(bias[:, None])
        if runs < 3:
            return value, (-np.inf, np.inf)
        without = total[:, None] - deviations
        left = (without**2 - (squares[:, None] - deviations**2)).mean(axis=(0, 2)) / ((runs - 1) * (runs - 2))
        spread = 1.96 * float(np.sqrt((runs - 1) / runs * ((left - left.mean()) ** 2).sum()))  # jackknife over runs
        return value, (value - spread, value + spread)


def _percentiles(values: Floats) -> Interval:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)
