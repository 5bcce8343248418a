"""Laplace problems that break naive solvers: (polygon, boundary, point, expected, tolerance), by every method."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

import nqr_geom as ng

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
ELL = np.array([[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1.0]])
CHANNEL = np.array([[0, 0], [10, 0], [10, 0.01], [0, 0.01]])
RIM = 2 * np.pi * np.arange(100) / 100
RING = np.stack([np.cos(RIM), np.sin(RIM)], axis=1)
METHODS = ("boundary", "wos", "fem")


def top(p):
    return (p[:, 1] == 1.0).astype(float)


def ell(p):
    theta = np.arctan2(p[:, 1], p[:, 0])
    theta = np.where(theta < -1e-12, theta + 2 * np.pi, np.maximum(theta, 0.0))
    return np.hypot(*p.T) ** (2 / 3) * np.sin(2 * theta / 3)


def log(p):
    return np.log(np.hypot(*p.T)) / np.log(2.0)


def arg(p):
    return np.angle(-(p[:, 0] + 1j * p[:, 1] - 1.2 - 0.5j))


CASES = {
    "jump on the square": (np.repeat(SQUARE, 2, axis=0), [0, 0, 0, 0, 0, 1, 1, 0], [[0.5, 0.5]], 0.25, 1e-9),
    "annulus": (shapely.Polygon(2 * RING, [RING]), log, [[1.5, 0.0]], np.log2(1.5), 1e-9),
    "annulus, hole turned": (shapely.Polygon(2 * RING, [RING[::-1]]), log, [[0.0, -1.5]], np.log2(1.5), 1e-9),
    "annulus of constants": (
        shapely.Polygon(2 * RING, [RING]),
        np.repeat([1.0, 0.0], 100),
        [[1.5, 0.0]],
        np.log2(1.5),
        5e-4,  # the polygons are not circles: O(1/m^2)
    ),
    "re-entrant corner": (ELL, ell, [[-0.2, 0.3], [-0.01, 0.01]], None, 1e-9),
    "argument": (SQUARE, arg, [[0.9, 0.5], [0.1, 0.2]], None, 1e-9),
    "channel": (CHANNEL, lambda p: p[:, 1] / 0.01, [[5.0, 0.0025], [0.1, 0.005]], [0.25, 0.5], 1e-8),
    "far away": (SQUARE + 1e6, lambda p: p[:, 0] - 1e6, [[1e6 + 0.25, 1e6 + 0.5]], 0.25, 1e-8),
    "tiny": (SQUARE * 1e-6, lambda p: p[:, 0] * 1e6, [[0.25e-6, 0.5e-6]], 0.25, 1e-9),
    "huge": (SQUARE * 1e6, lambda p: p[:, 0] * 1e-6, [[0.25e6, 0.5e6]], 0.25, 1e-9),
    "repeats": (SQUARE[[0, 0, 1, 1, 2, 3, 3, 0]], lambda p: p[:, 0], [[0.25, 0.5]], 0.25, 1e-9),
    "collinear": (
        np.concatenate([np.linspace(SQUARE[k], SQUARE[(k + 1) % 4], 5, endpoint=False) for k in range(4)]),
        lambda p: p[:, 0],
        [[0.25, 0.5]],
        0.25,
        1e-9,
    ),
    "beside the edge": (SQUARE, lambda p: p[:, 0], [[0.25, 1e-9], [0.25, 0.0], [0.0, 0.0]], [0.25, 0.25, 0.0], 1e-8),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_case(name, method):
    polygon, boundary, points, expected, tolerance = CASES[name]
    truth = boundary(np.asarray(points)) if expected is None else np.broadcast_to(expected, len(points))
    walks = {"n": 4000} if method == "wos" else {}
    got = ng.solve_laplace(polygon, boundary, points, method=method, full_output=True, **walks)
    if method == "wos":  # four standard errors, and the shell
        tolerance = 4.0 * got.stderr[:, 0] + 2e-3
    elif method == "fem":
        tolerance = max(tolerance, 2e-3)
    assert (np.abs(got.value[:, 0] - truth) <= tolerance).all()


def test_an_absolute_shell_would_be_wrong_in_the_channel():
    """A shell of 1e-3 of the domain stops nearly at once here; this is the bias that local sizes take away."""
    point = [[5.0, 0.0025]]
    right = ng.solve_laplace(CHANNEL, lambda p: p[:, 1] / 0.01, point, method="wos", n=20000, full_output=True)
    wide = ng.solve_laplace(CHANNEL, lambda p: p[:, 1] / 0.01, point, method="wos", n=20000, epsilon=0.49)
    assert abs(right.value[0, 0] - 0.25) < 4.0 * right.stderr[0, 0] + 1e-3
    assert abs(wide[0] - 0.25) > 0.015


@pytest.mark.parametrize("method", ["auto", "wos", "wos-lhs", "wos-rqmc", "structured", "inet", "boundary", "fem"])
@pytest.mark.parametrize("value", [0.1, -7.0, 1e60])
def test_a_constant_is_that_constant_exactly(method, value):
    polygon = shapely.Polygon(2 * RING[::8], [RING[::8]])
    points = [[1.5, 0.0], [0.0, 1.2]]
    for boundary in (np.full(2 * len(RING[::8]), value), lambda p: np.full(len(p), value)):
        assert (ng.solve_laplace(polygon, boundary, points, method=method, n=50) == value).all()


@pytest.mark.parametrize("method", ["wos", "wos-lhs", "wos-rqmc", "structured", "inet", "boundary", "fem"])
def test_points_outside_are_refused_or_nan(method):
    points = [[0.5, 0.5], [2.0, 0.5], [1e200, 0.0]]
    with pytest.raises(ValueError, match=r"points: expected points inside.*row 1"):
        ng.solve_laplace(SQUARE, np.arange(4.0), points, method=method)
    got = ng.solve_laplace(SQUARE, np.arange(4.0), points, method=method, n=16, outside="nan")
    assert np.isfinite(got).tolist() == [True, False, False]


def test_maximum_principle():
    points = np.random.default_rng(0).random((200, 2))
    for method in ("wos", "wos-lhs", "wos-rqmc", "structured", "boundary"):
        got = ng.solve_laplace(SQUARE, [0.0, 1.0, -1.0, 0.5], points, method=method, n=16)
        assert -1.0 - 1e-9 <= got.min() <= got.max() <= 1.0 + 1e-9


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": "magic"}, "method: expected one of auto, wos, wos-lhs, wos-rqmc, structured, inet, boundary, fem"),
        ({"points": [[np.nan, 0.5]]}, "points: expected finite"),
        ({"points": [0.5, 0.5]}, "points: expected shape"),
        ({"tol": 0.0}, "tol: "),
        ({"n": 0}, "n: "),
        ({"epsilon": 2.0}, "epsilon: "),
        ({"screening": -1.0}, "screening: "),
        ({"outside": "clip"}, "outside: "),
        ({"method": "boundary", "source": 1.0}, "source: expected none with method 'boundary'"),
        ({"method": "wos-lhs", "screening": 1.0}, "screening: expected none with method 'wos-lhs'"),
        ({"method": "inet", "source": 1.0}, "source: expected none with method 'inet'"),
        ({"method": "inet", "max_steps": 20}, "max_steps: expected 12 with method 'inet'"),
        ({"boundary": [1.0, 2.0]}, "boundary: expected 4 values"),
        ({"polygon": SQUARE[[0, 2, 1, 3]]}, "polygon: expected an outline that does not cross"),
        ({"method": "wos", "source": lambda p: p}, "source: expected a callable that gives shape"),
    ],
)
def test_bad_input_is_refused_by_name(change, words):
    arguments = {"polygon": SQUARE, "boundary": np.zeros(4), "points": [[0.5, 0.5]], **change}
    with pytest.raises(ValueError, match=words):
        ng.solve_laplace(**arguments)


def test_auto_says_what_it_chose():
    cheap = ng.solve_laplace(SQUARE, np.arange(4.0), [[0.5, 0.5]], tol=0.5, full_output=True)
    assert (cheap.plan["method"], "walks" in cheap.plan["why"]) == ("wos", True)
    many = np.random.default_rng(0).random((1000, 2))
    dear = ng.solve_laplace(SQUARE, np.arange(4.0), many, tol=1e-4, full_output=True)
    assert dear.plan["method"] == "boundary"
    assert dear.plan["residual"] < 1e-4
    assert ng.solve_laplace(SQUARE, np.zeros(4), [[0.5, 0.5]], source=1.0, full_output=True).plan["method"] == "fem"


def test_no_points():
    for method in ("wos", "wos-lhs", "wos-rqmc", "structured", "inet", "boundary", "fem"):
        assert ng.solve_laplace(SQUARE, np.arange(4.0), np.zeros((0, 2)), method=method).shape == (0,)
