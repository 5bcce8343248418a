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

_CLEAR = 1.0  # centres farther apart than this many times both lengths: two terms of the expansion suffice
_LOST = 1e-3  # a panel with a smaller pivot lies on others

# Gauss-Legendre on [-1/2, 1/2]: four points for neighbours, two for others that are close.
_FOUR = (-0.4305681557970263, -0.16999052179242815, 0.16999052179242815, 0.4305681557970263)
_WEIGHTS = (0.17392742256872692, 0.32607257743127305, 0.32607257743127305, 0.17392742256872692)
_TWO = 0.28867513459481287

_inline = njit(inline="always", error_model="numpy")
# Sums may be taken in any order: they are long enough to fill vector registers.
_sums = njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})


@_inline
def _mean_log(mx, my, ex, ey, square, x, y):  # type: ignore[no-untyped-def]
    """Mean of ln|(x, y) - panel|; the panel has centre m, vector e and squared length `square`."""
    half = 2.0 / square
    u = ((x - mx) * ex + (y - my) * ey) * half
    v = abs((y - my) * ex - (x - mx) * ey) * half
    a, b = (u + 1.0) ** 2 + v * v, (u - 1.0) ** 2 + v * v
    total = 0.5 * math.log(0.25 * square) - 1.0 + 0.5 * v * math.atan2(2.0 * v, u * u + v * v - 1.0)
    if a > 0.0:
        total += 0.25 * (u + 1.0) * math.log(a)
    if b > 0.0:
        total -= 0.25 * (u - 1.0) * math.log(b)
    return total


@_inline
def _near(mx, my, ex, ey, square, i, j, r):  # type: ignore[no-untyped-def]
    """Mean of ln|x - y| over two panels whose centres are near, their squared distance r.

    In closed form where one continues the other; else exact over the longer one, Gauss-Legendre over the other.
    """
    if square[i] > square[j]:
        i, j = j, i
    a, b = math.sqrt(square[i]), math.sqrt(square[j])
    touch = abs(r - 0.25 * (a + b) ** 2) < 1e-6 * r
    if touch and ex[i] * ex[j] + ey[i] * ey[j] > (1.0 - 1e-9) * a * b:
        whole = (a + b) ** 2 * math.log(a + b) - square[i] * math.log(a) - square[j] * math.log(b)
        return 0.5 * whole / (a * b) - 1.5
    total = 0.0
    if r > 0.36 * (a + b) ** 2:
        for k in range(2):
            s = _TWO - 2.0 * k * _TWO
            total += 0.5 * _mean_log(mx[j], my[j], ex[j], ey[j], square[j], mx[i] + s * ex[i], my[i] + s * ey[i])
        return total
    for k in range(4):
        x, y = mx[i] + _FOUR[k] * ex[i], my[i] + _FOUR[k] * ey[i]
        total += _WEIGHTS[k] * _mean_log(mx[j], my[j], ex[j], ey[j], square[j], x, y)
    return total


@_sums
def _fill(mx, my, ex, ey, square, matrix):  # type: ignore[no-untyped-def]
    """Lower half of minus the mean logarithm between panels."""
    m = len(mx)
    length = np.sqrt(square)
    # Squares of the panel vectors as complex numbers, over 24: the second term of the expansion.
    real, imag = (ex * ex - ey * ey) / 24.0, ex * ey / 12.0
    for i in range(m):
        row = matrix[i]
        for j in range(i):
            dx, dy = mx[i] - mx[j], my[i] - my[j]
            r = dx * dx + dy * dy
            a, b = real[i] + real[j], imag[i] + imag[j]
            turned = (a * (dx * dx - dy * dy) + b * 2.0 * dx * dy) / (r * r)
            row[j] = turned - 0.5 * math.log(r)
        for j in range(i):
            dx, dy = mx[i] - mx[j], my[i] - my[j]
            r = dx * dx + dy * dy
            if r < (_CLEAR * (length[i] + length[j])) ** 2:
                row[j] = -_near(mx, my, ex, ey, square, i, j, r)
        row[i] = 1.5 - math.log(length[i])


@_sums
def _factor(matrix):  # type: ignore[no-untyped-def]
    """Cholesky factor in the lower half, in place; a panel that lies on those before it gets a row of zeros."""
    m = len(matrix)
    for i in range(m):
        row = matrix[i]
        for j in range(i):
            other = matrix[j]
            total = 0.0
            for k in range(j):
                total += row[k] * other[k]
            row[j] = (row[j] - total) * other[j]
        total = 0.0
        for k in range(i):
            total += row[k] * row[k]
        pivot = row[i] - total
        if pivot > _LOST:
            row[i] = 1.0 / math.sqrt(pivot)  # the diagonal holds inverses: no division later
        else:
            row[: i + 1] = 0.0


@_sums
def _solve(matrix, right):  # type: ignore[no-untyped-def]
    """Both triangular solves, in place."""
    m = len(right)
    for i in range(m):
        row, total = matrix[i], 0.0
        for k in range(i):
            total += row[k] * right[k]
        right[i] = (right[i] - total) * row[i]
    for i in range(m - 1, -1, -1):
        row = matrix[i]
        right[i] *= row[i]
        value = right[i]
        for k in range(i):
            right[k] -= value * row[k]


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
    matrix, work : (k, k) and (6, k) float64, k >= m
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
    mx, my, ex, ey, square, ones = (work[0, :m], work[1, :m], work[2, :m], work[3, :m], work[4, :m], work[5, :m])
    for j in range(m):
        mx[j] = scale * (0.5 * (ends[j, 0] + ends[j, 2]) - x)
        my[j] = scale * (0.5 * (ends[j, 1] + ends[j, 3]) - y)
        ex[j], ey[j] = scale * (ends[j, 2] - ends[j, 0]), scale * (ends[j, 3] - ends[j, 1])
        square[j] = ex[j] * ex[j] + ey[j] * ey[j]
    _fill(mx, my, ex, ey, square, matrix)
    _factor(matrix)
    for j in range(m):
        out[j], ones[j] = -_mean_log(mx[j], my[j], ex[j], ey[j], square[j], 0.0, 0.0), 1.0
    _solve(matrix, out)
    _solve(matrix, ones)
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
