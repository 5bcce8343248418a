"""Models on hostile inputs: all answers are finite, what is far from the family is flagged, the family is not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.hard_cases.hostile import hostile
from nqr_geom.hard_cases.learned import held, models
from nqr_geom.integrator.estimate import run
from nqr_geom.recipes import JOINT, rule_of

PLAIN = [name for name in models() if name not in JOINT]


@pytest.mark.parametrize("name", PLAIN)
def test_every_answer_is_finite(name):
    assert all(np.isfinite(held(name, one)[:2]).all() for one in hostile(rule_of(name).problem))


@pytest.mark.parametrize("name", ["gwn-uniform", "gwn-student-uniform", "sd-uniform"])
def test_what_no_card_knows_is_flagged(name):
    far = {"queries 1e-12 beside the curve", "queries 1e3 away", "a circle from its centre: constant", "5000 samples"}
    flags = {one.name: held(name, one).flagged for one in hostile(rule_of(name).problem) if one.name in far}
    assert flags["a circle from its centre: constant"] == flags["5000 samples"] == 1.0
    assert max(flags.values()) == 1.0


@pytest.mark.parametrize("name", [name for name in PLAIN if "structured" not in name and name != "gwn-student"])
def test_the_family_is_hardly_ever_given_up(name):
    recipe = rule_of(name)
    problem = recipe.family(torch.arange(300), 2, "test").problem
    sampler = registry.make("sampler", recipe.designs[0])
    got = run(problem, sampler, registry.make("rule", f"inet-{name}"), recipe.sizes[0][0], seed=2)
    assert got.fallback.mean() < 0.02
