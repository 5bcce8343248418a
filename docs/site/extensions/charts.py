"""Error against time from the figures that the benchmarks left, one chart an application."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Row = dict[str, Any]
Curves = dict[str, list[tuple[float, float]]]  # microseconds and mean squared errors of each method

SHOWN = (  # on the toy family; all of them would hide each other
    "random+mc",
    "stratified+mc",
    "stratified+trapezoid",
    "stratified+regression-3",
    "stratified+toy-hermite",
    "stratified+inet-toy-uniform",
    "stratified+inet-toy-structured",
    "toy-split+toy-hermite",
)


def rows_of(results: Path, name: str) -> tuple[list[Row], str]:
    """Rows of a benchmark, and the command that measured them."""
    told = json.loads((results / f"{name}.json").read_text())
    return told["rows"], f"python benchmarks/{name}.py, {told['machine']['cores']} cores"


@contextmanager
def chart(path: Path, height: float, title: str) -> Iterator[Any]:
    """Axes of a picture of that height that is saved at the end; its letters stay text."""
    with rc_context({"svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9}):
        figure = Figure(figsize=(8.2, height), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        axes.set_title(title, fontsize=10)
        yield axes
        figure.savefig(path)


def against_time(path: Path, curves: Curves, title: str, command: str) -> None:
    """Microseconds and mean squared error of each method, a point or a line; in grey the best that any reaches."""
    with chart(path, 4.4, title) as axes:
        best, front = float("inf"), []
        for x, y in sorted(point for points in curves.values() for point in points):
            if y < best:
                best = y
                front.append((x, y))
        axes.step(*zip(*front, strict=True), where="post", color="0.75", lw=1.2, zorder=1)
        for k, (label, points) in enumerate(sorted(curves.items(), key=lambda item: -item[1][-1][1])):
            look = {"color": f"C{k % 10}", "marker": "osD^vPX"[k % 7], "ms": 5, "lw": 1.3}
            axes.plot(*zip(*points, strict=True), label=label, **look)
        axes.set(xscale="log", yscale="log", xlabel="microseconds per integral", ylabel="mean squared error")
        axes.grid(True, which="major", alpha=0.3)
        axes.figure.legend(loc="outside right center", frameon=False, fontsize=8.5)
        axes.annotate(command, (1.0, -0.17), xycoords="axes fraction", ha="right", fontsize=7.5, color="0.4")


def bars(path: Path, rows: list[tuple[str, float, float]], title: str, command: str) -> None:
    """Milliseconds of what ran beside what running everything would take."""
    with chart(path, 0.9 + 0.55 * len(rows), title) as axes:
        at = range(len(rows))
        axes.barh([k - 0.2 for k in at], [row[1] for row in rows], 0.36, label="what the scene calls for")
        axes.barh([k + 0.2 for k in at], [row[2] for row in rows], 0.36, color="0.75", label="everything")
        axes.set_yticks(list(at), [row[0] for row in rows])
        axes.invert_yaxis()
        axes.set_xlabel(f"milliseconds ({command})")
        axes.legend(frameon=False, fontsize=8.5)


def collected(rows: Iterable[tuple[str, float | None, float]]) -> Curves:
    """Points of each method in the given order; those that were not timed are left out."""
    curves: Curves = {}
    for method, microseconds, mse in rows:
        if microseconds:
            curves.setdefault(method, []).append((microseconds, mse))
    return curves


def both(row: Row) -> str:
    return f"{row['design']}+{row['rule']}"


def write(results: Path, out: Path) -> None:
    """Every chart of the site."""
    rows, command = rows_of(results, "learned")
    found = collected((both(r), r.get("microseconds"), r["mse"]) for r in rows if r["problem"] == "gwn")
    against_time(out / "gwn.svg", found, "winding numbers of held-out shapes, 32 samples", command)

    rows, command = rows_of(results, "sd_methods")
    found = collected((both(r), r.get("microseconds"), r["mse"]) for r in rows if r.get("problem") == "sd")
    against_time(out / "sd.svg", found, "smoothed distances of held-out shapes, 32 samples", command)

    rows, command = rows_of(results, "toy_convergence")
    held = [r for r in rows if r["problem"] == "held out" and both(r) in SHOWN]
    found = collected((both(r), r.get("microseconds"), r["mse"]) for r in held)
    against_time(out / "toy.svg", found, "the toy family, 1 to 64 samples", command)

    rows, command = rows_of(results, "wos_methods")
    family = [r for r in rows if r["problem"] == "family of Fig. 41"]
    found = collected((r["method"], r.get("us_per_query"), r["mse"]) for r in family)
    against_time(out / "laplace.svg", found, "harmonic functions on random polygons, 32 walks of 12 steps", command)

    rows, command = rows_of(results, "transmittance")
    found = collected((r["method"], r.get("us_a_ray"), r["mse"]) for r in rows if r["set"] == "clouds")
    against_time(out / "transmittance.svg", found, "transmittance of random clouds, 24 queries", command)

    rows, command = rows_of(results, "effects")
    times = [(r["case"], r["ms"], r["ms_with_everything"]) for r in rows]
    bars(out / "direct.svg", times, "direct light, 128 x 128 pixels, 16 passes", command)
