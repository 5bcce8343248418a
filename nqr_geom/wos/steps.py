"""What a walk on spheres shows to a sampler that chooses its directions one by one."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from nqr_geom.integrator.learn.steps import Walks
from nqr_geom.integrator.problem import WalkProblem
from nqr_geom.wos.problems import LaplaceProblem, WalkState

__all__ = ["LaplaceWalks"]


class LaplaceWalks(Walks):
    """Steps of a walk in units of its first ball, directions from the nearest boundary point.

    Nothing depends on the place, the size or the direction of the domain, nor on its boundary values: where to look
    is a question of geometry, since the answer is linear in the values.

    Parameters
    ----------
    problem : LaplaceProblem
        Whose walks these are.

    Raises
    ------
    ValueError
        If it is another problem.
    """

    size: ClassVar[int] = 10

    def __init__(self, problem: WalkProblem) -> None:
        if not isinstance(problem, LaplaceProblem):
            raise ValueError(f"problem: expected 'laplace', got {problem.name!r}")
        super().__init__(problem)
        self.first: tuple[Tensor, Tensor] | None = None

    def look(self, state: WalkState, step: int) -> tuple[Tensor, Tensor, Tensor]:
        """Sizes, the place relative to the query and the nearest boundary point, each in the walk's own frame."""
        seen = {name: tensor[:, 0] for name, tensor in self.problem.observe(state).items()}
        cosine, sine = seen["angle"].unbind(dim=-1)
        if self.first is None or step == 0:
            self.first = seen["distance"].clamp_min(1e-300), torch.stack([cosine, sine], dim=-1)
        radius, towards = self.first
        place = (seen["from_start"] - seen["closest"]) / radius  # of the walk, from the query
        corner = seen["from_start"] / radius
        alive = seen["alive"][:, 0] > 0.0

        def turned(v: Tensor, c: Tensor, s: Tensor) -> list[Tensor]:
            """Components along and across the direction (c, s), tamed."""
            size = torch.linalg.vector_norm(v, dim=-1)
            tame = torch.log1p(size) / size.clamp_min(1e-9)
            x, y = v.unbind(dim=-1)
            return [tame * (c * x + s * y), tame * (c * y - s * x)]

        parts = [
            torch.log((seen["distance"] / radius).clamp(1e-6, 1e6))[:, 0] / 3.0,
            *turned(place, cosine, sine),
            *turned(corner, cosine, sine),
            *turned(corner, towards[:, 0], towards[:, 1]),
            torch.log1p(torch.linalg.vector_norm(place, dim=-1)),
            torch.full_like(cosine, step / self.problem.dim),
            alive.double(),
        ]
        features = torch.where(alive[:, None], torch.stack(parts, dim=-1), 0.0).float()
        turn = torch.atan2(sine, cosine) / (2.0 * math.pi)
        return features, turn, alive
