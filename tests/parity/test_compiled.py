"""The compiled pass over sampler and rule gives what the two give one after the other."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from numba import njit

import nqr_geom as ng
from nqr_geom.curves import compiled, hermite, problems
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.curves.structured import CurveRefine, GwnHermite
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import MonteCarlo
from nqr_geom.integrator.samplers import Random, Sampler, Sobol, Stratified
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.streams import Stream
from tests.tensors import GwnByTensors, RefineByTensors


class Plain(GwnProblem):
    """The same problem without its compiled pass."""

    def compiled(self, sampler: object, rule: object, n: int) -> None:
        return None


def plain(problem: GwnProblem) -> Plain:
    return Plain(**{field.name: getattr(problem, field.name) for field in fields(problem)})


@njit
def numbers(key: np.uint64, rows: np.ndarray, n: int) -> np.ndarray:
    result = np.empty((len(rows), n))
    for b in range(len(rows)):
        for i in range(n):
            result[b, i] = unit(mixed(mixed(key, rows[b]), i))
    return result


@pytest.mark.parametrize("seed", [0, 1, -7, 2**62])
def test_keyed_numbers_are_those_of_streams(seed: int) -> None:
    stream = Stream(seed, "train", "any")
    rows = np.array([0, 1, 5, 10**12])
    expected = stream.uniform(rows[:, None], np.arange(9))
    np.testing.assert_array_equal(numbers(unsigned(stream.key), rows, 9), expected)


def test_constants_are_those_of_the_reference() -> None:
    """Kernels keep their own copies: a cached kernel would not notice a change in another file."""
    assert compiled._QUADRATIC == hermite._QUADRATIC
    assert compiled._LEVELS == hermite._LEVELS
    assert compiled._TINY == problems._TINY


@pytest.mark.parametrize("sampler", [Random(), Stratified()])
@pytest.mark.parametrize("n", [1, 2, 33])
def test_monte_carlo(sampler: Random | Stratified, n: int) -> None:
    problem = GwnProblem.family(3, resolution=16)
    fast = run(problem, sampler, MonteCarlo(), n, seed=4)
    slow = run(plain(problem), sampler, MonteCarlo(), n, seed=4)
    assert "compiled" in fast.stages
    assert "compiled" not in slow.stages
    np.testing.assert_allclose(fast.value, slow.value, rtol=1e-12, atol=1e-12)
    assert (fast.stderr is None) == (slow.stderr is None)
    if fast.stderr is not None:
        np.testing.assert_allclose(fast.stderr, slow.stderr, rtol=1e-9)
    assert fast.counts == slow.counts


AXES = np.array(
    [[1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [-1, 1], [-1, -1], [1, -1], [0, 0], [-1, -1e-17], [-1, 1e-17]]
)


@pytest.mark.parametrize("kind", ["anywhere", "axes", "half turns and hardly less", "of any size", "close"])
def test_angles_between_points(kind: str) -> None:
    generator = np.random.default_rng(5)
    one, two = generator.normal(size=(2, 3000, 2))
    if kind == "axes":
        one, two = AXES[generator.integers(len(AXES), size=(2, 3000))].astype(np.float64)
    elif kind == "half turns and hardly less":
        one[:, 0] = two[:, 0] = -1.0
        one[:, 1], two[:, 1] = generator.choice([0.0, -0.0, 1e-16, -1e-16, 1e-300, -1e-300], size=(2, 3000))
    elif kind == "of any size":
        one, two = (
            np.tanh(p) * generator.choice([1.7e308, 1e200, 1.0, 1e-200, 1e-310], size=(3000, 1)) for p in (one, two)
        )
    elif kind == "close":
        two = one * (1.0 + 10.0 ** generator.uniform(-17, -3, (3000, 2)))
    expected = np.arctan2(two[:, 1] + 0.0, two[:, 0]) - np.arctan2(one[:, 1] + 0.0, one[:, 0])
    found = [compiled._between(*a, *b) for a, b in zip(one, two, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=2e-15)


def cubics(seed: int, pieces: int) -> ng.Curve:
    return ng.Curve.bezier(np.random.default_rng(seed).uniform(-1, 1, (pieces, 4, 2)))


@pytest.mark.parametrize("n", [12, 20, 32, 90])
@pytest.mark.parametrize("pieces", [1, 6])
def test_refined_cubics(n: int, pieces: int) -> None:
    points = np.random.default_rng(n).uniform(-1, 1, (700, 2))
    problem = GwnProblem.of([cubics(k, pieces) for k in range(3)], points)
    fast = run(problem, CurveRefine(), GwnHermite(), n, seed=n)
    slow = run(plain(problem), RefineByTensors(), GwnByTensors(), n, seed=n)
    assert "compiled" in fast.stages
    # Nearly equal gains may be ordered differently by a last digit, and then another gap is cut.
    same = np.abs(fast.value - slow.value)[:, 0] < 1e-11
    assert same.mean() > 0.999
    assert (fast.fallback[same] == slow.fallback[same]).mean() > 0.999
    assert fast.counts == slow.counts


def test_curves_through_the_query_and_degenerate_ones() -> None:
    shapes = [
        ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True),
        ng.Curve.polyline([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5]]),
        ng.Curve.polyline([[0, 0], [0, 0], [1, 0], [1, 0], [0, 0]]),
    ]
    points = [[0.5, 0.0], [0.0, 0.0], [0.5, 0.5], [0.25, 1e-12], [1.0, 1.0], [2.0, 0.0], [3.0, 1.0]]
    problem = GwnProblem.of(shapes, points)
    for n in (8, 32, 100):
        fast = run(problem, CurveRefine(), GwnHermite(), n)
        slow = run(plain(problem), RefineByTensors(), GwnByTensors(), n)
        assert np.isfinite(fast.value).all()
        off = ~(fast.fallback | slow.fallback)
        np.testing.assert_allclose(fast.value[off], slow.value[off], atol=1e-11)


def test_too_few_samples_take_the_long_way() -> None:
    problem = GwnProblem.family(1, resolution=4)
    assert problem.compiled(CurveRefine(), GwnHermite(), 11) is None
    assert problem.compiled(CurveRefine(), GwnHermite(), 12) is not None
    assert problem.compiled(Sobol(), GwnHermite(), 12) is None


def test_same_answer_in_any_part_of_the_batch() -> None:
    problem = GwnProblem.family(2, resolution=40)
    whole = run(problem, CurveRefine(), GwnHermite(), 16, seed=1).value
    part = run(problem.take(slice(1000, 1400)), CurveRefine(), GwnHermite(), 16, seed=1).value
    np.testing.assert_array_equal(part, whole[1000:1400])


@pytest.mark.parametrize("sampler", [Random(), Stratified(), Sobol(), CurveRefine()])
@pytest.mark.parametrize("n", [1, 13, 90])
def test_the_rule_on_samples_of_any_design(sampler: Sampler, n: int) -> None:
    points = np.random.default_rng(n).uniform(-1, 1, (400, 2))
    problem = GwnProblem.of([cubics(k, 5) for k in range(3)], points)
    samples = sampler.draw(problem, n, Stream(3))
    fast, slow = GwnHermite().by_kernel(samples), GwnHermite().by_tensors(samples)
    assert torch.equal(fast[1], slow[1])
    # What two near samples say of a far end is as uncertain as their rounding.
    assert ((fast[0] - slow[0]).abs() < 1e-10).double().mean() > 0.995


@pytest.mark.parametrize("spread", [0.2, 0.0])
@pytest.mark.parametrize("n", [10, 11, 40])
def test_refined_black_boxes(spread: float, n: int) -> None:
    """Points of a callable, and several shapes with different numbers of pieces: the reference's, one by one."""
    points = np.random.default_rng(n).uniform(-1, 1, (200, 2))
    spiral = ng.Curve.from_callable(lambda s: np.exp(-s)[:, None] * np.stack([np.cos(9 * s), np.sin(9 * s)], 1), 5)
    for problem in (GwnProblem.of(spiral, points), GwnProblem.of([cubics(1, 5), cubics(2, 3)], points)):
        fast, slow = (kind(spread).draw(problem, n, Stream(4)) for kind in (CurveRefine, RefineByTensors))
        same = (fast.x - slow.x).abs().amax(dim=(1, 2)) < 1e-12  # nearly equal gains may be ordered differently
        assert same.double().mean() > 0.995
        assert fast.seen.queries == slow.seen.queries
        assert fast.seen.features.keys() == slow.seen.features.keys()
        torch.testing.assert_close(fast.value[same], slow.value[same], rtol=1e-9, atol=1e-9)
        for name, feature in fast.seen.features.items():
            torch.testing.assert_close(feature[same], slow.seen.features[name][same], rtol=1e-9, atol=1e-9)
        half = problem.take(slice(100, 200))
        assert torch.equal(CurveRefine(spread).draw(half, n, Stream(4)).x, fast.x[100:200])
