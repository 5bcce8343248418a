"""Which problem exercises which registry entry, so that loops over the registry reach everything or fail.

An entry says what it needs; `PROBLEMS` answers with problems that bring it. An entry with a need that is not listed
here raises in `problems_for`, and its test is red until someone adds a problem.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import torch

from nqr_geom import registry
from nqr_geom.integrator.problem import Problem, Samples
from nqr_geom.registry import Entry
from nqr_geom.streams import Stream
from nqr_geom.wos.record import ALIVE, VALUE
from tests.integrands import TwoTechniques, smooth

_CONTROL = np.random.default_rng(3).random((6, 3, 2))
_POINTS = np.random.default_rng(4).random((5, 2))


def _curve_problem(kind: str) -> Problem:
    """Six quadratic pieces and five queries."""
    import nqr_geom as ng

    return getattr(ng.problems, kind)(ng.Curve.bezier(_CONTROL), _POINTS)


def _toy() -> Problem:
    import nqr_geom as ng

    return ng.problems.toy(5)


def _laplace(max_steps: int = 4) -> Problem:
    """Five queries in a square, walks of few steps."""
    import nqr_geom as ng

    square = [[-0.2, -0.2], [1.2, -0.2], [1.2, 1.2], [-0.2, 1.2]]
    return ng.problems.laplace(square, [0.0, 1.0, 0.5, -1.0], _POINTS, max_steps=max_steps)


def _p_laplace() -> Problem:
    """The same in twelve steps, where a rule is to see that p = 4."""
    import nqr_geom as ng

    square = [[-0.2, -0.2], [1.2, -0.2], [1.2, 1.2], [-0.2, 1.2]]
    return ng.problems.p_laplace(square, [0.0, 1.0, 0.5, -1.0], _POINTS, p=4.0)


def _transmittance() -> Problem:
    """Five rays through three noisy balls."""
    import nqr_geom as ng
    from nqr_geom import render

    noise = render.Noise(amplitude=0.8, frequency=0.9, seed=1)
    cloud = render.Spheres([[3, 5, 5], [6, 5, 4], [6, 4, 7]], [1.5, 2.0, 1.0], [0] * 3, [10] * 3, noise=noise)
    origins = 3.5 + 2.0 * np.random.default_rng(5).random((5, 3)) - [5.0, 0.0, 0.0]
    return ng.problems.transmittance(cloud, origins, [[1.0, 0.1, 0.05]] * 5, 20.0)


def _direct() -> Problem:
    """Five pixels of a room with shapes, materials and lights of every kind."""
    import nqr_geom as ng
    from tests.scenes import two_spheres

    return ng.problems.direct(two_spheres(8)).take(torch.tensor([18, 33, 43, 44, 52]))


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "line": smooth,
    "square": lambda: smooth(2),
    "two-techniques": TwoTechniques,
    "toy": _toy,
    "gwn": lambda: _curve_problem("gwn"),
    "sd": lambda: _curve_problem("sd"),
    "laplace": _laplace,
    "laplace in 12 steps": lambda: _laplace(12),  # what networks were trained on
    "p-laplace": _p_laplace,
    "transmittance": _transmittance,
    "direct": _direct,
}

# Plain rules work there, too; they are held to their laws in fewer dimensions.
FOR_NETWORKS = ("laplace in 12 steps", "p-laplace")

_ANY = ("line", "square", "toy", "gwn", "sd", "laplace", "transmittance")

# What an entry needs -> the problems that bring it.
BRINGS: dict[str, tuple[str, ...]] = {
    "": _ANY,
    "pdf": _ANY,
    "strata": _ANY,
    "nodes": _ANY,
    "control": ("line", "square"),
    "techniques": ("two-techniques", "direct"),
    "direct": ("direct",),
    "halves": ("transmittance",),
    "transmittance": ("transmittance",),
    "curves": ("gwn", "sd"),
    "toy": ("toy",),
    "gwn": ("gwn",),
    "sd": ("sd",),
    "laplace": ("laplace", "laplace in 12 steps"),
    "p-laplace": ("p-laplace",),
}


# A trained model is also a rule; tests/properties/test_learn.py holds every one of them to laws of its own.
RULES = [
    entry
    for entry in registry.entries("rule")
    if entry.name not in {f"inet-{model.name}" for model in registry.entries("model")}
]


@cache
def problem(name: str) -> Problem:
    """A test problem by name, built once."""
    return PROBLEMS[name]()


def problems_for(entry: Entry) -> list[str]:
    """Names of all test problems that an entry has to work on."""
    if entry.needs not in BRINGS:
        raise AssertionError(f"tests/fixtures.py knows no problem for {entry.name!r}, which needs {entry.needs!r}")
    return [name for name in BRINGS[entry.needs] if entry.dims in ("any", str(problem(name).dim))]


@cache
def draw(problem_name: str, sampler: str, n: int, row: int | None = None) -> Samples:
    """Samples of a test problem, or of one of its integrals alone, ready for a rule; treat them as read-only."""
    at = problem(problem_name)
    if row is not None:
        at = at.take(slice(row, row + 1))
    return at.finalize(registry.make("sampler", sampler).draw(at, n, Stream(0)))[0]


def samplers_for(problem_name: str) -> list[str]:
    """Names of all registered samplers that have to work on a test problem."""
    at, found = problem(problem_name), []
    for entry in registry.entries("sampler"):
        anywhere = not entry.needs and (entry.dims == "any" or at.dim == 1)
        if anywhere or problem_name in problems_for(entry):
            found.append(entry.name)
    return found


def brings(samples: Samples, needs: str) -> bool:
    """Whether samples of a fitting problem bring what a rule declares to need."""
    return {
        "pdf": samples.pdf is not None,
        "control": samples.pdf is not None,
        "techniques": samples.pdf is not None,
        "direct": samples.pdf is not None,
        "strata": samples.stratum is not None,
        "nodes": samples.design == "gauss-legendre",
        "halves": samples.design == "jitter-pair",
    }.get(needs, True)


def accepted(rule: Entry, n: int) -> list[tuple[str, str, Samples]]:
    """Problem, sampler and samples of every combination that a rule declares to accept; never empty."""
    found = [
        (name, sampler, samples)
        for name in problems_for(rule)
        for sampler in samplers_for(name)
        if brings(samples := draw(name, sampler, n), rule.needs)
    ]
    assert found, f"no sampler brings what rule {rule.name!r} needs ({rule.needs!r})"
    return found


def with_values(samples: Samples, value: torch.Tensor) -> Samples:
    """The same samples of another integrand; what features tell of it beside its value is that of a constant."""
    features = {k: torch.zeros_like(v) if k == "derivative" else v for k, v in samples.seen.features.items()}
    if "steps" in features:  # of walks: the boundary value before every step
        steps = features["steps"].unflatten(-1, (samples.dim, -1)).clone()
        steps[..., VALUE] = steps[..., ALIVE] * value[:, :1, :, :1].expand(steps.shape[0], -1, -1, -1)
        features["steps"] = steps.flatten(-2)
    return replace(samples, seen=replace(samples.seen, value=value.expand_as(samples.value), features=features))
