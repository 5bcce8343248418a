"""Laws of smooth pieces and the rule built on them, one integrand at a time: `law` and `structured`, compiled.

The same formulas and the same answers to rounding; those two stay the reference. Samples come in rising order, so that
the samples of a piece are neighbours.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["hermite", "propagated", "trapezoid"]

# A division by zero gives infinity, as everywhere else, and does not raise.
_inline = njit(inline="always", error_model="numpy")
_function = njit(error_model="numpy")

_TRUST = 1e-9
_NODES = 8
_LAST = 4  # index of the last piece
_NEAR = 0.25  # below it c3 is a series


@_inline
def propagated(alpha, t, value, slope, curvature):
    """f and f' at distance t from a point where f, f' and f'' are known."""
    if alpha == 0.0:
        return value + t * (slope + 0.5 * t * curvature), slope + t * curvature
    omega = math.sqrt(alpha)
    half = 0.5 * omega * t
    sine, cosine = math.sin(half), math.cos(half)
    reached = 2.0 / omega * sine
    rise = reached * cosine
    there = value + (slope * rise + 0.5 * curvature * reached * reached)
    return there, slope * (cosine * cosine - sine * sine) + curvature * rise


@_inline
def _third(z, c1):
    """c3 from z and c1: seven terms of its series where the closed form cancels."""
    if z >= _NEAR:
        return (1.0 - c1) / z
    total = 1.0 - z * (1.0 / 210.0)
    total = 1.0 - z * (1.0 / 156.0) * total
    total = 1.0 - z * (1.0 / 110.0) * total
    total = 1.0 - z * (1.0 / 72.0) * total
    total = 1.0 - z * (1.0 / 42.0) * total
    total = 1.0 - z * (1.0 / 20.0) * total
    return total / 6.0


@_function
def trapezoid(x, f):
    """The trapezoidal rule, extended as a constant to both ends of [0, 1]."""
    n = len(x)
    total = 0.0
    for i in range(n):
        low = x[i - 1] if i > 0 else -x[0]
        high = x[i + 1] if i < n - 1 else 2.0 - x[n - 1]
        total += 0.5 * n * (high - low) * f[i]
    return total / n


@_function
def _strays(x, f, d, bend, alpha, first, last):
    """Whether one of the samples first + 1 .. last - 1 does not follow from its left neighbour."""
    for i in range(first, last - 1):
        h = x[i + 1] - x[i]
        guess, guess_slope = propagated(alpha, h, f[i], d[i], bend[i])
        slopes = abs(d[i]) + abs(d[i + 1])
        rounding = 1e-14 * (abs(f[i]) + abs(f[i + 1]))
        if abs(guess - f[i + 1]) > _TRUST * (abs(f[i + 1] - f[i]) + h * slopes) + rounding:
            return True
        if (abs(guess_slope - d[i + 1]) - 1e3 * _TRUST * slopes) * max(h, 1e-300) > rounding:
            return True
    return False


@_function
def _root(ratio):
    """theta in (0, 2 pi) with theta cot(theta / 2) = ratio < 2."""
    low, high = 0.0, 2.0 * math.pi
    for _ in range(50):
        middle = 0.5 * (low + high)
        if middle / math.tan(0.5 * middle) > ratio:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@_function
def _polished(omega, x, f, d, first, last):
    """omega brought to fit all steps between the samples first .. last - 1, by Gauss and Newton."""
    for _ in range(4):
        along, square = 0.0, 0.0
        for i in range(first, last - 1):
            h, rise, both = x[i + 1] - x[i], f[i + 1] - f[i], d[i + 1] + d[i]
            theta = omega * h
            sine, cosine = math.sin(0.5 * theta), math.cos(0.5 * theta)
            off = rise * theta * cosine - h * both * sine
            by = h * (rise * (cosine - 0.5 * theta * sine) - 0.5 * h * both * cosine)
            along += off * by
            square += by * by
        omega -= along / (square if square > 0.0 else 1.0)
    return omega


@_function
def _by_pair(x, f, d, bend, first, last, highest):
    """`law.fit_pairs` for one piece whose samples first .. last - 1 `fit` does not explain: alpha, and whether known.

    Writes f'' of the samples where the law is known.
    """
    many = last - first > 2
    pair, largest = -1, -1.0
    for i in range(first, last - 1):
        h, rise = x[i + 1] - x[i], f[i + 1] - f[i]
        if h > 0.0 and h * highest < 2.0 * math.pi and rise != 0.0 and abs(h * rise) > largest:
            pair, largest = i, abs(h * rise)
    kept = bend[first:last].copy()
    if many:
        # A parabola may be told badly by squares.
        even = (d[last - 1] - d[first]) / max(x[last - 1] - x[first], 1e-300)
        bend[first:last] = even
        if not _strays(x, f, d, bend, 0.0, first, last):
            return 0.0, True
        bend[first:last] = kept
    if pair < 0:
        return 0.0, False
    h = x[pair + 1] - x[pair]
    ratio = h * (d[pair + 1] + d[pair]) / (f[pair + 1] - f[pair])
    if not ratio < 2.0:
        return 0.0, False
    omega = _root(ratio) / h
    if omega > highest:
        return 0.0, False
    if many:
        omega = _polished(omega, x, f, d, first, last)
    omega = min(max(omega, 0.0), highest)
    alpha, half = omega * omega, 0.5 * omega * h
    turned = half / math.tan(half) if half > 0.0 else 1.0
    middle = (d[pair + 1] - d[pair]) / h * turned
    for i in range(first, last):
        bend[i] = middle + alpha * (0.5 * (f[pair] + f[pair + 1]) - f[i])
    if many and _strays(x, f, d, bend, alpha, first, last):
        bend[first:last] = kept
        return 0.0, False
    return alpha, True


@_function
def _by_squares(x, f, d, bend, first, last, unit):
    """`law.fit` for one piece with the samples first .. last - 1: alpha, whether known, whether foreign to every law.

    Writes f'' of the samples.
    """
    count, scale = last - first, 1.0 / unit
    mean = 0.0
    for i in range(first, last):
        mean += f[i]
    mean /= count
    f_f, f_square, fourth, energy = 0.0, 0.0, 0.0, 0.0
    for i in range(first, last):
        value, slope = (f[i] - mean) * scale, d[i] * scale
        square = value * value
        f_f += square
        f_square += square * value
        fourth += square * square
        energy += slope * slope
    energy /= count
    tilt = f_square / f_f if f_f > 0.0 else 0.0
    q_q, q_energy, f_energy = 0.0, 0.0, 0.0
    for i in range(first, last):
        value, slope = (f[i] - mean) * scale, d[i] * scale
        q = value * value - f_f / count - tilt * value
        off = slope * slope - energy
        q_q += q * q
        q_energy += q * off
        f_energy += value * off
    alpha = 0.0
    if count > 2 and q_q > 1e-24 * fourth:
        alpha = max(-q_energy / q_q, 0.0)
    gamma = (f_energy + alpha * f_square) / (2.0 * f_f if f_f > 0.0 else 1.0)
    for i in range(first, last):
        bend[i] = unit * gamma - alpha * (f[i] - mean)
    wrong = _strays(x, f, d, bend, alpha, first, last)
    return alpha, not wrong and count > 1, wrong and count > 2


@_function
def _laws(x, f, d, piece, highest, alpha, bend, known, foreign):
    """alpha, f'', known and foreign of samples 1 .. len - 2; the ends of [0, 1] are not samples."""
    last = len(x) - 1
    unit, first = 0.0, 1
    for i in range(1, last):
        if i == last - 1 or piece[i + 1] != piece[i]:
            mean = 0.0
            for j in range(first, i + 1):
                mean += f[j]
            mean /= i + 1 - first
            for j in range(first, i + 1):
                unit = max(unit, abs(f[j] - mean))
            first = i + 1
    unit = unit if unit > 1e-300 else 1.0  # whose inverse is a number, too
    first = 1
    for i in range(1, last):
        if i == last - 1 or piece[i + 1] != piece[i]:
            law, sure, strange = _by_squares(x, f, d, bend, first, i + 1, unit)
            if not sure and i > first:
                found, sure = _by_pair(x, f, d, bend, first, i + 1, highest)
                if sure:
                    law, strange = found, False
            for j in range(first, i + 1):
                alpha[j], known[j], foreign[j] = law, sure, strange
            first = i + 1


@_inline
def _faded(level, t, value, slope, reach):
    """Continuation of a sample of unknown law by t: its tangent near it, the level farther away."""
    return level + (value - level + slope * t) * math.exp(-0.5 * (t / reach) * (t / reach))


@_function
def _end(at, i, end, same, level, reach, x, f, d, alpha, bend, known, foreign):
    """Continue sample i to the end `at` of [0, 1], entry `end` of the tables."""
    t = at - x[i]
    x[end], d[end], alpha[end], bend[end], known[end], foreign[end] = at, 0.0, 0.0, 0.0, False, False
    if same and known[i]:
        f[end], d[end] = propagated(alpha[i], t, f[i], d[i], bend[i])
        alpha[end], bend[end], known[end] = alpha[i], bend[i] - alpha[i] * (f[end] - f[i]), True
    elif same:
        f[end] = _faded(level, t, f[i], d[i], reach)
    else:
        f[end] = level


@_inline
def _continued(i, step, level, reach, low, high, f, d, alpha, bend, known, side):
    """The integrand at distances step / 2, 3 step / 2 .. from sample i, by its law or by fading: fills `side`."""
    if not known[i]:
        for k in range(_NODES):
            side[k] = _faded(level, (k + 0.5) * step, f[i], d[i], reach)
    elif alpha[i] == 0.0:
        for k in range(_NODES):
            t = (k + 0.5) * step
            side[k] = min(max(f[i] + t * (d[i] + 0.5 * t * bend[i]), low), high)
    else:
        omega = math.sqrt(alpha[i])
        # Sine and cosine of half of what the wave has turned, from node to node.
        sine, cosine = math.sin(0.25 * omega * step), math.cos(0.25 * omega * step)
        turn, keep = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
        for k in range(_NODES):
            reached = 2.0 / omega * sine
            side[k] = min(max(f[i] + reached * (d[i] * cosine + 0.5 * reached * bend[i]), low), high)
            sine, cosine = sine * keep + cosine * turn, cosine * keep - sine * turn


@_inline
def _broken(g, breaks, level, reach, jump, shortest, low, high, x, f, d, alpha, bend, known, room):
    """Posterior mean of the integral from sample g to g + 1 with hidden breaks, or without any but of unknown law."""
    h = x[g + 1] - x[g]
    left, right, chance = room[0], room[1], room[2]
    _continued(g, h / _NODES, level, reach, low, high, f, d, alpha, bend, known, left)
    _continued(g + 1, -h / _NODES, level, reach, low, high, f, d, alpha, bend, known, right)  # from the right
    share = 0.0
    if breaks == 1:
        likeliest, whole = -np.inf, 0.0
        for k in range(_NODES):
            off = min(max((right[_NODES - 1 - k] - left[k]) / jump, -1e100), 1e100)
            chance[k] = -0.5 * off * off
            likeliest = max(likeliest, chance[k])
        for k in range(_NODES):
            chance[k] = math.exp(chance[k] - likeliest)
            whole += chance[k]
        share = 1.0 / whole
    stretch = 1.0 / min(max(1.0 - shortest * ((breaks - 1) / max(h, 1e-300)), 0.05), 1.0)
    total, before = 0.0, 0.0
    for k in range(_NODES):
        u = (k + 0.5) / _NODES
        if breaks > 1:  # order statistics of breaks that leave room for the pieces between them
            stays = max(1.0 - stretch * u, 0.0) ** breaks
            came = max(1.0 - stretch * (1.0 - u), 0.0) ** breaks
        elif breaks == 1:
            here = chance[k] * share
            before += here
            stays = 1.0 - (before - 0.5 * here)
            came = 1.0 - stays
        else:
            stays, came = 1.0 - u, u
        total += stays * left[k] + came * right[_NODES - 1 - k] + (1.0 - stays - came) * level
    return h * (total / _NODES)


@_function
def hermite(x, f, d, piece, alpha, bend, known, foreign, room, reach, jump, shortest, highest):
    """`ToyHermite` of one integrand.

    Parameters
    ----------
    x, f, d, piece : ndarray, (N + 2,)
        Samples in rising order with f, f' and piece at 1 .. N; the ends of [0, 1] are written here.
    alpha, bend, known, foreign, room : ndarray, (N + 2,) and (3, 8)
        Written here.
    reach, jump, shortest, highest : float
        Of the rule and of the family that it knows.
    """
    n = len(x) - 2
    level = trapezoid(x[1:-1], f[1:-1])
    _laws(x, f, d, piece, highest, alpha, bend, known, foreign)
    piece[0], piece[n + 1] = 0, _LAST
    _end(0.0, 1, 0, piece[1] == 0, level, reach, x, f, d, alpha, bend, known, foreign)
    _end(1.0, n, n + 1, piece[n] == _LAST, level, reach, x, f, d, alpha, bend, known, foreign)
    lowest, highest_value = f.min(), f.max()
    low, high = 2.0 * lowest - highest_value, 2.0 * highest_value - lowest
    total = 0.0
    for g in range(n + 1):
        h, breaks = x[g + 1] - x[g], piece[g + 1] - piece[g]
        straight = 0.5 * h * (f[g + 1] + f[g])
        if breaks == 0 and known[g] and known[g + 1]:
            # The mean of what follows from the left and from the right.
            c2, c3 = 0.5, 1.0 / 6.0
            if alpha[g] > 0.0:
                z = alpha[g] * h * h
                half = 0.5 * math.sqrt(z)
                sinc = math.sin(half) / half if half > 0.0 else 1.0
                c2, c3 = 0.5 * sinc * sinc, _third(z, sinc * math.cos(half))
            total += straight + 0.5 * h * h * (c2 * (d[g] - d[g + 1]) + h * c3 * (bend[g + 1] + bend[g]))
        elif breaks == 0 and foreign[g] and foreign[g + 1]:
            total += straight + 0.5 * h * h * (d[g] - d[g + 1]) / 6.0
        else:
            total += _broken(g, breaks, level, reach, jump, shortest, low, high, x, f, d, alpha, bend, known, room)
    return total
