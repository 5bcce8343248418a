"""What the rule for pieces leaves open, and that no sampling network leaves a piece unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from nqr_geom import registry
from nqr_geom.integrator.learn.inet import INet, INetConfig, LearnedRule, doubt
from nqr_geom.integrator.learn.snet import LearnedSampler
from nqr_geom.integrator.learn.train import expected_error, robust
from nqr_geom.recipes import JOINT, RECIPES
from nqr_geom.streams import Stream
from nqr_geom.toy.gaps import ToyGaps
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.tokens import TOY_TOKENS, toy_doubt

STREAM = Stream(4, "validation")
PROBLEM = ToyProblem(torch.arange(512), 4, "validation")
RECIPE = JOINT["toy-nqr"].rule


def test_the_doubt_is_the_error_in_the_mean() -> None:
    samples = registry.make("sampler", "toy-split").draw(PROBLEM, 32, STREAM)
    rule = registry.make("rule", "toy-hermite")
    error = (rule.combine(samples).estimate(samples)[:, 0].numpy() - PROBLEM.reference()[:, 0]) ** 2
    expected = expected_error(RECIPE, samples)
    assert expected is not None
    assert 0.5 < error.mean() / expected.mean().item() < 2.0
    assert np.corrcoef(np.sqrt(error), expected[:, 0].sqrt().numpy())[0, 1] > 0.3


def test_the_doubt_follows_its_sample_in_any_order() -> None:
    samples = registry.make("sampler", "random").draw(PROBLEM, 12, STREAM)
    order = torch.rand(512, 12, generator=torch.Generator().manual_seed(0)).argsort(dim=1)
    assert_allclose(toy_doubt(samples.permuted(order)), toy_doubt(samples).gather(1, order), rtol=1e-12)


def test_a_network_in_units_of_doubt_cannot_spoil_what_is_exact() -> None:
    samples = registry.make("sampler", "toy-split").draw(PROBLEM, 48, STREAM)
    base = RECIPE.base_rule()
    truth = torch.from_numpy(PROBLEM.reference())
    errors = []
    for config in (RECIPE.config, replace(RECIPE.config, in_doubt=False)):
        net = INet(config)
        torch.nn.init.normal_(net.head.weight, std=0.01, generator=torch.Generator().manual_seed(0))
        estimate = LearnedRule(net, base, RECIPE.extra).combine(samples).estimate(samples)
        errors.append((estimate - truth).square().mean().item())
    plain = (base.combine(samples).estimate(samples) - truth).square().mean().item()
    assert errors[0] < 10.0 * plain
    assert errors[1] > 1e4 * plain


def test_doubt_needs_an_application_that_tells_it() -> None:
    samples = registry.make("sampler", "random").draw(PROBLEM, 4, STREAM)
    with pytest.raises(ValueError, match="doubt"):
        doubt(samples, replace(TOY_TOKENS, doubt=None))
    assert expected_error(RECIPES["toy-uniform"], samples) is None
    assert not INetConfig().in_doubt


def test_losses_are_in_units_of_what_is_expected() -> None:
    error, unit = torch.tensor([[1e-3], [2e-4]]).double(), torch.tensor([[1e-6], [1e-8]]).double()
    assert_allclose(robust(RECIPE, error, None, unit), robust(RECIPE, torch.tensor([[1.0], [2.0]]).double(), None))


class Lazy(ToyGaps):
    """A sampler that never looks into a gap within a piece unless it must."""

    def worth(self) -> torch.Tensor:
        worth, used = super().worth(), slice(0, self.used)
        within = (self.ends[0][:, used] == self.ends[1][:, used]) & (worth < 100.0)
        return torch.where(within, worth - 50.0, worth)


def test_pieces_are_known_in_the_end_however_lazy_a_sampler_is() -> None:
    sampler = LearnedSampler(replace(JOINT["toy-nqr"], view=Lazy).snet())
    samples = sampler.draw(PROBLEM, 32, STREAM)
    rule = registry.make("rule", "toy-hermite")
    error = (rule.combine(samples).estimate(samples)[:, 0].numpy() - PROBLEM.reference()[:, 0]) ** 2
    assert error.max() < 1e-3  # without the samples that are kept for them 1e-2 and more
    assert np.median(error) < 2e-7


def test_where_samples_are_plenty_nothing_is_forced() -> None:
    many, few = ToyGaps(PROBLEM, 64), ToyGaps(PROBLEM, 4)
    assert bool((many.worth() < 100.0).all())
    assert_array_equal(many.worth() + 1e3, few.worth())


def test_weights_count_integrals() -> None:
    error = torch.tensor([[1.0], [2.0], [4.0]], dtype=torch.float64)
    twice = robust(RECIPE, error[[0, 0, 1]], None)
    assert_allclose(robust(RECIPE, error, None, weight=torch.tensor([2.0, 1.0, 0.0]).double()), twice)
