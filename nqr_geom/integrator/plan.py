"""How much to spend: double the samples until repetitions agree, and say what was chosen and why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from nqr_geom.integrator.estimate import Estimate, Statistics, run
from nqr_geom.integrator.problem import Problem
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler

__all__ = ["until"]

_REPLICATES = 8
_MOST = 2**14  # samples per integral and replicate before giving up


def until(problem: Problem, sampler: Sampler, rule: Rule, tol: float, n: int, *, seed: int = 0) -> Estimate:
    """Double n until the spread of eight repetitions says that every integral is within `tol`.

    Only integrals that are not there yet are estimated again. The spread sees variance, not a bias that all
    repetitions share: two successive sizes must agree within `tol` as well.

    Parameters
    ----------
    problem, sampler, rule
        As for `run`.
    tol : float
        Absolute tolerance on G(F), > 0.
    n : int
        Samples per integral to start with.
    seed : int
        As for `run`.

    Returns
    -------
    Estimate
        `plan` holds the tolerance, the sizes tried, and "met", whether every integral got there before 16384 samples.
    """
    total = run(problem, sampler, rule, n, replicates=_REPLICATES, seed=seed)
    value, stderr = total.value.copy(), _error_bar(total)
    inner, fallback, m2 = total.inner.copy(), total.fallback.copy(), total.statistics.m2.copy()
    open_rows = np.arange(problem.batch)
    sizes, seconds, counts = [n], total.seconds, dict(total.counts)
    while n < _MOST and len(open_rows):
        n *= 2
        part = run(problem.take(_index(open_rows)), sampler, rule, n, replicates=_REPLICATES, seed=seed)
        settled = np.maximum(3.0 * _error_bar(part), np.abs(part.value - value[open_rows])).max(axis=1) <= tol
        value[open_rows], stderr[open_rows] = part.value, _error_bar(part)
        inner[open_rows], fallback[open_rows], m2[open_rows] = part.inner, part.fallback, part.statistics.m2
        open_rows = open_rows[~settled]
        sizes.append(n)
        seconds += part.seconds
        counts = {key: counts[key] + part.counts[key] for key in counts}
    plan = {**total.plan, "n": n, "tol": tol, "sizes": tuple(sizes), "met": not len(open_rows)}
    return replace(
        total,
        value=value,
        stderr=stderr,
        n=n,
        inner=inner,
        counts=counts,
        seconds=seconds,
        stages={"all": seconds},
        fallback=fallback,
        plan=plan,
        statistics=Statistics(value, m2, _REPLICATES, "replicates"),
    )


def _error_bar(estimate: Estimate) -> NDArray[np.float64]:
    """Standard error of eight or more repetitions; they always have one."""
    return estimate.stderr if estimate.stderr is not None else np.full_like(estimate.value, np.inf)


def _index(rows: NDArray[np.int64]) -> torch.Tensor:
    return torch.from_numpy(rows)
