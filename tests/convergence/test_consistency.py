"""Appendix C.2: at every N a shipped model is no worse than its network or its consistent rule alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from nqr_geom import registry
from nqr_geom.integrator.learn.train import draw_batch
from nqr_geom.recipes import RECIPES, model

Floats = NDArray[np.float64]

MODELS = [entry.name for entry in registry.entries("model") if entry.name in RECIPES]
# Integrals at each N: enough to see a network that answers where it should not, and no more.
INTEGRALS = {8: 512, 32: 512, 64: 256, 128: 128, 512: 48, 4096: 4}


@cache
@torch.no_grad()
def squared_errors(name: str, n: int) -> tuple[Floats, Floats, Floats]:
    """Of the model, of its network alone and of its consistent rule alone, on the same test samples, (B,) each."""
    made, recipe = model(name), RECIPES[name]
    batch, samples = draw_batch(recipe, torch.arange(INTEGRALS[n]), n, 7, "test")
    samples, link = batch.problem.finalize(samples)
    blend, learned, safe = (
        (link(rule.combine(samples).estimate(samples)) - batch.answer).square().mean(dim=1).numpy()
        for rule in (made, made.learned, made.consistent)
    )
    return blend, learned, safe


def worse(mine: Floats, other: Floats) -> bool:
    """Whether errors are clearly larger on the same integrals: in the mean, and beyond chance there or in orders."""

    def deviations(difference: Floats) -> float:
        spread = difference.std(ddof=1)
        return float(difference.mean() / spread * np.sqrt(len(difference))) if spread > 0.0 else 0.0

    orders = np.log(mine + 1e-30) - np.log(other + 1e-30)
    return mine.mean() > 1.25 * other.mean() and (deviations(mine - other) > 2.0 or deviations(orders) > 3.0)


@pytest.mark.parametrize("n", INTEGRALS)
@pytest.mark.parametrize("name", MODELS)
def test_the_blend_is_no_worse_than_either_part(name: str, n: int) -> None:
    blend, learned, safe = squared_errors(name, n)
    assert not worse(blend, learned)
    assert not worse(blend, safe)


@pytest.mark.parametrize("n", [512, 4096])
@pytest.mark.parametrize("name", [name for name in MODELS if not RECIPES[name].config.doubtful_only])
def test_so_many_integrals_tell_a_wrong_blend(name: str, n: int) -> None:
    """Far beyond training the network alone, which is what a share of 1 would give, fails the test above."""
    _, learned, safe = squared_errors(name, n)
    if worse(learned, safe):
        assert model(name).card.share(n) < 1.0  # a blend may be better than either


def test_most_networks_are_wrong_far_beyond_training() -> None:
    """So that the test above can fail."""
    beyond = [worse(*squared_errors(name, 4096)[1:]) for name in MODELS if not RECIPES[name].config.doubtful_only]
    assert sum(beyond) >= len(beyond) / 2


@pytest.mark.parametrize("name", [name for name in MODELS if RECIPES[name].config.tokens.dim == 1])
def test_errors_fall_to_nothing(name: str) -> None:
    """Consistent: 128 times the samples leave less than a thousandth of the error (walks keep that of their end)."""
    assert squared_errors(name, 4096)[0].mean() < 1e-3 * squared_errors(name, 32)[0].mean()
