"""Observed orders of the finite elements: L2 error against mesh size, with a rate, a band and an absolute cap."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from nqr_geom.fem.linear import laplace
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.fem.space import Solution

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
L_SHAPE = np.array([[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1]])
OUTSIDE = np.array([-0.3, -0.2])
EXPONENTS = (1.2, 1.5, 2.0, 3.0, 6.0, 10.0)

Field = Callable[[np.ndarray], np.ndarray]


def l2_error(found: Solution, truth: Field) -> float:
    """Root of the integral of the squared error, by the rule that integrates sources, relative to the range."""
    x, w = found.space.source_points, found.space.source_weights
    exact = truth(x)
    values = found.offset + found.space.value @ found.coefficients
    return float(np.sqrt((w * (values - exact) ** 2).sum() / w.sum()) / np.ptp(exact))


def observed(solve: Callable[[Mesh], Solution], polygon: np.ndarray, truth: Field, order: int, n: int) -> tuple:
    """Order between a mesh and the one with half its edges, from degrees of freedom, and the smaller error."""
    found = solve(Mesh.of(polygon, n, order=order))
    coarse, fine = found.coarse, found
    assert coarse is not None
    errors = [l2_error(u, truth) for u in (coarse, fine)]
    return np.log(errors[0] / errors[1]) / np.log(np.sqrt(fine.space.size / coarse.space.size)), errors[1]


def polar_angle(x: np.ndarray) -> np.ndarray:
    return np.arctan2(x[:, 1] - OUTSIDE[1], x[:, 0] - OUTSIDE[0])


def fundamental(p: float) -> Field:
    def value(x: np.ndarray) -> np.ndarray:
        r = np.hypot(*(x - OUTSIDE).T)
        return np.log(r) if p == 2.0 else r ** ((p - 2.0) / (p - 1.0))

    return value


def wave(x: np.ndarray) -> np.ndarray:
    return np.sin(3.0 * x[:, 0]) * np.cosh(2.0 * x[:, 1])


@pytest.mark.parametrize(("order", "cap"), [(1, 2e-3), (2, 4e-5)])
@pytest.mark.parametrize("screening", [0.0, 7.0])
def test_linear_problems(order: int, cap: float, screening: float) -> None:
    def source(x: np.ndarray) -> np.ndarray:
        return (9.0 - 4.0 + screening) * wave(x)

    def solve(mesh: Mesh) -> Solution:
        return laplace(mesh, wave, source=source, screening=screening, order=order)

    rate, error = observed(solve, SQUARE, wave, order, 300)
    assert order + 1 - 0.15 < rate < order + 1 + 0.4
    assert error < cap


@pytest.mark.parametrize(("order", "cap"), [(1, 1e-3), (2, 1e-5)])
def test_corner_singularity_keeps_the_order_on_graded_meshes(order: int, cap: float) -> None:
    def corner(x: np.ndarray) -> np.ndarray:
        angle = np.arctan2(x[:, 1], x[:, 0]) % (2.0 * np.pi)
        return np.hypot(*x.T) ** (2.0 / 3.0) * np.sin(2.0 / 3.0 * angle)

    errors, sizes = [], []
    for n in (500, 4000):
        found = laplace(L_SHAPE, corner, n=n, order=order)
        errors.append(l2_error(found, corner))
        sizes.append(found.space.size)
    rate = np.log(errors[0] / errors[1]) / np.log(np.sqrt(sizes[1] / sizes[0]))
    assert rate > order + 1 - 0.25
    assert errors[1] < cap


def test_corner_singularity_spoils_the_order_on_uniform_meshes() -> None:
    def corner(x: np.ndarray) -> np.ndarray:
        angle = np.arctan2(x[:, 1], x[:, 0]) % (2.0 * np.pi)
        return np.hypot(*x.T) ** (2.0 / 3.0) * np.sin(2.0 / 3.0 * angle)

    def solve(mesh: Mesh) -> Solution:
        return laplace(mesh, corner, order=2)

    found = solve(Mesh.of(L_SHAPE, 300, order=2, graded=False))
    assert found.coarse is not None
    assert np.log2(l2_error(found.coarse, corner) / l2_error(found, corner)) < 1.6


@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("name", ["polar angle", "fundamental solution"])
def test_p_laplacian(p: float, name: str) -> None:
    truth = polar_angle if name == "polar angle" else fundamental(p)
    rate, error = observed(lambda mesh: p_laplace(mesh, truth, p, order=1), SQUARE, truth, 1, 500)
    assert 1.85 < rate < 2.4
    assert error < 1e-3


@pytest.mark.parametrize("p", [1.5, 3.0])
def test_p_laplacian_with_quadratic_elements(p: float) -> None:
    rate, error = observed(lambda mesh: p_laplace(mesh, polar_angle, p, order=2), SQUARE, polar_angle, 2, 150)
    assert 2.75 < rate < 3.5
    assert error < 5e-5
