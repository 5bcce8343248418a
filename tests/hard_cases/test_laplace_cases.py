"""What solvers of Laplace problems say beside their answers, and queries that are none."""

from __future__ import annotations

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom.hard_cases.laplace import UNIT


def test_auto_says_what_it_chose():
    cheap = ng.solve_laplace(UNIT, np.arange(4.0), [[0.5, 0.5]], tol=0.5, full_output=True)
    assert cheap.plan["method"] in ("wos", "wos-lhs", "wos-rqmc", "structured")
    assert "at the least cost" in cheap.plan["why"]
    many = np.random.default_rng(0).random((1000, 2))
    dear = ng.solve_laplace(UNIT, np.arange(4.0), many, tol=1e-4, full_output=True)
    assert dear.plan["method"] == "boundary"
    assert dear.plan["error"] < 1e-4
    heated = ng.solve_laplace(UNIT, np.zeros(4), [[0.5, 0.5]], source=1.0, full_output=True)
    assert heated.plan["method"] in ("wos", "fem")  # what else knows a source? Walks are cheaper for one query
    assert abs(heated.value[0, 0] - 0.0736713533) < 1e-3  # of a series of sines
    assert heated.plan["met"]


def test_an_absolute_shell_is_biased_by_a_hundredth_in_the_channel():
    channel = [[0, 0], [10, 0], [10, 0.01], [0, 0.01]]
    wide = ng.solve_laplace(channel, lambda p: p[:, 1] / 0.01, [[5.0, 0.0025]], method="wos", n=20000, epsilon=0.49)
    assert abs(wide[0] - 0.25) > 0.015


@pytest.mark.parametrize("method", ["wos", "wos-lhs", "wos-rqmc", "structured", "inet", "boundary", "fem"])
def test_no_points(method):
    assert ng.solve_laplace(UNIT, np.arange(4.0), np.zeros((0, 2)), method=method).shape == (0,)
