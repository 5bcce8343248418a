"""What a user calls: exact answers straight from the curve, sampled ones through the integrator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check, registry
from nqr_geom.chunks import by_chunks, keyed
from nqr_geom.curves.curve import BlackBoxCurve, Curve
from nqr_geom.p_harmonic import solve_p_laplace
from nqr_geom.pde import solve_laplace

if TYPE_CHECKING:
    from nqr_geom.curves.distance import ClosestPoint
    from nqr_geom.integrator.estimate import Estimate
    from nqr_geom.integrator.frontier import Frontier
    from nqr_geom.integrator.problem import Problem

__all__ = [
    "closest_point",
    "distance",
    "distance_gradient",
    "frontier",
    "gwn",
    "gwn_gradient",
    "integrate",
    "models",
    "rules",
    "samplers",
    "sd",
    "sd_gradient",
    "signed_distance",
    "solve_laplace",
    "solve_p_laplace",
]

Floats = NDArray[np.float64]


def _curve(curve: Any) -> Curve:
    if not isinstance(curve, Curve):
        raise TypeError(f"curve: expected a Curve, such as Curve.polyline(points), got {type(curve).__name__}")
    return curve


def _need_torch(purpose: str) -> None:
    check.require("torch", "learn", purpose)


def _answer(
    exact: Callable[[], Floats],
    problem: Callable[[Curve | list[Curve]], Problem],
    name: str,
    curve: Curve,
    method: str,
    n: int,
    seed: int,
    rows: ArrayLike | None,
    full_output: bool,
) -> Floats | Estimate:
    """An exact answer, or the estimate of a sampled method, for one of the problems on curves."""
    black_box = isinstance(curve, BlackBoxCurve)
    if method == "auto":
        method = "structured" if black_box else "exact"
    if method == "exact":
        if not full_output:
            return exact()
        from nqr_geom.integrator.estimate import exactly

        return exactly(exact, name)
    _need_torch(f"methods such as {method!r}")
    sampler, rule = registry.method(method, name)
    most = registry.entry("rule", rule).pieces
    # Rules that know few pieces see a long curve in parts with n samples each; their integrals add up (Fig. 25).
    parts = curve.split_pieces(most) if most and curve.n_pieces > most and not black_box else [curve]
    made = problem(parts if len(parts) > 1 else curve)
    if rows is not None:
        made = keyed(made, check.rows(rows, made.batch // len(parts)))
    estimate = integrate(made, n, sampler=sampler, rule=rule, seed=seed)
    if len(parts) > 1:
        from nqr_geom.integrator.estimate import folded

        estimate = folded(estimate, len(parts), getattr(made, "alpha", None))
    return estimate if full_output else estimate.value[:, 0]


@by_chunks("points")
def gwn(
    curve: Curve,
    points: ArrayLike,
    *,
    method: str = "exact",
    n: int = 32,
    tol: float | None = None,
    budget: float | None = None,
    seed: int = 0,
    rows: ArrayLike | None = None,
    full_output: bool = False,
) -> Floats | Estimate:
    """Generalised winding number of a curve around each query point (Eq. 5).

    Counter-clockwise is +1. On the curve itself the principal value is given, the mean of both sides: 1/2 on an edge
    of a simple polygon, the interior angle over 2 pi at its corner.

    Parameters
    ----------
    curve : Curve
        Open, closed, self-intersecting or disjoint pieces.
    points : (m, 2) array_like, or dask array
        Query points, finite. A dask array gives one back that is computed chunk by chunk, in all functions of `points`
        that return an array; the values are those of the whole, bit for bit.
    method : str
        "exact" (default), "auto" (exact where the pieces are known, else "structured"), "mc", "stratified",
        "trapezoid", "structured", "inet" (a trained network), "nqr" (a network places the samples, another weighs
        them), "student" (a small network in compiled code), or any "sampler+rule" of `samplers()` and `rules()`.
        All but "exact" see the curve through point queries only and need the extra "learn".
    n : int
        Samples per query of a sampled method; for trained ones per query and six pieces.
    tol : float, optional
        Absolute error to reach in place of n: "auto" takes the method that should get there at the least cost, by
        measured models of costs and errors; a method that is named takes as many samples as that needs. Bounds on the
        error are checked on the way; the full output's `error` has them, and its `plan` what was done and why.
    budget : float, optional
        Seconds to spend in place of n: the most accurate answer within that time. Imports, compilation and a first call
        for one query do not count. With `tol` too, the cheapest answer within `tol`, as long as the time lasts.
    seed : int
        Seed of a sampled method; the same seed gives the same answer.
    rows : (m,) array_like of int, optional
        Which row of a bigger array each point is, 0 .. m-1 if not given: it keys the random numbers, so that parts of
        an array, asked for one by one, get the answers of the whole.
    full_output : bool
        Return the `Estimate` with counts, times and error bars instead of the array.

    Returns
    -------
    (m,) float64 ndarray, or Estimate

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range, or the curve is a black box and the method "exact".

    References
    ----------
    Jacobson, Kavan, Sorkine-Hornung, Robust inside-outside segmentation using generalized winding numbers, 2013;
    Lu et al., Neural Quadrature Rule and Autoregressive Adaptive Sampling, Section 6.2.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> ng.gwn(square, [[0.5, 0.5], [2.0, 0.5], [0.5, 0.0]])
    array([1. , 0. , 0.5])
    """
    _curve(curve)

    def exact() -> Floats:
        from nqr_geom.curves import winding

        return winding.gwn(curve, points)

    def problem(curve: Curve | list[Curve]) -> Problem:
        from nqr_geom import problems

        return problems.gwn(curve, points)

    if tol is not None or budget is not None:
        from nqr_geom.plans import planned_curve

        asked: dict[str, Any] = {"method": method, "tol": tol, "budget": budget, "seed": seed, "rows": rows}
        estimate = planned_curve("gwn", curve, points, exact, problem, **asked)
        return estimate if full_output else estimate.value[:, 0]
    return _answer(exact, problem, "gwn", curve, method, n, seed, rows, full_output)


@by_chunks("points")
def sd(
    curve: Curve,
    points: ArrayLike,
    *,
    alpha: float = 35.0,
    method: str = "exact",
    n: int = 32,
    tol: float | None = None,
    budget: float | None = None,
    seed: int = 0,
    rows: ArrayLike | None = None,
    full_output: bool = False,
) -> Floats | Estimate:
    """Smoothed unsigned distance `-ln(integral of exp(-alpha |x - p|) dl) / alpha` (Eq. 50).

    Parameters
    ----------
    curve : Curve
        At least one piece of positive length.
    points : (m, 2) array_like
        Query points, finite.
    alpha : float
        Sharpness, > 0, in units of one over length. The answer lies between d_min - ln(L)/alpha and
        d_max - ln(L)/alpha for a curve of length L.
    method, n, tol, budget, seed, rows, full_output
        As for `gwn`. "exact" is adaptive quadrature to about 1e-10. "inet" is trained for alpha = 35 on shapes in
        [-1, 1]^2 and for alpha between an eighth and four times that; elsewhere it gives way to the trapezoid and the
        Estimate says so.

    Returns
    -------
    (m,) float64 ndarray, or Estimate
        In the unit of the coordinates; negative values are possible.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> segment = ng.Curve.polyline([[-1, 0], [1, 0]])
    >>> ng.sd(segment, [[0.0, 0.5]]).round(3)
    array([0.534])
    """
    _curve(curve)

    def problem(curve: Curve | list[Curve]) -> Problem:
        from nqr_geom import problems

        return problems.sd(curve, points, alpha)

    def exact() -> Floats:
        from nqr_geom.curves import smooth

        return smooth.sd(curve, points, alpha=alpha)

    if tol is not None or budget is not None:
        from nqr_geom.plans import planned_curve

        asked: dict[str, Any] = {"method": method, "tol": tol, "budget": budget, "seed": seed, "rows": rows}
        estimate = planned_curve("sd", curve, points, exact, problem, **asked)
        return estimate if full_output else estimate.value[:, 0]
    return _answer(exact, problem, "sd", curve, method, n, seed, rows, full_output)


@by_chunks("points")
def distance(curve: Curve, points: ArrayLike) -> Floats:
    """Distance from each point (m, 2) to the nearest point of the curve, (m,) float64, >= 0.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> ng.distance(ng.Curve.polyline([[0, 0], [2, 0]]), [[1.0, 0.5], [3.0, 0.0]])
    array([0.5, 1. ])
    """
    from nqr_geom.curves import distance as kernels

    return kernels.distance(_curve(curve), points)


@by_chunks("points")
def signed_distance(curve: Curve, points: ArrayLike, *, sign: str = "nonzero") -> Floats:
    """Distance with a sign, negative inside, (m,) float64.

    Parameters
    ----------
    curve : Curve
        Open curves have a soft inside: where the winding number rounds to something else than zero.
    points : (m, 2) array_like
        Query points, finite.
    sign : {"nonzero", "even-odd"}
        What is inside: a winding number that is not zero, or an odd one.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> ng.signed_distance(square, [[0.5, 0.25], [2.0, 0.5]])
    array([-0.25,  1.  ])
    """
    from nqr_geom.curves import distance as kernels

    return kernels.signed_distance(_curve(curve), points, sign=sign)


def closest_point(curve: Curve, points: ArrayLike) -> ClosestPoint:
    """Nearest point of the curve to each query (m, 2), with its distance, piece and parameter.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> nearest = ng.closest_point(ng.Curve.polyline([[0, 0], [2, 0], [2, 2]]), [[1.0, 0.5]])
    >>> nearest.point, nearest.piece, nearest.t
    (array([[1., 0.]]), array([0]), array([0.5]))
    """
    from nqr_geom.curves import distance as kernels

    return kernels.closest_point(_curve(curve), points)


@by_chunks("points", columns=2)
def gwn_gradient(curve: Curve, points: ArrayLike) -> Floats:
    """Derivative of the winding number by the query, (m, 2) float64; zero for closed curves.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> ng.gwn_gradient(ng.Curve.polyline([[1, -1], [1, 1]]), [[0.0, 0.0]]).round(4) + 0.0
    array([[0.1592, 0.    ]])
    """
    from nqr_geom.curves import winding

    return winding.gwn_gradient(_curve(curve), points)


@by_chunks("points", columns=2)
def sd_gradient(curve: Curve, points: ArrayLike, *, alpha: float = 35.0) -> Floats:
    """Derivative of the smoothed distance by the query, (m, 2) float64, of length at most 1.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> ng.sd_gradient(ng.Curve.polyline([[-1, 0], [1, 0]]), [[0.0, 0.5]]).round(2) + 0.0
    array([[0.  , 0.97]])
    """
    from nqr_geom.curves import smooth

    return smooth.sd_gradient(_curve(curve), points, alpha=alpha)


@by_chunks("points", columns=2)
def distance_gradient(curve: Curve, points: ArrayLike) -> Floats:
    """Derivative of the distance by the query, (m, 2) float64: a unit vector away from the nearest point.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> ng.distance_gradient(ng.Curve.polyline([[0, 0], [2, 0]]), [[1.0, 0.5]])
    array([[0., 1.]])
    """
    from nqr_geom.curves import distance as kernels

    return kernels.distance_gradient(_curve(curve), points)


def integrate(
    problem: Problem,
    n: int = 32,
    *,
    sampler: str = "stratified",
    rule: str = "mc",
    method: str | None = None,
    replicates: int = 1,
    tol: float | None = None,
    budget: float | None = None,
    seed: int = 0,
) -> Estimate:
    """Estimate a batch of integrals with any sampler and any rule.

    Parameters
    ----------
    problem : Problem
        From `problems`, or your own subclass of `nqr_geom.integrator.problem.Problem`.
    n : int
        Samples per integral.
    sampler, rule : str
        Names from `samplers()` and `rules()`. What does not fit is refused with the reason.
    method : str, optional
        An alias such as "structured", or "sampler+rule", instead of the two. With `tol` or `budget` also "auto": the
        best of those whose cost and error are measured on this kind of problem.
    replicates : int
        Independent repetitions to average; from 8 on they give a standard error.
    tol, budget : float, optional
        Absolute error to reach, seconds to spend, or both, in place of n and replicates, as for `gwn`.
    seed : int
        The same seed gives the same answer, whatever part of the batch is asked for.

    Returns
    -------
    Estimate

    Examples
    --------
    >>> import nqr_geom as ng
    >>> estimate = ng.integrate(ng.problems.toy(100), n=32, sampler="sobol", rule="trapezoid")
    >>> estimate.value.shape, estimate.counts["queries"]
    ((100, 1), 3200)
    """
    _need_torch("sampled methods")
    from nqr_geom.integrator.estimate import run

    planned = tol is not None or budget is not None
    if method is not None and not (planned and method == "auto"):
        sampler, rule = registry.method(method, problem.name)
    if planned:
        from nqr_geom.plans import planned_problem

        pair = None if method == "auto" else (sampler, rule)
        n, seed = check.integer("n", n, low=1), check.integer("seed", seed)
        name = method or f"{sampler}+{rule}"
        return planned_problem(problem, method=name, pair=pair, n=n, tol=tol, budget=budget, seed=seed)
    made = registry.make("sampler", sampler), registry.make("rule", rule)
    return run(problem, *made, n, replicates=replicates, seed=seed)


def frontier(
    problem: Problem,
    methods: Sequence[str] | None = None,
    budgets: Sequence[int] | None = None,
    *,
    runs: int = 16,
    seed: int = 0,
    tick: Callable[[int, int, str], None] | None = None,
) -> Frontier:
    """Measure what accuracy costs: error against samples, time and memory for each method, on this machine.

    Parameters
    ----------
    problem : Problem
        One that knows its reference.
    methods : sequence of str, optional
        Aliases or "sampler+rule"; by default those that fit the problem.
    budgets : sequence of int, optional
        Numbers of samples per integral.
    runs : int
        Independent runs a point.
    seed : int
        Seed of the first run.
    tick : callable, optional
        Called as ``tick(done, total, label)`` for a progress bar.

    Returns
    -------
    Frontier
        With `.table`, `.envelope()`, `.plot(path)` and `.to_json(path)`.
    """
    _need_torch("frontiers")
    from nqr_geom.integrator import frontier as measured

    return measured.frontier(problem, methods, budgets, runs=runs, seed=seed, tick=tick)


def samplers() -> dict[str, str]:
    """Every sampler by name, with one line of explanation.

    Examples
    --------
    >>> samplers()["grid"]
    'centres of n equal cells'
    """
    return {entry.name: entry.summary for entry in registry.entries("sampler")}


def rules() -> dict[str, str]:
    """Every rule by name, with one line of explanation."""
    return {entry.name: entry.summary for entry in registry.entries("rule")}


def models() -> dict[str, str]:
    """Every trained model by name, with one line of explanation."""
    return {entry.name: entry.summary for entry in registry.entries("model")}
