"""Curves that several groups of hard cases share."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.curves.curve import Curve

__all__ = ["INNER", "SQUARE", "circle_of_cubics", "closed", "joined", "koch", "pieces", "ring", "scaled"]

Floats = NDArray[np.float64]


def closed(*points: Sequence[float]) -> Curve:
    """A closed polygon from its vertices."""
    return Curve.polyline(np.array(points, dtype=float), closed=True)


def pieces(control: Any) -> Curve:
    """Bezier pieces from nested lists (k, degree + 1, 2)."""
    return Curve.bezier(np.array(control, dtype=float))


def joined(*parts: Curve) -> Curve:
    """All pieces of several curves as one curve."""
    return reduce(lambda one, other: one + other, parts)


def scaled(curve: Curve, s: float, shift: float = 0.0) -> Curve:
    """A curve s times as large, then moved by `shift` along both axes."""
    return curve.transformed(s * np.eye(2), (shift, shift))


def ring(m: int, radius: float = 1.0, turns: int = 1) -> Floats:
    """Vertices (m, 2) of a regular polygon, or of one that goes round several times."""
    angle = 2.0 * np.pi * turns * np.arange(m) / m
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def circle_of_cubics(n: int, turn: float = 2.0 * np.pi, radius: float = 1.0) -> Curve:
    """A circle (or a part of one) as n cubics that share ends bitwise."""
    angle = np.linspace(0.0, turn, n + 1)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if turn == 2.0 * np.pi:
        rim[-1] = rim[0]
    arm = 4.0 / 3.0 * np.tan(turn / n / 4.0)
    tangent = np.stack([-rim[:, 1], rim[:, 0]], axis=1) * arm
    return Curve.bezier(np.stack([rim[:-1], rim[:-1] + tangent[:-1], rim[1:] - tangent[1:], rim[1:]], axis=1))


def koch(depth: int) -> Floats:
    """Vertices (3 4^depth, 2) of Koch's snowflake, counter-clockwise, its triangle inscribed in the unit circle."""
    z = np.exp(2j * np.pi * np.arange(3) / 3.0)
    for _ in range(depth):
        step = (np.roll(z, -1) - z) / 3.0
        z = np.stack([z, z + step, z + step * (1.0 + np.exp(-1j * np.pi / 3.0)), z + 2.0 * step], axis=1).ravel()
    return np.stack([z.real, z.imag], axis=1)


SQUARE = closed((0, 0), (1, 0), (1, 1), (0, 1))
INNER = closed((0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75))
