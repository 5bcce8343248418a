"""Run a sampler and a rule over a problem, in tiles, and say everything about the answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.integrator import memory
from nqr_geom.integrator.statistics import Statistics
from nqr_geom.streams import Stream

if TYPE_CHECKING:  # an estimate is plain data, and exact answers come as one without torch
    from nqr_geom.integrator.problem import Problem
    from nqr_geom.integrator.rules import Rule
    from nqr_geom.integrator.samplers import Sampler

__all__ = ["Estimate", "Statistics", "exactly", "folded", "run"]

TILE_SAMPLES = 2**17  # integrand values held at a time; a fixed number, so that tiling depends on n alone


@dataclass(frozen=True)
class Estimate:
    """An answer and everything worth knowing about it.

    Attributes
    ----------
    value : ndarray, (B, C), float64
        The estimates G(F).
    stderr : ndarray, (B, C), or None
        Standard error, for independent samples or at least 8 replicates; None where there is none. `trusted` says for
        each integral whether an interval of two of them can be believed.
    n : int
        Samples per integral and replicate.
    inner : ndarray, (B, C)
        The inner integrals F before the link, mean over the replicates.
    counts : dict
        Work that was done: "queries" of the integrand, and what else the problem counts.
    seconds : float
        Wall time; `stages` splits it.
    peak_memory : int or None
        Bytes above the level before the run, where the system tells.
    effects : frozenset of str
        What the problem called for.
    fallback : ndarray, (B,), bool
        Integrals where the method gave way to a safer one or had to clamp.
    plan : dict
        Which sampler, rule and budget ran, and why.
    error : ndarray, (B,), or None
        Where `tol` or `budget` was asked for, or the method has one: bounds on the absolute error that are meant to
        hold for 95 integrals in 100. A deterministic method's is its residual or its estimate.
    """

    value: NDArray[np.float64]
    stderr: NDArray[np.float64] | None
    n: int
    inner: NDArray[np.float64]
    counts: dict[str, int]
    seconds: float
    stages: dict[str, float]
    peak_memory: int | None
    effects: frozenset[str]
    fallback: NDArray[np.bool_]
    plan: dict[str, Any]
    statistics: Statistics = field(repr=False)
    error: NDArray[np.float64] | None = field(default=None, repr=False)

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Integrals whose standard error can be taken at its word, (B,) bool: see `Statistics.trusted`.

        False where there is no standard error, where too few terms were seen, and where their skewness or kurtosis is
        too large for their number: there "value +- 2 stderr" may cover the truth far less often than 95 times in 100.

        Examples
        --------
        >>> import nqr_geom as ng
        >>> few, many = (ng.integrate(ng.problems.toy(50), n=n, sampler="random") for n in (16, 1024))
        >>> bool(few.trusted.any()), bool(many.trusted.mean() > 0.9)
        (False, True)
        """
        if self.stderr is None:
            return np.zeros(len(self.value), dtype=bool)
        if np.max(self.statistics.count, initial=1) <= 1:  # a deterministic answer
            return np.ones(len(self.value), dtype=bool)
        return np.asarray(self.statistics.trusted.all(axis=1))

    def merge(self, other: Estimate) -> Estimate:
        """Both estimates together; they must come from the same problem and method with different seeds.

        Examples
        --------
        >>> import nqr_geom as ng
        >>> problem = ng.problems.toy(4)
        >>> one, two = (ng.integrate(problem, n=16, sampler="random", seed=s) for s in (0, 1))
        >>> one.merge(two).counts["queries"]
        128
        """
        same = ("problem", "sampler", "rule", "n")
        if [self.plan[key] for key in same] != [other.plan[key] for key in same]:
            raise ValueError(f"other: expected an estimate by the same plan {self.plan}, got {other.plan}")
        if set(self.plan["seeds"]) & set(other.plan["seeds"]):
            raise ValueError(f"other: expected other seeds than {self.plan['seeds']}, got {other.plan['seeds']}")
        statistics = self.statistics.merge(other.statistics)
        return replace(
            self,
            value=statistics.mean,
            inner=(self.inner * self.statistics.count + other.inner * other.statistics.count) / statistics.count,
            stderr=statistics.stderr,
            counts={key: self.counts[key] + other.counts[key] for key in self.counts},
            seconds=self.seconds + other.seconds,
            stages={key: self.stages[key] + other.stages[key] for key in self.stages},
            peak_memory=max((p for p in (self.peak_memory, other.peak_memory) if p is not None), default=None),
            fallback=self.fallback | other.fallback,
            plan={**self.plan, "seeds": self.plan["seeds"] + other.plan["seeds"]},
            statistics=statistics,
        )


def folded(estimate: Estimate, parts: int, alpha: float | None = None) -> Estimate:
    """Add up integrals that were estimated in parts: the batch holds all first parts, then all second ones, ...

    Parameters
    ----------
    estimate : Estimate
        Of parts * B integrals G(F).
    parts : int
        How many parts each of the B integrals has.
    alpha : float, optional
        G(F) is -ln(F) / alpha, and it is the F that add up; without it G is the identity.
    """
    if alpha is not None:
        return _folded_logarithms(estimate, parts, alpha)

    def total(values: NDArray[Any]) -> NDArray[Any]:
        return _added(values.reshape(parts, -1, *values.shape[1:]))

    old = estimate.statistics
    statistics = _summed(total, old, np.ones_like(old.mean))
    return replace(
        estimate,
        value=statistics.mean,
        stderr=statistics.stderr,
        inner=total(estimate.inner),
        fallback=total(estimate.fallback).astype(bool),
        plan={**estimate.plan, "parts": parts},
        statistics=statistics,
    )


def _added(parts: NDArray[Any]) -> NDArray[Any]:
    """Sum over axis 0, part after part: NumPy's own order depends on how many rows there are."""
    return np.asarray(reduce(np.add, parts))


def _folded_logarithms(estimate: Estimate, parts: int, alpha: float) -> Estimate:
    """`folded` behind -ln(F) / alpha, with the smallest part taken out so that no F under- or overflows."""
    old = estimate.statistics

    def stacked(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(parts, -1, *values.shape[1:])

    least = stacked(old.mean).min(axis=0)
    inner = np.exp(-alpha * (stacked(old.mean) - least))
    total = _added(inner)
    # Each part moves the sum by its share of it.
    share = (inner / total).reshape(old.mean.shape)
    statistics = _summed(lambda values: _added(stacked(values)), old, share)
    statistics = replace(statistics, mean=least - np.log(total) / alpha)
    # A part that is farther than the nearest by 20 / alpha would have to be that wrong before its doubts matter.
    seen = (inner > 1e-9 * total).any(axis=2)
    return replace(
        estimate,
        value=statistics.mean,
        stderr=statistics.stderr,
        inner=np.exp(-alpha * statistics.mean),
        fallback=(stacked(estimate.fallback) & seen).any(axis=0),
        plan={**estimate.plan, "parts": parts},
        statistics=statistics,
    )


def _summed(total: Callable[[NDArray[Any]], NDArray[Any]], old: Statistics, share: NDArray[np.float64]) -> Statistics:
    """Statistics of sums of independent parts, each times its share: their cumulants add up."""
    mean, m2, n = total(old.mean * share), total(old.m2 * share**2), old.count
    if old.m3 is None or old.m4 is None:
        return Statistics(mean, m2, n, old.kind)
    fourth = old.m4 - 3.0 * old.m2**2 / n
    m4 = total(fourth * share**4) + 3.0 * m2**2 / n
    return Statistics(mean, m2, n, old.kind, total(old.m3 * share**3), m4)


def exactly(answer: Callable[[], NDArray[np.float64]], problem: str) -> Estimate:
    """An exact answer (B,) in the form of an estimate: no samples, standard error zero."""
    start = time.perf_counter()
    with memory.PeakMemory() as peak:
        value = answer()[:, None]
    seconds = time.perf_counter() - start
    return Estimate(
        value=value,
        stderr=np.zeros_like(value),
        n=0,
        inner=value,
        counts={"samples": 0, "queries": 0},
        seconds=seconds,
        stages={"exact": seconds},
        peak_memory=peak.peak,
        effects=frozenset(),
        fallback=np.zeros(len(value), dtype=bool),
        plan={"problem": problem, "sampler": "none", "rule": "exact", "n": 0, "replicates": 1, "seeds": ()},
        statistics=Statistics(value, np.zeros_like(value), 1, "replicates"),
    )


def tiles(batch: int, n: int) -> list[slice]:
    """Cut a batch into tiles of a fixed number of rows that depends on n alone."""
    rows = max(1, TILE_SAMPLES // n)
    return [slice(start, min(start + rows, batch)) for start in range(0, batch, rows)]


def _tile(
    problem: Problem, sampler: Sampler, rule: Rule, n: int, stream: Stream, stages: dict[str, float]
) -> dict[str, Any]:
    """One replicate of one tile: estimate, spread of its terms where they are independent, and the work done."""
    from nqr_geom.integrator.sums import power_sums

    start = time.perf_counter()
    whole = problem.compiled(sampler, rule, n)
    if whole is not None:
        result = whole(stream)
        stages["compiled"] = stages.get("compiled", 0.0) + time.perf_counter() - start
        counts = {"samples": problem.batch * n, "queries": result.queries, **result.work}
        inner, link = result.inner, result.link
        slope = link.slope(inner)
        moments = {k: m * slope**k for k, m in ((2, result.m2), (3, result.m3), (4, result.m4)) if m is not None}
        fallback = result.fallback | link.clamped(inner).any(dim=1)
        return {"value": link(inner), "inner": inner, "moments": moments, "fallback": fallback, "counts": counts}
    samples = sampler.draw(problem, n, stream)
    drawn = time.perf_counter()
    samples, link = problem.finalize(samples)
    combination = rule.combine(samples)
    inner = combination.estimate(samples)
    link = combination.link or link
    value = link(inner)
    fallback = link.clamped(inner).any(dim=1)
    if combination.fallback is not None:
        fallback = fallback | combination.fallback
    moments = {}
    if rule.averages and samples.independent and n > 1:
        slope, off = link.slope(inner), combination.per_sample(samples) - inner[:, None]
        moments = {k: total * slope**k for k, total in enumerate(power_sums(off), start=2)}
    stages["draw"] += drawn - start
    stages["combine"] += time.perf_counter() - drawn
    counts = {"samples": samples.x.shape[0] * n, "queries": samples.seen.queries, **samples.seen.work}
    return {"value": value, "inner": inner, "moments": moments, "fallback": fallback, "counts": counts}


def run(
    problem: Problem,
    sampler: Sampler,
    rule: Rule,
    n: int,
    *,
    replicates: int = 1,
    seed: int = 0,
    split: str = "test",
    first: int = 0,
) -> Estimate:
    """Estimate all integrals of a problem with one sampler and one rule.

    Parameters
    ----------
    problem : Problem
        B integrals over [0,1]^D.
    sampler, rule : Sampler, Rule
        Any of the registry, or your own.
    n : int
        Samples per integral, >= 1.
    replicates : int
        Independent repetitions that are averaged (behind the link); from 8 on they give a standard error.
    seed : int
        The same seed gives the same answer, bit for bit, whatever part of a batch is asked for.
    split : {"test", "train", "validation"}
        Which random numbers; public calls use "test".
    first : int
        Number of the first replicate, so that a later call goes on where an earlier one with the same seed stopped.

    Returns
    -------
    Estimate
        Value, standard error, counts, time by stage.

    Raises
    ------
    ValueError
        If n or replicates is below 1, or sampler, rule and problem do not fit.
    """
    import torch

    n = check.integer("n", n, low=1)
    replicates = check.integer("replicates", replicates, low=1)
    seed = check.integer("seed", seed)
    stages = {"draw": 0.0, "combine": 0.0}
    shape = (problem.batch, problem.channels)
    statistics = Statistics(np.zeros(shape), np.zeros(shape), 0, "replicates")
    inner = np.zeros(shape)
    fallback = np.zeros(problem.batch, dtype=bool)
    counts: dict[str, int] = {"samples": 0, "queries": 0}
    memory.keep_blocks()
    start = time.perf_counter()
    with memory.PeakMemory() as peak, torch.no_grad():
        for replicate in range(first, first + replicates):
            stream = Stream(seed, split, f"samples/{replicate}")
            value = np.empty(shape)
            moments: dict[str, Any] = {}
            for tile in tiles(problem.batch, n):
                part = _tile(problem.take(tile), sampler, rule, n, stream, stages)
                value[tile] = part["value"].cpu().numpy()
                inner[tile] += part["inner"].cpu().numpy() / replicates
                fallback[tile] |= part["fallback"].cpu().numpy()
                counts = {key: counts.get(key, 0) + amount for key, amount in part["counts"].items()}
                for k, power in part["moments"].items():
                    moments.setdefault(f"m{k}", np.zeros(shape))[tile] = power.cpu().numpy()
            if moments:
                latest = Statistics(mean=value, count=n, kind="samples", **moments)
            else:
                latest = Statistics(value, np.zeros(shape), 1, "replicates")
            statistics = statistics.merge(latest) if statistics.count else latest
    return Estimate(
        value=statistics.mean,
        stderr=statistics.stderr,
        n=n,
        inner=inner,
        counts=counts,
        seconds=time.perf_counter() - start,
        stages=stages,
        peak_memory=peak.peak,
        effects=problem.effects,
        fallback=fallback,
        plan={
            "problem": problem.name,
            "sampler": sampler.name,
            "rule": rule.name,
            "n": n,
            "replicates": replicates,
            "seeds": (seed,),
        },
        statistics=statistics,
    )
