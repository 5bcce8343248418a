"""Transmittance as a thing to learn: unbiased answers, rays that go everywhere, tokens without a scale, its loss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

import nqr_geom as ng
from nqr_geom import render
from nqr_geom.integrator.learn.inet import INet
from nqr_geom.integrator.learn.recipe import Batch, draw_samples, inner_answer
from nqr_geom.integrator.learn.tokens import sort_samples
from nqr_geom.integrator.learn.train import loss, residuals
from nqr_geom.integrator.problem import ExpLink, Problem, Samples
from nqr_geom.recipes import RECIPES
from nqr_geom.render import training
from nqr_geom.render.clamped import ClampedNoise
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.tokens import CONSTANTS, VOLUME_TOKENS
from nqr_geom.render.training import transmittance_batch
from nqr_geom.streams import Stream

RECIPE = RECIPES["transmittance-uniform"]
ROWS = torch.arange(400)


def seen(problem: Problem, designs: tuple[str, ...] = ("uniform-jitter",), n: int = 24) -> Samples:
    return sort_samples(draw_samples(problem, designs, n, Stream(3, "validation")))


def rays_of(batch: Batch) -> training.Rays:
    assert isinstance(batch.problem, TransmittanceProblem)
    return batch.problem.rays


def test_answers_are_those_of_the_clouds_that_the_public_family_gives() -> None:
    batch, clouds = transmittance_batch(torch.arange(6), 4, "validation"), ng.datasets.volumes(6, 4, "validation")
    rays = rays_of(batch)
    for k, cloud in enumerate(clouds):
        ray = rays.entry[k : k + 1].numpy(), rays.direction[k : k + 1].numpy(), 10.0
        truth = render.transmittance(cloud, *ray, n=4096, method="trapezoid")
        assert abs(truth[0] - batch.answer[k, 0]) < 1e-3
    assert (batch.answer < 0.9).any()


@pytest.mark.parametrize("split", ["train", "validation"])
def test_answers_are_far_better_than_what_is_learned(split: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = transmittance_batch(ROWS, 4, split).answer
    monkeypatch.setattr(training, "QUERIES", 4096)
    assert (transmittance_batch(ROWS, 4, split).answer - answer).square().mean() < 5e-7


def test_training_sees_other_constants_and_shorter_supports() -> None:
    batch = transmittance_batch(ROWS, 4, "train")
    rays, problem = rays_of(batch), batch.problem
    assert isinstance(problem, TransmittanceProblem)
    other, pieces = ROWS % 4 == 0, ROWS % 4 == 1
    density, constants = problem.medium.tensors["density"], problem.medium.constants
    assert (density[~other] == 1.0).all()
    assert density[other].min() < 0.4
    assert density[other].max() > 2.5
    for k, (low, high) in enumerate(((0.25, 2.0), (0.5, 2.0), (3.0, 7.0), (0.35, 0.65), (1.8, 2.2))):
        assert constants[other, k].min() < low + 0.1 * (high - low)
        assert constants[other, k].max() > high - 0.1 * (high - low)
        assert constants[~other, k].unique().numel() == 1
    straight = rays.direction[:, 2] == 1.0
    assert torch.equal(straight, ~other)
    assert torch.allclose(rays.direction.square().sum(dim=1), torch.ones(400).double())
    assert (rays.total > 0.0).all()
    whole = straight & (rays.total == 10.0)
    assert not (pieces & (batch.answer[:, 0] < 1.0) & whole).any()
    assert whole[~other & ~pieces].all()


def test_validation_and_test_are_the_family_itself() -> None:
    answers = []
    for split in ("train", "validation", "test"):
        batch = transmittance_batch(ROWS, 4, split)
        answers.append(batch.answer)
        if split != "train":
            assert (rays_of(batch).total == 10.0).all()
            assert 0.5 < (batch.answer == 1.0).double().mean() < 0.75
    assert all((one != two).double().mean() > 0.3 for one, two in zip(answers, answers[1:] + answers[:1], strict=True))
    part = transmittance_batch(ROWS[100:110], 4, "train")
    assert torch.equal(part.answer, transmittance_batch(ROWS, 4, "train").answer[100:110])


def scaled(problem: TransmittanceProblem, factor: float) -> TransmittanceProblem:
    """The same clouds in another unit of length."""
    tensors = dict(problem.medium.tensors)
    tensors["density"] = tensors["density"] / factor
    tensors["size"] = tensors["size"] * factor
    tensors["parts"] = tensors["parts"] * factor
    tensors["noise"] = tensors["noise"].clone()
    tensors["noise"][:, 1] /= factor
    rays = replace(
        problem.rays,
        **{name: getattr(problem.rays, name) * factor for name in ("entry", "near", "start", "length", "total")},
    )
    return replace(problem, medium=replace(problem.medium, tensors=tensors), rays=rays)


def test_tokens_know_no_unit_of_length() -> None:
    problem = transmittance_batch(ROWS, 4, "train").problem
    assert isinstance(problem, TransmittanceProblem)
    here = VOLUME_TOKENS.compute(seen(problem))
    there = VOLUME_TOKENS.compute(seen(scaled(problem, 64.0)))
    assert here.shape == (400, 24, 1, VOLUME_TOKENS.size)
    assert here.isfinite().all()
    # The noise is laid out in single precision, so a factor that is a power of two changes nothing but roundings.
    np.testing.assert_allclose(there, here, rtol=0.0, atol=2e-5)


def test_tokens_hold_the_answer_of_the_structured_rule() -> None:
    samples = seen(transmittance_batch(ROWS, 4, "train").problem, ("random", "uniform-jitter"))
    tokens = VOLUME_TOKENS.compute(samples).double()[:, :, 0]
    expected = ClampedNoise().combine(samples).estimate(samples)[:, 0]
    own, more = tokens[..., CONSTANTS + 6], tokens[..., CONSTANTS + 7]
    np.testing.assert_allclose(own.mean(dim=1), expected, rtol=1e-5, atol=1e-6)
    # What it adds to the plain weights, as an offset could.
    plain = samples.value.mean(dim=(1, 2, 3))
    np.testing.assert_allclose(plain + more.mean(dim=1), expected, rtol=1e-5, atol=2e-5)


def test_what_is_checked_belongs_to_the_ray() -> None:
    samples = seen(transmittance_batch(ROWS, 4, "train").problem)
    assert VOLUME_TOKENS.check is not None
    checked = VOLUME_TOKENS.check(samples)
    assert torch.equal(checked, VOLUME_TOKENS.compute(samples)[..., list(VOLUME_TOKENS.checked)])
    assert torch.equal(checked, checked[:, :1].expand_as(checked))


@pytest.mark.parametrize("factor", [0.0, 1e-60, 1e60])
def test_tokens_are_finite_whatever_comes(factor: float) -> None:
    samples = seen(transmittance_batch(ROWS[:8], 4, "train").problem)
    features = {name: factor * tensor for name, tensor in samples.seen.features.items()}
    wild = replace(samples, seen=replace(samples.seen, value=factor * samples.value, features=features))
    assert VOLUME_TOKENS.compute(wild).nan_to_num(nan=0.0, posinf=16.0, neginf=-16.0).isfinite().all()


def shaken(size: float) -> INet:
    """A network whose heads are not zero."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        net = INet(RECIPE.config)
        torch.nn.init.normal_(net.head.weight, std=size)
    return net


def test_residuals_are_in_depth_and_in_transmittance() -> None:
    batch = transmittance_batch(ROWS, 4, "train")
    samples = seen(batch.problem)
    with torch.no_grad():
        before, behind = residuals(RECIPE, INet(RECIPE.config), batch, samples)
    depth = samples.value.mean(dim=1)[:, 0]
    truth = -torch.log(batch.answer)
    assert behind is not None
    np.testing.assert_allclose(behind, torch.exp(-depth) - batch.answer, atol=1e-14)
    np.testing.assert_allclose(before, (depth - truth) / truth.clamp_min(1.0), atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1.0, 100.0])
def test_the_loss_is_finite_whatever_the_network_says(size: float) -> None:
    net = shaken(size)
    batch = transmittance_batch(ROWS[:32], 4, "train")
    value = loss(RECIPE, net, batch, seen(batch.problem))
    value.backward()
    assert value.isfinite()
    assert all(p.grad is None or p.grad.isfinite().all() for p in net.parameters())


def test_depths_below_zero_are_pulled_back() -> None:
    """The answer is clamped there, which has no slope; the training loss has one."""
    batch = transmittance_batch(ROWS[:32], 4, "train")
    net = shaken(0.0)
    with torch.no_grad():
        net.head.bias[-1] = -2.0  # the offset
    loss(replace(RECIPE, inner=0.0, outer=1.0), net, batch, seen(batch.problem)).backward()
    gradient: Tensor | None = net.head.bias.grad
    assert gradient is not None
    assert gradient[-1] < 0.0


def test_a_transmittance_that_is_not_seen_has_a_depth() -> None:
    answer = torch.tensor([[1.0], [0.5], [0.0]], dtype=torch.float64)
    depth = inner_answer(answer, ExpLink())
    assert depth[:2, 0].tolist() == [0.0, pytest.approx(np.log(2.0))]
    assert depth.isfinite().all()
