"""How far an estimate may be off, from what it says itself: bounds on every integral out of a few repetitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from nqr_geom.integrator.statistics import Statistics

__all__ = ["bound_of_samples", "bound_of_values"]

Floats = NDArray[np.float64]

_PRIOR = 3.0  # repetitions' worth of belief that an integral is like the others of its batch
_LEVEL = 0.975


def bound_of_values(values: Floats) -> Floats:
    """95% bounds on the error of the mean over R repetitions.

    With two or three repetitions the spread of one integral says little, that of all integrals together a lot: the
    variance of each is drawn towards the median of all (an empirical-Bayes variance as in Smyth 2004, with a fixed
    weight), and Student's quantile counts both.

    Parameters
    ----------
    values : ndarray, (R, B, C), R >= 2
        Independent repetitions.

    Returns
    -------
    ndarray, (B,)
        The largest over channels.

    Examples
    --------
    >>> bound_of_values(np.array([[[1.0], [2.0]], [[1.1], [2.1]]])).round(3)
    array([0.635, 0.635])
    """
    repeats = values.shape[0]
    own = values.var(axis=0, ddof=1)  # (B, C)
    if repeats >= 8 or len(own) < 8:
        freedom, variance = repeats - 1.0, own
    else:
        spread = own[own > 0.0]
        # The median of chi-square with one degree of freedom, 0.455, to the mean, 1.
        median = {2: 0.4549, 3: 0.6931}.get(repeats, 0.8)
        whole = float(np.median(spread)) / median if len(spread) else 0.0
        freedom = repeats - 1.0 + _PRIOR
        variance = (_PRIOR * whole + (repeats - 1.0) * own) / freedom
        variance[own == 0.0] = 0.0 if not len(spread) else variance[own == 0.0]
    bound = stdtrit(freedom, _LEVEL) * np.sqrt(variance / repeats)
    return np.asarray(bound.max(axis=1))


def bound_of_samples(statistics: Statistics) -> Floats:
    """95% bounds on the error of a mean of independent samples, (B,).

    Where the moments say that the spread hangs on few samples, its own uncertainty is added: the standard error of a
    variance is about sqrt((kurtosis - 1) / count) of it.
    """
    count = np.asarray(statistics.count, dtype=np.float64)
    variance = statistics.m2 / np.maximum(count - 1.0, 1.0)
    kurtosis = statistics.kurtosis
    tail = np.zeros_like(variance) if kurtosis is None else np.where(np.isfinite(kurtosis), kurtosis, 1.0)
    variance = variance * (1.0 + np.sqrt(np.maximum(tail - 1.0, 0.0) / count))
    bound = stdtrit(np.maximum(count - 1.0, 1.0), _LEVEL) * np.sqrt(variance / count)
    return np.asarray(bound.max(axis=1))
