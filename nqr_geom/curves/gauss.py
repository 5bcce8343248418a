"""Gauss-Legendre rule for exponentials of distances, and which panels it integrates to rounding.

With n nodes the error on [-1, 1] is about the largest integrand on an ellipse around it, over r^(2 n), r the sum of its
half axes: for exp(-w d) with a distance of w d = c1 s + c2 s^2 at most exp(c1 r / 2 + c2 r^2 / 4 - 2 n ln r), whichever
r is best. Sixteen nodes leave 1e-14 or less where 2 c1 + 4.8 c2 is at most 14.4. Square roots limit r: their
branch points lie at 2.5 half lengths of a panel that is 0.8 of its distance long, where r is 5.2, or beyond.

Library exponentials would be called node by node; `exponentials` is arithmetic on vectors.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["BEND", "BENT", "COUNT", "LONGEST", "NODES", "STRAIGHT", "WEIGHTS", "exponentials"]

COUNT = 16
_nodes, _weights = np.polynomial.legendre.leggauss(COUNT)
NODES, WEIGHTS = 0.5 * (_nodes + 1.0), 0.5 * _weights

STRAIGHT = 14.4  # largest range of an exponent over a panel, 2 c1, where it is linear
BEND = 4.8  # by how much that is less for every unit of c2
BENT = 3.0  # largest range where it may be as bent as it will
LONGEST = 0.64  # squared length of a panel over its squared distance

_LEAST = -700.0  # exponents below it count as it: 1e-304
_INTEGER = 1.5 * 2.0**52  # added to a small number, it leaves the nearest integer in the last bits
_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10  # the first has 21 zero bits at its end


@njit(error_model="numpy")
def exponentials(x, scale, bits):  # type: ignore[no-untyped-def]
    """e^x in place, to two units in the last place, for COUNT numbers up to 700; `bits` is a view of `scale` as int64.

    x = k ln 2 + r with an integer k; e^r is Taylor's polynomial, 2^k is put together bit by bit.
    """
    for j in range(COUNT):
        v = max(x[j], _LEAST)
        z = v * _LOG2_E + _INTEGER
        scale[j] = z
        k = z - _INTEGER
        r = (v - k * _LN2_HIGH) - k * _LN2_LOW
        p = 1.0 / 6227020800.0
        p = p * r + 1.0 / 479001600.0
        p = p * r + 1.0 / 39916800.0
        p = p * r + 1.0 / 3628800.0
        p = p * r + 1.0 / 362880.0
        p = p * r + 1.0 / 40320.0
        p = p * r + 1.0 / 5040.0
        p = p * r + 1.0 / 720.0
        p = p * r + 1.0 / 120.0
        p = p * r + 1.0 / 24.0
        p = p * r + 1.0 / 6.0
        p = p * r + 0.5
        p = p * r + 1.0
        x[j] = p * r + 1.0
    for j in range(COUNT):
        bits[j] = (bits[j] << 52) + (1023 << 52)
    for j in range(COUNT):
        x[j] *= scale[j]
