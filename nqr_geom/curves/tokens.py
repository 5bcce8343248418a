"""What a sample on a curve tells a network beyond its features: shape, seen from the query, free of rotation and scale.

Winding numbers do not change when query and curve are turned or scaled together, so lengths are measured in the mean
length of a piece and directions against the line of sight. A token also carries what a structure-aware rule would
look at: the angles that the query subtends with both neighbours on the piece, and with the piece's ends by tangent.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from nqr_geom.curves.hermite import tangents
from nqr_geom.integrator.learn.tokens import Extra, fourier
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean

__all__ = ["CURVE_TOKENS"]

_TINY = 1e-280
_SMALL = 1e-18  # its square is a normal number in single precision
_FREQUENCIES = 4


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def _unit(a: Tensor) -> Tensor:
    return a / torch.linalg.vector_norm(a, dim=-1, keepdim=True).clamp_min(_SMALL)


def _angle(a: Tensor, b: Tensor) -> Tensor:
    """Signed angle from a to b in turns of pi, (..., 2) -> (...).

    By the tangent of half the angle: torch rounds atan2 differently at the end of an array than inside it.
    """
    x, y = _dot(a, b), _cross(a, b)
    size = torch.linalg.vector_norm(a, dim=-1) * torch.linalg.vector_norm(b, dim=-1)
    behind = x < 0.0
    below = torch.where(behind, torch.where(y != 0.0, y, _SMALL), (size + x).clamp_min(_SMALL))
    return torch.atan(torch.where(behind, size - x, y) / below) * (2.0 / math.pi)


def _log(ratio: Tensor) -> Tensor:
    return ratio.clamp(1e-12, 1e12).log() / 3.0


def _side(r: Tensor, other: Tensor, unit_tangent: Tensor, other_tangent: Tensor, known: Tensor) -> list[Tensor]:
    """What one neighbour on the same piece tells, each (B, N); zero where there is none."""
    chord = other - r
    distance = torch.linalg.vector_norm(r, dim=-1).clamp_min(_SMALL)
    direction = _unit(chord)
    quantities = [
        2.0 * _angle(r, other),
        _log(torch.linalg.vector_norm(chord, dim=-1) / distance),
        _log(torch.linalg.vector_norm(other, dim=-1) / distance),
        _dot(direction, unit_tangent),
        _cross(direction, unit_tangent),
        2.0 * _angle(unit_tangent, other_tangent),
    ]
    return [torch.where(known, quantity, 0.0) for quantity in quantities]


def curve_tokens(samples: Samples) -> Tensor:
    """Invariant quantities of samples sorted by s, (B, N, 1, 37) float32.

    Parameters
    ----------
    samples : Samples
        With the features of a curve problem.
    """
    s = samples.x[..., 0]
    piece = samples.feature("piece", "inet")[:, :, 0, 0]
    count = samples.feature("pieces", "inet")[:, :, 0, 0]
    speed = samples.feature("speed", "inet")[:, :, 0, 0] / count
    length = row_mean(speed)[:, None].clamp_min(_TINY)  # of a piece, on average
    local = (s * count - piece).clamp(0.0, 1.0).float()
    # Everything below is a ratio of order one, so single precision is enough.
    r = (samples.feature("relative", "inet")[:, :, 0] / length[..., None]).float()
    tangent = (tangents(samples, "inet") / (count * length)[..., None]).float()
    speed = (speed / length).float()
    distance = torch.linalg.vector_norm(r, dim=-1).clamp_min(_SMALL)
    sight, unit = r / distance[..., None], _unit(tangent)
    to_start = r - local[..., None] * tangent
    to_end = r + (1.0 - local)[..., None] * tangent
    same = piece.diff(dim=1) == 0
    none = torch.zeros_like(piece[:, :1], dtype=torch.bool)
    before, after = torch.cat([none, same], dim=1), torch.cat([same, none], dim=1)
    gap = torch.nn.functional.pad(s.diff(dim=1) * samples.n, (1, 1)).float()
    density = (samples.n / count).float()  # samples on a piece, on average
    parts = [
        _log(distance),
        torch.log1p(1.0 / distance),
        _dot(sight, unit),
        _cross(sight, unit),
        _log(speed),
        torch.log1p(speed / distance),
        local,
        (local * density).log1p(),
        ((1.0 - local) * density).log1p(),
        2.0 * _angle(to_start, r),
        2.0 * _angle(r, to_end),
        torch.where(before, gap[:, :-1], 0.0).log1p(),
        torch.where(after, gap[:, 1:], 0.0).log1p(),
        *_side(r, torch.roll(r, 1, dims=1), unit, torch.roll(unit, 1, dims=1), before),
        *_side(r, torch.roll(r, -1, dims=1), unit, torch.roll(unit, -1, dims=1), after),
    ]
    invariants = torch.cat([torch.stack(parts, dim=-1), fourier(local[..., None], _FREQUENCIES)], dim=-1)
    position = torch.cat([r, unit], dim=-1)
    return torch.cat([invariants, position], dim=-1)[:, :, None]


CURVE_TOKENS = Extra(13 + 12 + 2 * _FREQUENCIES + 4, curve_tokens, checked=(0, 4))  # distance and speed
