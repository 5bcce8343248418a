"""Walks and what is made of them, compiled: means of their ends, or the rule that rebuilds what they saw.

No walk is written down. Linear boundary values are read on the way; a user's function is asked between walking and
rebuilding, for some hundred queries at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from nqr_geom.integrator.problem import Whole
from nqr_geom.integrator.rules import MonteCarlo
from nqr_geom.integrator.samplers import LatinHypercube, Random, Sampler
from nqr_geom.integrator.sums import power_sums, row_mean
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows
from nqr_geom.streams import Stream
from nqr_geom.wos.average import average, room_for
from nqr_geom.wos.domain import evaluated
from nqr_geom.wos.explore import NUMBERS, explored, space_for, table_of
from nqr_geom.wos.nearest import BINS, nearest, nearest_of_all
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.spread import WalkSpread
from nqr_geom.wos.structured import WalkFit

__all__ = ["whole_of"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TURN = 2.0 * math.pi
_FEW = 64  # samples of which ranks are counted rather than sorted
_ASKED = 2**17  # boundary points at most, of several queries, that a user's function is asked for at once

_kernel = njit(cache=True, nogil=True, error_model="numpy")


@_kernel
def _latin(key, order, n, most, bits, x):  # type: ignore[no-untyped-def]
    """Points (n, D) of a Latin hypercube: bit for bit those of the sampler."""
    for j in range(most):
        for w in range(n):
            bits[w] = np.int64(mixed(mixed(order, w), j))
        if n <= _FEW:
            for w in range(n):
                rank = 0
                for v in range(n):
                    rank += bits[v] < bits[w]
                x[rank, j] = w
        else:
            x[:, j] = np.argsort(bits)
        for w in range(n):
            x[w, j] = (x[w, j] + unit(mixed(mixed(key, w), j))) / n


class Inputs(NamedTuple):
    """Walks from B queries, as kernels take them; arrays are those of `explored`.

    Attributes
    ----------
    of, rows : (B,) int64
        Polygon and global index of each query.
    start : (B, 2) float64
        The queries.
    n, most : int
        Walks from each, and steps that one may take.
    key, order : uint64
        Of the samples' numbers, and of their order in a Latin hypercube.
    latin, spread : bool
        Whether samples are a Latin hypercube, and whether walks are directed.
    """

    edges: Floats
    size: Floats
    grid: Floats
    shape: Ints
    first: Ints
    items: NDArray[np.int32]
    arc: Floats
    linear: Floats
    of: Ints
    start: Floats
    rows: Ints
    epsilon: float
    rim: float
    n: int
    most: int
    key: np.uint64
    order: np.uint64
    latin: bool
    spread: bool
    floor: float
    smallest: float
    table: Floats


@_kernel
def _points(walks, b, bits, x):  # type: ignore[no-untyped-def]
    """The samples x (n, D) of row b; the key of its numbers."""
    own, n, most = mixed(walks.key, walks.rows[b]), walks.n, walks.most
    if walks.latin:
        _latin(own, mixed(walks.order, walks.rows[b]), n, most, bits, x)
    else:
        for w in range(n):
            walk = mixed(own, w)
            for j in range(most):
                x[w, j] = unit(mixed(walk, j))
    return own


@_kernel
def _end_rows(walks, low, high, edge, t, work):  # type: ignore[no-untyped-def]
    """Where the walks of rows low .. high end, (B, n): closest edge and parameter; steps and capped walks (B, 2)."""
    x, bits = np.empty((walks.n, walks.most)), np.empty(walks.n, np.int64)
    edges, size, grid, shape, first, items = (  # not looked up again in the loop
        walks.edges, walks.size, walks.grid, walks.shape, walks.first, walks.items
    )  # fmt: skip
    epsilon, most = walks.epsilon, walks.most
    for b in range(low, high):
        _points(walks, b, bits, x)
        s, steps, capped = walks.of[b], 0, 0
        for w in range(walks.n):
            px, py, inside = walks.start[b, 0], walks.start[b, 1], True
            for j in range(most + 1):
                e, where, square = nearest(edges, grid, shape, first, items, s, px, py)
                if e < 0:
                    e, where, square = nearest_of_all(edges, shape, s, px, py)
                radius = math.sqrt(square)
                inside = radius > max(epsilon * size[e, min(int(where * BINS), BINS - 1)], 1e-14)
                if j == most or not inside:
                    edge[b, w], t[b, w] = e, where
                    break
                steps += 1
                angle = _TURN * x[w, j]
                px, py = px + radius * math.cos(angle), py + radius * math.sin(angle)
            capped += inside
        work[b, 0], work[b, 1] = steps, capped


@_kernel
def _explore(walks, b, x, density, bits, space, seen, work):  # type: ignore[no-untyped-def]
    """The walks of row b: how many points they saw. Writes these, and steps and capped walks."""
    own = _points(walks, b, bits, x)
    count, work[b, 0], work[b, 1] = explored(
        walks.edges, walks.size, walks.grid, walks.shape, walks.first, walks.items, walks.arc, walks.linear,
        walks.of[b], walks.start[b, 0], walks.start[b, 1], walks.epsilon, walks.rim, x, own, walks.spread,
        walks.floor, walks.smallest, walks.table, space, False, density, seen,
    )  # fmt: skip
    return count


@_kernel
def _space(walks):  # type: ignore[no-untyped-def]
    """Room for `_explore`: points, densities, bits, and what `explored` needs."""
    n = walks.n
    return np.empty((n, walks.most)), np.empty(n), np.empty(n, np.int64), space_for(n, walks.table.shape[1])


@_kernel
def _rows(walks, loops, step, fade, least, low, high, value, lost, work):  # type: ignore[no-untyped-def]
    """Rows low .. high on linear values: answers (B,), measure that was cut off (B,), and the work (B, 2)."""
    most = walks.n * (walks.most + 1)
    seen, room = np.empty((most, NUMBERS)), room_for(most)
    x, density, bits, space = _space(walks)
    for b in range(low, high):
        count = _explore(walks, b, x, density, bits, space, seen, work)
        value[b], _, lost[b], _ = average(seen, count, loops[b], step, fade, least, False, room)


@_kernel
def _seen_rows(walks, base, low, high, seen, counts, work):  # type: ignore[no-untyped-def]
    """What the walks of rows base + low .. base + high see, (rows, k, 6), and how much that is."""
    x, density, bits, space = _space(walks)
    for b in range(low, high):
        counts[b] = _explore(walks, base + b, x, density, bits, space, seen[b], work)


@_kernel
def _average_rows(seen, counts, loops, step, fade, least, base, low, high, value, lost):  # type: ignore[no-untyped-def]
    """Answers to rows base + low .. base + high from what was seen."""
    room = room_for(seen.shape[1])
    for b in range(low, high):
        value[base + b], _, lost[base + b], _ = average(
            seen[b], counts[b], loops[base + b], step, fade, least, False, room
        )


def _fitted(problem: LaplaceProblem, walks: Inputs, rule: WalkFit, work: Any) -> tuple[Floats, Floats]:
    """Answers of `walk-fit` (B,) and measure that was cut off (B,)."""
    fit = (problem.loops().numpy(), rule.step, rule.fade, rule.least)
    value, lost = np.empty(problem.batch), np.empty(problem.batch)
    if all(boundary.function is None for boundary in problem.boundaries):
        kernel: Any = _rows
        over_rows(lambda i, j: kernel(walks, *fit, i, j, value, lost, work), problem.batch)
        return value, lost
    most = walks.n * (walks.most + 1)
    room = np.empty((min(max(1, _ASKED // most), problem.batch), most, NUMBERS))
    for base in range(0, problem.batch, len(room)):
        _asked(problem, walks, fit, base, room[: problem.batch - base], (value, lost, work))
    return value, lost


def _asked(
    problem: LaplaceProblem, walks: Inputs, fit: tuple[Any, ...], base: int, seen: Floats, out: tuple[Any, ...]
) -> None:
    """Rows from `base` on, as many as `seen` has room for, on boundary values of which some are a user's function."""
    explore, rebuild = cast("tuple[Any, Any]", (_seen_rows, _average_rows))
    value, lost, work = out
    counts, of = np.empty(len(seen), np.int64), problem.groups[base : base + len(seen)]
    over_rows(lambda i, j: explore(walks, base, i, j, seen, counts, work), len(seen))
    there = np.arange(seen.shape[1]) < counts[:, None]
    for k in np.unique(of):
        boundary = problem.boundaries[k]
        if boundary.function is not None:
            on = there & (of == k)[:, None]
            points = seen[on, 1:3] + np.repeat(walks.start[base : base + len(seen)], on.sum(axis=1), axis=0)
            seen[on, 3] = evaluated("boundary", boundary.function, boundary.domain.from_frame(points))
    over_rows(lambda i, j: rebuild(seen, counts, *fit, base, i, j, value, lost), len(seen))


def _means(problem: LaplaceProblem, walks: Inputs, work: Any) -> dict[str, Any]:
    """Means (B, 1) of the boundary values where walks end; of independent walks also sums of powers of deviations."""
    kernel: Any = _end_rows
    edge, t = np.empty((problem.batch, walks.n), np.int64), np.empty((problem.batch, walks.n))
    over_rows(lambda i, j: kernel(walks, i, j, edge, t, work), problem.batch)
    value = torch.from_numpy(problem.values(edge, t))
    mean = row_mean(value)
    if walks.latin or walks.n == 1:
        return {"inner": mean[:, None]}
    m2, m3, m4 = power_sums(value - mean[:, None])
    return {"inner": mean[:, None], "m2": m2[:, None], "m3": m3[:, None], "m4": m4[:, None]}


def whole_of(problem: LaplaceProblem, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
    """The compiled pass over a pair, where there is one: plain means or `walk-fit`, on walks of some samplers.

    Rows that `walk-fit` is in doubt of are done again by the pair itself, walk by walk.
    """
    if not isinstance(sampler, Sampler) or type(problem).evaluate is not LaplaceProblem.evaluate:
        return None
    if type(rule) not in (WalkFit, MonteCarlo) or type(sampler) not in (Random, LatinHypercube, WalkSpread):
        return None
    fit = rule if isinstance(rule, WalkFit) else None
    spread = sampler if isinstance(sampler, WalkSpread) else None
    if spread is not None and (fit is None or n > spread.most or spread.rim != fit.rim):
        return None

    def walks_of(stream: Stream) -> Inputs:
        start, rows = (np.ascontiguousarray(t.numpy()) for t in (problem.points, problem.rows))
        values = [np.zeros((len(b.domain.start), 2)) if b.linear is None else b.linear for b in problem.boundaries]
        key, order = unsigned(stream.key), unsigned(stream.child("order").key)
        how = spread or WalkSpread()
        return Inputs(
            *problem.geometry, problem.arcs, np.concatenate(values), problem.outline, start, rows, problem.epsilon,
            fit.rim if fit else 0.0, n, problem.dim, key, order, isinstance(sampler, LatinHypercube),
            spread is not None, how.floor, how.smallest, table_of(how.bins),
        )  # fmt: skip

    def whole(stream: Stream) -> Whole:
        walks, work = walks_of(stream), np.empty((problem.batch, 2), np.int64)
        if fit is None:
            found, doubtful = _means(problem, walks, work), torch.zeros(problem.batch, dtype=torch.bool)
        else:
            value, lost = _fitted(problem, walks, fit, work)
            found, doubtful = {"inner": torch.from_numpy(value)[:, None]}, torch.from_numpy(~(lost <= fit.doubt))
        steps, capped = (int(total) for total in work.sum(axis=0))
        if fit is not None and doubtful.any():
            part = problem.take(doubtful.nonzero()[:, 0])
            samples = sampler.draw(part, n, stream)
            found["inner"][doubtful] = fit.combine(samples).estimate(samples)
            steps += samples.seen.queries
        ended = {"walks_boundary": problem.batch * n - capped, "walks_capped": capped}
        return Whole(**found, fallback=doubtful, queries=steps, work=ended)

    return whole
