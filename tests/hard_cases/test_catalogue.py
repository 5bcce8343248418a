"""Every case of the catalogue keeps its bound, and what the textbook does in its place does not."""

from __future__ import annotations

import pytest

from nqr_geom import hard_cases

CASES = [case for group in hard_cases.groups() for case in hard_cases.cases(group)]
NAIVE = [case for case in CASES if case.naive is not None]


def ids(cases):
    return [f"{case.group}: {case.name}" for case in cases]


@pytest.mark.parametrize("case", CASES, ids=ids(CASES))
def test_holds(case):
    error = case.run()
    assert error <= case.bound, f"error {error}, bound {case.bound}"


@pytest.mark.parametrize("case", NAIVE, ids=ids(NAIVE))
def test_the_naive_way_fails(case):
    assert not case.naive() <= case.bound


def test_names_are_told_apart():
    assert len(set(ids(CASES))) == len(CASES)


@pytest.mark.parametrize("group", hard_cases.groups())
def test_every_group_has_a_naive_way_that_fails(group):
    assert any(case.group == group for case in NAIVE)


def test_measuring_tells_what_happened():
    told = []
    results = hard_cases.measure(lambda *what: told.append(what), groups=["winding"])
    assert [(r.group, r.name) for r in results] == [(c.group, c.name) for c in hard_cases.cases("winding")]
    assert told[-1][:2] == (len(results), len(results))
    assert all(result.holds and result.seconds >= 0.0 for result in results)
    with pytest.raises(ValueError, match="group: expected one of winding"):
        hard_cases.measure(groups=["magic"])


def test_a_case_that_breaks_is_a_result():
    broken = hard_cases.Case("winding", "broken", lambda: 1 / 0, 1.0).measure()
    assert (broken.error, broken.holds, broken.words) == (float("inf"), False, "ZeroDivisionError: division by zero")
    assert not hard_cases.Case("winding", "missing", lambda: float("nan"), 1.0).measure().holds
    allowed = hard_cases.case.refusal("winding", "allowed", lambda: None, "x").measure()
    assert not allowed.holds
