"""Hard cases of the classical rules, as one table: name, rule, samples, what they must give, tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.integrator.problem import Observation, Samples


def samples(x, f, *, h=None, integral=1.0, pdf=None, design="random", stratum=None, volume=None):
    """Samples of one integral in one dimension (or (N, D) positions), given by hand."""
    x = np.atleast_2d(np.asarray(x, dtype=float).T).T

    def column(values):
        return torch.tensor(np.asarray(values, dtype=float))[None, :, None]

    control = None if h is None else (column(h)[..., None], torch.tensor([[integral]], dtype=torch.float64))
    return Samples(
        torch.from_numpy(x)[None],
        Observation(column(f)[..., None], control=control),
        column(np.ones(len(x)) if pdf is None else pdf),
        design,
        stratum=None if stratum is None else torch.tensor([stratum]),
        volume=None if volume is None else torch.tensor([volume], dtype=torch.float64),
    )


def estimate(rule, given):
    combination = registry.make("rule", rule).combine(given)
    return combination.estimate(given), combination


LINE = np.array([0.1, 0.25, 0.4, 0.8])
ONE_POINT = ("mc", "trapezoid", "simpson", "regression-1", "regression-3", "regression-5", "stratification")
KERNEL_MASS = 0.015 * np.sqrt(2.0 * np.pi)  # integral of the Bayesian quadrature kernel about an inner point

CASES = [
    # One sample: every rule that is exact on constants gives its value.
    *((f"N = 1, {rule}", rule, samples([0.3], [7.0], stratum=[0], volume=[1.0]), 7.0, 1e-14) for rule in ONE_POINT),
    ("N = 1, gauss-legendre", "gauss-legendre", samples([0.5], [7.0], design="gauss-legendre"), 7.0, 1e-14),
    ("N = 1, bayesian-quadrature", "bayesian-quadrature", samples([0.3], [7.0]), 7.0 * KERNEL_MASS, 1e-7),
    ("N = 1, difference-cv", "difference-cv", samples([0.3], [7.0], h=[2.0], integral=1.5), 6.5, 1e-14),
    ("N = 1, ratio-cv", "ratio-cv", samples([0.3], [7.0], h=[2.0], integral=1.5), 5.25, 1e-14),
    # Equal samples carry what one of them does.
    ("equal, mc", "mc", samples([0.3] * 4, [7.0] * 4), 7.0, 1e-14),
    ("equal, trapezoid", "trapezoid", samples([0.3] * 4, [7.0] * 4), 7.0, 1e-14),
    ("equal, simpson", "simpson", samples([0.3] * 5, [7.0] * 5), 7.0, 1e-14),
    ("equal, regression-5", "regression-5", samples([0.3] * 4, [7.0] * 4), 7.0, 1e-9),
    ("equal, bayesian-quadrature", "bayesian-quadrature", samples([0.3] * 4, [7.0] * 4), 7.0 * KERNEL_MASS, 1e-6),
    ("all but one equal, simpson", "simpson", samples([0.3, 0.3, 0.9], [1.0, 1.0, 2.0]), 1.4, 1e-14),
    # Both ends of the interval.
    ("ends, trapezoid", "trapezoid", samples([0.0, 1.0], [1.0, 3.0]), 2.0, 1e-14),
    ("ends, simpson of x^2", "simpson", samples([0.0, 0.5, 1.0], [0.0, 0.25, 1.0]), 1.0 / 3.0, 1e-14),
    ("only the left end, trapezoid", "trapezoid", samples([0.0], [4.0]), 4.0, 1e-14),
    ("ends, regression-1", "regression-1", samples([0.0, 1.0], [1.0, 3.0]), 2.0, 1e-12),
    ("ends, bayesian-quadrature", "bayesian-quadrature", samples([0.0, 1.0], [1.0, 3.0]), 2.0 * KERNEL_MASS, 1e-6),
    # Simpson on uneven steps: no step more than twice its neighbour keeps weights non-negative; else the trapezoid.
    ("uneven, simpson", "simpson", samples([0.0, 0.01, 1.0], [5.0, 5.0, 5.0]), 5.0, 1e-13),
    ("uneven, simpson of a line", "simpson", samples([0.0, 0.01, 1.0], [0.0, 0.01, 1.0]), 0.5, 1e-13),
    # Eq. 29 divides by f; the additive term does not.
    ("f = 0 in Eq. 29", "difference-cv", samples(LINE, [0.0] * 4, h=LINE, integral=0.5), 0.5 - LINE.mean(), 1e-14),
    ("one f = 0", "difference-cv", samples(LINE, [0, 1, 2, 3], h=LINE, integral=0.5), 2.0 - LINE.mean(), 1e-14),
    # Eq. 30 divides by the sum of h: where that cancels, the plain mean is given, and flagged.
    ("sum h = 0 in Eq. 30", "ratio-cv", samples(LINE, [1, 2, 3, 4], h=[1, -1, 2, -2], integral=0.5), 2.5, 1e-14),
    ("h = 0 in Eq. 30", "ratio-cv", samples(LINE, [1, 2, 3, 4], h=[0, 0, 0, 0], integral=0.5), 2.5, 1e-14),
    (
        "h and f of size 1e-200",
        "ratio-cv",
        samples(LINE, 1e-200 * LINE, h=1e-200 * LINE, integral=0.5e-200),
        0.5e-200,
        0,
    ),
    # Fewer samples than terms, or repeated ones: the pseudo-inverse, exact on constants and on the line they span.
    ("2 samples, 6 terms", "regression-5", samples([0.2, 0.7], [3.0, 3.0]), 3.0, 1e-9),
    ("repeated, 2 terms", "regression-1", samples([0.2, 0.2, 0.6], 1.0 + np.array([0.2, 0.2, 0.6])), 1.5, 1e-12),
    ("crowded within 1e-9, 2 terms", "regression-1", samples(0.3 + 1e-9 * np.arange(4), [1, 2, 3, 4]), 2.5, 1e-6),
    ("crowded within rounding, 6 terms", "regression-5", samples(0.3 + 1e-16 * np.arange(3), [1, 2, 6]), 3.0, 1e-6),
    ("6 samples, 6 terms", "regression-5", samples(np.arange(6) / 5.0, (np.arange(6) / 5.0) ** 5), 1.0 / 6.0, 1e-9),
    # Strata of very different sizes and counts, and one that got nothing.
    (
        "uneven strata",
        "stratification",
        samples(LINE, [1, 1, 1, 5], stratum=[0, 0, 0, 1], volume=[1e-9] * 3 + [1 - 1e-9]),
        5.0 - 4e-9,
        1e-15,
    ),
    ("gap in the strata", "stratification", samples(LINE, [2] * 4, stratum=[0, 0, 3, 3], volume=[0.5] * 4), 2.0, 1e-15),
    # Densities over many orders of magnitude.
    ("pdf 1e-100 .. 1e100", "mc", samples(LINE, [1e-100, 1e100, 1, 1], pdf=[1e-100, 1e100, 1, 1]), 1.0, 1e-14),
]


@pytest.mark.parametrize(("rule", "given", "expected", "tolerance"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_case(rule, given, expected, tolerance):
    got, combination = estimate(rule, given)
    assert got.item() == pytest.approx(expected, rel=tolerance, abs=tolerance * abs(expected))
    assert torch.isfinite(combination.weights).all()


@pytest.mark.parametrize(("h", "flagged"), [([1, -1, 2, -2], True), ([0] * 4, True), ([1, 2, 3, 4], False)])
def test_a_ratio_that_means_nothing_is_flagged(h, flagged):
    _, combination = estimate("ratio-cv", samples(LINE, [1, 2, 3, 4], h=h))
    assert combination.fallback.tolist() == [flagged]


def test_simpson_weights_are_never_negative():
    """Plain irregular Simpson has negative weights from a ratio of two on, and large ones beyond."""
    x = np.random.default_rng(0).random((200, 9))
    given = [samples(row, np.ones(9)) for row in x]
    weights = torch.cat([estimate("simpson", each)[1].weights for each in given])
    assert weights.min() >= 0.0
    assert weights.sum(dim=1) == pytest.approx(9.0, rel=1e-13)


@pytest.mark.parametrize("gap", [0.0, 1e-300, 1e-16, 1e-12, 1e-9, 1e-6])
def test_bayesian_quadrature_bears_near_equal_nodes(gap):
    """Two nodes that nearly agree count as one: without noise on the diagonal the kernel matrix is singular."""
    near = samples([0.5, 0.5 + gap, 0.2], [2.0, 2.0, 1.0])
    once = samples([0.5, 0.2], [2.0, 1.0])
    got, combination = estimate("bayesian-quadrature", near)
    assert got.item() == pytest.approx(estimate("bayesian-quadrature", once)[0].item(), rel=1e-6)
    assert combination.weights.abs().max() < 1.0


def test_crowded_nodes_stay_finite():
    crowd = samples(0.5 + 1e-9 * np.arange(200), np.ones(200))
    assert estimate("bayesian-quadrature", crowd)[0].item() == pytest.approx(KERNEL_MASS, rel=1e-6)


def test_rows_of_size_1_and_1e60_and_nan_in_one_batch():
    one = samples(LINE, LINE**2, h=LINE, integral=0.5, stratum=[0, 1, 2, 3], volume=[0.25] * 4)

    def stacked(factors):
        rows = [one.value * factor for factor in factors]
        many = {
            field: getattr(one, field).expand(3, *getattr(one, field).shape[1:])
            for field in ("x", "pdf", "stratum", "volume")
        }
        control = tuple(part.expand(3, *part.shape[1:]) for part in one.seen.control)
        return replace(one, seen=Observation(torch.cat(rows), control=control), **many)

    for rule in (*ONE_POINT, "bayesian-quadrature", "difference-cv", "ratio-cv"):
        alone = estimate(rule, one)[0].item()
        got = estimate(rule, stacked([1.0, 1e60, float("nan")]))[0][:, 0].tolist()
        assert got[0] == alone
        assert np.isnan(got[2])
        if rule != "difference-cv":
            assert got[1] == pytest.approx(1e60 * alone, rel=1e-12)


def test_rectangle_and_trapezoid_are_one_code():
    assert registry.entry("rule", "rectangle").target == registry.entry("rule", "trapezoid").target


@pytest.mark.parametrize(
    ("rule", "given", "match"),
    [
        (
            "trapezoid",
            samples(np.full((3, 2), 0.5), [1, 1, 1]),
            "'trapezoid' needs a 1-D problem, these samples have 2",
        ),
        ("simpson", samples(np.full((3, 6), 0.5), [1, 1, 1]), "'simpson' needs a 1-D problem, these samples have 6"),
        ("mc", replace(samples(LINE, LINE), pdf=None), "'mc' needs samples with a density"),
        ("regression-3", replace(samples(LINE, LINE), pdf=None), "'regression-3' needs samples with a density"),
        ("gauss-legendre", samples(LINE, LINE), "needs its own nodes, these are 'random' points"),
        ("stratification", samples(LINE, LINE), "'stratification' needs stratified samples"),
        ("difference-cv", samples(LINE, LINE), "'difference-cv' needs a problem that brings a control variate"),
        ("ratio-cv", samples(LINE, LINE), "'ratio-cv' needs a problem that brings a control variate"),
        ("balance-heuristic", samples(LINE, LINE), "needs the densities of all techniques"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(rule, given, match):
    with pytest.raises(ValueError, match=match):
        registry.make("rule", rule).combine(given)
