"""Commands that solve an equation inside an outline: `laplace`, `p-laplace`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

import nqr_geom as ng
from nqr_geom import check
from nqr_geom.cli._app import app
from nqr_geom.cli._shared import Budget, Out, Resolution, Seed, Source, Text, draw, read_curve
from nqr_geom.curves.curve import Curve

__all__ = ["laplace", "p_laplace"]


def _read_outline(source: str, text: bool, out: Path) -> tuple[Curve, Any]:
    """A closed outline and the polygon in it, once `out` is known to be writable: solving first takes long.

    Vertices of an array keep their order, so that values can be given for each.
    """
    from nqr_geom.pictures import ENDINGS

    check.choice("out", out.suffix.lower(), ENDINGS)
    curve = read_curve(source, text)
    return curve, np.load(source, allow_pickle=False) if source.lower().endswith(".npy") and not text else curve


def _values(name: str, bounds: tuple[float, float, float, float]) -> Any:
    """Boundary values a user names: a file with one a vertex, or a function that is simple in the outline's box."""
    if name.lower().endswith(".npy"):
        if not Path(name).is_file():
            raise ValueError(f"values: expected an existing file, got {name!r}")
        return np.load(name, allow_pickle=False)
    middle = 0.5 * np.array([bounds[0] + bounds[2], bounds[1] + bounds[3]])
    half = 0.5 * max(bounds[2] - bounds[0], bounds[3] - bounds[1])
    functions = {
        "x": lambda x, y: x,
        "y": lambda x, y: y,
        "saddle": lambda x, y: x * y,
        "waves": lambda x, y: np.cos(3.0 * np.arctan2(y, x)),
    }
    function = functions[check.choice("values", name, functions)]
    return lambda points: function(*((points - middle) / half).T)


@app.command
def laplace(
    source: Source,
    *,
    values: Annotated[
        str, Parameter(help="Boundary values: x, y, saddle, waves, or a .npy file with one a vertex of a .npy outline.")
    ] = "waves",
    method: Annotated[
        str, Parameter(help="auto, wos, wos-lhs, wos-rqmc, structured, inet, nqr, boundary, fem.")
    ] = "auto",
    tol: Annotated[
        float | None,
        Parameter(help="Absolute error to reach, 1e-3 by default; the boundary solver goes to 1e-6 of the spread."),
    ] = None,
    budget: Budget = None,
    samples: Annotated[
        int | None, Parameter(name=["--samples", "-n"], help="Walks per query instead of tol (all but boundary, fem).")
    ] = None,
    text: Text = False,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("laplace.png"),
) -> None:
    """Draw the harmonic function inside a closed outline."""
    from nqr_geom.wos.domain import Domain

    curve, polygon = _read_outline(source, text, out)
    domain, boundary = Domain.of(polygon), _values(values, curve.bounds)
    if method in ("auto", "boundary") and budget is None:  # solved once for all bands of the picture
        from nqr_geom.wos.boundary import solve

        solution = solve(domain, domain.boundary(boundary), 1e-6)

        def answer(points: Any, seed: int) -> Any:
            return np.where(domain.inside(points), solution(points), np.nan)
    else:

        def answer(points: Any, seed: int) -> Any:
            return ng.solve_laplace(
                polygon, boundary, points, method=method, tol=tol, budget=budget, n=samples, seed=seed, outside="nan"
            )

    draw(curve, answer, out, resolution, "harmonic function", signed=False, seed=seed, whole=budget is not None)


@app.command
def p_laplace(
    source: Source,
    *,
    p: Annotated[float, Parameter(help="The exponent, greater than 1.")] = 3.0,
    values: Annotated[
        str, Parameter(help="Boundary values: x, y, saddle, waves, or a .npy file with one a vertex of a .npy outline.")
    ] = "waves",
    method: Annotated[str, Parameter(help="fem, or inet: a network on walks, for p from 1.5 to 6.")] = "fem",
    tol: Annotated[float | None, Parameter(help="Refine until the estimated error is at most this (fem).")] = None,
    samples: Annotated[int, Parameter(name=["--samples", "-n"], help="Walks per query (inet).")] = 32,
    text: Text = False,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("p-laplace.png"),
) -> None:
    """Draw the p-harmonic function inside a closed outline."""
    from nqr_geom.p_harmonic import METHODS, p_harmonic

    check.choice("method", method, METHODS)
    curve, polygon = _read_outline(source, text, out)
    boundary = _values(values, curve.bounds)
    if method == "fem":  # solved once for all bands of the picture
        solution = p_harmonic(polygon, boundary, p, tol=tol)

        def answer(points: Any, seed: int) -> Any:
            return solution(points, outside="nan")
    else:

        def answer(points: Any, seed: int) -> Any:
            return ng.solve_p_laplace(
                polygon, boundary, points, p, method=method, n=samples, tol=tol, outside="nan", seed=seed
            )

    draw(curve, answer, out, resolution, f"p-harmonic, p = {p:g}", signed=False, seed=seed)
