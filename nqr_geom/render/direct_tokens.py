"""What a pass of direct light tells a network: Table 5 for both techniques, and what structure-aware rules make of it.

Radiance counts in the mean of the row's values, so nothing depends on how bright a scene is. Beside its own features a
token carries its weight by the balance heuristic, and, as all samples of one light know the same of it, how much of
that light they see and how far their sum is from its irradiance in closed form.
"""

from __future__ import annotations

import torch
from torch import Tensor

from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, compress, fourier, standard
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.sums import row_mean
from nqr_geom.render.direct_rules import known_light, of_same_light

__all__ = ["DIRECT_TOKENS", "KNOWN_TOKENS"]

_PLACES, _DIRECTIONS = 5, 3  # frequencies, as in Table 5
_TYPICAL = 0.1  # radius over distance that stands where no light was hit
_PLAIN = TokenConfig(dim=6, channels=3)


def _logarithm(ratio: Tensor) -> Tensor:
    return ratio.clamp(1e-6, 1e6).log() / 3.0


def _checked(samples: Samples) -> Tensor:
    """How sharp the reflection is, how large the light is seen and how often it is chosen, (B, N, T, 3)."""
    pdf, radius, distance, chance = (
        samples.feature(name, "inet") for name in ("bsdf_pdf", "light_radius", "light_distance", "chance")
    )
    seen = torch.where(distance > 0.0, radius / distance.clamp_min(1e-300), _TYPICAL)
    chosen = torch.where(chance > 0.0, chance, 1.0)
    return torch.cat([pdf.clamp(0.0, 1e12).log1p(), _logarithm(seen), _logarithm(chosen)], dim=-1).float()


def _alike(samples: Samples) -> Tensor:
    """Whether two samples of a row speak of the same light, (B, L, L) for the L = N T of them."""
    light = samples.feature("light", "inet").flatten(1)
    return ((light[:, :, None] == light[:, None]) & (light >= 0.0)[:, None]).double()


def _gathered(alike: Tensor, terms: Tensor) -> Tensor:
    """Sum over all samples of the same light, (B, N, T, 1) -> (B, N, T, 1)."""
    return (alike * terms.flatten(1)[:, None]).sum(dim=-1).reshape(terms.shape)


def direct_tokens(samples: Samples) -> Tensor:
    """Quantities of every technique's samples, those that are checked first, (B, N, T, 100) float32.

    Parameters
    ----------
    samples : Samples
        With the features of direct light.
    """
    value, unit = standard(samples.value, _PLAIN)
    get = {name: samples.feature(name, "inet") for name in samples.seen.features}
    balance = BalanceHeuristic().combine(samples).weights  # (B, N, T, 1)
    hit, alike = get["light"] >= 0.0, _alike(samples)
    counted = torch.where(hit, balance * get["lambert"] / samples.n, 0.0)
    sampled = _gathered(alike, counted)
    some = sampled > 0.0
    ratio = torch.where(some, get["irradiance"] / torch.where(some, sampled, 1.0), 1.0)
    shown = torch.where(some, _gathered(alike, counted * get["visible"]) / torch.where(some, sampled, 1.0), 0.0)
    steady = balance * (1.0 + get["diffuse_share"] * (ratio.clamp(0.0, 1e6) - 1.0))  # as the structured rule has it
    plain, exact = balance * value / unit, steady * value / unit
    means = [row_mean(part.sum(dim=2)) for part in (plain, exact)]  # (B, 3)
    spread = row_mean((plain.sum(dim=2) - means[0][:, None]).square()).sqrt()
    rows = [part[:, None, None].expand_as(value) for part in (*means, spread)]
    kind = torch.eye(2, dtype=value.dtype, device=value.device).expand(*value.shape[:2], 2, 2)
    unhidden = get["irradiance"] * get["radiance"] * get["bsdf"] / unit
    parts = [
        _checked(samples),
        kind,
        fourier(get["pss"], _PLACES),
        fourier(0.5 * get["direction"], _DIRECTIONS),
        get["direction"],
        balance,
        *(compress(part) for part in (plain, exact)),
        *(_logarithm(get[name]) for name in ("nee_pdf", "bsdf_pdf", "lambert", "irradiance")),
        get["nee_ratio"].clamp(0.0, 4.0),
        compress(get["bsdf"]),
        get["diffuse_share"],
        get["light_direction"],
        _logarithm(get["light_distance"]),
        _logarithm(get["light_radius"]),
        hit.double(),
        get["visible"],
        _logarithm(ratio),
        shown,
        compress(unhidden),
        compress(get["unhidden"] / unit),
        *(compress(row) for row in rows),
    ]
    return torch.cat([part.float() for part in parts], dim=-1)


DIRECT_TOKENS = Extra(
    3 + 2 + 6 * _PLACES + 6 * _DIRECTIONS + 3 + 1 + 6 + 4 + 3 + 3 + 3 + 3 + 6 + 6 + 9,
    direct_tokens,
    checked=(0, 1, 2),
    check=_checked,
)


def known_tokens(samples: Samples) -> Tensor:
    """`direct_tokens`, then what `direct-known` makes of the sample and of its light, (B, N, T, 114) float32."""
    value, unit = standard(samples.value, _PLAIN)
    found = known_light(samples, "inet")
    light, visible = samples.feature("light", "inet"), samples.feature("visible", "inet")
    part = (found.expected * found.ratio).sum(dim=-1, keepdim=True)  # of its light's known radiance
    total, seen, squares = (of_same_light(light, terms) for terms in (part, part * visible, part.square()))
    some = total > 0.0
    safe = torch.where(some, total, 1.0)
    steady = found.balance * found.ratio * value / unit
    mean = row_mean(steady.sum(dim=2))[:, None, None].expand_as(value)
    known, everything = (samples.feature(name, "inet") / unit for name in ("known", "known_all"))
    parts = [
        compress(steady),
        compress(known),
        compress(mean),
        part / safe,
        seen / safe,
        torch.where(some, squares / safe.square(), 0.0),  # one over how many samples there are in effect
        visible * (visible - seen / safe),
        _logarithm(everything.sum(dim=-1, keepdim=True)),
    ]
    return torch.cat([direct_tokens(samples), *(part.float() for part in parts)], dim=-1)


KNOWN_TOKENS = Extra(
    DIRECT_TOKENS.size + 3 + 3 + 3 + 5, known_tokens, checked=DIRECT_TOKENS.checked, check=DIRECT_TOKENS.check
)
