"""Networks over walks: Table 14's rows on held-out polygons, and domains unlike those of the training (Fig. 33).

    python benchmarks/learned_walks.py [--quick]

32 walks of at most 12 steps, the same ones for every rule of a design. Polygons are of the split "test"; the truth is
the boundary solver's. Ratios are of means to plain Monte Carlo on random walks, with 95% bootstrap intervals over
polygons; on a single domain over eight runs. What is measured on networks that ship goes into their cards.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from comparison import SEED, N, Pair, rows_of, show, trained_sampler
from learned import write_cards
from numpy.typing import NDArray
from shapes import write

from nqr_geom.wos.boundary import solve
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import queries
from nqr_geom.wos.outlines import outlines
from nqr_geom.wos.problems import LaplaceProblem

Floats = NDArray[np.float64]

DESIGNS = ("random", "latin-hypercube")
RULES = ("mc", "walk-fit", "inet-laplace-uniform")
AVOIDING = ("uniform", "walk-fit", "inet-laplace-uniform", "inet-laplace-spread")  # weights of 1/pdf are useless there
PAPER = {("random", "inet-laplace-uniform"): 11.4, ("latin-hypercube", "inet-laplace-uniform"): 13.8,
         ("latin-hypercube", "mc"): 1.5}  # fmt: skip
TOLERANCE = 1e-3  # of the boundary solver; on polygons of the family errors come out near 1e-9


@dataclass(frozen=True, eq=False)
class Solved(LaplaceProblem):
    """Queries with answers that were computed once.

    Parameters
    ----------
    answers : Tensor, (B, 1)
        Solutions.
    """

    answers: torch.Tensor = field(default_factory=lambda: torch.zeros(0, 1))

    def reference(self) -> Floats:
        return self.answers.numpy()

    def take(self, index: slice | torch.Tensor) -> Solved:
        return replace(self, points=self.points[index], shape=self.shape[index], rows=self.rows[index],
                       answers=self.answers[index])  # fmt: skip


def solved(problem: LaplaceProblem) -> Solved:
    """The same problem with its answers."""
    answers = np.empty((problem.batch, 1))
    for k, boundary in enumerate(problem.boundaries):
        on = problem.groups == k
        answers[on, 0] = solve(boundary.domain, boundary, TOLERANCE).at(problem.points[on].numpy())
    return Solved(**vars(problem), answers=torch.from_numpy(answers))


def foreign(points: int) -> Iterator[tuple[str, LaplaceProblem]]:
    """The domains of Fig. 33, uniform queries in each."""
    for name, outline in outlines().items():
        domain = Domain.of(outline.vertices)
        inside = domain.to_frame(queries(domain, points, 0, SEED))
        yield name, LaplaceProblem.joined([domain.boundary(outline.values)], [inside], 12, 1e-3)


def pairs() -> list[Pair]:
    """All designs with all rules that suit them."""
    made = [(design, rule) for design in DESIGNS for rule in RULES] + [("walk-spread", rule) for rule in AVOIDING]
    joint = trained_sampler("laplace")
    return made if joint is None else [*made, *((joint[0], rule) for rule in ("uniform", "walk-fit", joint[1]))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer polygons and queries; writes nothing")
    quick = parser.parse_args().quick
    shapes, points, runs = (10, 32, 2) if quick else (100, 96, 8)
    rows: list[dict[str, Any]] = rows_of("laplace", solved(LaplaceProblem.family(shapes, SEED, points=points)), pairs())
    for row in rows:
        if (row["design"], row["rule"]) in PAPER:
            row["paper"] = PAPER[row["design"], row["rule"]]
    show("polygons of Fig. 41", rows)
    cards = list(rows)
    for name, problem in foreign(64 if quick else 192):
        part = rows_of(f"laplace, {name}", solved(problem), pairs(), runs)
        show(name, part)
        rows += part
    for row in rows:
        del row["microseconds"]  # walks_time.py tells times
    if not quick:
        write_cards(cards)
        write("learned_walks", rows, n=N, seed=SEED, shapes=shapes, points=points, runs_outside=runs)


if __name__ == "__main__":
    main()
