"""Newton's method that is cut short says so with numbers."""

from __future__ import annotations

import pytest

from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.fem.space import NotConverged
from nqr_geom.hard_cases.laplace import UNIT


def test_no_convergence_is_said_with_numbers(monkeypatch):
    monkeypatch.setattr("nqr_geom.fem.p_laplace._NEWTON_STEPS", 2)
    with pytest.raises(NotConverged, match=r"on the way to 50 in 2 steps; its last one was \d"):
        p_laplace(UNIT, lambda x: x[:, 0] * x[:, 1], 50.0, n=200)
