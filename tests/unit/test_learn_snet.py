"""The sampling network: its densities, its base samplers, and that nothing depends on the batch."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.gaps import CurveGaps, SdGaps
from nqr_geom.curves.training import gwn_batch
from nqr_geom.curves.training_sd import sd_batch
from nqr_geom.integrator.learn.snet import LearnedSampler, SNet, SNetConfig
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.problem import Feature, Observation, Problem, Schema
from nqr_geom.integrator.rules import MonteCarlo
from nqr_geom.recipes import JOINT
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.training import transmittance_batch
from nqr_geom.streams import Stream
from nqr_geom.toy.gaps import ToyGaps
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.steps import LaplaceWalks

STREAM = Stream(3, "validation")
ROOM = DirectProblem.family(1, seed=5, split="validation", resolution=18)
GRID = SNetConfig(JOINT["toy-nqr"].sampler.tokens, head="grid", grid=((16,),))
STEP = SNetConfig(TokenConfig(dim=12, unit=1.0, frequencies=1), head="step", bins=16)
NETS = {name: recipe.snet for name, recipe in JOINT.items()} | {
    "toy-grid": lambda: SNet(GRID),
    "walk": lambda: SNet(STEP, LaplaceWalks),
}


def problem_of(name: str, n: int) -> Problem:
    rows = torch.arange(n)
    if name in ("walk", "laplace-nqr"):
        return LaplaceProblem.family(1, 5, "validation", points=n)
    if name == "direct-nqr":
        return ROOM.take(torch.arange(80, 80 + n) % ROOM.batch)
    if name.startswith("transmittance"):
        return transmittance_batch(rows, 5, "validation").problem
    if name.startswith("sd"):
        return sd_batch(rows, 5, "validation").problem
    return gwn_batch(rows, 5, "validation").problem if name.startswith("gwn") else ToyProblem(rows, 5, "validation")


def disturbed(make: Callable[[], SNet], size: float = 0.5) -> SNet:
    """A network with random weights everywhere, the zero-initialised ones included; the same in every process."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        net = make()
        for parameter in net.parameters():
            parameter.data.add_(size * torch.randn_like(parameter) / math.sqrt(parameter.shape[-1]))
    return net.eval()


class Cube(Problem):
    """A smooth function of six variables: for the grid head in more than one dimension."""

    name, dim, schema = "cube", 6, Schema()

    def __init__(self, rows: torch.Tensor) -> None:
        self.rows = rows

    def evaluate(self, x: torch.Tensor) -> Observation:
        return Observation(x.sum(dim=2)[..., None, None].exp(), queries=x.shape[0] * x.shape[1])

    def take(self, index: slice | torch.Tensor) -> Cube:
        return Cube(self.rows[index])


@pytest.mark.parametrize("layers", [1, 3])
def test_the_last_state_alone_is_the_last_of_all(layers: int) -> None:
    trunk = disturbed(lambda: SNet(replace(GRID, layers=layers))).trunk
    tokens = Stream(4).uniform(torch.arange(7)[:, None, None], torch.arange(9)[:, None], torch.arange(100))
    tokens = tokens[..., : trunk.embed_in.in_features].float()
    with torch.no_grad():
        assert_allclose(trunk.last(tokens), trunk(tokens)[:, -1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", NETS)
@pytest.mark.parametrize("trained", [False, True])
def test_sampling_and_scoring_agree(name: str, trained: bool) -> None:
    net = disturbed(NETS[name]) if trained else NETS[name]().eval()
    with torch.no_grad():
        rollout = net.sample(problem_of(name, 40), 24, STREAM)
        scored = net.log_prob(rollout)
    drawn = rollout.samples.pdf
    assert drawn is not None
    assert torch.isfinite(scored).all()
    together = drawn.prod(dim=-1) if net.config.techniques > 1 else drawn[..., 0]
    assert_allclose(scored.double().exp(), together, rtol=2e-4)
    assert drawn.min() >= 0.999 * net.config.floor**net.config.tokens.dim  # of every coordinate


@pytest.mark.parametrize("name", [name for name in NETS if name not in ("walk", "laplace-nqr")])
def test_the_density_is_that_of_the_points(name: str) -> None:
    """1/p of a point averages to one, and probabilities of its place are uniform, whatever the network says."""
    net = disturbed(NETS[name])
    problem = problem_of(name, 1).take(torch.zeros(4096, dtype=torch.int64))
    keys = torch.arange(4096)
    with torch.no_grad():
        samples = net.sample(problem, 3, STREAM, keys).samples
    assert samples.pdf is not None
    for i in range(3):
        p, x = samples.pdf[:, i, 0].numpy(), samples.x[:, i, 0].numpy()
        # The integral of g over [0, 1] by importance sampling, for three g whose integrals are known.
        for g, exact in ((np.ones_like(x), 1.0), (x, 0.5), ((x > 0.3).astype(float), 0.7)):
            terms = g / p
            assert abs(terms.mean() - exact) < 4.5 * terms.std() / 64.0


def test_an_untrained_pair_of_the_papers_form_is_uniform() -> None:
    net = JOINT["toy-nqr-uniform"].snet()
    with torch.no_grad():
        samples = net.sample(problem_of("toy", 256), 8, STREAM).samples
    assert samples.pdf is not None
    assert_allclose(samples.pdf, 1.0, atol=2e-6)
    assert stats.kstest(samples.x[:, 7, 0].numpy(), "uniform").pvalue > 1e-3


def test_an_untrained_network_comes_near_the_structured_sampler() -> None:
    problem = ToyProblem(torch.arange(512), 5, "validation")
    truth, rule = torch.as_tensor(problem.reference()), registry.make("rule", "toy-hermite")
    with torch.no_grad():
        mine, theirs, uniform = (
            (rule.combine(s).estimate(s) - truth).square().mean().item()
            for s in (
                JOINT["toy-nqr"].snet().sample(problem, 32, STREAM).samples,
                registry.make("sampler", "toy-split").draw(problem, 32, STREAM),
                registry.make("sampler", "random").draw(problem, 32, STREAM),
            )
        )
    assert mine < 4.0 * theirs < 1e-2 * uniform


@pytest.mark.parametrize("name", NETS)
def test_an_integral_sees_the_same_samples_in_any_batch(name: str) -> None:
    sampler = LearnedSampler(disturbed(NETS[name]))
    problem = problem_of(name, 300)
    whole = sampler.draw(problem, 12, STREAM)
    for part in (slice(0, 1), slice(70, 71), slice(250, 300), torch.tensor([299, 3, 120])):
        alone = sampler.draw(problem.take(part), 12, STREAM)
        assert_array_equal(alone.x, whole.x[part])
        assert alone.pdf is not None
        assert whole.pdf is not None
        assert_array_equal(alone.pdf, whole.pdf[part])


def test_beyond_what_the_network_places_points_are_stratified() -> None:
    sampler = LearnedSampler(JOINT["toy-nqr"].snet(), most=8)
    problem = problem_of("toy", 5)
    samples = sampler.draw(problem, 40, STREAM)
    assert_array_equal(samples.x[:, :8], sampler.draw(problem, 8, STREAM).x)
    assert_array_equal((samples.x[:, 8:, 0] * 32).long(), torch.arange(32).expand(5, 32))
    assert samples.pdf is not None
    assert samples.value.shape == (5, 40, 1, 1)
    assert samples.seen.queries == 5 * 40


def test_a_grid_in_six_dimensions_with_two_groups() -> None:
    config = SNetConfig(TokenConfig(dim=6), head="grid", grid=((4, 4, 4), (4, 4, 4)))
    net = disturbed(lambda: SNet(config))
    problem = Cube(torch.arange(2048))
    with torch.no_grad():
        rollout = net.sample(problem, 6, STREAM)
        scored = net.log_prob(rollout)
    samples = rollout.samples
    assert samples.pdf is not None
    assert samples.x.min() >= 0.0
    assert samples.x.max() < 1.0
    assert_allclose(scored.double().exp(), samples.pdf[..., 0], rtol=2e-4)
    assert samples.pdf.std() > 0.1
    terms = (samples.value[..., 0, 0] / samples.pdf[..., 0]).flatten().numpy()
    assert abs(terms.mean() - (math.e - 1.0) ** 6) < 4.5 * terms.std() / math.sqrt(len(terms))


def test_the_density_of_walks_is_that_of_their_directions() -> None:
    net = disturbed(NETS["walk"], 0.3)
    problem = problem_of("walk", 1).take(torch.zeros(1024, dtype=torch.int64))
    with torch.no_grad():
        samples = net.sample(problem, 3, STREAM, torch.arange(1024)).samples
    assert samples.pdf is not None
    alive = samples.seen.features["steps"][:, :, 0, 9::10] > 0.0
    assert alive.any(dim=0).all()
    weight = 1.0 / samples.pdf[..., 0]
    # Steps that a walk makes are drawn by the density; those after its end are uniform and count as 1.
    for i in (1, 2):  # the first is uniform
        assert abs(weight[:, i].mean() - 1.0) < 4.5 * weight[:, i].std() / 32.0
        moment = weight[:, i] * torch.cos(2.0 * math.pi * samples.x[:, i, 0])
        assert abs(moment.mean()) < 4.5 * moment.std() / 32.0
        assert stats.kstest(samples.x[:, i, 11][~alive[:, i, 11]].numpy(), "uniform").pvalue > 1e-3


def test_directions_turn_with_the_domain() -> None:
    star = np.array([[1.0, 0.0], [0.3, 0.4], [-0.2, 1.0], [-0.4, 0.1], [-0.9, -0.5], [0.2, -0.4]])
    turn = 3.0 * np.array([[0.0, -1.0], [1.0, 0.0]])
    net = disturbed(NETS["walk"], 0.3)
    densities, walks = [], []
    for vertices, point in ((star, [0.1, 0.05]), (star @ turn.T, turn @ [0.1, 0.05])):
        problem = ng.problems.laplace(vertices, np.arange(6.0), [point])
        with torch.no_grad():
            samples = net.sample(problem, 1, STREAM).samples
        densities.append(samples.pdf)
        walks.append(samples.x)
    # The frame of a domain rounds, and a walk repeats that many times over: only its first steps agree closely.
    assert_allclose(densities[0], densities[1], rtol=1e-3)
    assert_allclose(torch.frac(walks[1][0, 0, :4] - walks[0][0, 0, :4] + 1.0), 0.25, atol=1e-4)


def test_monte_carlo_on_its_samples_is_unbiased() -> None:
    net = disturbed(JOINT["toy-nqr-uniform"].snet, 0.2)
    problem = problem_of("toy", 1).take(torch.zeros(4096, dtype=torch.int64))
    with torch.no_grad():
        samples = net.sample(problem, 16, STREAM, torch.arange(4096)).samples
    means = MonteCarlo().combine(samples).estimate(samples)[:, 0].numpy()
    assert abs(means.mean() - problem.reference()[0, 0]) < 4.5 * means.std() / 64.0


@pytest.mark.parametrize("name", ["toy", "gwn", "sd"])
def test_gaps_tile_the_interval(name: str) -> None:
    problem, maker = problem_of(name, 20), {"toy": ToyGaps, "gwn": CurveGaps, "sd": SdGaps}[name]
    gaps = maker(problem, 10)
    for i in range(10):
        x = STREAM.uniform(problem.rows, torch.tensor(i))
        slot = gaps.containing(x)
        at = torch.arange(20)
        assert ((gaps.left[at, slot] <= x) & (x < gaps.right[at, slot])).all()
        beside = gaps.cut(slot, x, problem.evaluate(x[:, None, None]))
        assert beside.shape == (20, 2 * maker.size)
        assert torch.isfinite(beside).all()
        width = torch.where(gaps.open, gaps.right - gaps.left, 0.0)
        assert_allclose(width.sum(dim=1), 1.0, atol=1e-14)
        assert torch.isfinite(gaps.worth()).all()
        assert (gaps.open.sum(dim=1) - gaps.open[:, : gaps.start].sum(dim=1)).max() <= 2 * (i + 1)


def test_gaps_on_curves_do_not_see_place_size_or_direction() -> None:
    curve = ng.datasets.curves(1, seed=4)[0]
    turn = 2.5 * np.array([[0.6, -0.8], [0.8, 0.6]])
    points = np.array([[0.1, 0.2], [0.5, -0.3]])
    moved = curve.transformed(turn, [3.0, -1.0])
    features = []
    for c, p in ((curve, points), (moved, points @ turn.T + [3.0, -1.0])):
        problem = ng.problems.gwn(c, p)
        gaps = CurveGaps(problem, 4)
        for x in (0.05, 0.3, 0.32, 0.9):
            at = torch.full((2,), x, dtype=torch.float64)
            gaps.cut(gaps.containing(at), at, problem.evaluate(at[:, None, None]))
        features.append(gaps.features)
    assert_allclose(features[0], features[1], atol=2e-5)


def test_bad_arguments_are_named() -> None:
    tokens = TokenConfig(features=(Feature("piece", "index", levels=5),))
    with pytest.raises(ValueError, match="floor: expected"):
        SNetConfig(tokens, floor=0.0)
    with pytest.raises(ValueError, match="head: 'gap' needs one dimension"):
        SNetConfig(replace(tokens, dim=2))
    with pytest.raises(ValueError, match="view: the head 'step' needs a type of Walks"):
        SNet(STEP, ToyGaps)
    with pytest.raises(ValueError, match="problem: expected one of walks"):
        SNet(STEP, LaplaceWalks).sample(problem_of("toy", 1), 2, STREAM)
    with pytest.raises(ValueError, match="grid: expected 1 axes"):
        SNetConfig(tokens, head="grid", grid=((4, 4),))
    with pytest.raises(ValueError, match="view: the head 'gap' needs a type of Gaps, got None"):
        SNet(SNetConfig(tokens))
    with pytest.raises(ValueError, match="in 1 dimensions, 'cube' has 6"):
        LearnedSampler(JOINT["toy-nqr"].snet()).draw(Cube(torch.arange(2)), 4, STREAM)
    with pytest.raises(ValueError, match="expected a problem on curves"):
        CurveGaps(problem_of("toy", 1), 4)
    with pytest.raises(ValueError, match="expected a smoothed distance"):
        SdGaps(problem_of("gwn", 1), 4)
    assert SNetConfig.from_dict(GRID.to_dict()) == GRID
