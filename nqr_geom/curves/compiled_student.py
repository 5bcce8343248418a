"""Random or jittered points, base rule, the tokens of `stencil`, an MLP and the weighted sum in one compiled pass.

The same answer as sampler and rule one after the other, to the rounding of the weights' type: kernels are compiled for
the type that they are given, float32 for speed, float64 where a test wants to see every digit agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.curves.compiled import _LEVELS, Floats, Ints, _at, _rebuilt, _sort
from nqr_geom.keyed import mixed, unit, unsigned
from nqr_geom.rows import over_rows

__all__ = ["Estimated", "Layers", "estimated"]

_TINY = 1e-280
_SMALL = 1e-18
_LIMIT = 16.0  # of a network's input
_FLAT = 5e-2  # part of the largest value
_CLOSEST = 1e-4  # gap in units of 1/N below which gaps look alike
_LEAST_GROWTH, _GROWTH = -30.0, 3.0
_TOKENS = 30
_LANES = 16  # numbers of single precision in a vector register: loops over samples have no remainder

_inline = njit(inline="always", error_model="numpy")
_function = njit(error_model="numpy", fastmath={"contract"})
_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@dataclass(frozen=True)
class Layers:
    """Weights (outputs, inputs) and biases (outputs,) of the three linear layers, float32 or float64 alike.

    Outputs of hidden layers must be multiples of four; inputs of the first are padded to one. The last gives g and h
    of plain weights (`inet.correct`), and an offset too where the base rule is the rebuilt curve.
    """

    first: tuple[NDArray, NDArray]
    second: tuple[NDArray, NDArray]
    last: tuple[NDArray, NDArray]

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            weights = getattr(self, name)[0]
            if weights.shape[0] % 4 or (name == "second" and weights.shape[1] % 4):
                raise ValueError(f"{name}: expected multiples of 4 hidden channels, got {weights.shape}")
        inputs, outputs = self.first[0].shape[1], self.last[0].shape[0]
        if inputs != _TOKENS or outputs not in (2, 3):
            raise ValueError(f"layers: expected {_TOKENS} inputs and 2 or 3 outputs, got {inputs} and {outputs}")

    @property
    def structured(self) -> bool:
        """Whether they correct the rebuilt curve's winding number where that is in doubt, instead of plain weights."""
        return self.last[0].shape[0] == 3

    @property
    def arrays(self) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray, NDArray]:
        """What kernels take: inputs padded to a multiple of four."""
        first = np.pad(self.first[0], ((0, 0), (0, -_TOKENS % 4)))
        return first, self.first[1], *self.second, *self.last


@_function
def _linear(weights, bias, x, out):
    """out = weights x + bias along contiguous samples; four outputs and four inputs at a time."""
    outputs, inputs = weights.shape
    n = x.shape[1]
    for j in range(0, outputs, 4):
        a, b, c, d = out[j], out[j + 1], out[j + 2], out[j + 3]
        for i in range(n):
            a[i], b[i], c[i], d[i] = bias[j], bias[j + 1], bias[j + 2], bias[j + 3]
        for k in range(0, inputs, 4):
            p, q, r, s = x[k], x[k + 1], x[k + 2], x[k + 3]
            a0, a1, a2, a3 = weights[j, k], weights[j, k + 1], weights[j, k + 2], weights[j, k + 3]
            b0, b1, b2, b3 = weights[j + 1, k], weights[j + 1, k + 1], weights[j + 1, k + 2], weights[j + 1, k + 3]
            c0, c1, c2, c3 = weights[j + 2, k], weights[j + 2, k + 1], weights[j + 2, k + 2], weights[j + 2, k + 3]
            d0, d1, d2, d3 = weights[j + 3, k], weights[j + 3, k + 1], weights[j + 3, k + 2], weights[j + 3, k + 3]
            for i in range(n):
                a[i] += a0 * p[i] + a1 * q[i] + a2 * r[i] + a3 * s[i]
                b[i] += b0 * p[i] + b1 * q[i] + b2 * r[i] + b3 * s[i]
                c[i] += c0 * p[i] + c1 * q[i] + c2 * r[i] + c3 * s[i]
                d[i] += d0 * p[i] + d1 * q[i] + d2 * r[i] + d3 * s[i]


@_function
def _layer(weights, bias, x, out):
    """out = relu(weights x + bias)."""
    _linear(weights, bias, x, out)
    zero = x.dtype.type(0.0)
    for j in range(out.shape[0]):
        row = out[j]
        for i in range(out.shape[1]):
            row[i] = max(row[i], zero)


@_function
def _outputs(weights, bias, x, out):
    """out = weights x + bias, for few outputs."""
    for j in range(weights.shape[0]):
        for i in range(x.shape[1]):
            out[j, i] = bias[j]
        for k in range(weights.shape[1]):
            w = weights[j, k]
            for i in range(x.shape[1]):
                out[j, i] += w * x[k, i]


@_inline
def _half_turns(ax, ay, bx, by):
    """Signed angle from a to b in turns of pi, as `tokens.half_turns`."""
    x, y = ax * bx + ay * by, ax * by - ay * bx
    size = math.sqrt(ax * ax + ay * ay) * math.sqrt(bx * bx + by * by)
    if x < 0.0:
        return math.atan((size - x) / (y if y != 0.0 else _SMALL)) * (2.0 / math.pi)
    return math.atan(y / max(size + x, _SMALL)) * (2.0 / math.pi)


@_inline
def _log(ratio):
    return math.log(min(max(ratio, 1e-12), 1e12)) / 3.0


@_inline
def _seen(c, k, px, py, row, n, jittered, raw, order, s, r, t, piece):
    """Sorted samples of a query: fills s, piece, position from it r and tangent t = dx/ds, (n, ...)."""
    for i in range(n):
        raw[i] = unit(mixed(mixed(row, i), 0))
        if jittered:
            raw[i] = (i + raw[i]) / n
        order[i] = i
    if not jittered:
        _sort(raw, order)
    for i in range(n):
        s[i] = raw[order[i]]
        x, y, t[i, 0], t[i, 1], piece[i] = _at(c, k, s[i])
        r[i, 0], r[i, 1] = x - px, y - py
    for i in range(n):
        order[i] = i


@_inline
def _normalised(r, t, k, n, see, distance, length):
    """Into see = (position from the query, unit tangent, speed), lengths in the mean length of a piece."""
    total = 0.0
    for i in range(n):
        length[i] = math.sqrt(t[i, 0] ** 2 + t[i, 1] ** 2)
        total += length[i] / k
    mean = max(total / n, _TINY)
    for i in range(n):
        see[i, 0], see[i, 1] = r[i, 0] / mean, r[i, 1] / mean
        see[i, 4] = length[i] / k / mean
        tx, ty = t[i, 0] / max(length[i], _TINY) * see[i, 4], t[i, 1] / max(length[i], _TINY) * see[i, 4]
        size = max(math.sqrt(tx * tx + ty * ty), _SMALL)
        see[i, 2], see[i, 3] = tx / size, ty / size
        distance[i] = max(math.sqrt(see[i, 0] ** 2 + see[i, 1] ** 2), _SMALL)


@_inline
def _alone(i, s, k, piece, see, distance, tokens):
    """What a sample tells by itself: tokens 7 to 13."""
    rx, ry, ux, uy, speed = see[i, 0], see[i, 1], see[i, 2], see[i, 3], see[i, 4]
    local = min(max(s[i] * k - piece[i], 0.0), 1.0)
    tx, ty = ux * speed, uy * speed
    tokens[7, i] = _log(distance[i])
    tokens[8, i] = (rx * ux + ry * uy) / distance[i]
    tokens[9, i] = (rx * uy - ry * ux) / distance[i]
    tokens[10, i] = _log(speed)
    tokens[11, i] = local
    tokens[12, i] = 2.0 * _half_turns(rx - local * tx, ry - local * ty, rx, ry)
    rest = 1.0 - local
    tokens[13, i] = 2.0 * _half_turns(rx, ry, rx + rest * tx, ry + rest * ty)


@_inline
def _beside(i, n, s, piece, see, distance, tokens):
    """What the gap between samples i and i + 1 tells both."""
    j = i + 1
    gap = math.log(max(n * (s[j] - s[i]), _CLOSEST)) / 3.0
    hop = min(max(float(piece[j] - piece[i]), 0.0), 4.0) / 2.0
    tokens[6, i] = tokens[5, j] = gap
    tokens[15, i] = tokens[14, j] = hop
    if hop != 0.0:
        for m in range(7):
            tokens[23 + m, i] = tokens[16 + m, j] = 0.0
        return
    cx, cy = see[j, 0] - see[i, 0], see[j, 1] - see[i, 1]
    step = math.sqrt(cx * cx + cy * cy)
    dx, dy = cx / max(step, _SMALL), cy / max(step, _SMALL)
    turn = 2.0 * _half_turns(see[i, 0], see[i, 1], see[j, 0], see[j, 1])
    bend = 2.0 * _half_turns(see[i, 2], see[i, 3], see[j, 2], see[j, 3])
    tokens[23, i] = tokens[16, j] = 1.0
    tokens[24, i], tokens[17, j] = turn, -turn
    tokens[25, i], tokens[18, j] = _log(step / distance[i]), _log(step / distance[j])
    tokens[26, i], tokens[19, j] = _log(distance[j] / distance[i]), _log(distance[i] / distance[j])
    tokens[27, i], tokens[20, j] = dx * see[i, 2] + dy * see[i, 3], -(dx * see[j, 2] + dy * see[j, 3])
    tokens[28, i], tokens[21, j] = dx * see[i, 3] - dy * see[i, 2], -(dx * see[j, 3] - dy * see[j, 2])
    tokens[29, i], tokens[22, j] = bend, -bend


@_inline
def _ends(s, n, tokens):
    """Nothing lies beyond the outermost samples."""
    tokens[5, 0] = math.log(max(n * s[0], _CLOSEST)) / 3.0
    tokens[6, n - 1] = math.log(max(n * (1.0 - s[n - 1]), _CLOSEST)) / 3.0
    tokens[14, 0] = tokens[15, n - 1] = 2.0
    for m in range(7):
        tokens[16 + m, 0] = tokens[23 + m, n - 1] = 0.0


@_inline
def _row_tokens(s, k, piece, r, t, see, distance, f, n, tokens):
    """All tokens of a row, the numbers of `tokens.tokenize`, limited and free of NaN."""
    for i in range(n):
        x, y = r[i, 0], r[i, 1]
        f[i] = (x * t[i, 1] - y * t[i, 0]) / (2.0 * math.pi * max(x * x + y * y, _TINY))
        tokens[0, i] = math.copysign(math.log1p(abs(f[i])), f[i])
        tokens[1, i] = (i + 0.5) / n
        tokens[2, i] = math.log(n / 32.0)
        tokens[3, i] = 1.0 if i == 0 else 0.0
        tokens[4, i] = 1.0 if i == n - 1 else 0.0
        _alone(i, s, k, piece, see, distance, tokens)
    _ends(s, n, tokens)
    for i in range(n - 1):
        _beside(i, n, s, piece, see, distance, tokens)
    for m in range(_TOKENS):
        for i in range(n):
            v = tokens[m, i]
            tokens[m, i] = min(max(v, -_LIMIT), _LIMIT) if v == v else 0.0


@_inline
def _weighed(f, out, n):
    """Mean of W f with the weights that the network's outputs g and h stand for, as `inet.correct`."""
    total = 0.0
    for i in range(n):
        growth = min(max(float(out[0, i]), _LEAST_GROWTH), _GROWTH)
        total += (math.exp(growth) + float(out[1, i]) / max(abs(f[i]), 1.0)) * f[i]
    return total / n


@_inline
def _shift(f, out, n):
    """What h and o of the outputs add to a base rule that uses no values."""
    total = 0.0
    for i in range(n):
        total += float(out[1, i]) / max(abs(f[i]), 1.0) * f[i] + float(out[2, i])
    return total / n


@_inline
def _trapezoid(s, f, n):
    """The trapezoidal rule of sorted samples, extended as a constant to both ends."""
    total = 0.0
    for i in range(n):
        low = -s[0] if i == 0 else s[i - 1]
        high = 2.0 - s[n - 1] if i == n - 1 else s[i + 1]
        total += 0.5 * (high - low) * f[i]
    return total


@_inline
def _within(distance, see, box, n):
    """Whether all samples are as far and as fast as those of the family."""
    known = True
    for i in range(n):
        far, fast = _log(distance[i]), _log(see[i, 4])
        known &= box[0, 0] <= far <= box[1, 0] and box[0, 1] <= fast <= box[1, 1]
    return known


@_inline
def _flat(f, n):
    """Whether values are all but constant, as `tokens.flat`."""
    low, high = f[0], f[0]
    for i in range(1, n):
        low, high = min(low, f[i]), max(high, f[i])
    return high - low <= _FLAT * max(abs(low), abs(high))


@_kernel
def _student_rows(
    coefficients, pieces, shape, points, rows, key, n, jittered, structured, box,
    w1, b1, w2, b2, w3, b3, learned, safe, inside, doubtful, start, stop,
):  # fmt: skip
    padded = (n + _LANES - 1) // _LANES * _LANES
    raw, s, f, distance, length = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    order, piece = np.empty(n, np.int64), np.empty(n, np.int64)
    r, t, see = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 5))
    stack, levels = np.empty((2 * _LEVELS + 4, 8)), np.empty(2 * _LEVELS + 4, np.int64)
    tokens = np.zeros((w1.shape[1], padded), w1.dtype)
    one, two = np.empty((w1.shape[0], padded), w1.dtype), np.empty((w2.shape[0], padded), w1.dtype)
    out = np.empty((w3.shape[0], padded), w1.dtype)
    for b in range(start, stop):
        c, k = coefficients[shape[b]], pieces[shape[b]]
        _seen(c, k, points[b, 0], points[b, 1], mixed(key, rows[b]), n, jittered, raw, order, s, r, t, piece)
        inside[b], doubtful[b] = True, False
        if structured:
            safe[b], doubtful[b] = _rebuilt(s, r, t, piece, k, order, stack, levels)
            learned[b] = safe[b]
            if not doubtful[b] or not w1.size:
                continue
        _normalised(r, t, k, n, see, distance, length)
        inside[b] = _within(distance, see, box, n)
        _row_tokens(s, k, piece, r, t, see, distance, f, n, tokens)
        inside[b] &= not _flat(f, n)
        _layer(w1, b1, tokens, one)
        _layer(w2, b2, one, two)
        _outputs(w3, b3, two, out)
        if structured:
            learned[b] += _shift(f, out, n)
        else:
            learned[b], safe[b] = _weighed(f, out, n), _trapezoid(s, f, n)


@dataclass(frozen=True)
class Estimated:
    """What a pass gives, each (B,).

    Parameters
    ----------
    learned, safe : ndarray, float64
        The student's estimate, and on the same points that of the rule it fades to: the trapezoid, or the rebuilt
        curve.
    inside : ndarray, bool
        Integrals inside the box.
    doubtful : ndarray, bool
        Integrals that the rebuilt curve leaves in doubt; elsewhere the network was not asked.
    """

    learned: Floats
    safe: Floats
    inside: NDArray[np.bool_]
    doubtful: NDArray[np.bool_]


def estimated(
    coefficients: Floats,
    pieces: Ints,
    shape: Ints,
    points: Floats,
    rows: Ints,
    key: int,
    n: int,
    jittered: bool,
    box: Floats,
    layers: Layers,
) -> Estimated:
    """Run a student over all queries.

    Parameters
    ----------
    coefficients, pieces, shape, points, rows, key, n, jittered
        As for `compiled.sampled`.
    box : ndarray, (2, 2)
        Lowest and highest logarithms of distance and speed that the student knows.
    layers : Layers
        Its weights.
    """
    count = len(points)
    result = Estimated(np.empty(count), np.empty(count), np.empty(count, np.bool_), np.empty(count, np.bool_))
    known = (coefficients, pieces, shape, points, rows, unsigned(key), n, jittered, layers.structured, box)
    fixed = (*known, *layers.arrays, result.learned, result.safe, result.inside, result.doubtful)
    over_rows(lambda start, stop: _student_rows(*fixed, start, stop), count)
    return result
