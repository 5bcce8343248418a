"""Direct light as a thing to learn: rooms with answers that are kept, and tokens that know no brightness."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj
from nqr_geom.render import direct_training
from nqr_geom.render.direct_rules import KnownLight
from nqr_geom.render.direct_tokens import LAMP_TOKENS
from nqr_geom.render.direct_training import direct_batch
from nqr_geom.streams import Stream

ROWS = torch.arange(60)
BALANCE, PART, STEADY = 6, 14, 25  # places in a token


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


def test_tokens_hold_what_the_rule_of_known_light_makes_of_a_sample() -> None:
    samples = seen()
    tokens = LAMP_TOKENS.compute(samples).double()
    assert tokens.shape == (60, 16, 2, LAMP_TOKENS.size)
    assert tokens.isfinite().all()
    balance = BalanceHeuristic().combine(samples).weights
    np.testing.assert_allclose(tokens[..., BALANCE], balance[..., 0], rtol=1e-6, atol=1e-7)
    known = KnownLight().combine(samples)
    factors = torch.exp(3.0 * tokens[..., BALANCE + 1 : BALANCE + 4])
    counts = balance[..., 0] > 0.0
    np.testing.assert_allclose((factors * balance)[counts], known.weights[counts], rtol=1e-4)
    unit = samples.value.abs().mean(dim=(1, 2)).clamp_min(1e-300)
    weighted = ((known.weights * samples.value).sum(dim=2).mean(dim=1) / unit).mean(dim=1)
    lit = (samples.value > 0.0).any(dim=(1, 2)).all(dim=1)
    assert lit.sum() > 20
    np.testing.assert_allclose(tokens[..., STEADY].expm1().sum(dim=2).mean(dim=1)[lit], weighted[lit], rtol=1e-4)


def test_tokens_tell_how_much_of_its_lamp_a_row_sees() -> None:
    samples = seen()
    tokens = LAMP_TOKENS.compute(samples).double()
    light, visible = (samples.feature(name, "test")[..., 0] for name in ("light", "visible"))
    part, shown, squares = tokens[..., PART], tokens[..., PART + 1], tokens[..., PART + 2]
    met = 0
    for row in range(60):
        for j in light[row].unique().tolist():
            of = (light[row] == j) & (part[row] > 0.0)
            if j < 0.0 or not of.any():
                continue
            met += 1
            mine = part[row][of]
            assert mine.sum() == pytest.approx(1.0, abs=1e-5)
            assert (mine * visible[row][of]).sum() == pytest.approx(shown[row][of][0].item(), abs=1e-5)
            assert mine.square().sum() == pytest.approx(squares[row][of][0].item(), abs=1e-5)
    assert met > 60


def test_tokens_know_no_brightness_and_no_order() -> None:
    samples = seen()
    here = LAMP_TOKENS.compute(samples)
    scaled = ("incident", "radiance", "unhidden", "known", "known_all", "expected")
    bright = {name: tensor * (8.0 if name in scaled else 1.0) for name, tensor in samples.seen.features.items()}
    brighter = replace(samples, seen=replace(samples.seen, value=8.0 * samples.value, features=bright))
    np.testing.assert_allclose(LAMP_TOKENS.compute(brighter), here, rtol=1e-6, atol=1e-6)
    order = torch.arange(15, -1, -1).expand(60, 16)
    turned = LAMP_TOKENS.compute(samples.permuted(order))
    np.testing.assert_allclose(turned.flip(1), here, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("factor", [0.0, 1e-60, 1e60])
def test_tokens_are_finite_whatever_comes(factor: float) -> None:
    samples = seen()
    features = {name: factor * tensor for name, tensor in samples.seen.features.items()}
    wild = replace(samples, seen=replace(samples.seen, value=factor * samples.value, features=features))
    assert LAMP_TOKENS.compute(wild).nan_to_num(nan=0.0, posinf=16.0, neginf=-16.0).isfinite().all()


def test_what_is_checked_begins_the_tokens() -> None:
    samples = seen()
    assert LAMP_TOKENS.check is not None
    assert torch.equal(LAMP_TOKENS.check(samples), LAMP_TOKENS.compute(samples)[..., :3])
