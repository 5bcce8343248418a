"""The command that measures everything on this machine and writes it as a page: `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import nqr_geom as ng
from nqr_geom.cli._app import app, out_console
from nqr_geom.cli._shared import Seed, Text, progress_bar

__all__ = ["report"]


@app.command
def report(
    *,
    quick: Annotated[bool, Parameter(help="About two minutes on two idle cores; what is done without --full.")] = False,
    full: Annotated[bool, Parameter(help="More methods, larger budgets, narrow intervals; takes long.")] = False,
    apps: Annotated[
        list[str] | None,
        Parameter(help="Some of gwn, sd, toy, laplace, p-laplace, transmittance, direct.", consume_multiple=True),
    ] = None,
    input: Annotated[
        str | None,
        Parameter(
            help="Your own curve (SVG, path data, .npy points), volume (.npy densities) or scene (.json, mesh file)."
        ),
    ] = None,
    text: Text = False,
    seed: Seed = 0,
    out: Annotated[Path, Parameter(help="Folder; one that was begun with the same options is gone on with.")] = Path(
        "nqr-geom-report"
    ),
) -> None:
    """Measure what accuracy costs on this machine, for every application, and write it as one HTML page."""
    if quick and full:
        raise ValueError("full: expected --quick or --full, got both")
    with progress_bar() as progress:
        task = progress.add_task("preparing", total=None)

        def tick(done: int, total: int, label: str) -> None:
            progress.update(task, completed=done, total=total, description=label[:48])

        mode = "full" if full else "quick"
        made = ng.report(out, mode=mode, apps=apps, input=input, text=text, seed=seed, tick=tick)
    out_console.print(f"{made['cells']} cells in {made['took']}: wrote {out / 'report.html'}", highlight=False)
