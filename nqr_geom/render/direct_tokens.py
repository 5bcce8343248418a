"""What a pass of direct light tells a network: its sample, and what all samples of a row say together of its lamp.

A token holds what `direct-known` would make of the sample and what that rule cannot weigh: how sure the visibility of
its lamp is by the samples that met it, and what part of all light is in question. Radiance counts in the mean of the
row's values, so nothing depends on how bright a scene is. `kernels_tokens` computes the very same numbers and the two
change together.
"""

from __future__ import annotations

import torch
from torch import Tensor

from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, compress, standard
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_sum
from nqr_geom.render.direct_rules import known_light, of_same_light

__all__ = ["LAMP_TOKENS", "MANY", "TYPICAL", "lamp_tokens"]

TYPICAL = 0.1  # radius over distance that stands where no light was hit
MANY = 16  # passes
_PLAIN = TokenConfig(dim=6, channels=3)


def _logarithm(ratio: Tensor) -> Tensor:
    return ratio.clamp(1e-6, 1e6).log() / 3.0


def _over(part: Tensor, whole: Tensor, otherwise: float = 0.0) -> Tensor:
    """part / whole where there is a whole."""
    some = whole > 0.0
    return torch.where(some, part / torch.where(some, whole, 1.0), otherwise)


def _checked(samples: Samples) -> Tensor:
    """How sharp the reflection is, how large the light is seen and how often it is chosen, (B, N, T, 3)."""
    pdf, radius, distance, chance = (
        samples.feature(name, "inet") for name in ("bsdf_pdf", "light_radius", "light_distance", "chance")
    )
    chosen = torch.where(chance > 0.0, chance, 1.0)
    seen = _logarithm(_over(radius, distance, TYPICAL))
    return torch.cat([pdf.clamp(0.0, 1e12).log1p(), seen, _logarithm(chosen)], dim=-1).float()


def lamp_tokens(samples: Samples) -> Tensor:
    """Quantities of every technique's samples, those that are checked first, (B, N, T, 27) float32.

    Parameters
    ----------
    samples : Samples
        With the features of direct light.
    """
    value, unit = standard(samples.value, _PLAIN)
    found = known_light(samples, "inet")
    light, visible, density, diffuse, known, everything = (
        samples.feature(name, "inet") for name in ("light", "visible", "nee_pdf", "diffuse_share", "known", "known_all")
    )
    bring = found.expected * found.ratio  # what of its lamp's known radiance a sample stands for, (B, N, T, 3)
    part = bring.sum(dim=-1, keepdim=True)
    sums = of_same_light(light, torch.cat([part, part * visible, part.square(), torch.ones_like(part)], dim=-1))
    total, shown, squares, number = sums.split(1, dim=-1)
    shown = _over(shown, total)
    met = row_sum(bring.sum(dim=2))[:, None, None]  # (B, 1, 1, 3)
    shown_of_all = _over(row_sum((part * visible).sum(dim=2)), met[:, 0, 0].sum(dim=-1, keepdim=True))
    share = _over(known, everything)
    steady = (found.balance * found.ratio * value / unit).mean(dim=-1, keepdim=True)
    parts = [
        _checked(samples),
        light.new_tensor([1.0, 0.0]).view(2, 1).expand_as(light),
        (light >= 0.0).float(),
        visible,
        found.balance,
        _logarithm(found.ratio),
        share,
        _logarithm(share.mean(dim=-1, keepdim=True)),
        _over(part, total),
        shown,
        _over(squares, total.square()),  # one over how many samples there are in effect
        _logarithm(number / MANY),
        visible * (visible - shown),
        _logarithm(_over(everything, met, 1.0)),
        shown_of_all[:, None, None].expand_as(light),
        _logarithm(density),
        diffuse.mean(dim=-1, keepdim=True),
        compress(steady),
        _logarithm(everything.mean(dim=-1, keepdim=True) / unit.mean(dim=-1, keepdim=True)),
    ]
    return torch.cat([part.float() for part in parts], dim=-1)


LAMP_TOKENS = Extra(27, lamp_tokens, checked=(0, 1, 2), check=_checked)
