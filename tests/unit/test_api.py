"""The public doors: they agree with the integrator, refuse bad arguments by name, and need only what they use."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom.curves import families
from nqr_geom.curves.curve import Curve

POINTS = np.array([[0.25, 0.5], [1.5, 0.5], [0.4, -0.3]])


@pytest.mark.parametrize("method", ["mc", "stratified", "trapezoid", "structured", "sobol+regression-3"])
def test_sampled_answers_are_those_of_the_integrator(square: Curve, method: str) -> None:
    direct = ng.integrate(ng.problems.gwn(square, POINTS), 24, method=method, seed=5)
    np.testing.assert_array_equal(ng.gwn(square, POINTS, method=method, n=24, seed=5), direct.value[:, 0])
    direct = ng.integrate(ng.problems.sd(square, POINTS, alpha=9.0), 24, method=method, seed=5)
    np.testing.assert_array_equal(ng.sd(square, POINTS, alpha=9.0, method=method, n=24, seed=5), direct.value[:, 0])


def test_sampler_and_rule_may_be_named_apart(square: Curve) -> None:
    problem = ng.problems.gwn(square, POINTS)
    one = ng.integrate(problem, sampler="sobol", rule="trapezoid", seed=1)
    two = ng.integrate(problem, method="sobol+trapezoid", seed=1)
    np.testing.assert_array_equal(one.value, two.value)


def test_exact_and_auto(square: Curve) -> None:
    np.testing.assert_array_equal(ng.gwn(square, POINTS, method="auto"), [1.0, 0.0, 0.0])
    black_box = Curve.from_callable(square.sample, pieces=4)
    np.testing.assert_allclose(ng.gwn(black_box, POINTS, method="auto"), [1.0, 0.0, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="black"):
        ng.gwn(black_box, POINTS)


@pytest.mark.parametrize("method", ["exact", "structured"])
def test_full_output(square: Curve, method: str) -> None:
    estimate = ng.gwn(square, POINTS, method=method, n=16, full_output=True)
    np.testing.assert_allclose(estimate.value[:, 0], [1.0, 0.0, 0.0], atol=1e-12)
    assert estimate.counts["queries"] == (0 if method == "exact" else 48)
    assert estimate.plan["problem"] == "gwn"
    assert estimate.seconds > 0.0


def test_tolerance_is_met_and_costs_grow_only_where_needed(square: Curve) -> None:
    points = np.random.default_rng(3).uniform(-1.0, 2.0, (2000, 2))
    points = points[ng.distance(square, points) > 0.01]
    estimate = ng.gwn(square, points, method="stratified", tol=1e-3, full_output=True)
    assert (np.abs(estimate.value[:, 0] - ng.gwn(square, points)) < 1e-3).mean() > 0.99
    assert estimate.plan["met"]
    levels = estimate.plan["levels"]
    assert levels[0]["rows"] == len(points) > 10 * levels[-1]["rows"]
    assert [level["n"] for level in levels] == sorted(level["n"] for level in levels)


def test_unreachable_tolerance_says_so(square: Curve) -> None:
    estimate = ng.gwn(square, [[0.5, 1e-7]], method="mc", tol=1e-12, n=4096, full_output=True)
    assert not estimate.plan["met"]


@pytest.mark.parametrize("method", ["inet", "stratified+inet-gwn-uniform"])
def test_networks_see_long_curves_in_parts(method: str) -> None:
    curve = families.knots()
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (300, 2))
    points = points[ng.distance(curve, points) > 1e-2]
    estimate = ng.gwn(curve, points, method=method, n=32, full_output=True)
    truth = ng.gwn(curve, points)
    error = np.mean((estimate.value[:, 0] - truth) ** 2)
    plain = np.mean((ng.gwn(curve, points, method="mc", n=32 * 5) - truth) ** 2)
    assert estimate.plan["parts"] == 5
    assert estimate.value.shape == (len(points), 1)
    assert estimate.counts["samples"] == 32 * 5 * len(points)
    assert error < plain / 10.0


def test_several_shapes_in_one_problem(square: Curve, bowtie: Curve) -> None:
    problem = ng.problems.gwn([square, bowtie], POINTS)
    assert problem.groups.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(problem.reference()[:3, 0], ng.gwn(square, POINTS))


def test_part_of_a_batch_sees_the_same_numbers(square: Curve) -> None:
    problem = ng.problems.gwn(square, POINTS)
    whole = ng.integrate(problem, method="structured", n=16, seed=3).value
    for row in range(3):
        part = ng.integrate(problem.take(slice(row, row + 1)), method="structured", n=16, seed=3).value
        np.testing.assert_array_equal(part[0], whole[row])


BAD = {
    "curve": (lambda c: ng.gwn("M0 0", POINTS), TypeError, "curve: expected a Curve"),
    "curves": (lambda c: ng.problems.gwn([c, 3], POINTS), TypeError, "curve: expected a Curve or a sequence"),
    "shape": (lambda c: ng.gwn(c, [1.0, 2.0]), ValueError, r"points: expected shape \(m, 2\), got \(2,\)"),
    "nan": (lambda c: ng.gwn(c, [[np.nan, 0.0]]), ValueError, "points: expected finite"),
    "text": (lambda c: ng.distance(c, [["a", "b"]]), TypeError, "points: expected numbers"),
    "method": (lambda c: ng.gwn(c, POINTS, method="magic"), ValueError, "method: expected one of"),
    "sampler": (lambda c: ng.gwn(c, POINTS, method="magic+mc"), ValueError, "sampler: expected one of random"),
    "n": (lambda c: ng.gwn(c, POINTS, method="mc", n=0), ValueError, "n: expected an integer >= 1, got 0"),
    "n float": (lambda c: ng.gwn(c, POINTS, method="mc", n=3.5), TypeError, "n: expected an integer"),
    "tol": (lambda c: ng.gwn(c, POINTS, method="mc", tol=-1.0), ValueError, "tol: expected a number > 0"),
    "seed": (lambda c: ng.gwn(c, POINTS, method="mc", seed=0.5), TypeError, "seed: expected an integer"),
    "alpha": (lambda c: ng.sd(c, POINTS, alpha=-1.0), ValueError, "alpha: expected a number > 0"),
    "alpha nan": (lambda c: ng.sd(c, POINTS, alpha=np.nan), ValueError, "alpha: expected a number"),
    "sign": (lambda c: ng.signed_distance(c, POINTS, sign="magic"), ValueError, "sign: expected one of"),
    "replicates": (
        lambda c: ng.integrate(ng.problems.gwn(c, POINTS), replicates=0),
        ValueError,
        "replicates: expected an integer >= 1",
    ),
    "rule elsewhere": (
        lambda c: ng.gwn(c, POINTS, method="random+sd-hermite"),
        ValueError,
        "needs the feature 'alpha'",
    ),
    "family": (lambda c: ng.problems.toy(0), ValueError, "expected an integer >= 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_named(square: Curve, name: str) -> None:
    call, error, message = BAD[name]
    with pytest.raises(error, match=message):
        call(square)


def test_missing_extra_is_one_clear_sentence() -> None:
    code = """
import sys
sys.modules["torch"] = None
import nqr_geom as ng
square = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
assert ng.gwn(square, [[0.5, 0.5]]).tolist() == [1.0]
estimate = ng.gwn(square, [[0.5, 0.5]], full_output=True)
assert estimate.value.tolist() == [[1.0]]
try:
    ng.gwn(square, [[0.5, 0.5]], method="mc")
except ImportError as error:
    print(error)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == """methods such as 'mc' need torch: pip install "nqr-geom[learn]\""""


def test_unknown_public_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        ng.magic  # noqa: B018
    assert {"gwn", "sd", "Curve", "integrate"} <= set(dir(ng))
