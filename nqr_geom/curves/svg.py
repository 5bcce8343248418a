"""SVG documents and path data as Bezier pieces: checked strictly here, then parsed by svgelements.

svgelements reads what it understands and drops the rest in silence, so the text is held against the grammar of
SVG 1.1 first, and whatever does not fit is refused by name. Shapes are taken in their own coordinates, arcs
become cubics there, and only then the transforms act on the control points: this is exact under skews too.
"""

from __future__ import annotations

import io
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom.curves.bezier import pack

__all__ = ["ARC_TOLERANCE", "check_path_data", "read_svg"]

Floats = NDArray[np.float64]

ARC_TOLERANCE = 4e-7
"""Largest distance between an elliptical arc and its cubics, relative to the larger semi-axis."""

_ARC_STEP = math.pi / 6.0  # 30 degrees: the cubic with tangent length 4/3 tan(step/4) is off by 3.7e-7 radii
_CLOSING = 1e-15  # a closing edge shorter than this, relative to the coordinates, is rounding

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_SEPARATOR = r"(?:\s+,?\s*|,\s*)"
_TOKEN = re.compile(_NUMBER)
_GAP = re.compile(rf"{_SEPARATOR}?")
_COUNT = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_LENGTH = re.compile(rf"\s*{_NUMBER}(?:px|pt|pc|mm|cm|in|em|ex|%)?\s*")
_POINTS = re.compile(rf"\s*(?:{_NUMBER}{_SEPARATOR}?{_NUMBER}(?:{_SEPARATOR}?|$))*\s*")
_ARGUMENTS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}
_TRANSFORM = re.compile(rf"\s*(\w+)\s*\(\s*((?:{_NUMBER}{_SEPARATOR}?)*)\s*\)\s*,?")
_LENGTHS = {
    "rect": ("x", "y", "width", "height", "rx", "ry"),
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "line": ("x1", "y1", "x2", "y2"),
    "use": ("x", "y"),
}
_HREF = ("href", "{http://www.w3.org/1999/xlink}href")
_NAMESPACE = "{http://www.w3.org/2000/svg}"


def read_svg(path_or_d: str | os.PathLike[str]) -> tuple[Floats, NDArray[np.int64]]:
    """Control points (k, 4, 2) and degrees (k,) of a file or of path data; see `Curve.from_svg`.

    Examples
    --------
    >>> control, degree = read_svg("M 0 0 H 2 Q 3 0 3 1")
    >>> degree.tolist()
    [1, 2]
    """
    if not isinstance(path_or_d, (str, os.PathLike)):
        raise TypeError(f"path_or_d: expected a file name or SVG path data, got {type(path_or_d).__name__}")
    text = os.fspath(path_or_d)
    is_data = isinstance(path_or_d, str) and re.match(r"\s*[Mm]\s*[-+.\d]", text) is not None
    if os.path.isfile(text) or not is_data or text.lower().endswith(".svg"):
        return pack(list(_document_pieces(text)))
    check_path_data("path_or_d", text)
    import svgelements

    pieces = list(_pieces(svgelements.Path(text)))
    if not pieces:
        raise ValueError(f"path_or_d: expected path data that draws something, got {text!r}")
    return pack(pieces)


def check_path_data(name: str, d: str) -> None:
    """Hold path data against the grammar; raise ValueError naming `name` and the place where it leaves it.

    Examples
    --------
    >>> check_path_data("d", "M0,0 1-1a1 1 0 01.5.5z")
    >>> check_path_data("d", "M 0 0 L 1")
    Traceback (most recent call last):
    ValueError: d: expected SVG path data, L lacks numbers at character 9 of 'M 0 0 L 1'
    """

    def refuse(what: str) -> ValueError:
        shown = d if len(d) <= 60 else f"{d[:57]}..."
        return ValueError(f"{name}: expected SVG path data, {what} at character {at} of {shown!r}")

    at = len(d) - len(d.lstrip())
    if d[at : at + 1] not in ("M", "m") and d.strip():
        raise refuse("it must begin with M or m, which lacks")
    while at < len(d):
        command = d[at]
        if command.upper() not in _COUNT:
            raise refuse(f"{command!r} is no command")
        at += 1
        while at < len(d) and d[at].isspace():
            at += 1
        count, groups = _COUNT[command.upper()], 0
        while count and (groups == 0 or (at < len(d) and not d[at].isalpha())):
            for i in range(count):
                flag = command in "Aa" and i in (3, 4)
                match = re.compile("[01]").match(d, at) if flag else _TOKEN.match(d, at)
                if match is None:
                    raise refuse(f"{command} lacks numbers" if at == len(d) or not flag else "a flag is not 0 or 1")
                if not math.isfinite(float(match.group())):
                    raise refuse(f"{match.group()} is too large")
                at = match.end()
                gap = _GAP.match(d, at)
                # A comma promises another number; before a command or the end there is none.
                after = at if gap is None else gap.end()
                if "," in d[at:after] and (after == len(d) or d[after].isalpha()):
                    raise refuse("a comma leads nowhere")
                at = after
            groups += 1


def _document_pieces(path: str) -> Iterator[Floats]:
    """Pieces of every shape of a file, in drawing order."""
    root = _parse(path)
    _check_elements(path, root)
    _use_viewbox_units(path, root)
    for parent in list(root.iter()):
        for position, child in enumerate(list(parent)):
            # Drawn only through `use`, which finds it in here as well; svgelements would draw it in place.
            if child.tag == f"{_NAMESPACE}symbol":
                parent[position] = hidden = ElementTree.Element(f"{_NAMESPACE}defs")
                hidden.append(child)
    import svgelements

    try:
        document = svgelements.SVG.parse(io.BytesIO(ElementTree.tostring(root)), reify=False)
    except RecursionError as error:
        raise ValueError(f"path_or_d: expected SVG without circular use, got it in {path!r}") from error
    empty = True
    for element in document.elements():
        if isinstance(element, svgelements.Shape):
            m = element.transform
            for piece in _pieces(element.segments(transformed=False)):
                empty = False
                x, y = piece[:, 0], piece[:, 1]
                # Element by element, so that equal points keep equal images bit for bit.
                yield np.stack([m.a * x + m.c * y + m.e, m.b * x + m.d * y + m.f], axis=1)
    if empty:
        raise ValueError(
            f"path_or_d: expected at least one drawn shape (path, rect, circle, ellipse, line, polyline, polygon), "
            f"got none in {path!r}"
        )


def _parse(path: str) -> ElementTree.Element:
    if not os.path.isfile(path):
        shown = path if len(path) <= 80 else f"{path[:77]}..."
        raise ValueError(f"path_or_d: expected an existing SVG file or path data that begins with M, got {shown!r}")
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, UnicodeError, ValueError, LookupError) as error:
        raise ValueError(f"path_or_d: expected an SVG file, got {path!r} which is not XML: {error}") from error
    except OSError as error:
        raise ValueError(f"path_or_d: expected a readable SVG file, got {path!r}: {error}") from error
    if root.tag not in ("svg", f"{_NAMESPACE}svg"):
        raise ValueError(f"path_or_d: expected an <svg> document, got <{root.tag}> in {path!r}")
    return root


def _use_viewbox_units(path: str, root: ElementTree.Element) -> None:
    """Make the viewport as large as the view box: then coordinates are the numbers in the file, not pixels."""
    box = root.attrib.pop("viewBox", None)
    if box is None:
        return
    numbers = _TOKEN.findall(box)
    if not re.fullmatch(rf"\s*(?:{_NUMBER}{_SEPARATOR}?){{4}}\s*", box) or min(map(float, numbers[2:])) <= 0.0:
        raise ValueError(f"path_or_d: expected viewBox of 4 numbers with a positive size, got {box!r} in {path!r}")
    root.set("width", numbers[2])
    root.set("height", numbers[3])
    root.attrib.pop("preserveAspectRatio", None)


def _check_elements(path: str, root: ElementTree.Element) -> None:
    """Refuse attributes that svgelements would drop or cut short in silence."""
    names = {element.get("id") for element in root.iter()}
    for element in root.iter():
        tag = str(element.tag).removeprefix(_NAMESPACE)
        label = f"<{tag}{' id=' + element.attrib['id'] if 'id' in element.attrib else ''}>"

        def refuse(key: str, expected: str, got: str, label: str = label) -> ValueError:
            return ValueError(f"path_or_d: expected {expected} in {key} of {label}, got {got!r} in {path!r}")

        if tag == "path":
            d = element.attrib.setdefault("d", "")  # svgelements stumbles over a path without any
            check_path_data(f"path_or_d: d of {label} in {path!r}", d)
        if tag in ("polyline", "polygon") and not _POINTS.fullmatch(element.get("points", "")):
            raise refuse("points", "pairs of numbers", element.get("points", ""))
        for key in _LENGTHS.get(tag, ()):
            value = element.get(key, "0")
            if not _LENGTH.fullmatch(value) and not (key in ("rx", "ry") and value.strip() == "auto"):
                raise refuse(key, "a length", value)
        if "transform" in element.attrib and not _is_transform(element.attrib["transform"]):
            raise refuse("transform", "a list of SVG transforms", element.attrib["transform"])
        if tag == "use":
            target = next((element.attrib[key] for key in _HREF if key in element.attrib), "")
            if not target.startswith("#") or target[1:] not in names:
                raise refuse("href", "the id of an element of the file", target)


def _is_transform(text: str) -> bool:
    at = 0
    while at < len(text.rstrip()):
        match = _TRANSFORM.match(text, at)
        if match is None or len(_TOKEN.findall(match[2])) not in _ARGUMENTS.get(match[1], ()):
            return text.strip() == "none"
        at = match.end()
    return True


def _pieces(segments: Iterable[Any]) -> Iterator[Floats]:
    """Control polygons of svgelements' segments; neighbours share their points bit for bit."""
    start = at = np.zeros(2)
    last: Floats | None = None  # held back one step, because closing may move its end
    drawn = False
    for segment in segments:
        kind = type(segment).__name__
        if kind == "Move":
            start = at = _point(segment.end)
            drawn = False
            continue
        if kind == "Close":
            gap = np.abs(at - start).max()
            if last is not None and drawn and gap <= _CLOSING * np.abs(last).max():
                last[-1] = start
                at = start
                continue
            new = [np.stack([at, start])] if gap > 0.0 or not drawn else []
        elif kind == "Arc":
            new = _arc(segment, at)
        else:
            inner = [getattr(segment, name) for name in ("control", "control1", "control2") if hasattr(segment, name)]
            new = [np.stack([at, *map(_point, inner), _point(segment.end)])]
        for piece in new:
            if last is not None:
                yield last
            last = piece
            at = piece[-1].copy()
        drawn = True
    if last is not None:
        yield last


def _point(point: Any) -> Floats:
    return np.array([float(point.x), float(point.y)])


def _arc(arc: Any, start: Floats) -> list[Floats]:
    """Cubics of an elliptical arc in steps of at most 30 degrees; a straight line where a radius is 0."""
    end, centre = _point(arc.end), _point(arc.center)
    u, v = _point(arc.prx) - centre, _point(arc.pry) - centre
    sweep = float(arc.sweep)
    if sweep == 0.0 or not u.any() or not v.any():
        return [np.stack([start, end])]
    n = max(1, math.ceil(abs(sweep) / _ARC_STEP - 1e-9))
    angle = float(arc.get_start_t()) + sweep * np.arange(n + 1) / n
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    points = centre + cosine * u + sine * v
    points[0], points[-1] = start, end
    tangents = (4.0 / 3.0 * math.tan(sweep / n / 4.0)) * (cosine * v - sine * u)
    return [
        np.stack([points[i], points[i] + tangents[i], points[i + 1] - tangents[i + 1], points[i + 1]]) for i in range(n)
    ]
