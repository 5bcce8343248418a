"""Harmonic functions and their kin on polygons: `solve_laplace` picks a solver, runs it and says what it did."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check, registry
from nqr_geom.chunks import by_chunks
from nqr_geom.pde_plans import BY_RULE, LEARNED, Solvers, first_choice, laplace_ways, spread_of
from nqr_geom.pde_walks import by_walks, deterministic

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate
    from nqr_geom.integrator.plan import Way
    from nqr_geom.wos.boundary import BoundarySolution
    from nqr_geom.wos.domain import Boundary, Domain
    from nqr_geom.wos.walk import Physics

__all__ = ["METHODS", "solve_laplace"]

Floats = NDArray[np.float64]
Source = Callable[[Floats], ArrayLike] | float | None

METHODS = ("auto", "wos", "wos-lhs", "wos-rqmc", "structured", "inet", "nqr", "boundary", "fem")
_OUTSIDE = ("raise", "nan")

_STEPS = 10_000  # of a walk that is not told otherwise: it ends after some ten or twenty


def _for_chunks(given: dict[str, Any], queries: int) -> Callable[..., Any]:
    """What answers chunks of a dask array as `solve_laplace` would answer all of its points at once."""
    from nqr_geom.wos.domain import Domain
    from nqr_geom.wos.walk import Physics

    method = check.choice("method", given["method"], METHODS)
    if method == "fem" or (method == "wos" and given["n"] is None):
        # Where the mesh is refined and how many walks there are depends on all points together.
        raise ValueError(f"method: expected 'boundary', 'wos' with n, or a rule with a dask array, got {method!r}")
    if method not in ("auto", "boundary"):
        return partial(solve_laplace, **given)
    _only_laplace("boundary", Physics(check.number("screening", given["screening"], low=0.0), given["source"]))
    domain = Domain.of(given["polygon"])
    tol = check.number("tol", 1e-3 if given["tol"] is None else given["tol"], low=0.0, open_low=True)
    # Solved here and once: the workers get the solution, and its bits do not depend on their threads.
    solution = _solved(domain.boundary(given["boundary"]), tol)
    return partial(_by_solution, solution, outside=check.choice("outside", given["outside"], _OUTSIDE))


def _by_solution(solution: BoundarySolution, points: ArrayLike, rows: ArrayLike, *, outside: str) -> Floats:
    framed, inside = inside_of(solution.domain, points, outside)
    value = np.full(len(framed), np.nan)
    value[inside] = solution.at(framed[inside])
    return value


def _only_laplace(method: str, physics: Physics) -> None:
    """Refuse a source or screening for methods that know neither."""
    if method in ("boundary", *BY_RULE) and (physics.screening > 0.0 or physics.source is not None):
        what = "screening" if physics.screening > 0.0 else "source"
        raise ValueError(f"{what}: expected none with method {method!r}, which solves Laplace's equation, got one")


@by_chunks("points", prepare=_for_chunks)
def solve_laplace(
    polygon: Any,
    boundary: Any,
    points: ArrayLike,
    *,
    method: str = "auto",
    tol: float | None = None,
    budget: float | None = None,
    n: int | None = None,
    max_steps: int | None = None,
    epsilon: float = 1e-3,
    source: Source = None,
    screening: float = 0.0,
    outside: str = "raise",
    seed: int = 0,
    rows: ArrayLike | None = None,
    full_output: bool = False,
) -> Floats | Estimate:
    """Solve -laplace(u) + screening u = source in a polygon, u = boundary on its edge, at points.

    Parameters
    ----------
    polygon : (n, 2) array_like, shapely Polygon with holes, or closed Curve
        The domain; vertices in either order. A curved outline is flattened to 1e-4 of the longer side of its box.
    boundary : callable or (n,) array_like
        Values on the edge: a function (m, 2) -> (m,), or one number a vertex in given order, linear along the edges.
        A vertex given twice may carry a jump.
    points : (m, 2) array_like, or dask array
        Queries, finite. A dask array gives one back that is computed chunk by chunk, by a method that treats every
        point by itself: "boundary" ("auto" too), which is solved once, "wos" with `n`, or one with a rule.
    method : {"auto", "wos", "wos-lhs", "wos-rqmc", "structured", "inet", "nqr", "boundary", "fem"}
        "boundary": deterministic, to many digits, Laplace only. "wos": independent walks to the epsilon shell.
        "wos-lhs": `n` walks of at most `max_steps` (12) steps with Latin hypercube directions, as in the paper.
        "wos-rqmc": such walks, sorted before every step and spread again. "structured": walks that go where none has
        ended yet; their closest points rebuild the boundary, and the answer is the mean under its harmonic measure.
        "inet": such walks, weighed by a network too; it is trained on 32 walks of 12 steps. "nqr": walks that a network
        directs step by step, weighed by the one that was trained with it; slow.
        "fem": finite elements. "auto": what should meet `tol` at the least cost.
    tol : float, optional
        Absolute error to reach, 1e-3 if nothing says how much: "auto" takes the method that should get there at the
        least cost, by measured models of costs and errors; a method that is named takes as many walks or triangles as
        that needs. Bounds on the error are checked on the way. "boundary" goes further, to 1e-8 of the spread of the
        boundary values where it can.
    budget : float, optional
        Seconds to spend: the most accurate answer within that time. Imports, compilation and a first call for one query
        do not count. With `tol` too, the cheapest answer within `tol`, as long as the time lasts.
    n : int, optional
        Walks a query, in place of tol and budget. 32 where nothing else is said for "wos-lhs", "wos-rqmc",
        "structured", "inet", "nqr", with a cap on their steps.
    max_steps : int, optional
        Jumps of a walk before it takes the boundary value closest to it; such walks are counted. 10,000 by default.
    epsilon : float
        Shell in which a walk ends, as a part of the local size of the domain, so that channels are no special case.
    source : callable or float, optional
        Right-hand side, a function (m, 2) -> (m,) or a number, in value per length squared.
    screening : float
        >= 0, per length squared.
    outside : {"raise", "nan"}
        What to do with points outside the polygon.
    seed : int
        The same seed gives the same walks, whatever else is asked for.
    rows : (m,) array_like of int, optional
        Which row of a bigger array each point is, see `gwn`.
    full_output : bool
        Return the `Estimate`: walks by outcome and steps in `counts`, the choice and the residual in `plan`.

    Returns
    -------
    (m,) float64 ndarray, or Estimate

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range, a point lies outside, or a method cannot do what is asked.

    References
    ----------
    Section 6.4 and Appendix A.5 of the paper; Sawhney, Crane, Monte Carlo geometry processing, 2020.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> ng.solve_laplace(square, [0.0, 1.0, 1.0, 0.0], [[0.25, 0.5], [0.5, 0.1]], method="boundary").round(6)
    array([0.25, 0.5 ])
    """
    from nqr_geom.integrator.plan import Clock, Goal
    from nqr_geom.integrator.pursue import pursue
    from nqr_geom.wos.domain import Domain
    from nqr_geom.wos.walk import Physics

    check.choice("method", method, METHODS)
    check.choice("outside", outside, _OUTSIDE)
    epsilon = check.number("epsilon", epsilon, low=1e-12, high=0.5)
    screening = check.number("screening", screening, low=0.0)
    seed = check.integer("seed", seed)
    n = None if n is None else check.integer("n", n, low=1)
    max_steps = None if max_steps is None else check.integer("max_steps", max_steps, low=1)
    if source is not None and not callable(source):
        source = check.number("source", source) or None
    clock = Clock.start()
    domain = Domain.of(polygon)
    values = domain.boundary(boundary)
    framed, inside = inside_of(domain, points, outside)
    keys = check.rows(rows, len(framed))[inside]
    _only_laplace(method, Physics(screening, source))  # type: ignore[arg-type]
    if method in LEARNED and max_steps not in (None, 12):
        raise ValueError(f"max_steps: expected 12 with method {method!r}, which is trained on them, got {max_steps}")
    here = framed[inside]
    asked = _Question(polygon, boundary, source, screening, domain, values, here, keys)
    solvers = asked.solvers(max_steps, epsilon, seed)
    goal = Goal.checked(len(here), tol, budget, scale=spread_of(values), size=float(len(domain)))
    if tol is None and budget is None:
        n = n or 32 if method in BY_RULE else n
        goal = replace(goal, tol=1e-3)
    everything = np.arange(len(here))
    if n is not None and method in ("wos", *BY_RULE):
        draw = solvers.walks if method == "wos" else partial(solvers.rule, method)
        estimate = draw(everything, n, 0)
        estimate = replace(estimate, plan={**estimate.plan, "method": method, "tol": tol})
    else:
        estimate = pursue(laplace_ways(solvers, None if method == "auto" else [method]), goal, clock)
    estimate = scattered(estimate, inside)
    return estimate if full_output else estimate.value[:, 0]


@dataclass(frozen=True)
class _Question:
    """What was asked, read and in the domain's frame."""

    polygon: Any
    given: Any
    source: Source
    screening: float
    domain: Domain
    values: Boundary
    framed: Floats
    keys: NDArray[np.int64]

    def solvers(self, max_steps: int | None, epsilon: float, seed: int) -> Solvers:
        """All that can answer it."""
        from nqr_geom.wos.walk import Physics

        values, here, keys, domain = self.values, self.framed, self.keys, self.domain
        physics = Physics(_in_frame("screening", self.screening, domain), _framed(domain, self.source))
        few: dict[str, Any] = {"max_steps": max_steps or 12, "epsilon": epsilon, "seed": seed}
        far = {"epsilon": epsilon, "max_steps": max_steps or _STEPS, "physics": physics}

        def rule(method: str, rows: NDArray[np.int64], n: int, k: int) -> Estimate:
            return by_rule(values, here[rows], keys[rows], *registry.method(method, "laplace"), n=n, first=k, **few)

        def fem(tol: float) -> Estimate:
            whole = _polygon(domain, self.polygon)
            return _by_fem(whole, self.given, domain.from_frame(here), tol, self.source, self.screening)

        return Solvers(
            walks=lambda rows, n, k: by_walks(values, here[rows], keys[rows], n, seed, far, k),
            rule=rule,
            boundary=lambda tol: _by_boundary(values, here, tol),
            fem=fem,
            plain=physics.screening == 0.0 and physics.source is None,
        )


def ways_of(polygon: Any, boundary: Any, points: ArrayLike, methods: list[str] | None = None) -> list[Way]:
    """The ways in which `solve_laplace` would answer, for those who measure them."""
    from nqr_geom.wos.domain import Domain

    domain = Domain.of(polygon)
    framed = inside_of(domain, points, "raise")[0]
    asked = _Question(polygon, boundary, None, 0.0, domain, domain.boundary(boundary), framed, np.arange(len(framed)))
    return laplace_ways(asked.solvers(None, 1e-3, 0), methods)


def inside_of(domain: Domain, points: ArrayLike, outside: str) -> tuple[Floats, NDArray[np.bool_]]:
    """Points in the domain's frame, and which lie inside; the first one outside is refused unless they may be there."""
    framed = domain.to_frame(points)
    inside = domain.contains(framed)
    if outside == "raise" and not inside.all():
        row = int(np.flatnonzero(~inside)[0])
        where = domain.from_frame(framed[row : row + 1])[0].tolist()
        raise ValueError(f'points: expected points inside the polygon (or outside="nan"), got {where} at row {row}')
    return framed, inside


def _in_frame(name: str, coefficient: float, domain: Domain) -> float:
    """A coefficient per squared length in the domain's frame."""
    framed = coefficient * domain.unit * domain.unit
    if not np.isfinite(framed):
        raise ValueError(
            f"{name}: expected a polygon whose squared size is finite where there is one, got {domain.unit:.3g}"
        )
    return framed


def _framed(domain: Domain, source: Source) -> Callable[[Floats], Floats] | None:
    """A source in the domain's frame, where lengths are shorter by its unit."""
    from nqr_geom.wos.domain import evaluated

    if source is None:
        return None
    area = _in_frame("source", 1.0, domain)
    if callable(source):
        function = source
        return lambda framed: area * evaluated("source", function, domain.from_frame(framed))
    return lambda framed: np.full(len(framed), area * source)


def _cheapest(values: Boundary, queries: int, tol: float, physics: Physics) -> tuple[str, str]:
    """The method that should meet the tolerance first, and the reason in words."""
    from nqr_geom.integrator.plan import Goal

    plain = physics.screening == 0.0 and physics.source is None
    return first_choice(plain, Goal(queries, tol, None, spread_of(values), float(len(values.domain))))


def _solved(values: Boundary, tol: float) -> BoundarySolution:
    from nqr_geom.wos.boundary import solve

    return solve(values.domain, values, min(tol / spread_of(values), 1e-8 if len(values.domain) <= 100 else 1e-6))


def _by_boundary(values: Boundary, framed: Floats, tol: float) -> Estimate:
    start = time.perf_counter()
    solution = _solved(values, tol)
    value = solution.at(framed)
    told = {"residual": solution.residual, "unknowns": solution.unknowns}
    estimate = deterministic(value, time.perf_counter() - start, rule="boundary", **told)
    return replace(estimate, error=np.full(len(value), solution.residual))


def _polygon(domain: Domain, polygon: Any) -> Any:
    """What the finite elements take: the user's polygon, or the flattened one of a curve."""
    from nqr_geom.curves.curve import Curve

    if not isinstance(polygon, Curve):
        return polygon
    import shapely

    rings = [domain.from_frame(domain.start[domain.loop == k]) for k in range(int(domain.loop[-1]) + 1)]
    return shapely.Polygon(rings[0], rings[1:])


def _by_fem(polygon: Any, boundary: Any, points: Floats, tol: float, source: Source, screening: float) -> Estimate:
    from nqr_geom.fem.linear import laplace

    start = time.perf_counter()
    solution = laplace(polygon, boundary, source=source, screening=screening, tol=tol, points=points)
    value, error = solution(points), np.asarray(solution.error_at(points))
    estimate = deterministic(
        value, time.perf_counter() - start, rule="fem", triangles=len(solution.space.mesh.triangles)
    )
    return replace(estimate, error=error)


def by_rule(
    values: Boundary,
    framed: Floats,
    rows: NDArray[np.int64],
    sampler: str,
    rule: str,
    *,
    n: int,
    max_steps: int,
    epsilon: float,
    seed: int,
    first: int = 0,
    p: float | None = None,
) -> Estimate:
    """The integrator on the walk problem at points inside, less a constant so that constants are exact.

    With an exponent the problem shows it to the rule.
    """
    check.require("torch", "learn", f"methods such as '{sampler}+{rule}'")
    import torch

    from nqr_geom.integrator.estimate import run
    from nqr_geom.wos.problems import LaplaceProblem, PLaplaceProblem

    level = float(values.at(np.zeros(1, dtype=np.int64), np.zeros(1))[0])
    problem = LaplaceProblem.joined([values.less(level)], [framed], max_steps, epsilon)
    problem = replace(problem, rows=torch.from_numpy(rows))
    if p is not None:
        problem = PLaplaceProblem.like(problem, p)
    estimate = run(problem, registry.make("sampler", sampler), registry.make("rule", rule), n, seed=seed, first=first)
    statistics = replace(estimate.statistics, mean=estimate.statistics.mean + level)
    return replace(estimate, value=estimate.value + level, inner=estimate.inner + level, statistics=statistics)


def scattered(estimate: Estimate, inside: NDArray[np.bool_]) -> Estimate:
    """The estimate on all points, NaN at those outside."""
    if inside.all():
        return estimate

    def spread(column: Floats) -> Floats:
        result = np.full((len(inside), column.shape[1]), np.nan)
        result[inside] = column
        return result

    fallback = np.zeros(len(inside), dtype=bool)
    fallback[inside] = estimate.fallback
    value = spread(estimate.value)
    old = estimate.statistics
    powers: dict[str, Any] = {
        name: spread(getattr(old, name)) for name in ("m2", "m3", "m4") if getattr(old, name) is not None
    }
    statistics = replace(old, mean=value, **powers)
    stderr = None if estimate.stderr is None else spread(estimate.stderr)
    inner = spread(estimate.inner)
    error = None if estimate.error is None else spread(estimate.error[:, None])[:, 0]
    estimate = replace(estimate, error=error)
    return replace(estimate, value=value, inner=inner, stderr=stderr, fallback=fallback, statistics=statistics)
