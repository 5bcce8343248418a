"""Where Brownian motion from a point first meets a set of straight panels, compiled: their harmonic measure.

The measure w of a compact set E seen from z0 has the potential of a unit charge at z0, up to a constant: on E the
integral of ln|x - y| dw(y) is ln|x - z0| + c, and c = 0 where E encloses z0. Galerkin's method with one unknown a panel
gives a symmetric positive definite system once E lies in a disc of radius below 1. It asks nothing of E: panels may
cross, loops may be open or turned; the answer is a positive measure of mass one, so averages under it obey the maximum
principle and constants are exact.

References: Ransford, Potential theory in the complex plane, 1995, chapters 4 and 5; Hsiao, Wendland, Boundary integral
equations, 2008.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["harmonic_measure"]

# Of centres farther apart than this many times both lengths two terms suffice. Not 1: equal panels would tie.
_CLEAR = 0.97
_LOST = 1e-3  # a panel with a smaller pivot lies on others

# For logarithms: ln 2, the series of atanh, the bits of sqrt(1/2), and 1.5 * 2^52, whose last bits count whole numbers.
_LN2 = math.log(2.0)
_L3, _L5, _L7, _L9, _L11, _L13, _L15 = 1 / 3, 1 / 5, 1 / 7, 1 / 9, 1 / 11, 1 / 13, 1 / 15
_ROOT_HALF = int(np.float64(math.sqrt(0.5)).view(np.int64))
_MAGIC = 1.5 * 2.0**52
_MAGIC_BITS = int(np.float64(_MAGIC).view(np.int64))

# Gauss-Legendre on [-1/2, 1/2]: four points for neighbours, two for others that are close.
_FOUR = (-0.4305681557970263, -0.16999052179242815, 0.16999052179242815, 0.4305681557970263)
_WEIGHTS = (0.17392742256872692, 0.32607257743127305, 0.32607257743127305, 0.17392742256872692)
_TWO = 0.28867513459481287

_inline = njit(inline="always", error_model="numpy")
# Sums may be taken in any order: they are long enough to fill vector registers.
_sums = njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})


@_inline
def _mean_log(mx, my, ex, ey, square, log, x, y):  # type: ignore[no-untyped-def]
    """Mean of ln|(x, y) - panel|; the panel has centre m, vector e, squared length `square`, `log` of its length."""
    half = 2.0 / square
    u = ((x - mx) * ex + (y - my) * ey) * half
    v = abs((y - my) * ex - (x - mx) * ey) * half
    a, b = (u + 1.0) ** 2 + v * v, (u - 1.0) ** 2 + v * v
    total = log - _LN2 - 1.0 + 0.5 * v * math.atan2(2.0 * v, u * u + v * v - 1.0)
    if a > 0.0:
        total += 0.25 * (u + 1.0) * math.log(a)
    if b > 0.0:
        total -= 0.25 * (u - 1.0) * math.log(b)
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _minus_half_logs(x, fractions):  # type: ignore[no-untyped-def]
    """-ln(x)/2 of positive numbers, in place, to 1e-13: in vector registers, which the library's does not fill.

    x = 2^e m with m in [sqrt(1/2), sqrt(2)), and ln m = 2 atanh(s), s = (m - 1)/(m + 1), |s| < 0.172.
    """
    bits, parts = x.view(np.int64), fractions.view(np.int64)
    for k in range(len(x)):
        exponent = (bits[k] - _ROOT_HALF) >> 52
        parts[k] = bits[k] - (exponent << 52)
        bits[k] = exponent + _MAGIC_BITS
    for k in range(len(x)):
        s = (fractions[k] - 1.0) / (fractions[k] + 1.0)
        q = s * s
        series = 1.0 + q * (_L3 + q * (_L5 + q * (_L7 + q * (_L9 + q * (_L11 + q * (_L13 + q * _L15))))))
        x[k] = -0.5 * _LN2 * (x[k] - _MAGIC) - s * series


@_inline
def _near(mx, my, ex, ey, square, logs, i, j, r):  # type: ignore[no-untyped-def]
    """Mean of ln|x - y| over two panels whose centres are near, their squared distance r.

    In closed form where one continues the other; else exact over the longer one, Gauss-Legendre over the other.
    """
    if square[i] > square[j] * (1.0 + 1e-9):  # of two that are as long it is not rounding that decides
        i, j = j, i
    a, b = math.sqrt(square[i]), math.sqrt(square[j])
    touch = abs(r - 0.25 * (a + b) ** 2) < 1e-6 * r
    if touch and ex[i] * ex[j] + ey[i] * ey[j] > (1.0 - 1e-9) * a * b:
        whole = (a + b) ** 2 * math.log(a + b) - square[i] * logs[i] - square[j] * logs[j]
        return 0.5 * whole / (a * b) - 1.5
    total = 0.0
    if r > 0.36 * (a + b) ** 2:
        for k in range(2):
            s = _TWO - 2.0 * k * _TWO
            total += 0.5 * _mean_log(
                mx[j], my[j], ex[j], ey[j], square[j], logs[j], mx[i] + s * ex[i], my[i] + s * ey[i]
            )
        return total
    for k in range(4):
        x, y = mx[i] + _FOUR[k] * ex[i], my[i] + _FOUR[k] * ey[i]
        total += _WEIGHTS[k] * _mean_log(mx[j], my[j], ex[j], ey[j], square[j], logs[j], x, y)
    return total


@_sums
def _fill(mx, my, ex, ey, square, logs, room, matrix):  # type: ignore[no-untyped-def]
    """Lower half of minus the mean logarithm between panels; `logs` are those of their lengths."""
    m = len(mx)
    length = np.sqrt(square)
    # Squares of the panel vectors as complex numbers, over 24: the second term of the expansion.
    real, imag = (ex * ex - ey * ey) / 24.0, ex * ey / 12.0
    turned, close = np.empty(m), np.empty(m, np.bool_)
    for i in range(m):
        row = matrix[i, : i + 1]
        for j in range(i):
            dx, dy = mx[i] - mx[j], my[i] - my[j]
            r = dx * dx + dy * dy
            a, b = real[i] + real[j], imag[i] + imag[j]
            both = _CLEAR * (length[i] + length[j])
            close[j] = r < both * both
            turned[j] = (a * (dx * dx - dy * dy) + b * 2.0 * dx * dy) / (r * r)
            row[j] = r + 1e-300
        _minus_half_logs(row[:i], room)
        for j in range(i):
            row[j] += turned[j]
        for j in range(i):
            if close[j]:
                dx, dy = mx[i] - mx[j], my[i] - my[j]
                row[j] = -_near(mx, my, ex, ey, square, logs, i, j, dx * dx + dy * dy)
        row[i] = 1.5 - logs[i]


@_inline
def _finish(row, i, total):  # type: ignore[no-untyped-def]
    """The diagonal of row i, whose other entries have squares of this sum; it holds inverses: no division later."""
    pivot = row[i] - total
    if pivot > _LOST:
        row[i] = 1.0 / math.sqrt(pivot)
    else:  # the panel lies on those before it
        row[: i + 1] = 0.0


@_sums
def _factor(matrix):  # type: ignore[no-untyped-def]
    """Cholesky factor in the lower half, in place, two rows at a time."""
    m = len(matrix)
    for i in range(0, m - 1, 2):
        row, next_ = matrix[i], matrix[i + 1]
        square, other_square = 0.0, 0.0
        for j in range(i):
            other, inverse = matrix[j], matrix[j, j]
            one, two = 0.0, 0.0
            for k in range(j):
                one += row[k] * other[k]
                two += next_[k] * other[k]
            one, two = (row[j] - one) * inverse, (next_[j] - two) * inverse
            row[j], next_[j] = one, two
            square += one * one
            other_square += two * two
        _finish(row, i, square)
        total = 0.0
        for k in range(i):
            total += next_[k] * row[k]
        total = (next_[i] - total) * row[i]
        next_[i] = total
        _finish(next_, i + 1, other_square + total * total)
    if m % 2:
        row, square = matrix[m - 1], 0.0
        for j in range(m - 1):
            other, total = matrix[j], 0.0
            for k in range(j):
                total += row[k] * other[k]
            row[j] = (row[j] - total) * other[j]
            square += row[j] * row[j]
        _finish(row, m - 1, square)


@_sums
def _solve(matrix, right, other):  # type: ignore[no-untyped-def]
    """Both triangular solves for two right sides, in place."""
    m = len(right)
    for i in range(m):
        row, one, two = matrix[i], 0.0, 0.0
        for k in range(i):
            one += row[k] * right[k]
            two += row[k] * other[k]
        right[i], other[i] = (right[i] - one) * row[i], (other[i] - two) * row[i]
    for i in range(m - 1, -1, -1):
        row = matrix[i]
        right[i] *= row[i]
        other[i] *= row[i]
        one, two = right[i], other[i]
        for k in range(i):
            right[k] -= one * row[k]
            other[k] -= two * row[k]


@_sums
def harmonic_measure(ends, x, y, scale, matrix, work, out):  # type: ignore[no-untyped-def]
    """Measure of each panel seen from (x, y).

    Parameters
    ----------
    ends : (m, 4) float64
        x, y of both ends of each panel, of positive length.
    x, y : float
        Where the motion starts.
    scale : float
        Brings all panels into the disc of radius 1/2 about (x, y).
    matrix, work : (k, k) and (8, k) float64, k >= m
        Room for the system.
    out : (m,) float64
        The measure: not negative, of sum one.

    Returns
    -------
    lost : float
        Mass that had to be cut off below zero.
    """
    m = len(ends)
    matrix = matrix[:m]
    mx, my, ex, ey, square = work[0, :m], work[1, :m], work[2, :m], work[3, :m], work[4, :m]
    ones, logs, room = work[5, :m], work[6, :m], work[7, :m]
    for j in range(m):
        mx[j] = scale * (0.5 * (ends[j, 0] + ends[j, 2]) - x)
        my[j] = scale * (0.5 * (ends[j, 1] + ends[j, 3]) - y)
        ex[j], ey[j] = scale * (ends[j, 2] - ends[j, 0]), scale * (ends[j, 3] - ends[j, 1])
        square[j] = ex[j] * ex[j] + ey[j] * ey[j]
        logs[j] = 0.5 * math.log(square[j])
    _fill(mx, my, ex, ey, square, logs, room, matrix)
    _factor(matrix)
    for j in range(m):
        out[j], ones[j] = -_mean_log(mx[j], my[j], ex[j], ey[j], square[j], logs[j], 0.0, 0.0), 1.0
    _solve(matrix, out, ones)
    mass, capacity = 0.0, 0.0
    for j in range(m):
        mass += out[j]
        capacity += ones[j]
    missing = (1.0 - mass) / capacity
    lost, total = 0.0, 0.0
    for j in range(m):
        out[j] += missing * ones[j]
        if out[j] < 0.0:
            lost -= out[j]
            out[j] = 0.0
        total += out[j]
    for j in range(m):
        out[j] /= total
    return lost
