"""What accuracy costs: error against samples, wall time and memory, per method, on the user's own machine."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check, registry
from nqr_geom.integrator import memory
from nqr_geom.integrator.bootstrap import Bootstrap, Interval
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.problem import Problem
from nqr_geom.machine import machine, versions

__all__ = ["Frontier", "Point", "frontier", "refusal"]

BUDGETS = (4, 8, 16, 32, 64, 128, 256)
_BASELINES = ("random+mc", "random+balance-heuristic")  # plain Monte Carlo; the second where techniques compete
_PEER_CALLS = 3

Floats = NDArray[np.float64]
Tick = Callable[[int, int, str], None]


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


@dataclass(frozen=True)
class Frontier:
    """Every point that was measured, and what it was measured on.

    Attributes
    ----------
    problem : str
        Name of the problem.
    batch, groups : int
        Integrals, and shapes or scenes that they belong to.
    runs, seed : int
        Independent runs a point, and the seed of the first; run r has seed + r.
    baseline : str or None
        What `ratio` compares with.
    intervals_over : {"groups", "runs"}
        What the bootstrap resampled.
    points : list of Point
        In the order of methods and budgets.
    refused : dict
        "method, n" -> why it could not run there.
    machine, versions : dict
        Where this was measured, and with what.
    """

    problem: str
    batch: int
    groups: int
    runs: int
    seed: int
    baseline: str | None
    intervals_over: str
    points: list[Point] = field(repr=False)
    refused: dict[str, str] = field(default_factory=dict)
    machine: dict[str, str | int] = field(default_factory=machine, repr=False)
    versions: dict[str, str] = field(default_factory=lambda: versions("numpy", "scipy", "torch"), repr=False)

    @property
    def table(self) -> list[dict[str, Any]]:
        """One dictionary a point."""
        return [asdict(point) for point in self.points]

    def envelope(self) -> list[dict[str, Any]]:
        """Which sampled method is best from which time on: rows of seconds, method, n and mse, fastest first."""
        rows: list[dict[str, Any]] = []
        best = np.inf
        for point in sorted((p for p in self.points if p.kind == "sampled"), key=lambda p: (p.seconds, p.mse)):
            if point.mse < best:
                best = point.mse
                if not rows or rows[-1]["method"] != point.method:
                    rows.append({"seconds": point.seconds, "method": point.method, "n": point.n, "mse": point.mse})
        return rows

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """The whole frontier as JSON text; with a path, the file is written in full or not at all."""
        text = json.dumps(asdict(self), indent=1, allow_nan=False)
        if path is not None:
            target = Path(path)
            aside = target.with_name(f".{target.name}.{os.getpid()}")
            try:
                aside.write_text(text + "\n")
                aside.replace(target)
            finally:
                aside.unlink(missing_ok=True)
        return text

    @classmethod
    def from_json(cls, source: str | os.PathLike[str]) -> Frontier:
        """Read what `to_json` gave, from its text (str that starts with a brace) or from a file."""
        is_text = isinstance(source, str) and source.lstrip().startswith("{")
        fields = json.loads(source if is_text else Path(source).read_text())  # type: ignore[arg-type]
        points: list[dict[str, Any]] = fields.pop("points")
        for point in points:
            point.update({key: tuple(value) for key, value in point.items() if isinstance(value, list)})
        return cls(points=[Point(**point) for point in points], **fields)

    def plot(self, path: str | os.PathLike[str]) -> Path:
        """Draw error against queries and against time; the ending of `path` chooses the format."""
        from nqr_geom.integrator.chart import draw

        return draw(self, Path(path))


def refusal(problem: Problem, sampler: str, rule: str, n: int) -> str | None:
    """Why a sampler and a rule cannot answer a problem with n samples, or None if they can.

    Found out by trying on the first integral, so that nothing has to be declared twice.
    """
    try:
        run(problem.take(slice(0, 1)), registry.make("sampler", sampler), registry.make("rule", rule), n)
    except ValueError as error:
        return str(error)
    return None


def fitting(problem: Problem, n: int) -> list[str]:
    """The aliases that can answer this problem with n samples on this machine."""
    names = []
    for alias in registry.ALIASES:
        owner, colon, name = alias.rpartition(":")
        if colon and owner != problem.name:
            continue
        try:
            if refusal(problem, *registry.method(name, problem.name), n) is None:
                names.append(name)
        except ImportError:  # an extra that is not installed
            continue
    return list(dict.fromkeys(names))


@dataclass(frozen=True)
class _Measured:
    """Raw results of all runs of a method at one n."""

    deviations: Floats  # (B, R, C)
    seconds: float
    queries: float
    peak_memory: int | None
    fallback: float

    @property
    def errors(self) -> Floats:
        """Squared errors, mean over channels, (B, R)."""
        return (self.deviations**2).mean(axis=2)


def _measure(problem: Problem, truth: Floats, sampler: str, rule: str, n: int, runs: int, seed: int) -> _Measured:
    made = registry.make("sampler", sampler), registry.make("rule", rule)
    memory.release()
    estimates = [run(problem, *made, n, seed=seed + r) for r in range(runs)]
    deviations = np.stack([estimate.value - truth for estimate in estimates], axis=1)
    if not np.isfinite(deviations).all():
        row = int(np.argwhere(~np.isfinite(deviations))[0, 0])
        raise FloatingPointError(f"{sampler}+{rule} gave a non-finite estimate for integral {row}")
    peaks = [estimate.peak_memory for estimate in estimates if estimate.peak_memory is not None]
    return _Measured(
        deviations,
        seconds=float(np.median([estimate.seconds for estimate in estimates[1:]])) / problem.batch,
        queries=estimates[0].counts["queries"] / problem.batch,
        peak_memory=max(peaks, default=None),
        fallback=float(np.mean([estimate.fallback for estimate in estimates])),
    )


def _error_fields(errors: Floats, resample: Bootstrap) -> dict[str, Any]:
    return {
        "mse": float(errors.mean()),
        "mse_interval": resample.mean(errors),
        "median": float(np.median(errors)),
        "p99": float(np.quantile(errors, 0.99)),
    }


def _point(name: str, pair: tuple[str, str], n: int, got: _Measured, base: _Measured | None, by: Bootstrap) -> Point:
    bias, bias_interval = by.squared_bias(got.deviations)
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
        ratio_interval=by.ratio(base.errors, got.errors) if base is not None else None,
        fallback=got.fallback,
        **_error_fields(got.errors, by),
    )


def _peer(name: str, solve: Callable[[], Floats], truth: Floats, resample: Bootstrap) -> Point:
    memory.release()
    with memory.PeakMemory() as peak:
        answer = np.asarray(solve())
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


def _truth(problem: Problem) -> Floats:
    truth = problem.reference()
    if truth is None:
        raise ValueError(f"problem: expected one with a reference to measure errors against, {problem.name!r} has none")
    if not np.isfinite(truth).all():
        row = int(np.argwhere(~np.isfinite(truth))[0, 0])
        raise ValueError(f"problem: expected finite reference answers, integral {row} of {problem.name!r} has none")
    return truth


def frontier(
    problem: Problem,
    methods: Sequence[str] | None = None,
    budgets: Sequence[int] | None = None,
    *,
    runs: int = 16,
    seed: int = 0,
    tick: Tick | None = None,
) -> Frontier:
    """Measure what accuracy costs: error against samples, time and memory for each method, on this machine.

    Parameters
    ----------
    problem : Problem
        B integrals that know their reference; `problem.peers()` are timed too.
    methods : sequence of str, optional
        Aliases or "sampler+rule"; by default all aliases that fit the problem.
    budgets : sequence of int, optional
        Numbers of samples per integral, by default 4, 8, ..., 256.
    runs : int
        Independent runs a point, >= 2; the first one warms up and is not timed.
    seed : int
        Seed of the first run; run r has seed + r.
    tick : callable, optional
        Called as ``tick(done, total, label)`` after every point.

    Returns
    -------
    Frontier
        Points, table, envelope, JSON and plot.

    Raises
    ------
    ValueError
        If the problem has no reference, or a method does not fit it at any budget.

    Examples
    --------
    >>> from nqr_geom.toy.problem import ToyProblem
    >>> measured = frontier(ToyProblem(8), ["mc", "trapezoid"], [4, 16], runs=4)
    >>> [(point.method, point.n) for point in measured.points if point.kind == "sampled"]
    [('mc', 4), ('mc', 16), ('trapezoid', 4), ('trapezoid', 16)]
    """
    runs = check.integer("runs", runs, low=2)
    seed = check.integer("seed", seed)
    sizes = sorted(check.integer("budgets", n, low=1) for n in (BUDGETS if budgets is None else budgets))
    if not sizes or len(set(sizes)) < len(sizes):
        raise ValueError(f"budgets: expected one or more different numbers of samples, got {budgets!r}")
    if isinstance(methods, str):
        raise TypeError(f"methods: expected a sequence of names, got the single name {methods!r}")
    names = fitting(problem, max(sizes)) if methods is None else list(methods)
    if not names or len(set(names)) < len(names):
        raise ValueError(f"methods: expected one or more different names, got {methods!r}")
    pairs = {name: registry.method(name, problem.name) for name in names}
    truth = _truth(problem)
    refused = {(name, n): reason for name in names for n in sizes if (reason := refusal(problem, *pairs[name], n))}
    for name in names:
        if all((name, n) in refused for n in sizes):
            raise ValueError(f"methods: {name!r} does not fit: {refused[name, sizes[0]]}")

    resample = Bootstrap.of(problem.groups, runs, seed)
    baseline = next((b for b in _BASELINES if refusal(problem, *registry.method(b), max(sizes)) is None), None)
    peers = problem.peers()
    plan = [(name, n) for name in names for n in sizes if (name, n) not in refused]
    total = len(plan) + len(peers)
    measured: dict[tuple[tuple[str, str], int], _Measured] = {}

    def measure(pair: tuple[str, str], n: int) -> _Measured:
        if (pair, n) not in measured:
            measured[pair, n] = _measure(problem, truth, *pair, n, runs, seed)
        return measured[pair, n]

    points = []
    for name, n in plan:
        base = measure(registry.method(baseline), n) if baseline is not None else None
        points.append(_point(name, pairs[name], n, measure(pairs[name], n), base, resample))
        if tick is not None:
            tick(len(points), total, f"{name}, n = {n}")
    for name, solve in peers.items():
        points.append(_peer(name, solve, truth, resample))
        if tick is not None:
            tick(len(points), total, name)
    return Frontier(
        problem=problem.name,
        batch=problem.batch,
        groups=len(np.unique(problem.groups)),
        runs=runs,
        seed=seed,
        baseline=baseline,
        intervals_over=resample.over,
        points=points,
        refused={f"{name}, n = {n}": reason for (name, n), reason in refused.items()},
    )
