"""The compiled pass over sampler and rule gives what the two give one after the other, on the toy family."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.integrator.estimate import Estimate, run
from nqr_geom.streams import Stream
from nqr_geom.toy import compiled, compiled_law, family, law, structured
from nqr_geom.toy.family import Pieces, Shape, draw
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.split import ToySplit
from nqr_geom.toy.structured import ToyHermite

SAMPLERS = ("random", "stratified", "grid", "toy-split")
PAIRS = [
    ("random", "mc"),
    ("stratified", "mc"),
    *((sampler, rule) for sampler in SAMPLERS for rule in ("trapezoid", "toy-hermite")),
]


class Plain(ToyProblem):
    """The same problem without its compiled pass."""

    def compiled(self, sampler: object, rule: object, n: int) -> None:
        return None

    def take(self, index: slice | torch.Tensor) -> Plain:
        return Plain(self.rows[index], self.seed, self.split, self.pieces.take(index))


def both(problem: ToyProblem, sampler: str, rule: str, n: int, seed: int = 0) -> tuple[Estimate, Estimate]:
    """The compiled estimate and that of sampler and rule."""
    pair = registry.make("sampler", sampler), registry.make("rule", rule)
    fast = run(problem, *pair, n, seed=seed)
    slow = run(Plain(problem.rows, problem.seed, problem.split, problem.pieces), *pair, n, seed=seed)
    assert "compiled" in fast.stages
    assert "compiled" not in slow.stages
    assert fast.counts == slow.counts
    np.testing.assert_array_equal(fast.fallback, slow.fallback)
    return fast, slow


def test_constants_are_those_of_the_reference() -> None:
    """Kernels keep their own copies: a cached kernel would not notice a change in another file."""
    assert compiled._PIECES == family.PIECES
    assert compiled_law._LAST == family.PIECES - 1
    assert compiled_law._TRUST == law._TRUST
    assert compiled_law._NODES == structured._NODES


@pytest.mark.parametrize(("sampler", "rule"), PAIRS)
@pytest.mark.parametrize("n", [1, 2, 3, 7, 16, 32, 90])
def test_same_answer(sampler: str, rule: str, n: int) -> None:
    fast, slow = both(ToyProblem(400, seed=n), sampler, rule, n, seed=n)
    off = np.abs(fast.value - slow.value)
    if rule == "toy-hermite":
        # Samples that are close together may tell a law badly, and it amplifies their rounding.
        assert np.median(off) < 1e-14
        assert (off < 1e-12).mean() > 0.97
        assert off.max() < 1e-7
    else:
        assert off.max() < 1e-13
    assert (fast.stderr is None) == (slow.stderr is None)
    if fast.stderr is not None and slow.stderr is not None:
        np.testing.assert_allclose(fast.stderr, slow.stderr, rtol=1e-10)
        assert (fast.trusted == slow.trusted).all()


def waves(batch: int, omega: float) -> ToyProblem:
    """Integrands of waves of one frequency."""
    return ToyProblem(
        batch, pieces=draw(torch.arange(batch), Stream(3), Shape(linear=0.0, quadratic=0.0, frequency=(omega, omega)))
    )


def bent(change: Callable[[Pieces], Pieces]) -> ToyProblem:
    """Integrands with something changed."""
    return ToyProblem(100, pieces=change(ToyProblem(100).pieces))


def scaled(by: float) -> ToyProblem:
    """Integrands times a number."""
    return bent(lambda p: replace(p, value=by * p.value, slope=by * p.slope, curvature=by * p.curvature))


HOSTILE: dict[str, tuple[ToyProblem, float]] = {
    "slow waves": (waves(100, 1e-5), 1.0),
    "fast waves": (waves(100, 109.9), 1.0),
    "faster than the rule believes": (waves(100, 3000.0), 1.0),
    "huge": (scaled(1e60), 1e60),
    "tiny": (scaled(1e-60), 1e-60),
    "on top of 1e6": (bent(lambda p: replace(p, value=p.value + 1e6)), 1e6),
    "zero": (scaled(0.0), 1.0),
    "jumps alone": (bent(lambda p: replace(p, slope=0 * p.slope, curvature=0 * p.curvature, alpha=0 * p.alpha)), 1.0),
    "breaks in one place": (bent(lambda p: replace(p, edges=p.edges.index_fill(1, torch.arange(1, 5), 0.5))), 1.0),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
@pytest.mark.parametrize("sampler", ["random", "grid", "toy-split"])
@pytest.mark.parametrize("n", [3, 20, 64])
def test_hostile_integrands(case: str, sampler: str, n: int) -> None:
    problem, unit = HOSTILE[case]
    fast, slow = both(problem, sampler, "toy-hermite", n)
    assert np.isfinite(fast.value).all()
    near = np.abs(fast.value - slow.value) <= 1e-8 * unit
    # What is told from three samples with rounding may come out otherwise by a last digit.
    assert near.mean() >= 0.97


def test_other_constants_of_rule_and_sampler() -> None:
    problem = ToyProblem(300)
    shape = Shape(jump=1.5, shortest=0.02, frequency=(5.0, 60.0))
    pair = ToySplit(first=9, shape=shape), ToyHermite(shape=shape, reach=0.2)
    fast, other = (run(problem, *pair, 14).value for pair in (pair, (ToySplit(), ToyHermite())))
    slow = run(Plain(300), *pair, 14).value
    np.testing.assert_allclose(fast, slow, rtol=0.0, atol=1e-9)
    assert np.abs(fast - other).max() > 1e-3


def test_what_is_not_compiled_takes_the_long_way() -> None:
    class Own(ToyHermite):
        """Somebody's own rule."""

    problem = ToyProblem(2)
    hermite, plain, average = ToyHermite(), registry.make("rule", "trapezoid"), registry.make("rule", "mc")
    assert problem.compiled(ToySplit(), hermite, 12) is not None
    assert problem.compiled(ToySplit(), Own(), 12) is None
    assert problem.compiled(ToySplit(), average, 12) is None
    assert problem.compiled(registry.make("sampler", "sobol"), plain, 12) is None


def test_same_answer_in_any_part_of_the_batch() -> None:
    problem = ToyProblem(3000)
    whole = run(problem, ToySplit(), ToyHermite(), 16, seed=1).value
    part = run(problem.take(slice(1000, 1400)), ToySplit(), ToyHermite(), 16, seed=1).value
    np.testing.assert_array_equal(part, whole[1000:1400])
