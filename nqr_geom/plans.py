"""The ways in which winding numbers and smoothed distances can be answered, for `tol=` and `budget=`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check, registry
from nqr_geom.chunks import keyed
from nqr_geom.curves.curve import BlackBoxCurve, Curve
from nqr_geom.integrator.estimate import Estimate, exactly, folded

if TYPE_CHECKING:
    from nqr_geom.integrator.plan import Way
    from nqr_geom.integrator.problem import Problem

__all__ = ["curve_unit", "curve_ways", "models_of", "planned_curve", "planned_problem"]

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

# What "auto" chooses from; networks are left to those who name them.
_METHODS = ("structured", "trapezoid", "stratified", "mc")
_EXACT = {"gwn": 1e-11, "sd": 1e-9}  # measured against libigl and closed forms; distances relative to the curve's size
_SHORT = 1e-3  # seconds
_FEWEST = 32  # independent samples, before their spread says anything
_FEW_POINTS = 64  # of a black box, to see how big it is


def models_of(name: str, curve: Curve) -> str:
    """Under which name the models of a problem on such a curve are kept: a callable costs more."""
    return f"{name}-callable" if isinstance(curve, BlackBoxCurve) else name


def curve_unit(name: str, curve: Curve) -> dict[str, float]:
    """Scale of errors and number of pieces: winding numbers have no unit, distances that of the coordinates."""
    size = float(max(curve.n_pieces, 1))
    if name == "gwn":
        return {"scale": 1.0, "size": size}
    if isinstance(curve, BlackBoxCurve):
        points = curve.sample((np.arange(_FEW_POINTS) + 0.5) / _FEW_POINTS)
        low, high = points.min(axis=0), points.max(axis=0)
    else:
        low, high = np.reshape(curve.bounds, (2, 2))
    return {"scale": 0.5 * float((high - low).max()) or 1.0, "size": size}


def curve_ways(
    name: str,
    curve: Curve,
    exact: Callable[[], Floats] | None,
    problem: Callable[[Curve | list[Curve]], Problem],
    *,
    seed: int,
    methods: Sequence[str] | None = None,
    keys: Rows | None = None,
) -> list[Way]:
    """Exact evaluation where the curve's pieces are known, and sampled methods.

    Parameters
    ----------
    name : {"gwn", "sd"}
    curve : Curve
    exact : callable
        Gives the exact answers; not called for black boxes.
    problem : callable
        The problem on the curve, or on the parts of it that a list holds.
    seed : int
        Of the sampled methods.
    methods : sequence of str, optional
        Only these.
    keys : (m,) ndarray, optional
        Rows that key the random numbers.
    """
    from nqr_geom.integrator.models import model, unknown
    from nqr_geom.integrator.plan import Way

    black_box, models = isinstance(curve, BlackBoxCurve), models_of(name, curve)
    ways: list[Way] = []
    if exact is not None and not black_box and (methods is None or "exact" in methods):
        off = _EXACT[name] * curve_unit(name, curve)["scale"]

        def solve(tol: float) -> Estimate:
            found = exactly(exact, name)
            return replace(found, error=np.full(len(found.value), off))

        ways.append(Way("exact", model(models, "exact") or unknown(), solve=solve))
        if methods is None and not _has_torch():
            return ways
    for method in _METHODS if methods is None else methods:
        if method != "exact":
            ways.append(_sampled(name, curve, problem, method, models, seed, keys))
    return ways


def _has_torch() -> bool:
    import importlib.util

    return importlib.util.find_spec("torch") is not None


def _sampled(
    name: str,
    curve: Curve,
    problem: Callable[[Curve | list[Curve]], Problem],
    method: str,
    models: str,
    seed: int,
    keys: Rows | None,
) -> Way:
    """A sampled method; rules that know few pieces see a long curve in parts (Fig. 25)."""
    from nqr_geom.integrator.models import model, unknown
    from nqr_geom.integrator.plan import Way

    sampler, rule = registry.method(method, name)
    most = registry.entry("rule", rule).pieces
    known = model(models, method) or model(models, f"{sampler}+{rule}") or unknown()
    split = most and curve.n_pieces > most and not isinstance(curve, BlackBoxCurve)
    parts = curve.split_pieces(most) if split else [curve]
    alone = sampler == "random" and rule == "mc"
    least = _FEWEST if alone else 4
    if method == "structured":
        # A callable may wind about inside a piece: a few points more, so that two sizes do not agree on nonsense.
        least = max(2 * curve.n_pieces, 16 if isinstance(curve, BlackBoxCurve) else 4)
    made: list[Any] = []  # the problem and its pair, once a first sample is wanted

    def draw(rows: Rows, n: int, k: int) -> Estimate:
        import torch

        from nqr_geom.integrator.estimate import run

        if not made:
            pair = registry.make("sampler", sampler), registry.make("rule", rule)
            whole = problem(parts if len(parts) > 1 else curve)
            made.extend((whole if keys is None else keyed(whole, keys), *pair))
        whole, maker, weigher = made
        count = whole.batch // len(parts)
        if len(rows) < count:
            index = (np.arange(len(parts))[:, None] * count + rows).ravel()
            whole = whole.take(torch.from_numpy(index))
        found = run(whole, maker, weigher, n, seed=seed, first=k)
        return folded(found, len(parts), getattr(whole, "alpha", None)) if len(parts) > 1 else found

    return Way(method, known, draw=draw, least=least, independent=alone)


def planned_curve(
    name: str,
    curve: Curve,
    points: ArrayLike,
    exact: Callable[[], Floats],
    problem: Callable[[Curve | list[Curve]], Problem],
    *,
    method: str,
    tol: float | None,
    budget: float | None,
    seed: int,
    rows: ArrayLike | None,
) -> Estimate:
    """`gwn` or `sd` to a tolerance, within a time, or both."""
    from nqr_geom.integrator.plan import Clock, Goal, forecast

    clock = Clock.start()
    count = len(check.array("points", points, ("m", 2)))
    goal = Goal.checked(count, tol, budget, **curve_unit(name, curve))
    keys = None if rows is None else check.rows(rows, count)
    told: dict[str, Any] = {"seed": check.integer("seed", seed), "keys": keys}
    ways: list[Way] = []
    if method == "auto" and goal.tol is not None and goal.budget is None:
        alone = curve_ways(name, curve, exact, problem, methods=["exact"], **told)
        ways = [way for way in alone if forecast(way, goal).seconds < _SHORT]  # weighing others would take as long
    if not ways:
        methods = None if method == "auto" else [method]
        ways = curve_ways(name, curve, exact, problem, methods=methods, **told)
    if not ways:  # "exact" on a black box, which says why not
        exact()
    if any(way.sampled for way in ways):
        check.require("torch", "learn", f"methods such as {method!r}")
    from nqr_geom.integrator.pursue import pursue

    return pursue(ways, goal, clock)


def planned_problem(
    problem: Problem,
    *,
    method: str,
    pair: tuple[str, str] | None,
    n: int,
    tol: float | None,
    budget: float | None,
    seed: int,
) -> Estimate:
    """`integrate` to a tolerance, within a time, or both: by one sampler and rule, or by any measured one."""
    from nqr_geom.integrator.plan import Clock, Goal
    from nqr_geom.integrator.pursue import pursue
    from nqr_geom.integrator.ways import measured_methods, sampled_way

    clock = Clock.start()
    goal = Goal.checked(problem.batch, tol, budget)
    if pair is None:
        methods = [m for m in measured_methods(problem.name) if m not in ("exact", "boundary", "fem", "wos")]
        if not methods:
            raise ValueError(
                f"method: expected one that is named, got 'auto': no method is measured on {problem.name!r}"
            )
        ways = [sampled_way(problem, m, seed=seed, least=4) for m in methods]
    else:
        ways = [sampled_way(problem, method, seed=seed, least=min(n, 16), pair=pair)]
    return pursue(ways, goal, clock)
