"""Curves of many pieces as a sum of curves of few: winding numbers add up, and networks know few pieces (Fig. 25)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom import check
from nqr_geom.curves.problems import GwnProblem, Shapes
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler

__all__ = ["PieceRuns", "decompose", "run_decomposed"]

_GROUP_ROWS = 2**40  # rows of the g-th part are those of the whole plus g times this


@dataclass(frozen=True)
class PieceRuns:
    """Runs of consecutive pieces of other shapes, each a shape of its own.

    Parameters
    ----------
    whole : Shapes
        The shapes that are cut.
    owner : Tensor, (S,), int64
        Which of them each run belongs to.
    first, pieces : Tensor, (S,), int64
        First piece of each run and how many it has.
    """

    whole: Shapes
    owner: Tensor
    first: Tensor
    pieces: Tensor

    @property
    def queries_per_sample(self) -> int:
        """Point queries that a position with its tangent costs."""
        return self.whole.queries_per_sample

    def at(self, shape: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position, tangent and piece within the run, of runs `shape` (B,) at s (B, N)."""
        owner, first, count = (tensor[shape] for tensor in (self.owner, self.first, self.pieces))
        total = self.whole.pieces[owner]
        position, tangent, piece = self.whole.at(owner, (first[:, None] + s * count[:, None]) / total[:, None])
        local = torch.minimum((piece - first[:, None]).clamp_min(0), (count - 1)[:, None])
        return position, tangent * (count.double() / total)[:, None, None], local


def decompose(problem: GwnProblem, most: int = 6) -> tuple[GwnProblem, Tensor]:
    """Cut every integral into integrals over at most `most` pieces each.

    Parameters
    ----------
    problem : GwnProblem
        B winding numbers.
    most : int
        Pieces of a part, >= 1; a curve's parts are as equal as they can be.

    Returns
    -------
    parts : GwnProblem
        One integral for each part; a curve of few pieces is its own only part, with the same random numbers.
    whole : Tensor, (parts,), int64
        Which integral each part belongs to: the winding number is the sum over its parts.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> knots = ng.Curve.bezier(np.random.default_rng(0).uniform(-1, 1, (14, 3, 2)))
    >>> parts, whole = decompose(GwnProblem.of(knots, [[0.1, 0.2], [0.5, -0.3]]))
    >>> parts.shapes.pieces.tolist(), whole.tolist()
    ([5, 5, 4], [0, 0, 0, 1, 1, 1])
    """
    most = check.integer("most", most, low=1)
    owner, first, pieces, parts_of = [], [], [], []
    for k, count in enumerate(problem.shapes.pieces.tolist()):
        cuts = np.array_split(np.arange(count), -(-count // most))
        parts_of.append(range(len(owner), len(owner) + len(cuts)))
        owner += [k] * len(cuts)
        first += [int(cut[0]) for cut in cuts]
        pieces += [len(cut) for cut in cuts]
    runs = PieceRuns(problem.shapes, torch.tensor(owner), torch.tensor(first), torch.tensor(pieces))
    shape = [part for k in problem.shape.tolist() for part in parts_of[k]]
    whole = torch.tensor([b for b, k in enumerate(problem.shape.tolist()) for _ in parts_of[k]], dtype=torch.int64)
    group = torch.tensor([g for k in problem.shape.tolist() for g in range(len(parts_of[k]))], dtype=torch.int64)
    cut = replace(
        problem,
        shapes=runs,
        points=problem.points[whole],
        shape=torch.tensor(shape, dtype=torch.int64),
        rows=problem.rows[whole] + _GROUP_ROWS * group,
        curves=(),
    )
    return cut, whole


def run_decomposed(
    problem: GwnProblem, sampler: Sampler, rule: Rule, n: int, *, most: int = 6, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Winding numbers by n samples for every `most` pieces.

    Returns
    -------
    value : ndarray, (B, 1), float64
    fallback : ndarray, (B,), bool
        Integrals with a part where the rule gave way.
    """
    parts, whole = decompose(problem, most)
    estimate = run(parts, sampler, rule, n, seed=seed)
    value = np.zeros((problem.batch, 1))
    np.add.at(value, whole.numpy(), estimate.value)
    fallback = np.zeros(problem.batch, dtype=bool)
    np.logical_or.at(fallback, whole.numpy(), estimate.fallback)
    return value, fallback
