"""The smoothed distance to a curve, to rounding, for any alpha."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves.distance import distances, search
from nqr_geom.curves.exponential import exponential_rows
from nqr_geom.curves.tree import tree_of
from nqr_geom.rows import over_rows

if TYPE_CHECKING:
    from nqr_geom.curves.curve import Curve

__all__ = ["sd", "sd_gradient"]

_FAR = 2.0**100  # in the tree's units: from there distances are linear to 1e-30


def sd(curve: Curve, points: ArrayLike, alpha: float = 35.0) -> NDArray[np.float64]:
    """Smoothed distance, -1/alpha times the logarithm of the integral of exp(-alpha |x - p|) over the arc length.

    It lies between d_min - ln(L)/alpha and d_max - ln(L)/alpha (L the length), so it is negative near long curves, and
    tends to the distance for alpha to infinity. The smallest distance is taken out of the exponential, hence nothing
    saturates: the logarithm is as accurate at distance 1e6 as on the curve.

    Parameters
    ----------
    curve : Curve
        Lines, quadratic and cubic Bezier pieces, of positive total length; pieces of length zero count for nothing.
    points : (m, 2) array_like
        Query points, finite.
    alpha : float
        Sharpness, 1 / length, > 0.

    Returns
    -------
    (m,) float64 array
        In units of length. The integral is right to about 1e-13 relative, hence sd to 1e-13/alpha plus the rounding
        of the distance itself.

    Raises
    ------
    ValueError, TypeError
        If `points` has another shape or is not finite, `alpha` is not positive, the curve is a black box or has no
        length (the integral is 0 and its logarithm infinite), or a value exceeds float64.

    References
    ----------
    Eq. 50 of the paper; Madan and Levin, Fast evaluation of smooth distance constraints, 2022.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> segment = Curve.polyline([[0, 0], [2, 0]])
    >>> sd(segment, [[1, 0]], alpha=1.0).round(6), round(-np.log(2 * (1 - np.exp(-1))), 6)
    (array([-0.234472]), np.float64(-0.234472))
    """
    value, _ = _smoothed(curve, points, alpha, with_gradient=False)
    return value


def sd_gradient(curve: Curve, points: ArrayLike, alpha: float = 35.0) -> NDArray[np.float64]:
    """Gradient of `sd` with respect to the query: the mean of the unit vectors away from the curve's points.

    The mean is weighted by exp(-alpha |x - p|) and the arc length, so its length is at most 1. It is continuous off
    the ends of the curve, also on the curve; at an end of an open chain and at a corner the principal value is given.

    Parameters
    ----------
    curve, points, alpha
        As `sd`.

    Returns
    -------
    (m, 2) float64 array
        Off by about 1e-11.

    Raises
    ------
    ValueError, TypeError
        As `sd`.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> square = Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> sd_gradient(square, [[0.5, 0.5], [0.5, 1e3]]).round(6) + 0.0
    array([[0., 0.],
           [0., 1.]])
    """
    _, gradient = _smoothed(curve, points, alpha, with_gradient=True)
    return gradient


def _smoothed(
    curve: Curve, points: ArrayLike, alpha: float, with_gradient: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = check.array("points", points, ("m", 2))
    alpha = check.number("alpha", alpha, low=0.0, open_low=True)
    tree = tree_of(curve)
    start, end = tree.arcs.start, tree.arcs.end
    length = float(np.abs(end - start).sum())  # no less than the arc length of monotone arcs
    if length == 0.0:
        raise ValueError("curve: expected a positive length, got 0: the integral would be 0 and sd infinite")
    found = search(tree, points, with_points=False)
    framed = tree.to_frame(points, _FAR)
    sharpness = min(math.ldexp(alpha, tree.exponent), 1e300) if tree.exponent < 1000 else 1e300
    log, gradient = np.empty(len(points)), np.empty((len(points), 2))

    def rows(i: int, j: int) -> None:
        exponential_rows(
            *tree.clusters, start, end, tree.arcs.coefficients, framed[i:j], found.arc[i:j], found.u[i:j],
            sharpness, length, with_gradient, log[i:j], gradient[i:j],
        )  # fmt: skip

    over_rows(rows, len(points))
    with np.errstate(over="ignore"):
        value = distances(tree, found, points) - (log + tree.exponent * math.log(2.0)) / alpha
    if not np.isfinite(value).all():
        raise ValueError(f"alpha: expected a smoothed distance below 1.8e308, got alpha = {alpha}")
    return value, gradient
