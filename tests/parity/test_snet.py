"""The compiled pass of the sampling network on curves against the network itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

import nqr_geom as ng
from nqr_geom.curves import compiled_snet, gaps
from nqr_geom.curves.families import curves
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator.learn import tokens
from nqr_geom.integrator.learn.snet import LearnedSampler, SNet, SNetConfig
from nqr_geom.integrator.problem import Samples
from nqr_geom.recipes import JOINT, sampler
from nqr_geom.streams import Stream

STREAM = Stream(3, "validation", "snet parity")
BASE = JOINT["gwn-nqr"].sampler


def mixed() -> GwnProblem:
    """Curves of one to six pieces of degree 1 to 3, open and closed, with queries near and far."""
    rng = np.random.default_rng(8)
    shapes = [
        *curves(2, seed=3, split="validation"),
        ng.Curve.polyline([[0.0, 0.0], [1.0, 0.2], [0.4, 0.9]], closed=True),
        ng.Curve.bezier([[[0.0, 0.0], [1.0, 2.0], [2.0, -1.0], [1.0, 0.5]]]),
    ]
    return GwnProblem.of(shapes, rng.normal(size=(70, 2)))


def network(seed: int, **changes: object) -> SNet:
    """A network whose heads are not zero."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net = SNet(replace(BASE, **changes), JOINT["gwn-nqr"].view)
        with torch.no_grad():
            for weight in net.parameters():
                weight += 0.1 * torch.randn_like(weight)
    return net


def both(net: SNet, problem: GwnProblem, n: int) -> tuple[Samples, Samples]:
    """Samples of the compiled pass, and of the network itself."""
    assert problem.placing(net, n) is not None
    with torch.inference_mode():
        return LearnedSampler(net).draw(problem, n, STREAM), net.sample(problem, n, STREAM).samples


def assert_same(fast: Samples, slow: Samples, rows: float = 0.99) -> None:
    """All rows agree but those few in which a choice was within single precision of another."""
    assert fast.pdf is not None
    assert slow.pdf is not None
    same = ((fast.x - slow.x).abs() < 1e-9).all(dim=1)[:, 0]
    assert same.double().mean() >= rows
    assert_allclose(fast.pdf[same], slow.pdf[same], rtol=2e-4)
    assert_allclose(fast.x[:, 0], slow.x[:, 0], rtol=1e-12)
    assert_allclose(fast.value[same], slow.value[same], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    "changes",
    [{}, {"sharpness": 0.0, "profile": (0.25,) * 4}, {"floor": 0.5}, {"layers": 1, "width": 32, "heads": 4}],
    ids=["as trained", "uniform", "half of it uniform", "another size"],
)
@pytest.mark.parametrize("n", [1, 9, 40])
def test_the_compiled_pass_is_the_network(changes: dict[str, object], n: int) -> None:
    assert_same(*both(network(1, **changes), mixed(), n))


def test_the_shipped_network_places_the_same_points() -> None:
    assert_same(*both(sampler("gwn-nqr").net, mixed(), 32))


def test_untrained_it_is_its_base() -> None:
    net = JOINT["gwn-nqr"].snet()
    assert_same(*both(net, mixed(), 24))


def test_a_query_does_not_depend_on_those_beside_it() -> None:
    problem, net = mixed(), LearnedSampler(network(2))
    whole = net.draw(problem, 16, STREAM)
    for rows in (torch.tensor([5]), torch.arange(30, 67), torch.tensor([200, 3, 3, 90])):
        part = net.draw(problem.take(rows), 16, STREAM)
        assert_array_equal(part.x, whole.x[rows])
        assert part.pdf is not None
        assert whole.pdf is not None
        assert_array_equal(part.pdf, whole.pdf[rows])


def test_queries_on_the_curve_and_empty_curves_stay_finite() -> None:
    square = ng.Curve.polyline([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], closed=True)
    point = ng.Curve.polyline([[0.5, 0.5], [0.5, 0.5]])
    problem = GwnProblem.of([square, point], [[0.0, 0.0], [0.5, 0.5], [1e6, -1e6], [0.5, 1e-12]])
    samples = LearnedSampler(network(3)).draw(problem, 32, STREAM)
    assert samples.pdf is not None
    assert bool(((samples.x >= 0.0) & (samples.x < 1.0)).all())
    assert bool((samples.pdf.isfinite() & (samples.pdf > 0.0)).all())


def test_what_it_does_not_know_goes_to_the_network() -> None:
    problem = mixed()
    assert problem.placing(network(1), 8) is not None
    assert problem.placing(network(1, tokens=replace(BASE.tokens, frequencies=5)), 8) is None
    assert problem.placing(network(1).double(), 8) is None
    assert problem.placing(SNet(SNetConfig(BASE.tokens, head="grid", grid=((8,),))), 8) is None
    assert problem.placing(JOINT["toy-nqr-uniform"].snet(), 8) is None
    assert problem.placing("gwn-nqr", 8) is None
    black_box = ng.Curve.from_callable(lambda s: np.stack([np.cos(6.0 * s), np.sin(6.0 * s)], axis=-1))
    assert GwnProblem.of(black_box, [[0.1, 0.2]]).placing(network(1), 8) is None


def test_both_hold_the_same_constants() -> None:
    assert gaps.CurveGaps.size == compiled_snet._FEATURES
    assert (compiled_snet._UNSEEN, compiled_snet._NEAREST) == (gaps._UNSEEN, gaps._NEAREST)
    assert (BASE.tokens.width, tokens._LIMIT) == (compiled_snet._OWN, compiled_snet._LIMIT)
