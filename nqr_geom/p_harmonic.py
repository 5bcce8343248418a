"""p-harmonic functions on polygons: `solve_p_laplace` and the solution it asks, which may be asked again."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

if TYPE_CHECKING:
    from nqr_geom.fem.outline import BoundaryValues
    from nqr_geom.fem.space import Solution
    from nqr_geom.integrator.estimate import Estimate

__all__ = ["LEARNED_P", "LEARNED_RANGE", "METHODS", "p_harmonic", "solve_p_laplace"]

METHODS = ("fem", "inet")

_TRIANGLES = 8000
_COARSEST, _FINEST = 800, 400_000
LEARNED_P, LEARNED_RANGE = 3.0, (1.5, 6.0)  # what networks over walks were trained for
_LEARNED = ("walk-spread-full", "inet-p-laplace")
_OTHERS = ("walk-spread", "inet-p-laplace-range")


def solve_p_laplace(
    polygon: Any,
    boundary: BoundaryValues,
    points: ArrayLike,
    p: float = 3.0,
    *,
    method: str = "fem",
    n: int = 32,
    tol: float | None = None,
    budget: float | None = None,
    outside: str = "raise",
    seed: int = 0,
    full_output: bool = False,
) -> NDArray[np.float64] | Estimate:
    """Solve `div(|grad u|^(p-2) grad u) = 0` in a polygon, u = boundary on its edge, at points.

    Parameters
    ----------
    polygon : (n, 2) array_like, shapely Polygon with holes, or closed Curve
        The domain; vertices in either order. A curved outline is flattened to 1e-4 of the longer side of its box.
    boundary : callable or (n,) array_like
        Values on the edge: a function (m, 2) -> (m,), or, unless the polygon is a Curve, one number a vertex in given
        order, linear along the edges. A vertex given twice may carry a jump.
    points : (m, 2) array_like
        Queries, finite.
    p : float
        Greater than 1; p = 2 is Laplace's equation.
    method : {"fem", "inet"}
        "fem": finite elements with Newton's method and continuation in p. "inet": `n` walks on spheres of at most 12
        steps from every point, weighed by a network that is trained on answers of finite elements, one for p = 3 and
        one for p from 1.5 to 6; no mesh.
    n : int
        Walks a query of methods that walk; finite elements need none. The network is trained on 32.
    tol : float, optional
        Refine until the estimated absolute error at the points is at most this. By default about 8000 triangles are
        used, and ``plan["error"]`` of the full output says how good that is. Not for "inet".
    budget : float, optional
        Seconds to spend: finer and finer meshes, as long as the next one should be done in time, or `tol` is reached.
        Imports and compilation do not count. Not for "inet".
    outside : {"raise", "nan"}
        What to do with points outside the polygon.
    seed : int
        Seed of methods that walk.
    full_output : bool
        Return the `Estimate`, whose `plan` has the estimated largest error, triangles and Newton steps.

    Returns
    -------
    (m,) float64 ndarray, or Estimate

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range, or a point lies outside.
    RuntimeError
        If Newton's method or the refinement does not reach its goal; the message has the numbers.

    References
    ----------
    Appendix E.2 of the paper; Lindqvist, Notes on the p-Laplace equation, 2017.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> ng.solve_p_laplace(square, [0.0, 1.0, 3.0, 2.0], [[0.25, 0.5], [0.5, 0.1]], p=4.0).round(6)
    array([1.25, 0.7 ])
    """
    check.choice("method", method, METHODS)
    check.choice("outside", outside, ["raise", "nan"])
    n, seed = check.integer("n", n, low=1), check.integer("seed", seed)
    if method == "inet":
        if budget is not None:
            raise ValueError(f"budget: expected None with method 'inet', whose walks are said by n, got {budget!r}")
        estimate = _by_network(polygon, boundary, points, p, n, tol, outside, seed)
        return estimate if full_output else estimate.value[:, 0]
    places = check.array("points", points, ("m", 2))
    told: dict[str, Any] = {}
    if budget is not None:
        budget = check.number("budget", budget, low=0.0, open_low=True)

    def answer() -> NDArray[np.float64]:
        if budget is None:
            found = p_harmonic(polygon, boundary, p, tol=tol, points=places, outside=outside)
        else:
            found, levels = _in_time(polygon, boundary, p, tol, budget, places, outside)
            told.update(levels=levels)
        values = found(places, outside=outside)
        if full_output:
            error = float(np.nan_to_num(found.error_at(places, outside=outside)).max(initial=0.0))
            told.update(error=error, triangles=found.triangles, newton_steps=found.iterations)
        return values

    if not full_output:
        return answer()
    from nqr_geom.integrator.estimate import exactly

    estimate = exactly(answer, "p-laplace")
    plan = {**estimate.plan, "rule": "fem", "method": method, "p": float(p), "tol": tol, "budget": budget, **told}
    plan["met"] = None if tol is None else told["error"] <= tol
    error = np.full(len(estimate.value), told["error"])
    return replace(estimate, stderr=None, stages={"all": estimate.seconds}, plan=plan, error=error)


def _in_time(
    polygon: Any,
    boundary: BoundaryValues,
    p: float,
    tol: float | None,
    budget: float,
    points: NDArray[np.float64],
    outside: str,
) -> tuple[Solution, list[dict[str, float]]]:
    """The solution on the finest of a row of meshes that time allows, and what each took.

    A mesh has up to four times the triangles of the one before. What it should take is extrapolated from that one, with
    the power of the number of triangles that sparse factorisations have in the plane, 3/2.
    """
    start = time.perf_counter()
    triangles, levels = _COARSEST, []
    while True:
        began = time.perf_counter()
        found = p_harmonic(polygon, boundary, p, points=points, outside=outside, triangles=triangles)
        seconds = time.perf_counter() - began
        error = float(np.nan_to_num(found.error_at(points, outside="nan")).max(initial=0.0))
        levels.append({"triangles": float(found.triangles), "seconds": seconds, "error": error})
        left = budget - (time.perf_counter() - start)
        growth = min(4.0, (0.7 * left / seconds) ** (2.0 / 3.0)) if left > 0.0 else 0.0
        if growth < 1.5 or (tol is not None and error <= tol) or triangles >= _FINEST:
            return found, levels
        triangles = int(triangles * growth)


def _by_network(
    polygon: Any,
    boundary: BoundaryValues,
    points: ArrayLike,
    p: float,
    n: int,
    tol: float | None,
    outside: str,
    seed: int,
) -> Estimate:
    """Walks from the points inside, weighed by the network for p = 3 or by that for others; NaN outside."""
    from nqr_geom.pde import by_rule, inside_of, scattered
    from nqr_geom.wos.domain import Domain

    low, high = LEARNED_RANGE
    p = check.number("p", p, low=1.0, open_low=True)
    if not low <= p <= high:
        raise ValueError(f"p: expected {low:g} to {high:g} with method 'inet', which is trained for them, got {p!r}")
    if tol is not None:
        raise ValueError(f"tol: expected None with method 'inet', whose error is the network's, got {tol!r}")
    domain = Domain.of(polygon)
    framed, inside = inside_of(domain, points, outside)
    walks: dict[str, Any] = {"n": n, "max_steps": 12, "epsilon": 1e-3, "seed": seed}
    pair = _LEARNED if p == LEARNED_P else _OTHERS
    inner = (domain.boundary(boundary), framed[inside], np.flatnonzero(inside))
    found = by_rule(*inner, *pair, **walks, p=p)
    plan = {**found.plan, "problem": "p-laplace", "method": "inet", "p": p}
    return scattered(replace(found, plan=plan), inside)


def p_harmonic(
    polygon: Any,
    boundary: BoundaryValues,
    p: float = 3.0,
    *,
    tol: float | None = None,
    points: ArrayLike | None = None,
    outside: str = "raise",
    triangles: int = _TRIANGLES,
) -> Solution:
    """The solution that `solve_p_laplace` evaluates, to be asked at many sets of points.

    Parameters
    ----------
    polygon, boundary, p, tol, points, outside
        As for `solve_p_laplace`; `points` is where `tol` shall hold, everywhere by default.
    triangles : int
        About how many to begin with.

    Returns
    -------
    Solution
        ``solution(points, outside="nan")`` gives values, `solution.error` their estimated largest error.

    Examples
    --------
    >>> u = p_harmonic([[0, 0], [1, 0], [0, 1]], lambda x: x[:, 0] - x[:, 1], p=1.5)
    >>> u([[0.25, 0.25], [0.5, 0.1]]).round(9) + 0.0
    array([0. , 0.4])
    """
    from nqr_geom.fem.mesh import Mesh
    from nqr_geom.fem.p_laplace import default_order, p_laplace

    p = check.number("p", p, low=1.0, open_low=True)
    order = default_order(p)
    # Half the length of these edges is what is solved on: a quarter of the triangles.
    mesh = Mesh.of(_straight(polygon, boundary), triangles // 4, order=order)
    if points is None:
        return p_laplace(mesh, boundary, p, order=order, tol=tol)
    places = check.array("points", points, ("m", 2))
    inside = mesh.locate(places)[0] >= 0
    if outside == "raise" and not inside.all():
        row = int(np.flatnonzero(~inside)[0])
        where = places[row].tolist()
        raise ValueError(f'points: expected points inside the polygon (or outside="nan"), got {where} at row {row}')
    return p_laplace(mesh, boundary, p, order=order, tol=tol, points=places[inside])


def _straight(polygon: Any, boundary: BoundaryValues) -> Any:
    """What the finite elements take: the user's polygon, or a curve flattened."""
    from nqr_geom.curves.curve import Curve

    if not isinstance(polygon, Curve):
        return polygon
    if not callable(boundary):
        raise ValueError("boundary: expected a callable where the polygon is a Curve, got values")
    from shapely import Polygon

    from nqr_geom.wos.domain import Domain

    domain = Domain.of(polygon)
    rings = [domain.from_frame(domain.start[domain.loop == k]) for k in range(int(domain.loop[-1]) + 1)]
    return Polygon(rings[0], rings[1:])
