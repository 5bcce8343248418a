"""The network for p = 3: its answers are finite elements', and it keeps what a p-harmonic function keeps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom import p_training, registry
from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.p_training import P_RANGE, p_laplace_batch, p_range_batch
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream
from nqr_geom.wos import training
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import polygons, queries
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.training import pool

VERTICES, VALUES = (part[0] for part in polygons(1))
POINTS = queries(Domain.of(VERTICES), 12, 0)


@pytest.fixture(autouse=True, scope="module")
def small_pools(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Pools of a few polygons in a folder of their own."""
    patch = pytest.MonkeyPatch()
    patch.setenv("NQR_GEOM_CACHE", str(tmp_path_factory.mktemp("cache")))
    for room in (training, p_training):
        patch.setattr(room, "SHAPES", {"validation": 4, "test": 4})
        patch.setattr(room, "BLOCK", 4)
    pool.cache_clear()
    p_training.solved.cache_clear()
    p_training._exponents.cache_clear()
    yield
    patch.undo()
    pool.cache_clear()
    p_training.solved.cache_clear()
    p_training._exponents.cache_clear()


def network(*, wild: bool) -> LearnedRule:
    recipe = RECIPES["p-laplace"]
    with torch.random.fork_rng():
        torch.manual_seed(3)
        net = INet(recipe.config).eval()
        if wild:
            torch.nn.init.normal_(net.head.weight, std=0.3)
    return LearnedRule(net, recipe.base_rule(), recipe.extra, half=False)


def answers(rule: LearnedRule, values: np.ndarray) -> np.ndarray:
    problem = LaplaceProblem.of(VERTICES, values, POINTS)
    samples = registry.make("sampler", "latin-hypercube").draw(problem, 32, Stream(0))
    return rule.combine(samples).estimate(samples)[:, 0].numpy()


def test_batches_have_the_answers_of_a_finer_mesh() -> None:
    batch = p_laplace_batch(torch.arange(60), 0, "validation")
    problem, error = batch.problem, []
    count = len(problem.geometry.shape)
    for k in range(1):
        on = torch.nonzero(problem.shape % count == k)[:, 0]
        boundary = problem.boundaries[k]
        fine = ng.solve_p_laplace(
            polygons(4, split="validation").vertices[k],
            boundary.linear[:, 0],
            boundary.domain.from_frame(problem.points[on].numpy()),
            3.0,
        )
        sign = np.where(problem.shape[on] >= count, -1.0, 1.0)
        error.append(sign * fine - batch.answer[on, 0].numpy())
    assert len(np.concatenate(error)) > 8
    assert np.sqrt(np.mean(np.concatenate(error) ** 2)) < 1e-3


def test_walks_of_a_batch_are_those_of_the_polygon_with_either_sign() -> None:
    batch = p_laplace_batch(torch.arange(40), 0, "validation").problem
    assert 5 < (batch.shape >= 4).sum() < 35
    x = torch.rand(40, 6, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    seen = batch.evaluate(x)
    for row in (0, 7, 21):
        boundary = batch.boundaries[int(batch.shape[row])]
        alone = LaplaceProblem.joined([boundary], [batch.points[row : row + 1].numpy()], 12, 1e-3).evaluate(x[[row]])
        torch.testing.assert_close(seen.value[[row]], alone.value, rtol=0.0, atol=1e-12)
        for name, tensor in alone.features.items():
            torch.testing.assert_close(seen.features[name][[row]], tensor, rtol=0.0, atol=1e-12)


def test_an_untrained_network_is_the_one_for_two_bit_for_bit() -> None:
    samples = draw_samples(p_laplace_batch(torch.arange(30), 0, "test").problem, ("random",), 32, Stream(0))
    rules = network(wild=False), registry.make("rule", "inet-laplace-uniform")
    mine, theirs = (rule.combine(samples).estimate(samples) for rule in rules)
    assert torch.equal(mine, theirs)


def test_constants_may_be_added_and_factors_taken_out() -> None:
    rule = network(wild=True)
    first = answers(rule, VALUES)
    np.testing.assert_allclose(answers(rule, 40.0 * VALUES), 40.0 * first, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(answers(rule, VALUES + 3.0), first + 3.0, rtol=1e-5)
    np.testing.assert_allclose(answers(rule, np.full(19, 2.5)), 2.5, atol=1e-12)
    assert np.abs(first - answers(network(wild=False), VALUES)).max() > 1e-3


def test_it_reads_values() -> None:
    """The weights are not linear in the values: the answer for a sum is not the sum of answers."""
    rule, other = network(wild=True), np.roll(VALUES, 5)
    both = answers(rule, VALUES + other)
    assert np.abs(both - answers(rule, VALUES) - answers(rule, other)).max() > 1e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"p": 1.4}, "p: expected 1.5 to 6 with method 'inet'"),
        ({"p": 6.5}, "p: expected 1.5 to 6 with method 'inet'"),
        ({"tol": 1e-3}, "tol: expected None with method 'inet'"),
        ({"points": [[3.0, 0.0]]}, "points: expected points inside"),
        ({"n": 0}, "n: "),
        ({"method": "nqr"}, "method: expected one of fem, inet"),
    ],
)
def test_what_it_cannot_do_is_refused_by_name(change: dict[str, object], words: str) -> None:
    arguments = {"polygon": VERTICES, "boundary": VALUES, "points": POINTS, "p": 3.0, "method": "inet", **change}
    with pytest.raises(ValueError, match=words):
        ng.solve_p_laplace(**arguments)


def test_the_shipped_network_answers_through_the_public_door() -> None:
    far = np.insert(POINTS, 3, [9.0, 9.0], axis=0)
    found = ng.solve_p_laplace(VERTICES, VALUES, far, 3.0, method="inet", outside="nan", seed=4, full_output=True)
    assert (found.plan["method"], found.plan["p"], found.n) == ("inet", 3.0, 32)
    assert np.isnan(found.value[3, 0])
    inside = np.delete(found.value[:, 0], 3)
    truth = ng.solve_p_laplace(VERTICES, VALUES, POINTS, 3.0)
    assert np.sqrt(np.mean((inside - truth) ** 2)) < 0.1 * VALUES.std()
    assert (ng.solve_p_laplace(VERTICES, np.full(19, 0.3), POINTS, method="inet") == 0.3).all()


def test_more_walks_are_answered_by_the_network_for_two() -> None:
    problem = replace(LaplaceProblem.of(VERTICES, VALUES, POINTS), rows=torch.arange(len(POINTS)))
    samples = registry.make("sampler", "random").draw(problem, 300, Stream(0))
    rules = (registry.make("rule", name) for name in ("inet-p-laplace", "inet-laplace-spread"))
    mine, theirs = (rule.combine(samples).estimate(samples) for rule in rules)
    assert torch.equal(mine, theirs)


def test_each_polygon_has_exponents_of_its_own_and_their_answers() -> None:
    batch = p_range_batch(torch.arange(200), 0, "validation")
    p = batch.problem.p
    assert p is not None
    assert p.min() > P_RANGE[0]
    assert p.max() < P_RANGE[1]
    assert len(p.unique()) == 8  # two of each of four polygons
    problem, count = batch.problem, len(batch.problem.geometry.shape)
    which = p == p[0]
    boundary = problem.boundaries[int(problem.shape[0]) % count]
    fine = ng.solve_p_laplace(
        polygons(4, split="validation").vertices[int(problem.shape[0]) % count],
        boundary.linear[:, 0],
        boundary.domain.from_frame(problem.points[which].numpy()),
        float(p[0]),
    )
    sign = np.where(problem.shape[which] >= count, -1.0, 1.0)
    assert np.sqrt(np.mean((sign * fine - batch.answer[which, 0].numpy()) ** 2)) < 1e-3
    seen = problem.evaluate(torch.full((200, 2, 12), 0.3, dtype=torch.float64)).features["p"]
    torch.testing.assert_close(seen[:, 1, 0, 0], p)


@pytest.mark.parametrize("p", [1.6, 2.0, 2.5, 5.0])
def test_the_network_for_a_range_sees_p(p: float) -> None:
    """Its answers are nearer to the truth than the exact solution for p = 2 is, and at p = 2 not far from it."""
    found = ng.solve_p_laplace(VERTICES, VALUES, POINTS, p, method="inet", seed=1, full_output=True)
    assert (found.plan["rule"], found.plan["p"]) == ("inet-p-laplace-range", p)
    assert not found.fallback.any()
    truth, two = (ng.solve_p_laplace(VERTICES, VALUES, POINTS, q) for q in (p, 2.0))
    error, plain = (np.sqrt(np.mean((answer - truth) ** 2)) for answer in (found.value[:, 0], two))
    assert error < max(0.7 * plain, 0.03 * VALUES.std())
    assert (ng.solve_p_laplace(VERTICES, np.full(19, 0.3), POINTS, p, method="inet") == 0.3).all()


def test_samples_without_p_are_refused_by_name() -> None:
    rule = registry.make("rule", "inet-p-laplace-range")
    samples = registry.make("sampler", "walk-spread").draw(LaplaceProblem.of(VERTICES, VALUES, POINTS), 8, Stream(0))
    with pytest.raises(ValueError, match="rule: 'inet-p-laplace-range' needs samples of 'p-laplace'"):
        rule.combine(samples)
