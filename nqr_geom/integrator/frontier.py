"""What accuracy costs: error against samples, wall time and memory, per method, on the user's own machine."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check, registry
from nqr_geom.files import write_whole
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.measure import Measured, Point, measure, measure_peer, point_of
from nqr_geom.integrator.problem import Problem
from nqr_geom.machine import machine, versions

__all__ = ["Frontier", "Point", "fitting", "frontier", "refusal"]

BUDGETS = (4, 8, 16, 32, 64, 128, 256)
_BASELINES = ("random+mc", "random+balance-heuristic")  # plain Monte Carlo; the second where techniques compete

Floats = NDArray[np.float64]
Tick = Callable[[int, int, str], None]


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
            write_whole(path, text + "\n")
        return text

    @classmethod
    def from_json(cls, source: str | os.PathLike[str]) -> Frontier:
        """Read what `to_json` gave, from its text (str that starts with a brace) or from a file."""
        is_text = isinstance(source, str) and source.lstrip().startswith("{")
        fields = json.loads(source if is_text else Path(source).read_text())  # type: ignore[arg-type]
        points: list[dict[str, Any]] = fields.pop("points")
        return cls(points=[Point.from_dict(point) for point in points], **fields)

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


def _measure(problem: Problem, truth: Floats, sampler: str, rule: str, n: int, runs: int, seed: int) -> Measured:
    made = registry.make("sampler", sampler), registry.make("rule", rule)
    return measure(f"{sampler}+{rule}", lambda seed: run(problem, *made, n, seed=seed), truth, range(seed, seed + runs))


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
    measured: dict[tuple[tuple[str, str], int], Measured] = {}

    def results(pair: tuple[str, str], n: int) -> Measured:
        if (pair, n) not in measured:
            measured[pair, n] = _measure(problem, truth, *pair, n, runs, seed)
        return measured[pair, n]

    points = []
    for name, n in plan:
        base = results(registry.method(baseline), n) if baseline is not None else None
        points.append(point_of(name, pairs[name], n, results(pairs[name], n), base, resample))
        if tick is not None:
            tick(len(points), total, f"{name}, n = {n}")
    for name, solve in peers.items():
        points.append(measure_peer(name, solve, truth, resample))
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
