"""Run a plan: levels of more and more samples for those integrals that are not there yet, checked as it goes."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.integrator.bounds import bound_of_samples, bound_of_values
from nqr_geom.integrator.estimate import Estimate
from nqr_geom.integrator.plan import (
    PLENTY,
    Clock,
    Forecast,
    Goal,
    Way,
    cheapest,
    most_accurate,
    most_within,
    per_piece,
    seconds_of,
    sizes_of,
)
from nqr_geom.integrator.statistics import Statistics

__all__ = ["pursue"]

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

_MOST = {"samples": 2**20, "replicates": 2**16}  # samples an integral before a way is given up
_GROWTH = 16.0  # of one level over the last at most
_FIRST = 0.25  # of the samples that should do it are a first level: it shows what this problem is like,
_WORTH = 0.3  # unless it takes more than this part of their time
_NEARLY = 1.1  # times the time of the samples that should do it is not worth sparing: calls cost something, too
_NEAR = 3  # times the samples of the level before at most, and a level of a design is checked against that one
_PILOT = 0.08  # of a budget goes into finding out how fast this problem is
_LEVELS, _CAREFUL = 8, 6.0  # of them at most, and how much bigger each: costs do not grow in proportion for ever
_STALE = 0.9  # bounds that eight times the samples do not bring below this part of what they were will stay


@dataclass
class _Level:
    """One level, as it goes into the plan."""

    method: str
    n: int
    rows: int
    seconds: float
    open: int


@dataclass
class _Answer:
    """Best answers so far, integral by integral."""

    value: Floats = field(default_factory=lambda: np.empty((0, 1)))
    inner: Floats = field(default_factory=lambda: np.empty((0, 1)))
    error: Floats = field(default_factory=lambda: np.empty(0))
    fallback: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    moments: dict[str, Floats] = field(default_factory=dict)  # of answers that were put together from several
    count: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 1), dtype=np.int64))
    kinds: list[str] = field(default_factory=list)
    n: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    levels: list[_Level] = field(default_factory=list)
    last: Estimate | None = None
    pace: dict[str, float] = field(default_factory=dict)

    def put(self, rows: Rows, found: Estimate, bound: Floats) -> None:
        """Keep what is better than before; without an answer yet, anything is."""
        if self.last is None:  # the first answer is to everything, and often the only one
            self.value, self.inner, self.error, self.fallback = found.value, found.inner, bound, found.fallback
        else:
            if not self.moments:
                self._own(self.last.statistics)
            keep = (bound <= self.error[rows]) | ~np.isfinite(self.error[rows])
            at = rows[keep]
            self.value[at], self.inner[at], self.error[at] = found.value[keep], found.inner[keep], bound[keep]
            self.fallback[at] = found.fallback[keep]
            for name, kept in self.moments.items():
                array = getattr(found.statistics, name)
                kept[at] = np.nan if array is None else array[keep]
            self.count[at] = _counts(found.statistics, len(rows))[keep]
        self.kinds.append(found.statistics.kind)
        self.n, self.last = max(self.n, found.n), found
        for key, amount in found.counts.items():
            self.counts[key] = self.counts.get(key, 0) + amount

    def _own(self, first: Statistics) -> None:
        """Copies of the first answer, to be changed where others are better."""
        self.value, self.inner, self.error = (array.copy() for array in (self.value, self.inner, self.error))
        self.fallback = self.fallback.copy()
        for name in ("m2", "m3", "m4"):
            array = getattr(first, name)
            self.moments[name] = np.full_like(self.value, np.nan) if array is None else array.copy()
        self.count = _counts(first, len(self.value)).copy()

    def statistics(self) -> Statistics:
        """Of every integral's own terms; without spread where integrals were answered in different manners."""
        if self.last is not None and not self.moments:
            return self.last.statistics
        kinds = set(self.kinds)
        plain = len(kinds) == 1 and not any(np.isnan(m).any() for m in self.moments.values() if m.size)
        if plain:
            count: Any = self.count if self.count.size and np.ptp(self.count) else int(self.count.max(initial=1))
            return Statistics(self.value, count=count, kind=kinds.pop(), **self.moments)
        m2 = np.nan_to_num(self.moments.get("m2", np.zeros_like(self.value)))
        return Statistics(self.value, m2, 1, "replicates")


def _counts(statistics: Statistics, rows: int) -> NDArray[np.int64]:
    """Terms of each of so many integrals, (rows, 1)."""
    return np.broadcast_to(np.reshape(statistics.count, (-1, 1)), (rows, 1))


def _joined(parts: Sequence[Estimate]) -> Estimate:
    """The last of some runs of the same integrals, with the work that all of them were."""
    counts = {key: sum(part.counts[key] for part in parts) for key in parts[0].counts}
    return replace(parts[-1], counts=counts, fallback=np.any([part.fallback for part in parts], axis=0))


class _Sampling:
    """Levels of one sampled way."""

    def __init__(self, way: Way, goal: Goal, answer: _Answer, clock: Clock) -> None:
        self.way, self.goal, self.answer, self.clock = way, goal, answer, clock
        self.repetition = 0  # number of the next one
        self.sizes: list[int] = []
        self.kind = ""
        self.total: Statistics | None = None  # of independent samples, of the rows of the last level
        self.rows: Rows = np.arange(0)
        self.before: tuple[int, Floats] | None = None  # samples and values of the last level of a design

    @property
    def pace(self) -> float:
        """Measured over predicted seconds."""
        return self.answer.pace.get(self.way.method, 1.0)

    def level(self, rows: Rows, n: int) -> Floats:
        """n more samples (or repetitions of n) for some of the last level's rows; bounds for each."""
        start = time.perf_counter()
        draw = self.way.draw
        if draw is None:
            raise ValueError(f"method: expected one that samples, got {self.way.method!r}")
        known = self.before[0] if self.before is not None else 0
        sizes = (n,) if known < n <= _NEAR * known else sizes_of(self.way, n)
        parts = [draw(rows, size, self.repetition + k) for k, size in enumerate(sizes)]
        self.kind = "samples" if self.way.independent else "replicates"
        self.repetition += len(parts)
        seconds = time.perf_counter() - start
        predicted = sum(self.way.model.cost.seconds(len(rows), size, self.goal.size) for size in sizes)
        self.answer.pace[self.way.method] = seconds / max(predicted, 1e-9)
        found, bound = self._checked(rows, n, parts)
        self.answer.put(rows, found, bound)
        tol = self.goal.tol
        still = int((bound > tol).sum()) if tol is not None else 0
        self.answer.levels.append(_Level(self.way.method, n, len(rows), seconds, still))
        self.sizes.append(n)
        self.rows = rows
        return bound

    def _checked(self, rows: Rows, n: int, parts: list[Estimate]) -> tuple[Estimate, Floats]:
        """What a level gives, with all that was seen before, and how far it may be off."""
        found = _joined(parts)
        per = per_piece(self.way, self.goal)
        of = np.searchsorted(self.rows, rows)
        if self.kind == "samples":
            if self.total is not None:
                total = self.total.take(of).merge(found.statistics)
                found = replace(found, value=total.mean, stderr=total.stderr, statistics=total, n=n + sum(self.sizes))
            self.total = found.statistics
            seen = float(np.mean(found.statistics.count))
            return found, bound_of_samples(found.statistics) * self.way.model.factor_at(seen / per)
        values = [part.value for part in parts]
        if len(parts) == 1 and self.before is not None:
            values = [self.before[1][of], *values]
        bound = bound_of_values(np.stack(values)) * self.way.model.factor_at(n / per)
        if self.before is not None and self.before[0] < n:
            # What repetitions share they cannot see. Errors shrink from level to level by about as much as on the
            # family, so that the last step tells what is left.
            law = self.way.model.law
            shrunk = law.typical_at(n / per) / max(law.typical_at(self.before[0] / per), 1e-300)
            moved = np.abs(found.value - self.before[1][of]).max(axis=1)
            bound = np.maximum(bound, moved * min(max(shrunk, 0.02), 0.5))
        self.before = (n, found.value)
        return found, bound


def _start(sampling: _Sampling, forecast: Forecast) -> int:
    """Samples of a first level: a part of what the worst integrals should take, or all and what comes with them."""
    way, goal = sampling.way, sampling.goal
    if not way.model.known:
        return way.least
    most = _MOST["samples" if way.independent else "replicates"]
    whole = max(way.least, min(forecast.n or way.least, most))
    part, seconds = max(way.least, math.ceil(_FIRST * whole)), seconds_of(way, goal, whole)
    if seconds_of(way, goal, part) < _WORTH * seconds:
        return part
    if goal.tol is not None and forecast.error < PLENTY * goal.tol:
        return whole
    return min(max(whole, most_within(way, goal, _NEARLY * seconds) or whole), most)


def _next(sampling: _Sampling, n: int, open_bounds: Floats, tol: float) -> int:
    """Samples of the next level for integrals with these bounds."""
    ratio = float(np.median(open_bounds)) / tol
    if sampling.kind == "samples":  # added to what is there
        have = sum(sampling.sizes)
        return math.ceil(have * (min(max(1.15 * ratio**2, 1.5), _GROWTH) - 1.0))
    order = sampling.way.model.law.order(n / per_piece(sampling.way, sampling.goal))
    return math.ceil(n * min(max((1.2 * ratio) ** (1.0 / order), 2.0), _GROWTH))


def _reach(sampling: _Sampling, rows: Rows, forecast: Forecast, others: Sequence[Forecast]) -> tuple[Rows, str]:
    """Levels until every integral of `rows` is within the tolerance, or another way is better, or time is up."""
    goal, clock, way = sampling.goal, sampling.clock, sampling.way
    tol = goal.tol or 0.0
    n = _start(sampling, forecast)
    bounds: list[tuple[int, float]] = []  # after so many samples, of those that were open
    while True:
        if clock.budget is not None:
            fits = most_within(way, goal, clock.share, sampling.pace, len(rows))
            if fits is None or (sampling.sizes and fits < n / 4):
                return rows, "the budget is used up"
            n = min(n, fits)
        bound = sampling.level(rows, n)
        is_open = bound > tol
        if not is_open.any():
            return rows[:0], "met"
        left = bound[is_open]
        total = sum(sampling.sizes) if sampling.kind == "samples" else n
        middle = float(np.median(left))
        if any(8 * size <= total and middle > _STALE * before for size, before in bounds) and is_open.all():
            return rows[is_open], "more samples no longer help"
        rows = rows[is_open]
        bounds.append((total, middle))
        if total >= _MOST[sampling.kind]:
            return rows, f"{total} samples are not enough"
        n = min(_next(sampling, n, left, tol), _MOST[sampling.kind])
        going_on = sampling.pace * seconds_of(way, goal, n, len(rows))
        for other in others if len(sampling.sizes) > 1 else ():
            share = len(rows) if other.way.sampled else goal.rows
            # A machine that is slower than was thought is so for every method.
            there = max(sampling.pace, 1.0) * seconds_of(other.way, goal, other.n or 0, share)
            if other.n is not None and there < 0.5 * going_on:
                return rows, f"going on would take {going_on:.2g} s, {other.way.method} less"


def _spend(sampling: _Sampling, rows: Rows) -> str:
    """A first level to learn the pace, then the most samples that fit, then what is left."""
    goal, clock, way = sampling.goal, sampling.clock, sampling.way
    sampling.level(rows, most_within(way, goal, _PILOT * clock.left) or way.least)
    for _ in range(_LEVELS):
        n = most_within(way, goal, clock.share, sampling.pace)
        enough = 0.25 * sum(sampling.sizes) if way.independent else 1.5 * max(sampling.sizes)
        if n is None or n < max(enough, way.least):
            break
        n = min(n, _MOST[sampling.kind], math.ceil(_CAREFUL * max(sampling.sizes)))
        bound = sampling.level(rows, n)
        if goal.tol is not None and not (bound > goal.tol).any():
            return "the tolerance is met"
        if n == _MOST[sampling.kind]:
            return f"{n} samples are the most that are taken"
    return "the budget is used up"


def _solve(way: Way, tol: float, goal: Goal, answer: _Answer) -> None:
    """A method without samples answers everything at once."""
    if way.solve is None:
        raise ValueError(f"method: expected one without samples, got {way.method!r}")
    start = time.perf_counter()
    found = way.solve(tol)
    seconds = time.perf_counter() - start
    bound = found.error if found.error is not None else np.full(goal.rows, np.inf)
    answer.put(np.arange(goal.rows), found, bound)
    still = int(np.count_nonzero(bound > goal.tol)) if goal.tol is not None else 0
    answer.levels.append(_Level(way.method, 0, goal.rows, seconds, still))


def pursue(ways: Sequence[Way], goal: Goal, clock: Clock | None = None) -> Estimate:
    """Answer by the cheapest way within the tolerance, or by the most accurate one within the time.

    Parameters
    ----------
    ways : sequence of Way
        At least one. With several, the models decide; what they got wrong is found out on the way.
    goal : Goal
        With a tolerance, a budget, or both: then the cheapest way within the tolerance, as long as the time lasts.
    clock : Clock, optional
        Started when the question was asked; by default now.

    Returns
    -------
    Estimate
        `error` bounds each integral's error, `plan` says what was considered, chosen and measured, and why; "met"
        whether all bounds are within the tolerance (None without one).

    Raises
    ------
    ValueError
        If the goal has neither tolerance nor budget, or not even the fastest way fits into the budget.
    """
    if goal.tol is None and goal.budget is None:
        raise ValueError("tol: expected a tolerance, or a budget, or both, got neither")
    clock = Clock.start() if clock is None else clock
    clock.budget = goal.budget
    answer = _Answer()
    if goal.budget is not None:
        _warm(ways, goal, clock)
    listed, mode, why = _chosen(ways, goal, clock)
    rows, ends = np.arange(goal.rows), []
    if mode == "tol":
        for k, forecast in enumerate(listed):
            way, others = forecast.way, listed[k + 1 :]
            if way.sampled:
                rows, end = _reach(_Sampling(way, goal, answer, clock), rows, forecast, others)
            else:
                _solve(way, goal.tol or 0.0, goal, answer)
                rows = np.flatnonzero(answer.error > (goal.tol or 0.0))
                end = "met" if not len(rows) else "its own estimate of the error is larger"
            ends.append(f"{way.method}: {end}")
            if not len(rows) or clock.left <= 0.0 or end == "the budget is used up":
                break
            if goal.budget is not None and k + 1 < len(listed) and listed[k + 1].seconds > clock.share:
                break
    elif not listed[0].way.sampled:
        _solve(listed[0].way, listed[0].error, goal, answer)
        ends.append(f"{listed[0].way.method}: done")
    else:
        ends.append(f"{listed[0].way.method}: " + _spend(_Sampling(listed[0].way, goal, answer, clock), rows))
    return _told(answer, listed, goal, clock, f"{why}; {'; '.join(ends)}")


def _warm(ways: Sequence[Way], goal: Goal, clock: Clock) -> None:
    """Import and compile what may be chosen, on one integral; it does not count."""
    way = most_accurate(ways, goal, clock.left)[0].way
    draw = way.draw
    if draw is not None and goal.rows:
        clock.warm(lambda: draw(np.arange(1), way.least, 0))  # torch and its kernels are loaded here


def _chosen(ways: Sequence[Way], goal: Goal, clock: Clock) -> tuple[list[Forecast], str, str]:
    """Ways in the order in which they shall be tried, whether for the tolerance or the time, and why."""
    if goal.tol is not None:
        listed = cheapest(ways, goal)
        first = listed[0]
        if goal.budget is None or first.seconds <= clock.left or not first.way.model.known:
            if first.n is None:
                return listed, "tol", f"no method is known to reach {goal.tol:g}; the most accurate first"
            return listed, "tol", f"{first.way.method} should be within {goal.tol:g} at the least cost"
        needed = f"{first.seconds:.2g} s" if first.n is not None else "a method that is not here"
        why = f"the budget is too small: {goal.tol:g} should take {needed}; the most accurate within {goal.budget:g} s"
    else:
        why = f"most accurate within {goal.budget:g} s"
    listed = most_accurate(ways, goal, max(clock.left, 0.0))
    if listed[0].n is None:
        quickest = min(listed, key=lambda f: f.seconds)
        if quickest.seconds > 1.25 * (goal.budget or 0.0):
            raise ValueError(
                f"budget: expected about {quickest.seconds:.2g} s or more for {goal.rows} answers by "
                f"{quickest.way.method!r}, the fastest method here, got {goal.budget:g}"
            )
        listed = [quickest, *(f for f in listed if f is not quickest)]
    return listed, "budget", why


def _told(answer: _Answer, listed: Sequence[Forecast], goal: Goal, clock: Clock, why: str) -> Estimate:
    """The answer with its plan."""
    last = answer.last
    if last is None:
        raise ValueError("budget: nothing was answered")
    chosen = answer.levels[-1].method
    within = None if goal.tol is None else int(np.count_nonzero(answer.error <= goal.tol))
    statistics = answer.statistics()
    stderr = statistics.stderr
    if stderr is None and all(kind == "replicates" for kind in answer.kinds) and answer.levels[-1].n == 0:
        stderr = last.stderr
    plan = {
        **last.plan,
        "n": answer.n,
        "method": chosen,
        "tol": goal.tol,
        "budget": goal.budget,
        "why": why,
        "candidates": [forecast.told for forecast in listed],
        "predicted": {"seconds": listed[0].seconds, "error": listed[0].error},
        "levels": [vars(level) for level in answer.levels],
        "sizes": tuple(level.n for level in answer.levels),
        "error": float(answer.error.max(initial=0.0)),
        "within": None if within is None else within / goal.rows if goal.rows else 1.0,
        "met": None if within is None else within == goal.rows,
        "warmup_seconds": clock.paused,
    }
    spent = clock.spent
    return replace(
        last,
        value=answer.value,
        inner=answer.inner,
        stderr=stderr,
        n=answer.n,
        counts=answer.counts,
        seconds=spent,
        stages={"all": spent},
        fallback=answer.fallback,
        plan=plan,
        statistics=statistics,
        error=answer.error,
    )
