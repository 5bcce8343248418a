"""A corner of a polygon solved alone: from its own data, and as the answer to a field from elsewhere.

In a wedge the double layer of one side acts on the other by a matrix that depends on the angle alone, the same both
ways; so the even and the odd part of the density are solved apart. The mesh is graded down to where the strongest
power that the density may have is below the tolerance.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nqr_geom.wos.domain import Boundary

__all__ = ["Corner", "Rule", "corner_alone", "nodes_for", "rule_of"]

Floats = NDArray[np.float64]


class Rule(NamedTuple):
    """Gauss-Legendre on [-1, 1] and the matrix from values at its nodes to powers of s."""

    nodes: Floats
    weights: Floats
    inverse: Floats


class Corner(NamedTuple):
    """A corner solved alone, both sides (leaving, reaching) from the apex outwards.

    Attributes
    ----------
    radii : (m + 1,) ends of the fine panels.
    own : (2, m p) density that the data near the corner asks for.
    answer : (2, m p, 2, 2 p) density per field at the coarse nodes of both sides.
    moments : (2 p, m p) from fine to compressed densities.
    """

    radii: Floats
    own: Floats
    answer: Floats
    moments: Floats


def nodes_for(tol: float) -> int:
    """Nodes a panel for a relative accuracy."""
    return 12 if tol < 3e-7 else 8


@lru_cache(maxsize=8)
def rule_of(p: int) -> Rule:
    """The rule of p nodes, made once."""
    nodes, weights = np.polynomial.legendre.leggauss(p)
    return Rule(
        np.asarray(nodes, dtype=np.float64),
        np.asarray(weights, dtype=np.float64),
        np.asarray(np.linalg.inv(np.vander(nodes, increasing=True)), dtype=np.float64),
    )


def corner_alone(
    boundary: Boundary, leaving: int, arriving: int, angle: float, reach: float, tol: float, level: float
) -> Corner:
    """Solve the corner between two edges.

    Parameters
    ----------
    boundary : Boundary
        Values on the edge, of which `level` is taken off.
    leaving, arriving : int
        Edges that start and end at the corner.
    angle : float
        Between them, on the inside, in (0, 2 pi).
    reach : float
        Length of the coarse panels, two on each side.
    tol : float
        Relative accuracy.
    """
    from nqr_geom.wos.layer import wedge

    p = nodes_for(tol)
    rule = rule_of(p)
    unit = _graded_radii(angle, tol)
    coarse, moments = _between(tuple(unit), p)
    potential = wedge(angle, unit, rule.nodes, rule.weights, rule.inverse)
    radii = reach * unit
    r = (0.5 * (radii[:-1] + radii[1:])[:, None] + 0.5 * np.diff(radii)[:, None] * rule.nodes).ravel()
    out, back = np.full(len(r), leaving), np.full(len(r), arriving)
    lengths = boundary.domain.lengths
    data = np.stack([
        boundary.at(out, r / lengths[leaving]),
        boundary.at(back, 1.0 - r / lengths[arriving]),
    ]) - level  # fmt: skip
    identity = 0.5 * np.eye(len(r))
    even = np.linalg.solve(identity + potential, np.column_stack([coarse, data[0] + data[1]]))
    odd = np.linalg.solve(identity - potential, np.column_stack([coarse, data[0] - data[1]]))
    own = 0.5 * np.stack([even[:, -1] + odd[:, -1], even[:, -1] - odd[:, -1]])
    same, cross = 0.5 * (even + odd)[:, :-1], 0.5 * (even - odd)[:, :-1]
    answer = np.stack([np.stack([same, cross], axis=1), np.stack([cross, same], axis=1)])
    return Corner(radii, own, answer, moments)


def _graded_radii(angle: float, tol: float) -> Floats:
    """Ends of fine panels in units of a corner's coarse panels: halved until the strongest power is below tol."""
    # Densities have the powers pi/angle and pi/(2 pi - angle) of the inside and the outside.
    power = np.pi / max(angle, 2.0 * np.pi - angle)
    levels = int(np.clip(np.ceil(np.log2(1.0 / tol) / power) + 3, 12, 60))
    ends = 2.0 * 0.5 ** np.arange(levels, -1.0, -1.0)
    sine = abs(np.sin(angle))
    # Panels that face each other across a sharp angle are no longer than they are apart.
    parts = 1 if abs(angle - np.pi) < 0.5 * np.pi else int(np.clip(np.ceil(0.5 / max(sine, 1e-3)), 1, 3))
    fine = ends[:-1, None] + np.diff(ends)[:, None] * np.arange(parts) / parts
    return np.concatenate([[0.0], fine.ravel(), [2.0]])


@lru_cache(maxsize=64)
def _between(radii: tuple[float, ...], p: int) -> tuple[Floats, Floats]:
    """From the coarse panels of a side to its fine ones (m p, 2 p) by interpolation, and densities back (2 p, m p)."""
    rule, ends = rule_of(p), np.array(radii)
    result = np.zeros((len(ends) - 1, p, 2, p))
    for panel, (a, b) in enumerate(pairwise(ends)):
        coarse = int(a >= 1.0)
        s = 2.0 * (0.5 * (a + b) + 0.5 * (b - a) * rule.nodes - coarse) - 1.0
        result[panel, :, coarse] = np.vander(s, p, increasing=True) @ rule.inverse
    flat = result.reshape(-1, 2 * p)
    fine_weights = (0.5 * np.diff(ends)[:, None] * rule.weights).ravel()
    return flat, flat.T * fine_weights / np.tile(0.5 * rule.weights, 2)[:, None]
