"""The Gauss rule on panels: its exponentials, and what its limits promise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest

from nqr_geom.curves import gauss


def test_exponentials_are_right_to_the_last_places() -> None:
    x = np.concatenate([np.linspace(-700.0, 700.0, 8000), np.linspace(-1e-12, 1e-12, 8000)]).reshape(-1, gauss.COUNT)
    scale, found = np.empty(gauss.COUNT), x.copy()
    for row in found:
        gauss.exponentials(row, scale, scale.view(np.int64))
    expected = np.exp(x)
    assert (np.abs(found - expected) <= 2.0 * np.spacing(expected)).all()


@pytest.mark.parametrize("least", [-701.0, -1e6, -1e300, -np.inf])
def test_what_is_too_small_to_count_is_next_to_nothing(least: float) -> None:
    x, scale = np.full(gauss.COUNT, least), np.empty(gauss.COUNT)
    gauss.exponentials(x, scale, scale.view(np.int64))
    assert ((x >= 0.0) & (x < 1e-303)).all()


def off(exponent: Callable[[Any], Any]) -> float:
    """Error of the rule on exp(-exponent(s)), s in [0, 1], relative to the largest integrand."""
    values = [math.exp(-exponent(float(node))) for node in gauss.NODES]
    truth = mpmath.quad(lambda s: mpmath.exp(-exponent(s)), mpmath.linspace(0, 1, 9))
    return abs(float(truth) - float(values @ gauss.WEIGHTS)) * math.exp(min(map(exponent, np.linspace(0.0, 1.0, 1001))))


@pytest.mark.parametrize("bend", [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
def test_tame_exponents_are_integrated_to_rounding(bend: float) -> None:
    """Linear and square parts up to the limit, with the least exponent at an end or inside."""
    linear = 0.5 * (gauss.STRAIGHT - gauss.BEND * bend)
    assert off(lambda s: linear * (2.0 * s - 1.0) + bend * (2.0 * s - 1.0) ** 2) < 2e-14
    assert off(lambda s: gauss.BENT * (2.0 * s - 1.0) ** 2) < 2e-14


@pytest.mark.parametrize("sharpness", [1.0, 10.0])
@pytest.mark.parametrize("angle", [-1.0, 0.0, 0.5, 1.0, 1.5, 0.5 * math.pi])
def test_a_panel_of_the_longest_length_has_no_branch_point_nearby(angle: float, sharpness: float) -> None:
    """A straight panel at distance 1 that starts at its nearest point under every angle, or has that in its middle."""
    length = math.sqrt(gauss.LONGEST)
    along, across = (math.cos(angle), math.sin(angle)) if angle >= 0.0 else (0.0, 1.0)
    start = 0.0 if angle >= 0.0 else 0.5

    def exponent(s: Any) -> Any:
        x, y = 1.0 + length * along * (s - start), length * across * (s - start)
        return sharpness * (x * x + y * y) ** 0.5

    assert off(exponent) < 2e-15
