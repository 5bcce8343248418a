"""What a sample of a piecewise smooth function tells a network: differences to its neighbours, as rules use them.

Values are measured from the row's mean in the row's unit, so neither an added constant nor a factor is seen.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, compress, flat, sort_samples, standard
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import interval_weights
from nqr_geom.toy.family import Shape
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.split import Gap, Seen

__all__ = ["CENTRED", "TOY_TERMS", "TOY_TOKENS", "toy_batch", "toy_checked", "toy_doubt", "toy_terms", "toy_tokens"]

_LEVEL = 1e-12  # an added constant is not seen: what varies by more than rounding varies
_ACROSS = 0.98  # of all variation
CENTRED = TokenConfig(centred=True)


def _side(v: Tensor, d: Tensor, other_v: Tensor, other_d: Tensor, step: Tensor, same: Tensor) -> list[Tensor]:
    """What the neighbour at signed distance `step` tells, each (B, N): zero steps beyond the ends tell nothing."""
    rise = torch.where(step != 0.0, other_v - v, 0.0)
    ahead, behind = step * d, step * other_d
    return [
        torch.where(same, rise, 0.0),
        torch.where(same, 0.0, rise),
        ahead,
        torch.where(same, behind - ahead, 0.0),
        torch.where(same, rise - 0.5 * (ahead + behind), 0.0),
        torch.where(same, 0.0, rise - 0.5 * (ahead + behind)),
    ]


def _slopes(samples: Samples) -> Tensor:
    """f' in the row's unit, (B, N) float32."""
    _, unit = standard(samples.value, CENTRED)
    return (samples.feature("derivative", "inet") / unit)[:, :, 0, 0].float()


def toy_checked(samples: Samples) -> Tensor:
    """What tells whether data resemble the family, (B, N, 1, 1) float32."""
    return compress(_slopes(samples), 10.0)[:, :, None, None]


def toy_tokens(samples: Samples) -> Tensor:
    """Quantities of samples sorted by x, (B, N, 1, 14) float32."""
    x = samples.x[..., 0]
    value, unit = standard(samples.value, CENTRED)
    v = (value / unit)[:, :, 0, 0].float()
    d = _slopes(samples)
    piece = samples.feature("piece", "inet")[:, :, 0, 0]
    step = pad(x.diff(dim=1), (1, 1)).float()
    same = pad(piece.diff(dim=1) == 0, (1, 1))
    parts = [
        interval_weights(x).clamp_min(1e-4).log().float(),
        compress(d, 10.0),
        *_side(v, d, torch.roll(v, 1, dims=1), torch.roll(d, 1, dims=1), -step[:, :-1], same[:, :-1]),
        *_side(v, d, torch.roll(v, -1, dims=1), torch.roll(d, -1, dims=1), step[:, 1:], same[:, 1:]),
    ]
    parts[2:] = [part.asinh() for part in parts[2:]]
    return torch.stack(parts, dim=-1)[:, :, None]


def toy_terms(samples: Samples) -> Tensor:
    """`toy_tokens`, and how far the Taylor terms of either side go over both gaps beside each sample, (B, N, 1, 21).

    A break hides between samples of different pieces: what lies there follows from the slopes and the curvatures on
    either side, and curvatures are divided differences of slopes within a piece.
    """
    x, d = samples.x[..., 0], _slopes(samples).double()
    value, unit = standard(samples.value, CENTRED)
    gaps = pad(pad(x, (1, 0)), (0, 1), value=1.0).diff(dim=1)
    left, right = gaps[:, :-1], gaps[:, 1:]
    same = samples.feature("piece", "inet")[:, :, 0, 0].diff(dim=1) == 0
    bend = torch.where(same, d.diff(dim=1) / gaps[:, 1:-1].clamp_min(1e-12), 0.0)
    before, after = pad(bend, (1, 0)), pad(bend, (0, 1))
    terms = [d * left, d * right, before * right.square(), after * left.square(), (after - before) * left * right]
    own = [interval_weights(x) - 1.0, (value / unit)[:, :, 0, 0]]
    parts = torch.stack([*own, *(term.asinh() for term in terms)], dim=-1)[:, :, None]
    return torch.cat([toy_tokens(samples), parts.float()], dim=-1)


def _unlike(samples: Samples) -> Tensor:
    """Integrands, (B,) bool, that do not vary, or between their pieces only: those of the family vary within, too."""
    value = sort_samples(samples)
    piece = value.feature("piece", "inet")[:, :, 0, 0]
    rise = value.value[:, :, 0, 0].diff(dim=1).abs()
    total, across = rise.sum(dim=1), torch.where(piece.diff(dim=1) != 0, rise, 0.0).sum(dim=1)
    return flat(samples, _LEVEL) | (across > _ACROSS * total)


def toy_doubt(samples: Samples) -> Tensor:
    """N times the root of the squared error that is expected of the gap to the right of each sample, (B, N) float64.

    The first sample also answers for the gap to its left. Gaps within pieces whose law is known leave nothing.
    """
    order = samples.x[..., 0].argsort(dim=1, stable=True)
    ordered = samples.permuted(order)
    b, n = order.shape
    seen = Seen.empty(ordered.x, n)
    seen.enter(2, ordered.x[..., 0], ordered.seen)
    columns = torch.tensor([0, *range(2, n + 2), 1], device=order.device).expand(b, n + 2)
    gap = Gap.between(seen, columns[:, :-1], columns[:, 1:], Shape())
    # Two samples tell a parabola, or any law where they are close.
    smooth = (gap.breaks == 0) & gap.known.all(dim=-1)
    told = gap.parabola | (smooth & (gap.width * Shape().frequency[1] < math.tau))
    seen.settled.scatter_add_(1, gap.piece, 3.0 * told.double())
    settled = (gap.breaks == 0) & (seen.settled.gather(1, gap.piece) > 2.5)
    error = torch.where(settled, 0.0, gap.score)  # (B, N + 1)
    own = torch.cat([error[:, :1] + error[:, 1:2], error[:, 2:]], dim=1)
    return torch.empty_like(own).scatter(1, order, n * own.sqrt())


TOY_TOKENS = Extra(14, toy_tokens, checked=(1,), check=toy_checked, foreign=_unlike, doubt=toy_doubt)
TOY_TERMS = replace(TOY_TOKENS, size=21, compute=toy_terms)


def toy_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Random integrands of the family with their integrals, one for each of `rows` (B,)."""
    problem = ToyProblem(rows, seed, split)
    return Batch(problem, problem.pieces.integral()[:, None])
