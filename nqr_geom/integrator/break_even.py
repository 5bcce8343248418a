"""From which price per integrand query on a costly rule wins against a cheap one at equal time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nqr_geom import check

__all__ = ["break_even", "samples_to_match"]


def samples_to_match(sizes: Sequence[int], mse: Sequence[float], target: float) -> float:
    """Samples that a rule with the measured curve needs for a mean squared error of at most `target`.

    Between measured sizes the error is a power of the number of samples; beyond the last one the answer is infinite,
    because a curve that was not measured proves nothing.

    Parameters
    ----------
    sizes : sequence of int
        Ascending numbers of samples.
    mse : sequence of float
        Mean squared errors at them, > 0; a size that does worse than a smaller one counts as that one.
    target : float
        Error to reach, >= 0.

    Returns
    -------
    float
        At least the first size.

    Raises
    ------
    ValueError
        If sizes do not ascend or lengths differ.

    Examples
    --------
    >>> samples_to_match([4, 64], [1.0, 0.0625], 0.25)
    16.0
    >>> samples_to_match([4, 64], [1.0, 0.0625], 0.01)
    inf
    """
    n = np.array([check.integer("sizes", size, low=1) for size in sizes], dtype=np.float64)
    errors = np.array([check.number("mse", value, low=0.0, open_low=True) for value in mse])
    target = check.number("target", target, low=0.0)
    if len(n) != len(errors) or not len(n) or (np.diff(n) <= 0.0).any():
        raise ValueError(f"sizes: expected {len(errors)} ascending numbers, got {list(sizes)}")
    best = np.minimum.accumulate(errors)
    if target >= best[0]:
        return float(n[0])
    if target < best[-1]:
        return float("inf")
    k = int(np.argmax(best <= target))  # the first size that is good enough; the one before is not
    share = np.log(best[k - 1] / target) / np.log(best[k - 1] / best[k])
    return float(n[k - 1] * (n[k] / n[k - 1]) ** share)


def break_even(sizes: Sequence[int], mse: Sequence[float], n: int, target: float, overhead: float) -> float:
    """Cost c* of an integrand query from which n samples of a costly rule win at equal time.

    At a cost of c a query the costly rule takes n c + overhead, in which the cheap one affords (n c + overhead)/c
    samples. It needs M of them for the same error, so that c* = overhead / (M - n).

    Parameters
    ----------
    sizes, mse : sequence of int, sequence of float
        Measured curve of the cheap rule, as for `samples_to_match`.
    n : int
        Samples of the costly rule.
    target : float
        Its mean squared error.
    overhead : float
        Time that it spends beyond its queries, >= 0, in any unit.

    Returns
    -------
    float
        In the unit of `overhead`: infinite where the cheap rule needs no more samples than the costly one, 0 where its
        measured curve does not come down to the target. There any cost above overhead / (last size - n) is proven.

    Examples
    --------
    >>> round(break_even([4, 64, 1024], [1.0, 0.0625, 0.00390625], n=32, target=0.015625, overhead=44.8), 9)
    0.2
    """
    overhead = check.number("overhead", overhead, low=0.0)
    needed = samples_to_match(sizes, mse, target)
    n = check.integer("n", n, low=1)
    return float("inf") if needed <= n else overhead / (needed - n)
