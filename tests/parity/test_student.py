"""The compiled student gives what sampler, tokens, network and weighted sum give one after the other."""

from __future__ import annotations

import copy
import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves import compiled_student, problems, student
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.curves.structured import GwnHermite
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.learn import inet, tokens
from nqr_geom.integrator.learn.zoo import Model
from nqr_geom.integrator.rules import MonteCarlo, Trapezoid
from nqr_geom.integrator.samplers import Random, Sobol, Stratified
from nqr_geom.streams import Stream
from tests.tensors import GwnByTensors

DESIGNS = pytest.mark.parametrize("sampler", [Random(), Stratified()], ids=lambda sampler: sampler.name)


class Plain(GwnProblem):
    """The same problem without its compiled pass."""

    def compiled(self, sampler: object, rule: object, n: int) -> None:
        return None


def plain(problem: GwnProblem) -> Plain:
    return Plain(**{field.name: getattr(problem, field.name) for field in fields(problem)})


PLAIN, ON_CURVE = "gwn-student-uniform", "gwn-student"
BOTH = pytest.mark.parametrize("name", [PLAIN, ON_CURVE])


def model(name: str) -> Model:
    return registry.make("model", name)


def exact(name: str) -> Model:
    """The same weights in double precision."""
    shipped = model(name)
    return replace(shipped, learned=replace(shipped.learned, net=copy.deepcopy(shipped.learned.net).double()))


@pytest.fixture(scope="module")
def mixture() -> GwnProblem:
    """Shapes of six quadratics, one cubic, a square, and shapes without length here and there."""
    rng = np.random.default_rng(5)
    square = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    broken = ng.Curve.polyline([[0, 0], [0, 0], [1, 0], [1, 0], [0.2, 0.7]])
    shapes = [ng.Curve.bezier(rng.uniform(-1, 1, (k, d, 2))) for k, d in ((6, 3), (5, 3), (1, 4), (4, 4))]
    return GwnProblem.of([*shapes, square, broken], rng.uniform(-1, 1, (150, 2)))


@DESIGNS
@pytest.mark.parametrize("n", [1, 2, 5, 32, 33, 100])
def test_plain_weights_agree_in_every_digit(mixture: GwnProblem, sampler, n: int) -> None:
    fast, slow = (run(problem, sampler, exact(PLAIN), n, seed=2) for problem in (mixture, plain(mixture)))
    assert "compiled" in fast.stages
    assert "compiled" not in slow.stages
    # A query on the rim of the card's box may fall to either side of it in the reference's single precision.
    same = fast.fallback == slow.fallback
    assert same.mean() > 0.999
    np.testing.assert_allclose(fast.value[same], slow.value[same], rtol=1e-10, atol=1e-12)
    assert fast.counts == slow.counts
    assert fast.stderr is None
    assert slow.stderr is None


@DESIGNS
@pytest.mark.parametrize("n", [2, 5, 32, 33])
def test_corrections_of_the_rebuilt_curve_agree_in_every_digit(mixture: GwnProblem, sampler, n: int) -> None:
    rule, stream = exact(ON_CURVE), Stream(2)
    samples = sampler.draw(mixture, n, stream)
    base = rule.consistent.combine(samples)
    slow = (rule.learned.combine(samples).estimate(samples) - base.estimate(samples))[:, 0].numpy()
    shapes = mixture.shapes
    arrays = (shapes.coefficients, shapes.pieces, mixture.shape, mixture.points, mixture.rows)
    fast = compiled_student.estimated(
        *(array.numpy() for array in arrays), stream.key, n, isinstance(sampler, Stratified),
        np.array(rule.card.box), student.layers_of(rule.learned.net),
    )  # fmt: skip
    same = fast.doubtful == base.fallback.numpy()
    assert same.mean() > 0.995  # a decision within rounding may fall either way
    np.testing.assert_allclose((fast.learned - fast.safe)[same], slow[same], rtol=1e-11, atol=1e-11)
    assert (np.abs(slow) > 1e-3).any() == (fast.doubtful & fast.inside).any()
    # What two near samples say of a far end is as uncertain as their rounding, in either implementation.
    miss = np.abs(fast.safe - base.estimate(samples)[:, 0].numpy())[same]
    assert (miss < 1e-10).mean() > 0.99


@DESIGNS
@pytest.mark.parametrize("n", [1, 8, 32])
def test_the_rebuilt_curve_by_itself(mixture: GwnProblem, sampler, n: int) -> None:
    fast = run(mixture, sampler, GwnHermite(), n, seed=6)
    slow = run(plain(mixture), sampler, GwnByTensors(), n, seed=6)
    assert "compiled" in fast.stages
    same = fast.fallback == slow.fallback
    assert same.mean() > 0.995
    assert (np.abs(fast.value - slow.value)[same] < 1e-10).mean() > 0.99


@BOTH
@DESIGNS
def test_single_precision_agrees_to_its_rounding(name: str, sampler) -> None:
    problem = GwnProblem.family(4, resolution=24)
    fast, slow = (run(p, sampler, model(name), 32) for p in (problem, plain(problem)))
    assert "compiled" in fast.stages
    np.testing.assert_array_equal(fast.fallback, slow.fallback)
    np.testing.assert_allclose(fast.value, slow.value, atol=2e-5)
    assert np.abs(fast.value - slow.value).max() > 0.0  # or this would not be what is tested


@BOTH
@pytest.mark.parametrize("n", [8, 32])
def test_same_bits_in_any_part_of_the_batch(name: str, n: int) -> None:
    problem = GwnProblem.family(2, resolution=50)
    whole = run(problem, Random(), model(name), n, seed=1)
    for part in (slice(0, 1), slice(3000, 3400), slice(4999, 5000)):
        again = run(problem.take(part), Random(), model(name), n, seed=1)
        np.testing.assert_array_equal(again.value, whole.value[part])
        np.testing.assert_array_equal(again.fallback, whole.fallback[part])
    index = torch.arange(problem.batch - 1, -1, -7)
    again = run(problem.take(index), Random(), model(name), n, seed=1)
    np.testing.assert_array_equal(again.value, whole.value[index.numpy()])


def test_foreign_data_get_the_consistent_rule_and_a_flag() -> None:
    curve = ng.datasets.curves(1)[0]
    problem = GwnProblem.of(curve, [[0.3, 0.1], [900.0, 20.0], [-1e6, 0.0]])
    answer = run(problem, Stratified(), model(PLAIN), 32)
    assert answer.fallback.tolist() == [False, True, True]
    safe = run(problem, Stratified(), Trapezoid(), 32)
    np.testing.assert_allclose(answer.value[1:], safe.value[1:], rtol=1e-12)
    assert abs(answer.value[0] - safe.value[0]) > 1e-6
    # On the rebuilt curve what is flagged is what the curve leaves in doubt; far away its answer stands uncorrected.
    few, safe = (run(problem, Random(), rule, 6) for rule in (model(ON_CURVE), GwnHermite()))
    assert few.fallback.all()
    np.testing.assert_allclose(few.value[1:], safe.value[1:], rtol=1e-9, atol=1e-12)
    assert abs(few.value[0] - safe.value[0]) > 1e-6


def test_as_samples_grow_the_student_fades() -> None:
    problem, rule = GwnProblem.family(1, resolution=8), model(PLAIN)
    n = next(n for n in rule.card.sizes if 0.0 < rule.card.share(n) < 0.5)
    fast, slow, safe = (
        run(p, Random(), used, n) for p, used in ((problem, rule), (plain(problem), rule), (problem, Trapezoid()))
    )
    assert "compiled" in fast.stages
    assert fast.fallback.all()
    np.testing.assert_allclose(fast.value, slow.value, atol=2e-5)
    alone = run(problem, Random(), replace(rule, card=replace(rule.card, shares=(1.0,) * 10)), n)
    share = rule.card.share(n)
    np.testing.assert_allclose(fast.value, share * alone.value + (1.0 - share) * safe.value, rtol=1e-12, atol=1e-13)
    assert problem.compiled(Random(), rule, 2 * rule.card.sizes[-1]) is None
    many = 2 * rule.card.sizes[-1]
    curve, rebuilt = (run(problem, Random(), used, many) for used in (model(ON_CURVE), GwnHermite()))
    assert "compiled" in curve.stages
    np.testing.assert_allclose(curve.value, rebuilt.value, atol=1e-8)


def test_only_students_on_independent_or_jittered_points_are_compiled() -> None:
    problem, rule = GwnProblem.family(1, resolution=4), model(PLAIN)
    for name in (PLAIN, ON_CURVE):
        assert problem.compiled(Stratified(), model(name), 32) is not None
        assert problem.compiled(Sobol(), model(name), 32) is None
        assert problem.compiled(Stratified(), replace(model(name), consistent=MonteCarlo()), 32) is None
        based = replace(rule.learned, base=Trapezoid())
        assert problem.compiled(Stratified(), replace(model(name), learned=based), 32) is None
    for other in ("gwn-uniform", "gwn-structured"):
        assert problem.compiled(Stratified(), model(other), 32) is None


def test_black_boxes_take_the_long_way_and_agree() -> None:
    curve = ng.Curve.bezier(np.random.default_rng(1).uniform(-1, 1, (3, 3, 2)))
    points = np.random.default_rng(2).uniform(-1, 1, (40, 2))
    seen = ng.gwn(ng.Curve.from_callable(curve.sample, pieces=3), points, method="student", full_output=True)
    known = ng.gwn(curve, points, method="student", full_output=True)
    assert "compiled" in known.stages
    assert "compiled" not in seen.stages
    np.testing.assert_allclose(seen.value, known.value, atol=1e-4)  # its tangents are differences


def test_students_are_far_better_than_monte_carlo() -> None:
    """Bounds with room: measured are about 12 and 80 on plain weights, 75 and exact on the rebuilt curve."""
    problem = GwnProblem.family(6, seed=9, resolution=20)
    truth = problem.reference()

    def error(sampler: str, rule: str) -> float:
        made = registry.make("sampler", sampler), registry.make("rule", rule)
        return float(((run(problem, *made, 32).value - truth) ** 2).mean())

    usual = error("random", "mc")
    assert error("random", "inet-gwn-student-uniform") < usual / 6.0
    assert error("stratified", "inet-gwn-student-uniform") < usual / 30.0
    assert error("random", "inet-gwn-student") < usual / 30.0
    assert error("stratified", "inet-gwn-student") < 1e-12


@BOTH
def test_extreme_queries_stay_finite(name: str) -> None:
    shapes = [
        ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True),
        ng.Curve.polyline([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]]),
    ]
    problem = GwnProblem.of(shapes, [[0.5, 0.0], [0.0, 0.0], [0.5, 0.5], [0.25, 1e-12], [1e100, 1e100]])
    for n in (1, 8, 32):
        assert np.isfinite(run(problem, Stratified(), model(name), n).value).all()


def test_constants_are_those_of_the_reference() -> None:
    """Kernels keep their own copies: a cached kernel would not notice a change in another file."""
    assert compiled_student._LIMIT == tokens._LIMIT
    assert compiled_student._LEAST_GROWTH == inet._LEAST_GROWTH
    assert inet.INetConfig().growth == compiled_student._GROWTH
    assert compiled_student._TINY == problems._TINY


def test_layers_that_kernels_cannot_take_are_refused() -> None:
    def layers(inputs: int, one: int, two: int, outputs: int) -> compiled_student.Layers:
        sizes = (inputs, one, two, outputs)
        return compiled_student.Layers(*((np.zeros((b, a)), np.zeros(b)) for a, b in itertools.pairwise(sizes)))

    layers(30, 8, 4, 2)
    with pytest.raises(ValueError, match="second: expected multiples of 4 hidden channels"):
        layers(30, 8, 5, 2)
    with pytest.raises(ValueError, match="first: expected multiples of 4 hidden channels"):
        layers(30, 6, 4, 2)
    with pytest.raises(ValueError, match="layers: expected 30 inputs and 2 or 3 outputs, got 31 and 2"):
        layers(31, 8, 4, 2)
    with pytest.raises(ValueError, match="layers: expected 30 inputs and 2 or 3 outputs, got 30 and 4"):
        layers(30, 8, 4, 4)
