"""How much light gets through a volume: every estimator behind one door, and references."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check, registry
from nqr_geom.chunks import by_chunks, keyed
from nqr_geom.integrator.plan import Clock, Goal
from nqr_geom.render.volume import Homogeneous, Volume

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate
    from nqr_geom.render.problems import TransmittanceProblem

__all__ = ["TRACKERS", "optical_depth", "reference", "tracked", "transmittance"]

Floats = NDArray[np.float64]

_DEEPEST = 1e6  # a tracked photon collides as often as the majorant's optical depth says
TRACKERS = ("ratio", "track-length", "unbiased-raymarching")


def _estimate(
    problem: TransmittanceProblem, value: Floats, seconds: float, n: int, seed: int, method: str, counts: dict[str, int]
) -> Estimate:
    """An estimate (B,) that no sampler and rule made; one replicate, without a standard error."""
    from nqr_geom.integrator.estimate import Estimate, Statistics

    column = value[:, None]
    return Estimate(
        value=column,
        stderr=None,
        n=n,
        inner=column,
        counts=counts,
        seconds=seconds,
        stages={"track": seconds},
        peak_memory=None,
        effects=problem.effects,
        fallback=np.zeros(len(value), dtype=bool),
        plan={
            "problem": problem.name,
            "sampler": method,
            "rule": "mean",
            "n": n,
            "replicates": 1,
            "seeds": (seed,),
        },
        statistics=Statistics(column, np.zeros_like(column), 1, "replicates"),
    )


def tracked(problem: TransmittanceProblem, method: str, n: int, seed: int) -> Estimate:
    """Estimates of one of the `TRACKERS`, which are no rules: how many samples they take depends on the samples.

    Parameters
    ----------
    problem : TransmittanceProblem
        B rays.
    method : {"ratio", "track-length", "unbiased-raymarching"}
        See `transmittance`.
    n : int
        Queries a ray: tracking repeats until it has spent more, at most n times; marching spends them on average.
    seed : int
        Of the random numbers.

    Raises
    ------
    ValueError
        If the majorant's optical depth is above 1e6, the number of steps that a single run would take.
    """
    from nqr_geom.streams import Stream

    depth = problem.rays.total * problem.medium.tensors["density"][problem.rays.volume.long()]
    if problem.batch and float(depth.max()) > _DEEPEST:
        raise ValueError(
            f"volume: expected majorant times length up to {_DEEPEST:.0e} for method {method!r}, got "
            f"{float(depth.max()):.3g}; use ray marching"
        )
    stream = Stream(seed, name=f"samples/{method}")
    start = time.perf_counter()
    if method == "unbiased-raymarching":
        from nqr_geom.integrator.estimate import tiles
        from nqr_geom.render.unbiased import march

        parts = [march(problem.take(tile), n, stream) for tile in tiles(problem.batch, 2 * n)]
        value = np.concatenate([part.value.cpu().numpy() for part in parts] or [np.empty(0)])
        counts = {"samples": problem.batch, "queries": sum(p.queries for p in parts)}
        noise = sum(p.noise for p in parts)
    else:
        from nqr_geom.render.kernels_track import track

        # Most rays that meet little density would never spend n queries: n runs are enough for them.
        out, work = track(
            problem.medium, problem.rays, problem.rows, stream.key, ratio=method == "ratio", enough=n, most=n
        )
        value = out[:, 0].cpu().numpy()
        runs, queries, noise = work.sum(dim=0).tolist()
        counts = {"samples": runs, "queries": queries}
    if problem.medium.noisy:
        counts["noise"] = noise
    return _estimate(problem, value, time.perf_counter() - start, n, seed, method, counts)


def _closed(problem: TransmittanceProblem) -> Estimate:
    """The closed form of a homogeneous medium, or of none."""
    from nqr_geom.integrator.estimate import exactly

    depth = problem.closed_depth()
    estimate = exactly(lambda: np.exp(-depth[:, 0]), problem.name)
    return replace(estimate, inner=depth, effects=problem.effects)


def _kernels(problem: TransmittanceProblem, estimate: Estimate, method: str) -> tuple[str, ...]:
    """Names of the kernel variants that ran."""
    if "exact" in estimate.stages or not problem.batch:
        return ()
    plain = "march" if "compiled" in estimate.stages else "observe"
    verb = {"ratio": "track-ratio", "track-length": "track-length"}.get(method, plain)
    return (f"{verb}[{problem.medium.name}]",)


@by_chunks("origins", "directions", "t_max")
def transmittance(
    volume: Volume,
    origins: ArrayLike,
    directions: ArrayLike,
    t_max: ArrayLike,
    *,
    n: int = 24,
    method: str = "stratified",
    tol: float | None = None,
    budget: float | None = None,
    seed: int = 0,
    rows: ArrayLike | None = None,
    full_output: bool = False,
    everything: bool = False,
) -> Floats | Estimate:
    """Part of the light that gets through a volume along each ray, T = exp(-integral of mu) (Eq. 6).

    Only what the volume calls for runs: a homogeneous medium is answered in closed form by every method, rays that miss
    the box cost no query, and noise is evaluated where it can make a difference.

    Parameters
    ----------
    volume : Volume
        A medium in a box, see `Homogeneous`, `Grid`, `Spheres`, `Torus`, `Extrusion`.
    origins, directions : (m, 3) array_like, or dask arrays
        Where rays start and go; directions of any length but zero. Dask arrays give one back that is computed chunk by
        chunk.
    t_max : float or (m,) array_like, or dask array
        Length of the rays, >= 0, in the unit of the coordinates; infinity for all of the volume.
    n : int
        Density queries per ray.
    method : str
        Ray marching: "random"; "stratified" (default: equal steps with one random shift; with either this is Kettunen's
        biased estimator, which the paper calls "Ray Marching"); "trapezoid"; "regression" (a cubic as control
        variate); "jackknife" (Peters);
        "structured" (knows the shape and the noise's statistics, places samples where the density is uncertain);
        "inet" (stratified queries weighed by a network) and "nqr" (placed by another one), for clouds like those of
        `datasets.volumes`, elsewhere flagged; or any "sampler+rule" of `samplers()` and `rules()`. With `tol` or
        `budget` also "auto". Unbiased: "unbiased-raymarching" (Kettunen; n queries on average). Tracking: "ratio" and
        "track-length", repeated until more than n queries are spent but not more than n times; a single run is
        unbiased, the mean of a number of runs that depends on them is so only nearly.
    tol : float, optional
        Absolute error of a transmittance to reach in place of n: "auto" takes the method that should get there at the
        least cost, a method that is named as many queries as that needs. Bounds on the error are checked on the way;
        the full output's `error` has them, and its `plan` what was done and why.
    budget : float, optional
        Seconds to spend in place of n: the most accurate answer within that time. Imports, compilation and a first call
        for one ray do not count. With `tol` too, the cheapest answer within `tol`, as long as the time lasts.
    seed : int
        The same seed gives the same answer for a ray, whatever other rays are asked for after it.
    rows : (m,) array_like of int, optional
        Which row of a bigger array each ray is, 0 .. m-1 if not given: it keys the random numbers.
    full_output : bool
        Return the `Estimate`: optical depths (`inner`), queries and noise evaluations (`counts`), effects, kernels
        (`plan`), time by stage.
    everything : bool
        Do all work even where the volume does not call for it; for measuring what is saved.

    Returns
    -------
    (m,) float64 ndarray, or Estimate
        Within [0, 1], but for "jackknife" and "unbiased-raymarching", which may leave it.

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range.
    ImportError
        If Warp or torch is not installed.

    References
    ----------
    Section 6.3 and Tables 4 and 12 of the paper; Novak et al., Residual ratio tracking, 2014; Novak et al., Monte Carlo
    methods for volumetric light transport simulation, 2018; Kettunen et al., An unbiased ray-marching transmittance
    estimator, 2021; Peters, Jackknife transmittance and MIS weight estimation, 2025.

    Examples
    --------
    >>> from nqr_geom import render
    >>> fog = render.Homogeneous([0, 0, 0], [1, 1, 1], density=2.0)
    >>> render.transmittance(fog, [[-1, 0.5, 0.5], [-1, 5, 5]], [[1, 0, 0], [1, 0, 0]], 10.0).round(6)
    array([0.135335, 1.      ])
    """
    check.require("torch", "render", "transmittances")
    n, seed = check.integer("n", n, low=1), check.integer("seed", seed)
    if not isinstance(volume, Volume):
        raise TypeError(f"volume: expected a Volume, such as Homogeneous(low, high), got {volume!r}")
    planned = tol is not None or budget is not None
    clock = Clock.start() if planned else Clock()
    if method not in TRACKERS and not (planned and method == "auto"):
        sampler, rule = registry.method(method, "transmittance")
    from nqr_geom.render.problems import TransmittanceProblem

    @cache
    def problem_on(support: str) -> TransmittanceProblem:
        made = TransmittanceProblem.of(volume, origins, directions, t_max, support=support, everything=everything)
        return made if rows is None else keyed(made, check.rows(rows, made.batch))

    problem = problem_on("pieces" if method == "structured" else "bounds")
    closed = problem.effects <= {Homogeneous.kind} and not everything
    if closed:
        goal = Goal.checked(problem.batch, tol, budget)
        estimate = _closed(problem)
        if planned:
            told = {"why": "closed form", "met": None if goal.tol is None else True, "tol": tol, "budget": budget}
            estimate = replace(estimate, plan={**estimate.plan, **told}, error=np.zeros(problem.batch))
    elif planned:
        from nqr_geom.integrator.pursue import pursue
        from nqr_geom.render.plans import transmittance_ways

        ways = transmittance_ways(problem_on, None if method == "auto" else [method], seed=seed)
        estimate = pursue(ways, Goal.checked(problem.batch, tol, budget), clock)
        method = estimate.plan["method"]
    elif method in TRACKERS:
        estimate = tracked(problem, method, n, seed)
    else:
        from nqr_geom.integrator.estimate import run

        estimate = run(problem, registry.make("sampler", sampler), registry.make("rule", rule), n, seed=seed)
    if not full_output:
        return estimate.value[:, 0]
    plan = {**estimate.plan, "method": method, "kernels": _kernels(problem, estimate, method)}
    return replace(estimate, plan=plan)


def reference(problem: TransmittanceProblem, runs: int = 128, seed: int = 0) -> tuple[Floats, Floats]:
    """Unbiased transmittances (B,) by the mean of `runs` ratio trackings, and their standard errors (B,).

    Never the exponential of a noisy depth: that would be biased, and so would be what is trained on it.

    Parameters
    ----------
    problem : TransmittanceProblem
        B rays; on the support "pieces" fewer queries do.
    runs : int
        >= 2.
    seed : int
        Of the runs; independent of what the same seed gives `transmittance`.
    """
    from nqr_geom.render.kernels_track import track
    from nqr_geom.streams import Stream

    runs = check.integer("runs", runs, low=2)
    key = Stream(check.integer("seed", seed), name="reference").key
    out, _ = track(problem.medium, problem.rays, problem.rows, key, ratio=True, enough=2**31 - 1, most=runs)
    mean, squares = out.cpu().numpy().T
    return mean, np.sqrt(squares / (runs - 1) / runs)


def optical_depth(problem: TransmittanceProblem, n: int = 128, seed: int = 0) -> Floats:
    """Unbiased optical depths (B,) by n stratified queries a ray; what the inner loss is measured against (Eq. 8)."""
    from nqr_geom.integrator.estimate import run
    from nqr_geom.integrator.rules import MonteCarlo
    from nqr_geom.integrator.samplers import Stratified

    return run(problem, Stratified(), MonteCarlo(), n, seed=seed, split="validation").inner[:, 0]
