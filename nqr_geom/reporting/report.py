"""`nqr_geom.report`: measure, keep, and write the page and the JSON beside it."""

from __future__ import annotations

import gc
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from random import Random
from typing import Any

from nqr_geom import check
from nqr_geom.files import write_whole
from nqr_geom.machine import cores, machine, versions

__all__ = ["report"]

Tick = Callable[[int, int, str], None]
Record = dict[str, Any]

_BUSY = 1.3  # load over cores from which times are not to be trusted
_PACKAGES = ("numpy", "scipy", "numba", "torch", "warp-lang", "scikit-fem", "libigl", "plotly")


def report(
    out: str | os.PathLike[str] = "nqr-geom-report",
    *,
    mode: str = "quick",
    apps: Sequence[str] | None = None,
    input: Any = None,
    text: bool = False,
    seed: int = 0,
    tick: Tick | None = None,
) -> Record:
    """Measure what accuracy costs on this machine, application by application, and write it as one page.

    Every method that fits (classical, structure-aware, student and trained networks, exact answers, finite elements,
    boundary integrals, other libraries) at several budgets: error against queries and time with 95% intervals, who is
    best from which time on, from which cost of a query on a network pays, time by stage, memory, how often error bars
    hold, what it saves to run only what a scene calls for, and the hard cases. What has been measured is kept in the
    folder at once, cell by cell: a report that was killed goes on where it stopped when it is called again.

    Parameters
    ----------
    out : str or path
        Folder for `report.html`, `report.json` and the cells; made if it is not there. A folder of another
        configuration (mode, seed, input, version, machine) is refused.
    mode : {"quick", "full"}
        About two minutes on two idle cores, or far longer with more methods, larger budgets and narrow intervals.
    apps : sequence of str, optional
        Some of "gwn", "sd", "toy", "laplace", "p-laplace", "transmittance", "direct"; by default all that fit.
    input : str, path, Curve, Scene, Volume or (n, 2) array_like, optional
        Your own curve (SVG file, path data, points), polygon, volume (.npy densities) or scene (.json, mesh file)
        instead of the random families.
    text : bool
        Take `input` as text and use its outlines.
    seed : int
        Of inputs and runs.
    tick : callable, optional
        Called as ``tick(done, total, label)`` after every cell.

    Returns
    -------
    dict
        What `report.json` holds.

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, an application does not fit the input, or the folder is another report's.
    ImportError
        If the extra "report" is not installed.

    Examples
    --------
    On your own polygon ``report("costs", input=points, apps=["gwn", "laplace"])`` writes costs/report.html.

    >>> report("costs", mode="slow")
    Traceback (most recent call last):
    ValueError: mode: expected one of quick, full, got 'slow'
    """
    from nqr_geom.reporting.settings import MODES

    check.choice("mode", mode, MODES)
    return measured(Path(out), MODES[mode], mode=mode, apps=apps, input=input, text=text, seed=seed, tick=tick)


def measured(
    folder: Path, sizes: Any, *, mode: str, apps: Any, input: Any, text: bool, seed: int, tick: Tick | None
) -> Record:
    """`report` with any sizes."""
    check.require("jinja2", "report", "report pages")
    check.require("plotly", "report", "report pages")
    check.require("torch", "report", "reports")
    from nqr_geom.reporting.applications import APPLICATIONS, build
    from nqr_geom.reporting.measuring import Run
    from nqr_geom.reporting.own import own
    from nqr_geom.reporting.pages import render_page
    from nqr_geom.reporting.store import Store

    seed = check.integer("seed", seed)
    theirs = None if input is None else own(input, text)
    identity = None if theirs is None else theirs.identity
    names = _chosen(
        apps, tuple(APPLICATIONS) if theirs is None else tuple(theirs.makers), {} if theirs is None else theirs.unfit
    )
    began, load = time.perf_counter(), os.getloadavg()[0]
    stamp = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    store = Store(folder / "cells", _configuration(mode, sizes, seed, identity))
    progress = _Progress(tick)
    runs: list[Any] = []
    for name in names:
        progress.label(f"preparing {name}")
        made = build(name, sizes, seed) if theirs is None else theirs.makers[name](sizes)
        runs.append(Run(made, sizes, seed, store, progress.step))
    scenic = tuple(name for name in names if name in ("direct", "transmittance")) if theirs is None else ()
    groups = _hard_groups() if theirs is None and apps is None else ()
    progress.total = sum(run.cells for run in runs) + bool(scenic) + len(groups)
    with _collected():
        records = [run.measure() for run in runs]
        effects = _effects(scenic, sizes, store, progress)
        hard = [_hard(group, sizes.hard_seconds, store, progress) for group in groups]
    load = max(load, os.getloadavg()[0])
    made_of: Record = {
        "mode": mode,
        "seed": seed,
        "input": None if theirs is None else theirs.label,
        "begun": stamp,
        "took": _spoken(time.perf_counter() - began),
        "machine": machine(),
        "versions": versions(*_PACKAGES),
        "load": round(load, 1),
        "busy": load > _BUSY * cores(),
        "command": _command(mode, apps, theirs, seed),
        "cells": progress.done,
        "cell_seconds": sizes.cell_seconds,
        "hard_seconds": sizes.hard_seconds,
        "effect_pixels": sizes.effect_pixels,
        "effect_repeats": sizes.effect_repeats,
        "applications": records,
        "effects": effects,
        "hard": hard,
        "json_name": "report.json",
    }
    write_whole(folder / "report.json", json.dumps(made_of, indent=1, allow_nan=False) + "\n")
    write_whole(folder / "report.html", render_page(made_of))
    return made_of


class _Progress:
    """Counts cells for a caller who wants to know."""

    def __init__(self, tick: Tick | None) -> None:
        self.tick, self.done, self.total = tick, 0, 0

    def label(self, text: str) -> None:
        """Tell without counting."""
        if self.tick is not None:
            self.tick(self.done, max(self.total, 1), text)

    def step(self, text: str) -> None:
        """One more cell."""
        self.done += 1
        self.label(text)


@contextmanager
def _collected() -> Iterator[None]:
    """What is alive now is left out of garbage collection: looking through it before each of many cells takes long."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _chosen(apps: Any, fitting: tuple[str, ...], unfit: Mapping[str, str]) -> tuple[str, ...]:
    """The applications that were asked for, in the page's order."""
    from nqr_geom.reporting.applications import APPLICATIONS

    if apps is None:
        return fitting
    if isinstance(apps, str):
        raise TypeError(f"apps: expected a sequence of names, got the single name {apps!r}")
    names = [check.choice("apps", name, APPLICATIONS) for name in apps]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"apps: expected one or more different names, got {apps!r}")
    for name in names:
        if name not in fitting:
            raise ValueError(f"apps: {name!r} does not fit the input: {unfit[name]}")
    return tuple(name for name in APPLICATIONS if name in names)


def _configuration(mode: str, sizes: Any, seed: int, identity: str | None) -> Record:
    """What all cells of a folder have in common."""
    return {
        "mode": mode,
        "sizes": asdict(sizes),
        "seed": seed,
        "input": identity,
        "machine": {key: value for key, value in machine().items() if key in ("processor", "cores", "system")},
        "versions": versions("numpy", "scipy", "torch"),
    }


def _effects(scenic: tuple[str, ...], sizes: Any, store: Any, progress: _Progress) -> list[Record]:
    """The table of effects for the applications that have them."""
    if not scenic:
        return []
    key = f"effects: {', '.join(scenic)}"
    rows: list[Record] | None = store.get(key)
    if rows is None:
        from nqr_geom.reporting.effects import table

        rows = table(scenic, sizes.effect_pixels, sizes.effect_repeats)
        store.put(key, rows)
    progress.step("effects")
    return rows


def _hard_groups() -> tuple[str, ...]:
    from nqr_geom.hard_cases import groups

    return groups()


def _hard(group: str, limit: float, store: Any, progress: _Progress) -> Record:
    """Results of one group of hard cases; an error that is not finite is none, with words.

    With a limit of seconds cases come in an order that is shuffled, so that those that are run are of all kinds.
    """
    from nqr_geom.hard_cases import cases, missing

    key = f"hard cases: {group}"
    kept: Record | None = store.get(key)
    if kept is None:
        extra = missing(group)
        kept = {"group": group, "reason": None if extra is None else f'it needs the extra "{extra}"', "results": []}
        todo = [] if extra else cases(group)
        Random(0).shuffle(todo)
        kept["cases"] = len(todo)
        begin = time.perf_counter()
        for case in todo:
            if time.perf_counter() - begin > limit:
                break
            one = case.measure()
            error = one.error if math.isfinite(one.error) else None
            kept["results"].append(asdict(one) | {"holds": one.holds, "error": error})
            progress.label(f"{group}: {case.name}")
        store.put(key, kept)
    progress.step(key)
    return kept


def _spoken(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} minutes"


def _command(mode: str, apps: Any, theirs: Any, seed: int) -> str:
    """The command line that makes this report."""
    parts = ["nqr-geom report"] + (["--full"] if mode == "full" else [])
    if theirs is not None:
        parts.append(f"--input {theirs.label}")
    if apps is not None:
        parts += [f"--apps {name}" for name in apps]
    if seed:
        parts.append(f"--seed {seed}")
    return " ".join(parts)
