"""Commands that show what there is and what it costs: `frontier`, `demo`, `list`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich import box
from rich.table import Table

import nqr_geom as ng
from nqr_geom import check, registry
from nqr_geom.cli._app import app, out_console
from nqr_geom.cli._shared import Resolution, Text, progress_bar, read_curve
from nqr_geom.cli.curves import gwn, sd
from nqr_geom.curves.curve import Curve

if TYPE_CHECKING:
    from nqr_geom.integrator.frontier import Frontier

__all__ = ["demo", "frontier", "list_"]


def _on_grid(problem: str, curve: Curve, resolution: int) -> tuple[Any, list[int]]:
    """A problem on a grid around a curve, and budgets from two samples a piece on."""
    from nqr_geom.pictures import Window

    points = Window.around(curve.bounds, resolution).points
    return getattr(ng.problems, problem)(curve, points), [2 * curve.n_pieces * k for k in (1, 2, 4)]


def _measure(problem: Any, methods: Sequence[str] | None, budgets: Sequence[int], runs: int) -> Frontier:
    with progress_bar() as progress:
        task = progress.add_task("measuring")

        def tick(done: int, total: int, label: str) -> None:
            progress.update(task, completed=done, total=total, description=label)

        return ng.frontier(problem, methods, budgets, runs=runs, tick=tick)


def _show(measured: Frontier, title: str) -> None:
    """Error against time as a table, one line a method and budget."""
    table = Table(title=title, box=box.SIMPLE_HEAD)
    table.add_column("method")
    for column in ("n", "us / query", "MSE", "95% interval", "x plain MC"):
        table.add_column(column, justify="right", no_wrap=True)
    for point in measured.points:
        low, high = point.mse_interval
        ratio = "" if point.ratio is None else f"{point.ratio:.3g}" if point.ratio < 1e9 else "> 1e9"
        table.add_row(
            point.method,
            str(point.n or ""),
            f"{1e6 * point.seconds:.3g}",
            f"{point.mse:.1e}",
            f"{low:.1e} .. {high:.1e}",
            ratio,
        )
    out_console.print(table)


@app.command
def frontier(
    problem: Annotated[str, Parameter(help="A random family: toy, gwn, sd, laplace or transmittance.")] = "gwn",
    *,
    input: Annotated[str | None, Parameter(help="Measure on your own curve instead (SVG, path data, .npy).")] = None,
    text: Text = False,
    methods: Annotated[list[str] | None, Parameter(help="Methods to compare; all that fit by default.")] = None,
    budgets: Annotated[list[int] | None, Parameter(help="Samples per integral.")] = None,
    shapes: Annotated[int, Parameter(help="Shapes (or toy integrands) of the random family.")] = 8,
    runs: Annotated[int, Parameter(help="Independent runs a point.")] = 16,
    out: Annotated[Path | None, Parameter(help="A chart (.png) or all figures (.json).")] = None,
) -> None:
    """Measure error against samples and time for every method on this machine."""
    check.choice("problem", problem, [entry.name for entry in registry.entries("problem")])
    if out is not None:
        check.choice("out", out.suffix.lower(), [".png", ".json"])
    if input is not None:
        if problem not in ("gwn", "sd"):
            raise ValueError(f"problem: expected gwn or sd for a curve of your own, got {problem!r}")
        made, usual = _on_grid(problem, read_curve(input, text), 24)
    else:
        family: Any = registry.entry("problem", problem).load()
        grid = {"gwn": 24, "sd": 24, "transmittance": 16}
        size = {"resolution": grid[problem]} if problem in grid else {}
        made = family.family(check.integer("shapes", shapes, low=1), **size)
        usual = [8, 16, 32, 64]
    measured = _measure(made, methods, budgets or usual, runs)
    _show(measured, f"{problem}: error against time")
    if out is not None:
        measured.plot(out) if out.suffix.lower() == ".png" else measured.to_json(out)
        out_console.print(f"wrote {out}", highlight=False)


@app.command
def demo(
    *,
    out: Annotated[Path, Parameter(help="Folder for the pictures.")] = Path("demo-out"),
    resolution: Resolution = 400,
) -> None:
    """Winding numbers of a shipped SVG, smoothed distances of a text, and an error-against-time table."""
    from importlib.resources import as_file, files

    with as_file(files("nqr_geom") / "data" / "fish.svg") as path:
        gwn(str(path), resolution=resolution, out=out / "gwn-fish.png")
    letters = read_curve("nqr", text=True)
    sd("nqr", text=True, resolution=resolution, out=out / "sd-text.png")
    problem, budgets = _on_grid("gwn", letters, 16)
    measured = _measure(problem, ["mc", "stratified", "trapezoid", "structured"], budgets[:2], 8)
    _show(measured, f"winding number of the letters ({letters.n_pieces} pieces): error against time")
    chart = measured.plot(out / "error-against-time.png")
    out_console.print(f"wrote {chart}", highlight=False)


@app.command(name="list")
def list_(kind: Annotated[str, Parameter(help="sampler, rule, problem or model.")] = "rule") -> None:
    """List what there is: samplers, rules, problems or models."""
    table = Table()
    table.add_column("name", no_wrap=True)
    for column in ("what it does", "exact on", "dimensions"):
        table.add_column(column)
    for entry in registry.entries(kind):
        table.add_row(entry.name, entry.summary, entry.exact if kind == "rule" else "", entry.dims)
    out_console.print(table)
