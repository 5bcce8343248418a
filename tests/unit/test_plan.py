"""Choosing a method and running it: costs, laws, bounds, tolerances, budgets, and what is said about them."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom import speed as machine_speed
from nqr_geom.integrator.bounds import bound_of_samples, bound_of_values
from nqr_geom.integrator.estimate import Statistics
from nqr_geom.integrator.models import Cost, Law, Model, model
from nqr_geom.integrator.plan import Clock, Goal, Way, cheapest, most_accurate, most_within, sizes_of
from nqr_geom.integrator.pursue import _Answer, _Sampling, pursue

SQUARE = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
POINTS = np.random.default_rng(0).uniform(-1.0, 2.0, (150, 2))
POINTS = POINTS[ng.distance(SQUARE, POINTS) > 0.02]  # nearer ones may take more samples than there may be
UNIT = [[0, 0], [1, 0], [1, 1], [0, 1]]


def way(name: str, per_sample: float, error: float, **options) -> Way:
    """A made-up method whose error falls like 1 / n."""
    law = Law((1, 1024), (error / 3, error / 3072), (error, error / 1024))
    return Way(name, Model(Cost({"rows*n": per_sample}), law), draw=lambda rows, n, k: None, **options)


def test_costs_are_fitted_to_what_was_measured():
    true = Cost({"1": 2e-3, "rows": 3e-7, "rows*n": 1e-8})
    told = [(r, n, 1.0, true.seconds(r, n)) for r in (10, 1000, 10_000) for n in (4, 32, 256)]
    found = Cost.fit(["1", "n", "rows", "rows*n", "rows*n*n"], told)
    for row in told:
        assert found.seconds(*row[:3]) == pytest.approx(row[3], rel=1e-3)


def test_laws_go_on_beyond_their_table_and_find_sizes():
    law = Law((16, 64, 256), (0.1, 0.05, 0.025), (0.4, 0.2, 0.1))
    assert law.high_at(1024) == pytest.approx(0.05)
    assert law.high_at(4) == pytest.approx(0.8)
    assert 64 <= law.size_for(0.2) <= 77
    assert Law((16, 64), (0.1, 0.1), (0.1, 0.1)).size_for(0.01) is None
    assert law.order(64) == pytest.approx(0.5)


def test_the_cheapest_and_the_most_accurate_are_found():
    fast, slow = way("fast", 1e-8, 10.0, independent=True), way("slow", 1e-6, 0.1, independent=True)
    assert [f.way.method for f in cheapest([fast, slow], Goal(100, tol=0.05))] == ["slow", "fast"]
    assert most_accurate([fast, slow], Goal(100), 1e-3)[0].way.method == "slow"
    n = most_within(fast, Goal(100), 1e-3)
    assert 900 <= n <= 1000
    assert sizes_of(fast, 8) == (8,)
    assert sizes_of(way("design", 1.0, 1.0), 8) == (4, 8)


def test_bounds_hold_where_repetitions_are_normal():
    rng = np.random.default_rng(1)
    truth, scale = rng.normal(size=4000), np.exp(rng.normal(size=4000) * 0.3)
    values = truth[None, :, None] + scale[None, :, None] * rng.normal(size=(2, 4000, 1))
    held = np.abs(values.mean(axis=0)[:, 0] - truth) <= bound_of_values(values)
    assert 0.94 < held.mean() < 0.99
    terms = truth[:, None, None] + scale[:, None, None] * rng.normal(size=(4000, 64, 1))
    held = np.abs(terms.mean(axis=1)[:, 0] - truth) <= bound_of_samples(Statistics.of(terms))
    assert 0.94 < held.mean() < 0.995


def test_statistics_with_a_count_for_each_integral_merge():
    terms = np.random.default_rng(2).normal(size=(2, 30, 1))
    one = Statistics.of(terms[:, :10])
    both = one.merge(Statistics.of(terms[:, 10:]))
    mixed = Statistics(np.stack([one.mean[0], both.mean[1]]), np.stack([one.m2[0], both.m2[1]]),
                       np.array([[10], [30]]), "samples")  # fmt: skip
    assert mixed.stderr[0] == pytest.approx(one.stderr[0])
    assert mixed.stderr[1] == pytest.approx(both.stderr[1])


def test_a_level_is_checked_against_the_one_before_where_that_is_near():
    drawn = []

    def draw(rows, n, k):
        drawn.append((n, k))
        value = np.full((len(rows), 1), 1.0 / n)
        return replace(ng.gwn(SQUARE, POINTS[: len(rows)], full_output=True), value=value, inner=value, n=n)

    goal = Goal(2, tol=1e-9)
    sampling = _Sampling(replace(way("design", 1e-6, 1.0), draw=draw), goal, _Answer(), Clock())
    bounds = [sampling.level(np.arange(2), n) for n in (8, 16, 200, 600)]
    assert drawn == [(4, 0), (8, 1), (16, 2), (100, 3), (200, 4), (600, 5)]
    for n, bound in zip((8, 16, 200, 600), bounds, strict=True):
        assert (bound >= 1.0 / n).all()


def test_samples_that_cost_next_to_nothing_are_taken_at_once():
    drawn = []
    dear = Model(Cost({"1": 1.0, "rows*n": 1e-6}), Law((8, 1024), (1.0, 1 / 128), (1.0, 1 / 128)))

    def draw(rows, n, k):
        drawn.append(n)
        return ng.gwn(SQUARE, POINTS[: len(rows)], full_output=True)

    pursue([Way("dear", dear, draw=draw)], Goal(1, tol=0.25))
    assert drawn[-1] > 10_000  # 32 would do, and would take as long


@pytest.mark.parametrize(("method", "tol"), [("auto", 1e-3), ("structured", 1e-3), ("stratified", 2e-2), ("mc", 0.1)])
def test_tolerances_are_met_and_the_plan_says_how(method, tol):
    truth = ng.gwn(SQUARE, POINTS)
    got = ng.gwn(SQUARE, POINTS, method=method, tol=tol, full_output=True)
    assert got.plan["met"]
    assert (got.error <= tol).all()
    assert np.mean(np.abs(got.value[:, 0] - truth) <= tol) >= 0.95
    assert got.plan["method"] == ("exact" if method == "auto" else method)
    assert {"candidates", "why", "predicted", "levels", "tol", "budget"} <= set(got.plan)
    json.dumps(got.plan["candidates"])


def test_other_methods_are_weighed_where_exact_answers_take_long():
    def weighed(points, **options):
        got = ng.gwn(SQUARE, points, method="auto", full_output=True, **options)
        assert got.plan["method"] == "exact" or got.plan["met"]
        return [candidate["method"] for candidate in got.plan["candidates"]]

    assert weighed(POINTS, tol=1e-3) == ["exact"]
    assert set(weighed(np.tile(POINTS, (20_000, 1)), tol=1e-3)) > {"exact", "structured"}
    assert set(weighed(POINTS, tol=1e-3, budget=1.0)) > {"exact", "structured"}


def test_a_second_answer_changes_no_array_of_the_first():
    first, second = (ng.gwn(SQUARE, POINTS, method="mc", n=n, seed=n, full_output=True) for n in (32, 64))
    before = first.value.copy(), first.fallback.copy(), first.statistics.m2.copy()
    answer, half = _Answer(), np.arange(0, len(POINTS), 2)
    answer.put(np.arange(len(POINTS)), first, np.ones(len(POINTS)))
    assert answer.statistics() is first.statistics
    answer.put(half, replace(second, value=second.value[half], inner=second.inner[half],
                             fallback=second.fallback[half], statistics=second.statistics.take(half)),
               np.full(len(half), 0.5))  # fmt: skip
    np.testing.assert_array_equal(answer.value[half], second.value[half])
    np.testing.assert_array_equal(answer.value[1::2], first.value[1::2])
    np.testing.assert_array_equal(answer.error, np.where(np.arange(len(POINTS)) % 2, 1.0, 0.5))
    np.testing.assert_array_equal(answer.statistics().m2[1::2], first.statistics.m2[1::2])
    for array, kept in zip((first.value, first.fallback, first.statistics.m2), before, strict=True):
        np.testing.assert_array_equal(array, kept)


def test_black_boxes_are_sampled_and_agree():
    box = ng.Curve.from_callable(SQUARE.sample, pieces=4)
    got = ng.gwn(box, POINTS, method="auto", tol=1e-2, full_output=True)
    assert got.plan["method"] == "structured"
    np.testing.assert_allclose(got.value[:, 0], ng.gwn(SQUARE, POINTS), atol=1e-9)
    smooth = ng.sd(box, POINTS, method="auto", tol=1e-3, full_output=True)
    assert np.mean(np.abs(smooth.value[:, 0] - ng.sd(SQUARE, POINTS)) <= 1e-3) >= 0.95


def test_budgets_are_kept_and_more_time_is_more_accurate():
    ng.gwn(SQUARE, POINTS, method="mc", n=16)  # torch is loaded
    errors = []
    for budget in (0.05, 0.5):
        start = time.process_time()
        got = ng.gwn(SQUARE, POINTS, method="mc", budget=budget, full_output=True)
        assert time.process_time() - start < 4 * budget + 0.5  # a guard: the share within time is the benchmark's
        assert got.plan["met"] is None
        errors.append(np.median(got.error))
    assert errors[1] < errors[0]


def test_too_small_a_budget_is_refused_or_said():
    with pytest.raises(ValueError, match=r"budget: expected about .* s or more"):
        ng.solve_laplace(UNIT, [0.0, 1.0, 1.0, 0.0], [[0.5, 0.5]], method="boundary", budget=1e-6)
    got = ng.gwn(SQUARE, POINTS, method="mc", tol=1e-9, budget=0.1, full_output=True)
    assert not got.plan["met"]
    assert "too small" in got.plan["why"]


@pytest.mark.parametrize("name", ["tol", "budget"])
def test_bad_goals_are_refused_by_name(name):
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"{name}: expected a number > 0.0"):
            ng.gwn(SQUARE, POINTS, **{name: bad})
        with pytest.raises(ValueError, match=f"{name}: expected a number > 0.0"):
            ng.solve_laplace(UNIT, np.zeros(4), [[0.5, 0.5]], **{name: bad})
    with pytest.raises(TypeError, match=f"{name}: expected a number"):
        ng.integrate(ng.problems.toy(3), **{name: "little"})


def test_planned_answers_do_not_depend_on_chance_and_take_no_points():
    first, second = (ng.gwn(SQUARE, POINTS, method="stratified", tol=0.05) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert ng.gwn(SQUARE, np.empty((0, 2)), method="auto", tol=1e-3).shape == (0,)
    assert ng.gwn(SQUARE, np.empty((0, 2)), method="mc", tol=1e-3).shape == (0,)


def test_p_laplace_refines_as_long_as_there_is_time():
    got = ng.solve_p_laplace(UNIT, lambda x: np.sin(3 * x[:, 0]) * x[:, 1], [[0.5, 0.5]], budget=1.5, full_output=True)
    levels = got.plan["levels"]
    assert [level["triangles"] for level in levels] == sorted(level["triangles"] for level in levels)
    assert got.error[0] == got.plan["error"]
    with pytest.raises(ValueError, match="budget: expected None with method 'inet'"):
        ng.solve_p_laplace(UNIT, np.zeros(4), [[0.5, 0.5]], method="inet", budget=1.0)


def test_speed_is_kept_and_broken_files_are_measured_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("NQR_GEOM_CACHE", str(tmp_path))
    machine_speed.speed.cache_clear()
    first = machine_speed.speed()
    (path,) = tmp_path.glob("speed-*.json")
    assert json.loads(path.read_text()) == first
    machine_speed.speed.cache_clear()
    assert machine_speed.speed() == first
    for broken in ("{", '{"calls": 1.0}', '{"calls": -1, "numbers": 1, "matrices": 1}'):
        path.write_text(broken)
        machine_speed.speed.cache_clear()
        assert machine_speed.speed().keys() == first.keys()
    machine_speed.speed.cache_clear()


def test_every_application_has_models():
    for name, method in (("gwn", "exact"), ("sd", "exact"), ("sd-callable", "structured"), ("laplace", "boundary"),
                         ("transmittance", "structured"), ("direct", "mis"), ("toy", "structured")):  # fmt: skip
        found = model(name, method)
        assert found is not None
        assert found.cost.seconds(1000, 32, 6) > 0.0
    assert model("gwn", "magic") is None
