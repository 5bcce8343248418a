"""The ways in which the integrator can answer a problem: every sampler and rule that has a measured model."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from nqr_geom import registry
from nqr_geom.integrator.estimate import Estimate, run
from nqr_geom.integrator.models import model, table, unknown
from nqr_geom.integrator.plan import Way
from nqr_geom.integrator.problem import Problem
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler

__all__ = ["drawing", "measured_methods", "sampled_way", "sampled_ways"]

Rows = NDArray[np.int64]

_FEWEST = 32  # independent samples, before their spread says anything


def measured_methods(problem: str) -> list[str]:
    """Methods that have a model for a problem, as `benchmarks/cost_models.py` measured them.

    Examples
    --------
    >>> "structured" in measured_methods("gwn")
    True
    """
    return [key.partition(":")[2] for key in table()["models"] if key.partition(":")[0] == problem]


def drawing(problem: Problem, sampler: Sampler, rule: Rule, seed: int) -> Callable[[Rows, int, int], Estimate]:
    """What a `Way` draws with: repetition k with n samples each of some rows of a problem."""
    import torch

    def draw(rows: Rows, n: int, k: int) -> Estimate:
        part = problem if len(rows) == problem.batch else problem.take(torch.from_numpy(rows))
        return run(part, sampler, rule, n, seed=seed, first=k)

    return draw


def sampled_way(
    problem: Problem, method: str, *, seed: int, models: str = "", least: int = 1, pair: tuple[str, str] | None = None
) -> Way:
    """A sampler and a rule over a problem.

    Parameters
    ----------
    problem : Problem
        All integrals.
    method : str
        Alias or "sampler+rule".
    seed : int
        Of the random numbers.
    models : str
        Under which name the models of the problem are kept; its own by default.
    least : int
        Fewest samples.
    pair : (sampler, rule), optional
        Names, where they are not those that the registry gives for the method.
    """
    sampler, rule = pair or registry.method(method, problem.name)
    made = registry.make("sampler", sampler), registry.make("rule", rule)
    known = model(models or problem.name, method) or model(models or problem.name, f"{sampler}+{rule}")
    alone = sampler == "random" and made[1].averages
    least = max(least, _FEWEST) if alone else least
    return Way(method, known or unknown(), draw=drawing(problem, *made, seed), least=least, independent=alone)


def sampled_ways(problem: Problem, methods: Sequence[str], *, seed: int, models: str = "", least: int = 1) -> list[Way]:
    """`sampled_way` for each method."""
    return [sampled_way(problem, method, seed=seed, models=models, least=least) for method in methods]
