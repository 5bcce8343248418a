"""What a network on plain weights reads and learns from: the weights under which `ToyHermite` would answer.

An additive term says what a gap holds beyond its two ends; plain weights have to say it by how much either end counts.
Of all weights that do, those nearest to the trapezoid's are moderate, smooth, and told.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean, row_sum
from nqr_geom.toy.family import Shape
from nqr_geom.toy.law_tokens import LAW_TOKENS, law_tokens, moved, pieces_of
from nqr_geom.toy.structured import ToyHermite
from nqr_geom.toy.tokens import toy_doubt

__all__ = ["TOLD_TOKENS", "missed_by_weights", "weights_of"]

_MOST = 16.0  # that a sample is told to count more
_SMALL = 0.01  # squared values, of the row's mean square, that count as near zero
_NONE = 1e-300
_SHAPE = Shape()


def weights_of(samples: Samples, edges: Tensor, integral: Tensor) -> Tensor:
    """Weights under which the mean of the samples is what given integrals over their gaps add up to, (B, N).

    They are the trapezoid's, and the least change (in squares) of both ends of every gap that makes its integral right.
    Where both ends are near zero, the rest of it goes to all samples of the row. Rows of zeros keep the trapezoid.

    Parameters
    ----------
    samples : Samples
        Sorted by x.
    edges : Tensor, (B, N + 2)
        0, the samples' x, 1.
    integral : Tensor, (B, N + 1)
        Over each gap.
    """
    value, n = samples.value[:, :, 0, 0], samples.n
    first, inner, last = edges.diff(dim=1).split([1, n - 1, 1], dim=1)
    left, right = torch.cat([first, 0.5 * inner], dim=1), torch.cat([0.5 * inner, last], dim=1)
    off = integral - pad(left * value, (0, 1)) - pad(right * value, (1, 0))
    square = row_mean(value.square())[:, None]
    ends = pad(value.square(), (1, 1))
    size = (ends[:, :-1] + ends[:, 1:] + _SMALL * square).clamp_min(_NONE)
    share = off / size
    rest = row_sum(share * (_SMALL * square))[:, None] / (n * square).clamp_min(_NONE)
    return n * (left + right + (share[:, :-1] + share[:, 1:] + rest) * value)


def _told(samples: Samples) -> Tensor:
    """`law_tokens`, and by how much the weight in the rule's answer is above 1, as it is and compressed."""
    gaps = ToyHermite().gaps(samples)
    more = weights_of(samples, gaps.edges, gaps.integral) - 1.0
    parts = torch.stack([more.clamp(-_MOST, _MOST), more.asinh()], dim=-1)[:, :, None]
    return torch.cat([law_tokens(samples, gaps), parts.float()], dim=-1)


def _doubt(samples: Samples) -> Tensor:
    """N times the root of the squared error that is expected of half of the gaps to both sides, (B, N) float64."""
    order = samples.x[..., 0].argsort(dim=1, stable=True)
    right = toy_doubt(samples).gather(1, order)  # the first one's holds its left gap, too
    both = torch.hypot(right, moved(right, -1)) / 2.0
    return torch.empty_like(both).scatter(1, order, both)


def _foreign(samples: Samples) -> Tensor:
    """Integrands, (B,) bool, that do not vary as the family does, or at a level where none of it lies.

    Networks see values from the level of their row. An additive term may not care, but weights apply to all of a value.
    """
    off = (row_mean(samples.value[:, :, 0, 0]) - _SHAPE.level).abs()
    elsewhere = off > _SHAPE.level_spread + _SHAPE.band + _SHAPE.amplitude[1]
    return elsewhere if LAW_TOKENS.foreign is None else elsewhere | LAW_TOKENS.foreign(samples)


def missed_by_weights(batch: Batch, samples: Samples) -> Tensor:
    """What plain weights miss of the part that each of the sorted samples should have of the integral, (B, N)."""
    edges = pad(pad(samples.x[..., 0], (1, 0)), (0, 1), value=1.0)
    weights = weights_of(samples, edges, pieces_of(batch).antiderivative(edges).diff(dim=1))
    return (weights - 1.0) * samples.value[:, :, 0, 0] / samples.n


TOLD_TOKENS = replace(LAW_TOKENS, size=LAW_TOKENS.size + 2, compute=_told, foreign=_foreign, doubt=_doubt)
