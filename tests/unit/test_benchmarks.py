"""What benchmarks of learned rules promise: networks beside their bases, and trained samplers once there are any."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from nqr_geom import registry
from nqr_geom.integrator.problem import Problem, Samples
from nqr_geom.integrator.samplers import Random
from nqr_geom.streams import Stream
from nqr_geom.toy.problem import ToyProblem


@pytest.fixture
def comparison(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return import_module("comparison")


@pytest.fixture
def targets(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return import_module("targets")


def test_targets_are_reached_only_by_all_of_their_values(targets: ModuleType) -> None:
    rows = {"exact_gwn": [{"case": "star, 100 segments", "ratio": 2.0, "largest_difference": 1e-3}],
            "mitsuba_direct": [{"ratio": 1.5}, {"ratio": 0.9}]}  # fmt: skip
    lines = {line.split(" | ")[0].strip("| "): line for line in targets.page(rows.get).splitlines()}
    assert "| 2 | yes |" in lines["winding numbers of 100 segments, times faster than libigl"]
    assert "| 0.001 | no |" in lines["their largest difference from libigl's"]
    assert "| 1.5, 0.9 | no |" in lines["direct light, times faster than Mitsuba 3, five scenes"]
    assert "| not measured | no |" in lines["toy, INet on random samples"]


def test_every_target_names_its_script(targets: ModuleType) -> None:
    folder = Path(targets.__file__).parent
    named = {one.benchmark for group in targets.TARGETS.values() for one in group}
    assert all((folder / f"{name}.py").exists() for name in named)


def test_a_trained_sampler_joins_once_it_has_a_name(comparison: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(registry.ALIASES, "toy:nqr", raising=False)
    without = comparison.pairs_for("toy")
    monkeypatch.setitem(registry.ALIASES, "toy:nqr", "bayesian-quadrature+inet-toy-structured")
    joined = [pair for pair in comparison.pairs_for("toy") if pair not in without]
    rules = ["toy-hermite", "inet-toy-structured", "inet-toy-uniform"]
    assert joined == [("bayesian-quadrature", rule) for rule in rules]


def test_ratios_are_of_means_on_the_same_samples(comparison: ModuleType) -> None:
    problem = ToyProblem.family(64)
    rows = comparison.rows_of("toy", problem, [("stratified", rule) for rule in ("toy-hermite", "inet-toy-structured")])
    plain, base, learned = rows
    assert (plain["design"], plain["rule"]) == ("random", "mc")
    assert learned["base"] == "toy-hermite"
    assert learned["ratio"] == pytest.approx(plain["mse"] / learned["mse"])
    assert learned["gain"] == pytest.approx(base["mse"] / learned["mse"])
    assert learned["gain_interval"][0] < learned["gain"] < learned["gain_interval"][1]
    assert "gain" not in base


def test_pairs_that_do_not_fit_are_left_out(comparison: ModuleType) -> None:
    """Greedy samples have no density, so that Monte Carlo refuses them."""
    rows = comparison.rows_of("toy", ToyProblem.family(2), [("toy-split", "mc"), ("toy-split", "toy-hermite")])
    assert [(row["design"], row["rule"]) for row in rows] == [("random", "mc"), ("toy-split", "toy-hermite")]


def test_a_remembered_sampler_draws_once(comparison: ModuleType) -> None:
    calls = []

    class Counting(Random):
        def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
            calls.append(stream.key)
            return super().draw(problem, n, stream)

    problem, kept = ToyProblem.family(16), comparison.Remembered(Counting())
    pairs = [("random", rule) for rule in ("mc", "trapezoid", "uniform")]
    plain, trapezoid, uniform = (comparison.errors_of(problem, pair, 2, sampler=kept).deviations for pair in pairs)
    assert len(calls) == 2  # one for each run
    assert (uniform == comparison.errors_of(problem, ("random", "uniform"), 2).deviations).all()
    assert (plain == uniform).all()  # on uniform points
    assert not (plain == trapezoid).any()
