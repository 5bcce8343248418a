"""Walk on spheres, compiled: every walk jumps from ball to ball until it is within the epsilon shell of the edge.

A walk is a pure function of (key, row, number of the walk): step j uses the random number of (row, walk, j), the same
one that a sampler of the integrator would place there, so both give the same walks and nothing depends on threads.

Branches of an effect that a problem does not have are not compiled: `_compiled` builds the kernel for what there is.

References: Muller, Some continuous Monte Carlo methods for the Dirichlet problem, 1956; Sawhney, Crane, Monte Carlo
geometry processing, 2020.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows
from nqr_geom.streams import Stream
from nqr_geom.wos.nearest import BINS, Nearest, nearest

__all__ = ["OUTCOMES", "Physics", "Walks", "bessel_i0", "uniforms", "walk"]

Floats = NDArray[np.float64]

OUTCOMES = ("boundary", "capped", "escaped")
_SOURCES = 16  # steps between two evaluations of a source

_TURN = 2.0 * math.pi


@njit(cache=True, nogil=True)
def uniforms(key, row, sample, count):  # type: ignore[no-untyped-def]
    """The first `count` numbers of a walk: bit for bit those of `Stream.uniform(row, sample, dimension)`."""
    state = mixed(mixed(key, row), sample)
    result = np.empty(count)
    for j in range(count):
        result[j] = unit(mixed(state, j))
    return result


@njit(cache=True, nogil=True)
def bessel_i0(x):  # type: ignore[no-untyped-def]
    """Modified Bessel function I0 times exp(-x), x >= 0: its series, or the asymptotic one where that is exact."""
    if x < 20.0:
        quarter, term, total, k = 0.25 * x * x, 1.0, 1.0, 1.0
        while term > 1e-17 * total:
            term *= quarter / (k * k)
            total += term
            k += 1.0
        return total * math.exp(-x)
    term, total, k = 1.0, 1.0, 1.0
    while abs(term) > 1e-17 and k < 30.0:
        term *= (2.0 * k - 1.0) ** 2 / (8.0 * k * x)
        total += term
        k += 1.0
    return total / math.sqrt(_TURN * x)


@dataclass(frozen=True)
class Physics:
    """What the equation -laplace(u) + screening u = source has beside the Laplacian, in the frame's units.

    Parameters
    ----------
    screening : float
        >= 0.
    source : callable, optional
        ``source(points (m, 2) in the frame) -> (m,)``.
    """

    screening: float = 0.0
    source: Callable[[Floats], Floats] | None = None


@dataclass(frozen=True)
class Walks:
    """Where walks ended.

    Attributes
    ----------
    edge, t : (B, n) arrays
        Closest boundary point of each walk's last position.
    outcome : (B, n) uint8
        Index into `OUTCOMES`.
    steps : (B, n) int64
        Jumps made.
    weight : (B, n) float64, or None
        What screening leaves of the boundary value.
    gained : (B, n) float64, or None
        What the walk collected from the source.
    """

    edge: NDArray[np.int64]
    t: Floats
    outcome: NDArray[np.uint8]
    steps: NDArray[np.int64]
    weight: Floats | None
    gained: Floats | None

    def counts(self) -> dict[str, int]:
        """Walks by outcome, and steps."""
        each = np.bincount(self.outcome.ravel(), minlength=len(OUTCOMES))
        return {f"walks_{name}": int(k) for name, k in zip(OUTCOMES, each, strict=True)} | {
            "steps": int(self.steps.sum())
        }


@lru_cache(maxsize=4)
def _compiled(screened: bool, sourced: bool) -> Any:
    """The kernel for the effects at hand; the others leave no instruction behind."""

    @njit(cache=True, nogil=True)
    def kernel(  # type: ignore[no-untyped-def]
        edges, size, grid, shape, first, items, of, start, rows, walks, key, screening, epsilon, most, low, high,
        edge, t, outcome, steps, weight, state, seen,
    ):  # fmt: skip
        root = math.sqrt(screening)
        n = len(walks)
        for k in range(low, high):
            i = k // n
            s = of[i]
            random = mixed(mixed(key, rows[i]), walks[k % n])
            x, y, done = start[i, 0], start[i, 1], 0
            if sourced:
                done = steps[k]
                x, y = state[k, 0], state[k, 1]
            throughput = weight[k] if screened else 1.0
            # With a source the caller looks in every few steps; a walk that has ended stays where it is.
            pause = min(done + _SOURCES, most) if sourced else most
            result = 1
            if sourced and outcome[k] != 1:
                continue
            while True:
                e, where, square = nearest(edges, grid, shape, first, items, s, x, y)
                if e < 0:
                    result = 2
                    break
                edge[k], t[k] = e - shape[s, 3], where
                radius = math.sqrt(square)
                if radius <= max(epsilon * size[e, min(int(where * BINS), BINS - 1)], 1e-14):
                    result = 0
                    break
                if done == pause:
                    break
                if sourced:
                    # Under Green's function, -4 s ln(s) ds, the radius is the root of a product of two uniforms.
                    extra = mixed(random, done)
                    part = math.sqrt(unit(mixed(extra, 0)) * unit(mixed(extra, 1)))
                    turn = _TURN * unit(mixed(extra, 2))
                    at = seen[k, done % _SOURCES]
                    at[0], at[1] = x + part * radius * math.cos(turn), y + part * radius * math.sin(turn)
                    at[2], at[3], at[4] = part * radius, radius, throughput
                if screened:
                    throughput *= math.exp(-root * radius) / bessel_i0(root * radius)
                angle = _TURN * unit(mixed(random, done))
                x, y = x + radius * math.cos(angle), y + radius * math.sin(angle)
                done += 1
            outcome[k], steps[k] = result, done
            if screened:
                weight[k] = throughput
            if sourced:
                state[k, 0], state[k, 1] = x, y

    return kernel


def walk(
    geometry: Nearest,
    of: NDArray[np.int64],
    start: Floats,
    rows: NDArray[np.int64],
    walks: NDArray[np.int64],
    stream: Stream,
    *,
    epsilon: float,
    max_steps: int,
    physics: Physics | None = None,
) -> Walks:
    """Walk from every start.

    Parameters
    ----------
    geometry : Nearest
        One or several polygons.
    of, start, rows : (B,), (B, 2) and (B,)
        Polygon, position in its frame and global row of each query.
    walks : (n,) int64
        Numbers of the walks: a later call with others goes on where this one ended.
    stream : Stream
        Source of the random numbers.
    epsilon : float
        Width of the shell as a part of the local size.
    max_steps : int
        Jumps before a walk counts as capped.
    physics : Physics, optional
        Screening and source; those that are zero cost nothing.
    """
    physics = physics or Physics()
    screened, sourced = physics.screening > 0.0, physics.source is not None
    total = len(start) * len(walks)
    edge, t = np.zeros(total, dtype=np.int64), np.zeros(total)
    outcome, steps = np.ones(total, dtype=np.uint8), np.zeros(total, dtype=np.int64)
    weight = np.ones(total if screened else 0)
    state = np.repeat(start, len(walks), axis=0) if sourced else np.zeros((0, 2))
    seen = np.zeros((total if sourced else 0, _SOURCES, 5))
    gained = np.zeros(total if sourced else 0)
    kernel, key = _compiled(screened, sourced), unsigned(stream.key)
    inputs = (*geometry, of, start, rows, walks, key, physics.screening, epsilon, max_steps)
    before = np.zeros(total, dtype=np.int64)
    while True:
        over_rows(lambda i, j: kernel(*inputs, i, j, edge, t, outcome, steps, weight, state, seen), total)
        if not sourced:
            break
        fresh = steps - before
        before[:] = steps
        gained += _gain(seen, fresh, physics)
        if not ((outcome == 1) & (steps < max_steps)).any():
            break
    square = (len(start), len(walks))
    return Walks(
        edge.reshape(square),
        t.reshape(square),
        outcome.reshape(square),
        steps.reshape(square),
        weight.reshape(square) if screened else None,
        gained.reshape(square) if sourced else None,
    )


def _gain(seen: Floats, fresh: NDArray[np.int64], physics: Physics) -> Floats:
    """Source at the points seen in the last steps times the integral of the balls' Green's function, summed by walk."""
    if physics.source is None:
        return np.zeros(len(seen))
    number, slot = np.nonzero(np.arange(_SOURCES) < fresh[:, None])
    x, y, part, radius, throughput = seen[number, slot].T
    value = 0.25 * radius**2 * throughput
    if physics.screening > 0.0:
        value = value * _screened_green(math.sqrt(physics.screening), part, radius)
    value = value * physics.source(np.stack([x, y], axis=1))
    return np.bincount(number, weights=value, minlength=len(seen)).astype(np.float64)


def _screened_green(root: float, part: Floats, radius: Floats) -> Floats:
    """Green's function of the screened equation over that of Laplace's, at distance `part` in a ball, in [0, 1]."""
    from scipy.special import i0e, k0e

    a, b = root * part, root * radius
    # K0(a) - K0(b) I0(a)/I0(b), each scaled by its exponential.
    green = k0e(a) * np.exp(-a) - k0e(b) * np.exp(-b) * (i0e(a) / i0e(b)) * np.exp(a - b)
    return np.clip(green / np.maximum(-np.log(part / radius), 1e-300), 0.0, 1.0)
