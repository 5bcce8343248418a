"""A curve a person brings: Bezier pieces under one parameter s in [0, 1], or a black box of points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves import bezier, parameter
from nqr_geom.curves.black_box import PointQueries, affine_map
from nqr_geom.curves.constructors import Constructors

__all__ = ["BlackBoxCurve", "Curve"]

_MOST_SEGMENTS = 50_000_000


class Curve(Constructors):
    """Lines, quadratic and cubic Bezier pieces in the plane, open or closed, connected or not. Immutable.

    Most users call a constructor: `polyline`, `bezier`, `from_svg`, `from_shapely`, `from_text`, `from_callable`.

    The parameter s in [0, 1] is spread evenly over the k pieces: s lies in piece ``min(floor(s k), k - 1)`` at
    the local parameter ``t = s k - piece``, so s = 1 is the end of the last piece. A value of s k within
    rounding of an integer j counts as j: ``s = j / k`` is the start of piece j whatever j and k. Where two
    pieces meet, an explicit `piece` asks for one side.

    Parameters
    ----------
    control : (k, 4, 2) array_like
        Control points, at most 1e300 in size; a piece of degree d uses the rows 0..d, the others are ignored.
    degree : (k,) array_like of int
        1, 2 or 3.

    Raises
    ------
    ValueError, TypeError
        If a shape is wrong or a number is not finite.

    Examples
    --------
    >>> square = Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> square
    Curve(4 pieces in 1 chain, closed)
    >>> square.length, square.bounds
    (4.0, (0.0, 0.0, 1.0, 1.0))
    >>> square.sample([0.125, 1.0])
    array([[0.5, 0. ],
           [0. , 0. ]])
    """

    derivative_queries = 0  # point queries that one tangent costs: the pieces are known here

    @staticmethod
    def from_callable(
        x: Callable[[NDArray[np.float64]], ArrayLike],
        pieces: int = 1,
        derivative: Callable[[NDArray[np.float64]], ArrayLike] | None = None,
    ) -> BlackBoxCurve:
        """A curve known only by its points.

        Parameters
        ----------
        x : callable
            Takes s (m,) float64 in [0, 1) and returns the points (m, 2).
        pieces : int
            Piece j is s in [j / pieces, (j + 1) / pieces): smooth inside, any jump or corner between them.
        derivative : callable, optional
            Takes s (m,) and returns dx/ds (m, 2). Without it tangents come from differences of five point
            queries inside one piece, see `BlackBoxCurve.derivative`.

        Returns
        -------
        BlackBoxCurve
            Answers `sample`, `piece` and `derivative`; what needs the pieces themselves raises ValueError.

        Examples
        --------
        >>> turn = lambda s: np.stack([np.cos(2 * np.pi * s), np.sin(2 * np.pi * s)], axis=1)
        >>> Curve.from_callable(turn).sample([0.0, 0.25]).round(12) + 0.0
        array([[1., 0.],
               [0., 1.]])
        """
        return BlackBoxCurve(PointQueries(x, pieces, derivative))

    # --- the parameter -----------------------------------------------------------------------------------

    def locate(self, s: ArrayLike, piece: ArrayLike | None = None) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Piece and local parameter of s.

        Parameters
        ----------
        s : array_like
            Any shape, in [0, 1].
        piece : array_like of int, optional
            The piece each s belongs to, broadcastable to s: at a joint s = j / k, `piece` j - 1 means the end
            of the piece before it and j the start of the next. Without it the next one is meant.

        Returns
        -------
        piece : int64 array of s's shape
        t : float64 array of s's shape, in [0, 1]

        Raises
        ------
        ValueError
            If s is outside [0, 1], `piece` does not hold it, or the curve is empty and s is not.

        Examples
        --------
        >>> bend = Curve.polyline([[0, 0], [1, 0], [1, 1]])
        >>> bend.locate([0.25, 0.5]), bend.locate(0.5, piece=0)
        ((array([0, 1]), array([0.5, 0. ])), (array(0), array(1.)))
        """
        return parameter.locate(s, piece, self.n_pieces)

    def piece(self, s: ArrayLike) -> NDArray[np.int64]:
        """Index of the piece each s lies in: int64, of s's shape, in 0 .. n_pieces - 1."""
        return self.locate(s)[0]

    def sample(self, s: ArrayLike, piece: ArrayLike | None = None) -> NDArray[np.float64]:
        """Points on the curve.

        Parameters
        ----------
        s : array_like, shape (m,) or any
            Parameters in [0, 1].
        piece : array_like of int, optional
            Which side of a joint is meant, see `locate`.

        Returns
        -------
        (m, 2) float64 ndarray, or s's shape with 2 appended
            At the ends of a piece exactly its control points.

        Examples
        --------
        >>> Curve.bezier([[[0, 0], [1, 2], [2, 0]]]).sample([0.0, 0.5])
        array([[0., 0.],
               [1., 1.]])
        """
        index, t = self.locate(s, piece)
        points = bezier.evaluate(self.control, self.degree, index.ravel(), t.ravel())
        return points.reshape((*index.shape, 2))

    def derivative(self, s: ArrayLike, piece: ArrayLike | None = None) -> NDArray[np.float64]:
        """dx/ds, shaped as in `sample`; the speed over s, so n_pieces times the speed over a piece.

        Examples
        --------
        >>> Curve.polyline([[0, 0], [1, 0], [1, 3]]).derivative([0.1, 0.9])
        array([[2., 0.],
               [0., 6.]])
        """
        index, t = self.locate(s, piece)
        velocity = bezier.derivative(self.control, self.degree, index.ravel(), t.ravel())
        return self.n_pieces * velocity.reshape((*index.shape, 2))

    # --- what the pieces tell ----------------------------------------------------------------------------

    # --- new curves from old -----------------------------------------------------------------------------

    def __add__(self, other: Curve) -> Curve:
        """The union: the pieces of both, in order."""
        if not isinstance(other, Curve):
            return NotImplemented
        return Curve(np.concatenate([self.control, other.control]), np.concatenate([self.degree, other.degree]))

    def reversed(self) -> Curve:
        """The same points the other way round: ``reversed().sample(s)`` is ``sample(1 - s)`` up to rounding."""
        rows = np.maximum(self.degree[:, None] - np.arange(4), 0)
        flipped = np.take_along_axis(self.control, rows[:, :, None], axis=1)
        return Curve(flipped[::-1], self.degree[::-1])

    def transformed(self, matrix: ArrayLike, shift: ArrayLike = (0.0, 0.0)) -> Curve:
        """The image under x -> matrix x + shift.

        Parameters
        ----------
        matrix : (2, 2) array_like
        shift : (2,) array_like

        Examples
        --------
        >>> Curve.polyline([[0, 0], [1, 0]]).transformed([[0, -1], [1, 0]], (5, 0)).sample(1.0)
        array([5., 1.])
        """
        return Curve(affine_map(matrix, shift)(self.control), self.degree)

    def to_polyline(self, tol: float) -> Curve:
        """Straight pieces that stay within `tol` of the curve, and the curve of them.

        The distance is proven from second differences (see `bezier.segment_counts`): equal steps in the
        parameter, as many as the piece's bending asks for. Lines stay as they are; joints keep their exact
        coordinates.

        Parameters
        ----------
        tol : float
            Largest deviation, > 0, in the curve's units.

        Raises
        ------
        ValueError
            If `tol` is not positive, or so small that more than 50 million segments were needed.

        Examples
        --------
        >>> arch = Curve.bezier([[[0, 0], [1, 2], [2, 0]]])
        >>> arch.to_polyline(0.01)
        Curve(10 pieces in 1 chain, open)
        """
        tol = check.number("tol", tol, low=0.0, open_low=True)
        counts = bezier.segment_counts(self.control, self.degree, tol)
        if counts.sum() > _MOST_SEGMENTS:
            raise ValueError(
                f"tol: expected one that {_MOST_SEGMENTS} segments can reach, got {tol} ({counts.sum():.3g})"
            )
        n = counts.astype(np.int64)
        piece = np.repeat(np.arange(self.n_pieces), n)
        step = np.arange(len(piece)) - np.repeat(np.cumsum(n) - n, n)
        # (step + 1) / n is the next segment's step / n, the same float: neighbours share points bit for bit.
        ends = [bezier.evaluate(self.control, self.degree, piece, (step + i) / n[piece]) for i in (0, 1)]
        return Curve._of(np.stack(ends, axis=1))

    def split_pieces(self, size: int) -> list[Curve]:
        """Consecutive curves of at most `size` pieces, which add up to this one (the decomposition of Fig. 25).

        Examples
        --------
        >>> [len(part) for part in Curve.polyline([[i, 0] for i in range(9)]).split_pieces(6)]
        [6, 2]
        """
        size = check.integer("size", size, low=1)
        return [self._part(i, min(i + size, self.n_pieces)) for i in range(0, self.n_pieces, size)]

    def _part(self, start: int, stop: int) -> Curve:
        return Curve(self.control[start:stop], self.degree[start:stop])


class BlackBoxCurve(Curve):
    """A curve that can only be asked for points: `sample`, `derivative`, `piece`, `locate`, `n_pieces`.

    It is made by `Curve.from_callable`. At the end of a piece (s = 1, or a joint with the piece before it given)
    the query is made just inside that piece, so a curve with jumps has both of its one-sided values.
    """

    _queries: PointQueries

    def __init__(self, queries: PointQueries) -> None:
        self._freeze(_queries=queries, n_pieces=queries.count)

    def __reduce__(self) -> tuple[Any, ...]:
        return (BlackBoxCurve, (self._queries,))

    def __getattribute__(self, name: str) -> Any:
        if name in _NEEDS_PIECES:
            raise ValueError(
                f"curve: {name} needs the pieces themselves, got a black box (from_callable); it answers "
                "sample, derivative and piece. Sample it and use Curve.polyline for an approximation"
            )
        return super().__getattribute__(name)

    @property
    def derivative_queries(self) -> int:  # type: ignore[override]
        """Point queries that one tangent costs: 0 where the derivative was given, else 5."""
        return self._queries.per_derivative

    def sample(self, s: ArrayLike, piece: ArrayLike | None = None) -> NDArray[np.float64]:
        """Points, one query each; parameters and shapes as in `Curve.sample`."""
        index, t = self.locate(s, piece)
        return self._queries.points(np.asarray(s, dtype=np.float64), index, t)

    def derivative(self, s: ArrayLike, piece: ArrayLike | None = None) -> NDArray[np.float64]:
        """dx/ds from the given derivative, else from five point queries inside the same piece.

        With steps of h = 2^-10 of a piece, the differences are off by h^4 / 30 |x^(5)| inside and by
        h^4 / 5 |x^(5)| at the ends of a piece (x by the local parameter), plus rounding of about 1e-12 of the
        coordinates: relative 5e-11 and 3e-10 for a circle in one piece.
        """
        index, t = self.locate(s, piece)
        return self._queries.tangents(np.asarray(s, dtype=np.float64), index, t)

    def transformed(self, matrix: ArrayLike, shift: ArrayLike = (0.0, 0.0)) -> BlackBoxCurve:
        """The image under x -> matrix x + shift, again a black box."""
        return BlackBoxCurve(self._queries.mapped(affine_map(matrix, shift), affine_map(matrix, (0.0, 0.0))))

    def _part(self, start: int, stop: int) -> BlackBoxCurve:
        return BlackBoxCurve(self._queries.window(start, stop))

    def __repr__(self) -> str:
        return f"BlackBoxCurve({self.n_pieces} piece{'s' * (self.n_pieces != 1)})"


_NEEDS_PIECES = frozenset(
    (
        "control",
        "degree",
        "coefficients",
        "chain",
        "is_closed",
        "piece_bounds",
        "bounds",
        "length",
        "to_polyline",
        "reversed",
    )
)
