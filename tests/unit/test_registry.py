"""The table of what there is: every line loads, every alias resolves, every error lists the options."""

from __future__ import annotations

import re

import pytest

from nqr_geom import registry
from nqr_geom.integrator.problem import Problem
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler
from tests import fixtures

KINDS = {"sampler": Sampler, "rule": Rule, "problem": Problem, "model": Rule}
ENTRIES = [(kind, entry) for kind in KINDS for entry in registry.entries(kind)]


@pytest.mark.parametrize(("kind", "entry"), ENTRIES, ids=[f"{kind}-{entry.name}" for kind, entry in ENTRIES])
def test_every_line_is_what_it_says(kind, entry):
    assert entry.dims in ("any", "1", "12")
    assert entry.summary
    assert fixtures.problems_for(entry)  # a test problem exists for it
    target = entry.load()
    if kind == "problem":
        assert issubclass(target, Problem)
        assert target.name == entry.name
        return
    made = registry.make(kind, entry.name)
    assert isinstance(made, KINDS[kind])
    other_names = {"rectangle": "trapezoid"} | ({entry.name: f"inet-{entry.name}"} if kind == "model" else {})
    assert made.name == other_names.get(entry.name, entry.name)


@pytest.mark.parametrize("kind", KINDS)
def test_names_are_unique(kind):
    names = [entry.name for entry in registry.entries(kind)]
    assert len(set(names)) == len(names)
    assert not any("+" in name or ":" in name for name in names)


@pytest.mark.parametrize("alias", registry.ALIASES)
def test_every_alias_resolves_and_fits_its_problem(alias):
    problem, _, name = alias.rpartition(":")
    sampler, rule = registry.method(name, problem)
    assert f"{sampler}+{rule}" == registry.ALIASES[alias]
    rule_entry = registry.entry("rule", rule)
    places = [place for place in fixtures.problems_for(rule_entry) if problem in ("", fixtures.problem(place).name)]
    assert any((place, sampler) in {pair[:2] for pair in fixtures.accepted(rule_entry, 8)} for place in places)


def test_an_alias_of_a_problem_hides_the_general_one_only_there():
    assert registry.method("structured", "toy") == ("toy-split", "toy-hermite")
    assert registry.method("mc", "toy") == ("random", "mc")
    assert registry.method("sobol+regression-3") == ("sobol", "regression-3")


@pytest.mark.parametrize(
    ("call", "options"),
    [
        (lambda: registry.entries("colour"), ("kind: expected one of sampler, rule, problem, model, got 'colour'",)),
        (lambda: registry.entry("rule", "magic"), ("rule: expected one of", "simpson", "ratio-cv", "got 'magic'")),
        (lambda: registry.make("sampler", "magic"), ("sampler: expected one of", "sobol", "got 'magic'")),
        (lambda: registry.method("magic"), ("method: expected one of", "trapezoid", "'sampler+rule', got 'magic'")),
        (lambda: registry.method("magic", "toy"), ("structured", "got 'magic'")),
        (lambda: registry.method("magic+mc"), ("sampler: expected one of", "got 'magic'")),
        (lambda: registry.method("random+magic"), ("rule: expected one of", "got 'magic'")),
    ],
)
def test_errors_list_what_there_is(call, options):
    with pytest.raises(ValueError, match=".*".join(map(re.escape, options))):
        call()


def test_options_of_another_problem_are_not_offered():
    with pytest.raises(ValueError, match="method: ") as caught:
        registry.method("magic")
    assert "structured" not in str(caught.value)


def test_an_entry_that_no_test_problem_fits_is_noticed():
    with pytest.raises(AssertionError, match="knows no problem for 'new', which needs 'tea'"):
        fixtures.problems_for(registry.Entry("new", "a:b", "a new rule", needs="tea"))
