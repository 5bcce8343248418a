"""The ways in which boundary value problems on polygons can be answered, for `tol=` and `budget=`."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate
    from nqr_geom.integrator.models import Model
    from nqr_geom.integrator.plan import Goal, Way
    from nqr_geom.wos.domain import Boundary

__all__ = ["BY_RULE", "LEARNED", "Solvers", "first_choice", "laplace_ways", "spread_of"]

Rows = NDArray[np.int64]

LEARNED = ("inet", "nqr")
BY_RULE = ("structured", "wos-lhs", "wos-rqmc", *LEARNED)  # a sampler and a rule over `n` walks of few steps


@dataclass(frozen=True)
class Solvers:
    """What `solve_laplace` can do with a question that has been read.

    Parameters
    ----------
    walks : callable
        ``walks(rows, n, k)`` are n independent walks of repetition k from each of some queries, to the shell.
    rule : callable
        ``rule(method, rows, n, k)`` is a sampler and a rule over walks of few steps.
    boundary, fem : callable
        The deterministic solvers, aimed at a tolerance, with their own bounds.
    plain : bool
        Whether the equation is Laplace's, without source and screening.
    """

    walks: Callable[[Rows, int, int], Estimate]
    rule: Callable[[str, Rows, int, int], Estimate]
    boundary: Callable[[float], Estimate]
    fem: Callable[[float], Estimate]
    plain: bool


def spread_of(values: Boundary) -> float:
    """Largest less smallest boundary value, as some points of every edge show it; 1 where there is none."""
    edges = len(values.domain)
    probe = values.at(np.repeat(np.arange(edges), 3), np.tile([0.1, 0.5, 0.9], edges))
    return float(np.ptp(probe)) or 1.0


def _methods(plain: bool) -> tuple[str, ...]:
    """What "auto" chooses from; networks are left to those who name them."""
    if not plain:
        return ("fem", "wos")
    learn = ("structured", "wos-lhs", "wos-rqmc") if importlib.util.find_spec("torch") is not None else ()
    return ("boundary", "fem", "wos", *learn)


def laplace_ways(solvers: Solvers, methods: Sequence[str] | None = None) -> list[Way]:
    """Every solver that can take the question, or those of `methods`."""
    from nqr_geom.integrator.plan import Way

    sure = {"boundary": solvers.boundary, "fem": solvers.fem}
    ways = []
    for name in _methods(solvers.plain) if methods is None else methods:
        known = _model(name, solvers.plain)
        if name in sure:
            ways.append(Way(name, known, solve=sure[name]))
        elif name in BY_RULE:
            ways.append(Way(name, known, draw=_by_rule(solvers, name), least=8))
        else:
            ways.append(Way(name, known, draw=solvers.walks, least=32, independent=True))
    return ways


def _model(name: str, plain: bool) -> Model:
    from nqr_geom.integrator.models import model, unknown

    return (None if plain else model("poisson", name)) or model("laplace", name) or unknown()


def _by_rule(solvers: Solvers, name: str) -> Callable[[Rows, int, int], Estimate]:
    return lambda rows, n, k: solvers.rule(name, rows, n, k)


def _unasked(*_: Any) -> Estimate:
    raise ValueError("method: expected to be compared, not to be run")


def first_choice(plain: bool, goal: Goal) -> tuple[str, str]:
    """The method that should meet the goal's tolerance first, and the reason in words."""
    from nqr_geom.integrator.plan import cheapest

    forecast_only = Solvers(_unasked, _unasked, _unasked, _unasked, plain)
    first, *others = cheapest(laplace_ways(forecast_only), goal)
    why = f"{first.way.method} should take {first.seconds:.2g} s"
    compared = ", ".join(f"{f.way.method} {f.seconds:.2g} s" for f in others if f.n is not None)
    return first.way.method, f"{why}, {compared}" if compared else why
