"""p-harmonic functions on random polygons with their answers, in batches: what a network for p = 3 learns from.

Walks, polygons and queries are those of `nqr_geom.wos.training`; the answers come from finite elements. The equation is
not linear, so each polygon is seen with its own boundary values or their negatives, and tokens hold the values: from
the mean of the ends in the row's unit, because a p-harmonic function stays one when a constant is added or it is
multiplied by a factor.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, compress, standard
from nqr_geom.integrator.problem import Observation, Samples
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Boundary
from nqr_geom.wos.families import polygons
from nqr_geom.wos.kept import kept
from nqr_geom.wos.record import ALIVE, VALUE
from nqr_geom.wos.tokens import WALK_TOKENS, boundary_values
from nqr_geom.wos.training import BLOCK, QUERIES, ManyPolygons, pool

__all__ = ["P_TOKENS", "P", "p_laplace_batch"]

P = 3.0

SHAPES = {"train": 256, "validation": 64, "test": 64}
_TRIANGLES = 120  # refined at the corners; the squared error is some 1e-8
_CENTRED = TokenConfig(centred=True)


@dataclass(frozen=True, eq=False)
class ValuedPolygons(ManyPolygons):
    """Walks in many polygons of the family with linear boundary values; polygon S + k is k with the negative ones.

    Parameters
    ----------
    ends : (2 E, 2) float64
        Values at both ends of every edge.
    """

    ends: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))

    name = "p-laplace"

    def evaluate(self, x: Tensor) -> Observation:
        walks, _, features = self.walked(x)
        flipped = self.shape.numpy() >= len(self.geometry.shape)
        a, b = np.moveaxis(self.ends[walks.edge + (flipped * len(self.arcs))[:, None, None]], -1, 0)
        value = a * (1.0 - walks.t) + b * walks.t
        walks.steps[..., VALUE] = value[..., :-1] * walks.steps[..., ALIVE]
        last = torch.from_numpy(np.ascontiguousarray(value[..., -1]))
        return Observation(last[:, :, None, None], features, queries=int(walks.made.sum()))


@lru_cache(maxsize=4)
def solved(split: str, seed: int) -> tuple[ValuedPolygons, Tensor]:
    """All queries of the polygons of a split, and their answers (S Q,)."""
    count, found = SHAPES[split], pool(split, seed).problem
    vertices, values = polygons(count, seed, split)
    points = found.points.unflatten(0, (-1, QUERIES)).numpy()

    def solve(first: int) -> dict[str, NDArray[Any]]:
        answers = []
        for k in range(first, first + BLOCK):
            inside = found.boundaries[k].domain.from_frame(points[k])
            answers.append(p_laplace(Mesh.of(vertices[k], _TRIANGLES, order=2), values[k], P, order=2)(inside))
        return {"answers": np.array(answers)}

    key = np.concatenate([vertices.reshape(count, -1), values], axis=1)
    parts = [kept("p3", key[k : k + BLOCK], partial(solve, k)) for k in range(0, count, BLOCK)]
    linear = [boundary.linear for boundary in found.boundaries if boundary.linear is not None]
    ends = np.concatenate(linear)
    negative = (Boundary(b.domain, linear=-v) for b, v in zip(found.boundaries, linear, strict=True))
    problem = ValuedPolygons(
        (*found.boundaries, *negative),
        found.geometry,
        found.points,
        found.shape,
        found.rows,
        found.dim,
        found.epsilon,
        found.arcs,
        np.concatenate([ends, -ends]),
    )
    return problem, torch.from_numpy(np.concatenate([part["answers"] for part in parts])).flatten()


def p_laplace_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """p-harmonic functions, p = 3, at a query of a polygon of the family for each of `rows` (B,)."""
    problem, answers = solved(split, seed)
    u = Stream(seed, split, "p-picks").uniform(rows[:, None], torch.arange(2, device=rows.device))
    pick, negative = (u[:, 0] * len(answers)).long(), u[:, 1] < 0.5
    shape = problem.shape[pick] + negative * len(problem.geometry.shape)
    batch = replace(problem, points=problem.points[pick], shape=shape, rows=rows)
    return Batch(batch, torch.where(negative, -answers[pick], answers[pick])[:, None])


def p_tokens(samples: Samples) -> Tensor:
    """Geometry of walks, then their boundary values, (B, N, 1, 172) float32."""
    value, unit = standard(samples.value, _CENTRED)  # (B, N, 1, 1), (B, 1, 1, 1)
    known = boundary_values(samples)[..., 0, :] - (samples.value - value)  # (B, N, 1, D)
    return torch.cat([WALK_TOKENS.compute(samples), *(compress(v, unit).float() for v in (value, known))], dim=-1)


P_TOKENS = Extra(
    WALK_TOKENS.size + 13,
    p_tokens,
    WALK_TOKENS.checked,
    boundary_values,
    WALK_TOKENS.check,
    foreign=WALK_TOKENS.foreign,
)
