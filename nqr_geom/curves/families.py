"""Families of curves: the random dataset of the paper, its shapes outside that dataset, and smooth black boxes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.curves.curve import BlackBoxCurve, Curve
from nqr_geom.streams import Stream

__all__ = ["control_points", "curves", "fourier", "house", "impossible", "knots", "lissajous"]

Floats = NDArray[np.float64]

# Fig. 38: sixteen free points make six quadratics, 0-1 and 2-3 joined end to end, 4 and 5 on their own.
_JOINED = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7], [7, 8, 9], [10, 11, 12], [13, 14, 15]])


def control_points(rows: Any, seed: int = 0, split: str = "test") -> Any:
    """Control points of the random shapes of Fig. 38, one shape for every row.

    Parameters
    ----------
    rows : (n,) int64 ndarray or torch tensor
        Indices of shapes; a shape depends on its own index, the seed and the split only.
    seed : int
        Any integer.
    split : {"test", "train", "validation"}
        Shapes of different splits have nothing in common.

    Returns
    -------
    (n, 6, 3, 2) float64 ndarray, or a tensor on the device of `rows`
        Six quadratic Bezier pieces with control points uniform in (-1, 1)^2; pieces 0 and 1 share a point, and
        so do 2 and 3.

    References
    ----------
    "Neural Quadrature Rule and Autoregressive Adaptive Sampling", Fig. 38 and appendix A.2 (which counts five
    pieces where the figure and Section 6.2 have six).

    Examples
    --------
    >>> points = control_points(np.arange(3))
    >>> points.shape, bool((points[:, 0, 2] == points[:, 1, 0]).all())
    ((3, 6, 3, 2), True)
    """
    point, axis, joined = np.arange(16)[:, None], np.arange(2), _JOINED
    if hasattr(rows, "new_tensor"):  # a torch tensor: the same integers on its device
        point, axis, joined = (rows.new_tensor(index) for index in (point, axis, joined))
    uniform = Stream(seed, split, "curves").uniform(rows[:, None, None], point, axis)  # (n, 16, 2)
    return (2.0 * uniform - 1.0)[:, joined]


def curves(n: int, seed: int = 0, split: str = "test") -> list[Curve]:
    """The random shapes of Fig. 38, as curves of six pieces.

    Parameters
    ----------
    n : int
        How many, >= 0; the first shapes of a longer list are those of a shorter one.
    seed : int
        Any integer.
    split : {"test", "train", "validation"}
        Which world the shapes belong to.

    Returns
    -------
    list of Curve
        Inside (-1, 1)^2, each of four chains.

    Examples
    --------
    >>> curves(2)
    [Curve(6 pieces in 4 chains, open), Curve(6 pieces in 4 chains, open)]
    """
    rows = np.arange(check.integer("n", n, low=0), dtype=np.int64)
    return [Curve.bezier(points) for points in control_points(rows, seed, split)]


def house() -> Curve:
    """Five segments around a house: the first shape of Fig. 25, counter-clockwise inside [-1, 1]^2.

    Examples
    --------
    >>> house()
    Curve(5 pieces in 1 chain, closed)
    """
    return Curve.polyline([[-0.6, -0.75], [0.6, -0.75], [0.6, 0.15], [0.0, 0.75], [-0.6, 0.15]], closed=True)


def impossible() -> Curve:
    """Eighteen segments: three L-shaped beams that close into an impossible triangle, as in Fig. 25.

    The beams run counter-clockwise and share their inner edges there and back: the winding number is 1 in all three
    and 0 in the triangle between them.

    Examples
    --------
    >>> impossible()
    Curve(18 pieces in 3 chains, closed)
    """
    hole = 3  # side of the inner triangle, in widths of a beam's face
    beam = np.array([(-1, -2), (hole + 3, -2), (0, hole + 1), (0, hole), (hole + 1, -1), (-2, -1)])
    result = Curve.polyline([])
    for _ in range(3):
        u, v = (beam - hole / 3.0).T  # triangular lattice: u along x, v at 60 degrees
        result = result + Curve.polyline(0.22 * np.stack([u + 0.5 * v, math.sqrt(0.75) * v], axis=1), closed=True)
        beam = np.stack([hole - beam.sum(axis=1), beam[:, 0]], axis=1)  # a third of a turn, exact on the lattice
    return result


def knots() -> Curve:
    """Thirty quadratic pieces: a trefoil and a cinquefoil of fifteen each, smooth and closed, as in Fig. 25.

    Examples
    --------
    >>> knots()
    Curve(30 pieces in 2 chains, closed)
    """
    return _knot(3, (-0.46, 0.4), 0.17) + _knot(5, (0.4, -0.38), 0.19)


def _knot(lobes: int, centre: tuple[float, float], scale: float) -> Curve:
    """Projection of the (2, lobes) torus knot as a quadratic B-spline of fifteen control points."""
    angle = 2.0 * np.pi * np.arange(15) / 15
    radius = scale * (2.0 + np.cos(lobes * angle))[:, None]
    corner = centre + radius * np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    middle = 0.5 * (corner + np.roll(corner, 1, axis=0))
    return Curve.bezier(np.stack([middle, corner, np.roll(middle, -1, axis=0)], axis=1))


def lissajous(a: int = 3, b: int = 2, phase: float = math.pi / 2.0, pieces: int = 1) -> BlackBoxCurve:
    """The closed smooth curve (sin(2 pi a s + phase), sin(2 pi b s)) as a black box with exact tangents.

    Parameters
    ----------
    a, b : int
        Oscillations in x and y, >= 1.
    phase : float
        Radians.
    pieces : int
        Into how many equal pieces its parameter is told to fall, >= 1.

    Examples
    --------
    >>> lissajous(1, 1).sample([0.0, 0.25]).round(12) + 0.0
    array([[1., 0.],
           [0., 1.]])
    """
    frequency = 2.0 * np.pi * np.array([check.integer("a", a, low=1), check.integer("b", b, low=1)])
    shift = np.array([check.number("phase", phase), 0.0])

    def x(s: Floats) -> Floats:
        return np.sin(s[:, None] * frequency + shift)

    def derivative(s: Floats) -> Floats:
        return frequency * np.cos(s[:, None] * frequency + shift)

    return Curve.from_callable(x, pieces, derivative)


def fourier(seed: int = 0, split: str = "test", harmonics: int = 5, pieces: int = 1) -> BlackBoxCurve:
    """A random closed smooth curve in [-1, 1]^2: a Fourier series with amplitudes falling like 1 / m^2.

    Parameters
    ----------
    seed : int
        Any integer.
    split : {"test", "train", "validation"}
        Which world it belongs to.
    harmonics : int
        Terms of the series, >= 1.
    pieces : int
        Into how many equal pieces its parameter is told to fall, >= 1.

    Returns
    -------
    BlackBoxCurve
        With exact tangents.

    Examples
    --------
    >>> wave = fourier(seed=3)
    >>> bool(np.allclose(wave.sample(0.0), wave.sample(1.0)))
    True
    """
    m = np.arange(1, check.integer("harmonics", harmonics, low=1) + 1)
    uniform = Stream(seed, split, "fourier").uniform(np.arange(2)[:, None, None], m[:, None], np.arange(2))
    amplitude = (0.5 + 0.5 * uniform[0]) / m[:, None] ** 2  # (harmonics, 2)
    amplitude /= amplitude.sum(axis=0)
    phase = 2.0 * np.pi * uniform[1]
    frequency = 2.0 * np.pi * m[:, None]

    def series(wave: Callable[[Floats], Floats], weight: Floats) -> Callable[[Floats], Floats]:
        return lambda s: (weight * wave(s[:, None, None] * frequency + phase)).sum(axis=1)

    return Curve.from_callable(series(np.cos, amplitude), pieces, series(lambda t: -np.sin(t), amplitude * frequency))
