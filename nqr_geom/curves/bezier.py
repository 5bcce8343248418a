"""Bezier pieces of degree 1 to 3 as arrays: evaluation, boxes, lengths and flattening.

Every function takes `control` (k, 4, 2) float64 and `degree` (k,) int64; a piece of degree d uses the rows
0..d, and the rows after d repeat its last point. Nothing here validates: `Curve` stands at the door.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["boxes", "coefficients", "derivative", "evaluate", "lengths", "pack", "segment_counts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LENGTH_TOLERANCE = 1e-13  # of the control polygon, per interval of the adaptive rule
_LENGTH_DEPTH = 60


def pack(pieces: Sequence[Floats]) -> tuple[Floats, Ints]:
    """Lay control polygons (d+1, 2) of mixed degrees into one `control` and `degree`.

    Examples
    --------
    >>> control, degree = pack([np.array([[0.0, 0.0], [1.0, 0.0]])])
    >>> control[0].tolist(), degree.tolist()
    ([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0]], [1])
    """
    control = np.empty((len(pieces), 4, 2))
    degree = np.empty(len(pieces), dtype=np.int64)
    for row, piece in enumerate(pieces):
        control[row, : len(piece)] = piece
        control[row, len(piece) :] = piece[-1]
        degree[row] = len(piece) - 1
    return control, degree


def coefficients(control: Floats, degree: Ints) -> Floats:
    """Power basis (k, 4, 2): c0 + c1 t + c2 t^2 + c3 t^3, from differences so that lines have exact zeros."""
    result = np.zeros_like(control)
    first = np.diff(control, axis=1)
    second = np.diff(first, axis=1)
    third = second[:, 1] - second[:, 0]
    quadratic, cubic = degree == 2, degree == 3
    result[:, 0] = control[:, 0]
    result[:, 1] = first[:, 0] * degree[:, None]
    result[quadratic, 2] = second[quadratic, 0]
    result[cubic, 2] = 3.0 * second[cubic, 0]
    result[cubic, 3] = third[cubic]
    return result


def _de_casteljau(points: Floats, t: Floats) -> Floats:
    """Evaluate control polygons (m, d+1, 2) at t (m,); at t = 0 and t = 1 the ends come out bit for bit."""
    u = t[:, None, None]
    while points.shape[1] > 1:
        points = (1.0 - u) * points[:, :-1] + u * points[:, 1:]
    return points[:, 0]


def evaluate(control: Floats, degree: Ints, piece: Ints, t: Floats) -> Floats:
    """Points (m, 2) of the pieces `piece` (m,) at their local parameters `t` (m,) in [0, 1]."""
    result = np.empty((len(piece), 2))
    wanted = degree[piece]
    for d in (1, 2, 3):
        rows = np.flatnonzero(wanted == d)
        result[rows] = _de_casteljau(control[piece[rows], : d + 1], t[rows])
    return result


def derivative(control: Floats, degree: Ints, piece: Ints, t: Floats) -> Floats:
    """dx/dt (m, 2) of the pieces `piece` (m,) at `t` (m,), through the hodograph's control points."""
    result = np.empty((len(piece), 2))
    wanted = degree[piece]
    for d in (1, 2, 3):
        rows = np.flatnonzero(wanted == d)
        hodograph = d * np.diff(control[piece[rows], : d + 1], axis=1)
        result[rows] = _de_casteljau(hodograph, t[rows])
    return result


def _stationary(c1: Floats, c2: Floats, c3: Floats) -> tuple[Floats, Floats]:
    """Roots of c1 + 2 c2 t + 3 c3 t^2 clipped to [0, 1]; where there is none, an end (harmless for a box)."""
    a, b, c = 3.0 * c3, 2.0 * c2, c1
    scale = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(c))
    scale = np.where(scale > 0.0, scale, 1.0)
    a, b, c = a / scale, b / scale, c / scale
    discriminant = b * b - 4.0 * a * c
    root = np.sqrt(np.maximum(discriminant, 0.0))
    q = -0.5 * (b + np.copysign(root, b))  # no cancellation: both terms have one sign
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        pair = (q / a, c / q)
    one, two = (np.clip(np.where((discriminant >= 0.0) & ~np.isnan(t), t, 0.0), 0.0, 1.0) for t in pair)
    return one, two


def boxes(control: Floats, degree: Ints) -> Floats:
    """Tight boxes (k, 4) as xmin, ymin, xmax, ymax: ends and interior extrema of each coordinate."""
    k = len(degree)
    ends = np.stack([control[:, 0], control[:, 3]])
    low, high = ends.min(axis=0), ends.max(axis=0)
    c = coefficients(control, degree)
    rows = np.arange(k)
    for axis in (0, 1):
        for t in _stationary(c[:, 1, axis], c[:, 2, axis], c[:, 3, axis]):
            value = evaluate(control, degree, rows, t)[:, axis]
            low[:, axis] = np.minimum(low[:, axis], value)
            high[:, axis] = np.maximum(high[:, axis], value)
    return np.concatenate([low, high], axis=1)


@lru_cache(maxsize=1)
def _gauss() -> tuple[Floats, Floats]:
    """Sixteen Gauss-Legendre nodes and weights on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    return 0.5 * (nodes + 1.0), 0.5 * weights


def lengths(control: Floats, degree: Ints) -> Floats:
    """Arc length (k,) of every piece: exact for lines, adaptive Gauss-Legendre for the others.

    An interval is halved until its two halves agree with it to 1e-13 of the control polygon, which is no
    longer than a constant times the arc (all norms of polynomials of one degree are equivalent): so this is a
    relative tolerance. A cusp, where the speed has a kink, costs about twenty halvings.
    """
    steps = np.diff(control, axis=1)
    scale = np.hypot(steps[..., 0], steps[..., 1]).sum(axis=1)
    chord = control[:, 3] - control[:, 0]
    result = np.where(degree == 1, np.hypot(chord[:, 0], chord[:, 1]), 0.0)
    nodes, weights = _gauss()

    def integral(piece: Ints, start: Floats, width: Floats) -> Floats:
        t = start[:, None] + width[:, None] * nodes
        velocity = derivative(control, degree, np.repeat(piece, len(nodes)), t.ravel())
        speed = np.hypot(velocity[:, 0], velocity[:, 1]).reshape(t.shape)
        return width * (speed @ weights)

    piece = np.flatnonzero((degree > 1) & (scale > 0.0))
    start, width = np.zeros(len(piece)), np.ones(len(piece))
    whole = integral(piece, start, width)
    for depth in range(_LENGTH_DEPTH):
        half = 0.5 * width
        left, right = integral(piece, start, half), integral(piece, start + half, half)
        done = np.abs(left + right - whole) <= _LENGTH_TOLERANCE * scale[piece]
        done |= depth == _LENGTH_DEPTH - 1
        np.add.at(result, piece[done], (left + right)[done])
        open_ = ~done
        if not open_.any():
            break
        piece = np.concatenate([piece[open_], piece[open_]])
        start = np.concatenate([start[open_], (start + half)[open_]])
        width = np.concatenate([half[open_], half[open_]])
        whole = np.concatenate([left[open_], right[open_]])
    return result


def segment_counts(control: Floats, degree: Ints, tol: float) -> Floats:
    """Equal parameter steps (k,) after which no chord of a piece is farther than `tol` from its arc.

    Linear interpolation on a step h is off by at most h^2/8 max|x''|, and |x''| is at most d (d-1) times the
    largest second difference of the control points, because x'' lies in the hull of its own control points.
    Returned as float64, since a tiny `tol` can ask for more than an integer holds.
    """
    second = np.diff(control, n=2, axis=1)
    size = np.hypot(second[..., 0], second[..., 1])
    used = np.arange(2) < (degree - 1)[:, None]  # rows after d repeat the last point: not part of the piece
    bound = (degree * (degree - 1)) * np.where(used, size, 0.0).max(axis=1, initial=0.0)
    with np.errstate(over="ignore"):
        return np.maximum(np.ceil(np.sqrt(bound / 8.0 / tol)), 1.0)
