"""What samples are worth: a rule turns samples into weights W and an additive term a, F = a + (1/N) sum W_i f_i.

Every classical rule of Appendix B is one of these. `a` comes from positions and features alone (control variates,
closed-form parts), so an estimate is linear in the values whenever the weights do not look at them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import combinations_with_replacement

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Link, Samples
from nqr_geom.integrator.samplers import cells_per_axis, gauss_legendre
from nqr_geom.integrator.sums import cholesky_weights, least_norm, row_mean

__all__ = [
    "BalanceHeuristic",
    "BayesianQuadrature",
    "Combination",
    "DifferenceControlVariate",
    "GaussLegendre",
    "MonteCarlo",
    "RatioControlVariate",
    "Regression",
    "Rule",
    "Simpson",
    "Stratification",
    "Trapezoid",
    "interval_weights",
]


@dataclass(frozen=True)
class Combination:
    """How a rule combines samples.

    Parameters
    ----------
    weights : Tensor, broadcastable to (B, N, T, C)
        W_i.
    offset : Tensor, (B, C) or (B, N, C), or None
        The additive term a, or one term a sample whose mean is a; None is zero.
    fallback : Tensor, (B,) bool, or None
        Integrals where the rule gave way to a safer one.
    link : Link, or None
        A link of the rule's own, where it states its estimate in another scale than the values'.
    doubt : Tensor, (B,), or None
        How much of the answer is a guess, in [0, 1], where the rule knows: 0 where its samples tell all.
    """

    weights: Tensor
    offset: Tensor | None = None
    fallback: Tensor | None = None
    link: Link | None = None
    doubt: Tensor | None = None

    def per_sample(self, samples: Samples) -> Tensor:
        """The terms whose mean over N is the estimate, (B, N, C)."""
        terms = (self.weights * samples.value).sum(dim=2)
        if self.offset is None:
            return terms
        return terms + (self.offset if self.offset.ndim == 3 else self.offset[:, None])

    def estimate(self, samples: Samples) -> Tensor:
        """F = a + mean over N, sum over T of W f, (B, C)."""
        if self.offset is None or self.offset.ndim == 3:
            return row_mean(self.per_sample(samples))
        return row_mean((self.weights * samples.value).sum(dim=2)) + self.offset


class Rule(ABC):
    """Combines samples into an estimate; sees nothing but the samples."""

    name: str = "rule"
    averages = False  # the estimate is a mean of terms that are independent when the samples are

    @abstractmethod
    def combine(self, samples: Samples) -> Combination:
        """Weights and additive term for these samples.

        Raises
        ------
        ValueError
            If the samples lack what the rule needs (one dimension, a density, a feature).
        """

    def _need_1d(self, samples: Samples) -> None:
        if samples.dim != 1:
            raise ValueError(f"rule: {self.name!r} needs a 1-D problem, these samples have {samples.dim} dimensions")

    def _need_one_technique(self, samples: Samples) -> None:
        if samples.value.shape[2] != 1:
            raise ValueError(
                f"rule: {self.name!r} would add up {samples.value.shape[2]} techniques that estimate the same "
                "integral; use 'balance-heuristic'"
            )

    def _need_pdf(self, samples: Samples) -> Tensor:
        if samples.pdf is None:
            raise ValueError(f"rule: {self.name!r} needs samples with a density, {samples.design!r} points have none")
        return samples.pdf


class MonteCarlo(Rule):
    """W = 1/pdf: the plain mean for uniform samples, importance sampling (Eq. 23) for others."""

    name = "mc"
    averages = True

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        return Combination(1.0 / self._need_pdf(samples)[..., None])


def interval_weights(x: Tensor) -> Tensor:
    """N times the length of the interval that each point stands for, (B, N) -> (B, N), in the points' own order.

    The interval reaches half-way to the neighbours and to the ends of [0, 1] (Eq. 12 with 13, Eq. 16 with 17: the
    generalised rectangle and trapezoidal rules have the same weights).

    Examples
    --------
    >>> interval_weights(torch.tensor([[0.75, 0.25]]))
    tensor([[1., 1.]])
    """
    ordered, order = x.sort(dim=1)
    ends = torch.cat([-ordered[:, :1], ordered, 2.0 - ordered[:, -1:]], dim=1)
    weights = 0.5 * x.shape[1] * (ends[:, 2:] - ends[:, :-2])
    return torch.empty_like(weights).scatter(1, order, weights)


class Trapezoid(Rule):
    """The trapezoidal rule on any points, extended as a constant to both ends; the rectangle rule is the same."""

    name = "trapezoid"

    def combine(self, samples: Samples) -> Combination:
        self._need_1d(samples)
        self._need_one_technique(samples)
        return Combination(interval_weights(samples.x[..., 0])[..., None, None])


class Simpson(Rule):
    """Simpson's composite rule on any points, constant beyond the outermost ones.

    Two neighbouring steps share a parabola where neither is more than twice the other, which keeps every weight
    non-negative; elsewhere, and on a last odd step, the trapezoid is used.
    """

    name = "simpson"

    def combine(self, samples: Samples) -> Combination:
        self._need_1d(samples)
        self._need_one_technique(samples)
        x, order = samples.x[..., 0].sort(dim=1)
        n = samples.n
        step = x.diff(dim=1)
        panels = (n - 1) // 2
        h0, h1 = step[:, 0 : 2 * panels : 2], step[:, 1 : 2 * panels : 2]
        alike = (h0 <= 2.0 * h1) & (h1 <= 2.0 * h0) & (h0 > 0.0)
        ratio = torch.where(alike, h1 / torch.where(alike, h0, 1.0), 1.0)
        total = h0 + h1
        left = torch.where(alike, total * (2.0 - ratio) / 6.0, 0.5 * h0)
        middle = torch.where(alike, total * (2.0 + ratio + 1.0 / ratio) / 6.0, 0.5 * total)
        right = torch.where(alike, total * (2.0 - 1.0 / ratio) / 6.0, 0.5 * h1)
        lengths = torch.zeros_like(x)
        lengths[:, 0 : 2 * panels : 2] += left
        lengths[:, 1 : 2 * panels : 2] += middle
        lengths[:, 2 : 2 * panels + 1 : 2] += right
        if n % 2 == 0:
            lengths[:, -2:] += 0.5 * step[:, -1:]
        lengths[:, 0] += x[:, 0]
        lengths[:, -1] += 1.0 - x[:, -1]
        weights = torch.empty_like(lengths).scatter(1, order, n * lengths)
        return Combination(weights[..., None, None])


class GaussLegendre(Rule):
    """Gauss-Legendre weights for Gauss-Legendre nodes: exact to degree 2N - 1 in one dimension (Eq. 18)."""

    name = "gauss-legendre"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        if samples.design != "gauss-legendre":
            raise ValueError(f"rule: 'gauss-legendre' needs its own nodes, these are {samples.design!r} points")
        weights = torch.full_like(samples.x[..., 0], samples.n)
        for axis, k in enumerate(cells_per_axis(samples.n, samples.dim)):
            nodes, lengths = (torch.as_tensor(part, device=samples.x.device) for part in gauss_legendre(k))
            # Which node it is follows from the position, so that the samples may come in any order.
            between = 0.5 * (nodes[1:] + nodes[:-1])
            weights = weights * lengths[torch.bucketize(samples.x[..., axis].contiguous(), between)]
        return Combination(weights[..., None, None])


def _canonical(x: Tensor) -> tuple[Tensor, Tensor]:
    """Points (B, N, D) by their first coordinate, and their indices (B, N).

    Ill-conditioned systems magnify the last bit, so it must not depend on the order in which samples came.
    """
    order = x[..., 0].argsort(dim=1)
    return x.gather(1, order[..., None].expand_as(x)), order


def _legendre_basis(x: Tensor, degree: int) -> Tensor:
    """All products of shifted Legendre polynomials of total degree <= `degree`, (B, N, D) -> (B, N, M).

    The first one is 1; all others integrate to 0 over the cube.
    """
    u = 2.0 * x - 1.0
    polynomials = [torch.ones_like(u), u]
    for k in range(1, degree):
        polynomials.append(((2 * k + 1) * u * polynomials[k] - k * polynomials[k - 1]) / (k + 1))
    dim = x.shape[2]
    # Each product by the axes of its linear factors; the order is that of the exponents.
    chosen = (axes for total in range(degree + 1) for axes in combinations_with_replacement(range(dim), total))
    columns = []
    for exponent in sorted(tuple(axes.count(axis) for axis in range(dim)) for axes in chosen):
        column = torch.ones_like(x[..., 0])
        for axis, k in enumerate(exponent):
            if k:
                column = column * polynomials[k][..., axis]
        columns.append(column)
    return torch.stack(columns, dim=-1)


_MOST_TERMS = 1000  # of a fit: twice what degree 3 has in 12 dimensions


@dataclass(frozen=True)
class Regression(Rule):
    """Regression Monte Carlo: a least-squares polynomial as control variate (Salaun et al. 2022).

    The fitted polynomial's integral plus the mean residual, which the fit makes zero. Where the fit is not unique
    (fewer samples than terms, or crowded ones) the terms above the constant have least norm, so that constants stay
    exact and one sample gives the plain mean.

    Parameters
    ----------
    degree : int
        Total degree of the polynomial.
    """

    degree: int = 1

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"regression-{self.degree}"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        x, order = _canonical(samples.x)
        share = 1.0 / self._need_pdf(samples)[..., 0].gather(1, order)
        share = share / row_mean(share)[:, None]
        terms = math.comb(samples.dim + self.degree, self.degree)
        if terms > _MOST_TERMS:
            raise ValueError(
                f"rule: {self.name!r} expected at most {_MOST_TERMS} terms, a polynomial of degree {self.degree} has "
                f"{terms} in {samples.dim} dimensions"
            )
        basis = _legendre_basis(x, self.degree)[..., 1:]
        means = row_mean(share[..., None] * basis)
        columns = (basis - means[:, None]).unbind(dim=-1)
        weighted = share[..., None] * (basis - means[:, None])
        gram = torch.stack([row_mean(weighted * column[..., None]) for column in columns], dim=1)
        # Take the fit's terms out of the mean: all but the constant integrate to 0.
        weights = share
        for column, slope in zip(weighted.unbind(dim=-1), least_norm(gram, means, 1e-10).unbind(dim=-1), strict=True):
            weights = weights - column * slope[:, None]
        return Combination(torch.empty_like(weights).scatter(1, order, weights)[..., None, None])


@dataclass(frozen=True)
class BayesianQuadrature(Rule):
    """Posterior mean of the integral under a zero-mean Gaussian process with a squared-exponential kernel (Eq. 19).

    Parameters
    ----------
    length : float
        Length scale of the kernel, in units of the cube's side.
    jitter : float
        Relative noise on the diagonal; it keeps (nearly) repeated points harmless.
    """

    length: float = 0.015
    jitter: float = 1e-8

    name = "bayesian-quadrature"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        x, order = _canonical(samples.x)
        gap = (x[:, :, None] - x[:, None]) / self.length
        kernel = torch.exp(-0.5 * gap.square().sum(-1))
        kernel.diagonal(dim1=1, dim2=2).add_(self.jitter)
        scale = math.sqrt(2.0) * self.length
        axis = torch.erf((1.0 - x) / scale) + torch.erf(x / scale)
        mean = (self.length * math.sqrt(math.pi / 2.0) * axis).prod(dim=-1)
        weights = torch.empty_like(mean).scatter(1, order, cholesky_weights(kernel, mean))
        return Combination(samples.n * weights[..., None, None])


class Stratification(Rule):
    """W = N A_s / N_s: each stratum counts by its volume, however many samples it got (Eq. 26)."""

    name = "stratification"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        if samples.stratum is None or samples.volume is None:
            raise ValueError(f"rule: 'stratification' needs stratified samples, these are {samples.design!r} points")
        levels = int(samples.stratum.max()) + 1
        counts = samples.x.new_zeros(samples.x.shape[0], levels)
        counts.scatter_add_(1, samples.stratum, torch.ones_like(samples.volume))
        share = samples.volume / counts.gather(1, samples.stratum)
        return Combination(samples.n * share[..., None, None])


class DifferenceControlVariate(Rule):
    """H + mean(f - h) for a control variate h with known integral H (Eq. 27): W = 1/pdf, a = H - mean(h).

    The additive term is kept sample by sample, because it is f - h that varies, not f.
    """

    name = "difference-cv"
    averages = True

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        weights = 1.0 / self._need_pdf(samples)[..., None]
        h, integral = _control(samples, self.name)
        return Combination(weights, integral[:, None] - (weights * h).sum(dim=2))


class RatioControlVariate(Rule):
    """H sum(f) / sum(h) for a control variate h with known integral H (Eq. 30).

    Where the mean of h cancels to less than a thousandth of the mean of |h| the ratio means nothing, and the plain
    mean is given instead.
    """

    name = "ratio-cv"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        weights = 1.0 / self._need_pdf(samples)[..., None]
        h, integral = _control(samples, self.name)
        mean = row_mean((weights * h).sum(dim=2))
        size = row_mean((weights * h).abs().sum(dim=2))
        sound = mean.abs() > 1e-3 * size
        ratio = torch.where(sound, integral / torch.where(sound, mean, 1.0), 1.0)
        return Combination(weights * ratio[:, None, None], fallback=~sound.all(dim=1))


def _control(samples: Samples, name: str) -> tuple[Tensor, Tensor]:
    if samples.seen.control is None:
        raise ValueError(f"rule: {name!r} needs a problem that brings a control variate")
    return samples.seen.control


class BalanceHeuristic(Rule):
    """Multiple importance sampling with one sample of each technique a pass (Eqs. 32 to 35).

    Values are f/p_t; the weight of technique t at its own sample is p_t / sum_k p_k.
    """

    name = "balance-heuristic"
    averages = True

    def combine(self, samples: Samples) -> Combination:
        densities = samples.seen.technique_pdf
        if densities is None:
            raise ValueError("rule: 'balance-heuristic' needs the densities of all techniques at every sample")
        own = densities.diagonal(dim1=2, dim2=3)
        total = densities.sum(dim=-1)
        share = torch.where(total > 0.0, own / torch.where(total > 0.0, total, 1.0), 0.0)
        return Combination((share / self._need_pdf(samples))[..., None])
