"""What several commands take, read and write: curves that a user names, fields as pictures, progress, reports."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from rich import box
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from nqr_geom import check
from nqr_geom.cli._app import error_console, out_console
from nqr_geom.curves.curve import Curve

__all__ = [
    "Budget",
    "Method",
    "Out",
    "Resolution",
    "Samples",
    "Seed",
    "Source",
    "Text",
    "Tol",
    "draw",
    "progress_bar",
    "read_curve",
    "show_estimate",
]

Source = Annotated[
    str, Parameter(help="An SVG file, SVG path data, or a .npy file with the points of a polyline (n, 2).")
]
Text = Annotated[bool, Parameter(help="Take SOURCE as text and use its outlines.")]
Method = Annotated[str, Parameter(help="exact, auto, mc, stratified, trapezoid, structured, inet, or sampler+rule.")]
Samples = Annotated[int, Parameter(name=["--samples", "-n"], help="Samples per query of a sampled method.")]
Resolution = Annotated[int, Parameter(help="Grid lines of the picture's longer side.")]
Seed = Annotated[int, Parameter(help="Seed of a sampled method.")]
Tol = Annotated[
    float | None,
    Parameter(help="Absolute error to reach in place of --samples; --method auto does it at the least cost."),
]
Budget = Annotated[
    float | None, Parameter(help="Seconds to spend, in place of --samples: the best answer in that time.")
]
Out = Annotated[Path, Parameter(help="A picture (.png), values (.npy), or a grid for ParaView (.vti, .vtp).")]


def read_curve(source: str, text: bool) -> Curve:
    """The curve a user names on the command line."""
    if text:
        return Curve.from_text(source)
    if source.lower().endswith(".npy"):
        if not Path(source).is_file():
            raise ValueError(f"source: expected an existing file, got {source!r}")
        points = np.load(source, allow_pickle=False)
        return Curve.polyline(points, closed=bool(len(points) > 2 and (points[0] == points[-1]).all()))
    return Curve.from_svg(source, flip_y=True)


def progress_bar() -> Progress:
    """A bar on standard error that leaves nothing behind."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=error_console, transient=True)


def draw(
    curve: Curve,
    answer: Callable[[Any, int], Any],
    out: Path,
    resolution: int,
    name: str,
    signed: bool,
    seed: int = 0,
    whole: bool = False,
) -> None:
    """Evaluate a field on a grid around the curve, band by band under a progress bar, and save it.

    `answer` takes points and a seed; every band has its own, or the noise of sampled methods would repeat.
    With `whole` it takes all points at once, as a time for all of them does.
    """
    from nqr_geom.pictures import ENDINGS, Window, save_field

    check.choice("out", out.suffix.lower(), ENDINGS)
    window = Window.around(curve.bounds, resolution)
    bands = np.array_split(window.points, 1 if whole else max(1, len(window.points) // 16384))
    with progress_bar() as progress:
        numbered = progress.track(list(enumerate(bands)), description=name)
        values = [answer(band, seed + (k << 32)) for k, band in numbered]
    path = save_field(out, curve, window, np.concatenate(values), name=name, signed=signed)
    out_console.print(f"{curve!r}: wrote {path}", highlight=False)


def show_estimate(title: str, estimate: Any) -> None:
    """What a scene or volume called for and what ran."""
    kernels = estimate.plan["kernels"]
    table = Table(title=title, box=box.SIMPLE_HEAD, show_header=False)
    table.add_row("effects", ", ".join(sorted(estimate.effects)) or "none")
    table.add_row("kernels", (kernels if isinstance(kernels, str) else ", ".join(kernels)) or "none")
    for kind, count in estimate.counts.items():
        table.add_row(kind, f"{count:,}")
    for stage, seconds in estimate.stages.items():
        table.add_row(f"seconds: {stage}", f"{seconds:.3f}")
    out_console.print(table)
