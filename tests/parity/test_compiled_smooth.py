"""The compiled pass over smoothed distances gives what sampler and rule give one after the other."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom.curves import compiled_smooth, hermite
from nqr_geom.curves.problems import SdProblem
from nqr_geom.curves.structured import CurveRefine, SdHermite
from nqr_geom.integrator.estimate import Estimate, run
from nqr_geom.integrator.rules import MonteCarlo, Rule
from nqr_geom.integrator.samplers import Random, Sampler, Sobol, Stratified
from nqr_geom.streams import Stream
from tests.tensors import RefineByTensors, SdByTensors

RNG = np.random.default_rng(0)
CURVES = [ng.Curve.bezier(RNG.uniform(-1, 1, (6, 4, 2))) for _ in range(2)]
POINTS = RNG.uniform(-1.2, 1.2, (150, 2))
PAIRS = [
    (Random(), MonteCarlo()),
    (Stratified(), MonteCarlo()),
    (Random(), SdHermite()),
    (Stratified(), SdHermite()),
    (CurveRefine(), SdHermite()),
]


class Plain(SdProblem):
    """The same problem without its compiled pass."""

    def compiled(self, sampler: object, rule: object, n: int) -> None:
        return None


def plain(problem: SdProblem) -> Plain:
    return Plain(**{field.name: getattr(problem, field.name) for field in fields(problem)})


def run_plainly(problem: SdProblem, pair: tuple[Sampler, Rule], n: int, seed: int = 0) -> Estimate:
    sampler = RefineByTensors() if isinstance(pair[0], CurveRefine) else pair[0]
    rule = SdByTensors() if isinstance(pair[1], SdHermite) else pair[1]
    return run(plain(problem), sampler, rule, n, seed=seed)


def test_constants_are_those_of_the_reference() -> None:
    assert compiled_smooth._LEVELS == hermite._LEVELS
    assert compiled_smooth._UNSEEN == hermite.UNSEEN


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: f"{pair[0].name}+{pair[1].name}")
@pytest.mark.parametrize("alpha", [0.5, 35.0, 4000.0])
def test_the_compiled_pass_is_the_pair(pair: tuple[Sampler, Rule], alpha: float) -> None:
    problem = SdProblem.of(CURVES, POINTS, alpha)
    for n in (12, 33, 100) if isinstance(pair[0], CurveRefine) else (1, 2, 33, 100):
        fast, slow = run(problem, *pair, n, seed=n), run_plainly(problem, pair, n, seed=n)
        assert "compiled" in fast.stages
        assert "compiled" not in slow.stages
        # Nearly equal gains may be ordered differently by a last digit, and then another gap is cut.
        assert (np.abs(fast.value - slow.value) < 1e-12 + 1e-12 / alpha).mean() > 0.999
        np.testing.assert_array_equal(fast.fallback, slow.fallback)
        assert fast.counts == slow.counts
        assert (fast.stderr is None) == (slow.stderr is None)
        if fast.stderr is not None:
            np.testing.assert_allclose(fast.stderr, slow.stderr, rtol=1e-9)


@pytest.mark.parametrize("pair", PAIRS[2:], ids=lambda pair: pair[0].name)
@pytest.mark.parametrize("alpha", [1e-6, 35.0, 1e9])
def test_curves_through_the_query_and_degenerate_ones(pair: tuple[Sampler, Rule], alpha: float) -> None:
    shapes = [
        ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True),
        ng.Curve.polyline([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]]),
        ng.Curve.polyline([[0, 0], [0, 0], [1, 0], [1, 0], [0, 0]]),
    ]
    points = [[0.5, 0.0], [0.0, 0.0], [0.5, 0.5], [0.25, 1e-12], [1.0, 1.0], [0.3, 3e5]]
    problem = SdProblem.of(shapes, points, alpha)
    for n in (10, 32):
        fast, slow = run(problem, *pair, n), run_plainly(problem, pair, n)
        assert np.isfinite(fast.value).all()
        np.testing.assert_allclose(fast.value, slow.value, rtol=1e-11, atol=1e-11 * max(1.0, 1.0 / alpha))
        np.testing.assert_array_equal(fast.fallback, slow.fallback)


def test_other_pairs_go_the_long_way() -> None:
    problem = SdProblem.of(CURVES[:1], POINTS[:4])
    assert problem.compiled(Sobol(), SdHermite(), 32) is None
    assert problem.compiled(CurveRefine(), MonteCarlo(), 32) is None
    assert problem.compiled(CurveRefine(), SdHermite(), 11) is None
    assert problem.compiled(CurveRefine(), SdHermite(), 12) is not None


def test_same_answer_in_any_part_of_the_batch() -> None:
    problem = SdProblem.of(CURVES, np.tile(POINTS, (8, 1)))
    for pair in PAIRS:
        whole = run(problem, *pair, 16, seed=1).value
        part = run(problem.take(slice(900, 1300)), *pair, 16, seed=1).value
        np.testing.assert_array_equal(part, whole[900:1300])


@pytest.mark.parametrize("sampler", [Random(), Stratified(), Sobol(), CurveRefine()], ids=lambda sampler: sampler.name)
@pytest.mark.parametrize("alpha", [0.5, 35.0, 4000.0])
def test_the_rule_on_samples_of_any_design(sampler: Sampler, alpha: float) -> None:
    problem = SdProblem.of(CURVES, POINTS, alpha)
    for n in (1, 13, 90):
        samples, _ = problem.finalize(sampler.draw(problem, n, Stream(3)))
        fast, slow = (run_of(samples, torch.full((problem.batch,), alpha, dtype=torch.float64))
                      for run_of in (SdHermite().by_kernel, SdHermite().by_tensors))  # fmt: skip
        assert torch.equal(fast[3], slow[3])
        for value, expected in zip(fast[:3], slow[:3], strict=True):
            np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-12)
