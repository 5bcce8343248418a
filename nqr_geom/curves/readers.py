"""Shapely geometries and font outlines as Bezier pieces. SVG has its own file, `svg`."""

from __future__ import annotations

import os
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.curves.bezier import pack
from nqr_geom.curves.svg import read_svg

__all__ = ["read_shapely", "read_svg", "read_text"]

Floats = NDArray[np.float64]
Pieces = tuple[Floats, NDArray[np.int64]]


def read_shapely(geometry: Any) -> Pieces:
    """Control points (k, 4, 2) and degrees (k,) of a geometry's lines; see `Curve.from_shapely`.

    Examples
    --------
    >>> import shapely
    >>> control, degree = read_shapely(shapely.box(0, 0, 1, 1))
    >>> len(degree)
    4
    """
    import shapely

    if not isinstance(geometry, shapely.Geometry):
        raise TypeError(f"geometry: expected a shapely geometry, got {type(geometry).__name__}")
    edges = [np.zeros((0, 2, 2))]
    for line in _lines(geometry):
        vertices = shapely.get_coordinates(line)
        edges.append(np.stack([vertices[:-1], vertices[1:]], axis=1))
    pairs = np.concatenate(edges)
    return pairs[:, [0, 1, 1, 1]], np.ones(len(pairs), dtype=np.int64)


def _lines(geometry: Any) -> list[Any]:
    """The linear parts in order; polygons with the inside on the left, so that holes run clockwise."""
    import shapely

    if isinstance(geometry, shapely.Polygon):
        turned = shapely.geometry.polygon.orient(geometry, 1.0)
        return [] if turned.is_empty else [turned.exterior, *turned.interiors]
    if isinstance(geometry, shapely.LineString):  # LinearRing is one
        return [geometry]
    if isinstance(geometry, (shapely.MultiLineString, shapely.MultiPolygon, shapely.GeometryCollection)):
        return [line for part in geometry.geoms for line in _lines(part)]
    raise ValueError(
        "geometry: expected (Multi)LineString, LinearRing, (Multi)Polygon or a collection of them, "
        f"got {geometry.geom_type}"
    )


def read_text(text: str, font: str | os.PathLike[str] | None = None, size: float = 1.0) -> Pieces:
    """Control points (k, 4, 2) and degrees (k,) of a line of text; see `Curve.from_text`.

    Examples
    --------
    >>> control, degree = read_text("o")
    >>> sorted(set(degree.tolist()))
    [2]
    """
    if not isinstance(text, str):
        raise TypeError(f"text: expected a string, got {type(text).__name__}")
    size = check.number("size", size, low=0.0, open_low=True)
    outlines, em = _read_glyphs(text, _font_path(font))
    pieces: list[Floats] = []
    pen_x = 0.0
    for outline, width in outlines:
        pieces += [np.add(piece, (pen_x, 0.0)) * (size / em) for piece in outline]
        pen_x += width
    return pack(pieces)


def _font_path(font: str | os.PathLike[str] | None) -> str | os.PathLike[str]:
    if font is None:
        matplotlib = check.require("matplotlib", "plot", "text without an explicit font")
        return os.path.join(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")
    if not isinstance(font, (str, os.PathLike)):
        raise TypeError(f"font: expected the path of a font file, got {type(font).__name__}")
    return font


# What fontTools lets through where a table is cut short, missing or inconsistent.
_BROKEN_FONT = (AssertionError, AttributeError, EOFError, IndexError, KeyError, TypeError, struct.error, zlib.error)


def _read_glyphs(text: str, font: str | os.PathLike[str]) -> tuple[list[tuple[list[Floats], float]], int]:
    """Outline and advance width of every character in font units, and the units of the em square."""
    from fontTools.ttLib import TTFont, TTLibError

    try:
        with open(font, "rb") as file:
            face = TTFont(file, fontNumber=0, lazy=True)
            glyphs, names = face.getGlyphSet(), face.getBestCmap() or {}
            missing = next((character for character in text if ord(character) not in names), None)
            if missing is not None:
                raise ValueError(f"text: expected characters of the font, got {missing!r} which it lacks")
            line = [glyphs[names[ord(character)]] for character in text]
            return [(_outline(glyph, glyphs), glyph.width) for glyph in line], face["head"].unitsPerEm
    except OSError as error:
        raise ValueError(f"font: expected an existing font file, got {os.fspath(font)!r}: {error}") from error
    except (TTLibError, *_BROKEN_FONT) as error:
        raise ValueError(f"font: expected a sound TrueType or OpenType font, got {font!r}: {error!r}") from error


def _outline(glyph: Any, glyphs: Any) -> list[Floats]:
    """A glyph's contours in font units, closed, components resolved, turned to positive signed area."""
    from fontTools.pens.recordingPen import DecomposingRecordingPen

    pen = DecomposingRecordingPen(glyphs)
    glyph.draw(pen)
    contours: list[list[Floats]] = []
    for verb, points in pen.value:
        if verb == "moveTo":
            contours.append([])
            start = at = np.array(points[0], dtype=np.float64)
        elif verb in ("closePath", "endPath"):
            if (at != start).any():
                contours[-1].append(np.stack([at, start]))
        else:
            if verb == "qCurveTo" and points[-1] is None:  # a contour without any point on the curve
                start = at = (np.array(points[-2], dtype=np.float64) + points[0]) / 2.0
                contours.append([])
                points = (*points[:-1], tuple(start))
            for inner in _segments(verb, points):
                contours[-1].append(np.array([at, *inner], dtype=np.float64))
                at = contours[-1][-1][-1]
    pieces = [piece for contour in contours for piece in contour]
    # TrueType fills clockwise outlines and CFF counter-clockwise ones; the area tells, whatever the font does.
    if sum(map(_swept_area, pieces)) < 0.0:
        pieces = [piece[::-1] for contour in contours for piece in reversed(contour)]
    return pieces


def _segments(verb: str, points: Any) -> Any:
    """Points of each piece after its start: implied points on the curve are made explicit."""
    from fontTools.pens.basePen import decomposeQuadraticSegment, decomposeSuperBezierSegment

    if verb == "lineTo":
        return [points]
    if verb == "qCurveTo":
        return decomposeQuadraticSegment(points) if len(points) > 1 else [points]
    return decomposeSuperBezierSegment(points) if len(points) > 3 else [points]


def _swept_area(piece: Floats) -> float:
    """Signed area between a piece and the origin, 1/2 integral of x dy - y dx, exact for degree 1 to 3."""
    x, y = piece[:, 0], piece[:, 1]
    cross = x[:, None] * y - y[:, None] * x
    weights = _AREA_WEIGHTS[len(piece) - 1]
    return float(sum(weight * cross[i, j] for (i, j), weight in weights.items()))


# For Bernstein polynomials: 1/2 integral of (b_i b_j' - b_j b_i') for i < j.
_AREA_WEIGHTS = {
    1: {(0, 1): 1 / 2},
    2: {(0, 1): 1 / 3, (1, 2): 1 / 3, (0, 2): 1 / 6},
    3: {(0, 1): 3 / 10, (0, 2): 3 / 20, (0, 3): 1 / 20, (1, 2): 3 / 20, (1, 3): 3 / 20, (2, 3): 3 / 10},
}
