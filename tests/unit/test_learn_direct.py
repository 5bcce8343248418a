"""Direct light as a thing to learn: rooms with answers that are kept, and tokens that know no brightness."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.integrator.learn.tokens import Extra
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj
from nqr_geom.render import direct_training
from nqr_geom.render.direct_rules import KnownLight, UnhiddenLight
from nqr_geom.render.direct_tokens import DIRECT_TOKENS, KNOWN_TOKENS
from nqr_geom.render.direct_training import direct_batch
from nqr_geom.streams import Stream

ROWS = torch.arange(60)
FIRST = 3 + 2 + 30 + 18 + 3 + 1  # the contributions by the balance heuristic, then those of the structured rule


@pytest.fixture(autouse=True)
def few_rooms(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    direct_training.pool.cache_clear()
    monkeypatch.setenv("NQR_GEOM_CACHE", str(tmp_path))
    monkeypatch.setattr(direct_training, "ROOMS", dict.fromkeys(("train", "validation", "test"), 2))
    monkeypatch.setattr(direct_training, "RESOLUTION", 6)
    monkeypatch.setattr(direct_training, "PASSES", 64)


def seen(split: str = "train") -> Samples:
    return draw_samples(direct_batch(ROWS, 3, split).problem, ("pmj", "random"), 16, Stream(1, "validation"))


def test_answers_are_those_of_other_passes(tmp_path: Path) -> None:
    batch = direct_batch(ROWS, 3, "validation")
    other = run(batch.problem, Pmj(), BalanceHeuristic(), 256, replicates=8, seed=5)
    assert other.stderr is not None
    off = (batch.answer.numpy() - other.value) / (2.0 * other.stderr + 1e-3)
    assert np.abs(off).mean() < 1.0
    assert len(list(tmp_path.glob("direct/*.npy"))) == 1
    direct_training.pool.cache_clear()
    assert torch.equal(direct_batch(ROWS, 3, "validation").answer, batch.answer)


def test_training_looks_at_lit_pixels_and_splits_at_rooms_of_their_own() -> None:
    answers = {split: direct_batch(ROWS, 3, split).answer for split in ("train", "validation", "test")}
    assert (answers["train"] > 0.0).any(dim=1).all()
    assert not (answers["test"] > 0.0).any(dim=1).all()
    for one, other in (("train", "validation"), ("validation", "test"), ("test", "train")):
        same = (answers[one][:, None] == answers[other][None]).all(dim=-1) & (answers[one] > 0.0).any(dim=1)[:, None]
        assert not same.any()
    batch = direct_batch(ROWS[20:30], 3, "train")
    assert torch.equal(batch.answer, answers["train"][20:30])
    assert torch.equal(batch.problem.rows, ROWS[20:30])


def test_tokens_hold_the_balance_heuristic_and_the_structured_rule() -> None:
    samples = seen()
    tokens = DIRECT_TOKENS.compute(samples).double()
    assert tokens.shape == (60, 16, 2, DIRECT_TOKENS.size)
    assert tokens.isfinite().all()
    unit = samples.value.abs().mean(dim=(1, 2))
    for first, rule in ((FIRST, BalanceHeuristic()), (FIRST + 3, UnhiddenLight())):
        shares = tokens[..., first : first + 3].expm1().sum(dim=2).mean(dim=1) * unit
        combination = rule.combine(replace(samples, design="pmj"))
        weighted = (combination.weights * samples.value).sum(dim=2).mean(dim=1)
        rows = torch.ones(60, dtype=torch.bool)
        if combination.offset is not None:  # lights that may be missed are another matter
            rows = (samples.feature("chance", "test")[samples.feature("light", "test") >= 0].min() >= 0.125).expand(60)
            rows = rows | (combination.offset.abs().amax(dim=1) == 0.0)
        assert rows.sum() > 5
        np.testing.assert_allclose(shares[rows], weighted[rows], rtol=2e-4, atol=1e-5)


def test_tokens_of_known_light_go_on_with_what_its_rule_makes_of_a_sample() -> None:
    samples = seen()
    tokens = KNOWN_TOKENS.compute(samples)
    assert tokens.shape == (60, 16, 2, KNOWN_TOKENS.size)
    assert torch.equal(tokens[..., : DIRECT_TOKENS.size], DIRECT_TOKENS.compute(samples))
    assert tokens.isfinite().all()
    combination = KnownLight().combine(samples)
    weighted = (combination.weights * samples.value).sum(dim=2).mean(dim=1)
    unit = samples.value.abs().mean(dim=(1, 2))
    shares = tokens[..., DIRECT_TOKENS.size :][..., :3].double().expm1().sum(dim=2).mean(dim=1) * unit
    np.testing.assert_allclose(shares, weighted, rtol=2e-4, atol=1e-5)
    seen_of_light = tokens[..., DIRECT_TOKENS.size + 10]
    assert (seen_of_light >= 0.0).all()
    assert (seen_of_light <= 1.0 + 1e-6).all()


@pytest.mark.parametrize("kind", [DIRECT_TOKENS, KNOWN_TOKENS], ids=["direct", "known"])
def test_tokens_know_no_brightness_and_no_order(kind: Extra) -> None:
    samples = seen()
    here = kind.compute(samples)
    scaled = ("incident", "radiance", "unhidden", "known", "known_all", "expected")
    bright = {name: tensor * (8.0 if name in scaled else 1.0) for name, tensor in samples.seen.features.items()}
    brighter = replace(samples, seen=replace(samples.seen, value=8.0 * samples.value, features=bright))
    np.testing.assert_allclose(kind.compute(brighter), here, rtol=1e-6, atol=1e-6)
    order = torch.arange(15, -1, -1).expand(60, 16)
    turned = kind.compute(samples.permuted(order))
    np.testing.assert_allclose(turned.flip(1), here, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("factor", [0.0, 1e-60, 1e60])
def test_tokens_are_finite_whatever_comes(factor: float) -> None:
    samples = seen()
    features = {name: factor * tensor for name, tensor in samples.seen.features.items()}
    wild = replace(samples, seen=replace(samples.seen, value=factor * samples.value, features=features))
    assert DIRECT_TOKENS.compute(wild).nan_to_num(nan=0.0, posinf=16.0, neginf=-16.0).isfinite().all()


def test_what_is_checked_begins_the_tokens() -> None:
    samples = seen()
    assert DIRECT_TOKENS.check is not None
    assert torch.equal(DIRECT_TOKENS.check(samples), DIRECT_TOKENS.compute(samples)[..., :3])
