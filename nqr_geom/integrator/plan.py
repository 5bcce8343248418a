"""Which method, and how much of it: the cheapest that should be accurate enough, or the best that fits the time.

A door (an application's public function) names the ways in which it could answer. This file forecasts seconds and
error of each from measured models, and chooses; `pursue.py` runs what was chosen and checks it while it goes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.integrator.estimate import Estimate
from nqr_geom.integrator.models import Model
from nqr_geom.speed import speed

__all__ = ["Clock", "Forecast", "Goal", "Way", "cheapest", "forecast", "most_accurate", "sizes_of"]

Rows = NDArray[np.int64]

_SHARE = 0.7  # of the time that is left is handed out: what is predicted may be a third off
_CHECKED = 2.0  # what finding out how far samples are off makes of their price: a first level, and one more than enough
_AGAIN = 1.4  # and asking again for the few that are not within the tolerance yet
PLENTY = 0.1  # of a tolerance: where the forecast is below, none should have to be asked again
_ALIKE = 1e-9  # errors below it, in units of the scale, are as good as each other


@dataclass(frozen=True)
class Way:
    """One way to answer all integrals of a question.

    Parameters
    ----------
    method : str
        What a user calls it.
    model : Model
        What it costs and how far it is off.
    draw : callable, optional
        ``draw(rows, n, k)`` is repetition k with n samples each of the integrals `rows`, as an Estimate.
    solve : callable, optional
        Instead of `draw`: ``solve(tol)`` is the answer to all integrals by a method without samples, aimed at `tol`,
        with its own bounds in `Estimate.error`. Its model counts 1 / tol (in units of the scale) as samples.
    least : int
        Fewest samples that it takes.
    independent : bool
        Whether its samples are independent and averaged, so that one repetition tells its own error.
    """

    method: str
    model: Model
    draw: Callable[[Rows, int, int], Estimate] | None = None
    solve: Callable[[float], Estimate] | None = None
    least: int = 1
    independent: bool = False

    @property
    def sampled(self) -> bool:
        """Whether it takes samples."""
        return self.draw is not None


@dataclass(frozen=True)
class Goal:
    """What is asked for.

    Parameters
    ----------
    rows : int
        Number of integrals.
    tol : float or None
        Largest absolute error.
    budget : float or None
        Seconds.
    scale : float
        Unit of errors: size of a domain, spread of boundary values.
    size : float
        Pieces or edges of what is integrated over.
    """

    rows: int
    tol: float | None = None
    budget: float | None = None
    scale: float = 1.0
    size: float = 1.0

    @classmethod
    def checked(cls, rows: int, tol: Any, budget: Any, **unit: float) -> Goal:
        """The goal, refused by name where `tol` or `budget` is not a positive number."""
        tol = None if tol is None else check.number("tol", tol, low=0.0, open_low=True)
        budget = None if budget is None else check.number("budget", budget, low=0.0, open_low=True)
        return cls(rows, tol, budget, **unit)


@dataclass
class Clock:
    """Time since a question was asked, less what does not count: imports, compilation, first calls."""

    budget: float | None = None
    started: float = field(default_factory=time.perf_counter)
    paused: float = 0.0

    @classmethod
    def start(cls) -> Clock:
        """A clock that runs from now on, with this machine's speed measured before."""
        speed()
        return cls()

    @property
    def spent(self) -> float:
        """Seconds that count."""
        return time.perf_counter() - self.started - self.paused

    @property
    def left(self) -> float:
        """Seconds until the budget is used up; infinite without one."""
        return math.inf if self.budget is None else self.budget - self.spent

    @property
    def share(self) -> float:
        """What of the time that is left may be planned with."""
        return _SHARE * self.left

    def warm(self, first: Callable[[], object]) -> None:
        """A first call whose time does not count."""
        start = time.perf_counter()
        first()
        self.paused += time.perf_counter() - start


@dataclass(frozen=True)
class Forecast:
    """What a way should cost and reach with n samples.

    Attributes
    ----------
    method : str
    n : int or None
        Samples an integral; None where no number of them is enough.
    seconds, error : float
        Predicted wall time, and 95% quantile of the error.
    """

    way: Way = field(repr=False)
    n: int | None
    seconds: float
    error: float

    @property
    def told(self) -> dict[str, Any]:
        """For the plan of an Estimate."""
        return {"method": self.way.method, "n": self.n, "seconds": self.seconds, "error": self.error}


def sizes_of(way: Way, n: int) -> tuple[int, ...]:
    """Samples of the repetitions that make a level of n: half as many before, where a run does not tell its own error.

    The last one is the answer, and how far it is from the one before tells how far it may be off.
    """
    return (n,) if way.independent else (max(way.least, (n + 1) // 2), n)


def seconds_of(way: Way, goal: Goal, n: float, rows: int | None = None) -> float:
    """Predicted wall time of a level of n samples, all of its repetitions."""
    sizes = sizes_of(way, math.ceil(n)) if way.sampled else (n,)
    return sum(way.model.cost.seconds(goal.rows if rows is None else rows, size, goal.size) for size in sizes)


def per_piece(way: Way, goal: Goal) -> float:
    """Samples here over samples on the model's family: long curves take more for the same error."""
    return max(goal.size / way.model.size, 1e-3) if way.model.size else 1.0


def forecast(way: Way, goal: Goal) -> Forecast:
    """What it takes to be within the goal's tolerance."""
    if goal.tol is None:
        raise ValueError("tol: expected a number, got None")
    wanted = goal.tol / goal.scale
    found = way.model.checked.size_for(wanted)
    if found is None:
        last = way.model.law.sizes[-1]
        return Forecast(way, None, math.inf, way.model.law.high_at(last) * goal.scale)
    n = max(way.least, math.ceil(found * per_piece(way, goal))) if way.sampled else found
    return Forecast(way, n, seconds_of(way, goal, n), way.model.law.high_at(n / per_piece(way, goal)) * goal.scale)


def most_within(way: Way, goal: Goal, seconds: float, pace: float = 1.0, rows: int | None = None) -> int | None:
    """Most samples of a level that `seconds` are enough for, None if not even the fewest are.

    Parameters
    ----------
    pace : float
        Measured over predicted time, as far as is known.
    """

    def fits(n: float) -> bool:
        return pace * seconds_of(way, goal, n, rows) <= seconds

    if not fits(way.least):
        return None
    low = way.least
    while 2 * low <= 2**20 and fits(2 * low):
        low *= 2
    high = 2 * low
    while high - low > max(1, low // 16):
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _within(way: Way, goal: Goal, seconds: float) -> Forecast:
    """The most accurate that a way can be in so many seconds."""
    n = most_within(way, goal, seconds)
    if n is None:
        return Forecast(way, None, seconds_of(way, goal, way.least), math.inf)
    reached = way.model.law.high_at(n / per_piece(way, goal)) * goal.scale
    return Forecast(way, n, seconds_of(way, goal, n), reached)


def _price(forecast: Forecast, goal: Goal) -> float:
    """Seconds that a forecast comes to with all that goes with it."""
    if not forecast.way.sampled:
        return forecast.seconds
    again = 1.0 if goal.tol is None or forecast.error < PLENTY * goal.tol else _AGAIN
    return forecast.seconds * _CHECKED * again


def cheapest(ways: Sequence[Way], goal: Goal) -> list[Forecast]:
    """Forecasts for the tolerance, the cheapest first; those that cannot reach it last."""
    found = [forecast(way, goal) for way in ways]
    return sorted(found, key=lambda f: (_price(f, goal), f.error))


def most_accurate(ways: Sequence[Way], goal: Goal, seconds: float) -> list[Forecast]:
    """Forecasts for a time, the most accurate first; those that do not fit last."""
    found = [_within(way, goal, _SHARE * seconds) for way in ways]
    return sorted(found, key=lambda f: (max(f.error, _ALIKE * goal.scale), f.seconds))
