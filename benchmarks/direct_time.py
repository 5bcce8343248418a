"""What direct light costs in time: the layout of Tables 15 to 17 and Fig. 36, milliseconds an image.

    python benchmarks/direct_time.py [--quick]

Two scenes, one inside and one outside the training family; 4, 8 and 16 passes at 32, 64 and 128 squared pixels, with
the scene and what the camera sees at hand. Monte Carlo is the fastest there is: a compiled pass over random points and
the balance heuristic. Medians of repetitions that take turns, as wall time and as time over Monte Carlo's, on as many
threads as the process has.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from direct_ways import UNHIDDEN, ways
from figures import DOCS, SEVERAL, figure, save
from learned_time import interleaved
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.scene_families import scenes
from nqr_geom.render.scene_gallery import gallery

SIZES, PASSES = (32, 64, 128), (4, 8, 16)
METHODS = ("random", "mis", UNHIDDEN, "structured", "inet", "nqr")
# Milliseconds of Tables 15 to 17 at 128 squared, test scene 1, over Monte Carlo's: INet, SNet + INet.
PAPER = {("inet", 4): 6.1, ("inet", 8): 7.5, ("inet", 16): 7.8, ("nqr", 4): 8.0, ("nqr", 8): 11.5, ("nqr", 16): 13.8}
_MARKS = (5, 10, 20, 50, 100, 200, 500)  # milliseconds
GOALS = {"structured": 2.0, "inet": 8.0, "nqr": 20.0}


def problems(size: int) -> dict[str, DirectProblem]:
    """A held-out scene of the family, and the teaser."""
    inside = scenes(1, seed=17, split="test", resolution=size)[0]
    return {"test scene": DirectProblem.of(inside), "teaser": DirectProblem.of(gallery("teaser", size, size))}


def measured(sizes: tuple[int, ...], passes: tuple[int, ...], repeats: int) -> list[dict[str, Any]]:
    """One row a scene, size, number of passes and way."""
    made = {name: (registry.make("sampler", s), registry.make("rule", r)) for name, (s, r) in ways(METHODS).items()}
    rows: list[dict[str, Any]] = []
    for size in sizes:
        for scene, problem in problems(size).items():
            for n in passes:
                jobs: dict[str, Callable[[], Any]] = {
                    name: (lambda pair=pair, n=n, problem=problem: run(problem, *pair, n))
                    for name, pair in made.items()
                }
                for pair in made.values():  # compilation, weights and tables of points are not of an image
                    run(problem.take(slice(0, 1)), *pair, n)
                spent = interleaved(jobs, repeats)
                plain = spent["random"]
                rows += [
                    {
                        "scene": scene,
                        "method": name,
                        "resolution": size,
                        "n": n,
                        "milliseconds": 1e3 * wall,
                        "ns_per_pass": 1e9 * wall / problem.batch / n,
                        "us_per_pixel": 1e6 * wall / problem.batch,
                        "times_mc": wall / plain[0],
                        "processor_times_mc": processor / plain[1],
                        "paper": PAPER.get((name, n)),
                        "goal": GOALS.get(name),
                    }
                    for name, (wall, processor) in spent.items()
                ]
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Fig. 36: time against passes at the largest image, and against pixels at the most passes."""
    made = figure(9.5, 3.8)
    left, right = made.subplots(1, 2)
    size, n = max(row["resolution"] for row in rows), max(row["n"] for row in rows)
    for name, colour in zip(dict.fromkeys(row["method"] for row in rows), ("0.15", *SEVERAL), strict=False):
        for axis, key, fixed, at in ((left, "n", "resolution", size), (right, "resolution", "n", n)):
            of = [r for r in rows if r["method"] == name and r[fixed] == at and r["scene"] == "teaser"]
            axis.plot([r[key] for r in of], [r["milliseconds"] for r in of], marker="o", ms=4, color=colour, label=name)
    left.set(xlabel="passes", ylabel="milliseconds an image", title=f"{size} x {size}", yscale="log", xscale="log")
    right.set(xlabel="pixels a side", title=f"{n} passes", yscale="log", xscale="log")
    for axis, ticks in ((left, PASSES), (right, SIZES)):
        axis.set_xticks(ticks, [str(tick) for tick in ticks])
        axis.set_yticks(_MARKS, [str(tick) for tick in _MARKS])
        axis.minorticks_off()
        axis.grid(color="0.92")
    left.legend(fontsize=8, loc="lower center", ncol=3)
    save(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small image; writes nothing")
    quick = parser.parse_args().quick
    rows = measured((16,), (4, 16), 1) if quick else measured(SIZES, PASSES, 3)
    table = Table("scene", "method", "image", "passes", "ms", "ns / pass", "times MC", "processor", "paper", "goal")
    for row in rows:
        numbers = (f"{row[k]:.3g}" for k in ("milliseconds", "ns_per_pass", "times_mc", "processor_times_mc"))
        told = (str(row["n"]), *numbers, str(row["paper"] or ""), str(row["goal"] or ""))
        table.add_row(row["scene"], row["method"], f"{row['resolution']}^2", *told)
    Console(width=120).print(table)
    if not quick:
        draw(rows, DOCS / "direct-time.png")
        print(write("direct_time", rows, repeats=3, threads=torch.get_num_threads()))


if __name__ == "__main__":
    main()
