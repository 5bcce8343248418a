"""The price of a query from which a costly rule wins, against curves whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from nqr_geom.integrator.break_even import break_even, samples_to_match

SIZES = (4, 16, 64, 256)


def curve(order: float) -> list[float]:
    return [3.0 * n**-order for n in SIZES]


@pytest.mark.parametrize("order", [1.0, 2.0, 3.5])
@pytest.mark.parametrize("samples", [4.0, 5.0, 16.0, 100.0, 256.0])
def test_powers_are_followed_exactly(order: float, samples: float) -> None:
    assert samples_to_match(SIZES, curve(order), 3.0 * samples**-order) == pytest.approx(samples, rel=1e-9)


def test_a_curve_is_not_extended() -> None:
    assert samples_to_match(SIZES, curve(2.0), 2.9 * 256.0**-2.0) == np.inf
    assert samples_to_match(SIZES, curve(2.0), 0.0) == np.inf
    assert samples_to_match(SIZES, curve(2.0), 100.0) == 4.0


def test_a_size_that_does_worse_than_a_smaller_one_is_passed_over() -> None:
    assert samples_to_match(SIZES, [1.0, 0.1, 0.5, 0.01], 0.1) == 16.0
    # From 0.1 at 64 samples, which 16 reach already, to 0.01 at 256.
    needed = samples_to_match(SIZES, [1.0, 0.1, 0.5, 0.01], 0.05)
    assert needed == pytest.approx(64.0 * 4.0 ** np.log10(2.0))


def test_both_rules_take_as_long_at_the_cost_that_is_told() -> None:
    """At c* the cheap rule's error in the costly rule's time is the costly rule's error."""
    n, overhead, target = 32, 7.0, 3.0 * 200.0**-2.0
    cost = break_even(SIZES, curve(2.0), n, target, overhead)
    affordable = (n * cost + overhead) / cost
    assert 3.0 * affordable**-2.0 == pytest.approx(target, rel=1e-9)


def test_never_and_always() -> None:
    assert break_even(SIZES, curve(2.0), 32, 3.0 * 16.0**-2.0, 7.0) == np.inf
    assert break_even(SIZES, curve(2.0), 32, 1e-9, 7.0) == 0.0


def test_bad_curves_are_refused() -> None:
    with pytest.raises(ValueError, match="sizes: expected 4 ascending numbers"):
        samples_to_match((4, 64, 16, 256), curve(2.0), 0.1)
    with pytest.raises(ValueError, match="sizes: expected 3 ascending numbers"):
        samples_to_match(SIZES, curve(2.0)[:3], 0.1)
    with pytest.raises(ValueError, match="mse"):
        samples_to_match(SIZES, [1.0, 0.5, 0.0, 0.0], 0.1)
    with pytest.raises(ValueError, match="overhead"):
        break_even(SIZES, curve(2.0), 32, 0.1, -1.0)
