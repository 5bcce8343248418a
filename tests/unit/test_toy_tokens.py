"""What the network on plain weights reads of its neighbours: Taylor terms over the gaps, within pieces only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from nqr_geom.integrator.learn.tokens import standard
from nqr_geom.integrator.problem import Observation, Samples
from nqr_geom.toy.tokens import CENTRED, TOY_TERMS, toy_terms, toy_tokens

X = torch.tensor([0.05, 0.2, 0.3, 0.55, 0.6, 0.9], dtype=torch.float64)
PIECE = torch.tensor([0, 0, 0, 3, 3, 4])
BEND = torch.tensor([4.0, 4.0, 4.0, -30.0, -30.0, 9.0], dtype=torch.float64)  # f'' of three parabolas


def samples() -> Samples:
    """One row: parabolas about 0 with a level each."""
    value = PIECE + 0.5 * BEND * X * X
    parts = {"derivative": (BEND * X)[None, :, None, None], "piece": PIECE[None, :, None, None]}
    return Samples(X[None, :, None], Observation(value[None, :, None, None], parts), None, "test")


def terms(row: Samples) -> np.ndarray:
    """The last seven quantities, (6, 7), with the compression of the last five undone."""
    new = toy_terms(row)[0, :, 0, 14:].double().numpy()
    return np.concatenate([new[:, :2], np.sinh(new[:, 2:])], axis=1)


def test_terms_are_those_of_the_parabolas_on_either_side() -> None:
    row = samples()
    unit = standard(row.value, CENTRED)[1].item()
    gap = np.diff(X.numpy(), prepend=0.0, append=1.0)
    left, right = gap[:-1], gap[1:]
    slope, bend = (BEND * X).numpy() / unit, BEND.numpy() / unit
    has_left, has_right = np.array([0, 1, 1, 0, 1, 0]), np.array([1, 1, 0, 1, 0, 0])
    wanted = [
        slope * left,
        slope * right,
        has_left * bend * right**2,
        has_right * bend * left**2,
        (has_right - has_left) * bend * left * right,
    ]
    assert_allclose(terms(row)[:, 2:], np.stack(wanted, axis=1), rtol=2e-5, atol=1e-6)
    assert_allclose(terms(row)[:, 0], 6.0 * np.array([0.125, 0.125, 0.175, 0.15, 0.175, 0.25]) - 1.0, rtol=1e-6)


def test_the_first_quantities_are_those_that_other_models_read() -> None:
    assert torch.equal(toy_terms(samples())[..., :14], toy_tokens(samples()))
    assert TOY_TERMS.size == toy_terms(samples()).shape[-1]


@pytest.mark.parametrize(("factor", "shift"), [(1e3, 0.0), (1.0, 7.0), (-2.0, 1.0)])
def test_neither_an_added_constant_nor_a_factor_is_seen(factor: float, shift: float) -> None:
    row = samples()
    slope = {**row.seen.features, "derivative": factor * row.feature("derivative", "test")}
    other = replace(row, seen=Observation(factor * row.value + shift, slope))
    sign = np.array([1.0, *[np.sign(factor)] * 6])
    assert_allclose(terms(other), sign * terms(row), rtol=1e-5, atol=1e-6)
