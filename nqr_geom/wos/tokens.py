"""What a walk tells a network: its steps, seen from the query, free of rotation and scale.

A harmonic function is linear in its boundary values, and does not care how the domain is turned or scaled. So tokens
hold geometry alone (a rule that does not look at values is linear in them), lengths are measured in the first ball's
radius and directions against its closest boundary point. Walks are a set: every token stands for one walk, and what it
says about its neighbours on the boundary does not depend on the order of the walks.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit
from torch import Tensor

from nqr_geom.integrator.learn.tokens import Extra
from nqr_geom.integrator.problem import Samples
from nqr_geom.rows import over_rows

__all__ = ["WALK_TOKENS", "boundary_values", "reach", "unknown", "walk_tokens"]

_STEP = 12  # numbers for a step
_END = 15  # and for the end of a walk
_TURN = 2.0 * math.pi


@njit(cache=True, nogil=True, inline="always")
def _log(x):  # type: ignore[no-untyped-def]
    return math.log(min(max(x, 1e-6), 1e6))


@njit(cache=True, nogil=True, error_model="numpy")
def _spacing(arc, px, py, count, before, after, gap):  # type: ignore[no-untyped-def]
    """The boundary points before and after each of `count` ones, and how much of the boundary is nearest to it.

    Points that coincide (a re-entrant corner is closest to much) share their part, so that no order is favoured.
    """
    order = np.argsort(arc[:count], kind="mergesort")
    low = 0
    while low < count:
        high = low + 1
        while high < count and arc[order[high]] == arc[order[low]]:
            high += 1
        a, b, i = order[low - 1 if low > 0 else count - 1], order[high if high < count else 0], order[low]
        part = math.hypot(px[i] - px[a], py[i] - py[a]) + math.hypot(px[i] - px[b], py[i] - py[b])
        for k in range(low, high):
            before[order[k]], after[order[k]], gap[order[k]] = a, b, part / (high - low)
        low = high


@njit(cache=True, nogil=True, error_model="numpy")
def _neighbour(out, px, py, qx, qy):  # type: ignore[no-untyped-def]
    """The end (qx, qy) of another walk as the end (px, py) sees it, in four numbers."""
    p, q = math.hypot(px, py), math.hypot(qx, qy)
    below = max(p * q, 1e-18)
    out[0] = _log(math.hypot(qx - px, qy - py)) / 3.0
    out[1], out[2] = (px * qy - py * qx) / below, (px * qx + py * qy) / below
    out[3] = _log(q) - _log(p)


@njit(cache=True, nogil=True, error_model="numpy")
def _tokens(x, steps, end, length, finished, result, low, high):  # type: ignore[no-untyped-def]
    n, dim = x.shape[1], x.shape[2]
    most = n * (dim + 1)
    px, py, arc, gap = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    before, after = np.empty(most, np.int64), np.empty(most, np.int64)
    for i in range(low, high):
        first = steps[i, 0, 0]
        radius = first[2] if first[2] > 0.0 else 1.0
        c, s = (first[7], first[8]) if first[9] > 0.0 else (1.0, 0.0)
        # Boundary points that were seen: the ends first, then every step's but the first, which all walks share.
        count = n
        for w in range(n):
            ex, ey = end[i, w, 0] / radius, end[i, w, 1] / radius
            px[w], py[w], arc[w] = c * ex + s * ey, c * ey - s * ex, end[i, w, 3]
        _spacing(arc, px, py, n, before, after, gap)
        for w in range(n):
            a, b = before[w], after[w]
            out = result[i, w, dim * _STEP :]
            far = math.hypot(px[w], py[w])
            out[0], out[1] = px[w] / max(far, 1e-18), py[w] / max(far, 1e-18)
            out[2] = _log(far)
            out[3] = max(_log(end[i, w, 2] / radius), -9.0) / 3.0
            out[4], out[5] = length[i, w] / dim, finished[i, w]
            _neighbour(out[6:10], px[w], py[w], px[a], py[a])
            _neighbour(out[10:14], px[w], py[w], px[b], py[b])
        for w in range(n):
            for j in range(1, dim):
                o = steps[i, w, j]
                if o[9] == 0.0:
                    break
                ex, ey = o[5] / radius, o[6] / radius
                px[count], py[count], arc[count] = c * ex + s * ey, c * ey - s * ex, o[3]
                count += 1
        _spacing(arc, px, py, count, before, after, gap)
        at = n
        for w in range(n):
            result[i, w, dim * _STEP + 14] = _log(gap[w]) / 3.0
            for j in range(dim):
                o, out = steps[i, w, j], result[i, w, j * _STEP : (j + 1) * _STEP]
                if o[9] == 0.0:
                    break
                ex, ey = o[5] / radius, o[6] / radius
                bx, by = c * ex + s * ey, c * ey - s * ex
                ax, ay = o[0] / radius, o[1] / radius
                x0, y0 = bx - (c * ax + s * ay), by - (c * ay - s * ax)
                place, far = math.hypot(x0, y0), math.hypot(bx, by)
                squeeze = math.log1p(place) / place if place > 1e-9 else 1.0
                out[0], out[1] = x0 * squeeze, y0 * squeeze
                out[2], out[3] = bx / max(far, 1e-18), by / max(far, 1e-18)
                out[4], out[5] = _log(far), _log(o[2] / radius)
                out[6], out[7] = c * o[7] + s * o[8], c * o[8] - s * o[7]
                turn = _TURN * x[i, w, j]
                tx, ty = math.cos(turn), math.sin(turn)
                out[8], out[9] = c * tx + s * ty, c * ty - s * tx
                out[10] = 1.0
                if j > 0:
                    out[11] = _log(gap[at]) / 3.0
                    at += 1


def walk_tokens(samples: Samples) -> Tensor:
    """Invariant quantities of walks, (B, N, 1, 12 D + 15) float32.

    Parameters
    ----------
    samples : Samples
        With the features of `LaplaceProblem`.
    """

    def feature(name: str) -> np.ndarray:
        return np.ascontiguousarray(samples.feature(name, "inet")[:, :, 0].double().numpy())

    x = np.ascontiguousarray(samples.x.numpy())
    batch, n, dim = x.shape
    steps = feature("steps").reshape(batch, n, dim, -1)
    result = np.zeros((batch, n, dim * _STEP + _END), dtype=np.float32)
    inputs = (x, steps, feature("end"), feature("length")[..., 0], feature("finished")[..., 0], result)
    over_rows(lambda low, high: _tokens(*inputs, low, high), batch)
    return torch.from_numpy(result)[:, :, None]


def boundary_values(samples: Samples) -> Tensor:
    """Boundary values at the closest points of all steps, (B, N, 1, C, D); a walk that has ended repeats its last."""
    if "known" in samples.seen.features:  # many boundary values on one polygon, in training
        return samples.seen.features["known"].unflatten(-1, (samples.value.shape[-1], samples.dim))
    seen = samples.feature("steps", "inet")
    return torch.where(seen[..., 9::10] > 0.0, seen[..., 4::10], samples.value)[..., None, :]


def reach(samples: Samples) -> Tensor:
    """Logarithm of how far walks end from the query, in first radii, (B, N, 1, 1): what tells a foreign scale."""
    first = samples.feature("steps", "inet")[:, :1, 0, 2:3]  # (B, 1, 1)
    radius = torch.where(first > 0.0, first, 1.0)
    end = samples.feature("end", "inet")[:, :, 0, :2] / radius
    return torch.hypot(end[..., 0], end[..., 1]).clamp(1e-6, 1e6).log().float()[:, :, None, None]


def unknown(samples: Samples) -> Tensor:
    """Domains with holes, and walks that begin twice the same way, (B,) bool: no network has learned on any."""
    loops, begun = samples.feature("loops", "inet")[:, 0, 0], samples.x[..., 0].sort(dim=1).values
    return (loops[:, -1] > loops[:, 0]) | (begun.diff(dim=1) == 0.0).any(dim=1)


# A corner cut off at the last step, or a query in the shell, may end nearer than the first radius; nothing ends farther
# than the domain is wide.
WALK_TOKENS = Extra(
    12 * _STEP + _END,
    walk_tokens,
    checked=(12 * _STEP + 2,),
    beside=boundary_values,
    check=reach,
    foreign=unknown,
    taught=("known", "p"),  # what is seen for another p is the same: answers are those for p = 2
)
