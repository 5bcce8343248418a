"""What a walk on spheres shows to a sampler that chooses its directions one by one."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
import torch
from numba import njit
from torch import Tensor

from nqr_geom.integrator.learn.steps import Look, Walks
from nqr_geom.integrator.problem import Observation, WalkProblem
from nqr_geom.rows import over_rows
from nqr_geom.wos.explore import AVOID, UNIFORM, directions, table_of
from nqr_geom.wos.problems import LaplaceProblem, WalkState

__all__ = ["LaplaceWalks"]

_TURN = 2.0 * math.pi


@njit(cache=True, nogil=True, error_model="numpy")
def _ahead(place, radius, towards, open_, ends, count, table, low, high, result):  # type: ignore[no-untyped-def]
    """Logarithms of what `directions` tells, for rows low .. high."""
    bins = result.shape[1]
    seen, near = np.empty(bins), np.empty(bins)
    for i in range(low, high):
        if open_[i] and count > 0:
            px, py, ux, uy = place[i, 0], place[i, 1], towards[i, 0], towards[i, 1]
            directions(px, py, radius[i], ux, uy, ends[i], count, table, seen, near)
            for b in range(bins):
                result[i, b, 1], result[i, b, 2] = math.log1p(seen[b]), math.log(near[b])


class LaplaceWalks(Walks):
    """Steps of a walk in units of its first ball, directions from the nearest boundary point.

    Nothing depends on the place, the size or the direction of the domain, nor on its boundary values: where to look
    is a question of geometry, since the answer is linear in the values. Of each direction it is known how many walks
    began there (at the first step), how many ends lie there, and how far from the landing place the nearest end is; the
    walks of the untrained network are those of `FullWalkSpread`, and as there one in four is uniform.

    Parameters
    ----------
    problem : LaplaceProblem
        Whose walks these are.
    n, bins : int
        As for `Walks`.

    Raises
    ------
    ValueError
        If it is another problem.
    """

    size: ClassVar[int] = 11
    base: ClassVar[tuple[float, ...]] = (-AVOID, -AVOID, 1.0)

    def __init__(self, problem: WalkProblem, n: int, bins: int) -> None:
        if not isinstance(problem, LaplaceProblem):
            raise ValueError(f"problem: expected 'laplace', got {problem.name!r}")
        super().__init__(problem, n, bins)
        self.laplace = problem
        self.started = torch.zeros(problem.batch, bins)
        self.ends = np.zeros((problem.batch, 2, n))
        self.table = table_of(bins)
        self.count = 0

    def look(self, state: WalkState, step: int) -> Look:
        """Sizes, the place relative to the query and the nearest boundary point, each in the walk's own frame."""
        place = state.position[:, 0]
        open_ = state.alive[:, 0] & (self.count % UNIFORM > 0)
        corner = self.laplace.corner(state)[:, 0]
        towards = corner - place
        if step == 0:
            self.radius = state.distance.clamp_min(1e-300)  # (B, 1)
            self.towards = _unit(towards)
        direction, query = _unit(towards), self.laplace.points
        moved, met = (place - query) / self.radius, (corner - query) / self.radius
        parts = [
            torch.log((state.distance / self.radius).clamp(1e-6, 1e6)) / 3.0,
            _turned(moved, direction),
            _turned(met, direction),
            _turned(met, self.towards),
            _turned(direction, self.towards),
            torch.full_like(self.radius, step / self.problem.dim),
            open_[:, None].double(),
        ]
        seen = torch.where(open_[:, None], torch.cat(parts, dim=1), 0.0).float()
        turn = torch.atan2(towards[:, 1], towards[:, 0]) / _TURN
        return Look(seen, self._ahead(place - query, state.distance[:, 0], direction, open_, step), turn, open_)

    def _ahead(self, place: Tensor, radius: Tensor, towards: Tensor, open_: Tensor, step: int) -> Tensor:
        result = np.zeros((len(place), self.bins, len(self.base)), dtype=np.float32)
        where = (tensor.numpy() for tensor in (place, radius, towards, open_))
        given: tuple[Any, ...] = (*where, self.ends, self.count, self.table)
        rows: Any = _ahead
        over_rows(lambda low, high: rows(*given, low, high, result), len(place))
        ahead = torch.from_numpy(result)
        if step == 0:
            ahead[:, :, 0] = self.started.log1p()
        return ahead

    def step(self, state: WalkState, x: Tensor) -> WalkState:
        return self.laplace.jump(state, x)

    def note(self, bins: Tensor, seen: Observation) -> None:
        first = bins[:, :1]
        self.started.scatter_add_(1, first, torch.ones_like(first, dtype=self.started.dtype))
        self.ends[:, :, self.count] = seen.features["end"][:, 0, 0, :2].numpy()
        self.count += 1


def _unit(v: Tensor) -> Tensor:
    return v / torch.linalg.vector_norm(v, dim=-1, keepdim=True).clamp_min(1e-300)


def _turned(v: Tensor, direction: Tensor) -> Tensor:
    """Components of v (B, 2) along and across a direction, with long vectors shortened to their logarithm."""
    size = torch.linalg.vector_norm(v, dim=-1, keepdim=True)
    tame = torch.log1p(size) / size.clamp_min(1e-9)
    (x, y), (c, s) = v.unbind(dim=-1), direction.unbind(dim=-1)
    return tame * torch.stack([c * x + s * y, c * y - s * x], dim=-1)
