"""Harmonic functions and their kin on polygons: `solve_laplace` picks a solver, runs it and says what it did."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check, registry
from nqr_geom.chunks import by_chunks
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate, Statistics
    from nqr_geom.wos.boundary import BoundarySolution
    from nqr_geom.wos.domain import Boundary, Domain
    from nqr_geom.wos.walk import Physics

__all__ = ["METHODS", "solve_laplace"]

Floats = NDArray[np.float64]
Source = Callable[[Floats], ArrayLike] | float | None

METHODS = ("auto", "wos", "wos-lhs", "wos-rqmc", "structured", "inet", "boundary", "fem")
_OUTSIDE = ("raise", "nan")
_BY_RULE = ("wos-lhs", "wos-rqmc", "structured", "inet")  # a sampler and a rule over `n` walks of few steps

_STEPS = 10_000  # of a walk that is not told otherwise: it ends after some ten or twenty
_PILOT = 64  # walks a query before the first look at the spread
_MOST_WALKS = 2**20  # a query, before giving up on a tolerance
_TILE = 2**18  # walks held at a time
_WALK_SECONDS = 2.5e-6  # one walk on one core, for "auto" to compare with
_SURE = 3.0  # standard errors within the tolerance


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
    tol = check.number("tol", given["tol"], low=0.0, open_low=True)
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
    if method in ("boundary", *_BY_RULE) and (physics.screening > 0.0 or physics.source is not None):
        what = "screening" if physics.screening > 0.0 else "source"
        raise ValueError(f"{what}: expected none with method {method!r}, which solves Laplace's equation, got one")


@by_chunks("points", prepare=_for_chunks)
def solve_laplace(
    polygon: Any,
    boundary: Any,
    points: ArrayLike,
    *,
    method: str = "auto",
    tol: float = 1e-3,
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
    method : {"auto", "wos", "wos-lhs", "wos-rqmc", "structured", "inet", "boundary", "fem"}
        "boundary": deterministic, to many digits, Laplace only. "wos": independent walks to the epsilon shell.
        "wos-lhs": `n` walks of at most `max_steps` (12) steps with Latin hypercube directions, as in the paper.
        "wos-rqmc": such walks, sorted before every step and spread again. "structured": Latin hypercube walks whose
        closest points rebuild the boundary; the answer is the mean under its harmonic measure. "inet": the same walks,
        weighed by a network; it is trained on 32 walks of 12 steps.
        "fem": finite elements. "auto": what should meet `tol` at the least cost.
    tol : float
        Absolute error to aim for: walks are added until three standard errors are within it, unless `n` says how many.
        "boundary" goes further, to 1e-8 of the spread of the boundary values where it can.
    n : int, optional
        Walks a query. 32 by default with a cap on steps: "wos-lhs", "wos-rqmc", "structured", "inet".
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
    from nqr_geom.wos.domain import Domain
    from nqr_geom.wos.walk import Physics

    check.choice("method", method, METHODS)
    check.choice("outside", outside, _OUTSIDE)
    tol = check.number("tol", tol, low=0.0, open_low=True)
    epsilon = check.number("epsilon", epsilon, low=1e-12, high=0.5)
    screening = check.number("screening", screening, low=0.0)
    seed = check.integer("seed", seed)
    n = None if n is None else check.integer("n", n, low=1)
    max_steps = None if max_steps is None else check.integer("max_steps", max_steps, low=1)
    if source is not None and not callable(source):
        source = check.number("source", source) or None
    domain = Domain.of(polygon)
    values = domain.boundary(boundary)
    framed, inside = inside_of(domain, points, outside)
    keys = check.rows(rows, len(framed))[inside]
    physics = Physics(screening * domain.unit**2, _framed(domain, source))
    plan: dict[str, Any] = {"method": method}
    if method == "auto":
        method, why = _cheapest(values, int(inside.sum()), tol, physics)
        plan = {"method": method, "why": why}
    _only_laplace(method, physics)
    if method == "boundary":
        estimate = _by_boundary(values, framed[inside], tol)
    elif method == "fem":
        whole = _polygon(domain, polygon)
        estimate = _by_fem(whole, boundary, domain.from_frame(framed[inside]), tol, source, screening)
    elif method in _BY_RULE:
        if method == "inet" and max_steps not in (None, 12):
            raise ValueError(f"max_steps: expected 12 with method 'inet', which is trained on them, got {max_steps}")
        settings: dict[str, Any] = {"n": n or 32, "max_steps": max_steps or 12, "epsilon": epsilon, "seed": seed}
        estimate = by_rule(values, framed[inside], keys, *registry.method(method, "laplace"), **settings)
    else:
        settings = {"epsilon": epsilon, "max_steps": max_steps or _STEPS, "physics": physics}
        estimate = _by_walks(values, framed[inside], keys, n, tol, seed, settings)
    estimate = replace(estimate, plan={**estimate.plan, **plan, "tol": tol})
    estimate = scattered(estimate, inside)
    return estimate if full_output else estimate.value[:, 0]


def inside_of(domain: Domain, points: ArrayLike, outside: str) -> tuple[Floats, NDArray[np.bool_]]:
    """Points in the domain's frame, and which lie inside; the first one outside is refused unless they may be there."""
    framed = domain.to_frame(points)
    inside = domain.contains(framed)
    if outside == "raise" and not inside.all():
        row = int(np.flatnonzero(~inside)[0])
        where = domain.from_frame(framed[row : row + 1])[0].tolist()
        raise ValueError(f'points: expected points inside the polygon (or outside="nan"), got {where} at row {row}')
    return framed, inside


def _framed(domain: Domain, source: Source) -> Callable[[Floats], Floats] | None:
    """A source in the domain's frame, where lengths are shorter by its unit."""
    from nqr_geom.wos.domain import evaluated

    if source is None:
        return None
    area = domain.unit**2
    if callable(source):
        function = source
        return lambda framed: area * evaluated("source", function, domain.from_frame(framed))
    return lambda framed: np.full(len(framed), area * source)


def _cheapest(values: Boundary, queries: int, tol: float, physics: Physics) -> tuple[str, str]:
    """The method that should meet the tolerance first, and the reason in words."""
    edges = len(values.domain)
    if physics.screening > 0.0 or physics.source is not None:
        return "fem", "a source or screening, and deterministic where walks are noisy"
    probe = values.at(np.repeat(np.arange(edges), 3), np.tile([0.1, 0.5, 0.9], edges))
    walks = max(_PILOT, (_SURE * 0.3 * float(np.ptp(probe)) / tol) ** 2)
    walking = queries * walks * _WALK_SECONDS
    # Measured: dense corners, then a matrix of about 50 nodes an edge that is filled and multiplied.
    solving = 0.02 * edges + 2.5e-5 * edges**2 + 2e-7 * edges * queries
    if walking < solving:
        return "wos", f"about {walks:.2g} walks a query take {walking:.2g} s, the boundary solver {solving:.2g} s"
    return "boundary", f"about {walks:.2g} walks a query would take {walking:.2g} s, this {solving:.2g} s"


def _estimate(
    value: Floats,
    statistics: Statistics,
    stderr: Floats | None,
    n: int,
    counts: dict[str, int],
    seconds: float,
    **plan: Any,
) -> Estimate:
    from nqr_geom.integrator.estimate import Estimate

    return Estimate(
        value=value,
        stderr=stderr,
        n=n,
        inner=value,
        counts=counts,
        seconds=seconds,
        stages={"all": seconds},
        peak_memory=None,
        effects=frozenset(),
        fallback=np.zeros(len(value), dtype=bool),
        plan={"problem": "laplace", "n": n, "replicates": 1, **plan},
        statistics=statistics,
    )


def _sure(value: Floats, seconds: float, **plan: Any) -> Estimate:
    """A deterministic answer (m,) as an estimate without spread."""
    from nqr_geom.integrator.estimate import Statistics

    column = value[:, None]
    statistics = Statistics(column, np.zeros_like(column), 1, "replicates")
    counts = {"samples": 0, "queries": 0}
    return _estimate(column, statistics, None, 0, counts, seconds, sampler="none", seeds=(), **plan)


def _solved(values: Boundary, tol: float) -> BoundarySolution:
    from nqr_geom.wos.boundary import solve

    edges = len(values.domain)
    probe = values.at(np.repeat(np.arange(edges), 3), np.tile([0.1, 0.5, 0.9], edges))
    relative = tol / (float(np.ptp(probe)) or 1.0)
    return solve(values.domain, values, min(relative, 1e-8 if edges <= 100 else 1e-6))


def _by_boundary(values: Boundary, framed: Floats, tol: float) -> Estimate:
    start = time.perf_counter()
    solution = _solved(values, tol)
    value = solution.at(framed)
    told = {"residual": solution.residual, "unknowns": solution.unknowns, "met": solution.residual <= tol}
    return _sure(value, time.perf_counter() - start, rule="boundary", **told)


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
    value = solution(points)
    return _sure(value, time.perf_counter() - start, rule="fem", triangles=len(solution.space.mesh.triangles))


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
) -> Estimate:
    """The integrator on the walk problem at points inside, less a constant so that constants are exact."""
    check.require("torch", "learn", f"methods such as '{sampler}+{rule}'")
    import torch

    from nqr_geom.integrator.estimate import run
    from nqr_geom.wos.problems import LaplaceProblem

    level = float(values.at(np.zeros(1, dtype=np.int64), np.zeros(1))[0])
    problem = LaplaceProblem.joined([values.less(level)], [framed], max_steps, epsilon)
    problem = replace(problem, rows=torch.from_numpy(rows))
    estimate = run(problem, registry.make("sampler", sampler), registry.make("rule", rule), n, seed=seed)
    statistics = replace(estimate.statistics, mean=estimate.statistics.mean + level)
    return replace(estimate, value=estimate.value + level, inner=estimate.inner + level, statistics=statistics)


def _by_walks(
    values: Boundary,
    framed: Floats,
    rows: NDArray[np.int64],
    n: int | None,
    tol: float,
    seed: int,
    settings: dict[str, Any],
) -> Estimate:
    """Independent walks, as many as asked for or until every standard error is small enough."""
    start = time.perf_counter()
    stream = Stream(seed, "test", "samples/0")
    counts: dict[str, int] = {}
    total = _batch(values, framed, rows, np.arange(n or _PILOT), stream, settings, counts)
    while n is None and total.count < _MOST_WALKS and len(framed) and _SURE * _largest(total) > tol:
        wanted = total.count * (_SURE * _largest(total) / tol) ** 2
        upto = int(min(max(1.2 * wanted, 2 * total.count), 8 * total.count, _MOST_WALKS))
        fresh = np.arange(total.count, upto)
        total = total.merge(_batch(values, framed, rows, fresh, stream, settings, counts))
    told = {"met": bool(len(framed) == 0 or _SURE * _largest(total) <= tol)} if n is None else {}
    counts = {"samples": total.count * len(framed), "queries": counts.get("steps", 0), **counts}
    seconds = time.perf_counter() - start
    what = {"sampler": "random", "rule": "mc", "seeds": (seed,), **told}
    return _estimate(total.mean, total, total.stderr, total.count, counts, seconds, **what)


def _largest(statistics: Statistics) -> float:
    return float(statistics.stderr.max()) if statistics.stderr is not None else np.inf


def _batch(
    values: Boundary,
    framed: Floats,
    rows: NDArray[np.int64],
    walks: NDArray[np.int64],
    stream: Stream,
    settings: dict[str, Any],
    counts: dict[str, int],
) -> Statistics:
    """Statistics of some walks from every query, held a tile of queries and walks at a time."""
    from nqr_geom.integrator.estimate import Statistics
    from nqr_geom.wos.walk import walk

    moments = np.zeros((4, len(framed), 1))
    of = np.zeros(len(framed), dtype=np.int64)
    height = max(1, _TILE // len(walks))
    for low in range(0, len(framed), height):
        part = slice(low, low + height)
        whole: Statistics | None = None
        for first in range(0, len(walks), _TILE):
            some = walks[first : first + _TILE]
            ended = walk(values.domain.nearest, of[part], framed[part], rows[part], some, stream, **settings)
            terms = values.at(ended.edge, ended.t)
            if ended.weight is not None:
                terms = terms * ended.weight
            if ended.gained is not None:
                terms = terms + ended.gained
            for key, count in ended.counts().items():
                counts[key] = counts.get(key, 0) + count
            piece = Statistics.of(terms[..., None])
            whole = piece if whole is None else whole.merge(piece)
        if whole is not None:
            moments[:, part] = whole.mean, whole.m2, whole.m3, whole.m4
    mean, m2, m3, m4 = moments
    return Statistics(mean, m2, len(walks), "samples", m3, m4)


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
    return replace(estimate, value=value, inner=inner, stderr=stderr, fallback=fallback, statistics=statistics)
