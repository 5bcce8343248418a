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
from nqr_geom.curves.tokens import CURVE_TOKENS, Vector, checked_sizes, dot, logarithm, moved, rolled, scaled
from nqr_geom.integrator.learn.tokens import Extra, flat
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean

__all__ = ["SD_TOKENS"]

_TINY = 1e-280
_STEEPEST = 1e3  # far beyond what a token can hold
_E_FOLDS = 3.0  # brings logarithms to order one; they stay linear, as those of the weights that a network has to find
_OWN = 10


def _decay(rise: Tensor) -> Tensor:
    """Mean of exp(-x) over [0, rise], for rise >= 0."""
    return torch.where(rise > 1e-8, -torch.expm1(-rise) / rise.clamp_min(1e-8), 1.0)


def _chord(start: Vector, end: Vector, alpha: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
    """alpha (nearest distance - shift) of chords, and the logarithm of exp(-alpha (d - shift)) over them, (B, N) each.

    Distance is taken as linear from the nearest point to either end.
    """
    step = end[0] - start[0], end[1] - start[1]
    length2 = dot(step, step)
    along = (-dot(start, step) / length2.clamp_min(_TINY)).clamp(0.0, 1.0)
    foot = moved(start, along, step)
    nearest = dot(foot, foot).sqrt()
    mean = torch.zeros_like(length2)
    for share, tip in ((along, start), (1.0 - along, end)):
        mean = mean + share * _decay(alpha * (dot(tip, tip).sqrt() - nearest).clamp_min(0.0))
    behind = alpha * (nearest - shift)
    return behind, torch.log((length2.sqrt() * mean).clamp_min(_TINY)) - behind


def _midpoint(r: Vector, slope: Vector, s: Tensor, shifted: int) -> Vector:
    """Middle of the Hermite cubic from each sample to the one `shifted` places before it."""
    other, other_slope = rolled(r, shifted), rolled(slope, shifted)
    eighth = (torch.roll(s, shifted, dims=1) - s) / 8.0
    x, y = (0.5 * (a + b) + eighth * (t - u) for a, b, t, u in zip(r, other, slope, other_slope, strict=True))
    return x, y


def _bend(slope: Vector, s: Tensor, before: Tensor, after: Tensor) -> Vector:
    """How the slope changes towards a neighbour on the same piece; zero where there is none."""
    bend = torch.zeros_like(s), torch.zeros_like(s)
    for known, shifted in ((before, 1), (after, -1)):
        gap = torch.where(known, s - torch.roll(s, shifted, dims=1), 0.0)
        seen, other = known & (gap != 0.0), rolled(slope, shifted)
        turn = scaled((slope[0] - other[0], slope[1] - other[1]), 1.0 / torch.where(seen, gap, 1.0))
        bend = torch.where(seen, turn[0], bend[0]), torch.where(seen, turn[1], bend[1])
    return bend


def _to(known: Tensor, there: Vector, otherwise: Vector) -> Vector:
    """One point or the other."""
    return torch.where(known, there[0], otherwise[0]), torch.where(known, there[1], otherwise[1])


def _sharpness(speed: Tensor, count: Tensor, alpha: Tensor) -> Tensor:
    """alpha times the mean length of a piece, (B, N): a logarithm."""
    return logarithm(alpha * row_mean(speed / count)[:, None])


def _checked(samples: Samples) -> Tensor:
    """What is checked of winding numbers, and the sharpness, (B, N, 1, 3)."""
    speed, count, alpha = (samples.feature(name, "inet")[..., 0] for name in ("speed", "pieces", "alpha"))
    sizes = checked_sizes(samples)
    return torch.cat(
        [sizes, _sharpness(speed[:, :, 0], count[:, :, 0], alpha[:, :, 0]).to(sizes)[:, :, None, None]], -1
    )


def sd_tokens(samples: Samples) -> Tensor:
    """Quantities of samples sorted by s, those of a winding number first, (B, N, 1, 47) float32.

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
    relative, tangent = samples.feature("relative", "inet")[:, :, 0], tangents(samples, "inet")
    r, slope = (relative[..., 0], relative[..., 1]), (tangent[..., 0], tangent[..., 1])
    shift = distance.amin(dim=1, keepdim=True)
    behind = alpha * (distance - shift)
    unit = torch.log(row_mean(speed * torch.exp(-behind))[:, None].clamp_min(_TINY))
    same = piece.diff(dim=1) == 0
    none = torch.zeros_like(piece[:, :1], dtype=torch.bool)
    before, after = torch.cat([none, same], dim=1), torch.cat([same, none], dim=1)
    bend, sides = _bend(slope, s, before, after), []
    for known, shifted, end in ((before, 1, piece), (after, -1, piece + 1)):
        reach = end / count - s
        tip = moved(moved(r, reach, slope), 0.5 * reach.square(), bend)  # where the piece ends if it goes on like this
        sides.append(_chord(r, _to(known, _midpoint(r, slope, s, shifted), tip), alpha, shift))
    logs = torch.stack([log for _, log in sides], dim=-1)
    most = logs.amax(dim=(1, 2))[:, None]
    own = torch.log(torch.exp(logs - most[..., None]).sum(dim=-1).clamp_min(_TINY)) + most  # of each sample, (B, N)
    whole = torch.log(row_mean(torch.exp(own - most))[:, None].clamp_min(_TINY)) + most
    many = math.log(samples.n)
    parts = [
        _sharpness(speed, count, alpha).expand_as(s),
        torch.log1p(alpha * distance),
        torch.log1p(behind),
        behind / _E_FOLDS,
        *(nearest / _E_FOLDS for nearest, _ in sides),
        *((log + many - unit) / _E_FOLDS for _, log in sides),
        (own + many + behind - torch.log(speed.clamp_min(_TINY))) / _E_FOLDS,  # the weight of the chords' integral
        ((whole + many - unit) / _E_FOLDS).expand_as(s),
    ]
    more = torch.stack(parts, dim=-1).nan_to_num(nan=0.0, posinf=_STEEPEST, neginf=-_STEEPEST)
    return torch.cat([CURVE_TOKENS.compute(samples), more.float()[:, :, None]], dim=-1)


# Checked as for winding numbers, and the sharpness: at another one the network has learned nothing.
SD_TOKENS = Extra(
    CURVE_TOKENS.size + _OWN,
    sd_tokens,
    checked=(*CURVE_TOKENS.checked, CURVE_TOKENS.size),
    check=_checked,
    foreign=flat,
)
