"""Sampler and rule in one compiled pass, for the toy family on a CPU.

The same points, the same formulas and the same answers (to rounding) as `samplers`, `rules`, `split` and `structured`,
which stay the reference: what is compiled here is what error-against-time charts must not be unfair to, plain Monte
Carlo first of all.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows, with_term
from nqr_geom.toy.compiled_law import hermite, propagated, trapezoid
from nqr_geom.toy.family import Shape

__all__ = ["GRID", "RANDOM", "SPLIT", "STRATIFIED", "averaged", "combined"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A division by zero gives infinity, as everywhere else, and does not raise.
_inline = njit(inline="always", error_model="numpy")
_function = njit(error_model="numpy")
_kernel = njit(cache=True, nogil=True, error_model="numpy")

RANDOM, STRATIFIED, GRID, SPLIT = range(4)  # how samples are placed
_BELOW_ONE = 1.0 - 2.0**-53
_PIECES = 5
_BROKEN = _PIECES  # what stands for the piece of a gap with breaks


@_inline
def _look(edges, laws, x):
    """f, f' and piece at x of an integrand with edges (6,) and laws (5, 4): value, slope, curvature, alpha."""
    piece = 0
    for k in range(1, _PIECES):
        piece += x >= edges[k]
    law = laws[piece]
    f, d = propagated(law[3], x - edges[piece], law[0], law[1], law[2])
    return f, d, piece


@_inline
def _point(design, row, i, n):
    """Point i of n of a design that does not look at the integrand."""
    u = 0.5 if design == GRID else unit(mixed(mixed(row, i), 0))
    return u if design == RANDOM else (i + u) / n


@_kernel
def _average_rows(edges, laws, rows, key, n, design, moments, start, stop):
    for b in range(start, stop):
        row = mixed(key, rows[b])
        mean, squares, cubes, fourths = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            f = _look(edges[b], laws[b], min(_point(design, row, i, n), _BELOW_ONE))[0]
            mean, squares, cubes, fourths = with_term(f, i, mean, squares, cubes, fourths)
        moments[0, b], moments[1, b], moments[2, b], moments[3, b] = mean, squares, cubes, fourths


def averaged(edges: Floats, laws: Floats, rows: Ints, key: int, n: int, design: int) -> Floats:
    """Plain Monte Carlo: the mean, and sums of powers 2 to 4 of the deviations, (4, B).

    Parameters
    ----------
    edges, laws : ndarray, (B, 6) and (B, 5, 4)
        Ends of the pieces; f, f' and f'' at the left end of each, and alpha.
    rows : ndarray, (B,), int64
        Global row of each integrand.
    key : int
        Of the stream, see `Stream.key`.
    n, design : int
        Samples, and how they are placed, `RANDOM` or `STRATIFIED`.
    """
    moments = np.empty((4, len(rows)))
    fixed = (edges, laws, rows, unsigned(key), n, design, moments)
    over_rows(lambda start, stop: _average_rows(*fixed, start, stop), len(rows))
    return moments


@_inline
def _gap(a, b, x, f, d, piece, jump, settled):
    """What the gap between the samples a and b leaves open, 0 and 1 being the ends of [0, 1]: `split.Gap.between`.

    Its expected squared error while the law of its piece is not settled (it is where both ends agree with a parabola),
    and the piece.
    """
    h = x[b] - x[a]
    inside = a >= 2 and b >= 2
    ahead, behind, rise = h * d[a], h * d[b], f[b] - f[a]
    off = rise - 0.5 * (ahead + behind)
    spread, least = (2.0 * jump) ** 2, (0.5 * jump) ** 2
    if piece[a] != piece[b]:
        leaves = min(off * off if inside else spread, 2.0 * spread) + least
        return h * h / 12.0 * leaves, _BROKEN
    if inside and abs(off) <= 1e-9 * (abs(rise) + abs(ahead) + abs(behind)):
        settled[piece[a]] += 3
    tangent = ahead + behind
    leaves = off * off if inside else min(tangent * tangent, spread) + least
    return h * h / 12.0 * leaves, piece[a]


@_inline
def _idle(g, x, left, right):
    """What a gap of a settled law is worth."""
    h = x[right[g]] - x[left[g]]
    return 1e-8 * h * h


@_function
def _split(edges, laws, row, n, first, jump, x, f, d, piece, left, right, kind, leaves, settled, follows):
    """`ToySplit`: fills x, f, d and piece from entry 2 on, and which sample follows which."""
    settled[:] = 0
    x[0], f[0], d[0], piece[0] = 0.0, 0.0, 0.0, 0
    x[1], f[1], d[1], piece[1] = 1.0, 0.0, 0.0, _PIECES - 1
    first = min(n, first)
    for i in range(2, first + 2):
        x[i] = _point(STRATIFIED, row, i - 2, first)
        f[i], d[i], piece[i] = _look(edges, laws, x[i])
        settled[piece[i]] += 1
    a = 0
    for g in range(first + 1):
        b = g + 2 if g < first else 1
        left[g], right[g], follows[a] = a, b, b
        leaves[g], kind[g] = _gap(a, b, x, f, d, piece, jump, settled)
        a = b
    for g in range(first + 1):
        if settled[kind[g]] > 2:
            leaves[g] = _idle(g, x, left, right)
    for i in range(first + 2, n + 2):
        widest, most = 0, -1.0
        for g in range(i - 1):
            if leaves[g] > most:
                widest, most = g, leaves[g]
        a, b, new = left[widest], right[widest], i - 1
        x[i] = 0.5 * (x[a] + x[b])
        f[i], d[i], piece[i] = _look(edges, laws, x[i])
        follows[a], follows[i] = i, b
        right[widest], left[new], right[new] = i, i, b
        # No other piece than that of the new sample can become settled.
        before = settled[piece[i]] > 2
        settled[piece[i]] += 1
        leaves[widest], kind[widest] = _gap(a, i, x, f, d, piece, jump, settled)
        leaves[new], kind[new] = _gap(i, b, x, f, d, piece, jump, settled)
        if before:
            for g in (widest, new):
                if kind[g] == piece[i]:
                    leaves[g] = _idle(g, x, left, right)
        elif settled[piece[i]] > 2:
            for g in range(i):
                if kind[g] == piece[i]:
                    leaves[g] = _idle(g, x, left, right)


@_kernel
def _combine_rows(edges, laws, rows, key, n, design, first, jump, plain, known, value, start, stop):
    x, f, d, piece = np.empty(n + 2), np.empty(n + 2), np.empty(n + 2), np.empty(n + 2, np.int64)
    at, look, slope, index = np.empty(n + 2), np.empty(n + 2), np.empty(n + 2), np.empty(n + 2, np.int64)
    alpha, bend, sure, foreign = np.empty(n + 2), np.empty(n + 2), np.empty(n + 2, np.bool_), np.empty(n + 2, np.bool_)
    left, right, kind = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    leaves, follows, settled = np.empty(n + 1), np.empty(n + 2, np.int64), np.empty(_PIECES + 1, np.int64)
    room = np.empty((3, 8))
    for b in range(start, stop):
        row = mixed(key, rows[b])
        if design == SPLIT:
            _split(
                edges[b], laws[b], row, n, first, jump, at, look, slope, index, left, right, kind, leaves, settled,
                follows,
            )  # fmt: skip
            i = 0
            for k in range(1, n + 1):
                i = follows[i]
                x[k], f[k], d[k], piece[k] = at[i], look[i], slope[i], index[i]
        else:
            for i in range(n):
                x[i + 1] = min(_point(design, row, i, n), _BELOW_ONE)
            if design == RANDOM:
                x[1 : n + 1].sort()
            for k in range(1, n + 1):
                f[k], d[k], piece[k] = _look(edges[b], laws[b], x[k])
        if plain:
            value[b] = trapezoid(x[1 : n + 1], f[1 : n + 1])
        else:
            value[b] = hermite(x, f, d, piece, alpha, bend, sure, foreign, room, *known)


def combined(
    edges: Floats,
    laws: Floats,
    rows: Ints,
    key: int,
    n: int,
    design: int,
    first: int,
    jump: float,
    rule: tuple[float, Shape] | None,
) -> Floats:
    """The trapezoidal rule or `ToyHermite` on samples that are placed in any way, (B,).

    Parameters are those of `averaged`, and `first` and `jump` those of `ToySplit`; `rule` is what `ToyHermite` knows,
    or None for the trapezoidal rule.
    """
    value = np.empty(len(rows))
    reach, shape = rule or (1.0, Shape())
    known = (reach, shape.jump, shape.shortest, shape.frequency[1])
    fixed = (edges, laws, rows, unsigned(key), n, design, first, jump, rule is None, known, value)
    over_rows(lambda start, stop: _combine_rows(*fixed, start, stop), len(rows))
    return value
