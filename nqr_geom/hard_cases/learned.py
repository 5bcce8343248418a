"""Trained models on inputs they were not made for: finite, and never much worse than the rule that they give way to.

The error of a case is the model's mean squared error over its consistent rule's, on the same samples of all inputs of a
kind (`hostile`): never more than twice as large. What the consistent rule gets right to rounding the model must, too.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from nqr_geom import registry
from nqr_geom.hard_cases.case import Case
from nqr_geom.hard_cases.hostile import KINDS, Hostile, hostile
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler
from nqr_geom.recipes import JOINT, RECIPES, rule_of

__all__ = ["Held", "cases", "fallback_rates", "held", "inputs", "models"]

_ROUNDING = 1e-7  # an error that counts as none: networks answer in single precision


class Held(NamedTuple):
    """A model on one hostile input.

    Attributes
    ----------
    mse, consistent : float
        Mean squared errors of the model and of its consistent rule; NaN where an answer is not finite.
    flagged : float
        Share of integrals that the Estimate flags.
    """

    mse: float
    consistent: float
    flagged: float


def models() -> list[str]:
    """Names of the models that have a list of hostile inputs.

    Examples
    --------
    >>> "gwn-uniform" in models()
    True
    """
    shipped = (entry.name for entry in registry.entries("model"))
    return [name for name in shipped if (name in RECIPES or name in JOINT) and hostile(rule_of(name).problem)]


def _sampler(name: str, one: Hostile) -> Sampler:
    placed: Sampler = registry.make("sampler", f"snet-{name}") if name in JOINT else one.design
    return placed


def held(name: str, one: Hostile) -> Held:
    """A model and its consistent rule on one hostile input.

    Parameters
    ----------
    name : str
        One of `models()`.
    one : Hostile
        Of the list of its problem.
    """
    problem, sampler = one.make(), _sampler(name, one)
    answer = one.answer(problem)
    model: Rule = registry.make("rule", f"inet-{name}")
    safe: Rule = registry.make("rule", rule_of(name).consistent)
    mine, theirs = run(problem, sampler, model, one.n, seed=1), run(problem, sampler, safe, one.n, seed=1)
    errors = [float((((estimate.value - answer) / one.unit) ** 2).mean()) for estimate in (mine, theirs)]
    return Held(errors[0], errors[1], float(mine.fallback.mean()))


def fallback_rates(integrals: int = 500) -> dict[str, dict[str, float]]:
    """How often each model gives way: on held-out integrals of its own family, and on the hostile list.

    Parameters
    ----------
    integrals : int
        Of the family's test split.

    Returns
    -------
    dict
        Model to {"family": share, "hostile": share}.
    """
    rates = {}
    for name in models():
        recipe = rule_of(name)
        problem = recipe.family(torch.arange(integrals), 2, "test").problem
        sampler = registry.make("sampler", f"snet-{name}" if name in JOINT else recipe.designs[0])
        family = run(problem, sampler, registry.make("rule", f"inet-{name}"), recipe.sizes[0][0], seed=2)
        flagged = [held(name, one).flagged for one in hostile(recipe.problem)]
        rates[name] = {"family": float(family.fallback.mean()), "hostile": float(np.mean(flagged))}
    return rates


def inputs(name: str, kind: str) -> list[Hostile]:
    """What a model is held to; one that places its samples itself does not meet those of others."""
    own = name in JOINT
    given = hostile(rule_of(name).problem)
    return [one for one in given if one.kind == kind and not (own and one.design is not Hostile.design)]


def _ratio(name: str, kind: str) -> float:
    """Mean squared error of a kind over the consistent rule's."""
    mine, theirs, _ = np.mean([held(name, one) for one in inputs(name, kind)], axis=0)
    return float((mine + _ROUNDING**2) / (theirs + _ROUNDING**2))


def _naive_constant() -> float:
    """What a network that always answers makes of constants, over a rule that is exact on them."""
    problem = next(one for one in hostile("toy") if one.kind == "constant").make()
    rule: Rule = registry.make("rule", "inet-toy-structured").learned
    got = run(problem, Hostile.design, rule, 32, seed=1).value
    return float((((got - 2.5) ** 2).mean() + _ROUNDING**2) / _ROUNDING**2)


def cases() -> list[Case]:
    """Every model on every kind of hostile inputs of its problem."""
    made = []
    for name in models():
        for kind in KINDS:
            if inputs(name, kind):
                naive = _naive_constant if (name, kind) == ("toy-structured", "constant") else None
                words = f"{rule_of(name).problem}: {kind} [{name}]"
                made.append(Case("learned", words, partial(_ratio, name, kind), 2.0, naive))
    return made
