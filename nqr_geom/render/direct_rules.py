"""Rules for direct light: regression for each technique, and closed-form light with sampled visibility."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Observation, Samples
from nqr_geom.integrator.rules import BalanceHeuristic, Combination, Regression, Rule
from nqr_geom.integrator.sums import row_sum

__all__ = ["KnownLight", "TechniqueRegression", "UnhiddenLight", "known_light", "sure_chance"]

_EVEN_AXES = ("pmj", "sobol", "latin-hypercube")  # designs that hit every stratum of each axis


@dataclass(frozen=True)
class TechniqueRegression(Rule):
    """Regression Monte Carlo for each technique apart, on values under the balance heuristic (Section 6.1).

    Parameters
    ----------
    degree : int
        Total degree of the polynomials in a technique's own three coordinates.
    """

    degree: int = 1

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"direct-regression-{self.degree}"

    def combine(self, samples: Samples) -> Combination:
        own = samples.feature("pss", self.name)
        density = self._need_pdf(samples)[..., None]
        shares = BalanceHeuristic().combine(samples).weights * density
        fit = Regression(self.degree)
        weights = []
        for t in range(samples.value.shape[2]):
            pdf = None if samples.pdf is None else samples.pdf[:, :, t : t + 1]
            part = replace(samples, x=own[:, :, t], seen=Observation(samples.value[:, :, t : t + 1]), pdf=pdf)
            weights.append(fit.combine(part).weights * shares[:, :, t : t + 1])
        return Combination(torch.cat(weights, dim=2))


def sure_chance(design: str, n: int) -> float:
    """Least chance of a light at which n samples are (as good as) sure to choose it.

    Evenly spread designs put a sample into each of 2^k <= n strata of an axis, one of which lies inside any two
    strata's width. Of independent samples all miss such a light once in eight million times.
    """
    if design in _EVEN_AXES:
        return 2.0 / (1 << (n.bit_length() - 1))
    return 16.0 / n


class UnhiddenLight(Rule):
    """Diffuse light as exact irradiance of each light, if nothing hid it, times its visibility by the samples.

    The samples of a light estimate its contribution with and without what stands in the way. The ratio of the two,
    times the exact one without, does not see how the light was chosen nor how the cosine varies over it: where a light
    is quite visible or quite hidden it is exact on diffuse surfaces. Lights that may be missed by chance keep the
    balance heuristic, with their exact unhidden irradiance as control variate, as strong as the other lights are
    visible. Glossy lobes keep the balance heuristic.
    """

    name = "direct-unhidden"

    def combine(self, samples: Samples) -> Combination:
        light, lambert, chance, irradiance, share, radiance, visible, unhidden, f = (
            samples.feature(name, self.name)
            for name in (
                "light", "lambert", "chance", "irradiance", "diffuse_share", "radiance", "visible", "unhidden", "bsdf"
            )
        )  # fmt: skip
        self._need_pdf(samples)
        balance = BalanceHeuristic().combine(samples).weights  # (B, N, T, 1)
        counted = torch.where(light >= 0, balance * lambert / samples.n, 0.0)
        sure = (light >= 0) & (chance >= sure_chance(samples.design, samples.n))
        ratio = torch.ones_like(lambert)
        missed = unhidden[:, 0, 0].clone()  # (B, 3)
        for j in torch.unique(light):  # the lights of this tile
            of = sure & (light == j)
            sampled = _total(torch.where(of, counted, 0.0))[:, None, None]  # (B, 1, 1, 1)
            used = of & (sampled > 0.0)
            ratio = torch.where(used, irradiance / torch.where(sampled > 0.0, sampled, 1.0), ratio)
            # Every sample of a light says the same of it.
            missed = missed - torch.where(used, irradiance * radiance, 0.0).amax(dim=(1, 2))
        missed = missed - _total(torch.where(sure, 0.0, counted * radiance))
        certain = _total(torch.where(sure, counted, 0.0))
        shown = _total(torch.where(sure, counted * visible, 0.0))
        every = _total(counted)
        strength = torch.where(certain > 0.0, shown / torch.where(certain > 0.0, certain * every, 1.0), 0.0)
        offset = strength * _total(counted * f * share) * missed
        weights = balance * (1.0 + share * (ratio - 1.0))
        return Combination(weights, offset)


class KnownLight(Rule):
    """What each light would send to the viewer if nothing hid it, glossy lobes included, times its visibility.

    The visibility of a light is that of its samples, each counted by what it would bring under the balance heuristic:
    the estimate of a light lies between nothing and all of it, so that no sample can stand out. Lights that no sample
    has met are as visible as the others together. A ratio of sums, so its bias falls like 1/n.
    """

    name = "direct-known"

    def combine(self, samples: Samples) -> Combination:
        self._need_pdf(samples)
        found = known_light(samples, self.name)
        missed = samples.feature("known_all", self.name)[:, 0, 0] - _total(found.expected * found.ratio)
        every = _total(found.expected)
        shown = _total(found.expected * samples.feature("visible", self.name))
        visible = torch.where(every > 0.0, shown / torch.where(every > 0.0, every, 1.0), 0.0)
        return Combination(found.balance * found.ratio, visible * missed.clamp_min(0.0))


class Known(NamedTuple):
    """What samples say of their lights.

    Attributes
    ----------
    balance : Tensor, (B, N, T, 1)
        Weights of the balance heuristic.
    expected : Tensor, (B, N, T, C)
        What each sample would add to the estimate if nothing hid the light.
    ratio : Tensor, (B, N, T, C)
        Known radiance of the sample's light over the sum of `expected` of all its samples; 1 where there is none.
    """

    balance: Tensor
    expected: Tensor
    ratio: Tensor


def known_light(samples: Samples, rule: str) -> Known:
    """Compare what the samples of each light expect of it with what is known, for the rule of that name."""
    light, expected, known = (samples.feature(name, rule) for name in ("light", "expected", "known"))
    balance = BalanceHeuristic().combine(samples).weights
    expected = balance * torch.where(light >= 0.0, expected, 0.0) / samples.n
    total = of_same_light(light, expected)
    some = total > 0.0
    return Known(balance, expected, torch.where(some, known / torch.where(some, total, 1.0), 1.0))


def of_same_light(light: Tensor, terms: Tensor) -> Tensor:
    """Sum over all samples of a row that met the same light, (B, N, T, C) -> (B, N, T, C), 0 where they met none."""
    sums = torch.zeros_like(terms)
    for j in torch.unique(light[light >= 0.0]):  # the lights of this tile
        of = light == j
        sums = torch.where(of, _total(torch.where(of, terms, 0.0))[:, None, None], sums)
    return sums


def _total(terms: Tensor) -> Tensor:
    """Sum over samples and techniques, (B, N, T, C) -> (B, C)."""
    return row_sum(terms.sum(dim=2))
