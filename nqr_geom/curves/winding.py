"""Exact generalized winding numbers of lines and Bezier curves of degree 2 and 3.

Let the direction from the query p to a point that runs along a chain turn by theta. With the principal argument Arg,
whose branch cut is the ray to the left of p,

    theta = Arg(end - p) - Arg(start - p) + 2 pi (crossings of the cut, downwards +1, upwards -1).

So a closed chain needs no angle at all, only an integer, and an open one needs its two ends. "Above" means y >= p_y
for every point alike, hence neighbours agree about their joint whatever the rounding, and the integer is one number of
the whole chain. Crossings are decided by the tree (`tree.py`): a run whose box does not reach p crosses the cut as its
end points say; inside the box of an arc, a segment by the exact sign of an orientation determinant, and a curved arc
by halving, because it is monotone and each point on it rules out two quadrants.

If p lies on the curve, the part within a vanishing disc is left out (the principal value): a passage through p adds
Arg(-arriving tangent) - Arg(leaving tangent), that is half a turn where the curve is smooth.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves.tree import MIXED, spatial_order, tree_of
from nqr_geom.rows import over_rows

if TYPE_CHECKING:
    from nqr_geom.curves.curve import Curve

__all__ = ["gwn", "gwn_gradient"]

_FAR = 2.0**60  # in the tree's units; every angle from there is below 2**-58
_TURN = 2.0 * math.pi
_SPLITTER = 2.0**27 + 1.0
_ORIENT_BOUND = (3.0 + 16.0 * 2.0**-53) * 2.0**-53  # Shewchuk 1997, ccwerrboundA
_NOISE = 2.0**-40  # a derivative this small relative to the arc is a cusp, its rounding no direction


def gwn(curve: Curve, points: ArrayLike) -> NDArray[np.float64]:
    """Generalized winding number of a curve about points, exact up to rounding.

    Counter-clockwise is +1. A closed chain of pieces gives an exact integer off the curve, also right beside a joint.
    On the curve the value is the principal value, the mean of both sides: 1/2 inside an edge of a counter-clockwise
    polygon, the interior angle over 2 pi at a corner, and at the end of an open chain what the rest of it subtends.
    For segments and for joints "on the curve" is decided exactly; within a few rounding errors of the inside of a
    curved piece the value is that of one side or the mean.

    Parameters
    ----------
    curve : Curve
        Lines, quadratic and cubic Bezier pieces, open or closed, connected or not. The empty curve gives 0.
    points : (m, 2) array_like
        Query points, finite.

    Returns
    -------
    (m,) float64 array
        In turns. Error below 1e-15 times (1 + number of open chains).

    Raises
    ------
    ValueError, TypeError
        If `points` has another shape or is not finite, or if `curve` is a black box.

    References
    ----------
    Jacobson, Kavan, Sorkine-Hornung: Robust inside-outside segmentation using generalized winding numbers, 2013;
    Eq. 5 of the paper.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> square = Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> gwn(square, [[0.5, 0.5], [0.5, 1e-9], [0.5, -1e-9], [0.5, 0], [1, 1]])
    array([1.  , 1.  , 0.  , 0.5 , 0.25])
    """
    points = check.array("points", points, ("m", 2))
    tree = tree_of(curve)
    framed = tree.to_frame(points, _FAR)
    order = spatial_order(framed, len(tree.nodes.skip))
    if order is not None:
        framed = framed[order]
    out = np.empty(len(points))

    def rows(start: int, stop: int) -> None:
        _wind(*tree.nodes, *tree.arcs, tree.open_ends, framed[start:stop], out[start:stop])

    over_rows(rows, len(points))
    if order is None:
        return out
    result = np.empty_like(out)
    result[order] = out
    return result


def gwn_gradient(curve: Curve, points: ArrayLike) -> NDArray[np.float64]:
    """Gradient of the generalized winding number with respect to the query.

    The integer part of a winding number is constant wherever it is continuous, so the gradient comes from the ends of
    open chains alone: (1/2 pi) times the sum of J(end - p) - J(start - p) with J(v) = (v_y, -v_x)/|v|^2. It is zero
    for closed curves. On the curve itself, where the winding number jumps, this is the derivative from either side.

    Parameters
    ----------
    curve : Curve
        As in `gwn`.
    points : (m, 2) array_like
        Query points, finite; the gradient is infinite at the end of an open chain.

    Returns
    -------
    (m, 2) float64 array
        In turns per unit of length.

    Raises
    ------
    ValueError, TypeError
        As `gwn`; also if a point is the end of an open chain, or so near that the gradient exceeds float64.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> segment = Curve.polyline([[1, -1], [1, 1]])
    >>> gwn_gradient(segment, [[0, 0]]) * 2 * np.pi
    array([[1., 0.]])
    """
    points = check.array("points", points, ("m", 2))
    tree = tree_of(curve)
    framed = tree.to_frame(points, _FAR)
    out = np.zeros((len(points), 2))
    if len(tree.open_ends):
        over_rows(lambda a, b: _end_gradients(tree.open_ends, framed[a:b], out[a:b]), len(points))
    with np.errstate(over="ignore", under="ignore"):
        gradient = np.ldexp(out, -tree.exponent)
    bad = ~np.isfinite(gradient).all(axis=1)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise ValueError(
            "points: expected points off the ends of open chains (the gradient is infinite there), "
            f"got {points[row].tolist()} at row {row}"
        )
    return gradient


@njit(cache=True, nogil=True)
def _end_gradients(open_ends, points, out):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        gx, gy = 0.0, 0.0
        for c in range(open_ends.shape[0]):
            for end in range(2):
                x, y = open_ends[c, 2 * end] - points[i, 0], open_ends[c, 2 * end + 1] - points[i, 1]
                scale = max(abs(x), abs(y))
                if scale == 0.0:
                    gx = np.inf
                    continue
                x, y = x / scale, y / scale
                factor = (2 * end - 1) / (_TURN * (x * x + y * y)) / scale
                gx, gy = gx + factor * y, gy - factor * x
        out[i, 0], out[i, 1] = gx, gy


@njit(cache=True, nogil=True)
def _wind(box, skip, arc, start, end, coefficients, curved, open_ends, points, out):  # type: ignore[no-untyped-def]
    count = skip.shape[0]
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        turns = _open_turns(open_ends, px, py)
        node = 0
        while node < count:
            if py > box[node, 3] or py < box[node, 1] or px < box[node, 0]:
                node = skip[node]  # all below, all above, or all to the right: the cut is not met
            elif px > box[node, 2] and arc[node] != MIXED:
                turns += (box[node, 4] >= py) * 1.0 - (box[node, 5] >= py) * 1.0
                node = skip[node]
            elif arc[node] < 0:
                node += 1
            else:
                a = arc[node]
                turns += _arc_turns(start[a], end[a], coefficients[a], curved[a], px, py)
                node = skip[node]
        out[i] = turns


@njit(cache=True, nogil=True)
def _open_turns(open_ends, px, py):  # type: ignore[no-untyped-def]
    """Sum of Arg(end - p) - Arg(start - p) over the open chains, in turns; an end at p is left to its arc.

    One atan2 a chain: the angle between the two directions differs from the difference of their arguments by a full
    turn exactly where the straight way from start to end crosses the cut.
    """
    angle, whole = 0.0, 0.0
    for c in range(open_ends.shape[0]):
        sx, sy = open_ends[c, 0] - px, open_ends[c, 1] - py
        ex, ey = open_ends[c, 2] - px, open_ends[c, 3] - py
        cross = sx * ey - sy * ex
        if cross != 0.0:
            angle += math.atan2(cross, sx * ex + sy * ey)
            if sy >= 0.0 and ey < 0.0:
                whole -= (cross > 0.0) * 1.0
            elif sy < 0.0 and ey >= 0.0:
                whole += (cross < 0.0) * 1.0
        else:
            if ex != 0.0 or ey != 0.0:
                angle += math.atan2(ey, ex)
            if sx != 0.0 or sy != 0.0:
                angle -= math.atan2(sy, sx)
    return whole + angle / _TURN


@njit(cache=True, nogil=True)
def _arc_turns(start, end, coefficients, curved, px, py):  # type: ignore[no-untyped-def]
    """What an arc adds whose closed box holds p: signed crossings of the cut, and the passage if p is on it."""
    sx, sy, ex, ey = start[0], start[1], end[0], end[1]
    from_p, to_p = sx == px and sy == py, ex == px and ey == py
    if from_p and to_p:
        return 0.0
    if from_p or to_p:
        return _touching_turns(start, end, coefficients, curved, px, py, to_p)
    if curved:
        side = _side_of_curve(start, end, coefficients, px, py)
    else:
        side = _orientation(sx, sy, ex, ey, px, py)
        side = side if ey > sy else -side
    step = (sy >= py) * 1.0 - (ey >= py) * 1.0
    if sy == ey and side == 0.0:  # a level arc through p: Arg jumps between 0 and pi
        return 0.5 if sx < ex else -0.5
    # side < 0: the arc passes left of p and meets the cut; 0: on p, the mean of both sides.
    return step if side < 0.0 else (0.0 if side > 0.0 else 0.5 * step)


@njit(cache=True, nogil=True)
def _touching_turns(start, end, coefficients, curved, px, py, to_p):  # type: ignore[no-untyped-def]
    """An arc that ends (or starts) at p: its tangent stands for the missing direction."""
    quadrant_x = (start[0] - px) if to_p else (end[0] - px)
    quadrant_y = (start[1] - py) if to_p else (end[1] - py)
    tx, ty = quadrant_x, quadrant_y
    if curved:
        tx, ty = _direction(coefficients, to_p)
        # A monotone arc stays in one quadrant of p: rounding must not turn its tangent out of it.
        tx = math.copysign(abs(tx), quadrant_x) if tx * quadrant_x > 0.0 else 0.0
        ty = math.copysign(abs(ty), quadrant_y) if ty * quadrant_y > 0.0 else 0.0
        if tx == 0.0 and ty == 0.0:
            tx, ty = quadrant_x, quadrant_y
    turns = math.atan2(ty, tx) / _TURN
    if quadrant_x < 0.0:  # only there can the arc leave a level tangent across the cut
        turns += (quadrant_y >= 0.0) * 1.0 - (ty >= 0.0) * 1.0
    return turns if to_p else -turns


@njit(cache=True, nogil=True)
def _direction(c, at_end):  # type: ignore[no-untyped-def]
    """Direction of an arc's points near one end, seen from that end: the first derivative that does not vanish."""
    x1, x2, x3 = c[0, 0], c[1, 0], c[2, 0]
    y1, y2, y3 = c[0, 1], c[1, 1], c[2, 1]
    if at_end:  # in v = 1 - u
        x1, x2, x3 = -(x1 + 2.0 * x2 + 3.0 * x3), x2 + 3.0 * x3, -x3
        y1, y2, y3 = -(y1 + 2.0 * y2 + 3.0 * y3), y2 + 3.0 * y3, -y3
    size = abs(x1) + abs(x2) + abs(x3) + abs(y1) + abs(y2) + abs(y3)
    if abs(x1) + abs(y1) > _NOISE * size:
        return x1, y1
    if abs(x2) + abs(y2) > _NOISE * size:
        return x2, y2
    return x3, y3


@njit(cache=True, nogil=True)
def _side_of_curve(start, end, c, px, py):  # type: ignore[no-untyped-def]
    """Where a monotone arc passes p at the height of p: -1 left of it, 1 right of it, 0 through it.

    Mirrored so that it rises in x and y, a point of the arc down-left of p or up-right of p halves the arc; any other
    settles the side. An arc that is nowhere told apart from p down to the last bit passes through it.
    """
    fx = 1.0 if end[0] >= start[0] else -1.0
    fy = 1.0 if end[1] >= start[1] else -1.0
    ox, oy = fx * (start[0] - px), fy * (start[1] - py)
    x1, x2, x3 = fx * c[0, 0], fx * c[1, 0], fx * c[2, 0]
    y1, y2, y3 = fy * c[0, 1], fy * c[1, 1], fy * c[2, 1]
    low, high = 0.0, 1.0
    for _ in range(60):
        u = 0.5 * (low + high)
        x, y = ox + u * (x1 + u * (x2 + u * x3)), oy + u * (y1 + u * (y2 + u * y3))
        if x <= 0.0 and y <= 0.0:
            if x == 0.0 and y == 0.0:
                return 0.0
            low = u
        elif x >= 0.0 and y >= 0.0:
            high = u
        else:  # down-right of the mirrored arc: at the height of p the arc is further left
            return -fx if x < 0.0 else fx
    return 0.0


@njit(cache=True, nogil=True)
def _orientation(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Exact sign of (a - p) x (b - p): 1 if a, b, p turn counter-clockwise, 0 if they are collinear."""
    left, right = (ax - px) * (by - py), (ay - py) * (bx - px)
    det = left - right
    if abs(det) > _ORIENT_BOUND * (abs(left) + abs(right)):
        return 1.0 if det > 0.0 else -1.0
    return _exact_orientation(ax, ay, bx, by, px, py)


@njit(cache=True, nogil=True)
def _exact_orientation(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Sign of the six products that remain after expansion, summed without rounding (Shewchuk 1997)."""
    largest = max(max(abs(ax), abs(ay), abs(bx)), max(abs(by), abs(px), abs(py)))
    if 0.0 < largest < 2.0**-300:  # keep the low parts of the products above underflow
        k = 2.0**600
        ax, ay, bx, by, px, py = k * ax, k * ay, k * bx, k * by, k * px, k * py
    f = (ax, -ax, -px, -ay, ay, py)
    g = (by, py, by, bx, px, bx)
    expansion, length = np.empty(12), 0
    for i in range(6):
        high = f[i] * g[i]
        s, t = _SPLITTER * f[i], _SPLITTER * g[i]
        fh, gh = s - (s - f[i]), t - (t - g[i])
        fl, gl = f[i] - fh, g[i] - gh
        low = fl * gl - (((high - fh * gh) - fl * gh) - fh * gl)
        for carry in (low, high):
            for j in range(length):  # grow the expansion by one exact component
                total = carry + expansion[j]
                virtual = total - carry
                expansion[j] = (carry - (total - virtual)) + (expansion[j] - virtual)
                carry = total
            expansion[length] = carry
            length += 1
    sign = 0.0
    for j in range(12):  # the last non-zero component outweighs the others
        if expansion[j] != 0.0:
            sign = 1.0 if expansion[j] > 0.0 else -1.0
    return sign
