"""What a student sees of a sample on a curve: the sample, its two neighbours on the piece, and nothing else.

The same invariants of rotation and scale as in `tokens`, fewer of them, so that a compiled pass can afford them:
`compiled_student` computes the very same numbers and the two change together.
"""

from __future__ import annotations

import torch
from torch import Tensor

from nqr_geom.curves.tokens import (
    Sight,
    Vector,
    checked_sizes,
    cross,
    dot,
    half_turns,
    logarithm,
    moved,
    norm,
    rolled,
    scaled,
)
from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, flat
from nqr_geom.integrator.problem import Samples

__all__ = ["CURVE_STENCIL", "STENCIL_TOKENS"]

_SMALL = 1e-18


def _side(r: Vector, other: Vector, unit: Vector, other_unit: Vector, distance: Tensor, same: Tensor) -> list[Tensor]:
    """What one neighbour tells, each (B, N); zero where it lies on another piece."""
    chord = other[0] - r[0], other[1] - r[1]
    step = dot(chord, chord).sqrt()
    direction = scaled(chord, 1.0 / step.clamp_min(_SMALL))
    quantities = [
        torch.ones_like(step),
        2.0 * half_turns(r, other),
        logarithm(step / distance),
        logarithm(norm(other) / distance),
        dot(direction, unit),
        cross(direction, unit),
        2.0 * half_turns(unit, other_unit),
    ]
    return [torch.where(same, quantity, 0.0) for quantity in quantities]


def curve_stencil(samples: Samples) -> Tensor:
    """Quantities of samples sorted by s, (B, N, 1, 23) float64.

    Parameters
    ----------
    samples : Samples
        With the features of a curve problem.
    """
    seen = Sight.of(samples, torch.float64)
    r, tangent, local = seen.r, seen.tangent, seen.local
    distance = norm(r)
    sight, unit = scaled(r, 1.0 / distance), scaled(tangent, 1.0 / norm(tangent))
    hop = torch.nn.functional.pad(seen.piece.diff(dim=1).double(), (1, 1), value=4.0).clamp(0.0, 4.0) / 2.0
    before, after = hop[:, :-1], hop[:, 1:]
    far, fast = seen.sizes
    parts = [
        far,
        dot(sight, unit),
        cross(sight, unit),
        fast,
        local,
        2.0 * half_turns(moved(r, -local, tangent), r),
        2.0 * half_turns(r, moved(r, 1.0 - local, tangent)),
        before,
        after,
        *_side(r, rolled(r, 1), unit, rolled(unit, 1), distance, before == 0.0),
        *_side(r, rolled(r, -1), unit, rolled(unit, -1), distance, after == 0.0),
    ]
    return torch.stack(parts, dim=-1)[:, :, None]


CURVE_STENCIL = Extra(
    9 + 14,
    curve_stencil,
    checked=(0, 3),  # distance and speed
    check=checked_sizes,
    foreign=flat,
)
STENCIL_TOKENS = TokenConfig(frequencies=0, extra=CURVE_STENCIL.size, unit=1.0)
