"""What a sample on a curve tells a network beyond its features: shape, seen from the query, free of rotation and scale.

Winding numbers do not change when query and curve are turned or scaled together, so lengths are measured in the mean
length of a piece and directions against the line of sight. A token also carries what a structure-aware rule would
look at: the angles that the query subtends with both neighbours on the piece, and with the piece's ends by tangent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nqr_geom.integrator.learn.tokens import Extra, flat, fourier
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean

__all__ = ["CURVE_TOKENS", "Sight", "checked_sizes"]

_TINY = 1e-280
_SMALL = 1e-18  # its square is a normal number in single precision
_FREQUENCIES = 4


Vector = tuple[Tensor, Tensor]
"""Components of vectors: sums over a last axis of two are slow, and round as they like."""


def cross(a: Vector, b: Vector) -> Tensor:
    """a x b of plane vectors."""
    return a[0] * b[1] - a[1] * b[0]


def dot(a: Vector, b: Vector) -> Tensor:
    """a . b of plane vectors."""
    return a[0] * b[0] + a[1] * b[1]


def norm(a: Vector) -> Tensor:
    """Length, not below what single precision can square."""
    return dot(a, a).sqrt().clamp_min(_SMALL)


def scaled(a: Vector, factor: Tensor) -> Vector:
    """factor a."""
    return a[0] * factor, a[1] * factor


def moved(a: Vector, step: Tensor, b: Vector) -> Vector:
    """a + step b."""
    return a[0] + step * b[0], a[1] + step * b[1]


def rolled(a: Vector, shift: int) -> Vector:
    """Every sample's neighbour `shift` places before it."""
    return torch.roll(a[0], shift, dims=1), torch.roll(a[1], shift, dims=1)


def half_turns(a: Vector, b: Vector) -> Tensor:
    """Signed angle from a to b in turns of pi.

    By the tangent of half the angle: torch rounds atan2 differently at the end of an array than inside it.
    """
    x, y = dot(a, b), cross(a, b)
    size = dot(a, a).sqrt() * dot(b, b).sqrt()
    behind = x < 0.0
    below = torch.where(behind, torch.where(y != 0.0, y, _SMALL), (size + x).clamp_min(_SMALL))
    return torch.atan(torch.where(behind, size - x, y) / below) * (2.0 / math.pi)


def logarithm(ratio: Tensor) -> Tensor:
    """Natural logarithm of ratios between 1e-12 and 1e12, brought to order one."""
    return ratio.clamp(1e-12, 1e12).log() / 3.0


@dataclass(frozen=True)
class Sight:
    """Curve samples as their query sees them, lengths in the mean length of a piece; each field (B, N) or a pair.

    Parameters
    ----------
    s, local, piece, count : Tensor
        Parameter, place on the piece in [0, 1], index of the piece, number of pieces.
    r, tangent : Vector
        Position from the query, and its derivative by `local`.
    speed : Tensor
        Length of `tangent`.
    """

    s: Tensor
    local: Tensor
    piece: Tensor
    count: Tensor
    r: Vector
    tangent: Vector
    speed: Tensor

    @classmethod
    def of(cls, samples: Samples, dtype: torch.dtype) -> Sight:
        """From the features of a curve problem; all that is computed here is of order one."""
        s = samples.x[..., 0]
        piece = samples.feature("piece", "inet")[:, :, 0, 0]
        count = samples.feature("pieces", "inet")[:, :, 0, 0]
        relative, normal = (samples.feature(name, "inet")[:, :, 0] for name in ("relative", "normal"))
        speed = samples.feature("speed", "inet")[:, :, 0, 0] / count
        length = row_mean(speed)[:, None].clamp_min(_TINY)  # of a piece, on average
        local = (s * count - piece).clamp(0.0, 1.0).to(dtype)
        speed = (speed / length).to(dtype)
        r = (relative[..., 0] / length).to(dtype), (relative[..., 1] / length).to(dtype)
        tangent = -normal[..., 1].to(dtype) * speed, normal[..., 0].to(dtype) * speed
        return cls(s, local, piece, count, r, tangent, speed)

    @property
    def sizes(self) -> list[Tensor]:
        """Logarithms of distance and speed: what tells whether a shape is like those of the family."""
        return [logarithm(norm(self.r)), logarithm(self.speed)]


def checked_sizes(samples: Samples) -> Tensor:
    """Logarithms of distance and speed of samples in any order, (B, N, 1, 2)."""
    return torch.stack(Sight.of(samples, torch.float32).sizes, dim=-1)[:, :, None]


def _side(r: Vector, other: Vector, unit: Vector, other_unit: Vector, distance: Tensor, known: Tensor) -> list[Tensor]:
    """What one neighbour on the same piece tells, each (B, N); zero where there is none."""
    chord = other[0] - r[0], other[1] - r[1]
    length = dot(chord, chord).sqrt()
    direction = scaled(chord, 1.0 / length.clamp_min(_SMALL))
    quantities = [
        2.0 * half_turns(r, other),
        logarithm(length / distance),
        logarithm(dot(other, other).sqrt() / distance),
        dot(direction, unit),
        cross(direction, unit),
        2.0 * half_turns(unit, other_unit),
    ]
    return [torch.where(known, quantity, 0.0) for quantity in quantities]


def curve_tokens(samples: Samples) -> Tensor:
    """Invariant quantities of samples sorted by s, (B, N, 1, 37) float32.

    Parameters
    ----------
    samples : Samples
        With the features of a curve problem.
    """
    seen = Sight.of(samples, torch.float32)
    r, tangent, local, speed = seen.r, seen.tangent, seen.local, seen.speed
    distance = norm(r)
    sight, unit = scaled(r, 1.0 / distance), scaled(tangent, 1.0 / norm(tangent))
    rest = 1.0 - local
    same = torch.nn.functional.pad(seen.piece.diff(dim=1) == 0, (1, 1))
    before, after = same[:, :-1], same[:, 1:]
    gap = torch.nn.functional.pad(seen.s.diff(dim=1) * samples.n, (1, 1)).float()
    density = (samples.n / seen.count).float()  # samples on a piece, on average
    far, fast = seen.sizes
    parts = [
        far,
        torch.log1p(1.0 / distance),
        dot(sight, unit),
        cross(sight, unit),
        fast,
        torch.log1p(speed / distance),
        local,
        (local * density).log1p(),
        (rest * density).log1p(),
        2.0 * half_turns(moved(r, -local, tangent), r),
        2.0 * half_turns(r, moved(r, rest, tangent)),
        torch.where(before, gap[:, :-1], 0.0).log1p(),
        torch.where(after, gap[:, 1:], 0.0).log1p(),
        *_side(r, rolled(r, 1), unit, rolled(unit, 1), distance, before),
        *_side(r, rolled(r, -1), unit, rolled(unit, -1), distance, after),
        *fourier(local[..., None], _FREQUENCIES).unbind(dim=-1),
        *r,
        *unit,
    ]
    return torch.stack(parts, dim=-1)[:, :, None]


# Distance and speed are what is checked.
CURVE_TOKENS = Extra(13 + 12 + 2 * _FREQUENCIES + 4, curve_tokens, checked=(0, 4), check=checked_sizes, foreign=flat)
