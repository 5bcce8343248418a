"""The ways in which transmittances and direct light can be answered, for `tol=` and `budget=`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nqr_geom import registry
from nqr_geom.integrator.plan import Way
from nqr_geom.integrator.ways import drawing, sampled_way

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate
    from nqr_geom.render.direct_problem import DirectProblem
    from nqr_geom.render.problems import TransmittanceProblem

__all__ = ["brightness", "direct_ways", "transmittance_ways"]

Rows = NDArray[np.int64]

_TRANSMITTANCE = ("structured", "stratified", "trapezoid", "random")
_DIRECT = ("structured", "mis", "random")
_LEAST = {"structured": 6, "jackknife": 2}


def transmittance_ways(
    problem_on: Callable[[str], TransmittanceProblem], methods: Sequence[str] | None, *, seed: int
) -> list[Way]:
    """Ray marching and the structured method, or those of `methods`.

    Parameters
    ----------
    problem_on : callable
        The rays on the support "bounds" or "pieces".
    methods : sequence of str, optional
        Only these.
    seed : int
        Of the random numbers.
    """
    from nqr_geom.integrator.models import unknown
    from nqr_geom.render.estimators import TRACKERS

    ways = []
    for method in _TRANSMITTANCE if methods is None else methods:
        if method in TRACKERS:
            ways.append(Way(method, unknown(), draw=_tracking(problem_on("bounds"), method, seed)))
        else:
            way = sampled_way(problem_on("bounds"), method, seed=seed, least=_LEAST.get(method, 2))
            ways.append(replace(way, draw=_on_pieces(problem_on, seed)) if method == "structured" else way)
    return ways


def _on_pieces(problem_on: Callable[[str], TransmittanceProblem], seed: int) -> Callable[[Rows, int, int], Estimate]:
    """The structured method, whose pieces of rays are looked for when it is first asked."""

    @cache
    def asked() -> Callable[[Rows, int, int], Estimate]:
        sampler, rule = registry.method("structured", "transmittance")
        return drawing(problem_on("pieces"), registry.make("sampler", sampler), registry.make("rule", rule), seed)

    return lambda rows, n, k: asked()(rows, n, k)


def _tracking(problem: TransmittanceProblem, method: str, seed: int) -> Callable[[Rows, int, int], Estimate]:
    """Repetitions of an estimator that is no rule; each has a seed of its own."""
    import torch

    from nqr_geom.render.estimators import tracked

    def draw(rows: Rows, n: int, k: int) -> Estimate:
        part = problem if len(rows) == problem.batch else problem.take(torch.from_numpy(rows))
        return tracked(part, method, n, seed + k * 2**32)

    return draw


def direct_ways(problem: DirectProblem, methods: Sequence[str] | None, *, seed: int) -> list[Way]:
    """Sampling under the balance heuristic and the structured method, or those of `methods`."""
    names = _DIRECT if methods is None else methods
    return [sampled_way(problem, method, seed=seed, least=2) for method in names]


def brightness(problem: DirectProblem, seed: int) -> float:
    """Mean radiance over pixels and channels from two passes: the unit of errors."""
    from nqr_geom.integrator.estimate import run
    from nqr_geom.integrator.rules import BalanceHeuristic
    from nqr_geom.integrator.samplers import Pmj

    if not problem.batch:
        return 1.0
    return float(run(problem, Pmj(), BalanceHeuristic(), 2, seed=seed, split="validation").value.mean()) or 1.0
