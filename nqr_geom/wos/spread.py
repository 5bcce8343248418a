"""Walks that go where no walk has ended yet.

Before each step the directions from the walk's position are weighed by the ends of the earlier walks of the same query:
how many lie in a direction's sector, and how far from where the step would land the nearest one is. So the walks do not
see the near parts of the boundary again and again. Rules that do not ask how walks are distributed (`walk-fit`,
networks) profit from it, since their error comes from boundary that no walk came near. One walk in four is uniform: the
mean of those is what a rule in doubt can fall back to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numba import njit

from nqr_geom import check
from nqr_geom.curves._rows import over_rows
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import BELOW_ONE, LatinHypercube, Sampler
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.streams import Stream
from nqr_geom.wos.nearest import BINS
from nqr_geom.wos.nearest import nearest as closest
from nqr_geom.wos.problems import LaplaceProblem

__all__ = ["AVOID", "UNIFORM", "WalkSpread", "directions"]

_TURN = 2.0 * math.pi
_SMALL, _LARGE = 1e-2, 1e2  # a landing place's distance from an end counts between these, in radii
AVOID = 4  # power of 1 + the number of ends, or of starts, in a direction
UNIFORM = 4  # the first of so many walks is uniform


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def directions(px, py, radius, towards, ends, count, seen, near):  # type: ignore[no-untyped-def]
    """What the first `count` ends (n, 2) say of equal sectors of directions from (px, py), the first at `towards`.

    Writes how many ends lie in each sector, an end between two middles shared by both, and how far the nearest end is
    from where a step along the middle lands, in radii (the same everywhere where there is no end).
    """
    bins = len(seen)
    seen[:] = 0.0
    for k in range(count):
        at = (math.atan2(ends[k, 1] - py, ends[k, 0] - px) - towards) * (bins / _TURN) - 0.5
        below = math.floor(at)
        part = at - below
        seen[int(below) % bins] += 1.0 - part
        seen[int(below + 1.0) % bins] += part
    for b in range(bins):
        angle = _TURN * ((b + 0.5) / bins) + towards
        x, y = px + radius * math.cos(angle), py + radius * math.sin(angle)
        least = np.inf
        for k in range(count):
            dx, dy = ends[k, 0] - x, ends[k, 1] - y
            least = min(least, dx * dx + dy * dy)
        near[b] = min(max(math.sqrt(least) / radius, _SMALL), _LARGE)


@njit(cache=True, nogil=True, error_model="numpy")
def _walks(  # type: ignore[no-untyped-def]
    edges, size, grid, shape, first, items, of, start, rows, epsilon, key, floor, bins, low, high, x, density
):
    """Directions x (B, N, D) of rows low .. high, and the density (B, N) of every walk given those before it."""
    n, most = x.shape[1], x.shape[2]
    ends = np.empty((n, 2))
    seen, near, worth, started = np.empty(bins), np.empty(bins), np.empty(bins), np.empty(bins)
    for i in range(low, high):
        started[:] = 0.0
        for w in range(n):
            own = mixed(mixed(key, rows[i]), w)
            px, py = start[i, 0], start[i, 1]
            cx, cy = px, py
            density[i, w] = 1.0
            for j in range(most):  # what the walk does not need is uniform
                x[i, w, j] = unit(mixed(own, j))
            for j in range(most + 1):
                e, where, square = closest(edges, grid, shape, first, items, of[i], px, py)
                if e < 0:  # off the grid by rounding, so on the boundary
                    cx, cy = px, py
                    break
                cx, cy = edges[e, 0] + where * edges[e, 2], edges[e, 1] + where * edges[e, 3]
                radius = math.sqrt(square)
                shell = max(epsilon * size[e, min(int(where * BINS), BINS - 1)], 1e-14)
                if j == most or not radius > shell:
                    break
                towards = math.atan2(cy - py, cx - px)
                if w % UNIFORM == 0:
                    b = int((x[i, w, j] - towards / _TURN) % 1.0 * bins) % bins
                    started[b] += j == 0
                    angle = _TURN * x[i, w, j]
                    px, py = px + radius * math.cos(angle), py + radius * math.sin(angle)
                    continue
                directions(px, py, radius, towards, ends, w, seen, near)
                total = 0.0
                for b in range(bins):
                    worth[b] = near[b] / (1.0 + seen[b]) ** AVOID
                    if j == 0:
                        worth[b] /= (1.0 + started[b]) ** AVOID
                    total += worth[b]
                # One number decides whether the direction is uniform and, if it is not, for a sector.
                u, place = x[i, w, j], unit(mixed(own, most + j))
                if u < floor:
                    b = min(int(place * bins), bins - 1)
                    place = place * bins - b
                else:
                    level, b = total * (u - floor) / (1.0 - floor), 0
                    while b < bins - 1 and level >= worth[b]:
                        level -= worth[b]
                        b += 1
                if j == 0:
                    started[b] += 1.0
                density[i, w] *= floor + (1.0 - floor) * bins * worth[b] / total
                turn = towards / _TURN + (b + place) / bins
                x[i, w, j] = min(turn - math.floor(turn), BELOW_ONE)
                angle = _TURN * x[i, w, j]
                px, py = px + radius * math.cos(angle), py + radius * math.sin(angle)
            ends[w, 0], ends[w, 1] = cx, cy


@dataclass(frozen=True)
class WalkSpread(Sampler):
    """Walks one after the other, three in four drawn towards boundary that those before them have not met.

    The density of a direction is proportional to the distance from its landing place to the nearest earlier end, over
    the fourth power of one plus the number of earlier ends in its sector; the first step also avoids the sectors in
    which earlier walks began. The samples carry the density, so that weights of 1/pdf stay unbiased (if useless: they
    are products over all steps).

    Parameters
    ----------
    bins : int
        Sectors of directions, the first beginning at the closest boundary point.
    floor : float
        Part of every direction's density that is uniform, in (0, 1).
    most : int
        Walks that look at each other; those beyond are a Latin hypercube, so that the cost stays linear in n.

    Examples
    --------
    >>> samples = WalkSpread().draw(LaplaceProblem.family(2, points=3), 32, Stream(0))
    >>> samples.x.shape, samples.independent
    (torch.Size([6, 32, 12]), False)
    """

    bins: int = 24
    floor: float = 0.05
    most: int = 64

    name = "walk-spread"

    def __post_init__(self) -> None:
        check.integer("bins", self.bins, low=2)
        check.number("floor", self.floor, low=0.0, high=1.0, open_low=True)
        check.integer("most", self.most, low=1)

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        if not isinstance(problem, LaplaceProblem):
            raise ValueError(f"sampler: {self.name!r} needs the problem 'laplace', got {problem.name!r}")
        few = min(n, self.most)
        x, density = np.empty((problem.batch, few, problem.dim)), np.empty((problem.batch, few))
        start, rows = (np.ascontiguousarray(t.numpy()) for t in (problem.points, problem.rows))
        walks = (*problem.geometry, problem.outline, start, rows, problem.epsilon)
        fixed = (*walks, unsigned(stream.key), self.floor, self.bins)
        over_rows(lambda i, j: _walks(*fixed, i, j, x, density), problem.batch)
        at = torch.from_numpy(x)
        samples = Samples(at, problem.evaluate(at), torch.from_numpy(density)[..., None], self.name)
        if n <= few:
            return samples
        rest = LatinHypercube().draw(problem, n - few, stream.child("rest"))
        pdf = torch.cat([torch.from_numpy(density)[..., None], torch.ones_like(rest.x[..., :1])], dim=1)
        seen = Observation.join([samples.seen, rest.seen])
        return replace(samples, x=torch.cat([at, rest.x], dim=1), seen=seen, pdf=pdf)
