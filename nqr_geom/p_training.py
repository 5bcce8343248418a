"""p-harmonic functions on random polygons with their answers, in batches: what networks for p = 3 or any p learn from.

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
from nqr_geom.p_harmonic import LEARNED_P, LEARNED_RANGE
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Boundary
from nqr_geom.wos.families import polygons
from nqr_geom.wos.kept import kept
from nqr_geom.wos.record import ALIVE, VALUE
from nqr_geom.wos.tokens import WALK_TOKENS, boundary_values, reach, unknown
from nqr_geom.wos.training import BLOCK, QUERIES, ManyPolygons, pool

__all__ = ["P_RANGE", "P_RANGE_TOKENS", "P_TOKENS", "P", "p_laplace_batch", "p_range_batch"]

P, P_RANGE = LEARNED_P, LEARNED_RANGE

SHAPES = {"train": 256, "validation": 64, "test": 64}
_TRIANGLES = 120  # refined at the corners; for the squared error see benchmarks/p_walks.py
_FINER = 400  # for other exponents, of which some bend their solutions more
_EXPONENTS = 2  # of a polygon
_CENTRED = TokenConfig(centred=True)


@dataclass(frozen=True, eq=False)
class ValuedPolygons(ManyPolygons):
    """Walks in many polygons of the family with linear boundary values; polygon S + k is k with the negative ones.

    Parameters
    ----------
    ends : (2 E, 2) float64
        Values at both ends of every edge.
    p : Tensor, (B,), optional
        Exponent of each query, where a network is to see it.
    """

    ends: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    p: Tensor | None = None

    name = "p-laplace"

    def evaluate(self, x: Tensor) -> Observation:
        walks, _, features = self.walked(x)
        flipped = self.shape.numpy() >= len(self.geometry.shape)
        a, b = np.moveaxis(self.ends[walks.edge + (flipped * len(self.arcs))[:, None, None]], -1, 0)
        value = a * (1.0 - walks.t) + b * walks.t
        walks.steps[..., VALUE] = value[..., :-1] * walks.steps[..., ALIVE]
        if self.p is not None:
            features["p"] = self.p[:, None, None, None].expand(-1, x.shape[1], -1, -1)
        last = torch.from_numpy(np.ascontiguousarray(value[..., -1]))
        return Observation(last[:, :, None, None], features, queries=int(walks.made.sum()))

    def take(self, index: slice | Tensor) -> ValuedPolygons:
        p = None if self.p is None else self.p[index]
        return replace(self, points=self.points[index], shape=self.shape[index], rows=self.rows[index], p=p)


@lru_cache(maxsize=4)
def solved(split: str, seed: int, exponents: tuple[float, ...] | None = None) -> tuple[ValuedPolygons, Tensor]:
    """All queries of the polygons of a split, and their answers (S Q,) for p = 3 or for other exponents (S,)."""
    count, found = SHAPES[split], pool(split, seed).problem
    vertices, values = polygons(count, seed, split)
    points = found.points.unflatten(0, (-1, QUERIES)).numpy()

    def solve(first: int) -> dict[str, NDArray[Any]]:
        answers = []
        for k in range(first, first + BLOCK):
            inside = found.boundaries[k].domain.from_frame(points[k])
            p, triangles = (P, _TRIANGLES) if exponents is None else (exponents[k], _FINER)
            answers.append(p_laplace(Mesh.of(vertices[k], triangles, order=2), values[k], p, order=2)(inside))
        return {"answers": np.array(answers)}

    key = np.concatenate([vertices.reshape(count, -1), values], axis=1)
    if exponents is not None:
        key = np.column_stack([key, exponents])
    name = "p3" if exponents is None else "p-range"
    parts = [kept(name, key[k : k + BLOCK], partial(solve, k)) for k in range(0, count, BLOCK)]
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
    pick = (u[:, 0] * len(answers)).long()
    return _either_sign(replace(problem.take(pick), rows=rows), answers[pick], u[:, 1] < 0.5)


def _either_sign(problem: ValuedPolygons, answer: Tensor, negative: Tensor) -> Batch:
    """Some of the integrals with the negative boundary values."""
    shape = problem.shape + negative * len(problem.geometry.shape)
    return Batch(replace(problem, shape=shape), torch.where(negative, -answer, answer)[:, None])


@lru_cache(maxsize=4)
def _exponents(split: str, seed: int) -> NDArray[np.float64]:
    """Some exponents of every polygon, (E, S), log-uniform in `P_RANGE`."""
    low, high = P_RANGE
    u = Stream(seed, split, "exponents").uniform(np.arange(_EXPONENTS)[:, None], np.arange(SHAPES[split]))
    found: NDArray[np.float64] = low * (high / low) ** u
    return found


def p_range_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """p-harmonic functions with p in `P_RANGE` at a query of a polygon of the family for each of `rows` (B,)."""
    exponents = _exponents(split, seed)
    found = [solved(split, seed, tuple(of.tolist())) for of in exponents]
    problem, answers = found[0][0], torch.stack([answers for _, answers in found])
    u = Stream(seed, split, "p-range-picks").uniform(rows[:, None], torch.arange(3, device=rows.device))
    pick, which = (u[:, 0] * answers.shape[1]).long(), (u[:, 2] * len(exponents)).long()
    some = problem.take(pick)
    some = replace(some, rows=rows, p=torch.from_numpy(exponents)[which, some.shape])
    return _either_sign(some, answers[which, pick], u[:, 1] < 0.5)


def p_tokens(samples: Samples) -> Tensor:
    """Geometry of walks, then their boundary values, (B, N, 1, 172) float32."""
    value, unit = standard(samples.value, _CENTRED)  # (B, N, 1, 1), (B, 1, 1, 1)
    known = boundary_values(samples)[..., 0, :] - (samples.value - value)  # (B, N, 1, D)
    return torch.cat([WALK_TOKENS.compute(samples), *(compress(v, unit).float() for v in (value, known))], dim=-1)


def _not_for_three(samples: Samples) -> Tensor:
    """What no network over walks knows, and another exponent where one is told, (B,) bool."""
    told = samples.seen.features.get("p")
    return unknown(samples) if told is None else unknown(samples) | (told[:, 0, 0, 0] != P)


P_TOKENS = Extra(
    WALK_TOKENS.size + 13,
    p_tokens,
    WALK_TOKENS.checked,
    boundary_values,
    WALK_TOKENS.check,
    taught=("p",),
    foreign=_not_for_three,
)


def _exponent(samples: Samples) -> Tensor:
    """3 (p - 2)/p, -1 to 2 where it was trained, (B, N, 1, 1)."""
    p = samples.feature("p", "inet")
    return 3.0 * ((p - 2.0) / p).float()


def p_range_tokens(samples: Samples) -> Tensor:
    """`p_tokens`, then the exponent, (B, N, 1, 173) float32."""
    return torch.cat([p_tokens(samples), _exponent(samples)], dim=-1)


def _range_check(samples: Samples) -> Tensor:
    return torch.cat([reach(samples), _exponent(samples)], dim=-1)


P_RANGE_TOKENS = Extra(
    P_TOKENS.size + 1,
    p_range_tokens,
    (*P_TOKENS.checked, P_TOKENS.size),
    boundary_values,
    _range_check,
    foreign=unknown,
)
