"""What the samples of a piece tell of its law, for a network on plain weights that reads the gaps beside each sample.

Taylor terms tell badly of a wave that turns between two samples, but three samples of it tell all of it. Nothing is
said of what a rule would make of the gaps: where a break hides, both sides are continued, and that is all.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.learn.tokens import standard
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean
from nqr_geom.toy.family import PIECES, Shape
from nqr_geom.toy.law import Law, fit, fit_pairs, stumpff
from nqr_geom.toy.law_tokens import REACH, answered, continued, in_wave, moved, pieces_of, seen, waves
from nqr_geom.toy.tokens import CENTRED, TOY_TERMS, toy_terms

__all__ = ["LAW_TERMS", "law_terms", "missed_by_mean"]

_PLACES = 8  # in a gap
_FAR = 4.0  # that a law is believed to lead away from its sample, in units of the row


def _insides(v: Tensor, d: Tensor, law: Law, gaps: Tensor) -> Tensor:
    """What the integral over each gap has beyond the trapezoid if it lies in one piece of known law, (B, N + 1).

    The left end tells it as well as the right one; the first gap has none.
    """
    alpha, bend, slope, known = (
        torch.cat([part[:, :1], part], dim=1) for part in (law.alpha, law.curvature, d, law.known)
    )
    step = torch.cat([-gaps[:, :1], gaps[:, 1:]], dim=1)
    _, _, c2, c3, _ = stumpff(alpha * step * step)
    whole = gaps * step * (slope * c2 + step * bend * c3) - 0.5 * gaps * pad(v.diff(dim=1), (1, 1))
    return torch.where(known, whole, 0.0)


def _breaks(v: Tensor, d: Tensor, law: Law, gaps: Tensor, hidden: Tensor) -> Tensor:
    """Both laws at places in the gaps where breaks hide, (4, B, N + 1, _PLACES), 0 elsewhere: how far the left one
    leads away from its sample, how far the right one is above it, how far the right one leads away, and where that
    stands in its wave."""
    row, gap = hidden.nonzero(as_tuple=True)
    h = gaps[row, gap, None]
    laws = [pad(part, (1, 1)) for part in (law.alpha, law.curvature, v, d, *waves(v, d, law))]
    before, after = ([part[row, gap + k] for part in laws] for k in (0, 1))
    t = h * ((torch.arange(_PLACES, dtype=v.dtype, device=v.device) + 0.5) / _PLACES)
    left, right = continued(t, *before[:4]), continued(t - h, *after[:4])
    inner = ((gap > 0) & (gap < v.shape[1]))[:, None]
    value, _, wave, above, height = (part[:, None] for part in after[2:])
    high = in_wave(right, value, wave, above, height)
    parts = [left - before[2][:, None], (right - left) * inner, right - value, high]
    result = v.new_zeros(4, *gaps.shape, _PLACES)
    result[:, row, gap] = torch.stack(parts)
    return result


def law_terms(samples: Samples) -> Tensor:
    """`toy_terms`, and what the laws of the pieces say of both gaps beside each sample, (B, N, 1, 105) float32.

    First comes whether the laws of the sample, of the next and of the last one are known, then omega, curvature, and
    the centre and the height of a wave. Then, of the gap to the right and of the one to the left: what its integral
    has beyond the trapezoid if it lies in one piece; at `_PLACES` in it, if a break hides there, how far the law leads
    away from the sample, and how far it is from there to the law of the other side. Then, at the same places, how high
    the right law stands in its wave. Tangents stand for laws that are not known.

    Last, without compression, comes what the gap to the right of the sample has of the integral (that to the left of
    the first one, too) in N times units of the row: what the trapezoid puts there beyond the sample, what the law adds
    to that in a piece, and what either law adds of the gap around every place where a break hides.
    """
    x, v, d, piece = seen(samples)
    piece = piece % PIECES  # as tokens take indices; models do not answer for others
    law = fit_pairs(fit(x, v, d, piece, PIECES), x, v, d, piece, Shape().frequency[1])
    alpha, bend = (torch.where(law.known, part, 0.0) for part in (law.alpha, law.curvature))
    law = replace(law, alpha=alpha, curvature=bend)
    gaps = pad(pad(x, (1, 0)), (0, 1), value=1.0).diff(dim=1)
    hidden = pad(pad(piece, (1, 0)), (0, 1), value=PIECES - 1).diff(dim=1) != 0
    value, unit = (part[..., 0] for part in standard(samples.value, CENTRED))  # (B, N, 1), (B, 1, 1)
    whole = torch.where(hidden, 0.0, _insides(v, d, law, gaps) * samples.n)[..., None] / unit
    ahead, jump, behind, high = _breaks(v, d, law, gaps, hidden)
    ahead, jump, behind = (part / unit for part in (ahead, jump, behind))
    after, before = slice(1, None), slice(None, -1)
    wave, above, height = (part[..., None] for part in waves(v, d, law))
    flags = [law.known, moved(law.known, 1), moved(law.known, -1), alpha.sqrt() * REACH]
    own = [bend[..., None] * REACH**2 / unit, torch.where(wave, value + above, 0.0) / unit, height / unit]
    right = [whole[:, after], ahead[:, after], jump[:, after]]
    left = [whole[:, before], behind[:, before].flip(-1), -jump[:, before].flip(-1)]
    width = (gaps * samples.n)[..., None]
    ahead, behind = (part.clamp(-_FAR, _FAR) * width / _PLACES for part in (ahead, behind))
    ends = pad(value, (0, 0, 1, 1))
    ends[:, 0], ends[:, -1] = value[:, 0], value[:, -1]
    trapezoid = 0.5 * width * (ends[:, 1:] + ends[:, :-1]) / unit
    first = (torch.arange(samples.n, device=x.device) == 0)[:, None]
    parts = [
        torch.stack([flag.double() for flag in flags], dim=-1),
        torch.cat([*own, *right, *left], dim=-1).asinh(),
        *(high[:, after], high[:, before].flip(-1)),
        trapezoid[:, after] + torch.where(first, trapezoid[:, before], 0.0) - value / unit,
        *(whole[:, after], ahead[:, after], behind[:, after]),
        *(torch.where(first, part[:, before], 0.0) for part in (whole, behind)),
    ]
    return torch.cat([toy_terms(samples), torch.cat(parts, dim=-1)[:, :, None].float()], dim=-1)


def missed_by_mean(batch: Batch, samples: Samples) -> Tensor:
    """What the plain mean misses of the part that each of the sorted samples answers for, (B, N) float64.

    Integrand and samples are measured from the mean of the row, which is all of them that a network does not see.
    """
    edges = pad(pad(samples.x[..., 0], (1, 0)), (0, 1), value=1.0)
    mean = row_mean(samples.value[:, :, 0, 0])[:, None]
    parts = answered((pieces_of(batch).antiderivative(edges) - mean * edges).diff(dim=1))
    return parts - (samples.value[:, :, 0, 0] - mean) / samples.n


LAW_TERMS = replace(TOY_TERMS, size=TOY_TERMS.size + 12 + 9 * _PLACES, compute=law_terms)
