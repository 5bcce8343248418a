"""Hard cases of the classical rules: what they must give for samples that are too few, too equal or too far apart.

Truths are closed forms of each rule's own definition: means, lines through samples, Gaussians' integrals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike

from nqr_geom import registry
from nqr_geom.hard_cases.case import Case, deviation, refusal
from nqr_geom.integrator.problem import Observation, Samples
from nqr_geom.integrator.rules import Combination

__all__ = ["cases"]


class Row(NamedTuple):
    """A rule, samples, and what it must make of them."""

    name: str
    rule: str
    given: Samples
    expected: float
    tolerance: float


def samples(
    x: ArrayLike,
    f: ArrayLike,
    *,
    h: ArrayLike | None = None,
    integral: float = 1.0,
    pdf: ArrayLike | None = None,
    design: str = "random",
    stratum: list[int] | None = None,
    volume: list[float] | None = None,
) -> Samples:
    """Samples of one integral in one dimension (or (N, D) positions), given by hand."""
    x = np.atleast_2d(np.asarray(x, dtype=float).T).T

    def column(values: ArrayLike) -> torch.Tensor:
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


def _estimate(rule: str, given: Samples) -> tuple[torch.Tensor, Combination]:
    combination: Combination = registry.make("rule", rule).combine(given)
    return combination.estimate(given), combination


LINE = np.array([0.1, 0.25, 0.4, 0.8])
ONE_POINT = ("mc", "trapezoid", "simpson", "regression-1", "regression-3", "regression-5", "stratification")
KERNEL_MASS = 0.015 * np.sqrt(2.0 * np.pi)  # integral of the Bayesian quadrature kernel about an inner point

_ROWS: list[tuple[Any, ...]] = [
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
TABLE = [Row(*row) for row in _ROWS]


def _error(row: Row) -> float:
    got, combination = _estimate(row.rule, row.given)
    return deviation(got.item(), row.expected, abs(row.expected)) if _finite(combination.weights) else float("nan")


def _finite(tensor: torch.Tensor) -> bool:
    return bool(torch.isfinite(tensor).all())


def _flag(h: ArrayLike, flagged: bool) -> float:
    """A ratio that means nothing is flagged."""
    _, combination = _estimate("ratio-cv", samples(LINE, [1, 2, 3, 4], h=h))
    flags = combination.fallback
    return 0.0 if flags is not None and flags.tolist() == [flagged] else float("inf")


def _simpson_weights() -> float:
    """Weights over 200 random designs of nine points: none negative, all sums right."""
    x = np.random.default_rng(0).random((200, 9))
    weights = torch.cat([_estimate("simpson", samples(row, np.ones(9)))[1].weights for row in x])
    return max(max(0.0, -float(weights.min())), deviation(weights.sum(dim=1).numpy() / 9.0, 1.0))


def _naive_simpson() -> float:
    """The parabola through three uneven points, integrated: its weights."""
    x = np.array([0.0, 0.01, 1.0])
    return float(max(0.0, -np.linalg.solve(np.vander(x, increasing=True).T, [1.0, 1 / 2, 1 / 3]).min()))


def _near_nodes(gap: float) -> float:
    """Two nodes of Bayesian quadrature that nearly agree count as one, with weights of size one."""
    got, combination = _estimate("bayesian-quadrature", samples([0.5, 0.5 + gap, 0.2], [2.0, 2.0, 1.0]))
    once = _estimate("bayesian-quadrature", samples([0.5, 0.2], [2.0, 1.0]))[0].item()
    return abs(got.item() / once - 1.0) if float(combination.weights.abs().max()) < 1.0 else float("inf")


def _naive_near_nodes() -> float:
    """The kernel matrix as it is, without noise on its diagonal, has no inverse."""
    x = np.array([0.5, 0.5 + 1e-12, 0.2])
    kernel = np.exp(-((x[:, None] - x) ** 2) / (2 * 0.015**2))
    return float(np.linalg.cond(kernel))


def _crowd() -> float:
    got = _estimate("bayesian-quadrature", samples(0.5 + 1e-9 * np.arange(200), np.ones(200)))[0].item()
    return abs(got / KERNEL_MASS - 1.0)


def _rows(rule: str) -> float:
    """Rows of size 1 and 1e60 and one that is NaN in a batch: the first bit for bit as alone, the last stays alone."""
    one = samples(LINE, LINE**2, h=LINE, integral=0.5, stratum=[0, 1, 2, 3], volume=[0.25] * 4)
    many: dict[str, Any] = {
        field: getattr(one, field).expand(3, *getattr(one, field).shape[1:])
        for field in ("x", "pdf", "stratum", "volume")
    }
    control: Any = tuple(part.expand(3, *part.shape[1:]) for part in one.seen.control or ())
    values = torch.cat([one.value * factor for factor in (1.0, 1e60, float("nan"))])
    batch = replace(one, seen=Observation(values, control=control), **many)
    alone, got = _estimate(rule, one)[0].item(), _estimate(rule, batch)[0][:, 0].tolist()
    if got[0] != alone or not np.isnan(got[2]):
        return float("inf")
    return abs(got[1] / (1e60 * alone) - 1.0) if rule != "difference-cv" else 0.0


def _naive_rows() -> float:
    """Small rows from a running sum over the batch, as a difference of its ends."""
    total = np.cumsum(np.concatenate([np.full(4, 1e60), LINE**2]))
    return float(abs((total[-1] - total[3]) / (LINE**2).sum() - 1.0))


def _one_code() -> float:
    """Rectangle rule (Eq. 12) and trapezoid have the same weights."""
    same = registry.entry("rule", "rectangle").target == registry.entry("rule", "trapezoid").target
    return 0.0 if same else float("inf")


def _advantages(rewards: ArrayLike) -> float:
    """Groups with equal rewards, and groups of one, have advantage 0."""
    from nqr_geom.integrator.learn.joint import advantages

    return float(advantages(torch.as_tensor(np.asarray(rewards, dtype=float))).abs().max())


_MISFITS: tuple[tuple[str, Samples, str], ...] = (
    ("trapezoid", samples(np.full((3, 2), 0.5), [1, 1, 1]), "'trapezoid' needs a 1-D problem, these samples have 2"),
    ("simpson", samples(np.full((3, 6), 0.5), [1, 1, 1]), "'simpson' needs a 1-D problem, these samples have 6"),
    ("mc", replace(samples(LINE, LINE), pdf=None), "'mc' needs samples with a density"),
    ("regression-3", replace(samples(LINE, LINE), pdf=None), "'regression-3' needs samples with a density"),
    ("gauss-legendre", samples(LINE, LINE), "needs its own nodes, these are 'random' points"),
    ("stratification", samples(LINE, LINE), "'stratification' needs stratified samples"),
    ("difference-cv", samples(LINE, LINE), "'difference-cv' needs a problem that brings a control variate"),
    ("ratio-cv", samples(LINE, LINE), "'ratio-cv' needs a problem that brings a control variate"),
    ("balance-heuristic", samples(LINE, LINE), "needs the densities of all techniques"),
)


def cases() -> list[Case]:
    """Classical rules."""
    group, made = "rules", []

    def add(name: str, run: Callable[[], float], bound: float, naive: Callable[[], float] | None = None) -> None:
        made.append(Case(group, name, run, bound, naive))

    for row in TABLE:
        add(row.name, partial(_error, row), row.tolerance)
    for h, flagged in (([1, -1, 2, -2], True), ([0] * 4, True), ([1, 2, 3, 4], False)):
        add(f"a ratio that means nothing is flagged [{h}]", partial(_flag, h, flagged), 0.0)
    add("weights of uneven Simpson", _simpson_weights, 1e-13, _naive_simpson)
    for gap in (0.0, 1e-300, 1e-16, 1e-12, 1e-9, 1e-6):
        naive = _naive_near_nodes if gap == 1e-12 else None
        add(f"nearly equal nodes of Bayesian quadrature [{gap:g}]", partial(_near_nodes, gap), 1e-6, naive)
    add("200 nodes within 2e-7", _crowd, 1e-6)
    for rule in (*ONE_POINT, "bayesian-quadrature", "difference-cv", "ratio-cv"):
        naive = _naive_rows if rule == "mc" else None
        add(f"rows of size 1, 1e60 and NaN [{rule}]", partial(_rows, rule), 1e-12, naive)
    add(
        "advantages of equal rewards", partial(_advantages, [[2.0, 2.0, 2.0], [1e30, 1e30, 1e30], [0.0, 0.0, 0.0]]), 0.0
    )
    add("advantages in groups of one", partial(_advantages, [[2.0], [1e-30]]), 0.0)
    add("rectangle and trapezoid are one code", _one_code, 0.0)
    for rule, given, words in _MISFITS:
        made.append(
            refusal(
                group, f"samples that do not fit [{rule}]", partial(registry.make("rule", rule).combine, given), words
            )
        )
    return made
