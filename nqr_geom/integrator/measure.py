"""One method at one budget, measured: errors with intervals, wall time by stage, queries and memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.integrator import memory
from nqr_geom.integrator.bootstrap import Bootstrap, Interval
from nqr_geom.integrator.estimate import Estimate

__all__ = ["Measured", "Point", "measure", "measure_peer", "point_of"]

_PEER_CALLS = 3
_SLOW_PEER = 1.0  # seconds: a call that takes longer is not repeated, start-up no longer tells

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """One method at one number of samples, measured.

    Attributes
    ----------
    method, sampler, rule : str
        The name that was asked for and what it stands for; a peer has no sampler and no rule.
    kind : {"sampled", "exact"}
        "exact" for peers, which have no number of samples and are drawn apart.
    n : int or None
        Samples per integral.
    queries : float or None
        Evaluations of the integrand per integral.
    seconds : float
        Wall time per integral: the median over the runs after a first one.
    peak_memory : int or None
        Bytes that the whole batch needed at most.
    mse, mse_interval : float, (low, high)
        Mean squared error with its 95% bootstrap interval.
    median, p99 : float
        Quantiles of the squared error over integrals and runs.
    squared_bias, squared_bias_interval : float, (low, high), or None for peers
        Unbiased estimate, which may be negative.
    ratio, ratio_interval : float, (low, high), or None
        MSE of plain Monte Carlo with the same n over this one's.
    fallback : float
        Share of integrals for which the method gave way to a safer one.
    stages : dict
        Seconds per integral by stage, of the run in the middle.
    """

    method: str
    sampler: str
    rule: str
    kind: str
    n: int | None
    queries: float | None
    seconds: float
    peak_memory: int | None
    mse: float
    mse_interval: Interval
    median: float
    p99: float
    squared_bias: float | None = None
    squared_bias_interval: Interval | None = None
    ratio: float | None = None
    ratio_interval: Interval | None = None
    fallback: float = 0.0
    stages: dict[str, float] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> Point:
        """The point that `dataclasses.asdict` made a dictionary of, also after a way through JSON."""
        found: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in fields.items()}
        return cls(**found)


@dataclass(frozen=True)
class Measured:
    """Raw results of all runs of a method at one budget.

    Attributes
    ----------
    deviations : ndarray, (B, R, C)
        Estimate minus truth.
    seconds, queries : float
        Per integral.
    peak_memory : int or None
        Bytes of the batch.
    fallback : float
        Share of integrals.
    stages : dict
        Seconds per integral.
    """

    deviations: Floats
    seconds: float
    queries: float
    peak_memory: int | None
    fallback: float
    stages: dict[str, float] = field(default_factory=dict)

    @property
    def errors(self) -> Floats:
        """Squared errors, mean over channels, (B, R)."""
        return (self.deviations**2).mean(axis=2)


def measure(name: str, answer: Callable[[int], Estimate], truth: Floats, seeds: Sequence[int]) -> Measured:
    """Run a method once a seed; the first run warms up and is not timed.

    Parameters
    ----------
    name : str
        For messages.
    answer : callable
        ``answer(seed)`` gives the Estimate of all B integrals.
    truth : ndarray, (B, C)
        What it should be.
    seeds : sequence of int
        At least two.

    Raises
    ------
    FloatingPointError
        If an estimate is not finite.
    """
    batch = len(truth)
    memory.release()
    estimates = [answer(seed) for seed in seeds]
    deviations = np.stack([estimate.value - truth for estimate in estimates], axis=1)
    if not np.isfinite(deviations).all():
        row = int(np.argwhere(~np.isfinite(deviations))[0, 0])
        raise FloatingPointError(f"{name} gave a non-finite estimate for integral {row}")
    peaks = [estimate.peak_memory for estimate in estimates if estimate.peak_memory is not None]
    timed = sorted(estimates[1:], key=lambda estimate: estimate.seconds)
    middle = timed[(len(timed) - 1) // 2]
    return Measured(
        deviations,
        seconds=float(np.median([estimate.seconds for estimate in timed])) / batch,
        queries=estimates[0].counts["queries"] / batch,
        peak_memory=max(peaks, default=None),
        fallback=float(np.mean([estimate.fallback for estimate in estimates])),
        stages={stage: seconds / batch for stage, seconds in middle.stages.items()},
    )


def point_of(
    name: str, pair: tuple[str, str], n: int, got: Measured, base: Measured | None, resample: Bootstrap
) -> Point:
    """The figures of a measured method, beside plain Monte Carlo's where that is given."""
    bias, bias_interval = resample.squared_bias(got.deviations)
    mse = float(got.errors.mean())
    ratio = float(base.errors.mean()) / mse if base is not None and mse > 0.0 else None
    return Point(
        method=name,
        sampler=pair[0],
        rule=pair[1],
        kind="sampled",
        n=n,
        queries=got.queries,
        seconds=got.seconds,
        peak_memory=got.peak_memory,
        squared_bias=bias,
        squared_bias_interval=bias_interval,
        ratio=ratio,
        ratio_interval=resample.ratio(base.errors, got.errors) if base is not None else None,
        fallback=got.fallback,
        stages=got.stages,
        **_error_fields(got.errors, resample),
    )


def measure_peer(name: str, solve: Callable[[], Floats], truth: Floats, resample: Bootstrap) -> Point:
    """The figures of a solver without randomness; `solve` gives all answers (B, C)."""
    memory.release()
    start = time.perf_counter()
    with memory.PeakMemory() as peak:
        answer = np.asarray(solve())
    spent = [time.perf_counter() - start]
    if spent[0] < _SLOW_PEER:
        spent = []
        for _ in range(_PEER_CALLS):
            start = time.perf_counter()
            solve()
            spent.append(time.perf_counter() - start)
    # A peer has no randomness: over a single shape there is nothing to resample.
    errors = ((answer - truth) ** 2).mean(axis=1, keepdims=True)
    if resample.over == "runs":
        errors = np.repeat(errors, resample.times.shape[1], axis=1)
    return Point(
        method=name,
        sampler="",
        rule="",
        kind="exact",
        n=None,
        queries=None,
        seconds=float(np.median(spent)) / len(truth),
        peak_memory=peak.peak,
        **_error_fields(errors, resample),
    )


def _error_fields(errors: Floats, resample: Bootstrap) -> dict[str, Any]:
    return {
        "mse": float(errors.mean()),
        "mse_interval": resample.mean(errors),
        "median": float(np.median(errors)),
        "p99": float(np.quantile(errors, 0.99)),
    }
