"""Every rule against its textbook formula, written out sample by sample in plain NumPy (Appendix B)."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import torch

from nqr_geom import registry
from nqr_geom.integrator.problem import Observation, Samples

N = 9
RANDOM = np.random.default_rng(11)
X = RANDOM.random((4, N))
F = np.sin(7.0 * X) + X**2
PDF = 0.5 + RANDOM.random((4, N))
H = 1.0 + X**2
INTEGRAL = 4.0 / 3.0
STRATUM = RANDOM.integers(0, 3, (4, N))
AREA = np.array([0.2, 0.3, 0.5])


def made(x=X, design="random", **other):
    def column(a):
        return torch.from_numpy(np.ascontiguousarray(a))[..., None]

    control = (column(H)[..., None], torch.full((4, 1), INTEGRAL, dtype=torch.float64))
    seen = Observation(column(F)[..., None], control=control)
    stratum = torch.from_numpy(STRATUM)
    return Samples(
        column(x), seen, column(PDF), design, stratum=stratum, volume=torch.from_numpy(AREA)[stratum], **other
    )


def monte_carlo(row):
    """Eq. 23."""
    return sum(F[row, i] / PDF[row, i] for i in range(N)) / N


def rectangle(row):
    """Eqs. 12 and 13."""
    order = np.argsort(X[row])
    x = [-X[row][order[0]], *X[row][order], 2.0 - X[row][order[-1]]]
    return sum((x[i + 1] - x[i - 1]) / 2.0 * F[row][order[i - 1]] for i in range(1, N + 1))


def trapezoid(row):
    """Eq. 14 with the constant extension of Fig. 42(b)."""
    order = np.argsort(X[row])
    f = F[row][order]
    return scipy.integrate.trapezoid([f[0], *f, f[-1]], [0.0, *X[row][order], 1.0])


def simpson(row):
    """A parabola through three points where the two steps are alike, chords elsewhere."""
    order = np.argsort(X[row])
    x, f = X[row][order], F[row][order]
    total = x[0] * f[0] + (1.0 - x[-1]) * f[-1]
    for i in range(0, N - 2, 2):
        left, right = x[i + 1] - x[i], x[i + 2] - x[i + 1]
        if max(left, right) <= 2.0 * min(left, right):
            parabola = np.polyint(np.polyfit(x[i : i + 3] - x[i], f[i : i + 3], 2))
            total += np.polyval(parabola, left + right)
        else:
            total += scipy.integrate.trapezoid(f[i : i + 3], x[i : i + 3])
    return total


def regression(degree):
    def formula(row):
        """Weighted least squares by QR, its integral and the mean residual."""
        fit = np.polyfit(X[row], F[row], degree, w=PDF[row] ** -0.5)
        residual = (F[row] - np.polyval(fit, X[row])) / PDF[row]
        return np.polyval(np.polyint(fit), 1.0) + residual.mean()

    return formula


def bayesian(row):
    """Eqs. 19 to 22, the kernel's mean by adaptive quadrature."""

    def kernel(a, b):
        return np.exp(-0.5 * ((a - b) / 0.015) ** 2)

    gram = kernel(X[row][:, None], X[row]) + 1e-8 * np.eye(N)
    mean = [scipy.integrate.quad(kernel, 0, 1, args=(x,), points=[x], epsabs=1e-13)[0] for x in X[row]]
    return scipy.linalg.solve(gram, mean, assume_a="pos") @ F[row]


def stratification(row):
    """Eq. 24, strata without samples left out."""
    inside = [F[row][STRATUM[row] == s] for s in range(3)]
    return sum(area * f.mean() for area, f in zip(AREA, inside, strict=True) if len(f))


def difference(row):
    """Eq. 27 with importance sampling."""
    return INTEGRAL + np.mean((F[row] - H[row]) / PDF[row])


def difference_weights(row):
    """Eq. 29, which divides by f, on uniform samples."""
    weights = 1.0 + (INTEGRAL - H[row]) / F[row]
    return np.mean(weights * F[row])


def ratio(row):
    """Eq. 30."""
    return np.sum(F[row] / PDF[row]) / np.sum(H[row] / PDF[row]) * INTEGRAL


FORMULAS = {
    "mc": [monte_carlo],
    "trapezoid": [trapezoid, rectangle],
    "rectangle": [rectangle, trapezoid],
    "simpson": [simpson],
    "regression-1": [regression(1)],
    "regression-3": [regression(3)],
    "regression-5": [regression(5)],
    "bayesian-quadrature": [bayesian],
    "stratification": [stratification],
    "difference-cv": [difference],
    "ratio-cv": [ratio],
}
ELSEWHERE = {"gauss-legendre", "balance-heuristic"}  # on samples of their own, below


def test_every_classical_rule_has_its_formula_here():
    classical = {e.name for e in registry.entries("rule") if e.target.startswith("nqr_geom.integrator.rules:")}
    assert classical == set(FORMULAS) | ELSEWHERE


@pytest.mark.parametrize("name", FORMULAS)
def test_formula(name):
    samples = made()
    got = registry.make("rule", name).combine(samples).estimate(samples)[:, 0].numpy()
    for formula in FORMULAS[name]:
        np.testing.assert_allclose(got, [formula(row) for row in range(4)], rtol=1e-11)


def test_difference_control_variate_is_also_equation_29():
    samples = made()
    uniform = Samples(samples.x, samples.seen, torch.ones_like(samples.pdf), "random")
    got = registry.make("rule", "difference-cv").combine(uniform).estimate(uniform)[:, 0].numpy()
    np.testing.assert_allclose(got, [difference_weights(row) for row in range(4)], rtol=1e-12)


def test_simpson_on_an_equal_grid_is_scipys():
    x = np.broadcast_to((np.arange(N) + 0.5) / N, (4, N))
    samples = made(x)
    got = registry.make("rule", "simpson").combine(samples).estimate(samples)[:, 0].numpy()
    expected = scipy.integrate.simpson(F, x=x, axis=1) + (F[:, 0] + F[:, -1]) * 0.5 / N
    np.testing.assert_allclose(got, expected, rtol=1e-13)


def test_gauss_legendre_is_numpys():
    nodes, weights = np.polynomial.legendre.leggauss(N)
    samples = made(np.broadcast_to((nodes + 1.0) / 2.0, (4, N)), "gauss-legendre")
    got = registry.make("rule", "gauss-legendre").combine(samples).estimate(samples)[:, 0].numpy()
    np.testing.assert_allclose(got, F @ weights / 2.0, rtol=1e-12)


def test_balance_heuristic():
    """Eqs. 32 and 33 and the short form 35, three techniques with N samples each."""
    densities = 0.2 + RANDOM.random((2, N, 3, 3))  # [i, m, k]: density of technique k at sample i of technique m
    f = RANDOM.random((2, N, 3))
    own = np.einsum("bimm->bim", densities)
    value = torch.from_numpy(f / own)[..., None]
    seen = Observation(value, technique_pdf=torch.from_numpy(densities))
    samples = Samples(
        torch.zeros(2, N, 1, dtype=torch.float64), seen, torch.ones(2, N, 3, dtype=torch.float64), "random"
    )
    got = registry.make("rule", "balance-heuristic").combine(samples).estimate(samples)[:, 0].numpy()
    for row in range(2):
        long = short = 0.0
        for m in range(3):
            for i in range(N):
                g = densities[row, i, m]
                weight = N * g[m] / sum(N * g[k] for k in range(3))
                long += weight * f[row, i, m] / g[m] / N
                short += f[row, i, m] / sum(N * g[k] for k in range(3))
        assert got[row] == pytest.approx(long, rel=1e-13)
        assert got[row] == pytest.approx(short, rel=1e-13)


def test_a_fit_with_too_many_terms_is_refused():
    """Degree 5 in 12 dimensions has 6188 terms; degree 3 has 455 and is exact on its polynomials."""
    x = torch.rand(1, 600, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    value = (1.0 + x[..., 0] * x[..., 5] * x[..., 11])[..., None, None]
    samples = Samples(x, Observation(value), torch.ones(1, 600, 1), "given")
    fit = registry.make("rule", "regression-3").combine(samples).estimate(samples)
    np.testing.assert_allclose(fit.numpy(), 1.125, rtol=1e-6)
    with pytest.raises(ValueError, match=r"'regression-5' expected at most 1000 terms, .* has 6188 in 12 dimensions"):
        registry.make("rule", "regression-5").combine(samples)
