"""Closest points of a curve, exact distances, signed distances and their gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves.closest import closest_rows
from nqr_geom.curves.tree import CurveTree, spatial_order, tree_of
from nqr_geom.curves.winding import gwn
from nqr_geom.rows import over_rows

if TYPE_CHECKING:
    from nqr_geom.curves.curve import Curve

__all__ = ["ClosestPoint", "closest_point", "distance", "distance_gradient", "signed_distance"]

_FAR = 2.0**400  # in the tree's units: squares stay finite; seen from there a curve is flat to the last bit
_NEAR = 2.0**-20  # in the tree's units: nearer than this, the curve's normal is the better direction

SIGNS = ("nonzero", "even-odd")


class ClosestPoint(NamedTuple):
    """Where a curve comes nearest to each query.

    Attributes
    ----------
    point : (m, 2) float64 array
        The nearest point of the curve; one of them where there are several, always the same one.
    distance : (m,) float64 array
        Its distance, in units of length, >= 0.
    piece : (m,) int64 array
        The piece it lies on.
    t : (m,) float64 array
        The local parameter on that piece, in [0, 1].
    """

    point: NDArray[np.float64]
    distance: NDArray[np.float64]
    piece: NDArray[np.int64]
    t: NDArray[np.float64]


class Search(NamedTuple):
    """Raw answer in the tree's units: arc, its parameter and the squared distance of every query."""

    framed: NDArray[np.float64]
    arc: NDArray[np.int64]
    u: NDArray[np.float64]
    square: NDArray[np.float64]


def search(tree: CurveTree, points: NDArray[np.float64], with_points: bool = True) -> Search:
    """Closest arcs of checked points on all cores; without arcs of length zero if so wished."""
    framed = tree.to_frame(points, _FAR)
    order = spatial_order(framed, len(tree.clusters.skip))
    queries = framed if order is None else framed[order]
    arc, u = np.empty(len(points), dtype=np.int64), np.empty(len(points))
    square = np.empty(len(points))

    def rows(i: int, j: int) -> None:
        closest_rows(*tree.clusters, *tree.arcs, queries[i:j], with_points, arc[i:j], u[i:j], square[i:j])

    over_rows(rows, len(points))
    if order is None:
        return Search(framed, arc, u, square)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return Search(framed, arc[back], u[back], square[back])


def feet(tree: CurveTree, found: Search) -> NDArray[np.float64]:
    """(m, 2) nearest points in the tree's units; ends of arcs bit for bit."""
    arcs, u = tree.arcs, found.u[:, None]
    c = arcs.coefficients[found.arc]
    inner = arcs.start[found.arc] + u * (c[:, 0] + u * (c[:, 1] + u * c[:, 2]))
    return np.where(u == 1.0, arcs.end[found.arc], inner)


def _checked(curve: Curve, points: ArrayLike) -> tuple[CurveTree, NDArray[np.float64]]:
    points = check.array("points", points, ("m", 2))
    tree = tree_of(curve)
    if len(tree.piece) == 0:
        raise ValueError("curve: expected at least one piece, got an empty curve, which is at no distance")
    return tree, points


def closest_point(curve: Curve, points: ArrayLike) -> ClosestPoint:
    """Nearest points of a curve by branch and bound on its tree.

    Parameters
    ----------
    curve : Curve
        Lines, quadratic and cubic Bezier pieces; at least one, of length zero if need be.
    points : (m, 2) array_like
        Query points, finite.

    Returns
    -------
    ClosestPoint
        Named tuple of `point`, `distance`, `piece`, `t`. Distances are off by at most about 1e-15 times the larger
        of the distance and the size of the curve's coordinates.

    Raises
    ------
    ValueError, TypeError
        If `points` has another shape or is not finite, if `curve` is empty or a black box, or if a distance exceeds
        float64.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> square = Curve.polyline([[0, 0], [4, 0], [4, 4], [0, 4]], closed=True)
    >>> found = closest_point(square, [[1, 1.5], [7, 1]])
    >>> found.point
    array([[0. , 1.5],
           [4. , 1. ]])
    >>> found.distance, found.piece, found.t
    (array([1., 3.]), array([3, 1]), array([0.625, 0.25 ]))
    """
    tree, points = _checked(curve, points)
    found = search(tree, points)
    point = np.ldexp(feet(tree, found), tree.exponent)
    t0, t1 = tree.interval[found.arc].T
    t = np.where(found.u == 1.0, t1, t0 + found.u * (t1 - t0))
    return ClosestPoint(point, distances(tree, found, points), tree.piece[found.arc], t)


def distances(tree: CurveTree, found: Search, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances in the curve's units; from the coordinates themselves where the query was drawn in."""
    far = np.abs(found.framed).max(axis=1, initial=0.0) >= _FAR
    with np.errstate(over="ignore", under="ignore"):
        result = np.ldexp(np.sqrt(found.square), tree.exponent)
        if far.any():
            rows = Search(*(field[far] for field in found))
            result[far] = np.hypot(*(points[far] - np.ldexp(feet(tree, rows), tree.exponent)).T)
    if not np.isfinite(result).all():
        row = int(np.flatnonzero(~np.isfinite(result))[0])
        raise ValueError(f"points: expected a distance below 1.8e308, got {points[row].tolist()} at row {row}")
    return result


def distance(curve: Curve, points: ArrayLike) -> NDArray[np.float64]:
    """Distance to the nearest point of a curve: (m,) float64, >= 0; arguments and errors as `closest_point`.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> distance(Curve.polyline([[0, 0], [4, 0]]), [[1, 2], [7, 4], [2, 0]])
    array([2., 5., 0.])
    """
    tree, points = _checked(curve, points)
    found = search(tree, points)
    return distances(tree, found, points)


def signed_distance(curve: Curve, points: ArrayLike, sign: str = "nonzero") -> NDArray[np.float64]:
    """Distance to a curve, negative inside.

    With w the generalized winding number, a point is inside

    - by "nonzero" if \\|w\\| > 1/2, so a clockwise curve has the same inside and a doubled one no hole;
    - by "even-odd" if w rounds to an odd integer, so where two discs overlap is outside.

    For closed curves these are the rules of SVG and PostScript. For open ones they mean the same with w rounded: the
    sign changes on the curve and also across the level sets w = 1/2 + k that close the gaps, where the distance is
    not zero; a reversed curve gives the same signs. On the curve the value is 0.

    Parameters
    ----------
    curve : Curve
        As `closest_point`.
    points : (m, 2) array_like
        Query points, finite.
    sign : {"nonzero", "even-odd"}
        What counts as inside.

    Returns
    -------
    (m,) float64 array
        In units of length.

    Raises
    ------
    ValueError, TypeError
        As `closest_point`, or if `sign` is unknown.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> square = Curve.polyline([[0, 0], [4, 0], [4, 4], [0, 4]], closed=True)
    >>> signed_distance(square, [[1, 2], [7, 8], [4, 1]])
    array([-1.,  5.,  0.])
    """
    check.choice("sign", sign, SIGNS)
    away = distance(curve, points)
    turns = np.abs(gwn(curve, points))
    # A closed chain's turns are exact integers; half a turn on an open level set is no side.
    inside = turns > 0.5 if sign == "nonzero" else np.rint(turns) % 2 == 1
    return np.where(inside & (away > 0.0), -away, away)


def distance_gradient(curve: Curve, points: ArrayLike) -> NDArray[np.float64]:
    """Gradient of the distance with respect to the query: the unit vector away from the closest point.

    Where several points are closest, it is that of the one `closest_point` names. On the curve the distance has a
    kink, and the gradient given is 0, the mean of both sides.

    Parameters
    ----------
    curve, points
        As `closest_point`.

    Returns
    -------
    (m, 2) float64 array
        Of length 1, or 0 on the curve.

    Raises
    ------
    ValueError, TypeError
        As `closest_point`.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> distance_gradient(Curve.polyline([[0, 0], [4, 0]]), [[1, 2], [7, 4], [2, 0]])
    array([[0. , 1. ],
           [0.6, 0.8],
           [0. , 0. ]])
    """
    tree, points = _checked(curve, points)
    found = search(tree, points)
    away = found.framed - feet(tree, found)
    # Close to the inside of an arc the difference is mostly rounding, and the normal is not.
    c, u = tree.arcs.coefficients[found.arc], found.u[:, None]
    tangent = c[:, 0] + u * (2.0 * c[:, 1] + u * 3.0 * c[:, 2])
    side = np.where(
        tree.arcs.curved[found.arc], _cross(tangent, away), _cross(tangent, found.framed - tree.arcs.start[found.arc])
    )
    normal = np.sign(side)[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    inner = (found.u > 0.0) & (found.u < 1.0) & (found.square < _NEAR**2) & (tangent != 0.0).any(axis=1)
    direction = np.where(inner[:, None], normal, away)
    direction[found.square == 0.0] = 0.0
    largest = np.abs(direction).max(axis=1, keepdims=True, initial=0.0)
    direction = direction / np.where(largest > 0.0, largest, 1.0)
    length = np.hypot(direction[:, 0], direction[:, 1])[:, None]
    return direction / np.where(length > 0.0, length, 1.0) + 0.0


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
