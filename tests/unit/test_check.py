"""Every guard fires, names its argument, and says what was expected and what came."""

from __future__ import annotations

import re

import numpy as np
import pytest

from nqr_geom import check

NAN, INF = float("nan"), float("inf")

REFUSED = [
    (lambda: check.array("p", [[0, 1, 2]], ("m", 2)), ValueError, "p: expected shape (m, 2), got (1, 3)"),
    (lambda: check.array("p", 3.0, ("m",)), ValueError, "p: expected shape (m,), got ()"),
    (lambda: check.array("p", [[1, 2], [3]], ("m", 2)), TypeError, "p: expected numbers, got [[1, 2], [3]]"),
    (lambda: check.array("p", ["a"], ("m",)), TypeError, "p: expected numbers, got ['a']"),
    (lambda: check.array("p", [1j], ("m",)), TypeError, "p: expected numbers, got [1j]"),
    (lambda: check.array("p", None, ("m",)), ValueError, "p: expected shape (m,), got ()"),
    (lambda: check.array("p", [0.0, NAN], ("m",)), ValueError, "p: expected finite numbers, got nan at index (1,)"),
    (lambda: check.array("p", [[0, 1], [INF, 2]], ("m", 2)), ValueError, "got inf at index (1, 0)"),
    (lambda: check.number("a", "x"), TypeError, "a: expected a number, got 'x'"),
    (lambda: check.number("a", None), TypeError, "a: expected a number, got None"),
    (lambda: check.number("a", NAN), ValueError, "a: expected a number that is finite, got nan"),
    (lambda: check.number("a", INF, low=0), ValueError, "a: expected a number >= 0, got inf"),
    (lambda: check.number("a", -1, low=0.0), ValueError, "a: expected a number >= 0.0, got -1"),
    (lambda: check.number("a", 0, low=0.0, open_low=True), ValueError, "a: expected a number > 0.0, got 0"),
    (lambda: check.number("a", 2, low=0.0, high=1.0), ValueError, "a: expected a number >= 0.0 and <= 1.0, got 2"),
    (lambda: check.number("a", 2, high=1.0), ValueError, "a: expected a number <= 1.0, got 2"),
    (lambda: check.integer("n", True), TypeError, "n: expected an integer, got True"),
    (lambda: check.integer("n", np.True_), TypeError, "n: expected an integer, got"),
    (lambda: check.integer("n", 3.0), TypeError, "n: expected an integer, got 3.0"),
    (lambda: check.integer("n", "3"), TypeError, "n: expected an integer, got '3'"),
    (lambda: check.integer("n", 0, low=1), ValueError, "n: expected an integer >= 1, got 0"),
    (lambda: check.integer("n", 9, low=1, high=8), ValueError, "n: expected an integer >= 1 and <= 8, got 9"),
    (lambda: check.choice("m", "c", ["a", "b"]), ValueError, "m: expected one of a, b, got 'c'"),
    (lambda: check.choice("m", 1, ["a"]), ValueError, "m: expected one of a, got 1"),
    (lambda: check.choice("m", ["a"], ["a"]), ValueError, "m: expected one of a, got ['a']"),
    (
        lambda: check.require("no_such_module", "plot", "frontier plots"),
        ImportError,
        'frontier plots need no_such_module: pip install "nqr-geom[plot]"',
    ),
]


@pytest.mark.parametrize(("call", "error", "message"), REFUSED, ids=[message for *_, message in REFUSED])
def test_refused(call, error, message):
    with pytest.raises(error, match=re.escape(message)):
        call()


def test_long_values_are_cut_short_in_messages():
    with pytest.raises(TypeError) as caught:
        check.number("a", "x" * 10_000)
    assert len(str(caught.value)) < 150
    with pytest.raises(TypeError, match=re.escape("a: expected a number, got array of shape (3,) and dtype float64")):
        check.number("a", np.zeros(3))


def test_accepted():
    points = check.array("p", [[0, 1]], ("m", 2))
    assert points.dtype == np.float64
    own = np.zeros((3, 2))
    assert check.array("p", own, ("m", 2)) is own  # no copy of what is right already
    assert check.array("p", np.zeros((0, 2)), ("m", 2)).shape == (0, 2)
    assert check.array("p", [0.0, NAN], ("m",), finite=False).shape == (2,)
    assert check.array("p", np.zeros(2, dtype=np.float32), (2,)).dtype == np.float64
    assert check.number("a", np.float32(0.5), low=0, high=0.5) == 0.5
    assert check.number("a", 0, low=0.0) == 0.0
    value = check.integer("n", np.int64(3), low=3, high=3)
    assert value == 3
    assert type(value) is int
    assert check.choice("m", "b", {"a": 1, "b": 2}) == "b"
    assert check.require("math", "learn", "roots").pi > 3.0
