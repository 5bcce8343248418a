"""The frontier tells the truth: errors known in closed form, intervals that cover, a file that comes back."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor

from nqr_geom.integrator import frontier as module
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.frontier import Frontier, frontier, refusal
from nqr_geom.integrator.problem import Observation, Problem
from tests.integrands import Known, TwoTechniques, smooth


@dataclass
class Lines(Problem):
    """Integrals of 1 + a x, a known per shape: plain Monte Carlo has variance a^2 / (12 n)."""

    slope: Tensor = field(default_factory=lambda: torch.ones(1))
    size: int = 4  # integrals that share a shape
    rows: Tensor = field(default_factory=lambda: torch.arange(0))
    name: str = "lines"
    shift: float = 0.0  # of the reference: what every estimate is then biased by
    calls: list = field(default_factory=list)

    def __post_init__(self) -> None:
        if not len(self.rows):
            self.rows = torch.arange(self.size * len(self.slope))

    @property
    def groups(self) -> np.ndarray:
        return 7 * (self.rows // self.size).numpy()

    def _a(self) -> Tensor:
        return self.slope[self.rows // self.size].double()

    def evaluate(self, x: Tensor) -> Observation:
        return Observation((1.0 + self._a()[:, None, None] * x)[..., None], queries=2 * x.shape[0] * x.shape[1])

    def take(self, index: slice | Tensor) -> Lines:
        return replace(self, rows=self.rows[index])

    def reference(self) -> np.ndarray:
        return (1.0 + 0.5 * self._a())[:, None].numpy() + self.shift

    def peers(self) -> dict:
        def slow() -> np.ndarray:
            self.calls.append(1)
            time.sleep(0.002)
            return self.reference() + 1e-3

        return {"closed form": self.reference, "off by 0.001": slow}


def lines(groups=40, **options) -> Lines:
    return Lines(torch.linspace(0.5, 1.5, groups), **options)


def truth(problem: Lines, n: int) -> float:
    """MSE of plain Monte Carlo."""
    return float((problem._a() ** 2).mean()) / (12.0 * n)


@pytest.fixture(scope="module")
def measured() -> Frontier:
    return frontier(lines(), ["mc", "stratified", "grid+trapezoid", "random+trapezoid"], [16, 4], runs=8, seed=3)


def test_errors_are_the_known_ones(measured):
    points = {(p.method, p.n): p for p in measured.points}
    assert list(points)[:4] == [("mc", 4), ("mc", 16), ("stratified", 4), ("stratified", 16)]
    for n in (4, 16):
        mc, stratified, grid = (points[m, n] for m in ("mc", "stratified", "grid+trapezoid"))
        assert mc.mse_interval[0] < truth(lines(), n) < mc.mse_interval[1]
        assert mc.mse == pytest.approx(truth(lines(), n), rel=0.1)
        assert stratified.mse == pytest.approx(truth(lines(), n) / n**2, rel=0.1)
        assert grid.mse < 1e-30  # the midpoint rule is exact on lines
        assert mc.ratio == 1.0
        assert mc.ratio_interval == (1.0, 1.0)
        assert stratified.ratio_interval[0] < n**2 < stratified.ratio_interval[1]
        assert stratified.ratio == pytest.approx(mc.mse / stratified.mse, rel=1e-12)
        assert mc.squared_bias_interval[0] < 0.0 < mc.squared_bias_interval[1]
        assert mc.queries == 2 * n
        assert 0.0 < mc.seconds < 0.1
        assert mc.median < mc.mse < mc.p99  # a chi-square with one degree of freedom
        assert mc.median == pytest.approx(0.455 * mc.mse, rel=0.2)


def test_a_known_bias_is_found():
    got = frontier(lines(shift=0.05), ["mc"], [64], runs=16).points[0]
    assert got.squared_bias_interval[0] < 0.05**2 < got.squared_bias_interval[1]
    assert got.squared_bias == pytest.approx(0.05**2, rel=0.1)
    assert got.mse == pytest.approx(0.05**2 + truth(lines(), 64), rel=0.1)


@pytest.mark.parametrize("groups", [1, 30])
def test_intervals_cover(groups):
    """Of 100 experiments the 95% intervals of MSE and squared bias hold the truth in 85 and more."""
    random = np.random.default_rng(0)
    held = np.zeros(2)
    for seed in range(100):
        # errors of 4 integrals a shape, with a bias that all integrals share and a spread of their own
        deviations = 0.5 + random.normal(size=(4 * groups, 12, 1))
        resample = Bootstrap.of(np.repeat(np.arange(groups), 4), 12, seed)
        assert resample.over == ("groups" if groups > 1 else "runs")
        low, high = resample.mean((deviations**2).mean(axis=2))
        value, (bias_low, bias_high) = resample.squared_bias(deviations)
        assert bias_low < value < bias_high
        held += low < 1.25 < high, bias_low < 0.25 < bias_high
    assert (held >= 85).all()
    assert (held < 100).all()  # nor are they wide enough for anything


def test_shapes_and_not_queries_are_resampled():
    """Queries of one shape err alike: 1000 of them say no more than one, and the interval knows."""
    per_shape = np.random.default_rng(1).exponential(size=20)
    few = Bootstrap.of(np.arange(20), 2, 0).mean(np.repeat(per_shape[:, None], 2, axis=1))
    many = Bootstrap.of(np.repeat(np.arange(20), 50), 2, 0).mean(np.repeat(per_shape, 50)[:, None].repeat(2, axis=1))
    np.testing.assert_allclose(few, many, rtol=1e-12)


def test_ratios_are_resampled_jointly():
    """Errors that are proportional shape by shape have a ratio without any spread."""
    errors = np.random.default_rng(2).exponential(size=(50, 4))
    resample = Bootstrap.of(np.arange(50), 4, 0)
    low, high = resample.ratio(3.0 * errors, errors)
    assert low == pytest.approx(3.0, rel=1e-12)
    assert high == pytest.approx(3.0, rel=1e-12)
    assert resample.ratio(errors, 0.0 * errors) is None


def test_the_standard_error_of_a_mean_is_that_of_its_groups() -> None:
    errors = np.repeat(np.random.default_rng(2).exponential(size=(400, 1)), 8, axis=0)
    told = Bootstrap.of(np.repeat(np.arange(400), 8), 1, 0).standard_error(errors)
    assert told == pytest.approx(errors[::8].std(ddof=1) / 20.0, rel=0.1)


def test_peers_are_timed_and_drawn_apart(measured):
    peers = {p.method: p for p in measured.points if p.kind == "exact"}
    assert set(peers) == {"closed form", "off by 0.001"}
    assert peers["closed form"].mse == 0.0
    assert peers["off by 0.001"].mse == pytest.approx(1e-6)
    assert peers["off by 0.001"].seconds >= 0.002 / 160
    assert peers["off by 0.001"].n is None
    assert peers["off by 0.001"].ratio is None


def test_envelope_is_the_best_for_each_budget(measured):
    rows = measured.envelope()
    sampled = [p for p in measured.points if p.kind == "sampled"]
    assert rows[0]["seconds"] == min(p.seconds for p in sampled)
    for budget in [p.seconds for p in sampled]:
        best = min((p for p in sampled if p.seconds <= budget), key=lambda p: p.mse)
        assert [row["method"] for row in rows if row["seconds"] <= budget][-1] == best.method
    assert [row["seconds"] for row in rows] == sorted(row["seconds"] for row in rows)
    assert all(one["method"] != two["method"] for one, two in pairwise(rows))
    assert not {row["method"] for row in rows} & {"closed form", "off by 0.001"}


def test_json_comes_back_and_files_are_whole(measured, tmp_path):
    path = tmp_path / "frontier.json"
    text = measured.to_json(path)
    assert Frontier.from_json(text) == Frontier.from_json(path) == Frontier.from_json(str(path)) == measured
    assert [entry.name for entry in tmp_path.iterdir()] == ["frontier.json"]
    fields = json.loads(text)
    assert fields["machine"]["cores"] >= 1
    assert {"python", "nqr-geom", "numpy", "torch"} <= set(fields["versions"])
    assert fields["seed"] == 3
    with pytest.raises(FileNotFoundError):
        measured.to_json(tmp_path / "missing" / "frontier.json")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        measured.to_json(tmp_path / "folder")
    assert {entry.name for entry in tmp_path.iterdir()} == {"folder", "frontier.json"}  # nothing half-written is left
    assert len(measured.table) == len(measured.points)
    assert measured.table[0]["mse"] == measured.points[0].mse


def test_a_picture_is_written(measured, tmp_path):
    for name in ("frontier.png", "frontier.svg"):
        path = measured.plot(tmp_path / name)
        assert path.stat().st_size > 10_000
    text = (tmp_path / "frontier.svg").read_text()
    assert "microseconds per integral" in text
    assert "integrand queries per integral" in text


def test_a_missing_matplotlib_is_one_clear_sentence(measured, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r'frontier plots need matplotlib: pip install "nqr-geom\[plot\]"'):
        measured.plot(tmp_path / "frontier.png")


def test_same_seed_same_errors_and_progress_is_told():
    told = []
    one = frontier(lines(5), ["mc"], [4, 8], runs=2, seed=1, tick=lambda *step: told.append(step))
    two = frontier(lines(5), ["mc"], [4, 8], runs=2, seed=1)
    other = frontier(lines(5), ["mc"], [4, 8], runs=2, seed=2)
    errors = [[(p.mse, p.mse_interval, p.squared_bias) for p in f.points[:2]] for f in (one, two, other)]
    assert errors[0] == errors[1]
    assert errors[0] != errors[2]
    labels = ["mc, n = 4", "mc, n = 8", "closed form", "off by 0.001"]
    assert told == [(k + 1, 4, label) for k, label in enumerate(labels)]


def test_by_default_all_aliases_that_fit_are_measured():
    names = module.fitting(lines(2), 16)
    assert {"mc", "stratified", "trapezoid", "simpson", "gauss-legendre", "bayesian-quadrature"} == set(names)
    assert "structured" in module.fitting(_toy(), 16)
    assert "mis" in module.fitting(TwoTechniques(), 16)
    got = frontier(TwoTechniques(), budgets=[4], runs=2)
    assert got.baseline == "random+balance-heuristic"
    assert {p.method for p in got.points} == set(module.fitting(TwoTechniques(), 4))


def _toy() -> Problem:
    from nqr_geom.toy.problem import ToyProblem

    return ToyProblem(2)


def test_refusal_says_why():
    assert refusal(lines(2), "random", "mc", 4) is None
    assert "needs samples with a density" in refusal(lines(2), "grid", "mc", 4)


@dataclass
class NoReference(Known):
    def reference(self):
        return None


@dataclass
class BrokenReference(Known):
    def reference(self):
        return np.array([[1.0], [np.nan], [1.0]])


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        (
            (NoReference(smooth().integrand, 1.0), ["mc"], [4]),
            ValueError,
            "problem: .* a reference .* 'known' has none",
        ),
        ((BrokenReference(smooth().integrand, 1.0), ["mc"], [4]), ValueError, "finite reference answers, integral 1"),
        ((lines(2), ["magic"], [4]), ValueError, "method: expected one of"),
        ((lines(2), "mc", [4]), TypeError, "methods: expected a sequence of names, got the single name 'mc'"),
        ((lines(2), [], [4]), ValueError, "methods: expected one or more"),
        ((lines(2), ["mc", "mc"], [4]), ValueError, "methods: expected one or more different"),
        ((lines(2), ["grid+mc"], [4]), ValueError, "methods: 'grid.mc' does not fit: rule: 'mc' needs samples with"),
        ((lines(2), ["mc"], []), ValueError, "budgets: expected one or more"),
        ((lines(2), ["mc"], [4, 4]), ValueError, "budgets: expected one or more different"),
        ((lines(2), ["mc"], [0]), ValueError, "budgets: expected an integer >= 1, got 0"),
    ],
)
def test_what_cannot_be_measured_is_refused(arguments, error, match):
    with pytest.raises(error, match=match):
        frontier(*arguments)


def test_one_run_is_not_enough():
    with pytest.raises(ValueError, match="runs: expected an integer >= 2, got 1"):
        frontier(lines(2), ["mc"], [4], runs=1)


def test_a_non_finite_estimate_is_not_swept_under():
    broken = Known(lambda x: torch.where(x[..., 0] > 0.0, torch.nan, 1.0), 1.0)
    with pytest.raises(FloatingPointError, match="mc gave a non-finite estimate for integral 0"):
        frontier(broken, ["mc"], [4], runs=2)
