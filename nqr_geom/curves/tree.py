"""A tree for exact queries: a curve as monotone arcs, under boxes along its chains and under boxes by place.

Three facts make it exact and fast.

- Every piece is cut where x'(t) or y'(t) vanishes. The resulting *arcs* are monotone in x and in y, so the box of an
  arc is the box of its two ends, and one evaluated point splits arc and box alike: no root has to be found.
- A node is a run of consecutive arcs of one chain. Seen from a point outside its box, a run turns by exactly the
  angle between its two ends (the box is convex), whatever it does in between.
- Nodes lie in depth-first order: the first child of node i is i + 1, and `skip[i]` is the node after i's subtree.
  A traversal needs no stack, and skipping a subtree is one load.

Above the chains, which come in Morton order, the same binary layout goes on, so that many small chains (a page of
glyphs, a soup of segments) are as sub-linear as one long one. Closest points have no use for runs, and a run of a
spiral is near everything: they get the same arcs in `clusters`, a radix tree by place (three to six times faster on a
spiral, the same on a star), built when first asked for.

Coordinates are multiplied by a power of two (exact) so that the largest one lies in [1/2, 1): products of differences
can neither overflow nor underflow, at any scale of the input. Nothing is shifted: a shift would round.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nqr_geom.curves import bezier

if TYPE_CHECKING:
    from nqr_geom.curves.curve import Curve

__all__ = ["Arcs", "CurveTree", "Nodes", "spatial_order", "tree_of"]

RUN, MIXED = -1, -2  # what an inner node is; a leaf holds the index of its arc


class Arcs(NamedTuple):
    """Monotone arcs: x(u) = start + u (c[0] + u (c[1] + u c[2])), u in [0, 1], in tree order."""

    start: NDArray[np.float64]  # (a, 2)
    end: NDArray[np.float64]  # (a, 2), bitwise the next arc's start within a chain
    coefficients: NDArray[np.float64]  # (a, 3, 2)
    curved: NDArray[np.bool_]  # (a,), False: exactly the segment from start to end


class Nodes(NamedTuple):
    """Depth-first nodes: bounds, the run's first and last y, the way past the subtree, the arc or kind."""

    box: NDArray[np.float64]  # (n, 6): xmin, ymin, xmax, ymax, y of the first point, y of the last point
    skip: NDArray[np.int64]  # (n,)
    arc: NDArray[np.int64]  # (n,), >= 0: a leaf; RUN: of one chain, or of closed chains only; MIXED


@dataclass(frozen=True, eq=False)
class CurveTree:
    """A curve made ready for exact queries; build once with `tree_of`, query many times.

    Attributes
    ----------
    exponent : int
        Coordinates in the tree are the curve's times 2**-exponent.
    arcs, nodes : Arcs, Nodes
        Geometry and hierarchy.
    piece : (a,) int64 array
        The curve's piece that an arc is part of.
    interval : (a, 2) float64 array
        The part of that piece's [0, 1] the arc covers.
    open_ends : (c, 4) float64 array
        First and last point (x, y, x, y) of every chain that is not closed.
    """

    exponent: int
    arcs: Arcs
    nodes: Nodes
    piece: NDArray[np.int64]
    interval: NDArray[np.float64]
    open_ends: NDArray[np.float64]

    @classmethod
    def build(cls, control: NDArray[np.float64], degree: NDArray[np.int64]) -> CurveTree:
        """The tree of pieces with control points (k, 4, 2), rows after `degree` repeating the last."""
        largest = float(np.abs(control).max(initial=0.0))
        exponent = int(np.frexp(largest)[1])
        # Adding 0.0 turns -0.0 into 0.0: on the branch cut, atan2 would tell them apart.
        control = np.ldexp(control, -exponent) + 0.0
        arcs, piece, interval = _monotone_arcs(control, degree)
        chain = _chains(arcs)
        order, chain = _chains_in_morton_order(arcs, chain)
        arcs = Arcs(arcs.start[order], arcs.end[order], arcs.coefficients[order], arcs.curved[order])
        first = np.flatnonzero(np.diff(chain, prepend=-1))
        last = np.append(first[1:], len(chain))[: len(first)] - 1
        is_open = (arcs.start[first] != arcs.end[last]).any(axis=1)
        open_ends = np.hstack([arcs.start[first], arcs.end[last]])[is_open]
        nodes = _runs(arcs, chain, first, is_open)
        return cls(exponent, arcs, nodes, piece[order], interval[order], open_ends)

    @cached_property
    def clusters(self) -> Nodes:
        """The same arcs under boxes by place: a run of a spiral is near everything, a cluster is not."""
        return _clusters(self.arcs)

    def to_frame(self, points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
        """Points in the tree's units; beyond `radius` drawn in along their direction, so that squares are finite."""
        with np.errstate(over="ignore", under="ignore"):
            framed = np.ldexp(points, -self.exponent) + 0.0
        reach = np.abs(framed).max(axis=1, initial=0.0)
        far = reach > radius
        if far.any():
            # Halve first: the direction must survive where the scaled coordinates themselves do not.
            largest = np.abs(points[far]).max(axis=1, keepdims=True)
            framed[far] = points[far] / largest * radius
        return framed


def tree_of(curve: Curve) -> CurveTree:
    """The tree of `curve`, built on first use and kept on the curve.

    Examples
    --------
    >>> from nqr_geom.curves.curve import Curve
    >>> square = Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> tree_of(square).nodes.box.shape
    (7, 6)
    >>> tree_of(square) is tree_of(square)
    True
    """
    cache = vars(curve)  # a frozen dataclass has one, too
    tree = cache.get("_tree")
    if tree is None:
        tree = CurveTree.build(curve.control, curve.degree)
        cache["_tree"] = tree
    return tree


def _turning_parameters(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 4) parameters in (0, 1) where x' or y' vanishes, ascending; 1 where there is none."""
    scale = np.abs(a).max(axis=1, initial=np.finfo(np.float64).tiny)  # a speck on a large curve: no underflow
    c, b, q = a[:, 0] / scale, 2.0 * a[:, 1] / scale, 3.0 * a[:, 2] / scale
    with np.errstate(all="ignore"):
        # The stable pair of formulas; a vanishing leading coefficient sends one root to infinity and no further.
        half = -0.5 * (b + np.copysign(np.sqrt(b * b - 4.0 * q * c), b))
        roots = np.concatenate([half / q, c / half], axis=1)
    roots = np.where((roots > 0.0) & (roots < 1.0), roots, 1.0)
    return np.sort(roots, axis=1)


def _without_specks(
    turns: NDArray[np.float64], origin: NDArray[np.float64], a: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Drop turning points that rounding alone sets apart from an end or from each other.

    Where the velocity vanishes (a drawn-in handle, a cusp), x and y turn at once, up to rounding. An arc between two
    such points would be a speck with a direction made of noise.
    """
    turns = turns.copy()
    noise = 2.0**-50 * (np.abs(origin).max(axis=1) + np.abs(a).max(axis=2).sum(axis=1))
    t = turns[:, :, None]
    offsets = t * (a[:, None, 0] + t * (a[:, None, 1] + t * a[:, None, 2]))
    for columns, neighbour in (((3, 2, 1, 0), a.sum(axis=1)), ((0, 1, 2, 3), np.zeros_like(origin))):
        for column in columns:
            here, turn = offsets[:, column], turns[:, column]
            speck = np.abs(here - neighbour).max(axis=1) <= noise
            neighbour = np.where((speck | (turn == 1.0))[:, None], neighbour, here)
            turns[speck, column] = 1.0
    return np.sort(turns, axis=1)


def _monotone_arcs(
    control: NDArray[np.float64], degree: NDArray[np.int64]
) -> tuple[Arcs, NDArray[np.int64], NDArray[np.float64]]:
    """Cut every piece at its turning points; also which piece and which part of it each arc is."""
    k = len(control)
    a = bezier.coefficients(control, degree)[:, 1:]
    turns = np.where(degree[:, None] == 1, 1.0, _turning_parameters(a))
    knots = np.hstack([np.zeros((k, 1)), _without_specks(turns, control[:, 0], a), np.ones((k, 1))])
    piece, slot = np.nonzero(np.diff(knots, axis=1) > 0.0)
    t0, t1 = knots[piece, slot][:, None], knots[piece, slot + 1][:, None]
    a1, a2, a3 = (a[piece, i] for i in range(3))
    width = t1 - t0
    coefficients = np.stack(
        [
            width * (a1 + t0 * (2.0 * a2 + t0 * (3.0 * a3))),
            width**2 * (a2 + t0 * (3.0 * a3)),
            width**3 * a3,
        ],
        axis=1,
    )
    origin = control[piece, 0]
    start = np.where(t0 == 0.0, origin, origin + t0 * (a1 + t0 * (a2 + t0 * a3)))
    end = np.where(t1 == 1.0, control[piece, 3], origin + t1 * (a1 + t1 * (a2 + t1 * a3)))
    return Arcs(start, end, coefficients, degree[piece] > 1), piece, np.hstack([t0, t1])


def _chains(arcs: Arcs) -> NDArray[np.int64]:
    """(a,) number of the chain of every arc: a new one wherever an arc does not start where the last one ended."""
    if len(arcs.start) == 0:
        return np.zeros(0, dtype=np.int64)
    gap = (arcs.start[1:] != arcs.end[:-1]).any(axis=1)
    return np.concatenate([[0], np.cumsum(gap)])


def _chains_in_morton_order(arcs: Arcs, chain: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Order of the arcs that puts chains along a Morton curve, and the chains' numbers in that order."""
    if len(chain) == 0 or chain[-1] == 0:
        return np.arange(len(chain)), chain
    first = np.flatnonzero(np.diff(chain, prepend=-1))
    low = np.minimum.reduceat(np.minimum(arcs.start, arcs.end), first)
    high = np.maximum.reduceat(np.maximum(arcs.start, arcs.end), first)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(morton(0.5 * (low + high)), kind="stable")] = np.arange(len(first))
    order = np.argsort(rank[chain], kind="stable")
    return order, rank[chain][order]


def morton(points: NDArray[np.float64]) -> NDArray[np.uint64]:
    """(m,) Morton codes of points, 16 bits an axis, over their own box."""
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, np.finfo(np.float64).tiny)
    cell = np.minimum((points - low) / extent * 65536.0, 65535.0).astype(np.uint64)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        cell = (cell | (cell << np.uint64(shift))) & np.uint64(mask)
    return cell[:, 0] | (cell[:, 1] << np.uint64(1))


def spatial_order(points: NDArray[np.float64], nodes: int) -> NDArray[np.int64] | None:
    """An order of the queries along a Morton curve where it pays: many queries, a tree larger than the cache."""
    if nodes < 20_000 or len(points) < 1_000:
        return None
    return np.argsort(morton(points))


Cut = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.int64]]  # where to split ranges (low, high)
Level = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


def _hierarchy(count: int, cut: Cut) -> tuple[NDArray[np.int64], NDArray[np.int64], list[Level]]:
    """Depth-first `skip` and `arc` of a binary tree over range(count), and its levels from the root down.

    A level is (node, left child, right child, low, high) of the inner nodes at one depth.
    """
    size = max(2 * count - 1, 0)
    skip, arc = np.empty(size, dtype=np.int64), np.full(size, RUN, dtype=np.int64)
    levels: list[Level] = []
    at, low, high = (np.array([v] if count else [], dtype=np.int64) for v in (0, 0, count))
    while len(at):
        skip[at] = at + 2 * (high - low) - 1
        leaf = high - low == 1
        arc[at[leaf]] = low[leaf]
        at, low, high = at[~leaf], low[~leaf], high[~leaf]
        middle = cut(low, high)
        left, right = at + 1, at + 2 * (middle - low)
        levels.append((at, left, right, low, high))
        at = np.concatenate([left, right])
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    return skip, arc, levels


def _boxes(low: NDArray[np.float64], high: NDArray[np.float64], arc: NDArray[np.int64], levels: list[Level]) -> NDArray:
    """(n, 6) with the first four columns filled: boxes of the leaves, then of their parents, upwards."""
    box = np.zeros((len(arc), 6))
    leaf = arc >= 0
    box[leaf, :2], box[leaf, 2:4] = low[arc[leaf]], high[arc[leaf]]
    for at, left, right, _, _ in reversed(levels):
        box[at, :2] = np.minimum(box[left, :2], box[right, :2])
        box[at, 2:4] = np.maximum(box[left, 2:4], box[right, 2:4])
    return box


def _runs(arcs: Arcs, chain: NDArray[np.int64], first: NDArray[np.int64], is_open: NDArray[np.bool_]) -> Nodes:
    """Runs of consecutive arcs, split in the middle; several chains at the boundary next to the middle."""
    opened = np.concatenate([[0], np.cumsum(is_open)])  # open chains before chain c

    def cut(low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
        head, tail, middle = chain[low], chain[high - 1], (low + high) // 2
        nearest = np.searchsorted(first, middle)  # the first chain that starts at or after the middle
        after = first[np.clip(nearest, head + 1, np.maximum(tail, head + 1)) % len(first)]
        before = first[np.clip(nearest - 1, head + 1, np.maximum(tail, head + 1)) % len(first)]
        boundary = np.where(np.abs(after - middle) < np.abs(middle - before), after, before)
        return np.where(head == tail, middle, boundary)

    skip, arc, levels = _hierarchy(len(chain), cut)
    box = _boxes(np.minimum(arcs.start, arcs.end), np.maximum(arcs.start, arcs.end), arc, levels)
    leaf = arc >= 0
    box[leaf, 4], box[leaf, 5] = arcs.start[arc[leaf], 1], arcs.end[arc[leaf], 1]
    for at, _, _, low, high in levels:
        head, tail = chain[low], chain[high - 1]
        # Closed chains together turn by nothing seen from outside: equal ends say so.
        box[at, 4] = np.where(head == tail, arcs.start[low, 1], 0.0)
        box[at, 5] = np.where(head == tail, arcs.end[high - 1, 1], 0.0)
        arc[at[(head != tail) & (opened[tail + 1] > opened[head])]] = MIXED
    return Nodes(box, skip, arc)


def _clusters(arcs: Arcs) -> Nodes:
    """Arcs by place instead of by order along the curve: a radix tree over the Morton codes of their middles."""
    low, high = np.minimum(arcs.start, arcs.end), np.maximum(arcs.start, arcs.end)
    code = morton(0.5 * (low + high)) if len(low) else np.zeros(0, dtype=np.uint64)
    order = np.argsort(code, kind="stable")
    code = code[order]

    def cut(low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
        differ = code[low] ^ code[high - 1]
        bit = np.maximum(np.frexp(differ.astype(np.float64))[1] - 1, 0).astype(np.uint64)
        split = np.searchsorted(code, (code[high - 1] >> bit) << bit)
        return np.where(differ > 0, split, (low + high) // 2)

    skip, arc, levels = _hierarchy(len(code), cut)
    box = _boxes(low[order], high[order], arc, levels)
    return Nodes(box, skip, np.where(arc >= 0, order[np.maximum(arc, 0)], arc))
