"""Who takes part: methods of an application under one call, `answer(n, seed)`, and solvers that need no samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import registry
from nqr_geom.integrator.estimate import Estimate, run
from nqr_geom.integrator.frontier import refusal
from nqr_geom.integrator.problem import Problem

__all__ = ["KINDS", "Contender", "Solver", "contenders_for", "trackers_for"]

Floats = NDArray[np.float64]

# What a method is -> what the page calls a group of them; the order of legends and tables.
KINDS = {
    "classical": "classical rules",
    "tracking": "tracking",
    "library": "SciPy",
    "structured": "structure-aware",
    "student": "student network",
    "learned": "networks",
    "exact": "no samples",
}

# Beside the short names of `registry.ALIASES`: what they leave out and a numerical analyst asks for.
_ALSO = ("sobol+mc", "uniform-jitter+trapezoid", "stratified+regression-3")
_TRIED = 32  # samples with which a pair is tried on one integral


@dataclass(frozen=True)
class Contender:
    """A method that spends samples.

    Attributes
    ----------
    name : str
        What the page calls it.
    kind : str
        One of `KINDS`.
    pair : tuple of str
        Sampler and rule, empty where it is neither.
    answer : callable
        ``answer(n, seed)`` gives the Estimate of all integrals.
    refused : callable
        ``refused(n)`` says why it cannot be, or None.
    """

    name: str
    kind: str
    pair: tuple[str, str]
    answer: Callable[[int, int], Estimate]
    refused: Callable[[int], str | None] = lambda _: None


@dataclass(frozen=True)
class Solver:
    """A method without samples: exact, finite elements, a boundary integral, another library.

    Attributes
    ----------
    name, setting : str
        What the page calls it, and at what setting: points of one name are joined by a line.
    solve : callable
        Gives all answers (B, C).
    """

    name: str
    setting: str
    solve: Callable[[], Floats]


def kind_of(problem: str, pair: tuple[str, str]) -> str:
    """Which of `KINDS` a sampler and a rule are together.

    Examples
    --------
    >>> kind_of("gwn", ("stratified", "inet-gwn-student")), kind_of("gwn", ("stratified", "gwn-hermite"))
    ('student', 'structured')
    """
    sampler, rule = pair
    if rule.startswith("inet-"):
        return "student" if "student" in rule else "learned"
    if sampler.startswith("snet-"):
        return "learned"
    structured = registry.ALIASES.get(f"{problem}:structured", "+").partition("+")[2]
    return "structured" if rule == structured else "classical"


def _design(model: str) -> str:
    """The best spread samples that a network was trained on."""
    from nqr_geom.recipes import rule_of

    return next(name for name in rule_of(model).designs if name != "random")


def _names(problem: str, dim: int, everything: bool) -> dict[str, tuple[str, str]]:
    """Name -> pair of all that may be tried; of two names for one pair the application's own stays.

    Polynomials in several dimensions have more terms than any budget here has samples.
    """
    owned = [alias.partition(":")[2] for alias in registry.ALIASES if alias.startswith(f"{problem}:")]
    common = [alias for alias in registry.ALIASES if ":" not in alias]
    trained = [
        f"{_design(entry.options['name'])}+{entry.name}"
        for entry in registry.entries("rule")
        if entry.name.startswith("inet-") and entry.needs == problem and not entry.name.endswith("-nqr")
    ]
    names = [*owned, *common, *_ALSO, *trained]
    if everything:
        rules = [entry.name for entry in registry.entries("rule") if not entry.name.startswith("inet-")]
        designs = [e.name for e in registry.entries("sampler") if not e.adaptive and e.name != "bayesian-quadrature"]
        names += [f"stratified+{rule}" for rule in rules] + [f"{design}+mc" for design in designs]
        names += [f"{design}+trapezoid" for design in designs]
    pairs: dict[tuple[str, str], str] = {}
    for name in names:
        pair = registry.method(name, problem)
        if dim == 1 or not pair[1].startswith("regression-"):
            pairs.setdefault(pair, name)
    return {name: pair for pair, name in pairs.items()}


def contenders_for(problem: Problem, *, everything: bool = False) -> list[Contender]:
    """Every method of the registry that fits a problem on this machine.

    Parameters
    ----------
    problem : Problem
        What it has to answer.
    everything : bool
        Not only what has a short name, but every fixed design and every rule on stratified samples.
    """
    found = []
    for name, pair in _names(problem.name, problem.dim, everything).items():
        try:
            if refusal(problem, *pair, _TRIED) is not None:
                continue
            made = registry.make("sampler", pair[0]), registry.make("rule", pair[1])
        except ImportError:  # an extra that is not installed
            continue

        def answer(n: int, seed: int, made: tuple[Any, Any] = made) -> Estimate:
            return run(problem, *made, n, seed=seed)

        found.append(Contender(name, kind_of(problem.name, pair), pair, answer, partial(refusal, problem, *pair)))
    order = list(KINDS)
    return sorted(found, key=lambda contender: order.index(contender.kind))


def trackers_for(problem: Problem) -> list[Contender]:
    """The unbiased estimators of transmittance, which are no rules: their number of samples is random."""
    from nqr_geom.render.estimators import TRACKERS, tracked

    def one(method: str) -> Contender:
        def answer(n: int, seed: int) -> Estimate:
            estimate = tracked(problem, method, n, seed)  # type: ignore[arg-type]
            return replace(estimate, stages=estimate.stages or {"all": estimate.seconds})

        return Contender(method, "tracking", ("", ""), answer)

    return [one(method) for method in TRACKERS]
