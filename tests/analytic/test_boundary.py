"""The boundary solver against harmonic functions in closed form, and its residual against its error."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from nqr_geom.wos.boundary import solve
from nqr_geom.wos.domain import Domain

RNG = np.random.default_rng(1)
ANGLE = 2 * np.pi * np.arange(19) / 19
STAR = (0.7 + 0.25 * np.cos(7 * ANGLE + 0.3))[:, None] * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
ELL = np.array([[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1.0]])
HOLES = shapely.Polygon(
    [[0, 0], [4, 0], [4, 2], [0, 2]], [[[0.5, 0.5], [1, 0.5], [1, 1.5]], [[2, 0.5], [3, 0.5], [3, 1.5], [2.2, 1.8]]]
)


def c(p):
    return p[:, 0] + 1j * p[:, 1]


def ell(p):
    """r^(2/3) sin(2 theta/3) about the re-entrant corner, zero on both of its edges."""
    theta = np.arctan2(p[:, 1], p[:, 0])
    theta = np.where(theta < -1e-12, theta + 2 * np.pi, np.maximum(theta, 0.0))
    return np.hypot(*p.T) ** (2 / 3) * np.sin(2 * theta / 3)


CASES = {
    "square, Re z^3": (SQUARE, lambda p: (c(p) ** 3).real),
    "star, Im z^5": (STAR, lambda p: (c(p) ** 5).imag),
    "star, ln": (STAR, lambda p: np.log(np.abs(c(p) - 1.1 - 0.4j))),
    "star, arg": (STAR, lambda p: np.angle(-(c(p) - 1.1 - 0.4j))),
    "corner singularity": (ELL, ell),
    "two holes": (
        HOLES,
        lambda p: np.log(np.abs(c(p) - 0.8 - 0.7j)) - 2 * np.log(np.abs(c(p) - 2.7 - 1j)) + (c(p) ** 2).imag,
    ),
    "shifted by 1e6": (STAR + 1e6, lambda p: ((c(p) - 1e6 - 1e6j) ** 3).real),
    "channel": (np.array([[0, 0], [10, 0], [10, 0.01], [0, 0.01]]), lambda p: (c(p) ** 2).real),
}


def points_in(domain: Domain, m: int = 400) -> np.ndarray:
    framed = RNG.uniform(domain.start.min(axis=0), domain.start.max(axis=0), (m, 2))
    return domain.from_frame(framed[domain.contains(framed)])


@pytest.mark.parametrize("name", CASES)
def test_harmonic_functions_to_eight_digits(name):
    polygon, truth = CASES[name]
    domain = Domain.of(polygon)
    solution = solve(domain, domain.boundary(truth), 1e-9)
    points = points_in(domain)
    error = np.abs(solution(points) - truth(points)).max()
    scale = np.ptp(truth(points))
    assert error <= 1e-8 * scale
    assert solution.residual <= 1e-8 * scale
    assert solution.rounds <= 1  # refinement must not have to hide a mistake
    if "1e6" not in name:  # there the points themselves are rounded
        assert error <= 2.0 * solution.residual + 1e-12 * scale


def test_the_iterative_solver_gives_the_same(monkeypatch):
    domain, truth = Domain.of(HOLES), CASES["two holes"][1]
    monkeypatch.setattr("nqr_geom.wos.boundary._DENSE", 0)
    solution = solve(domain, domain.boundary(truth), 1e-6)
    assert solution.residual <= 2e-5  # 1e-6 of the spread
    assert solution.rounds <= 1


@pytest.mark.parametrize("side", range(4))
def test_jump_on_the_square(side):
    values = np.zeros((4, 2))
    values[side] = 1.0
    domain = Domain.of(np.repeat(SQUARE, 2, axis=0))
    solution = solve(domain, domain.boundary(np.roll(np.repeat(values[:, 0], 2), 1)))
    assert abs(solution([[0.5, 0.5]])[0] - 0.25) < 1e-10
    assert solution.residual < 1e-9


def test_linear_data_between_random_vertices():
    """No closed form: the residual is the proof, and the mean over a circle inside is its centre."""
    domain = Domain.of(STAR)
    solution = solve(domain, domain.boundary(RNG.normal(size=19)))
    assert solution.residual < 1e-8
    turn = 2 * np.pi * np.arange(64) / 64
    ring = 0.3 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    assert abs(solution(ring).mean() - solution([[0.0, 0.0]])[0]) < 1e-12


def test_close_to_the_edge_and_on_it():
    domain, truth = Domain.of(STAR), CASES["star, ln"][1]
    solution = solve(domain, domain.boundary(truth))
    a, b = STAR[3], STAR[4]
    inward = np.array([a[1] - b[1], b[0] - a[0]]) / np.hypot(*(b - a))
    gaps = np.array([0.0, 1e-16, 1e-12, 1e-8, 1e-4])
    points = np.concatenate([0.3 * a + 0.7 * b + gaps[:, None] * inward, a + gaps[:, None] * (-a / np.hypot(*a))])
    np.testing.assert_allclose(solution(points), truth(points), atol=1e-8)


def test_a_constant_is_that_constant():
    for polygon in (STAR, HOLES):
        domain = Domain.of(polygon)
        points = points_in(domain, 50)
        for boundary in (lambda p: np.full(len(p), 0.1), np.full(domain.given, 0.1)):
            solution = solve(domain, domain.boundary(boundary))
            assert (solution(points) == 0.1).all()
            assert solution.residual == 0.0


def test_loops_that_touch_are_refused():
    touching = shapely.Polygon([[0, 0], [1, 0], [1, 1], [0, 1]], [[[0.5, 0.0], [0.6, 0.5], [0.4, 0.5]]])
    domain = Domain.of(touching)
    with pytest.raises(ValueError, match="polygon: method 'boundary'"):
        solve(domain, domain.boundary(lambda p: p[:, 0]))
