"""Walk on spheres as an integral over directions: x[..., j] in [0, 1) turns step j (Section 6.4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from nqr_geom import check
from nqr_geom.integrator.problem import Feature, Observation, Schema, WalkProblem, Whole
from nqr_geom.rows import over_rows
from nqr_geom.streams import Stream
from nqr_geom.wos.boundary import solve
from nqr_geom.wos.domain import Boundary, Domain
from nqr_geom.wos.families import polygons, queries
from nqr_geom.wos.nearest import BINS, Nearest, join, nearest_rows
from nqr_geom.wos.record import ALIVE, SEEN, VALUE, record

__all__ = ["STEPS", "LaplaceProblem", "PLaplaceProblem", "WalkState"]

STEPS = 12  # the paper's


@dataclass(frozen=True)
class WalkState:
    """Walks under way.

    Parameters
    ----------
    position : Tensor, (B, N, 2)
        In the frames of the domains.
    edge, t, distance : Tensor, (B, N)
        Where the boundary is closest, and how far.
    alive : Tensor, (B, N), bool
        Not in the epsilon shell yet.
    steps : Tensor, (B, N), int64
        Jumps made.
    history : tuple of Tensor
        What was observed before every step so far, (B, N, 10) each.
    """

    position: Tensor
    edge: Tensor
    t: Tensor
    distance: Tensor
    alive: Tensor
    steps: Tensor
    history: tuple[Tensor, ...] = ()


@dataclass(frozen=True, eq=False)
class LaplaceProblem(WalkProblem):
    """Harmonic functions at B points, each on one of S domains, as means over walks of at most `dim` steps.

    A walk that is not in the epsilon shell after its last step takes the boundary value closest to it, so the estimate
    has a bias; the reference is the solution of the equation, and that bias counts as error.

    Parameters
    ----------
    boundaries : sequence of Boundary
        S domains with their values.
    geometry : Nearest
        Their edges, one behind the other.
    points : Tensor, (B, 2), float64
        Queries in the frames of their domains.
    shape : Tensor, (B,), int64
        Which domain each query belongs to.
    rows : Tensor, (B,), int64
        Global index of each integral.
    dim : int
        Steps a walk may take.
    epsilon : float
        Width of the shell as a part of the local size.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> problem = LaplaceProblem.of(square, [0.0, 1.0, 1.0, 0.0], [[0.25, 0.5], [0.5, 0.5]])
    >>> problem.reference().round(9).tolist()
    [[0.25], [0.5]]
    """

    boundaries: tuple[Boundary, ...]
    geometry: Nearest
    points: Tensor
    shape: Tensor
    rows: Tensor
    dim: int = STEPS
    epsilon: float = 1e-3

    name = "laplace"

    @classmethod
    def of(
        cls, polygon: Any, boundary: Any, points: ArrayLike, *, max_steps: int = STEPS, epsilon: float = 1e-3
    ) -> LaplaceProblem:
        """One domain and its queries (m, 2), which must lie inside."""
        domain = Domain.of(polygon)
        framed = domain.to_frame(points)
        outside = ~domain.contains(framed)
        if outside.any():
            row = int(np.flatnonzero(outside)[0])
            where = np.asarray(points, dtype=np.float64)[row].tolist()
            raise ValueError(f"points: expected points inside the polygon, got {where} at row {row}")
        return cls.joined([domain.boundary(boundary)], [framed], max_steps, epsilon)

    @classmethod
    def joined(
        cls, boundaries: Sequence[Boundary], framed: Sequence[NDArray[np.float64]], max_steps: int, epsilon: float
    ) -> LaplaceProblem:
        """Several domains with queries inside, in their frames."""
        counts = torch.tensor([len(part) for part in framed])
        return cls(
            tuple(boundaries),
            join([boundary.domain.nearest for boundary in boundaries]),
            torch.from_numpy(np.concatenate(framed)),
            torch.arange(len(framed)).repeat_interleave(counts),
            torch.arange(int(counts.sum())),
            check.integer("max_steps", max_steps, low=1),
            check.number("epsilon", epsilon, low=0.0, open_low=True),
        )

    @classmethod
    def family(cls, n: int, seed: int = 0, split: str = "test", points: int = 256) -> LaplaceProblem:
        """n random star-shaped polygons of Fig. 41, each with uniform query points inside.

        Parameters
        ----------
        n : int
            Number of shapes.
        seed, split
            Which shapes, see `nqr_geom.wos.families.polygons`.
        points : int
            Queries a shape.
        """
        vertices, values = polygons(n, seed=seed, split=split)
        points = check.integer("points", points, low=1)
        domains = [Domain.of(v) for v in vertices]
        framed = [d.to_frame(queries(d, points, k, seed, split)) for k, d in enumerate(domains)]
        boundaries = [d.boundary(v) for d, v in zip(domains, values, strict=True)]
        return cls.joined(boundaries, framed, STEPS, 1e-3)

    @property
    def groups(self) -> NDArray[np.int64]:
        return self.shape.cpu().numpy()

    @property
    def outline(self) -> NDArray[np.int64]:
        """Which polygon of `geometry` each query walks in, (B,)."""
        return self.shape.numpy()

    @property
    def schema(self) -> Schema:  # type: ignore[override]
        """Section 6.4's sequence of every step, how and where the walk ended, and where loops of the boundary end.

        "end" is the closest boundary point of the last position relative to the query, its distance and its arc length.
        """
        loops = max(int(boundary.domain.loop[-1]) + 1 for boundary in self.boundaries)
        return Schema(
            (
                Feature("steps", "scalar", self.dim * sum(SEEN.values())),
                Feature("length", "scalar"),
                Feature("finished", "index", levels=2),
                Feature("end", "scalar", 4),
                Feature("loops", "scalar", loops),
            )
        )

    def _search(self, position: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Closest edge, parameter, distance and whether outside the shell, (B, N) each."""
        points = np.ascontiguousarray(position.numpy().reshape(-1, 2))
        of = np.repeat(self.outline, position.shape[1])
        m = len(points)
        edge, t, square = np.empty(m, np.int64), np.empty(m), np.empty(m)
        edges, size, grid, shape, first, items = self.geometry

        def rows(i: int, j: int) -> None:
            out = (edge[i:j], t[i:j], square[i:j])
            nearest_rows(edges, grid, shape, first, items, of[i:j], points[i:j], *out)

        over_rows(rows, m)
        distance = np.sqrt(square)
        shell = np.maximum(self.epsilon * size[edge, np.minimum((t * BINS).astype(np.int64), BINS - 1)], 1e-14)
        found = (edge, t, distance, distance > shell)
        return tuple(torch.from_numpy(a).reshape(position.shape[:2]) for a in found)  # type: ignore[return-value]

    def start(self, n: int) -> WalkState:
        """n walks at every query."""
        edge, t, distance, alive = self._search(self.points[:, None])
        position = self.points[:, None].expand(-1, n, -1)
        edge, t, distance, alive = (a.expand(-1, n) for a in (edge, t, distance, alive))
        return WalkState(position, edge, t, distance, alive, torch.zeros(position.shape[:2], dtype=torch.int64))

    def _closest(self, state: WalkState) -> tuple[Tensor, Tensor, Tensor]:
        """The closest boundary point (B, N, 2) of each walk's position, its arc length and its value, (B, N)."""
        edge, t = state.edge.numpy(), state.t.numpy()
        arc = self.arcs[edge, 0] + t * self.arcs[edge, 1]
        return self.corner(state), torch.from_numpy(arc), torch.from_numpy(self.values(edge, t))

    def corner(self, state: WalkState) -> Tensor:
        """The closest boundary point (B, N, 2) of each walk's position."""
        edges = self.geometry.edges[state.edge.numpy()]
        return torch.from_numpy(edges[..., :2] + state.t.numpy()[..., None] * edges[..., 2:4])

    @cached_property
    def arcs(self) -> NDArray[np.float64]:
        """Arc length at the start of every edge of `geometry`, and its length, (E, 2)."""
        return np.concatenate([np.column_stack([b.domain.arc, b.domain.lengths]) for b in self.boundaries])

    def values(self, edge: NDArray[np.int64], t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Boundary values at t of edges of `geometry`, (B, ...)."""
        value, shape, first = np.empty(edge.shape), self.shape.numpy(), self.geometry.shape[:, 3]
        ends = np.flatnonzero(np.diff(shape, append=-1)) + 1
        for low, high in zip(np.append(0, ends[:-1]), ends, strict=True):  # rows of one domain after the other
            k = shape[low]
            value[low:high] = self.boundaries[k].at(edge[low:high] - first[k], t[low:high])
        return value

    def loops(self) -> Tensor:
        """Arc length at the end of each loop of each query's domain, (B, L); a domain with fewer repeats its last."""
        ends = [np.flatnonzero(np.diff(b.domain.loop, append=-1)) for b in self.boundaries]
        arcs = [b.domain.arc[end] + b.domain.lengths[end] for b, end in zip(self.boundaries, ends, strict=True)]
        most = max(len(arc) for arc in arcs)
        padded = np.stack([np.pad(arc, (0, most - len(arc)), mode="edge") for arc in arcs])
        return torch.from_numpy(padded)[self.shape]

    def observe(self, state: WalkState) -> Mapping[str, Tensor]:
        """What each walk sees before its next step; zeros once it has ended.

        Lengths are in the domain's frame. "closest" and "from_start" are relative to the position and to the query.
        """
        corner, arc, value = self._closest(state)
        away = corner - state.position
        turn = torch.atan2(away[..., 1], away[..., 0])
        seen = {
            "closest": away,
            "distance": state.distance[..., None],
            "arc_length": arc[..., None],
            "boundary_value": value[..., None],
            "from_start": corner - self.points[:, None],
            "angle": torch.stack([turn.cos(), turn.sin()], dim=-1),
            "alive": torch.ones_like(state.distance)[..., None],
        }
        return {name: torch.where(state.alive[..., None], tensor, 0.0) for name, tensor in seen.items()}

    def evaluate(self, x: Tensor) -> Observation:
        """Walk all steps in one compiled pass: the same as step by step, to rounding."""
        walks = record(self.geometry, self.arcs, self.shape.numpy(), self.points.numpy(), x.cpu().numpy(), self.epsilon)
        value = self.values(walks.edge, walks.t)
        walks.steps[..., VALUE] = value[..., :-1] * walks.steps[..., ALIVE]
        batch, n = x.shape[:2]
        features = {
            "steps": torch.from_numpy(walks.steps).reshape(batch, n, 1, -1),
            "length": torch.from_numpy(walks.made).double()[:, :, None, None],
            "finished": torch.from_numpy(~walks.alive).long()[:, :, None, None],
            "end": torch.from_numpy(walks.end)[:, :, None],
            "loops": self.loops()[:, None, None].expand(-1, n, -1, -1),
        }
        last = torch.from_numpy(np.ascontiguousarray(value[..., -1]))
        return Observation(last[:, :, None, None], features, None, None, int(walks.made.sum()), _outcomes(walks.alive))

    def step(self, state: WalkState, x: Tensor) -> WalkState:
        """Jump onto the largest circle in direction 2 pi x, where the walk has not ended."""
        seen = torch.cat(list(self.observe(state).values()), dim=-1)
        return replace(self.jump(state, x), history=(*state.history, seen))

    def jump(self, state: WalkState, x: Tensor) -> WalkState:
        """A step that leaves nothing in the history."""
        turn = 2.0 * math.pi * x
        jump = state.distance[..., None] * torch.stack([turn.cos(), turn.sin()], dim=-1)
        position = torch.where(state.alive[..., None], state.position + jump, state.position)
        edge, t, distance, outside = self._search(position)
        steps = state.steps + state.alive
        return replace(
            state, position=position, edge=edge, t=t, distance=distance, alive=state.alive & outside, steps=steps
        )

    def rank(self, state: WalkState) -> Tensor:
        """Arc length of the closest boundary point; walks that have ended come last."""
        arc = torch.from_numpy(self.arcs[state.edge.numpy(), 0] + state.t.numpy() * self.arcs[state.edge.numpy(), 1])
        return torch.where(state.alive, arc, math.inf)

    def finish(self, state: WalkState) -> Observation:
        """Boundary value closest to each walk's last position, and the walk."""
        corner, arc, value = self._closest(state)
        end = torch.cat([corner - self.points[:, None], state.distance[..., None], arc[..., None]], dim=-1)
        loops = self.loops()[:, None, None].expand(-1, state.edge.shape[1], -1, -1)
        features = {
            "steps": torch.cat(state.history, dim=-1)[:, :, None],
            "length": state.steps.double()[:, :, None, None],
            "finished": (~state.alive).long()[:, :, None, None],
            "end": end[:, :, None],
            "loops": loops,
        }
        outcomes = _outcomes(state.alive.numpy())
        return Observation(value[:, :, None, None], features, None, None, int(state.steps.sum()), outcomes)

    def take(self, index: slice | Tensor) -> LaplaceProblem:
        return replace(self, points=self.points[index], shape=self.shape[index], rows=self.rows[index])

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        from nqr_geom.wos.fused import whole_of

        return whole_of(self, sampler, rule, n)

    def reference(self) -> NDArray[np.float64]:
        """The solution of the equation to about 1e-9 of the spread of the boundary values, (B, 1)."""
        result = np.empty((self.batch, 1))
        shape, points = self.shape.numpy(), self.points.numpy()
        for k in np.unique(shape):
            boundary = self.boundaries[k]
            result[shape == k, 0] = solve(boundary.domain, boundary).at(points[shape == k])
        return result

    def peers(self) -> dict[str, Callable[[], NDArray[np.float64]]]:
        """The deterministic solver."""
        return {"boundary": self.reference}


@dataclass(frozen=True, eq=False)
class PLaplaceProblem(LaplaceProblem):
    """p-harmonic functions at B points by the walks of a harmonic one: only rules that see p can answer.

    Parameters
    ----------
    p : Tensor, (B,), float64
        Exponent of each query; 3 where none is given.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> problem = ng.problems.p_laplace(square, [0.0, 1.0, 1.0, 0.0], [[0.25, 0.5]], p=4.0)
    >>> problem.evaluate(torch.rand(1, 3, 12, dtype=torch.float64)).features["p"].flatten().tolist()
    [4.0, 4.0, 4.0]
    """

    p: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.float64))

    name = "p-laplace"

    def __post_init__(self) -> None:
        if len(self.p) == 0:
            object.__setattr__(self, "p", torch.full((self.batch,), 3.0, dtype=torch.float64))

    @classmethod
    def like(cls, problem: LaplaceProblem, p: float) -> PLaplaceProblem:
        """The queries of another problem, all with one exponent, which must exceed 1."""
        p = check.number("p", p, low=1.0, open_low=True)
        same = {each.name: getattr(problem, each.name) for each in fields(LaplaceProblem)}
        return cls(**same, p=torch.full((problem.batch,), p, dtype=torch.float64))

    @property
    def schema(self) -> Schema:  # type: ignore[override]
        return Schema((*super().schema.features, Feature("p", "scalar")))

    def evaluate(self, x: Tensor) -> Observation:
        return self._with_p(super().evaluate(x))

    def finish(self, state: WalkState) -> Observation:
        return self._with_p(super().finish(state))

    def _with_p(self, seen: Observation) -> Observation:
        p = self.p[:, None, None, None].expand(-1, seen.value.shape[1], -1, -1)
        return replace(seen, features={**seen.features, "p": p})

    def take(self, index: slice | Tensor) -> PLaplaceProblem:
        return replace(self, points=self.points[index], shape=self.shape[index], rows=self.rows[index], p=self.p[index])

    def reference(self) -> None:  # type: ignore[override]
        """Not known to walks; finite elements tell it (`solve_p_laplace`)."""
        return None

    def peers(self) -> dict[str, Callable[[], NDArray[np.float64]]]:
        return {}


def _outcomes(alive: NDArray[np.bool_]) -> dict[str, int]:
    """Walks that reached the boundary and walks that the number of steps cut off."""
    capped = int(alive.sum())
    return {"walks_boundary": alive.size - capped, "walks_capped": capped}
