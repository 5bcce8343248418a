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
from nqr_geom.p_training import p_laplace_batch
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
    yield
    patch.undo()
    pool.cache_clear()
    p_training.solved.cache_clear()


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
        ({"p": 2.5}, "p: expected 3 with method 'inet'"),
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
