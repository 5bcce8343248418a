"""Harmonic measures of the vertices of a polygon: what each vertex value counts at a point.

With values linear along the edges a harmonic function is u(x) = sum_k h_k(x) u_k. The functions h_k belong to the
polygon alone, so one factorisation answers for all boundary values there are: what training on random values needs.
They are fitted at the edge by polynomials and by poles that cluster outside every corner; by the maximum principle
the largest misfit on the edge bounds the error inside.

References: Gopal, Trefethen, Solving Laplace problems with corner singularities via rational functions, 2019.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

__all__ = ["vertex_measures"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_POLES = 10  # a corner
_DEGREE = 20
_RATE = 4.0  # poles thin out like exp(-rate (sqrt(poles) - sqrt(j)))
_DENSITY = 3  # places on either half of an edge for each pole


def vertex_measures(vertices: ArrayLike, points: ArrayLike) -> tuple[Floats, float]:
    """What each vertex value counts at points of a small polygon, to some five digits.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Of a simple polygon, counter-clockwise, no angle of 0 or 360 degrees. Cost grows like n^3.
    points : (m, 2) array_like
        Inside.

    Returns
    -------
    measures : (m, n) float64 ndarray
        Rows sum to 1 up to the error; times the values at the vertices it is the harmonic function.
    residual : float
        Largest misfit seen on the edge: an upper bound of the error, far above it away from the corners.

    Examples
    --------
    >>> measures, _ = vertex_measures([[0, 0], [1, 0], [1, 1], [0, 1]], [[0.5, 0.5], [0.25, 0.5]])
    >>> measures.round(4) + 0.0
    array([[0.25 , 0.25 , 0.25 , 0.25 ],
           [0.375, 0.125, 0.125, 0.375]])
    """
    corners = check.array("vertices", vertices, ("n", 2))
    inside = check.array("points", points, ("m", 2))
    centre = corners.mean(axis=0)
    scale = float(np.abs(corners - centre).max())
    z, x = (_complex((a - centre) / scale) for a in (corners, inside))
    edge, t = _places(len(z))
    ahead = np.roll(z, -1) - z
    poles, reach = _poles(z, ahead)
    given = np.zeros((len(edge), len(z)))
    row = np.arange(len(edge))
    given[row, edge] = 1.0 - t
    given[row, (edge + 1) % len(z)] = t
    matrix = _basis(z[edge] + ahead[edge] * t, poles, reach)
    found = np.linalg.lstsq(matrix, given, rcond=1e-13)[0]
    return _basis(x, poles, reach) @ found, float(np.abs(matrix @ found - given).max())


def _complex(a: Floats) -> Complexes:
    return np.asarray(a[:, 0] + 1j * a[:, 1])


def _clustered(count: int, per: int) -> Floats:
    """Distances in (0, 1] that thin out exponentially towards 0."""
    j = np.arange(1, per * count + 1) / per
    return np.asarray(np.exp(_RATE * (np.sqrt(j) - np.sqrt(count))))


def _places(n: int) -> tuple[NDArray[np.int64], Floats]:
    """Where the edge is looked at: edges and parameters, close together towards the corners."""
    half = 0.5 * _clustered(_POLES, _DENSITY)
    t = np.concatenate([half, 1.0 - half[-2::-1]])
    return np.repeat(np.arange(n), len(t)), np.tile(t, n)


def _poles(z: Complexes, ahead: Complexes) -> tuple[Complexes, Floats]:
    """Poles on the outer bisector of every corner, and their distances from it."""
    back = -np.roll(ahead, 1)
    outward = -ahead / np.abs(ahead) * np.exp(0.5j * (np.angle(back / ahead) % (2.0 * np.pi)))
    reach = np.minimum(np.abs(ahead), np.abs(back))[:, None] * _clustered(_POLES, 1)
    return (z[:, None] + outward[:, None] * reach).ravel(), reach.ravel()


def _basis(x: Complexes, poles: Complexes, reach: Floats) -> Floats:
    """Real and imaginary parts of poles and powers at points, (m, columns)."""
    fractions = reach / (x[:, None] - poles)
    powers = np.vander(x, _DEGREE + 1, increasing=True)
    return np.concatenate([fractions.real, fractions.imag, powers.real, powers[:, 1:].imag], axis=1)
