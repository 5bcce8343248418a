"""How curves come in: arrays, SVG, shapely geometries and text. The parsing itself is done by `readers`."""

from __future__ import annotations

import os
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.curves import readers
from nqr_geom.curves.pieces import Pieces

__all__ = ["Constructors"]


_PIECES = ("k", "degree + 1", 2)


def _is_none(points: ArrayLike) -> bool:
    """Whether this is an empty list or array: no points, in no particular shape."""
    return (isinstance(points, (list, tuple)) and not points) or getattr(points, "shape", None) == (0,)


class Constructors(Pieces):
    """Pieces that can be made from what people bring; `Curve` inherits these class methods.

    Examples
    --------
    >>> Constructors.polyline([[0, 0], [3, 4]]).length
    5.0
    """

    @classmethod
    def polyline(cls, points: ArrayLike, closed: bool = False) -> Self:
        """Straight pieces through the points.

        Parameters
        ----------
        points : (n, 2) array_like
            Vertices. None gives the empty curve, one a piece of length zero.
        closed : bool
            Return to the first point, unless the last one is the first already.

        Returns
        -------
        Curve
            n - 1 pieces, n if an edge was added.

        Examples
        --------
        >>> from nqr_geom.curves.curve import Curve
        >>> Curve.polyline([[0, 0], [3, 4]]).length
        5.0
        """
        vertices = check.array("points", np.zeros((0, 2)) if _is_none(points) else points, ("n", 2))
        if len(vertices) == 1 or (closed and len(vertices) and (vertices[0] != vertices[-1]).any()):
            vertices = np.concatenate([vertices, vertices[:1]])
        pairs = np.stack([vertices[:-1], vertices[1:]], axis=1)
        return cls._of(pairs)

    @classmethod
    def bezier(cls, control_points: ArrayLike) -> Self:
        """Bezier pieces of one degree.

        Parameters
        ----------
        control_points : (k, degree + 1, 2) array_like
            Degree 1, 2 or 3. Consecutive pieces are connected where the end of one equals the start of the next.

        Returns
        -------
        Curve
            k pieces.

        Examples
        --------
        >>> from nqr_geom.curves.curve import Curve
        >>> arch = Curve.bezier([[[0, 0], [1, 2], [2, 0]]])
        >>> arch.bounds
        (0.0, 0.0, 2.0, 1.0)
        """
        empty = np.zeros((0, 2, 2))
        points = check.array("control_points", empty if _is_none(control_points) else control_points, _PIECES)
        if points.shape[1] not in (2, 3, 4):
            raise ValueError(
                f"control_points: expected 2, 3 or 4 points a piece (degree 1, 2 or 3), got {points.shape[1]}"
            )
        return cls._of(points)

    @classmethod
    def _of(cls, points: NDArray[np.float64]) -> Self:
        """Pieces (k, degree + 1, 2) of one degree."""
        degree = points.shape[1] - 1
        rows = np.minimum(np.arange(4), degree)
        return cls(points[:, rows], np.full(len(points), degree))

    @classmethod
    def from_svg(cls, path_or_d: str | os.PathLike[str], *, flip_y: bool = False) -> Self:
        """The outlines of an SVG file, or of path data.

        Every drawn path, rect, circle, ellipse, line, polyline and polygon gives its outline, whatever its fill or
        stroke; `use`, `symbol` and transforms are resolved; text, images, markers and clip paths give nothing.
        A path without Z stays open. An arc with a zero radius is a line, ``M x y Z`` a piece of length zero.

        Parameters
        ----------
        path_or_d : str or path
            A file, or path data such as ``"M 0 0 L 1 0 A 1 1 0 0 1 0 1 Z"``.
        flip_y : bool
            SVG's y axis points down. False keeps the numbers as they are in the file: what is drawn clockwise
            on screen is counter-clockwise (+1) to this library, whose y axis points up. True negates y:
            a plot with y up shows the picture upright, and turning senses are those on screen.

        Returns
        -------
        Curve
            In the user units of the outermost view box. Elliptical arcs become cubics of at most 30 degrees, no
            farther from the arc than 4e-7 of its larger semi-axis; everything else is exact.

        Raises
        ------
        ValueError
            If the file is missing, not XML, not SVG or draws nothing; if path data, points, lengths, transforms
            or a reference break the grammar.

        Examples
        --------
        >>> from nqr_geom.curves.curve import Curve
        >>> Curve.from_svg("M 0 0 H 1 V 1 H 0 Z").length
        4.0
        """
        control, degree = readers.read_svg(path_or_d)
        return cls(control * (1.0, -1.0) if flip_y else control, degree)

    @classmethod
    def from_shapely(cls, geometry: Any) -> Self:
        """The lines of a shapely geometry.

        Parameters
        ----------
        geometry : shapely geometry
            (Multi)LineString, LinearRing, (Multi)Polygon or GeometryCollection of these; z is dropped. Polygons run
            counter-clockwise and their holes clockwise, so that the winding number is 1 inside and 0 in holes;
            lines and rings keep their direction.

        Returns
        -------
        Curve
            One straight piece an edge. An empty geometry gives the empty curve.

        Raises
        ------
        TypeError, ValueError
            If it is no shapely geometry, or one with points.

        Examples
        --------
        >>> from nqr_geom.curves.curve import Curve
        >>> import shapely
        >>> Curve.from_shapely(shapely.box(0, 0, 2, 1)).length
        6.0
        """
        return cls(*readers.read_shapely(geometry))

    @classmethod
    def from_text(cls, text: str, font: str | os.PathLike[str] | None = None, size: float = 1.0) -> Self:
        """The outlines of a line of text, exactly as the font draws them.

        Parameters
        ----------
        text : str
            Characters of the font, set side by side by their advance widths, without kerning; the base line
            is y = 0 and the pen starts at x = 0.
        font : path, optional
            A TrueType (quadratics) or OpenType/CFF (cubics) file. Default: DejaVu Sans, which comes with matplotlib.
        size : float
            Length of the em square in the curve's units, > 0.

        Returns
        -------
        Curve
            Closed. Each glyph is turned so that its area is positive: the winding number is 1 inside the strokes
            and 0 in a counter, such as that of "o"; where contours of a glyph overlap it adds up.

        Raises
        ------
        ValueError
            If the font is missing or broken, or lacks a character.
        ImportError
            If no font is given and matplotlib is not installed.

        Examples
        --------
        >>> from nqr_geom.curves.curve import Curve
        >>> Curve.from_text("o")
        Curve(16 pieces in 2 chains, closed)
        """
        return cls(*readers.read_text(text, font, size))
