"""The sampling network of direct light: a grid for each technique, rounds of samples, and what it knows of lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

import nqr_geom as ng
from nqr_geom.integrator.learn.slabs import Slabs
from nqr_geom.integrator.learn.snet import SNet, SNetConfig
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj
from nqr_geom.recipes import JOINT
from nqr_geom.render.direct_known import spans
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.direct_rules import KnownLight
from nqr_geom.render.direct_slabs import SIGHT_TOKENS, LampSlabs, lamp_credit, luminance
from nqr_geom.streams import Stream
from nqr_geom.toy.gaps import ToyGaps

STREAM = Stream(3, "validation")
ROOM = DirectProblem.family(1, seed=5, split="validation", resolution=12)
LIT = ROOM.take(torch.from_numpy(ROOM.reference()).amin(dim=1).nonzero()[:, 0])
PAIR = JOINT["direct-nqr"]


def disturbed(size: float = 0.3) -> SNet:
    """The network with random weights everywhere."""
    net = PAIR.snet()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(2)
        for parameter in net.parameters():
            parameter.data.add_(size * torch.randn_like(parameter) / parameter.shape[-1] ** 0.5)
        assert net.head.query is not None
        net.head.query.bias.data.fill_(0.7)  # lamps by their worth and doubt
    return net.eval()


def placed(net: SNet, problem: DirectProblem, n: int, keys: torch.Tensor | None = None) -> Samples:
    with torch.no_grad():
        return net.sample(problem, n, STREAM, keys).samples


def test_the_untrained_network_places_rounds_of_stratified_points() -> None:
    samples = placed(PAIR.snet(), ROOM, 20)
    first = 0
    for count in (8, 8, 4):
        expected = Pmj().points(ROOM.rows, count, 6, STREAM.child(f"round {first}"))
        assert_allclose(samples.x[:, first : first + count], expected, rtol=0.0, atol=1e-13)
        first += count
    assert samples.pdf is not None
    assert_allclose(samples.pdf, 1.0, rtol=1e-6)


@pytest.mark.parametrize("even", [True, False])
def test_each_technique_has_the_density_of_its_own_numbers(even: bool) -> None:
    pixel = LIT.take(torch.full((4096,), len(LIT.rows) // 2))
    with torch.no_grad():
        samples = disturbed().sample(pixel, 12, STREAM, torch.arange(4096), even=even).samples
    assert samples.pdf is not None
    assert samples.pdf.shape == (4096, 12, 2)
    assert (samples.pdf[..., 0] - samples.pdf[..., 1]).abs().min() < (samples.pdf[..., 0] - samples.pdf[..., 1]).std()
    for t, axes in enumerate(((0, 1, 2), (3, 4, 5))):
        weight = 1.0 / samples.pdf[..., t].double()
        assert weight.std() > 0.1
        x = samples.x[..., axes]
        # Integrals over the cube of that technique's numbers alone, by its density alone, in both rounds.
        for g, exact in ((torch.ones_like(weight), 1.0), (x[..., 0], 0.5), (x.prod(dim=-1), 0.125)):
            for part in (slice(0, 8), slice(8, 12)):
                terms = (g * weight)[:, part].mean(dim=1)
                assert abs(terms.mean() - exact) < 4.5 * terms.std() / 64.0


def test_the_floor_defends_every_place() -> None:
    net = disturbed(3.0)
    samples = placed(net, LIT, 16)
    assert samples.pdf is not None
    assert samples.pdf.min() >= 0.999 * net.config.floor
    assert samples.pdf.min() < 1.5 * net.config.floor
    assert samples.pdf.max() > 10.0


def test_the_importance_weighted_estimate_is_unbiased() -> None:
    net = disturbed()
    for at in (len(LIT.rows) // 3, len(LIT.rows) // 2, len(LIT.rows) - 3):
        pixel = LIT.take(torch.full((4096,), at))
        samples = placed(net, pixel, 16, torch.arange(4096))
        means = BalanceHeuristic().combine(samples).estimate(samples).numpy()
        truth = LIT.take(slice(at, at + 1)).reference()[0]
        assert (np.abs(means.mean(axis=0) - truth) < 4.5 * means.std(axis=0) / 64.0 + 2e-3 * truth).all()


def test_all_rounds_know_the_same_of_their_lamps() -> None:
    samples = placed(disturbed(), ROOM, 24)
    everything = samples.seen.features["known_all"]
    assert torch.equal(everything, everything[:, :1, :1].expand_as(everything))
    estimate = KnownLight().combine(samples).estimate(samples)
    assert (estimate >= 0.0).all()
    assert (estimate <= everything[:, 0, 0] * (1.0 + 1e-9) + 1e-12).all()


def test_slabs_hold_the_density_of_lamps_by_what_they_would_send() -> None:
    slabs = LampSlabs(ROOM, 16, (8, 8))
    density = slabs.ahead()[:, 8:, 0].double().exp() - 0.05
    worth = luminance(slabs.known)
    lit = (worth.sum(dim=1) > 0.0) & ((worth > 0.0) <= (spans(ROOM)[..., 1] > 0.0)).all(dim=1)
    assert lit.sum() > 20
    assert_allclose(density[lit].mean(dim=1), 1.0, rtol=1e-5)
    assert not slabs.ahead()[:, :8].any()
    assert not slabs.ahead()[..., 1].any()
    # Once a lamp's samples disagree, and another's do not, its slabs count more.
    slabs.note(slabs.evaluate(Pmj().points(ROOM.rows, 8, 6, STREAM)))
    change = slabs.ahead()[:, 8:, 1]
    assert (change > 0.1).any()
    assert (change < -0.1).any()


def test_credit_goes_to_samples_in_proportion_to_the_variance_that_they_bring() -> None:
    """Along the density's rise with it the variance of the rule's linear part falls, by an independent estimate."""
    half_hidden = LIT.take(torch.arange(len(LIT.rows)).repeat_interleave(64))
    net = PAIR.snet()
    with torch.no_grad():
        samples = net.sample(half_hidden, 16, STREAM, torch.arange(half_hidden.batch), even=False).samples
    credit = lamp_credit(samples, 64)
    assert credit.shape == (half_hidden.batch, 16, 2)
    assert_allclose(credit.view(-1, 64 * 16, 2).mean(dim=1), 0.0, atol=1e-9)
    visible, light = (samples.feature(name, "test")[..., 0] for name in ("visible", "light"))
    agree = torch.zeros(len(LIT.rows), dtype=torch.bool)
    for j in range(int(light.max()) + 1):
        of = (light == j).view(len(LIT.rows), -1)
        seen = visible.view(len(LIT.rows), -1)
        agree |= (of & (seen > 0.0)).any(dim=1) & (of & (seen == 0.0)).any(dim=1)
    busy = credit.view(len(LIT.rows), -1).abs().amax(dim=1) > 0.5
    assert busy.any()
    assert not (busy & ~agree).any()  # nothing is learned where samples of a lamp say the same
    # A sample that met no lamp brings no variance: it counts least.
    missed = credit[light < 0.0]
    assert (missed <= 0.0).all()


def test_a_network_without_knowledge_of_slabs_is_one_of_a_plain_grid() -> None:
    config = replace(PAIR.sampler, together=3)
    net = SNet(config, None, SIGHT_TOKENS)
    assert net.head.slabs is Slabs
    samples = placed(net, ROOM, 7)
    assert samples.x.shape == (ROOM.batch, 7, 6)


def test_bad_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="grid: expected a group for each of 2 techniques, got 1"):
        SNetConfig(TokenConfig(dim=6), head="grid", grid=((2,) * 6,), techniques=2)
    with pytest.raises(ValueError, match="together: expected 1 of the head 'gap', got 4"):
        SNetConfig(TokenConfig(), together=4)
    with pytest.raises(ValueError, match="problem: expected 'direct', got 'toy'"):
        LampSlabs(ng.problems.toy(1), 16, (8, 8))
    with pytest.raises(ValueError, match="grid: expected 8 cells on the first axis"):
        LampSlabs(ROOM, 16, (4, 4))

    with pytest.raises(ValueError, match="view: the head 'grid' needs a type of Slabs"):
        SNet(PAIR.sampler, ToyGaps, SIGHT_TOKENS)


def test_tokens_of_the_sampler_are_finite_and_know_no_brightness() -> None:
    samples = placed(PAIR.snet(), ROOM, 8)
    tokens = SIGHT_TOKENS.compute(samples)
    assert tokens.shape == (ROOM.batch, 8, 2, SIGHT_TOKENS.size)
    assert tokens.isfinite().all()
    scaled = ("known", "known_all", "expected")
    bright = {name: tensor * (8.0 if name in scaled else 1.0) for name, tensor in samples.seen.features.items()}
    brighter = replace(samples, seen=replace(samples.seen, value=8.0 * samples.value, features=bright))
    assert_array_equal(SIGHT_TOKENS.compute(brighter), tokens)


def test_pixels_that_are_drawn_more_often_count_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weighted means over what training draws are means over all lit pixels, whatever the doubts."""
    from nqr_geom.render import direct_training

    lit = torch.arange(0, len(ROOM.rows), 2)
    doubt = torch.zeros(len(ROOM.rows), dtype=torch.float64)
    doubt[lit[::5]] = 3.0
    answer = Stream(8).uniform(ROOM.rows[:, None], torch.arange(3))
    rooms = direct_training.Pool(ROOM, answer, lit)
    monkeypatch.setattr(direct_training, "pool", lambda split, seed: rooms)
    monkeypatch.setattr(direct_training, "doubts", lambda split, seed: doubt)
    direct_training._by_doubt.cache_clear()
    batch = direct_training.doubtful_batch(torch.arange(20_000), 0, "train")
    direct_training._by_doubt.cache_clear()
    assert batch.weight is not None
    assert batch.weight.min() < 0.5
    assert batch.weight.max() > 2.0
    assert_allclose((batch.weight[:, None] * batch.answer).mean(dim=0), answer[lit].mean(dim=0), rtol=5e-3)
    part = batch.take(torch.arange(3, 9))
    assert part.weight is not None
    assert torch.equal(part.weight, batch.weight[3:9])
    assert torch.equal(part.answer, batch.answer[3:9])
