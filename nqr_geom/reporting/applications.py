"""What is measured: an application is a batch of integrals with true answers and all that can answer them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.reporting.contenders import Contender, Solver, contenders_for, trackers_for
from nqr_geom.reporting.scipy_peer import tanh_sinh
from nqr_geom.reporting.settings import Sizes

if TYPE_CHECKING:
    from nqr_geom.integrator.problem import Problem
    from nqr_geom.wos.problems import LaplaceProblem

__all__ = ["APPLICATIONS", "Application", "build", "toward_laplace", "toward_p_laplace"]

Floats = NDArray[np.float64]

# Name -> title and what one integral is.
APPLICATIONS = {
    "gwn": ("Winding number", "generalised winding number of a curve around a query point (Eq. 5)"),
    "sd": ("Smoothed distance", "smoothed distance from a query point to a curve, alpha = 35 (Eq. 50)"),
    "toy": ("Toy family", "integral over [0, 1] of a piecewise smooth function with hidden breaks (Fig. 37)"),
    "laplace": ("Laplace", "harmonic function at a point, by walks on spheres of at most 12 steps (Section 6.4)"),
    "p-laplace": ("p-Laplace, p = 3", "3-harmonic function at a point, by the same walks (Appendix E.2)"),
    "transmittance": ("Transmittance", "light that gets through a volume along a ray (Eq. 6)"),
    "direct": ("Direct light", "light that reaches a pixel by one reflection (Section 6.1)"),
}


@dataclass(frozen=True)
class Application:
    """One application on one batch of integrals.

    Attributes
    ----------
    name : str
        A key of `APPLICATIONS`.
    inputs : str
        What the integrals belong to, in words.
    problem : Problem
        The batch.
    truth : callable
        Gives the true answers (B, C); asked once.
    truth_from : str
        Where they come from.
    contenders : list of Contender
        Methods that spend samples.
    solvers : list of Solver
        Methods that do not.
    baseline : str
        The contender whose error is the unit of ratios.
    bars : bool
        Whether the baseline's error bars aim at the truth, so that their coverage means something.
    scale : int
        Times the usual numbers of samples: curves of many pieces need more.
    """

    name: str
    inputs: str
    problem: Problem
    truth: Callable[[], Floats]
    truth_from: str
    contenders: list[Contender]
    solvers: list[Solver] = field(default_factory=list)
    baseline: str = "mc"
    bars: bool = True
    scale: int = 1

    @property
    def title(self) -> str:
        """Heading."""
        return APPLICATIONS[self.name][0]


def _known(problem: Problem) -> Callable[[], Floats]:
    def truth() -> Floats:
        found = problem.reference()
        if found is None:
            raise ValueError(f"problem: expected one with a reference, {problem.name!r} has none")
        return found

    return truth


def _peers(problem: Problem) -> list[Solver]:
    """The problem's own list of other solvers."""
    return [Solver(*name.partition(", ")[::2], solve) for name, solve in problem.peers().items()]


def _toy(sizes: Sizes, seed: int) -> Application:
    from nqr_geom.toy.problem import ToyProblem

    problem = ToyProblem.family(sizes.toy, seed)
    contenders = [*contenders_for(problem, everything=sizes.everything), tanh_sinh(problem)]
    return Application("toy", f"{sizes.toy:,} random functions", problem, _known(problem), "closed form", contenders)


def on_curves(name: str, inputs: str, problem: Problem, everything: bool) -> Application:
    """An application of curves on any batch of queries."""

    def logarithm(inner: Floats) -> Floats:
        alpha: float = problem.alpha  # type: ignore[attr-defined]
        return -np.log(np.maximum(inner, 1e-300)) / alpha

    scipy = tanh_sinh(problem, logarithm) if name == "sd" else tanh_sinh(problem)
    contenders = [*contenders_for(problem, everything=everything), scipy]
    source = "roots and subtended angles, exact" if name == "gwn" else "adaptive quadrature, about 1e-10"
    return Application(name, inputs, problem, _known(problem), source, contenders, _peers(problem))


def _curves(name: str, sizes: Sizes, seed: int) -> Application:
    from nqr_geom import registry

    family: Any = registry.entry("problem", name).load()
    problem = family.family(sizes.shapes, seed, resolution=sizes.grid)
    return on_curves(name, f"{sizes.shapes} random curves (Fig. 38), a grid of queries each", problem, sizes.everything)


def toward_laplace(inputs: str, problem: LaplaceProblem, polygons: list[Any], sizes: Sizes) -> Application:
    """Harmonic functions on given domains; `polygons` are what finite elements take, with boundary values."""
    from nqr_geom.fem.linear import laplace

    def boundary(tolerance: float) -> Floats:
        from nqr_geom.wos.boundary import solve

        def one(k: int) -> Floats:
            domain = problem.boundaries[k].domain
            return solve(domain, problem.boundaries[k], tolerance).at(problem.points.numpy()[problem.groups == k])

        return _domain_by_domain(problem, one)

    def elements(triangles: int) -> Floats:
        return _by_elements(problem, polygons, partial(laplace, n=triangles))

    solvers = [Solver("finite elements", f"from {n:,} triangles", partial(elements, n)) for n in sizes.triangles]
    solvers += [Solver("boundary integral", f"to {tol:.0e}", partial(boundary, tol)) for tol in sizes.residuals]
    contenders = contenders_for(problem, everything=sizes.everything)
    contenders = [one for one in contenders if one.pair[1] != "inet-p-laplace"]
    source = f"boundary integral to a residual of {sizes.truth:.0e} of the spread of the boundary values"
    return Application("laplace", inputs, problem, lambda: boundary(sizes.truth), source, contenders, solvers)


def toward_p_laplace(inputs: str, problem: LaplaceProblem, polygons: list[Any], sizes: Sizes) -> Application:
    """3-harmonic functions on given domains."""
    from nqr_geom.fem.linear import laplace
    from nqr_geom.fem.mesh import Mesh
    from nqr_geom.fem.p_laplace import p_laplace

    def elements(triangles: int) -> Floats:
        def solve(polygon: Any, values: Any) -> Any:
            return p_laplace(Mesh.of(polygon, triangles, order=2), values, 3.0, order=2)

        return _by_elements(problem, polygons, solve)

    names = {  # the last two aim at p = 2 and show what bending the answer is worth
        ("random", "mc"): "mc for p = 2",
        ("latin-hypercube", "inet-laplace-uniform"): "inet for p = 2",
        ("walk-spread-full", "inet-p-laplace"): "inet",
    }
    found = {one.pair: one for one in contenders_for(problem)}
    contenders = [replace(found[pair], name=name) for pair, name in names.items() if pair in found]
    solvers = [Solver("finite elements", f"from {n:,} triangles", partial(elements, n)) for n in sizes.p_triangles[:-1]]
    solvers.append(Solver("exact for p = 2", "", partial(_by_elements, problem, polygons, partial(laplace, n=2000))))
    best = sizes.p_triangles[-1]
    source = f"quadratic finite elements from {best:,} triangles"
    options: dict[str, Any] = {"baseline": "mc for p = 2", "bars": False}
    return Application("p-laplace", inputs, problem, lambda: elements(best), source, contenders, solvers, **options)


def _domain_by_domain(problem: LaplaceProblem, one: Callable[[int], Floats]) -> Floats:
    """Answers (B, 1) from one call a domain."""
    groups, result = problem.groups, np.empty((problem.batch, 1))
    for k in np.unique(groups):
        result[groups == k, 0] = one(int(k))
    return result


def _by_elements(problem: LaplaceProblem, polygons: list[Any], solve: Callable[..., Any]) -> Floats:
    """Answers (B, 1) of `solve(polygon, values)`, a solution that can be asked at points, domain by domain."""

    def one(k: int) -> Floats:
        places = problem.boundaries[k].domain.from_frame(problem.points.numpy()[problem.groups == k])
        return np.asarray(solve(*polygons[k])(places), dtype=np.float64)

    return _domain_by_domain(problem, one)


def _walks(name: str, sizes: Sizes, seed: int) -> Application:
    from nqr_geom.wos.families import polygons
    from nqr_geom.wos.problems import LaplaceProblem

    problem = LaplaceProblem.family(sizes.polygons, seed, points=sizes.points)
    made = polygons(sizes.polygons, seed=seed)
    given = list(zip(made.vertices, made.values, strict=True))
    inputs = f"{sizes.polygons} random polygons (Fig. 41), {sizes.points} queries each"
    return (toward_laplace if name == "laplace" else toward_p_laplace)(inputs, problem, given, sizes)


def _transmittance(sizes: Sizes, seed: int) -> Application:
    from nqr_geom.render.problems import TransmittanceProblem

    problem = TransmittanceProblem.family(sizes.volumes, seed, resolution=sizes.rays)
    return on_rays(f"{sizes.volumes} random clouds (Fig. 40), a grid of rays each", problem, sizes.everything)


def on_rays(inputs: str, problem: Any, everything: bool) -> Application:
    """Transmittance of any rays."""
    contenders = [*contenders_for(problem, everything=everything), *trackers_for(problem)]
    contenders.append(tanh_sinh(problem, lambda inner: np.exp(-np.maximum(inner, 0.0))))
    source = "unbiased marches with 2,048 queries a ray, or the closed form where there is one"
    return Application("transmittance", inputs, problem, _known(problem), source, contenders, [], "random")


def on_pixels(inputs: str, problem: Any, everything: bool) -> Application:
    """Direct light in any pixels."""
    contenders = contenders_for(problem, everything=everything)
    source = "4,096 passes in 16 runs"
    return Application("direct", inputs, problem, _known(problem), source, contenders, [], "random")


def _direct(sizes: Sizes, seed: int) -> Application:
    from nqr_geom.render.direct_problem import DirectProblem

    problem = DirectProblem.family(sizes.scenes, seed, resolution=sizes.pixels)
    return on_pixels(f"{sizes.scenes} random scenes (Fig. 39)", problem, sizes.everything)


def build(name: str, sizes: Sizes, seed: int) -> Application:
    """The application on its random family.

    Parameters
    ----------
    name : str
        A key of `APPLICATIONS`.
    sizes : Sizes
        How many shapes and queries.
    seed : int
        Which random family.
    """
    if name in ("gwn", "sd"):
        return _curves(name, sizes, seed)
    if name in ("laplace", "p-laplace"):
        return _walks(name, sizes, seed)
    return {"toy": _toy, "transmittance": _transmittance, "direct": _direct}[name](sizes, seed)
