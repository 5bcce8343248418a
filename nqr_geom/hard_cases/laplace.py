"""Laplace, Poisson and screened problems that break naive solvers, by every method that fits.

Errors of deterministic methods are absolute, those of walks count standard errors beyond the bias of the shell. Truths
are harmonic functions in closed form, Bessel functions of scipy on discs, and symmetry.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import shapely

import nqr_geom as ng
from nqr_geom.hard_cases.case import Case, deviation, refusal, sigmas
from nqr_geom.hard_cases.shapes import Floats, koch, ring

__all__ = ["TABLE", "UNIT", "Row", "cases", "top"]

UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
ELL = np.array([[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1.0]])
CHANNEL = np.array([[0, 0], [10, 0], [10, 0.01], [0, 0.01]])
ANNULUS = shapely.Polygon(2 * ring(100), [ring(100)])
_TEETH = [[k + d, h] for k in range(5) for d, h in ((0, 1), (0.02, 1), (0.02, 0.1), (1, 0.1))]
COMB = np.array([*_TEETH, [5, 0], [0, 0]])
_HOLES = [[(i + 0.5) / 5, (j + 0.5) / 5] for i in range(5) for j in range(5) if i + j != 4]
SIEVE = shapely.Polygon(UNIT, [np.array(centre) + ring(8, 0.03)[::-1] for centre in _HOLES])
_SHELL = 2e-3  # bias of a relative shell of 1e-3 where the data span about one


class Row(NamedTuple):
    """One domain with boundary data and queries; `expected` None takes the boundary function's own values."""

    name: str
    polygon: Any
    boundary: Any
    points: Any
    expected: Any
    tolerance: float


def top(p: Floats) -> Floats:
    """One on the upper edge of the unit square."""
    return np.asarray(p[:, 1] == 1.0, dtype=float)


def first(p: Floats) -> Floats:
    """The first coordinate."""
    return p[:, 0]


def corner(p: Floats) -> Floats:
    """r^(2/3) sin(2 theta/3), the singular function of the L-shape."""
    theta = np.arctan2(p[:, 1], p[:, 0])
    theta = np.where(theta < -1e-12, theta + 2 * np.pi, np.maximum(theta, 0.0))
    return np.asarray(np.hypot(*p.T) ** (2 / 3) * np.sin(2 * theta / 3))


def power(n: int, part: str) -> Callable[[Floats], Floats]:
    """Real or imaginary part of (z - 0.3 - 0.4 i)^n."""
    return lambda p: np.asarray(getattr(((p @ [1, 1j]) - 0.3 - 0.4j) ** n, part))


def argument(p: Floats) -> Floats:
    """The angle about a point to the right of the square, cut away from it."""
    return np.angle(-(p[:, 0] + 1j * p[:, 1] - 1.2 - 0.5j))


def logarithm(p: Floats) -> Floats:
    """log2 of the distance from the origin."""
    return np.asarray(np.log2(np.hypot(*p.T)))


def exponential(p: Floats) -> Floats:
    """Re exp(6 z): from 1e0 to 4e2 within the square, oscillating."""
    return np.asarray(np.exp(6 * p[:, 0]) * np.cos(6 * p[:, 1]) / 400)


_DENSE = np.concatenate([np.linspace(UNIT[k], UNIT[(k + 1) % 4], 5, endpoint=False) for k in range(4)])
_ROWS: list[tuple[Any, ...]] = [
    ("jump on the square", np.repeat(UNIT, 2, axis=0), [0, 0, 0, 0, 0, 1, 1, 0], [[0.5, 0.5]], 0.25, 1e-9),
    ("annulus", ANNULUS, logarithm, [[1.5, 0.0]], None, 1e-9),
    ("annulus, hole turned", shapely.Polygon(2 * ring(100), [ring(100)[::-1]]), logarithm, [[0.0, -1.5]], None, 1e-9),
    # Polygons are no circles: O(1/m^2).
    ("annulus of constants", ANNULUS, np.repeat([1.0, 0.0], 100), [[1.5, 0.0]], np.log2(1.5), 5e-4),
    ("re-entrant corner", ELL, corner, [[-0.2, 0.3], [-0.01, 0.01]], None, 1e-9),
    ("argument of a point outside", UNIT, argument, [[0.9, 0.5], [0.1, 0.2]], None, 1e-9),
    ("real part of a 5th power", UNIT, power(5, "real"), [[0.5, 0.5], [0.9, 0.1]], None, 1e-9),
    ("imaginary part of an 8th power", ELL, power(8, "imag"), [[-0.5, 0.5], [0.7, 0.4]], None, 1e-7),
    ("logarithm of a point 0.05 outside", UNIT - [1.05, 0.5], logarithm, [[-0.1, 0.0], [-0.9, 0.3]], None, 1e-8),
    ("exponential over three decades", UNIT, exponential, [[0.5, 0.5], [0.05, 0.9]], None, 1e-8),
    ("channel", CHANNEL, lambda p: p[:, 1] / 0.01, [[5.0, 0.0025], [0.1, 0.005]], [0.25, 0.5], 1e-8),
    ("needle with an angle of 1e-3", np.array([[0, 0], [1, -5e-4], [1, 5e-4]]), first, [[0.5, 0], [0.01, 0]], None,
     1e-8),
    ("comb with teeth 0.02 wide", COMB, lambda p: p[:, 1] - p[:, 0] / 5, [[0.01, 0.9], [2.5, 0.05], [4.01, 0.5]], None,
     1e-7),
    ("sieve of 20 holes", SIEVE, power(2, "real"), [[0.1, 0.9], [0.9, 0.1], [0.02, 0.02]], None, 1e-7),
    ("snowflake", koch(2), power(2, "imag"), [[0.0, 0.0], [0.6, 0.1]], None, 1e-7),
    ("shift 1e6", UNIT + 1e6, lambda p: p[:, 0] - 1e6, [[1e6 + 0.25, 1e6 + 0.5]], 0.25, 1e-8),
    *((f"square [scale {s:g}]", UNIT * s, lambda p, s=s: p[:, 0] / s, [[0.25 * s, 0.5 * s]], 0.25, 1e-9)
      for s in (1e-6, 1e6)),
    ("repeated vertices", UNIT[[0, 0, 1, 1, 2, 3, 3, 0]], first, [[0.25, 0.5]], None, 1e-9),
    ("collinear vertices", _DENSE, first, [[0.25, 0.5]], None, 1e-9),
    ("beside the edge, on it and on a vertex", UNIT, first, [[0.25, 1e-9], [0.25, 0.0], [0.0, 0.0]], None, 1e-8),
]  # fmt: skip
TABLE = [Row(*row) for row in _ROWS]


def _truth(row: Row) -> Floats:
    if row.expected is None:
        return np.asarray(row.boundary(np.asarray(row.points, dtype=float)))
    return np.broadcast_to(np.asarray(row.expected, dtype=float), len(row.points))


def _solve(row: Row, method: str) -> float:
    got: Any = ng.solve_laplace(row.polygon, row.boundary, row.points, method=method)
    return deviation(got, _truth(row))


def _walk(row: Row, n: int = 4000) -> float:
    """In standard errors; data are counted by their spread at the queries' scale, which is about one."""
    got: Any = ng.solve_laplace(row.polygon, row.boundary, row.points, method="wos", n=n, full_output=True)
    return sigmas(got.value[:, 0], got.stderr[:, 0], _truth(row), _SHELL)


def naive_mean(row: Row) -> float:
    """Inverse squared distances instead of a harmonic measure, over 4,096 points of the outline."""
    shape = row.polygon if isinstance(row.polygon, shapely.Polygon) else shapely.Polygon(row.polygon)
    line = shapely.MultiLineString([shape.exterior, *shape.interiors])
    edge = shapely.get_coordinates(shapely.segmentize(line, line.length / 4096))
    edge = edge[np.isfinite(row.boundary(edge))]
    weight = 1.0 / np.maximum(((np.asarray(row.points, dtype=float)[:, None] - edge) ** 2).sum(axis=2), 1e-300)
    return deviation((weight * row.boundary(edge)).sum(axis=1) / weight.sum(axis=1), _truth(row))


def _channel(epsilon: float) -> float:
    """The bias of a shell: an absolute one of 1e-3 of the domain is 0.49 of this channel's half width."""
    solve = partial(ng.solve_laplace, CHANNEL, lambda p: p[:, 1] / 0.01, [[5.0, 0.0025]], method="wos", n=20000)
    got: Any = solve(epsilon=epsilon, full_output=True)
    return sigmas(got.value[:, 0], got.stderr[:, 0], 0.25, 1e-3)


def _capped(epsilon: float, expected: float) -> float:
    """12 steps in a square: how far the share of unfinished walks is from what a shell of that width leaves."""
    points = np.random.default_rng(0).random((400, 2))
    got: Any = ng.solve_laplace(
        UNIT, np.zeros(4), points, method="wos", n=64, max_steps=12, epsilon=epsilon, full_output=True
    )
    whole = got.counts["walks_boundary"] + got.counts["walks_capped"]
    return abs(got.counts["walks_capped"] / whole - expected) if whole == 400 * 64 else float("nan")


def _coverage() -> float:
    """95% intervals of 500 seeds at the centre of a square whose upper edge is hot: distance from 0.95."""
    got: Any = ng.solve_laplace(UNIT, top, np.full((500, 2), 0.5), method="wos", n=256, epsilon=1e-5, full_output=True)
    return float(abs(np.mean(np.abs(got.value[:, 0] - 0.25) <= 1.96 * got.stderr[:, 0]) - 0.95))


def _maximum(method: str) -> float:
    """How far values leave the range of the boundary data."""
    points = np.random.default_rng(0).random((200, 2))
    got = np.asarray(ng.solve_laplace(UNIT, [0.0, 1.0, -1.0, 0.5], points, method=method, n=16))
    return float(max(0.0, got.max() - 1.0, -1.0 - got.min()))


def _constant(method: str, value: float) -> float:
    polygon = shapely.Polygon(2 * ring(13), [ring(13)])
    points = [[1.5, 0.0], [0.0, 1.2]]
    solve: Any = partial(ng.solve_laplace, polygon, points=points, method=method, n=50)
    return max(
        deviation(solve(data), value, abs(value)) for data in (np.full(26, value), lambda p: np.full(len(p), value))
    )


def _disc(kind: str, method: str, screening: float = 0.0) -> float:
    """-laplace u = 1: (1 - r^2)/4. Screened with boundary 1: I0(k r)/I0(k), scaled where k is large."""
    from scipy.special import ive

    r, k = np.array([0.0, 0.5, 0.9]), np.sqrt(screening)
    points = np.stack([r, 0 * r], axis=1)
    source = {"poisson": 1.0, "both": screening}.get(kind)
    boundary = np.zeros(400) if kind == "poisson" else np.ones(400)
    truth = 0.25 * (1 - r**2) if kind == "poisson" else ive(0, k * r) / ive(0, k) * np.exp(k * (r - 1.0))
    if kind == "both":  # u = 1 solves it
        truth = np.ones(3)
    solve = partial(ng.solve_laplace, ring(400), boundary, points, screening=screening, source=source, full_output=True)
    if method == "fem":
        got: Any = solve(method="fem", tol=1e-4)
        return deviation(got.value[:, 0], truth)
    got = solve(method="wos", n=8000)
    return sigmas(got.value[:, 0], got.stderr[:, 0], truth, _SHELL)


def _outside(method: str) -> float:
    """NaN outside, values inside, where NaN was asked for."""
    points = [[0.5, 0.5], [2.0, 0.5], [1e200, 0.0]]
    got: Any = ng.solve_laplace(UNIT, np.arange(4.0), points, method=method, n=16, outside="nan")
    return 0.0 if np.isfinite(got).tolist() == [True, False, False] else float("inf")


def _gradient(height: float) -> float:
    """Of 3 x - 2 y at some height over the edge, in standard errors."""
    data = lambda p: 3.0 * p[:, 0] - 2.0 * p[:, 1]  # noqa: E731
    got: Any = ng.laplace_gradient(UNIT, data, [[0.4, height]], n=2048, epsilon=1e-5, full_output=True)
    return sigmas(got.value, got.stderr, [[3.0, -2.0]], 1e-3)


def outside_refused(group: str, method: str) -> Case:
    """Queries outside are refused by row."""
    call = partial(ng.solve_laplace, UNIT, np.arange(4.0), [[0.5, 0.5], [2.0, 0.5]], method=method)
    return refusal(group, f"outside [{method}]", call, r"points: expected points inside.*row 1")


_REFUSED: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("no such method", {"method": "magic"}, "method: expected one of auto, wos, wos-lhs, wos-rqmc, structured, inet"),
    ("a query that is no number", {"points": [[np.nan, 0.5]]}, "points: expected finite"),
    ("a query of the wrong shape", {"points": [0.5, 0.5]}, "points: expected shape"),
    ("no tolerance", {"tol": 0.0}, "tol: "),
    ("no walks", {"n": 0}, "n: "),
    ("a shell wider than the domain", {"epsilon": 2.0}, "epsilon: "),
    ("negative screening", {"screening": -1.0}, "screening: "),
    ("no such treatment of outside", {"outside": "clip"}, "outside: "),
    ("a source for the boundary solver", {"method": "boundary", "source": 1.0}, "source: expected none with method"),
    ("too few values", {"boundary": [1.0, 2.0]}, "boundary: expected 4 values"),
    ("an outline that crosses itself", {"polygon": UNIT[[0, 2, 1, 3]]}, "polygon: expected an outline that does not"),
    ("a source of the wrong shape", {"method": "wos", "source": lambda p: p}, "source: expected a callable that gives"),
)  # fmt: skip

_DEAR = ("comb with teeth 0.02 wide", "snowflake", "needle with an angle of 1e-3")  # for finite elements
_NAIVE = (
    "re-entrant corner",
    "argument of a point outside",
    "real part of a 5th power",
    "channel",
    "sieve of 20 holes",
)


def cases() -> list[Case]:
    """Laplace problems without extras: boundary solver, finite elements and independent walks."""
    group, made = "laplace", []
    for row in TABLE:
        naive = partial(naive_mean, row) if row.name in _NAIVE else None
        variant = row.name if row.name.endswith("]") else f"{row.name} [boundary]"
        made.append(Case(group, variant, partial(_solve, row, "boundary"), row.tolerance, naive))
        if not row.name.endswith("]"):
            if row.name not in _DEAR:
                bound = max(row.tolerance, 2e-3)
                made.append(Case(group, f"{row.name} [fem]", partial(_solve, row, "fem"), bound))
            made.append(Case(group, f"{row.name} [wos]", partial(_walk, row), 4.0))
    made.append(Case(group, "channel: a local shell", partial(_channel, 1e-3), 4.0, partial(_channel, 0.49)))
    # Measured for an absolute shell; a local one is a little narrower.
    for epsilon, expected in ((1e-2, 0.09), (1e-3, 0.25), (1e-4, 0.42)):
        name = f"walks cut off after 12 steps are counted [epsilon {epsilon:g}]"
        made.append(Case(group, name, partial(_capped, epsilon, expected + 0.06), 0.09))
    made.append(Case(group, "95% intervals of 500 seeds", _coverage, 0.03))
    for method in ("wos", "boundary"):
        made.append(Case(group, f"maximum principle [{method}]", partial(_maximum, method), 1e-9))
    for method in ("auto", "wos", "boundary", "fem"):
        for value in (0.1, -7.0, 1e60):
            made.append(Case(group, f"a constant [{value:g}, {method}]", partial(_constant, method, value), 0.0))
    for method, bound in (("fem", 3e-4), ("wos", 4.0)):
        made.append(Case(group, f"source 1 on a disc [{method}]", partial(_disc, "poisson", method), bound))
        for s in (1.0, 50.0):
            name = f"screened on a disc [{s:g}, {method}]"
            made.append(Case(group, name, partial(_disc, "screened", method, s), max(bound, 1e-3)))
    made.append(Case(group, "screened hard on a disc [1e6, wos]", partial(_disc, "screened", "wos", 1e6), 4.0))
    made.append(Case(group, "source and screening that make one [wos]", partial(_disc, "both", "wos", 50.0), 4.0))
    for height in (0.5, 1e-4):
        made.append(Case(group, f"gradient above an edge [{height:g}]", partial(_gradient, height), 4.0))
    for method in ("wos", "boundary", "fem"):
        made.append(Case(group, f"NaN outside [{method}]", partial(_outside, method), 0.0))
        made.append(outside_refused(group, method))
    for name, change, words in _REFUSED:
        arguments = {"polygon": UNIT, "boundary": np.zeros(4), "points": [[0.5, 0.5]], **change}
        made.append(refusal(group, name, partial(ng.solve_laplace, **arguments), words))
    call = partial(ng.laplace_gradient, UNIT, np.arange(4.0), [[0.5, 0.5], [0.5, 0.0]])
    made.append(refusal(group, "gradient on the edge", call, "points: expected points off the edge.*row 1"))
    return made
