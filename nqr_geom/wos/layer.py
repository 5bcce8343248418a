"""The double layer potential of straight panels, compiled: exact next to a panel, Gauss-Legendre away from it.

A panel is tau(s) = centre + half s, s in [-1, 1], with a polynomial density; it contributes
Im(integral of density/(s - w) ds) / 2 pi at z, with w = (z - centre)/half. The integrals of s^k/(s - w) follow from one
logarithm by recursion, which loses |w|^p in the last place: so only up to |w| = `NEAR`, and the quadrature beyond.

References: Helsing, Ojala, On the evaluation of layer potentials close to their sources, 2008.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["assemble", "evaluate", "wedge"]

NEAR = 2.5  # in half lengths of a panel
CLEAR = 3.5  # in lengths of a corner's panels: farther away its compressed density serves

_TURN = 1.0 / (2.0 * np.pi)


@njit(cache=True, nogil=True, inline="always")
def _turned(a, b):  # type: ignore[no-untyped-def]
    """Imaginary part of a/b, without the care that a complex division takes."""
    return (a.imag * b.real - a.real * b.imag) / (b.real * b.real + b.imag * b.imag)


@njit(cache=True, nogil=True)
def _moments(w, q):  # type: ignore[no-untyped-def]
    """Integrals of s^k/(s - w) over [-1, 1]; a w on the panel itself is seen from its left."""
    x, y = w.real, w.imag
    log = 0.5 * np.log(((1.0 - x) ** 2 + y * y) / ((1.0 + x) ** 2 + y * y)) if y != 0.0 or abs(x) != 1.0 else 0.0
    q[0] = complex(log, np.arctan2(2.0 * y, x * x + y * y - 1.0))
    for k in range(len(q) - 1):
        q[k + 1] = w * q[k] + (0.0 if k % 2 else 2.0 / (k + 1))


@njit(cache=True, nogil=True)
def wedge(angle, edges, nodes, weights, inverse):  # type: ignore[no-untyped-def]
    """Potential on one side of a corner from densities on the other, (m p, m p), panels between `edges` (m + 1,)."""
    p, m = len(nodes), len(edges) - 1
    result = np.empty((m * p, m * p))
    q = np.empty(p, dtype=np.complex128)
    turn = complex(np.cos(angle), np.sin(angle))
    for i in range(m * p):
        a, b = edges[i // p], edges[i // p + 1]
        z = (0.5 * (a + b) + 0.5 * (b - a) * nodes[i % p]) * turn
        for k in range(m):
            w = (z - 0.5 * (edges[k] + edges[k + 1])) / (0.5 * (edges[k + 1] - edges[k]))
            if abs(w) < NEAR:
                _moments(w, q)
                for j in range(p):
                    total = 0.0
                    for n in range(p):
                        total += inverse[n, j] * q[n].imag
                    result[i, k * p + j] = total * _TURN
            else:
                for j in range(p):
                    result[i, k * p + j] = (weights[j] / (nodes[j] - w)).imag * _TURN
    return result


@njit(cache=True, nogil=True)
def assemble(z, source, edge, corner, middle, half, weights, inverse, low, high, out):  # type: ignore[no-untyped-def]
    """Rows low..high of the potential at all nodes from all nodes, without what a corner does to itself.

    `source` is tau' ds at each node; nodes of mid panels come last, p a panel, with `middle` and `half` of each panel.
    """
    p, n = len(weights), len(z)
    first = n - p * len(middle)
    q = np.empty(p, dtype=np.complex128)
    for i in range(low, high):
        row = out[i]
        for j in range(first):
            if edge[i] == edge[j] or corner[i] == corner[j]:
                row[j] = 0.0
            else:
                row[j] = _turned(source[j], z[j] - z[i]) * _TURN
        for k in range(len(middle)):
            at = first + k * p
            if edge[i] == edge[at]:
                row[at : at + p] = 0.0
                continue
            w = (z[i] - middle[k]) / half[k]
            if abs(w) < NEAR:
                _moments(w, q)
                for j in range(p):
                    total = 0.0
                    for m in range(p):
                        total += inverse[m, j] * q[m].imag
                    row[at + j] = total * _TURN
            else:
                for j in range(at, at + p):
                    row[j] = _turned(source[j], z[j] - z[i]) * _TURN


@njit(cache=True, nogil=True)
def _panel(w, coefficient, q):  # type: ignore[no-untyped-def]
    _moments(w, q)
    total = 0.0
    for k in range(len(q)):
        total += coefficient[k] * q[k].imag
    return total


@njit(cache=True, nogil=True)
def evaluate(  # type: ignore[no-untyped-def]
    points, own, corners, apex, side, reach, z, strength, first, radii, density, powers,
    middle, half, mid_edge, mid_powers, pole, charge, nodes, weights, out,
):  # fmt: skip
    """Potential at points (m,); `own` is the edge a point lies on, whose other panels see it edge-on, or -1.

    Parameters
    ----------
    corners : (c, 2) int64
        Edges that leave and reach each corner.
    apex, side, reach : (c,), (c, 2) and (c,)
        Corner, unit vectors along the leaving and the reaching edge away from it, and length of its panels.
    z, strength : (k,) complex
        Nodes and compressed density times tau' ds: first the corners', 4 p each, then the mid panels'.
    first, radii : (c + 1,) and (f + c,)
        Where the ends of a corner's fine panels begin in `radii`.
    density, powers : (f, 2, p)
        Density on the fine panels, at the nodes and as powers of s.
    middle, half, mid_edge, mid_powers : (k,), (k,), (k,), (k, p)
        Mid panels.
    pole, charge : (h,)
        Logarithms inside the holes.
    """
    p, count = len(nodes), len(apex)
    q = np.empty(p, dtype=np.complex128)
    for i in range(len(points)):
        x, total = points[i], 0.0
        for c in range(count):
            relative = x - apex[c]
            if abs(relative) > CLEAR * reach[c]:
                for j in range(4 * p * c, 4 * p * (c + 1)):
                    total += _turned(strength[j], z[j] - x)
                continue
            for b in range(2):
                if corners[c, b] == own[i]:
                    continue
                sign = 1.0 - 2.0 * b  # the reaching edge runs towards the corner
                local = relative * side[c, b].conjugate()
                for k in range(first[c], first[c + 1]):
                    near, far = radii[k + c], radii[k + c + 1]
                    size = 0.5 * (far - near)
                    w = (local - 0.5 * (near + far)) / size
                    if abs(w) < NEAR:
                        # Seen from its left, the reaching edge runs the other way: mirror it.
                        mirrored = w if b == 0 else w.conjugate()
                        total += _panel(mirrored, powers[k, b], q)
                    else:
                        for j in range(p):
                            total += sign * (density[k, b, j] * weights[j] / (nodes[j] - w)).imag
        for k in range(len(middle)):
            if mid_edge[k] == own[i]:
                continue
            w = (x - middle[k]) / half[k]
            if abs(w) < NEAR:
                total += _panel(w, mid_powers[k], q)
            else:
                for j in range(4 * p * count + k * p, 4 * p * count + (k + 1) * p):
                    total += _turned(strength[j], z[j] - x)
        total *= _TURN
        for h in range(len(pole)):
            total += charge[h] * np.log(abs(x - pole[h]))
        out[i] = total
