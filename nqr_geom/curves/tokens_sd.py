"""What a sample of a smoothed distance tells a network beyond what it tells for a winding number.

Winding numbers know no scale; here lengths count in units of 1 / alpha. So a token adds how sharp alpha is for the
curve, how far the sample lies in that unit and behind the nearest one, and what a structure-aware rule would make of
its neighbourhood: the nearest point of the chords to the middle of the way to both neighbours on the piece (of the
tangent to the piece's ends where there is none), and the integral along them with distance linear on both sides of it.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from nqr_geom.curves.hermite import tangents
from nqr_geom.curves.tokens import CURVE_TOKENS
from nqr_geom.integrator.learn.tokens import Extra
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean

__all__ = ["SD_TOKENS"]

_TINY = 1e-280
_STEEPEST = 60.0  # logarithms beyond it are all the same to a network
_OWN = 9


def _signed_log(value: Tensor) -> Tensor:
    return value.sign() * torch.log1p(value.abs())


def _decay(rise: Tensor) -> Tensor:
    """Mean of exp(-x) over [0, rise], for rise >= 0."""
    return torch.where(rise > 1e-8, -torch.expm1(-rise) / rise.clamp_min(1e-8), 1.0)


def _chord(start: Tensor, end: Tensor, alpha: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
    """alpha (nearest distance - shift) of the chords (B, N, 2) and the logarithm of exp(-alpha (d - shift)) over them.

    Distance is taken as linear from the nearest point to either end.
    """
    step = end - start
    length = torch.linalg.vector_norm(step, dim=-1)
    along = (-(start * step).sum(-1) / step.square().sum(-1).clamp_min(_TINY)).clamp(0.0, 1.0)
    nearest = torch.linalg.vector_norm(start + along[..., None] * step, dim=-1)
    mean = torch.zeros_like(length)
    for share, tip in ((along, start), (1.0 - along, end)):
        rise = alpha * (torch.linalg.vector_norm(tip, dim=-1) - nearest).clamp_min(0.0)
        mean = mean + share * _decay(rise)
    behind = alpha * (nearest - shift)
    return behind, torch.log((length * mean).clamp_min(_TINY)) - behind


def _midpoint(r: Tensor, slope: Tensor, s: Tensor, shifted: int) -> Tensor:
    """Middle of the Hermite cubic from each sample to the one `shifted` places before it, (B, N, 2)."""
    other, other_slope = torch.roll(r, shifted, dims=1), torch.roll(slope, shifted, dims=1)
    return 0.5 * (r + other) + ((torch.roll(s, shifted, dims=1) - s) / 8.0)[..., None] * (slope - other_slope)


def _ends(
    r: Tensor, slope: Tensor, s: Tensor, piece: Tensor, count: Tensor, before: Tensor, after: Tensor
) -> list[Tensor]:
    """Where the piece of each sample would start and end if it went on as a quadratic, (B, N, 2) each."""
    bend = torch.zeros_like(slope)
    for known, shifted in ((before, 1), (after, -1)):
        gap = torch.where(known, s - torch.roll(s, shifted, dims=1), 0.0)
        seen = known & (gap != 0.0)
        turn = (slope - torch.roll(slope, shifted, dims=1)) / torch.where(seen, gap, 1.0)[..., None]
        bend = torch.where(seen[..., None], turn, bend)
    reaches = (piece / count - s)[..., None], ((piece + 1) / count - s)[..., None]
    return [r + reach * slope + 0.5 * reach.square() * bend for reach in reaches]


def sd_tokens(samples: Samples) -> Tensor:
    """Quantities of samples sorted by s, those of a winding number first, (B, N, 1, 46) float32.

    Parameters
    ----------
    samples : Samples
        With the features of a smoothed distance.
    """
    s = samples.x[..., 0]
    piece = samples.feature("piece", "inet")[:, :, 0, 0]
    count = samples.feature("pieces", "inet")[:, :, 0, 0]
    speed = samples.feature("speed", "inet")[:, :, 0, 0]
    alpha = samples.feature("alpha", "inet")[:, :, 0, 0]
    distance = samples.feature("distance2", "inet")[:, :, 0, 0].sqrt()
    r, slope = samples.feature("relative", "inet")[:, :, 0], tangents(samples, "inet")
    shift = distance.amin(dim=1, keepdim=True)
    behind = alpha * (distance - shift)
    unit = torch.log(row_mean(speed * torch.exp(-behind))[:, None].clamp_min(_TINY))
    same = piece.diff(dim=1) == 0
    none = torch.zeros_like(piece[:, :1], dtype=torch.bool)
    before, after = torch.cat([none, same], dim=1), torch.cat([same, none], dim=1)
    ends = _ends(r, slope, s, piece, count, before, after)
    sides = [
        _chord(r, torch.where(known[..., None], _midpoint(r, slope, s, shifted), end), alpha, shift)
        for known, shifted, end in zip((before, after), (1, -1), ends, strict=True)
    ]
    logs = torch.stack([log for _, log in sides], dim=-1)
    most = logs.amax(dim=(1, 2))[:, None]
    own = torch.log(torch.exp(logs - most[..., None]).sum(dim=-1).clamp_min(_TINY)) + most  # of each sample, (B, N)
    whole = torch.log(row_mean(torch.exp(own - most))[:, None].clamp_min(_TINY)) + most
    many = math.log(samples.n)
    parts = [
        torch.log((alpha * row_mean(speed / count)[:, None]).clamp(1e-12, 1e12)) / 3.0,
        torch.log1p(alpha * distance),
        torch.log1p(behind),
        *(_signed_log(nearest) for nearest, _ in sides),
        *(_signed_log(log + many - unit) for _, log in sides),
        _signed_log(own + many + behind - torch.log(speed.clamp_min(_TINY))),  # the weight of the chords' integral
        _signed_log(whole + many - unit).expand_as(s),
    ]
    more = torch.stack(parts, dim=-1).nan_to_num(nan=0.0, posinf=_STEEPEST, neginf=-_STEEPEST)
    return torch.cat([CURVE_TOKENS.compute(samples), more.float()[:, :, None]], dim=-1)


# Checked as for winding numbers, and the sharpness: at another one the network has learned nothing.
SD_TOKENS = Extra(CURVE_TOKENS.size + _OWN, sd_tokens, checked=(*CURVE_TOKENS.checked, CURVE_TOKENS.size))
