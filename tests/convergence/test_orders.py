"""Observed orders of convergence, each in a band around theory and below an absolute cap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from tests.integrands import smooth, step

ROWS = 400


def rms_errors(problem, sampler, rule, sizes):
    """Root mean squared error over independent rows at each number of samples."""
    many = replace(problem, rows=torch.arange(ROWS))
    made = registry.make("sampler", sampler), registry.make("rule", rule)
    truth = many.reference()
    return np.array([np.sqrt(np.mean((run(many, *made, n).value - truth) ** 2)) for n in sizes])


def observed_order(errors, sizes):
    """Slope of the least-squares line in the log-log plot."""
    return -np.polyfit(np.log(sizes), np.log(errors), 1)[0]


POWERS = (16, 32, 64, 128, 256)
LARGE = (64, 128, 256, 512)  # for a fit of several terms

# Integrand, sampler, rule, sizes, order in theory, band, cap on the last error.
CASES = [
    (smooth(), "random", "mc", POWERS, 0.5, 0.05, 0.035),  # sigma = 0.492; 0.492 / 16 = 0.0308
    (smooth(2), "random", "mc", POWERS, 0.5, 0.05, 0.085),
    (step(), "random", "mc", POWERS, 0.5, 0.05, 0.033),
    (smooth(), "stratified", "mc", POWERS, 1.5, 0.06, 1.4e-4),  # |f'| / sqrt(12) / n^1.5
    (smooth(2), "stratified", "mc", (16, 64, 256, 1024), 1.0, 0.06, 1.6e-3),  # 1/2 + 1/D
    (step(), "stratified", "mc", POWERS, 1.0, 0.12, 2.2e-3),  # one cell of n holds the jump
    (smooth(), "latin-hypercube", "mc", POWERS, 1.5, 0.06, 1.4e-4),  # in one dimension it is stratified
    (smooth(2), "latin-hypercube", "mc", POWERS, 0.5, 0.12, 0.018),  # not additive: only the constant is better
    (smooth(), "sobol", "mc", POWERS, 1.5, 0.06, 1.4e-4),
    (smooth(2), "sobol", "mc", POWERS, 1.5, 0.2, 1.5e-3),  # up to a power of the logarithm (Owen 1997)
    (smooth(2), "pmj", "mc", POWERS, 1.5, 0.2, 1.5e-3),
    (step(), "sobol", "mc", POWERS, 1.0, 0.12, 2.2e-3),
    (smooth(), "random", "difference-cv", POWERS, 0.5, 0.05, 0.0145),  # sigma of f - h = 0.209; 0.209 / 16 = 0.0131
    (smooth(), "random", "regression-1", LARGE, 0.5, 0.08, 3.1e-3),  # sigma left by a line: 0.063
    (smooth(), "random", "regression-3", LARGE, 0.5, 0.1, 1.65e-5),
    (smooth(), "stratified", "regression-5", POWERS[:-1], 1.5, 0.3, 1e-8),
    (smooth(), "random", "trapezoid", POWERS, 2.0, 0.15, 1.2e-4),  # the ends: f' gap^2 / 2, gap exponential: 7 / n^2
    (smooth(), "stratified", "trapezoid", POWERS, 2.0, 0.15, 1e-4),
    (smooth(), "grid", "trapezoid", POWERS, 2.0, 0.02, 1.2e-6),  # the midpoint rule: (e - 1) / 24 / n^2
    (step(), "grid", "trapezoid", POWERS, 1.0, 0.02, 1.4e-3),  # n = 1 mod 3 or 2 mod 3: error 1 / (6 n) or 1 / (3 n)
    (step(), "random", "trapezoid", POWERS, 1.0, 0.1, 4e-3),
    (smooth(), "grid", "simpson", (17, 33, 65, 129, 257), 2.0, 0.05, 3.4e-6),  # the constant ends: (e - 1) / 8 / n^2
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0].name}{case[0].dim}-{case[1]}-{case[2]}")
def test_order(case):
    problem, sampler, rule, sizes, order, band, cap = case
    errors = rms_errors(problem, sampler, rule, sizes)
    assert observed_order(errors, sizes) == pytest.approx(order, abs=band)
    assert errors[-1] < cap


def test_gauss_legendre_is_spectral():
    """exp: the error is (N!)^4 / ((2N+1) (2N)!^3) e^xi, 5e-14 at N = 6; each node wins more digits than the last."""
    errors = rms_errors(smooth(), "gauss-legendre", "gauss-legendre", (1, 2, 3, 4, 5))
    exact = np.array([1.0 / 24, 1.0 / 4320, 1.0 / 2016000, 1.0 / 1778112000, 1.0 / 2534876467200])
    assert ((errors > exact) & (errors < np.e * exact)).all()
    assert rms_errors(smooth(2), "gauss-legendre", "gauss-legendre", (64,))[0] < 1e-12


def test_bayesian_quadrature_is_spectral_once_its_kernel_is_resolved():
    """A length scale of 0.015 wants about 64 points; before, the prior's zero mean wins."""
    errors = rms_errors(smooth(), "bayesian-quadrature", "bayesian-quadrature", (8, 64, 128))
    assert errors[0] > 0.5
    assert errors[1] < 2e-3
    assert errors[2] < 1e-5


def test_order_two_of_the_grid_is_seen_by_its_constant():
    """The midpoint rule's error on exp is (e - 1) / 24 / n^2, to first order."""
    errors = rms_errors(smooth(), "grid", "trapezoid", (64, 256))
    np.testing.assert_allclose(errors * np.array([64, 256]) ** 2, np.expm1(1.0) / 24.0, rtol=1e-3)
