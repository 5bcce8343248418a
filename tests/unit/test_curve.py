"""Curve: data, parameter, what follows from the pieces, black boxes. Truths from scipy, fontTools and shapely."""

import pickle

import numpy as np
import pytest
import shapely
from fontTools.misc import bezierTools
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly

from nqr_geom.curves.curve import Curve

RNG = np.random.default_rng(20)
LINES, QUADRATICS, CUBICS = (RNG.uniform(-1, 1, (5, d + 1, 2)) for d in (1, 2, 3))
MIXED = Curve.bezier(LINES) + Curve.bezier(QUADRATICS) + Curve.bezier(CUBICS)
SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


def circle(s):
    return np.stack([np.cos(2 * np.pi * s), np.sin(2 * np.pi * s)], axis=1)


def circle_derivative(s):
    return 2 * np.pi * np.stack([-np.sin(2 * np.pi * s), np.cos(2 * np.pi * s)], axis=1)


# --- data ------------------------------------------------------------------------------------------------


def test_layout_repeats_the_last_point_and_is_read_only():
    assert MIXED.control.shape == (15, 4, 2)
    assert MIXED.degree.tolist() == [1] * 5 + [2] * 5 + [3] * 5
    assert MIXED.degree.dtype == np.int64
    assert (MIXED.control[:5, 1:] == LINES[:, 1:]).all()
    assert (MIXED.control[5:10, 3] == QUADRATICS[:, 2]).all()
    for array in (MIXED.control, MIXED.degree, MIXED.coefficients, MIXED.chain, MIXED.piece_bounds):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError, match="immutable"):
        MIXED.n_pieces = 3


def test_input_is_copied():
    points = np.array(SQUARE, dtype=float)
    curve = Curve.polyline(points)
    points[:] = 7.0
    assert curve.bounds == (0.0, 0.0, 1.0, 1.0)


def test_pickle_keeps_bits():
    copy = pickle.loads(pickle.dumps(MIXED))
    assert (copy.control == MIXED.control).all()
    assert not copy.control.flags.writeable


@pytest.mark.parametrize(
    ("points", "closed", "pieces", "is_closed"),
    [
        ([], False, 0, True),
        ([], True, 0, True),
        (np.zeros((0, 2)), False, 0, True),
        ([[1, 2]], False, 1, True),
        ([[1, 2]], True, 1, True),
        (SQUARE, False, 3, False),
        (SQUARE, True, 4, True),
        ([*SQUARE, SQUARE[0]], True, 4, True),
        ([*SQUARE, SQUARE[0]], False, 4, True),
        ([[0, 0], [0, 0], [1, 0]], False, 2, False),
        ([[-0.0, 0.0], [1, 0], [0.0, -0.0]], True, 2, True),
    ],
)
def test_polyline_closing(points, closed, pieces, is_closed):
    curve = Curve.polyline(points, closed)
    assert len(curve) == curve.n_pieces == pieces
    assert curve.is_closed is is_closed
    assert curve.control[:, 0].tobytes() == np.roll(curve.control[:, 3], 1, axis=0).tobytes() or not is_closed


def test_empty_curve_answers():
    empty = Curve.polyline([])
    assert empty.length == 0.0
    assert empty.sample([]).shape == (0, 2)
    assert len(empty.to_polyline(0.1)) == len(empty.reversed()) == len(empty + empty) == 0
    assert empty.split_pieces(6) == []
    assert len(Curve.bezier([])) == 0
    with pytest.raises(ValueError, match="bounds: expected a curve with at least one piece"):
        _ = empty.bounds
    with pytest.raises(ValueError, match="s: expected none"):
        empty.sample(0.5)


def test_chains():
    two = Curve.polyline(SQUARE, closed=True) + Curve.bezier([[[5, 5], [6, 7], [7, 5]], [[7, 5], [6, 3], [5, 5]]])
    assert two.chain.tolist() == [0, 0, 0, 0, 1, 1]
    assert two.is_closed
    assert not (two + Curve.polyline([[9, 9], [8, 8]])).is_closed
    assert repr(two) == "Curve(6 pieces in 2 chains, closed)"


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: Curve.polyline([0, 1]), ValueError, r"points: expected shape \(n, 2\), got \(2,\)"),
        (lambda: Curve.polyline([[0, 1], [2]]), TypeError, "points: expected numbers"),
        (lambda: Curve.polyline([[0, np.nan], [1, 1]]), ValueError, "points: expected finite numbers, got nan"),
        (lambda: Curve.polyline([[0, np.inf], [1, 1]]), ValueError, "points: expected finite numbers, got inf"),
        (lambda: Curve.bezier(np.zeros((2, 5, 2))), ValueError, "control_points: expected 2, 3 or 4 points .* got 5"),
        (lambda: Curve.bezier(np.zeros((2, 3))), ValueError, "control_points: expected shape"),
        (lambda: Curve([[[0, 0]] * 4], [4]), ValueError, "degree: expected 1, 2 or 3, got 4"),
        (lambda: Curve([[[0, 0]] * 4], [1, 1]), ValueError, "degree: expected 1 integers"),
        (lambda: Curve([[[0, 0]] * 4], [1.0]), ValueError, "degree: .* dtype float64"),
        (lambda: Curve.polyline([[0, 1e301], [0, 0]]), ValueError, "expected coordinates up to 1e.300"),
        (lambda: MIXED.sample(1.5), ValueError, r"s: expected numbers in \[0, 1\], got 1.5"),
        (lambda: MIXED.sample([0.5, -1e-9]), ValueError, r"s: .* got -1e-09"),
        (lambda: MIXED.sample(np.nan), ValueError, "s: expected finite numbers"),
        (lambda: MIXED.sample([[1], [1, 2]]), TypeError, "s: expected numbers"),
        (lambda: MIXED.sample(0.5, piece=3), ValueError, "piece: expected the piece that holds s, got 3"),
        (lambda: MIXED.sample(0.5, piece=15), ValueError, "piece: "),
        (lambda: MIXED.sample(0.5, piece=7.0), TypeError, "piece: expected integers"),
        (lambda: MIXED.sample([0.5], piece=[7, 7]), ValueError, "piece: expected the shape of s"),
        (lambda: MIXED.to_polyline(0.0), ValueError, "tol: expected a number > 0.0"),
        (lambda: MIXED.to_polyline(1e-30), ValueError, "tol: expected one that 50000000 segments can reach"),
        (lambda: MIXED.split_pieces(0), ValueError, "size: expected an integer >= 1"),
        (lambda: MIXED.transformed(np.eye(3)), ValueError, "matrix: expected shape"),
        (lambda: MIXED.transformed(np.eye(2), 3.0), ValueError, "shift: expected shape"),
        (lambda: MIXED + 3, TypeError, "unsupported operand"),
        (lambda: Curve.from_callable(3), TypeError, "x: expected a callable"),
        (lambda: Curve.from_callable(circle, 0), ValueError, "pieces: expected an integer >= 1"),
        (lambda: Curve.from_callable(circle, 1, 2.0), TypeError, "derivative: expected a callable"),
    ],
)
def test_guards(make, error, message):
    with pytest.raises(error, match=message):
        make()


# --- the parameter ---------------------------------------------------------------------------------------


def test_parameter_contract():
    s = RNG.random(1000)
    assert (MIXED.piece(s) == np.minimum(np.floor(s * 15), 14)).all()
    index, t = MIXED.locate(s)
    assert (t == s * 15 - index).all()
    assert MIXED.locate(1.0) == (14, 1.0)


@given(st.integers(1, 20000), st.integers(0, 19999))
@settings(max_examples=200, deadline=None)
def test_a_joint_belongs_to_the_next_piece_whatever_the_rounding(k, j):
    j %= k
    curve = Curve(np.zeros((k, 4, 2)), np.ones(k, dtype=int))
    assert curve.locate(j / k) == (j, 0.0)
    assert curve.locate((j + 1) / k, piece=j) == (j, 1.0)


def test_ends_of_pieces_are_control_points_bit_for_bit():
    j = np.arange(15)
    assert MIXED.sample(j / 15).tobytes() == MIXED.control[:, 0].tobytes()
    assert MIXED.sample((j + 1) / 15, piece=j).tobytes() == MIXED.control[:, 3].tobytes()
    assert MIXED.sample(1.0).tobytes() == MIXED.control[14, 3].tobytes()
    far = Curve.bezier([[[1e17, 0.1], [3.0, 0.3]]]) + Curve.bezier([[[3.0, 0.3], [-1e17, 7.0], [0.7, 0.1]]])
    assert (far.sample([0.5, 0.5, 1.0], piece=[0, 1, 1]) == [[3.0, 0.3], [3.0, 0.3], [0.7, 0.1]]).all()


def test_shapes_follow_s():
    assert MIXED.sample(0.3).shape == (2,)
    assert MIXED.sample(np.full((3, 4), 0.3)).shape == MIXED.derivative(np.full((3, 4), 0.3)).shape == (3, 4, 2)
    assert (MIXED.sample(np.full((3, 4), 0.3)) == MIXED.sample(0.3)).all()


@pytest.mark.parametrize("points", [LINES, QUADRATICS, CUBICS], ids=["lines", "quadratics", "cubics"])
def test_points_tangents_and_coefficients_are_the_bernstein_polynomial(points):
    curve, t = Curve.bezier(points), np.linspace(0.0, 1.0, 17)
    for j in range(len(points)):
        truth = BPoly(points[j][:, None], [0.0, 1.0])
        s, piece = (j + t) / len(points), np.full(17, j)
        np.testing.assert_allclose(curve.sample(s, piece), truth(t), atol=2e-15)
        np.testing.assert_allclose(curve.derivative(s, piece) / len(points), truth.derivative()(t), atol=2e-14)
        power = sum(curve.coefficients[j, i] * t[:, None] ** i for i in range(4))
        np.testing.assert_allclose(power, truth(t), atol=5e-15)
        np.testing.assert_allclose(curve.coefficients[j].sum(axis=0), points[j][-1], atol=5e-15)


# --- what the pieces tell --------------------------------------------------------------------------------


def test_bounds_agree_with_fonttools():
    for control, degree, box in zip(MIXED.control, MIXED.degree, MIXED.piece_bounds, strict=True):
        points = [tuple(map(float, p)) for p in control[: degree + 1]]
        if degree == 1:
            truth = (*np.min(points, axis=0), *np.max(points, axis=0))
        else:
            truth = (bezierTools.calcQuadraticBounds if degree == 2 else bezierTools.calcCubicBounds)(*points)
        np.testing.assert_allclose(box, truth, atol=1e-14)
    low, high = MIXED.piece_bounds[:, :2].min(axis=0), MIXED.piece_bounds[:, 2:].max(axis=0)
    assert MIXED.bounds == (*low, *high)


@pytest.mark.parametrize("scale", [1e-170, 1.0, 1e160])
def test_bounds_closed_form_at_any_scale(scale):
    arch = Curve.bezier(scale * np.array([[[0, 0], [0, 4], [4, 4], [4, 0]]]))  # y = 12 t (1 - t)
    np.testing.assert_allclose(arch.bounds, scale * np.array([0, 0, 4, 3]), rtol=1e-15)
    assert Curve.polyline([[3, 4], [3, 4]]).bounds == (3.0, 4.0, 3.0, 4.0)


@pytest.mark.parametrize("scale", [1e-170, 1.0, 1e160])
@pytest.mark.parametrize(
    ("points", "length"),
    [
        ([[0, 0], [3, 4]], 5.0),
        ([[0, 0], [4, 0], [1, 0]], 25 / 7),  # overshoots to 16/7 and comes back
        ([[0, 0], [1, 0], [2, 0], [3, 0]], 3.0),
        ([[1, 1], [1, 1], [1, 1]], 0.0),
        ([[0, 0], [0.5, 0], [1, 1]], (2 * np.sqrt(5) + np.arcsinh(2)) / 4),  # y = x^2
        ([[1, -1], [-1 / 3, 1], [-1 / 3, -1], [1, 1]], 2 * (13 * np.sqrt(13) - 8) / 27),  # (u^2, u^3): a cusp inside
    ],
    ids=["line", "overshoot", "even cubic", "point", "parabola", "cusp"],
)
def test_length_closed_forms(points, length, scale):
    np.testing.assert_allclose(Curve.bezier([np.array(points) * scale]).length, length * scale, rtol=1e-12)


def test_length_agrees_with_fonttools_and_shapely():
    truth = sum(bezierTools.calcQuadraticArcLength(*map(tuple, points)) for points in QUADRATICS)
    np.testing.assert_allclose(Curve.bezier(QUADRATICS).length, truth, rtol=1e-12)
    vertices = RNG.random((50, 2))
    np.testing.assert_allclose(Curve.polyline(vertices).length, shapely.LineString(vertices).length, rtol=1e-14)


@pytest.mark.parametrize("tol", [0.1, 1e-3, 1e-5])
def test_polyline_stays_within_tol_and_is_not_wasteful(tol):
    curve = Curve.bezier(QUADRATICS) + Curve.bezier(CUBICS)
    flat = curve.to_polyline(tol)
    assert (flat.degree == 1).all()
    line = shapely.multilinestrings(shapely.linestrings(flat.control[:, [0, 1]]))
    off = shapely.distance(shapely.points(curve.sample(np.linspace(0, 1, 20001))), line)
    assert off.max() <= tol * (1 + 1e-9)
    parabola = Curve.bezier([[[0, 0], [1, 2], [2, 0]]])  # second difference 4: off by 1/n^2 at the middle of a step
    assert len(parabola.to_polyline(tol)) == np.ceil(1 / np.sqrt(tol))


def test_polyline_keeps_lines_joints_and_chains():
    loop = Curve.bezier([[[0, 0], [1, 3], [2, 0]], [[2, 0], [1, -0.3], [0, 0]]])
    flat = loop.to_polyline(1e-3)
    assert flat.is_closed
    assert flat.chain.max() == 0
    assert {(0.0, 0.0), (2.0, 0.0)} <= set(map(tuple, flat.control[:, 0]))
    square = Curve.polyline(SQUARE, closed=True)
    assert (square.to_polyline(1e-9).control == square.control).all()


# --- new curves from old ---------------------------------------------------------------------------------


def test_reversed():
    s = RNG.random(100)
    back = MIXED.reversed()
    np.testing.assert_allclose(back.sample(s), MIXED.sample(1 - s), atol=1e-13)
    np.testing.assert_allclose(back.derivative(s), -MIXED.derivative(1 - s), atol=1e-11)
    assert (back.reversed().control == MIXED.control).all()


def test_transformed_and_still_connected():
    matrix, shift = np.array([[0.3, -1.7], [2.1, 0.4]]), np.array([1e3, -7.0])
    s = RNG.random(100)
    image = MIXED.transformed(matrix, shift)
    np.testing.assert_allclose(image.sample(s), MIXED.sample(s) @ matrix.T + shift, atol=1e-12)
    star = Curve.polyline(RNG.random((101, 2)), closed=True).transformed(matrix, shift)
    assert star.is_closed
    assert star.chain.max() == 0


def test_split_adds_up_again():
    parts = MIXED.split_pieces(6)
    assert [len(part) for part in parts] == [6, 6, 3]
    assert ((parts[0] + parts[1] + parts[2]).control == MIXED.control).all()


# --- black boxes -----------------------------------------------------------------------------------------


def steps(pieces, seen):
    """A curve that jumps at every joint; it keeps what it was asked."""

    def x(s):
        seen.append(s.copy())
        index = np.floor(s * pieces)
        return np.stack([index, s], axis=1)

    return x


@pytest.mark.parametrize("pieces", [1, 3, 6, 49, 107])
def test_black_box_is_never_asked_across_a_joint(pieces):
    seen = []
    curve = Curve.from_callable(steps(pieces, seen), pieces)
    j = np.arange(pieces)
    assert curve.sample(j / pieces)[:, 0].tolist() == j.tolist()
    assert curve.sample((j + 1) / pieces, piece=j)[:, 0].tolist() == j.tolist()
    assert curve.sample(1.0)[0] == pieces - 1
    s = np.concatenate([j / pieces, (j + 1) / pieces, RNG.random(200)])
    piece = np.concatenate([j, j, np.floor(s[2 * pieces :] * pieces).astype(int)])
    tangent = curve.derivative(s, piece)
    assert (tangent[:, 0] == 0.0).all()  # any value of another piece would show as a jump over a tiny step
    np.testing.assert_allclose(tangent[:, 1], 1.0, atol=1e-9)
    asked = np.concatenate(seen)
    assert asked.min() >= 0.0
    assert asked.max() < 1.0
    assert seen[-1].size == curve.derivative_queries * s.size == 5 * s.size


@pytest.mark.parametrize("pieces", [1, 7])
def test_difference_tangents_are_as_accurate_as_documented(pieces):
    curve = Curve.from_callable(circle, pieces)
    s = np.linspace(0, 1, 1001)
    error = np.abs(curve.derivative(s) - circle_derivative(s)).max(axis=1) / (2 * np.pi)
    inside = np.abs(s - 0.5) < 0.49
    assert error.max() < 3e-10
    assert error[inside].max() < 5e-11
    assert error.max() > 1e-14  # it is a difference, not the formula


def test_given_derivative_is_used_and_costs_no_point():
    curve = Curve.from_callable(circle, 2, circle_derivative)
    assert curve.derivative_queries == 0
    s = RNG.random(10)
    assert (curve.derivative(s) == circle_derivative(s)).all()
    assert (curve.sample(s) == circle(s)).all()


def test_black_box_windows_and_images():
    curve = Curve.from_callable(circle, 8)
    part = curve.split_pieces(3)[1]
    assert [p.n_pieces for p in curve.split_pieces(3)] == [3, 3, 2]
    s = RNG.random(50)
    np.testing.assert_allclose(part.sample(s), circle(3 / 8 * (1 + s)), atol=1e-15)
    np.testing.assert_allclose(part.derivative(s), 3 / 8 * circle_derivative(3 / 8 * (1 + s)), atol=1e-10)
    assert (part.split_pieces(2)[1].sample(0.0) == circle(np.array([5 / 8]))).all()
    matrix = np.array([[2.0, 1.0], [0.0, -1.0]])
    for derivative in (None, circle_derivative):
        image = Curve.from_callable(circle, 8, derivative).transformed(matrix, (3.0, 4.0)).split_pieces(3)[1]
        np.testing.assert_allclose(image.sample(s), part.sample(s) @ matrix.T + (3.0, 4.0), atol=1e-14)
        np.testing.assert_allclose(image.derivative(s), part.derivative(s) @ matrix.T, atol=1e-9)


@pytest.mark.parametrize("name", ["control", "degree", "coefficients", "chain", "is_closed", "bounds", "length"])
def test_black_box_refuses_what_needs_pieces(name):
    with pytest.raises(ValueError, match=f"curve: {name} needs the pieces themselves"):
        getattr(Curve.from_callable(circle), name)


def test_black_box_refuses_methods_and_unions():
    box = Curve.from_callable(circle)
    for attempt in (lambda: box.to_polyline(0.1), lambda: box.reversed(), lambda: box + MIXED, lambda: MIXED + box):
        with pytest.raises(ValueError, match=r"curve: .* needs the pieces themselves"):
            attempt()
    assert repr(box) == "BlackBoxCurve(1 piece)"


@pytest.mark.parametrize(
    ("x", "error", "message"),
    [
        (lambda s: s, ValueError, r"x\(s\): expected shape \(m, 2\)"),
        (lambda s: circle(s)[:1], ValueError, r"x\(s\): expected shape \(3, 2\), got \(1, 2\)"),
        (lambda s: circle(s) * np.nan, ValueError, r"x\(s\): expected finite numbers"),
        (lambda s: "no", TypeError, r"x\(s\): expected numbers"),
    ],
)
def test_black_box_answers_are_checked(x, error, message):
    with pytest.raises(error, match=message):
        Curve.from_callable(x).sample([0.1, 0.2, 0.3])
    with pytest.raises(error, match=message.replace("x", "derivative", 1)):
        Curve.from_callable(circle, derivative=x).derivative([0.1, 0.2, 0.3])
