"""The sampling network on curves in one compiled pass: points, gaps, transformer and choice, many queries abreast.

The same points as `learn.snet`, `learn.heads` and `curves.gaps` give one after the other, to the rounding of single
precision; those stay the reference. Queries lie side by side in the vectors of the processor, so that a query's numbers
depend on no other, and everything that was read before (keys and values, keys of gaps) stays where it was put.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nqr_geom.curves.compiled import Floats, Ints, _at
from nqr_geom.curves.compiled_student import _layer, _linear, _log, _outputs
from nqr_geom.rows import over_rows

__all__ = ["LANES", "Weights", "placed"]

Singles = NDArray[np.float32]

LANES = 32  # queries abreast
_FEATURES = 17  # of a gap
_OWN = 34  # numbers of a sample by itself
_COUNTS = _OWN + 2 * _FEATURES
_LIMIT = 16.0
_TINY = 1e-280
_UNSEEN = 4.0
_NEAREST = 0.1
_NORM = np.float32(1e-5)
_BELOW_ONE = 1.0 - 2.0**-53

_inline = njit(inline="always", error_model="numpy")
_function = njit(error_model="numpy", fastmath={"contract"})
_sums = njit(error_model="numpy", fastmath={"contract", "reassoc"})
_kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@dataclass(frozen=True)
class Weights:
    """Weights (outputs, inputs) and biases of a sampling network, float32; those of blocks have a first axis more.

    Inputs and outputs are padded to multiples of four. `profile` are the base logits of bins.
    """

    embed_in: Singles
    embed_in_bias: Singles
    embed_out: Singles
    embed_out_bias: Singles
    norms: Singles
    qkv: Singles
    qkv_bias: Singles
    out: Singles
    out_bias: Singles
    up: Singles
    up_bias: Singles
    down: Singles
    down_bias: Singles
    last_norm: Singles
    key_in: Singles
    key_in_bias: Singles
    key_out: Singles
    key_out_bias: Singles
    query: Singles
    query_bias: Singles
    bias: Singles
    bias_bias: Singles
    bin_key: Singles
    bin_key_bias: Singles
    bin_state: Singles
    no_bias: Singles
    bins: Singles
    bins_bias: Singles
    profile: Singles

    @property
    def arrays(self) -> tuple[Singles, ...]:
        """What kernels take."""
        return tuple(getattr(self, field.name) for field in fields(self))


@_function
def _norm(weights, x, out):
    """Layer norm along the first axis; weights are (scale, shift)."""
    e, n = x.shape
    mean, spread = np.zeros(n, np.float32), np.zeros(n, np.float32)
    for j in range(e):
        row = x[j]
        for i in range(n):
            mean[i] += row[i]
    for i in range(n):
        mean[i] /= np.float32(e)
    for j in range(e):
        row = x[j]
        for i in range(n):
            spread[i] += (row[i] - mean[i]) * (row[i] - mean[i])
    for i in range(n):
        spread[i] = np.float32(1.0) / np.sqrt(spread[i] / np.float32(e) + _NORM)
    for j in range(e):
        a, b, row, to = weights[0, j], weights[1, j], x[j], out[j]
        for i in range(n):
            to[i] = (row[i] - mean[i]) * spread[i] * a + b


@_function
def _add(x, more):
    for j in range(x.shape[0]):
        a, b = x[j], more[j]
        for i in range(x.shape[1]):
            a[i] += b[i]


@_function
def _exp(x, whole, power):
    """e^x in place for x <= 0, to a few units of single precision; `power` is a view of `whole` as floats."""
    for i in range(x.shape[0]):
        v = max(x[i], np.float32(-87.0))
        k = np.floor(v * np.float32(1.44269504) + np.float32(0.5))
        v = (v - k * np.float32(0.693359375)) + k * np.float32(2.12194440e-4)
        whole[i] = (np.int32(k) + np.int32(127)) << np.int32(23)
        p = np.float32(1.9875691500e-4)
        p = p * v + np.float32(1.3981999507e-3)
        p = p * v + np.float32(8.3334519073e-3)
        p = p * v + np.float32(4.1665795894e-2)
        p = p * v + np.float32(1.6666665459e-1)
        p = p * v + np.float32(5.0000001201e-1)
        x[i] = p * v * v + v + np.float32(1.0)
    for i in range(x.shape[0]):
        x[i] *= power[i]


@_function
def _attend(qkv, keys, values, at, heads, mix, score, whole, power):
    """What the newest token takes from all up to it, itself included: fills mix (E, lanes)."""
    e, n = mix.shape
    size = e // heads
    scale = np.float32(size**-0.5)
    for j in range(e):
        for i in range(n):
            keys[at, j, i], values[at, j, i] = qkv[e + j, i], qkv[2 * e + j, i]
    for h in range(heads):
        first = h * size
        top = np.full(n, np.float32(-np.inf))
        for m in range(at + 1):
            row = score[m]
            for i in range(n):
                row[i] = np.float32(0.0)
            for j in range(first, first + size):
                q, key = qkv[j], keys[m, j]
                for i in range(n):
                    row[i] += key[i] * q[i]
            for i in range(n):
                row[i] *= scale
                top[i] = max(top[i], row[i])
        total = np.zeros(n, np.float32)
        for m in range(at + 1):
            row = score[m]
            for i in range(n):
                row[i] -= top[i]
            _exp(row, whole, power)
            for i in range(n):
                total[i] += row[i]
        for j in range(first, first + size):
            to = mix[j]
            for i in range(n):
                to[i] = np.float32(0.0)
            for m in range(at + 1):
                row, value = score[m], values[m, j]
                for i in range(n):
                    to[i] += row[i] * value[i]
            for i in range(n):
                to[i] /= total[i]


@_inline
def _half(ax, ay, bx, by):
    """Angle from a to b in turns of pi."""
    return math.atan2(ax * by - ay * bx, ax * bx + ay * by) / math.pi


@_inline
def _size(x, y):
    return max(math.sqrt(x * x + y * y), _TINY)


@_function
def _gap(h, k, left, right, a, b, out):
    """Features of a gap, as `CurveGaps`; returns how large it looks.

    `a` and `b` hold position from the query and tangent at its ends, where `left` and `right` say that they are known.
    """
    h = max(h, 0.0)
    for m in range(_FEATURES):
        out[m] = 0.0
    out[0], out[1], out[2], out[16] = _log(h * k), 1.0 if left else 0.0, 1.0 if right else 0.0, h * k
    if not (left or right):
        looks = max(_UNSEEN + h * k, 1e-12)
        out[15] = math.log(looks) / 3.0
        return looks
    speed_a, speed_b = _size(a[2], a[3]), _size(b[2], b[3])
    length = h * ((speed_a if left else 0.0) + (speed_b if right else 0.0)) / (2.0 if left and right else 1.0)
    # Of an end that is not known, the tangent of the other one tells.
    ax, ay = (a[0], a[1]) if left else (b[0] - h * b[2], b[1] - h * b[3])
    bx, by = (b[0], b[1]) if right else (a[0] + h * a[2], a[1] + h * a[3])
    mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
    both = left and right
    if both:
        mx += h * (a[2] - b[2]) / 8.0
        my += h * (a[3] - b[3]) / 8.0
    nearest = min(_size(ax, ay), _size(bx, by), _size(mx, my))
    looks = length / max(nearest + _NEAREST * length, _TINY) * (1.0 if both else 2.0)
    looks = max(looks + h * k, 1e-12)
    out[3] = _log(length / nearest)
    out[15] = math.log(looks) / 3.0
    if left:
        far = _size(a[0], a[1])
        out[4] = _log(length / far)
        tx, ty, sx, sy = a[2] / speed_a, a[3] / speed_a, a[0] / far, a[1] / far
        out[6], out[8] = tx * sx + ty * sy, sx * ty - sy * tx
    if right:
        far = _size(b[0], b[1])
        out[5] = _log(length / far)
        tx, ty, sx, sy = b[2] / speed_b, b[3] / speed_b, b[0] / far, b[1] / far
        out[7], out[9] = tx * sx + ty * sy, sx * ty - sy * tx
    if both:
        out[10], out[11] = _half(a[0], a[1], b[0], b[1]), _half(a[2], a[3], b[2], b[3])
        out[12], out[13] = _half(a[0], a[1], mx, my), _half(mx, my, b[0], b[1])
        out[14] = _log(_size(a[0], a[1]) / _size(b[0], b[1]))
    return looks


@_function
def _sample(x, piece, value, tx, ty, out, lane):
    """What a sample tells by itself, as `tokens.tokenize` of one alone, into column `lane`."""
    sine, cosine = math.sin(math.pi * x), math.cos(math.pi * x)
    for m in range(6):
        out[m, lane], out[6 + m, lane] = sine, cosine
        sine, cosine = 2.0 * sine * cosine, cosine * cosine - sine * sine
    told = math.copysign(math.log1p(abs(value)), value)
    out[12, lane] = min(max(told, -_LIMIT), _LIMIT) if told == told else 0.0
    out[13, lane], out[14, lane], out[15, lane], out[16, lane] = 0.5, math.log(1.0 / 32.0), 1.0, 1.0
    out[17, lane], out[18, lane] = math.log(max(x, 1e-4)) / 3.0, math.log(max(1.0 - x, 1e-4)) / 3.0
    for m in range(6):
        out[19 + m, lane] = 1.0 if piece % 6 == m else 0.0
    out[25, lane], out[26, lane], out[27, lane], out[28, lane] = 0.0, 0.0, 2.0, 2.0
    out[29, lane], out[30, lane], out[31, lane] = 0.0, 1.0, 1.0
    speed = _size(tx, ty)
    out[32, lane], out[33, lane] = ty / speed, -tx / speed


@_sums
def _dot(a, b):
    total = np.float32(0.0)
    for j in range(a.shape[0]):
        total += a[j] * b[j]
    return total


@_function
def _pick(p, count, u):
    """Index drawn by inversion from weights, and the part of its interval that u left over."""
    total = 0.0
    for j in range(count):
        total += p[j]
    at, below, index = u * total, 0.0, count - 1
    for j in range(count):
        if below + p[j] > at:
            index = j
            break
        if j < count - 1:
            below += p[j]
    rest = (at - below) / max(float(p[index]), 1e-300)
    return index, min(max(rest, 0.0), _BELOW_ONE), total


@_function
def _choose(live, count, key, extra, looks, left, right, sharpness, floor, query, u, p, whole, power):
    """A live gap by its logit, and the point's place: (index in live, uniform, log probability of the gap)."""
    size = np.float32(query.shape[0] ** -0.5)
    top = np.float32(-np.inf)
    for m in range(count):
        s = live[m]
        base = sharpness * math.log(looks[s]) if sharpness > 0.0 else math.log(max(right[s] - left[s], 1e-300))
        p[m] = np.float32(base) + (_dot(key[s], query) * size + extra[s])
        top = max(top, p[m])
    for m in range(count):
        p[m] -= top
    own = p[:count].copy()
    _exp(p[:count], whole, power)
    m, rest, total = _pick(p, count, u[0])
    anywhere = rest < floor
    if anywhere:
        x = min(u[2], _BELOW_ONE)
        for j in range(count):
            if left[live[j]] <= x < right[live[j]]:
                m = j
                break
    return m, anywhere, own[m] - math.log(total)


@_function
def _place(live, m, left, right, profile, logits, count, anywhere, log_gap, floor, u, p, whole, power):
    """The point in the chosen gap, and its density on [0, 1]."""
    s = live[m]
    top = np.float32(-np.inf)
    for j in range(count):
        p[j] = profile[j] + logits[j]
        top = max(top, p[j])
    for j in range(count):
        p[j] -= top
    own = p[:count].copy()
    _exp(p[:count], whole, power)
    j, _, total = _pick(p, count, u[1])
    x = u[2] if anywhere else left[s] + (j + u[2]) / count * (right[s] - left[s])
    x = min(x, _BELOW_ONE)
    width = max(right[s] - left[s], 1e-300)
    j = min(max(np.int64((x - left[s]) / width * count), 0), count - 1)
    inside = float(log_gap) + float(own[j] - math.log(total)) + math.log(count) - math.log(width)
    return x, (1.0 - floor) * math.exp(inside) + floor


@_kernel
def _place_rows(
    coefficients, pieces, shape, points, numbers, n, heads, bins, sharpness, floor, weights, x, pdf, start, stop
):  # fmt: skip
    (
        in_w, in_b, mid_w, mid_b, norms, qkv_w, qkv_b, out_w, out_b, up_w, up_b, down_w, down_b, last, key_w, key_b,
        make_w, make_b, query_w, query_b, bias_w, bias_b, bin_w, bin_b, see_w, see_b, bins_w, bins_b, profile,
    ) = weights  # fmt: skip
    wide, e, layers = in_w.shape[0], mid_w.shape[0], qkv_w.shape[0]
    walls = pieces.max()
    slots = walls + 2 * n
    single = np.float32
    token, hidden = np.zeros((in_w.shape[1], LANES), single), np.empty((wide, LANES), single)
    state, calm, more = np.empty((e, LANES), single), np.empty((e, LANES), single), np.empty((e, LANES), single)
    qkv, deep = np.empty((3 * e, LANES), single), np.empty((up_w.shape[1], LANES), single)
    keys, values = np.empty((layers, n, e, LANES), single), np.empty((layers, n, e, LANES), single)
    score, told = np.empty((n, LANES), single), np.zeros((key_w.shape[1], LANES), single)
    query, chosen, seen = np.empty((LANES, e), single), np.empty((e, LANES), single), np.empty((e, LANES), single)
    one, logits = np.empty((1, LANES), single), np.empty((bins_w.shape[0], LANES), single)
    key, extra = np.empty((LANES, slots, e), single), np.empty((LANES, slots), single)
    left, right, looks = np.empty((LANES, slots)), np.empty((LANES, slots)), np.empty((LANES, slots))
    features, ends = np.zeros((LANES, slots, _FEATURES)), np.zeros((LANES, slots, 2, 4))
    known = np.empty((LANES, slots, 2), np.bool_)
    live, count, slot = np.empty((LANES, slots), np.int64), np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    anywhere, log_gap, at = np.empty(LANES, np.bool_), np.empty(LANES), np.empty(LANES, np.int64)
    p, whole = np.empty(max(slots, LANES), single), np.empty(max(slots, LANES), np.int32)
    power = whole.view(single)
    for begin in range(start, stop, LANES):
        filled, used = 0, walls
        for lane in range(LANES):
            k = pieces[shape[min(begin + lane, stop - 1)]]
            count[lane] = 0
            for s in range(walls):
                left[lane, s], right[lane, s] = min(s / k, 1.0), min((s + 1) / k, 1.0)
                known[lane, s] = False
                h = right[lane, s] - left[lane, s]
                looks[lane, s] = _gap(h, k, False, False, ends[lane, s, 0], ends[lane, s, 1], features[lane, s])
                if h > 0.0:
                    live[lane, count[lane]] = s
                    count[lane] += 1
        token[:] = 0.0
        for i in range(n):
            token[_COUNTS], token[_COUNTS + 1] = 0.0 if i == 0 else 1.0, i / n
            token[_COUNTS + 2] = math.log(n / 32.0)
            _layer(in_w, in_b, token, hidden)
            _linear(mid_w, mid_b, hidden, state)
            for layer in range(layers):
                _norm(norms[layer, 0], state, calm)
                _linear(qkv_w[layer], qkv_b[layer], calm, qkv)
                _attend(qkv, keys[layer], values[layer], i, heads, more, score, whole, power)
                _linear(out_w[layer], out_b[layer], more, calm)
                _add(state, calm)
                _norm(norms[layer, 1], state, calm)
                _layer(up_w[layer], up_b[layer], calm, deep)
                _linear(down_w[layer], down_b[layer], deep, calm)
                _add(state, calm)
            _norm(last, state, calm)
            for j in range(e):
                for lane in range(LANES):
                    told[_FEATURES + j, lane] = calm[j, lane]
            for s in range(filled, used):
                for lane in range(LANES):
                    for m in range(_FEATURES):
                        told[m, lane] = features[lane, s, m]
                _layer(key_w, key_b, told, more)
                _linear(make_w, make_b, more, chosen)
                _outputs(bias_w, bias_b, chosen, one)
                for lane in range(LANES):
                    extra[lane, s] = one[0, lane]
                    for j in range(e):
                        key[lane, s, j] = chosen[j, lane]
            filled = used
            _linear(query_w, query_b, calm, more)
            for lane in range(LANES):
                u = numbers[min(begin + lane, stop - 1), i]
                for j in range(e):
                    query[lane, j] = more[j, lane]
                at[lane], anywhere[lane], log_gap[lane] = _choose(
                    live[lane], count[lane], key[lane], extra[lane], looks[lane], left[lane], right[lane], sharpness,
                    floor, query[lane], u, p, whole, power,
                )  # fmt: skip
                slot[lane] = live[lane, at[lane]]
                for j in range(e):
                    chosen[j, lane] = key[lane, slot[lane], j]
            _linear(bin_w, bin_b, chosen, seen)
            _linear(see_w, see_b, calm, more)
            _add(seen, more)
            for j in range(e):
                for lane in range(LANES):
                    seen[j, lane] = max(seen[j, lane], single(0.0))
            _linear(bins_w, bins_b, seen, logits)
            for lane in range(LANES):
                b = min(begin + lane, stop - 1)
                s, new = slot[lane], used
                place, density = _place(
                    live[lane], at[lane], left[lane], right[lane], profile, logits[:, lane], bins, anywhere[lane],
                    log_gap[lane], floor, numbers[b, i], p, whole, power,
                )  # fmt: skip
                x[b, i], pdf[b, i] = place, density
                c, k = coefficients[shape[b]], pieces[shape[b]]
                rx, ry, tx, ty, piece = _at(c, k, place)
                rx, ry = rx - points[b, 0], ry - points[b, 1]
                value = (rx * ty - ry * tx) / (2.0 * math.pi * max(rx * rx + ry * ry, _TINY))
                _sample(place, piece, value, tx, ty, token, lane)
                # The new sample is the right end of the left part and the left end of the right one.
                left[lane, new], right[lane, new] = left[lane, s], place
                left[lane, new + 1], right[lane, new + 1] = place, right[lane, s]
                known[lane, new, 0], known[lane, new + 1, 1] = known[lane, s, 0], known[lane, s, 1]
                known[lane, new, 1] = known[lane, new + 1, 0] = True
                ends[lane, new, 0], ends[lane, new + 1, 1] = ends[lane, s, 0], ends[lane, s, 1]
                for side in (ends[lane, new, 1], ends[lane, new + 1, 0]):
                    side[0], side[1], side[2], side[3] = rx, ry, tx, ty
                for m in range(at[lane], count[lane] - 1):
                    live[lane, m] = live[lane, m + 1]
                count[lane] -= 1
                for t in range(new, new + 2):
                    h = right[lane, t] - left[lane, t]
                    looks[lane, t] = _gap(
                        h, k, known[lane, t, 0], known[lane, t, 1], ends[lane, t, 0], ends[lane, t, 1],
                        features[lane, t],
                    )  # fmt: skip
                    for m in range(_FEATURES):
                        token[_OWN + (t - new) * _FEATURES + m, lane] = features[lane, t, m]
                    if h > 0.0:
                        live[lane, count[lane]] = t
                        count[lane] += 1
            used += 2


def placed(
    coefficients: Floats,
    pieces: Ints,
    shape: Ints,
    points: Floats,
    numbers: Floats,
    heads: int,
    bins: int,
    sharpness: float,
    floor: float,
    weights: Weights,
) -> tuple[Floats, Floats]:
    """Points (B, n) and their densities for all queries.

    Parameters
    ----------
    coefficients, pieces, shape, points
        As for `compiled.sampled`.
    numbers : ndarray, (B, n, 3)
        Uniform numbers of every choice.
    heads, bins : int
        Attention heads, and bins of a gap.
    sharpness, floor : float
        Of the gap head.
    weights : Weights
        The network.
    """
    n = numbers.shape[1]
    x, pdf = np.empty((len(points), n)), np.empty((len(points), n))
    fixed = (coefficients, pieces, shape, points, numbers, n, heads, bins, sharpness, floor, weights.arrays, x, pdf)
    over_rows(lambda start, stop: _place_rows(*fixed, start, stop), len(points))
    return x, pdf
