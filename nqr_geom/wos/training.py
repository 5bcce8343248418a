"""Harmonic functions on random polygons with their answers, in batches: what networks over walks learn from.

A network that reads no boundary values is linear in them, so every integral is learned from with all boundary values
there are: its channels are the hat functions of the vertices, and the answers are the vertices' harmonic measures, both
times `SCALE`: the mean over channels of squared errors is then the mean squared error over the family's random values.

The answers cost some fifty milliseconds a polygon, so a fixed number of polygons with many queries each is solved
once, kept on disk, and asked again and again with fresh walks. Polygons of the three splits have nothing in common.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.problem import Observation
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import VERTICES, PolygonFamily, polygons, queries
from nqr_geom.wos.kept import kept
from nqr_geom.wos.measures import vertex_measures
from nqr_geom.wos.nearest import join
from nqr_geom.wos.problems import STEPS, LaplaceProblem
from nqr_geom.wos.record import Record, record

__all__ = ["SCALE", "HatProblem", "laplace_batch", "pool"]

Floats = NDArray[np.float64]

SHAPES = {"train": 4096, "validation": 256, "test": 64}
QUERIES = 64  # a polygon
BLOCK = 64  # polygons in a file
_EPSILON = 1e-3

SCALE = PolygonFamily().size * math.sqrt(VERTICES)


@njit(cache=True, nogil=True)
def _hats(edge, t, scale, value, known):  # type: ignore[no-untyped-def]
    """Hat functions of the vertices times `scale` where walks ended, (B, N, V), and at all steps, (B, N, V, D)."""
    count, dim = value.shape[2], known.shape[3]
    for i in range(value.shape[0]):
        for w in range(value.shape[1]):
            for j in range(dim + 1):
                a, s = edge[i, w, j], t[i, w, j]
                b = (a + 1) % count
                if j < dim:
                    known[i, w, a, j], known[i, w, b, j] = scale * (1.0 - s), scale * s
                else:
                    value[i, w, a], value[i, w, b] = scale * (1.0 - s), scale * s


@dataclass(frozen=True, eq=False)
class ManyPolygons(LaplaceProblem):
    """Walks in many polygons of the family, with tables of all their edges: a batch asks a few queries of each.

    Parameters
    ----------
    arcs : (E, 2) float64
        Arc length at the start of every edge, and its length.
    """

    arcs: Floats = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def outline(self) -> NDArray[np.int64]:
        return self.shape.numpy() % len(self.geometry.shape)

    def walked(self, x: Tensor) -> tuple[Record, NDArray[np.int64], dict[str, Tensor]]:
        """Walks in directions x, the edges they met counted within their polygon, and features without values."""
        shape = self.outline
        walks = record(self.geometry, self.arcs, shape, self.points.numpy(), x.numpy(), self.epsilon)
        around = self.arcs.reshape(-1, VERTICES, 2)[shape, -1].sum(axis=1)
        features = {
            "steps": torch.from_numpy(walks.steps).flatten(2)[:, :, None],
            "length": torch.from_numpy(walks.made).double()[:, :, None, None],
            "finished": torch.from_numpy(~walks.alive).long()[:, :, None, None],
            "end": torch.from_numpy(walks.end)[:, :, None],
            "loops": torch.from_numpy(around)[:, None, None, None].expand(-1, x.shape[1], -1, -1),
        }
        return walks, walks.edge - self.geometry.shape[shape, 3][:, None, None], features


@dataclass(frozen=True, eq=False)
class HatProblem(ManyPolygons):
    """Harmonic measures of the vertices at queries, as channels: walks with all linear boundary values at once."""

    channels = VERTICES

    def evaluate(self, x: Tensor) -> Observation:
        """Walk, and see every vertex' hat function; "known" holds them at the closest points of all steps."""
        walks, edge, features = self.walked(x)
        batch, n, dim = x.shape
        value, known = np.zeros((batch, n, VERTICES)), np.zeros((batch, n, VERTICES, dim))
        _hats(edge, walks.t, SCALE, value, known)
        features["known"] = torch.from_numpy(known).flatten(2)[:, :, None]
        return Observation(torch.from_numpy(value)[:, :, None], features, queries=int(walks.made.sum()))


@dataclass(frozen=True, eq=False)
class Pool:
    """Polygons with their queries and answers.

    Attributes
    ----------
    problem : HatProblem
        All queries, polygon after polygon.
    measures : Tensor, (S Q, V), float32
        Their harmonic measures.
    """

    problem: HatProblem
    measures: Tensor


@lru_cache(maxsize=4)
def pool(split: str, seed: int) -> Pool:
    """The solved polygons of a split; those that are not on disk are solved first."""
    count = SHAPES[split]
    vertices, values = polygons(count, seed, split)
    boundaries = tuple(Domain.of(v).boundary(b) for v, b in zip(vertices, values, strict=True))
    domains = [boundary.domain for boundary in boundaries]

    def solve(first: int) -> dict[str, NDArray[Any]]:
        inside = [queries(domains[k], QUERIES, k, seed, split) for k in range(first, first + BLOCK)]
        measures = [vertex_measures(vertices[first + i], points)[0] for i, points in enumerate(inside)]
        framed = [domains[first + i].to_frame(points) for i, points in enumerate(inside)]
        return {"points": np.array(framed), "measures": np.array(measures, dtype=np.float32)}

    parts = [kept("measures", vertices[k : k + BLOCK], partial(solve, k)) for k in range(0, count, BLOCK)]
    points, measures = (torch.from_numpy(np.concatenate([part[name] for part in parts])).flatten(0, 1)
                        for name in ("points", "measures"))  # fmt: skip
    problem = HatProblem(
        boundaries,
        join([domain.nearest for domain in domains]),
        points,
        torch.arange(count).repeat_interleave(QUERIES),
        torch.arange(count * QUERIES),
        STEPS,
        _EPSILON,
        np.concatenate([np.column_stack([domain.arc, domain.lengths]) for domain in domains]),
    )
    return Pool(problem, measures)


def laplace_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Harmonic measures at a query of a polygon of the pool for each of `rows` (B,)."""
    found = pool(split, seed)
    pick = (Stream(seed, split, "picks").uniform(rows) * len(found.measures)).long()
    return Batch(replace(found.problem.take(pick), rows=rows), SCALE * found.measures[pick].double())
