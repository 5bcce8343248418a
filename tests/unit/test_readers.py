"""SVG, shapely and text readers. Truths from closed forms, svgelements' own points, shapely and fontTools' pens."""

import importlib.resources

import numpy as np
import pytest
import shapely
import svgelements
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.areaPen import AreaPen
from fontTools.pens.boundsPen import BoundsPen
from fontTools.pens.t2CharStringPen import T2CharStringPen
from fontTools.pens.ttGlyphPen import TTGlyphPen
from fontTools.ttLib import TTFont

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.svg import ARC_TOLERANCE

S = np.linspace(0.0, 1.0, 20001)


def winding(curve, point, tol=1e-4):
    """Sum of subtended angles of a fine polyline over 2 pi."""
    edges = curve.to_polyline(tol).control[:, [0, 3]] - np.asarray(point, dtype=float)
    (ax, ay), (bx, by) = edges[:, 0].T, edges[:, 1].T
    return np.arctan2(ax * by - ay * bx, ax * bx + ay * by).sum() / (2 * np.pi)


def area(curve, tol=1e-5):
    x, y = curve.to_polyline(tol).control[:, [0, 3]].transpose(2, 0, 1)
    return 0.5 * (x[:, 0] * y[:, 1] - y[:, 0] * x[:, 1]).sum()


@pytest.fixture
def svg(tmp_path):
    """Write the inside of an <svg> element to a file."""

    def write(inside, attributes=""):
        path = tmp_path / "picture.svg"
        path.write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {attributes}>'
            f"{inside}</svg>"
        )
        return path

    return write


# --- path data -------------------------------------------------------------------------------------------


def test_every_command_means_what_its_long_form_says():
    short = Curve.from_svg("m1,1h2v3H1V2l.5.5 1-1 Q3 3 4 1t1 1T6,0c0 1 1 1 1 0s1-1 1 0S9 9 9 1z")
    long = Curve.from_svg(
        "M 1 1 L 3 1 L 3 4 L 1 4 L 1 2 L 1.5 2.5 L 2.5 1.5 Q 3 3 4 1 Q 5 -1 5 2 Q 5 5 6 0 "
        "C 6 1 7 1 7 0 C 7 -1 8 -1 8 0 C 8 1 9 9 9 1 L 1 1"
    )
    assert short.degree.tolist() == long.degree.tolist() == [1] * 6 + [2] * 3 + [3] * 3 + [1]
    np.testing.assert_allclose(short.control, long.control, atol=1e-15)
    assert short.is_closed
    assert short.chain.max() == 0


@pytest.mark.parametrize(
    ("d", "ends"),
    [
        ("M 3 4 Z", [[[3, 4], [3, 4]]]),
        ("M 3 4 z z", [[[3, 4], [3, 4]]]),
        ("M 0 0 L 0 0 L 1 1", [[[0, 0], [0, 0]], [[0, 0], [1, 1]]]),
        ("M 0 0 L 1 1 L 0 0 Z", [[[0, 0], [1, 1]], [[1, 1], [0, 0]]]),
        ("M 0 0 A 0 0 0 0 1 5 5", [[[0, 0], [5, 5]]]),
        ("M 0 0 A 3 0 0 0 1 5 5", [[[0, 0], [5, 5]]]),
        ("M 2 2 A 1 1 0 0 1 2 2", [[[2, 2], [2, 2]]]),
        ("M 0 0 1 1 M 5 5 M 3 3 L 4 4", [[[0, 0], [1, 1]], [[3, 3], [4, 4]]]),
        ("M 0 0 L 1 0 1 1 Z L 5 5", [[[0, 0], [1, 0]], [[1, 0], [1, 1]], [[1, 1], [0, 0]], [[0, 0], [5, 5]]]),
        ("M 1 1 l 1 0 0 1 z m 1 1 l 1 1", [[[1, 1], [2, 1]], [[2, 1], [2, 2]], [[2, 2], [1, 1]], [[2, 2], [3, 3]]]),
    ],
)
def test_degenerate_paths_survive(d, ends):
    curve = Curve.from_svg(d)
    assert curve.control[:, [0, 3]].tolist() == ends
    assert (curve.degree == 1).all()


def test_rounding_adds_no_closing_edge():
    square = Curve.from_svg("m 0.1 0.1 h .2 v .2 h -.2 v -.2 z")  # 0.1 + 0.2 - 0.2 is not 0.1
    assert len(square) == 4
    assert square.is_closed


@pytest.mark.parametrize("d", ["M 1 0 A 1 1 0 0 1 -1 0 A 1 1 0 0 1 1 0 Z", "M1 0a1 1 0 11-2 0a1 1 0 112 0z"])
def test_circle_is_within_the_stated_tolerance(d):
    circle = Curve.from_svg(d)
    off = np.abs(np.hypot(*circle.sample(S).T) - 1).max()
    assert 1e-8 < off <= ARC_TOLERANCE
    assert len(circle) == 12
    assert circle.is_closed
    np.testing.assert_allclose(abs(area(circle, 1e-8)), np.pi, rtol=1e-6)


@pytest.mark.parametrize(
    ("radii", "rotation", "flags"),
    [((5, 2), 30, "1 1"), ((5, 2), 30, "0 0"), ((5, 2), 30, "0 1"), ((5, 2), 30, "1 0"), ((9, 2e-3), 0, "0 1")],
)
def test_elliptical_arcs_lie_on_their_ellipse(radii, rotation, flags):
    end = (3, 1) if radii[1] > 1 else (3, 0)
    d = f"M 0 0 A {radii[0]} {radii[1]} {rotation} {flags} {end[0]} {end[1]}"
    curve, truth = Curve.from_svg(d), svgelements.Path(d)[1]
    centre, u, v = (np.array([p.x, p.y], dtype=float) for p in (truth.center, truth.prx, truth.pry))
    frame = np.stack([u - centre, v - centre], axis=1)
    np.testing.assert_allclose(np.linalg.norm(frame, axis=0), radii, rtol=1e-9)
    unit = np.linalg.solve(frame, (curve.sample(S) - centre).T)
    assert np.abs(np.hypot(*unit) - 1).max() <= ARC_TOLERANCE  # off the ellipse: at most this times an axis
    assert curve.sample(0.0).tolist() == [0, 0]
    assert curve.sample(1.0).tolist() == list(end)
    along = np.array([[p.x, p.y] for p in (truth.point(t) for t in np.linspace(0, 1, 401))], dtype=float)
    away = shapely.distance(shapely.points(along), shapely.LineString(curve.sample(S)))
    assert away.max() <= 2 * ARC_TOLERANCE * radii[0]  # the same arc of the four


def test_arc_too_small_is_scaled_up():
    arc = Curve.from_svg("M -3 0 A 1 1 0 0 1 3 0")
    assert np.abs(np.hypot(*arc.sample(S).T) - 3).max() <= 3 * ARC_TOLERANCE


@pytest.mark.parametrize(
    ("d", "message"),
    [
        ("hello", "expected an existing SVG file or path data that begins with M, got 'hello'"),
        ("", "expected an existing SVG file or path data"),
        ("0 0 L 1 1", "expected an existing SVG file or path data"),
        ("M 0 0 L 1", "L lacks numbers at character 9"),
        ("M 0 0 L", "L lacks numbers"),
        ("M 0 0 L 1 1 garbage", "'g' is no command at character 12"),
        ("M 0 0 L 1 1; DROP", "L lacks numbers at character 11"),
        ("M0 0,", "a comma leads nowhere"),
        ("M 0 0 1,,1", "M lacks numbers"),
        ("M 0 0 Z 1 1", "'1' is no command"),
        ("M 0 0 L nan 1", "L lacks numbers"),
        ("M 0 0 L 1e999 0", "1e999 is too large"),
        ("M 0 0 A 1 1 0 2 1 3 3", "a flag is not 0 or 1"),
        ("M 0 0 C 1 1 2 2", "C lacks numbers"),
        ("M 1 1", "expected path data that draws something"),
        ("missing.svg", "expected an existing SVG file"),
        ("m1.svg", "expected an existing SVG file"),
    ],
)
def test_garbage_is_refused(d, message):
    with pytest.raises(ValueError, match=f"^path_or_d: .*{message}"):
        Curve.from_svg(d)


def test_numbers_are_no_path():
    with pytest.raises(TypeError, match="path_or_d: expected a file name or SVG path data, got int"):
        Curve.from_svg(3)


# --- documents -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "pieces", "box", "length"),
    [
        ('<rect x="1" y="2" width="3" height="4"/>', 4, (1, 2, 4, 6), 14.0),
        ('<rect width="4" height="4" rx="1"/>', 16, (0, 0, 4, 4), 8 + 2 * np.pi),
        ('<circle cx="5" cy="6" r="2"/>', 12, (3, 4, 7, 8), 4 * np.pi),
        ('<ellipse cx="0" cy="1" rx="2" ry="2"/>', 12, (-2, -1, 2, 3), 4 * np.pi),
        ('<line x1="0" y1="0" x2="3" y2="4"/>', 1, (0, 0, 3, 4), 5.0),
        ('<polyline points="0,0 3,0 3,4"/>', 2, (0, 0, 3, 4), 7.0),
        ('<polygon points="0 0 3 0 3 4"/>', 3, (0, 0, 3, 4), 12.0),
        ('<path d="M 0 0 H 3 V 4 Z"/>', 3, (0, 0, 3, 4), 12.0),
    ],
)
def test_shapes(svg, shape, pieces, box, length):
    curve = Curve.from_svg(svg(shape))
    assert len(curve) == pieces
    np.testing.assert_allclose(curve.bounds, box, atol=1e-14)
    np.testing.assert_allclose(curve.length, length, rtol=1e-6)
    assert curve.is_closed is not ("line" in shape)


def test_transforms_nest_and_act_on_arcs_exactly(svg):
    inside = '<g transform="translate(10,20) rotate(30)"><circle r="2" transform="skewX(40) scale(3 1)"/></g>'
    curve = Curve.from_svg(svg(inside))
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    matrix = np.array([[c, -s], [s, c]]) @ [[1, np.tan(np.radians(40))], [0, 1]] @ [[3, 0], [0, 1]]
    unit = np.linalg.solve(2 * matrix, (curve.sample(S) - (10, 20)).T)
    assert np.abs(np.hypot(*unit) - 1).max() <= ARC_TOLERANCE
    assert curve.is_closed
    assert curve.chain.max() == 0


def test_use_and_symbol_are_drawn_where_they_are_used(svg):
    inside = (
        '<defs><path id="a" d="M 0 0 L 1 0"/></defs><symbol id="b"><path d="M 0 0 L 0 1"/></symbol>'
        '<clipPath id="c"><rect width="9" height="9"/></clipPath>'
        '<use href="#a" x="5"/><use xlink:href="#a" transform="scale(2)"/><use href="#b" y="3"/>'
        '<path d="M 0 0 L 7 7" display="none"/><text>no outline</text>'
    )
    curve = Curve.from_svg(svg(inside))
    assert curve.control[:, [0, 3]].tolist() == [[[5, 0], [6, 0]], [[0, 0], [2, 0]], [[0, 3], [0, 4]]]


@pytest.mark.parametrize("size", ["", 'width="210mm" height="297mm"', 'width="50%"'])
def test_coordinates_are_those_of_the_view_box(svg, size):
    curve = Curve.from_svg(svg('<path d="M 12 7 L 13 9"/>', f'viewBox="10 5 100 50" {size}'))
    assert curve.bounds == (12.0, 7.0, 13.0, 9.0)
    assert Curve.from_svg(svg('<path d="M 12 7 L 13 9"/>', size)).bounds == (12.0, 7.0, 13.0, 9.0)


def test_flip_y_mirrors():
    d = "M 0 0 H 2 V 1 Z"  # clockwise on screen, counter-clockwise with y up
    assert winding(Curve.from_svg(d), (1.5, 0.5)) == pytest.approx(1.0)
    assert winding(Curve.from_svg(d, flip_y=True), (1.5, -0.5)) == pytest.approx(-1.0)
    assert Curve.from_svg(d, flip_y=True).is_closed


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ("", "expected at least one drawn shape"),
        ("<text>only</text>", "expected at least one drawn shape"),
        ("<path/>", "expected at least one drawn shape"),
        ('<path id="p" d="M 0 0 L 1"/>', "d of <path id=p> in .*: expected SVG path data, L lacks numbers"),
        ('<polygon points="0,0 1,1 2"/>', "expected pairs of numbers in points of <polygon>"),
        ('<polyline points="0,0 a,b"/>', "expected pairs of numbers in points"),
        ('<circle r="abc"/>', "expected a length in r of <circle>, got 'abc'"),
        ('<rect width="1" height="1" transform="spin(3)"/>', "expected a list of SVG transforms"),
        ('<rect width="1" height="1" transform="rotate(90) x"/>', "expected a list of SVG transforms"),
        ('<rect width="1" height="1" transform="matrix(1 0 0 1 0)"/>', "expected a list of SVG transforms"),
        ('<use href="#none"/>', "expected the id of an element of the file in href of <use>, got '#none'"),
        ('<g id="a"><use href="#a"/></g>', "without circular use"),
        ("<path", "which is not XML"),
    ],
)
def test_broken_documents_are_refused(svg, inside, message):
    with pytest.raises(ValueError, match=f"^path_or_d: .*{message}"):
        Curve.from_svg(svg(inside))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("M 0 0 L 1 1", "which is not XML"),
        ("<html/>", "expected an <svg> document, got <html>"),
        ('<svg viewBox="0 0 0 1"/>', "expected viewBox of 4 numbers"),
        ('<svg viewBox="0 0 1"/>', "expected viewBox of 4 numbers"),
    ],
)
def test_files_that_are_no_svg_are_refused(tmp_path, text, message):
    (tmp_path / "x.svg").write_text(text)
    with pytest.raises(ValueError, match=f"^path_or_d: .*{message}"):
        Curve.from_svg(tmp_path / "x.svg")
    with pytest.raises(ValueError, match="expected an existing SVG file"):
        Curve.from_svg(tmp_path)


def test_the_shipped_picture_has_holes_in_holes_and_open_strokes():
    with importlib.resources.as_file(importlib.resources.files("nqr_geom") / "data" / "fish.svg") as path:
        fish = Curve.from_svg(path, flip_y=True)
    assert sorted(set(fish.degree.tolist())) == [1, 2, 3]
    assert not fish.is_closed
    chains = [Curve(fish.control[fish.chain == i], fish.degree[fish.chain == i]) for i in range(fish.chain[-1] + 1)]
    closed = [chain for chain in chains if chain.is_closed]
    assert (len(chains), len(closed)) == (21, 12)

    def inside(x, y):
        return round(sum(winding(chain, (x, -y)) for chain in closed), 9)

    body, eye, pupil, fin_hole, bubble, outside = (150, 150), (268, 134), (288, 134), (211, 62), (372, 70), (390, 200)
    assert [inside(*p) for p in (body, eye, pupil, fin_hole, bubble, outside)] == [1, 0, 1, 0, 0, 0]


# --- shapely ---------------------------------------------------------------------------------------------


def test_polygons_are_one_inside_and_zero_in_holes_whatever_their_orientation():
    shell, hole = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (2, 1), (2, 2), (1, 2)]
    for outer in (shell, shell[::-1]):
        for inner in (hole, hole[::-1]):
            polygon = shapely.Polygon(outer, [inner])
            curve = Curve.from_shapely(polygon)
            assert (len(curve), curve.is_closed) == (8, True)
            assert [round(winding(curve, p), 12) for p in [(3, 3), (1.5, 1.5), (5, 5)]] == [1, 0, 0]
            assert area(curve) == polygon.area
            assert curve.length == polygon.length
            assert curve.bounds == polygon.bounds


def test_collections_keep_order_and_direction():
    line, ring = shapely.LineString([(0, 0, 9), (1, 1, 9), (2, 0, 9)]), shapely.LinearRing([(5, 5), (5, 6), (6, 5)])
    both = shapely.GeometryCollection(
        [shapely.MultiLineString([line]), ring, shapely.MultiPolygon([shapely.box(8, 8, 9, 9)])]
    )
    curve = Curve.from_shapely(both)
    assert curve.control[:5, 0].tolist() == [[0, 0], [1, 1], [5, 5], [5, 6], [6, 5]]
    assert np.bincount(curve.chain).tolist() == [2, 3, 4]
    assert winding(curve.split_pieces(2)[1] + curve.split_pieces(2)[2], (5.2, 5.2)) < 0  # the ring stays clockwise


@pytest.mark.parametrize("empty", [shapely.Polygon(), shapely.LineString(), shapely.GeometryCollection()])
def test_empty_geometries_are_empty_curves(empty):
    assert len(Curve.from_shapely(empty)) == 0


@pytest.mark.parametrize("points", [shapely.Point(0, 0), shapely.MultiPoint([(0, 0), (1, 1)])])
def test_points_are_refused(points):
    with pytest.raises(ValueError, match=f"geometry: expected .* got {points.geom_type}"):
        Curve.from_shapely(points)
    with pytest.raises(ValueError, match="geometry: expected"):
        Curve.from_shapely(shapely.GeometryCollection([points]))
    with pytest.raises(TypeError, match="geometry: expected a shapely geometry, got list"):
        Curve.from_shapely([(0, 0), (1, 1)])


# --- text ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dejavu():
    import matplotlib

    return TTFont(f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf")


@pytest.mark.parametrize("character", list("oA8&ég%iQ"))
def test_glyphs_agree_with_fonttools_pens(dejavu, character):
    glyphs = dejavu.getGlyphSet()
    glyph = glyphs[dejavu.getBestCmap()[ord(character)]]
    bounds, signed = BoundsPen(glyphs), AreaPen(glyphs)
    glyph.draw(bounds)
    glyph.draw(signed)
    curve = Curve.from_text(character, size=dejavu["head"].unitsPerEm)  # font units
    np.testing.assert_allclose(curve.bounds, bounds.bounds, atol=1e-9)
    np.testing.assert_allclose(area(curve, 1e-3), abs(signed.value), rtol=1e-5)
    assert curve.is_closed
    on_grid = curve.control * 4  # on-curve points may be midpoints of integers, twice in a composite
    assert (on_grid == np.rint(on_grid)).all()


def test_strokes_are_one_and_counters_zero():
    o = Curve.from_text("o")
    xmin, ymin, xmax, ymax = o.bounds
    assert sorted(set(o.degree.tolist())) == [2]
    assert o.chain.max() == 1
    assert winding(o, ((xmin + xmax) / 2, (ymin + ymax) / 2)) == pytest.approx(0, abs=1e-12)
    assert winding(o, (xmin + 0.05, (ymin + ymax) / 2)) == pytest.approx(1)


def test_size_and_advance(dejavu):
    one, big = Curve.from_text("il"), Curve.from_text("il", size=12.0)
    np.testing.assert_allclose(big.control, 12 * one.control, rtol=1e-15)
    advance = dejavu["hmtx"]["i"][0] / dejavu["head"].unitsPerEm
    l_alone = Curve.from_text("l")
    np.testing.assert_allclose(one.control[-len(l_alone) :], np.add(l_alone.control, (advance, 0)), atol=1e-15)
    assert len(Curve.from_text("")) == len(Curve.from_text(" ")) == 0


def build_font(path, glyph, cff):
    """A font with the one letter "a"."""
    builder = FontBuilder(1000, isTTF=not cff)
    builder.setupGlyphOrder([".notdef", "a"])
    builder.setupCharacterMap({ord("a"): "a"})
    if cff:
        empty = T2CharStringPen(600, None).getCharString()
        builder.setupCFF("Test", {}, {".notdef": empty, "a": glyph}, {})
    else:
        builder.setupGlyf({".notdef": TTGlyphPen(None).glyph(), "a": glyph})
    builder.setupHorizontalMetrics({".notdef": (600, 0), "a": (600, 0)})
    builder.setupHorizontalHeader(ascent=800, descent=-200)
    builder.setupPost()
    builder.save(path)
    return path


def test_cff_gives_cubics(tmp_path):
    pen = T2CharStringPen(600, None)
    pen.moveTo((0, 0))
    pen.curveTo((300, 0), (500, 200), (500, 500))
    pen.lineTo((0, 500))
    pen.closePath()
    curve = Curve.from_text("aa", font=build_font(tmp_path / "a.otf", pen.getCharString(), cff=True), size=1000)
    assert curve.degree.tolist() == [3, 1, 1, 3, 1, 1]
    assert curve.control[0].tolist() == [[0, 0], [300, 0], [500, 200], [500, 500]]
    assert curve.control[3].tolist() == [[600, 0], [900, 0], [1100, 200], [1100, 500]]
    assert curve.is_closed


def test_a_contour_without_points_on_the_curve(tmp_path):
    pen = TTGlyphPen(None)
    pen.qCurveTo((0, 0), (101, 0), (101, 100), (0, 100), None)
    pen.closePath()
    curve = Curve.from_text("a", font=str(build_font(tmp_path / "a.ttf", pen.glyph(), cff=False)), size=1000)
    assert curve.degree.tolist() == [2] * 4
    assert curve.is_closed
    assert {(50.5, 0.0), (101.0, 50.0), (50.5, 100.0), (0.0, 50.0)} == set(map(tuple, curve.control[:, 0]))
    assert area(curve) > 0


def test_text_guards(tmp_path, dejavu):
    broken, cut = tmp_path / "broken.ttf", tmp_path / "cut.ttf"
    broken.write_text("no font at all")
    with open(dejavu.reader.file.name, "rb") as whole:
        cut.write_bytes(whole.read(20_000))
    for arguments, error, message in [
        (("a\n",), ValueError, r"text: expected characters of the font, got '\\n'"),
        (("\U0010ffff",), ValueError, "text: expected characters of the font"),
        ((3,), TypeError, "text: expected a string, got int"),
        (("a", None, 0.0), ValueError, "size: expected a number > 0.0"),
        (("a", "missing.ttf"), ValueError, "font: expected an existing font file, got 'missing.ttf'"),
        (("a", broken), ValueError, "font: expected a sound TrueType or OpenType font"),
        (("a", cut), ValueError, "font: expected a sound TrueType or OpenType font"),
        (("a", 3), TypeError, "font: expected the path of a font file, got int"),
    ]:
        with pytest.raises(error, match=message):
            Curve.from_text(*arguments)


def test_a_missing_default_font_names_the_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"text without an explicit font need matplotlib: pip install"):
        Curve.from_text("a")
