"""Curves cut into runs of pieces: nothing is lost, nothing counted twice."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nqr_geom import Curve, registry
from nqr_geom.curves.decompose import decompose, run_decomposed
from nqr_geom.curves.families import impossible, knots, lissajous
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator.estimate import run

POINTS = np.random.default_rng(4).uniform(-0.9, 0.9, (30, 2))


def test_parts_are_the_whole_piece_by_piece() -> None:
    problem = GwnProblem.of(knots(), POINTS[:2])
    parts, whole = decompose(problem)
    assert parts.shapes.pieces.tolist() == [6] * 5
    assert whole.tolist() == [0] * 5 + [1] * 5
    s = (torch.arange(12).double() + 0.3) / 12.0
    mine = parts.evaluate(s[None, :, None].expand(10, -1, 1))
    full = problem.evaluate(((torch.arange(60).double() + 0.3) / 60.0)[None, :, None].expand(2, -1, 1))
    for name in ("relative", "normal"):
        np.testing.assert_allclose(
            mine.features[name].reshape(2, 60, 1, 2), full.features[name].reshape(2, 60, 1, 2), atol=1e-13
        )
    np.testing.assert_allclose(mine.value.reshape(2, 60) * 5.0, full.value.reshape(2, 60), rtol=1e-10)
    assert (mine.features["pieces"] == 6).all()
    assert mine.features["piece"].reshape(10, 12)[0].tolist() == [k // 2 for k in range(12)]


@pytest.mark.parametrize(("curve", "parts"), [(knots(), 5), (impossible(), 3), (lissajous(3, 2, pieces=8), 2)])
def test_the_sum_of_exact_parts_is_the_winding_number(curve: Curve, parts: int) -> None:
    problem = GwnProblem.of(curve, POINTS)
    sampler, rule = registry.make("sampler", "curve-refine"), registry.make("rule", "gwn-hermite")
    value, fallback = run_decomposed(problem, sampler, rule, 64)
    assert decompose(problem)[0].batch == parts * 30
    far = ~fallback
    assert far.mean() > 0.9
    np.testing.assert_allclose(value[far], value[far].round(), atol=1e-4)
    # The same by small angles along each piece on its own.
    inside = np.linspace(0.0, 1.0 - 1e-9, 4001)
    s = (np.arange(curve.n_pieces)[:, None] + inside) / curve.n_pieces
    z = curve.sample(s.ravel()).reshape(*s.shape, 2) @ [1.0, 1j] - (POINTS @ [1.0, 1j])[:, None, None]
    turns = np.angle(z[..., 1:] / z[..., :-1]).sum(axis=(1, 2)) / (2.0 * np.pi)
    np.testing.assert_allclose(value[far, 0].round(), turns[far].round())


def test_few_pieces_stay_as_they_are() -> None:
    curve = Curve.polyline([[0, 0], [1, 0], [1, 1]], closed=True)
    problem = GwnProblem.of(curve, POINTS)
    sampler, rule = registry.make("sampler", "random"), registry.make("rule", "mc")
    value, fallback = run_decomposed(problem, sampler, rule, 16, seed=3)
    np.testing.assert_allclose(value, run(problem, sampler, rule, 16, seed=3).value, rtol=1e-12)
    assert not fallback.any()


def test_least_part_is_checked() -> None:
    with pytest.raises(ValueError, match="most: expected an integer >= 1, got 0"):
        decompose(GwnProblem.of(knots(), POINTS), 0)
