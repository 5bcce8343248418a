"""What is known of lamps before samples are placed: the slabs of a grid over the numbers of next-event estimation.

A slab is a stretch of the number that picks a light. How densely one would sample it by what its lights would send if
nothing hid them, and how much more or less after the samples so far, by whether they agree on what is visible.
`kernels_rounds` computes the same numbers and the two change together.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from nqr_geom.integrator.learn.slabs import Slabs
from nqr_geom.integrator.learn.tokens import Extra, compress, fourier
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.rules import BalanceHeuristic

__all__ = [
    "FAINT",
    "KINDS",
    "SIGHT_TOKENS",
    "SLABS",
    "LampSlabs",
    "lamp_credit",
    "lamp_doubt",
    "luminance",
    "sight_tokens",
]

SLABS, KINDS = 8, 3
_LUMINANCE = (0.2126, 0.7152, 0.0722)
FAINT = 0.05  # density below which slabs look alike
_EXACT = 1e-3  # error, relative to all light that nothing hides, below which there is nothing to learn


def luminance(radiance: Tensor) -> Tensor:
    """Of linear red, green and blue, (..., 3) -> (...)."""
    return radiance @ radiance.new_tensor(_LUMINANCE)


def lamp_doubt(seen: Observation, lamps: int) -> Tensor:
    """Standard deviation of a lamp's visibility, (B, L), by its samples so far and half a sample of either kind."""
    light, visible = seen.features["light"][..., 0].flatten(1).long(), seen.features["visible"][..., 0].flatten(1)
    counts = (seen.features["expected"].sum(dim=-1).flatten(1) > 0.0) & (light >= 0)
    picked = torch.nn.functional.one_hot(light.clamp_min(0), lamps) * counts[..., None]
    number = picked.sum(dim=1)
    shown = ((picked * visible[..., None]).sum(dim=1) + 0.5) / (number + 1.0)
    return (shown * (1.0 - shown)).clamp_min(0.0).sqrt()


class LampSlabs(Slabs):
    """Slabs of the two grids of direct light; those of directions by the material are all alike."""

    size = 2
    context = 2 * SLABS + KINDS + 1

    def __init__(self, problem: Problem, n: int, counts: tuple[int, ...]) -> None:
        # Its kernels load Warp, which a recipe can do without.
        from nqr_geom.render.direct_known import known, spans
        from nqr_geom.render.direct_problem import DirectProblem

        if not isinstance(problem, DirectProblem):
            raise ValueError(f"problem: expected 'direct', got {problem.name!r}")
        super().__init__(problem, n, counts)
        if counts != (SLABS, SLABS):
            raise ValueError(f"grid: expected {SLABS} cells on the first axis of both groups, got {counts}")
        self.lit, self.known = problem, known(problem, n)  # (B, L, 3)
        low, length = spans(problem).unbind(dim=-1)
        self.worth = torch.where(length > 0.0, luminance(self.known), 0.0)
        edge = torch.linspace(0.0, 1.0, counts[1] + 1, dtype=torch.float64)
        inside = torch.minimum(edge[1:], (low + length)[..., None]) - torch.maximum(edge[:-1], low[..., None])
        self.part = counts[1] * inside.clamp_min(0.0) / length.clamp_min(1e-300)[..., None]  # (B, L, slabs)
        self.looks: list[Observation] = []
        self.begun = self._density(self.worth)
        self.change = torch.zeros_like(self.begun)
        surfaces = problem.surfaces
        kind, roughness = (torch.from_numpy(np.ascontiguousarray(surfaces[key])) for key in ("kind", "roughness"))
        code = torch.nn.functional.one_hot(kind.long() + 1, KINDS + 1)[:, 1:]
        self.place = torch.cat([code.double(), roughness.clamp(1e-3, 1.0).log()[:, None]], dim=1)

    def _density(self, worth: Tensor) -> Tensor:
        """Logarithm of the density of slabs by shares of the worth of lamps, (B, slabs)."""
        total = worth.sum(dim=1, keepdim=True)
        share = torch.where(total > 0.0, worth / torch.where(total > 0.0, total, 1.0), 0.0)
        density = (share[..., None] * self.part).sum(dim=1)
        return torch.where(total > 0.0, density + FAINT, 1.0).log()

    def ahead(self) -> Tensor:
        lamps = torch.stack([self.begun, self.change], dim=-1).float()
        return torch.nn.functional.pad(lamps, (0, 0, self.counts[0], 0))

    def seen(self) -> Tensor:
        return torch.cat([self.begun, self.change, self.place], dim=1).float()

    def evaluate(self, x: Tensor) -> Observation:
        return self.lit.evaluate(x, self.known)

    def note(self, seen: Observation) -> None:
        self.looks.append(seen)
        doubt = lamp_doubt(Observation.join(self.looks), self.worth.shape[1])
        self.change = self._density(self.worth * doubt) - self.begun


def sight_tokens(samples: Samples) -> Tensor:
    """What a sampling network reads of a round of samples, each by itself, (B, k, T, 39) float32.

    Its place, whether it met a lamp and saw it, what it would bring if nothing hid the lamp and what it does bring, in
    units of all light that nothing hides, and the densities of both techniques.
    """
    get = {name: samples.feature(name, "snet") for name in samples.seen.features}
    unit = get["known_all"].sum(dim=-1, keepdim=True)
    unit = torch.where(unit > 0.0, unit, 1.0)
    balance = BalanceHeuristic().combine(samples).weights
    hit = (get["light"] >= 0.0).double()
    expected, value, known = (
        part.sum(dim=-1, keepdim=True) / unit for part in (get["expected"], samples.value, get["known"])
    )
    parts = [
        fourier(get["pss"], 5),
        hit,
        hit * get["visible"],
        balance.clamp_max(16.0),
        *(compress(part) for part in (balance * expected, balance * value, known)),
        *(get[name].clamp(1e-6, 1e6).log() / 3.0 for name in ("nee_pdf", "bsdf_pdf")),
        get["diffuse_share"].mean(dim=-1, keepdim=True),
    ]
    return torch.cat([part.float() for part in parts], dim=-1)


SIGHT_TOKENS = Extra(39, sight_tokens)


def lamp_credit(samples: Samples, group: int) -> Tensor:
    """How much of the variance of `direct-known` each sample brings, against the mean of its kind, (B G, N, T).

    To first order the rule is off by the sum over samples of e (v - V): e is what a sample would add if nothing hid its
    lamp, by its technique's own density, v whether it saw the lamp, and V how much of the lamp is visible, which all
    samples of a group tell together. The variance falls fastest where the density rises with e^2 (v - V)^2.

    Parameters
    ----------
    samples : Samples
        Of B pixels, `group` sequences each, one after the other.
    group : int
        G.
    """
    light, visible = samples.feature("light", "snet"), samples.feature("visible", "snet")  # (B G, N, T, 1)
    expected = torch.where(light >= 0.0, samples.feature("expected", "snet"), 0.0)
    expected = BalanceHeuristic().combine(samples).weights * expected
    lights, bright, saw = (part.reshape(-1, group, *part.shape[1:]) for part in (light, luminance(expected), visible))
    lights, saw = lights[..., 0], saw[..., 0]  # (B, G, N, T)
    share = torch.zeros_like(saw)
    for j in torch.unique(light[light >= 0.0]):  # the lights of this tile
        of = (lights == j) * bright
        total = of.sum(dim=(1, 2, 3), keepdim=True)
        part = (of * saw).sum(dim=(1, 2, 3), keepdim=True) / torch.where(total > 0.0, total, 1.0)
        share = torch.where(lights == j, part, share)
    off = (expected.square().mean(dim=-1).view_as(saw)) * (saw - share).square()
    unit = samples.feature("known_all", "snet")[:, :1, :1].square().mean(dim=-1).view(-1, group, 1, 1)[:, :1]
    size = off.sum(dim=3).mean(dim=(1, 2))[:, None, None, None] + _EXACT**2 * unit
    off = torch.where(size > 0.0, off / torch.where(size > 0.0, size, 1.0), 0.0)
    return (off - off.mean(dim=(1, 2), keepdim=True)).flatten(0, 1)
