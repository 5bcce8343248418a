"""The smoothed distance as a thing to learn: accurate answers, tokens that know alpha, a loss that nothing breaks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import nqr_geom as ng
from nqr_geom.curves.families import control_points
from nqr_geom.curves.problems import SdProblem
from nqr_geom.curves.shapes import PackedShapes
from nqr_geom.curves.tokens import CURVE_TOKENS
from nqr_geom.curves.tokens_sd import SD_TOKENS
from nqr_geom.curves.training import near_distance
from nqr_geom.curves.training_sd import ALPHA, SIZES, quadratic_sd, sd_batch
from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.recipe import Batch, Recipe, draw_samples, inner_answer
from nqr_geom.integrator.learn.tokens import sort_samples, tokenize
from nqr_geom.integrator.learn.train import TrainConfig, loss, residuals, train
from nqr_geom.integrator.problem import Samples
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream

RECIPE = RECIPES["sd-uniform"]


def problem_of(control: Tensor, points: Tensor, alpha: float = ALPHA) -> SdProblem:
    index = torch.arange(len(control))
    return SdProblem(PackedShapes.from_quadratics(control), points, index, index, alpha=alpha)


def seen(problem: SdProblem, n: int = 32) -> Samples:
    samples = draw_samples(problem, RECIPE.designs, n, Stream(3, "validation"))
    return problem.finalize(sort_samples(samples))[0]


def exact(control: Tensor, points: Tensor, alpha: float = ALPHA) -> np.ndarray:
    curves = [ng.Curve.bezier(c) for c in control.numpy()]
    return np.array([ng.sd(c, p[None], alpha=alpha)[0] for c, p in zip(curves, points.numpy(), strict=True)])


@pytest.fixture(scope="module")
def shapes() -> tuple[Tensor, Tensor]:
    control = control_points(torch.arange(200), 4, "validation")
    return control, sd_batch(torch.arange(200), 4, "validation").problem.points


def test_answers_against_dense_quadrature() -> None:
    batch = sd_batch(torch.arange(12), 5, "validation")
    cells = 2**12
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at = (torch.arange(cells).double()[:, None] + torch.from_numpy(0.5 * (nodes + 1.0))) / cells
    s = ((at + torch.arange(6.0).double()[:, None, None]) / 6.0).reshape(1, -1, 1).expand(12, -1, 1)
    w = torch.from_numpy(0.5 * weights).repeat(6 * cells) / (6 * cells)
    inner = (batch.problem.evaluate(s).value[..., 0, 0] * w).sum(dim=1)
    np.testing.assert_allclose(-torch.log(inner) / ALPHA, batch.answer[:, 0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("alpha", [1.0, ALPHA, 90.0])
def test_answers_are_those_of_the_curve(shapes: tuple[Tensor, Tensor], alpha: float) -> None:
    control, points = shapes
    np.testing.assert_allclose(quadratic_sd(control, points, alpha), exact(control, points, alpha), rtol=0, atol=1e-9)


def test_answers_next_to_the_curve(shapes: tuple[Tensor, Tensor]) -> None:
    """A thousandth away from a point of every shape, where the distance has its kink."""
    control = shapes[0]
    t = 0.37
    near = (1 - t) ** 2 * control[:, 2, 0] + 2 * t * (1 - t) * control[:, 2, 1] + t**2 * control[:, 2, 2]
    points = near + 1e-3 * torch.tensor([0.6, 0.8], dtype=torch.float64)
    np.testing.assert_allclose(quadratic_sd(control, points), exact(control, points), rtol=0.0, atol=1e-9)


def test_one_training_integral_in_four_has_another_size() -> None:
    rows = torch.arange(400)
    for split in ("train", "validation", "test"):
        batch = sd_batch(rows, 2, split)
        plain, size = control_points(rows, 2, split)[:, 0, 0], batch.problem.shapes.coefficients[:, 0, 0]
        factor = size[:, 0] / plain[:, 0]
        np.testing.assert_allclose(size, factor[:, None] * plain, rtol=1e-12)
        others = rows % 4 == 0
        assert (factor[~others] - 1.0).abs().max() < 1e-12
        assert (batch.problem.points.abs().amax(dim=1) <= factor).all()  # the query is scaled with its shape
        if split == "train":
            assert factor[others].min() < 1.3 * SIZES[0]
            assert factor[others].max() > SIZES[1] / 1.3
            control = control_points(rows, 2, split) * factor[:, None, None, None]
            np.testing.assert_allclose(batch.answer[:, 0], exact(control, batch.problem.points), rtol=0.0, atol=1e-9)
        else:
            assert (factor - 1.0).abs().max() < 1e-12
            assert near_distance(control_points(rows, 2, split), batch.problem.points).min() >= 1e-3


def test_tokens_begin_with_those_of_winding_numbers(shapes: tuple[Tensor, Tensor]) -> None:
    samples = seen(problem_of(*shapes))
    tokens = SD_TOKENS.compute(samples)
    assert tokens.shape[-1] == SD_TOKENS.size
    assert torch.equal(tokens[..., : CURVE_TOKENS.size], CURVE_TOKENS.compute(samples))
    assert tokens.isfinite().all()


def test_tokens_know_lengths_in_units_of_one_over_alpha(shapes: tuple[Tensor, Tensor]) -> None:
    """Curve and query larger and alpha smaller by one factor: the same tokens, positions in pieces included."""
    control, points = shapes
    here = SD_TOKENS.compute(seen(problem_of(control, points)))
    there = SD_TOKENS.compute(seen(problem_of(7.0 * control, 7.0 * points, ALPHA / 7.0)))
    np.testing.assert_allclose(there, here, rtol=0.0, atol=2e-5)
    sharper = SD_TOKENS.compute(seen(problem_of(control, points, 2.0 * ALPHA)))
    assert (sharper[..., CURVE_TOKENS.size :] - here[..., CURVE_TOKENS.size :]).abs().amax(dim=(0, 1, 2)).min() > 0.05


def test_tokens_hold_the_integral_over_chords(shapes: tuple[Tensor, Tensor]) -> None:
    """On polygons of two samples a side the chords are the curve, and distance is nearly linear on short ones."""
    control = shapes[0].clone()
    control[:, :, 1] = 0.5 * (control[:, :, 0] + control[:, :, 2])
    points = shapes[1]
    samples = seen(problem_of(control, points), 768)
    weights, logs = (3.0 * SD_TOKENS.compute(samples).double()[:, :, 0, k] for k in (-2, -1))
    logs, value = logs[:, 0], samples.value[..., 0, 0]
    # The weights that a token proposes give that integral.
    np.testing.assert_allclose((value * weights.exp()).mean(dim=1), value.mean(dim=1) * logs.exp(), rtol=1e-4)
    truth = torch.from_numpy(exact(control, points))[:, None]
    inner = inner_answer(truth, problem_of(control, points).finalize(samples)[1])
    rows = near_distance(shapes[0], points) > 0.05
    np.testing.assert_allclose((samples.value.mean(dim=1)[:, 0, 0] * logs.exp())[rows], inner[rows, 0], rtol=0.05)


def test_residuals_are_relative_and_know_no_scale(shapes: tuple[Tensor, Tensor]) -> None:
    recipe = replace(RECIPE, base="uniform")
    net = INet(recipe.config)
    control, points = shapes
    results = []
    for scale in (1.0, 20.0):
        problem = problem_of(scale * control, scale * points, ALPHA / scale)
        answer = torch.from_numpy(exact(scale * control, scale * points, ALPHA / scale))[:, None]
        samples = sort_samples(draw_samples(problem, RECIPE.designs, 32, Stream(3, "validation")))
        with torch.no_grad():
            before, behind = residuals(recipe, net, Batch(problem, answer), samples)
        assert behind is not None
        # Relative to the larger of truth and estimate, the inner residual is 1 - exp(-|logarithm of their ratio|).
        np.testing.assert_allclose(-behind, -before.sign() * torch.log1p(-before.abs()), atol=1e-8)
        results.append((before, behind))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)


def shaken(recipe: Recipe, size: float) -> INet:
    """A network whose heads are not zero."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        net = INet(recipe.config)
        torch.nn.init.normal_(net.head.weight, std=size)
    return net


@pytest.mark.parametrize(("alpha", "scale"), [(1e-3, 1.0), (35.0, 1e-3), (35.0, 1e3), (1e6, 1.0), (1e6, 1e3)])
def test_the_loss_is_finite_whatever_comes(shapes: tuple[Tensor, Tensor], alpha: float, scale: float) -> None:
    """Queries on the curve and far from it, and a network that answers with any sign."""
    control = scale * shapes[0][:20]
    points = torch.cat([control[:7, 2, 0], 1e3 * scale * shapes[1][7:14], scale * shapes[1][14:20]])
    problem = problem_of(control, points, alpha)
    batch = Batch(problem, torch.from_numpy(exact(control, points, alpha))[:, None])
    samples = sort_samples(draw_samples(problem, RECIPE.designs, 16, Stream(3, "validation")))
    for size in (0.0, 1.0, 100.0):
        net = shaken(RECIPE, size)
        value = loss(RECIPE, net, batch, samples)
        value.backward()
        assert value.isfinite()
        assert all(p.grad is None or p.grad.isfinite().all() for p in net.parameters())


def test_estimates_that_are_not_positive_are_the_base(shapes: tuple[Tensor, Tensor]) -> None:
    problem = problem_of(*shapes)
    samples = seen(problem)
    rule = LearnedRule(shaken(RECIPE, 0.1), RECIPE.base_rule(), RECIPE.extra)
    torch.nn.init.zeros_(rule.net.head.weight[:2])
    with torch.no_grad():  # offsets alone, so large that they take away what is there, more or less
        rule.net.head.bias[2] -= 1.0 + rule.combine(samples).offset.mean() / samples.value.mean()
    loose = replace(RECIPE.config, positive=False)
    free = INet(loose)
    free.load_state_dict(rule.net.state_dict())
    raw = LearnedRule(free, rule.base, rule.extra).combine(samples).estimate(samples)[:, 0]
    assert 0.05 < (raw <= 0.0).double().mean() < 0.95
    combination = rule.combine(samples)
    assert torch.equal(combination.fallback, raw <= 0.0)
    expected = torch.where(raw > 0.0, raw, rule.base.combine(samples).estimate(samples)[:, 0])
    np.testing.assert_allclose(combination.estimate(samples)[:, 0], expected, rtol=1e-14)


def test_weights_grow_as_far_as_the_recipe_says(shapes: tuple[Tensor, Tensor]) -> None:
    samples = seen(problem_of(*shapes))
    for growth in (1.0, 8.0):
        config = replace(RECIPE.config, growth=growth, offset=False, positive=False)
        net = INet(config)
        torch.nn.init.constant_(net.head.bias[:1], 100.0)
        weights = LearnedRule(net, RECIPE.base_rule(), RECIPE.extra).combine(samples).weights
        np.testing.assert_allclose(weights, np.exp(growth), rtol=1e-6)


def test_a_run_may_start_from_one_with_fewer_quantities(tmp_path: Path, shapes: tuple[Tensor, Tensor]) -> None:
    """The new quantities weigh nothing at first: the trunk sees what the other one saw."""
    small = replace(RECIPES["gwn-uniform"].config, layers=1, width=16, reach=0, direct=False)
    less = replace(RECIPES["gwn-uniform"], config=replace(small, tokens=replace(small.tokens, unit=None)))
    more = replace(RECIPE, config=replace(RECIPE.config, layers=1, width=16))
    config = TrainConfig(iterations=2, batch=8, warmup=1, every=2, validation=16)
    first = train(less, tmp_path / "gwn", config, precision="32-true", progress=False)
    config = replace(config, iterations=1, rate=1e-30)
    second = train(more, tmp_path / "sd", config, start_from=tmp_path / "gwn", precision="32-true", progress=False)
    samples = seen(problem_of(*shapes))
    tokens = tokenize(samples, more.config.tokens, SD_TOKENS)[:, :, 0]
    plain = tokenize(samples, less.config.tokens, CURVE_TOKENS)[:, :, 0]
    with torch.no_grad():
        np.testing.assert_allclose(second.embed_in(tokens), first.embed_in(plain), atol=1e-5)
    with pytest.raises(ValueError, match="start_from: expected a run of the same tokens and width"):
        train(less, tmp_path / "back", config, start_from=tmp_path / "sd", precision="32-true", progress=False)
