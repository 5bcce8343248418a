"""Commands that draw fields of a curve: `gwn`, `sd`, `distance`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

import nqr_geom as ng
from nqr_geom.cli._app import app
from nqr_geom.cli._shared import Budget, Method, Out, Resolution, Samples, Seed, Source, Text, Tol, draw, read_curve

__all__ = ["distance", "gwn", "sd"]


@app.command
def gwn(
    source: Source,
    *,
    text: Text = False,
    method: Method = "exact",
    samples: Samples = 32,
    tol: Tol = None,
    budget: Budget = None,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("gwn.png"),
) -> None:
    """Draw the generalised winding number of a curve."""
    curve = read_curve(source, text)

    def answer(points: Any, seed: int) -> Any:
        return ng.gwn(curve, points, method=method, n=samples, tol=tol, budget=budget, seed=seed)

    draw(curve, answer, out, resolution, "winding number", signed=True, seed=seed, whole=budget is not None)


@app.command
def sd(
    source: Source,
    *,
    text: Text = False,
    alpha: Annotated[float, Parameter(help="Sharpness in units of one over the curve's size.")] = 35.0,
    method: Method = "exact",
    samples: Samples = 32,
    tol: Tol = None,
    budget: Budget = None,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("sd.png"),
) -> None:
    """Draw the smoothed distance to a curve."""
    curve = read_curve(source, text)
    xmin, ymin, xmax, ymax = curve.bounds
    sharpness = alpha / (0.5 * max(xmax - xmin, ymax - ymin) or 1.0)

    def answer(points: Any, seed: int) -> Any:
        return ng.sd(curve, points, alpha=sharpness, method=method, n=samples, tol=tol, budget=budget, seed=seed)

    draw(curve, answer, out, resolution, "smoothed distance", signed=False, seed=seed, whole=budget is not None)


@app.command
def distance(
    source: Source,
    *,
    text: Text = False,
    signed: Annotated[bool, Parameter(help="Negative inside (non-zero winding).")] = False,
    resolution: Resolution = 256,
    out: Out = Path("distance.png"),
) -> None:
    """Draw the distance to a curve."""
    curve = read_curve(source, text)
    answer = ng.signed_distance if signed else ng.distance
    draw(curve, lambda points, _: answer(curve, points), out, resolution, "distance", signed=signed)
