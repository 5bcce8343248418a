"""The toy family as an integrator problem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom import check
from nqr_geom.integrator.problem import Feature, Observation, Problem, Schema, Whole
from nqr_geom.integrator.rules import MonteCarlo, Trapezoid
from nqr_geom.integrator.samplers import Grid, Random, Stratified
from nqr_geom.streams import Stream
from nqr_geom.toy.family import PIECES, Pieces, draw
from nqr_geom.toy.split import ToySplit
from nqr_geom.toy.structured import ToyHermite

__all__ = ["ToyProblem"]

_DESIGNS: dict[type, int] = {Random: 0, Stratified: 1, Grid: 2, ToySplit: 3}  # as kernels know them


class ToyProblem(Problem):
    """Integrals over [0, 1] of piecewise smooth functions that show f, f' and the piece index at a point (Fig. 37).

    Where the breaks lie is not told; but pieces come in order, the first starts at 0 and the last ends at 1.

    Parameters
    ----------
    rows : int or Tensor, (B,), int64
        Global indices of the integrands, or how many of the first ones. The same index is the same integrand.
    seed : int
        Which family of integrands.
    split : {"test", "train", "validation"}
        Integrands of different splits have nothing in common.
    pieces : Pieces, optional
        Your own integrands instead of random ones, one for each row.

    Raises
    ------
    ValueError
        If `rows` is not a positive number or a one-dimensional tensor, or `pieces` has another number of rows.
    TypeError
        If `rows` does not hold integers.

    References
    ----------
    Fig. 37 and Appendix A.1 of the paper.

    Examples
    --------
    >>> problem = ToyProblem(3)
    >>> seen = problem.evaluate(torch.full((3, 1, 1), 0.5, dtype=torch.float64))
    >>> seen.value.shape, sorted(seen.features)
    (torch.Size([3, 1, 1, 1]), ['derivative', 'piece'])
    """

    name = "toy"
    dim = 1
    schema = Schema((Feature("derivative", "scalar"), Feature("piece", "index", levels=PIECES)))

    def __init__(self, rows: int | Tensor, seed: int = 0, split: str = "test", pieces: Pieces | None = None) -> None:
        if not isinstance(rows, Tensor):
            rows = torch.arange(check.integer("rows", rows, low=1))
        if rows.dtype != torch.int64:
            raise TypeError(f"rows: expected int64, got {rows.dtype}")
        if rows.ndim != 1:
            raise ValueError(f"rows: expected shape (B,), got {tuple(rows.shape)}")
        if pieces is not None and pieces.value.shape[0] != rows.shape[0]:
            raise ValueError(f"pieces: expected {rows.shape[0]} integrands, got {pieces.value.shape[0]}")
        self.rows = rows
        self.seed = seed
        self.split = split
        self.pieces = draw(rows, Stream(seed, split, "toy")) if pieces is None else pieces

    @classmethod
    def family(cls, n: int, seed: int = 0, split: str = "test") -> ToyProblem:
        """The first n integrands of a seed and split.

        Examples
        --------
        >>> ToyProblem.family(4).batch
        4
        """
        return cls(check.integer("n", n, low=1), seed, split)

    def evaluate(self, x: Tensor) -> Observation:
        """Value (B, N, 1, 1), derivative (float64) and piece (int64) at x (B, N, 1)."""
        value, derivative, piece = self.pieces.evaluate(x[..., 0])
        features = {"derivative": derivative[..., None, None], "piece": piece[..., None, None]}
        return Observation(value[..., None, None], features, queries=value.numel())

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        """Plain Monte Carlo, the trapezoidal and the structured rule on four kinds of samples, on a CPU."""
        split = sampler if type(sampler) is ToySplit else None
        rebuilt = rule if type(rule) is ToyHermite else None
        average = type(rule) is MonteCarlo and type(sampler) in (Random, Stratified)
        placed = type(sampler) in _DESIGNS and (rebuilt is not None or type(rule) is Trapezoid)
        if self.rows.device.type != "cpu" or not (average or placed):
            return None

        def whole(stream: Stream) -> Whole:
            from nqr_geom.toy import compiled

            of = self.pieces
            laws = torch.stack([of.value, of.slope, of.curvature, of.alpha], dim=2).numpy()
            given = of.edges.contiguous().numpy(), laws, self.rows.numpy(), stream.key, n, _DESIGNS[type(sampler)]
            nowhere, queries = torch.zeros(self.batch, dtype=torch.bool), self.batch * n
            if average:
                mean, m2, m3, m4 = torch.from_numpy(compiled.averaged(*given))[..., None]
                if type(sampler) is Stratified or n == 1:
                    return Whole(mean, nowhere, queries)
                return Whole(mean, nowhere, queries, m2, m3=m3, m4=m4)
            first, jump = (split.first, split.shape.jump) if split else (0, 0.0)
            known = (rebuilt.reach, rebuilt.shape) if rebuilt else None
            value = compiled.combined(*given, first, jump, known)
            return Whole(torch.from_numpy(value)[:, None], nowhere, queries)

        return whole

    def take(self, index: slice | Tensor) -> ToyProblem:
        return ToyProblem(self.rows[index], self.seed, self.split, self.pieces.take(index))

    def reference(self) -> NDArray[np.float64]:
        """Exact integrals in closed form, (B, 1)."""
        return self.pieces.integral()[:, None].cpu().numpy()
