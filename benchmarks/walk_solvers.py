"""Error against time of all solvers of Laplace's equation: polygons of the family, and three domains unlike them.

    cd benchmarks && python walk_solvers.py [--quick]

Processor time a query on one thread. Walks of at most 12 steps under every rule; "boundary" and "fem" work once for a
domain and then answer, so their time is shared by its queries (96 in each polygon, 192 in a letter, a comb and a
coastline with oscillating values). The truth is the boundary solver's at a tolerance of 1e-7. Draws
docs/walk-solvers.png.
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

import numpy as np
import torch
from comparison import SEED
from equal_time import STUDIES, Study, points
from figures import DOCS, SEVERAL, figure, save
from learned_walks import Solved, foreign
from shapes import write

import nqr_geom as ng
from nqr_geom.wos.boundary import solve
from nqr_geom.wos.problems import LaplaceProblem

Row = dict[str, Any]

TRUTH = 1e-7
SOLVERS = {"boundary": (1e-2, 1e-4), "fem": (1e-1, 1e-2, 1e-3)}
SIZES = (4, 8, 16, 32, 64, 128)


def answered(problem: LaplaceProblem, solver: str, tol: float) -> np.ndarray:
    """What a solver without walks gives at all queries, (B,)."""
    found = np.empty(problem.batch)
    for k, boundary in enumerate(problem.boundaries):
        on = problem.groups == k
        inside = problem.points[on].numpy()
        if solver == "boundary":
            found[on] = solve(boundary.domain, boundary, tol).at(inside)
        else:
            polygon, values = boundary.domain.from_frame(boundary.domain.start), boundary.function
            given = boundary.linear[:, 0] if values is None and boundary.linear is not None else values
            found[on] = ng.solve_laplace(polygon, given, boundary.domain.from_frame(inside), method="fem", tol=tol)
    return found


def rows_of(name: str, problem: LaplaceProblem) -> list[Row]:
    """All solvers on one problem."""
    truth = torch.from_numpy(answered(problem, "boundary", TRUTH))[:, None]
    study = STUDIES["laplace"]
    whole = Solved(**{key: getattr(problem, key) for key in LaplaceProblem.__dataclass_fields__}, answers=truth)
    mine = Study(lambda less: (whole, truth.numpy()), study.classical, study.others, plain=study.plain)
    rows = [{"domain": name, **row} for row in points("laplace", mine, (*study.classical, *study.others), SIZES, 1)]
    for solver, tolerances in SOLVERS.items():
        for tol in tolerances:
            start = time.process_time()
            found = answered(problem, solver, tol)
            spent = 1e6 * (time.process_time() - start) / problem.batch
            mse = float(np.mean((found - truth[:, 0].numpy()) ** 2))
            rows.append({"domain": name, "method": solver, "n": 0, "tol": tol, "mse": mse, "us": spent})
            print(name, rows[-1], flush=True)
    return rows


def draw(rows: list[Row]) -> None:
    """A panel a domain; dashed lines are means of walks, squares are solvers without any."""
    names = list(dict.fromkeys(row["domain"] for row in rows))
    whole = figure(9.6, 4.2 * -(-len(names) // 2))
    for k, name in enumerate(names):
        panel = whole.add_subplot(-(-len(names) // 2), 2, k + 1)
        greys, colours = iter(("0.0", "0.4", "0.65")), iter((*SEVERAL, "tab:brown", "tab:olive"))
        for method in dict.fromkeys(row["method"] for row in rows):
            of = [row for row in rows if (row["domain"], row["method"]) == (name, method)]
            plain = method in STUDIES["laplace"].classical
            colour = next(greys) if plain else next(colours)
            style, marker = ("--" if plain else "-"), ("s" if method in SOLVERS else ".")
            at, error = ([row[key] for row in of] for key in ("us", "mse"))
            panel.plot(
                at, error, style, color=colour, marker=marker, lw=1.2, ms=4 if marker == "s" else 6, label=method
            )
        panel.set(xscale="log", yscale="log", title=name)
        panel.set(xlabel="processor microseconds a query", ylabel="mean squared error")
        panel.grid(alpha=0.3)
        panel.legend(fontsize=6, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    save(whole, DOCS / "walk-solvers.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer polygons and queries; writes nothing")
    quick = parser.parse_args().quick
    os.environ["NUMBA_NUM_THREADS"] = "1"
    torch.set_num_threads(1)
    rows = rows_of("polygons of Fig. 41", LaplaceProblem.family(2 if quick else 10, SEED, points=16 if quick else 96))
    for name, problem in foreign(32 if quick else 192):
        rows += rows_of(name, problem)
    if not quick:
        print(write("walk_solvers", rows, seed=SEED, truth=TRUTH))
        draw(rows)


if __name__ == "__main__":
    main()
