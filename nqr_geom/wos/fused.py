"""Walks and the rule that rebuilds what they saw, in one compiled pass: no walk is written down."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numba import njit

from nqr_geom.curves._rows import over_rows
from nqr_geom.integrator.problem import Whole
from nqr_geom.integrator.samplers import LatinHypercube, Random, Sampler
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.streams import Stream
from nqr_geom.wos.average import average, room_for
from nqr_geom.wos.explore import NUMBERS, explored, space_for, table_of
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.spread import WalkSpread
from nqr_geom.wos.structured import WalkFit

__all__ = ["whole_of"]

_FEW = 64  # samples of which ranks are counted rather than sorted

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


@_kernel
def _rows(  # type: ignore[no-untyped-def]
    edges, size, grid, shape, first, items, arc, linear, loops, of, start, rows, epsilon, n, most, key, order, latin,
    spread, floor, smallest, table, rim, step, fade, least, low, high, value, lost, work,
):  # fmt: skip
    """Rows low .. high: answers (B,), measure that was cut off (B,), and steps and capped walks (B, 2)."""
    x, density, bits = np.empty((n, most)), np.empty(n), np.empty(n, np.int64)
    seen, space, room = np.empty((n * (most + 1), NUMBERS)), space_for(n, table.shape[1]), room_for(n * (most + 1))
    for b in range(low, high):
        own = mixed(key, rows[b])
        if latin:
            _latin(own, mixed(order, rows[b]), n, most, bits, x)
        else:
            for w in range(n):
                walk = mixed(own, w)
                for j in range(most):
                    x[w, j] = unit(mixed(walk, j))
        count, work[b, 0], work[b, 1] = explored(
            edges, size, grid, shape, first, items, arc, linear, of[b], start[b, 0], start[b, 1], epsilon, rim, x, own,
            spread, floor, smallest, table, space, False, density, seen,
        )  # fmt: skip
        value[b], _, lost[b], _ = average(seen, count, loops[b], step, fade, least, False, room)


def whole_of(problem: LaplaceProblem, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
    """The compiled pass over a pair, where there is one: `walk-fit` on linear boundary values.

    Rows that the rule is in doubt of are done again by the pair itself, walk by walk.
    """
    if type(rule) is not WalkFit or not isinstance(sampler, Sampler):
        return None
    if (
        type(sampler) not in (Random, LatinHypercube, WalkSpread)
        or type(problem).evaluate is not LaplaceProblem.evaluate
    ):
        return None
    spread = sampler if isinstance(sampler, WalkSpread) else None
    if spread is not None and (n > spread.most or spread.rim != rule.rim):
        return None
    values = [boundary.linear for boundary in problem.boundaries if boundary.linear is not None]
    if len(values) < len(problem.boundaries):
        return None

    def whole(stream: Stream) -> Whole:
        linear, loops = np.concatenate(values), problem.loops().numpy()
        start, rows = (np.ascontiguousarray(t.numpy()) for t in (problem.points, problem.rows))
        key, order = unsigned(stream.key), unsigned(stream.child("order").key)
        how = spread or WalkSpread()
        inputs: tuple[Any, ...] = (
            *problem.geometry, problem.arcs, linear, loops, problem.outline, start, rows, problem.epsilon, n,
            problem.dim, key, order, isinstance(sampler, LatinHypercube), spread is not None, how.floor, how.smallest,
            table_of(how.bins), rule.rim, rule.step, rule.fade, rule.least,
        )  # fmt: skip
        value, lost, work = np.empty(problem.batch), np.empty(problem.batch), np.empty((problem.batch, 2), np.int64)
        kernel: Any = _rows
        over_rows(lambda i, j: kernel(*inputs, i, j, value, lost, work), problem.batch)
        steps, capped = (int(total) for total in work.sum(axis=0))
        inner = torch.from_numpy(value)[:, None]
        doubtful = torch.from_numpy(~(lost <= rule.doubt))
        if doubtful.any():
            part = problem.take(doubtful.nonzero()[:, 0])
            samples = sampler.draw(part, n, stream)
            inner[doubtful] = rule.combine(samples).estimate(samples)
            steps += samples.seen.queries
        ended = {"walks_boundary": problem.batch * n - capped, "walks_capped": capped}
        return Whole(inner, doubtful, steps, work=ended)

    return whole
