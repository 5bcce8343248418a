"""Networks over walks: what they start from, what they are exact on, and what they must not see."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.learn.inet import INet, INetConfig, LearnedRule, UniformWeights
from nqr_geom.integrator.learn.recipe import Recipe, draw_samples
from nqr_geom.integrator.learn.tokens import TokenConfig, tokenize
from nqr_geom.integrator.learn.train import TrainConfig, train
from nqr_geom.integrator.problem import Samples, WalkProblem
from nqr_geom.recipes import JOINT
from nqr_geom.streams import Stream
from nqr_geom.wos import training
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import polygons, queries
from nqr_geom.wos.measures import vertex_measures
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.tokens import WALK_TOKENS
from nqr_geom.wos.training import laplace_batch, pool

TOKENS = TokenConfig(dim=12, frequencies=0, extra=WALK_TOKENS.size, blind=True)
CONFIG = INetConfig(TOKENS, layers=1, width=16, weights="additive", unit_mass=True, beside=12)
VERTICES = polygons(2).vertices
VALUES = np.random.default_rng(5).normal(size=19)


@pytest.fixture(autouse=True, scope="module")
def small_pools(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Pools of a few polygons in a folder of their own."""
    patch = pytest.MonkeyPatch()
    patch.setenv("NQR_GEOM_CACHE", str(tmp_path_factory.mktemp("cache")))
    patch.setattr(training, "SHAPES", {"train": 8, "validation": 4, "test": 4})
    patch.setattr(training, "BLOCK", 4)
    pool.cache_clear()
    yield
    patch.undo()
    pool.cache_clear()


def problem(values: object = VALUES, shape: int = 0, points: int = 20) -> LaplaceProblem:
    return LaplaceProblem.of(VERTICES[shape], values, queries(Domain.of(VERTICES[shape]), points, shape))


def drawn(of: WalkProblem, n: int = 32, seed: int = 0, x: Tensor | None = None) -> Samples:
    x = registry.make("sampler", "random").points(of.rows, n, 12, Stream(seed)) if x is None else x
    return Samples(x, of.evaluate(x), x.new_ones(*x.shape[:2], 1), "random", True)


def network(config: INetConfig = CONFIG, *, wild: bool) -> LearnedRule:
    with torch.random.fork_rng():
        torch.manual_seed(7)
        net = INet(config).eval()
        if wild:
            torch.nn.init.normal_(net.head.weight, std=0.3)
            torch.nn.init.normal_(net.head.bias, std=0.3)
    return LearnedRule(net, UniformWeights(), WALK_TOKENS, half=False)


def answers(rule: LearnedRule, samples: Samples) -> np.ndarray:
    return rule.combine(samples).estimate(samples)[:, 0].numpy()


def test_measures_are_harmonic_and_sum_to_one() -> None:
    for shape in range(2):
        points = queries(Domain.of(VERTICES[shape]), 40, shape)
        measures, residual = vertex_measures(VERTICES[shape], points)
        solved = ng.solve_laplace(VERTICES[shape], VALUES, points, method="boundary", tol=1e-8)
        assert np.abs(measures @ VALUES - solved).max() < min(1e-3, residual * np.abs(VALUES).sum())
        assert np.sqrt(np.square(measures @ VALUES - solved).mean()) < 2e-4
        np.testing.assert_allclose(measures.sum(axis=1), 1.0, atol=1e-6)


def test_measures_do_not_care_for_place_and_size() -> None:
    points = queries(Domain.of(VERTICES[0]), 5, 0)
    here, _ = vertex_measures(VERTICES[0], points)
    there, _ = vertex_measures(1e6 + 3e3 * VERTICES[0], 1e6 + 3e3 * points)
    np.testing.assert_allclose(there, here, atol=1e-6)


def test_an_untrained_network_is_the_mean_bit_for_bit() -> None:
    samples = drawn(problem())
    assert (answers(network(wild=False), samples) == samples.value.mean(dim=(1, 2, 3)).numpy()).all()


def test_answers_are_linear_in_the_boundary_values_and_exact_on_constants() -> None:
    rule, other = network(wild=True), np.random.default_rng(6).normal(size=19)
    first, second = (answers(rule, drawn(problem(v))) for v in (VALUES, other))
    both = answers(rule, drawn(problem(2.0 * VALUES - 3.0 * other + 5.0)))
    np.testing.assert_allclose(both, 2.0 * first - 3.0 * second + 5.0, rtol=1e-12)
    np.testing.assert_allclose(answers(rule, drawn(problem(np.full(19, 0.1)))), 0.1, rtol=1e-13)
    assert np.abs(first - drawn(problem()).value.mean(dim=(1, 2, 3)).numpy()).min() > 1e-3  # it does change the answer


def test_walks_are_a_set() -> None:
    rule, samples = network(wild=True), drawn(problem())
    order = torch.rand(samples.x.shape[:2], generator=torch.Generator().manual_seed(1)).argsort(dim=1)
    np.testing.assert_allclose(answers(rule, samples.permuted(order)), answers(rule, samples), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("scale", "turns"), [(1e-3, 0.0), (4e5, 0.0), (1.0, 0.3), (7.0, 0.85)])
def test_a_turned_and_scaled_domain_with_turned_walks_has_the_same_tokens(scale: float, turns: float) -> None:
    c, s = np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)
    turn = scale * np.array([[c, s], [-s, c]])
    points = queries(Domain.of(VERTICES[0]), 20, 0)
    here, there = (LaplaceProblem.of(VERTICES[0] @ m, VALUES, points @ m) for m in (np.eye(2), turn))
    first = drawn(here)
    second = drawn(there, x=(first.x + turns) % 1.0)
    # A walk that ends at the rim of the shell may go on for a step where rounding is another.
    assert (first.seen.features["length"] == second.seen.features["length"]).double().mean() > 0.99
    gap = (tokenize(first, TOKENS, WALK_TOKENS) - tokenize(second, TOKENS, WALK_TOKENS)).abs()
    assert gap.quantile(0.999) < 1e-4


def test_tokens_read_no_values() -> None:
    assert torch.equal(*(tokenize(drawn(problem(v)), TOKENS, WALK_TOKENS) for v in (VALUES, lambda p: p[:, 0] ** 2)))


def test_a_query_in_the_shell_and_a_lone_walk_are_answered() -> None:
    rule = network(wild=True)
    edge = 0.5 * (VERTICES[0][3] + VERTICES[0][4]) * (1.0 - 1e-7)
    inside = LaplaceProblem.of(VERTICES[0], VALUES, [edge, [0.0, 0.0]])
    for n in (1, 2, 32):
        assert np.isfinite(answers(rule, drawn(inside, n))).all()
    assert answers(rule, drawn(inside))[0] == pytest.approx(0.5 * (VALUES[3] + VALUES[4]), abs=1e-5)


def test_hat_channels_are_all_boundary_values_at_once() -> None:
    batch = laplace_batch(torch.arange(30), 0, "validation")
    x = torch.rand(30, 8, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    hats = batch.problem.evaluate(x)
    values = [torch.from_numpy(b.linear[:, 0]) for b in batch.problem.boundaries]
    mine = torch.stack([values[k] for k in batch.problem.shape]) / training.SCALE
    plain = LaplaceProblem.evaluate(batch.problem, x)
    np.testing.assert_allclose((hats.value[:, :, 0] * mine[:, None]).sum(-1), plain.value[:, :, 0, 0], atol=1e-12)
    samples = Samples(x, hats, None, "random")
    beside = WALK_TOKENS.beside(samples)
    other = WALK_TOKENS.beside(replace(samples, seen=plain))
    np.testing.assert_allclose((beside * mine[:, None, None, :, None]).sum(3), other[:, :, :, 0], atol=1e-12)
    np.testing.assert_allclose((batch.answer * mine).sum(1), batch.problem.reference()[:, 0], atol=2e-4)


def test_pools_are_kept_on_disk_and_keyed_by_their_polygons(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = pool("validation", 0)
    monkeypatch.setenv("NQR_GEOM_CACHE", str(tmp_path))
    pool.cache_clear()
    fresh = pool("validation", 0)
    assert torch.equal(fresh.measures, before.measures)
    files = sorted((tmp_path / "laplace").iterdir())
    assert [file.suffix for file in files] == [".npz"]
    pool.cache_clear()
    written = files[0].stat().st_mtime_ns
    assert torch.equal(pool("validation", 0).problem.points, before.problem.points)
    assert files[0].stat().st_mtime_ns == written
    pool("validation", 1)
    assert len(list((tmp_path / "laplace").iterdir())) == 2


def test_a_small_network_learns_in_seconds(tmp_path: Path) -> None:
    recipe = Recipe(
        name="walks",
        problem="laplace",
        family=laplace_batch,
        base="uniform",
        consistent="mc",
        config=CONFIG,
        extra=WALK_TOKENS,
        designs=("random",),
    )
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    settings = TrainConfig(iterations=40, batch=64, warmup=10, every=40, validation=512, average=0.95)
    net = train(recipe, tmp_path, settings, precision="32-true", progress=False)
    torch.set_num_threads(before)
    batch = laplace_batch(torch.arange(512), 0, "test")
    samples = draw_samples(batch.problem, ("random",), 32, Stream(3))
    rules = LearnedRule(net, UniformWeights(), WALK_TOKENS), UniformWeights()
    mine, mean = ((r.combine(samples).estimate(samples) - batch.answer).square().mean() for r in rules)
    assert mine < 0.75 * mean


def test_the_pair_begins_as_its_rule() -> None:
    recipe = JOINT["laplace-nqr"].rule
    samples = registry.make("sampler", "walk-spread").draw(problem(), 32, Stream(0))
    learned = LearnedRule(INet(recipe.config), recipe.base_rule(), recipe.extra).combine(samples)
    base = registry.make("rule", "walk-fit").combine(samples)
    assert torch.equal(learned.estimate(samples), base.estimate(samples))
    assert torch.equal(learned.doubt, base.doubt)


def test_walks_directed_by_a_network_answer_at_the_door() -> None:
    square, points = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]]), np.array([[0.7, 1.1], [1.6, 0.4]])
    got = ng.solve_laplace(square, lambda p: p[:, 0] - p[:, 1], points, method="nqr", full_output=True)
    np.testing.assert_allclose(got.value[:, 0], points[:, 0] - points[:, 1], atol=0.02)
    assert got.plan["rule"] == "inet-laplace-nqr"
    assert got.counts["samples"] == 64
    again = ng.solve_laplace(square, lambda p: p[:, 0] - p[:, 1], points[1:], method="nqr", rows=[1])
    assert again[0] == got.value[1, 0]
    np.testing.assert_array_equal(ng.solve_laplace(square, np.full(4, 3.0), points, method="nqr"), [3.0, 3.0])
    with pytest.raises(ValueError, match="max_steps: expected 12 with method 'nqr'"):
        ng.solve_laplace(square, np.zeros(4), points, method="nqr", max_steps=20)
