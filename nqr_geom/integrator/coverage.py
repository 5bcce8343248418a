"""How often error bars hold: the coverage of intervals against the number of terms and their kurtosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from nqr_geom import check, registry
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.problem import Problem
from nqr_geom.integrator.statistics import Statistics

__all__ = ["BINS", "Coverage", "coverage"]

BINS = (1.0, 4.0, 8.0, 16.0, 64.0, 256.0, np.inf)  # of the kurtosis; a normal law has 3
_LEVEL = 0.95


@dataclass(frozen=True)
class Coverage:
    """Integrals of similar kurtosis at one number of samples.

    Attributes
    ----------
    n : int
        Samples per integral.
    low, high : float
        The kurtosis of an integral's terms lies in [low, high).
    integrals, runs : int
        How many integrals, and independent runs of each.
    covered : float
        Share of all 95% Student intervals that hold the true value.
    trusted : float
        Share of estimates that `Estimate.trusted` vouches for.
    covered_trusted : float or None
        Share of the intervals of those that hold the true value; None where none was trusted.
    """

    n: int
    low: float
    high: float
    integrals: int
    runs: int
    covered: float
    trusted: float
    covered_trusted: float | None


def coverage(
    problem: Problem,
    *,
    sampler: str = "random",
    rule: str = "mc",
    sizes: Sequence[int] = (32, 64, 128, 256, 512),
    runs: int = 500,
    seed: int = 0,
    truth: NDArray[np.float64] | None = None,
) -> list[Coverage]:
    """Count how often 95% intervals hold the truth, by number of samples and by kurtosis.

    Parameters
    ----------
    problem : Problem
        One with a reference.
    sampler, rule : str
        Of the registry, with independent samples and a rule that averages them.
    sizes : sequence of int
        Samples per integral, each >= 2.
    runs : int
        Independent runs, with seeds from `seed` on.
    seed : int
        Of the first run.
    truth : (B, C) ndarray, optional
        The true answers, where they are known already; by default the problem's reference.

    Returns
    -------
    list of Coverage
        For every size, the bins of kurtosis that hold an integral. The kurtosis is that of all terms of all runs.

    Raises
    ------
    ValueError
        If the problem has no reference, or the method no standard error from its samples.

    References
    ----------
    Hall, On the bootstrap and confidence intervals, 1988: what skewness and kurtosis take from a t interval.

    Examples
    --------
    >>> from nqr_geom.toy.problem import ToyProblem
    >>> rows = coverage(ToyProblem(20), sizes=[128], runs=40)
    >>> sum(row.integrals for row in rows), all(0.8 < row.covered <= 1.0 for row in rows)
    (20, True)
    """
    runs = check.integer("runs", runs, low=2)
    seed = check.integer("seed", seed)
    sizes = [check.integer("sizes", n, low=2) for n in sizes]
    truth = problem.reference() if truth is None else check.array("truth", truth, (problem.batch, problem.channels))
    if truth is None:
        raise ValueError(f"problem: expected one with a reference, {problem.name!r} has none")
    pair = registry.make("sampler", sampler), registry.make("rule", rule)
    rows: list[Coverage] = []
    for n in sizes:
        hits, trusts = np.empty((runs, problem.batch), bool), np.empty((runs, problem.batch), bool)
        whole: Statistics | None = None
        half = float(stdtrit(n - 1, 0.5 + 0.5 * _LEVEL))
        for k in range(runs):
            estimate = run(problem, *pair, n, seed=seed + k)
            if estimate.stderr is None or estimate.statistics.kind != "samples":
                raise ValueError(f"sampler: expected independent samples with a standard error, got {sampler}+{rule}")
            hits[k] = (np.abs(estimate.value - truth) <= half * estimate.stderr).all(axis=1)
            trusts[k] = estimate.trusted
            whole = estimate.statistics if whole is None else whole.merge(estimate.statistics)
        kurtosis = whole.kurtosis if whole is not None else None
        tail = np.full(problem.batch, np.inf) if kurtosis is None else kurtosis.max(axis=1)
        rows += _binned(n, tail, hits, trusts)
    return rows


def _binned(
    n: int, kurtosis: NDArray[np.float64], hits: NDArray[np.bool_], trusts: NDArray[np.bool_]
) -> list[Coverage]:
    rows = []
    for low, high in pairwise(BINS):
        own = (kurtosis >= low) & ((kurtosis < high) | (high == np.inf))
        if own.any():
            hit, trust = hits[:, own], trusts[:, own]
            sure = float(hit[trust].mean()) if trust.any() else None
            told = (int(own.sum()), len(hits), float(hit.mean()), float(trust.mean()), sure)
            rows.append(Coverage(n, low, high, *told))
    return rows
