"""What the gaps of `ToyHermite` tell a network that corrects it: the laws on either side, and where a break may lie.

A token stands for one sample and for the gap to its right; the first one also answers for the gap to its left.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.learn.tokens import Extra
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean, row_sum
from nqr_geom.toy.family import PIECES, Pieces, Shape
from nqr_geom.toy.law import Law, propagate
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.structured import GapIntegrals, ToyHermite
from nqr_geom.toy.tokens import TOY_TOKENS, toy_checked, toy_doubt, toy_tokens

__all__ = [
    "LAW_TOKENS",
    "REACH",
    "answered",
    "continued",
    "law_tokens",
    "missed",
    "moved",
    "pieces_of",
    "seen",
    "waves",
]

REACH = 0.04  # a usual gap: slopes and curvatures count over this distance
_NODES = 8  # places of a break, from one end of a gap to the other
_OWN = 14  # quantities of a sample
_BESIDE = _OWN + 6
_ROW = 6
_LARGEST = 1e6  # of a continued law, in jumps
_SLOWEST = (0.5 * Shape().frequency[0]) ** 2  # alpha of a wave: below, rounding bends a parabola
_SIZE = TOY_TOKENS.size + _OWN + 4 * _BESIDE + 3 * _NODES + 3 + _ROW


def waves(v: Tensor, d: Tensor, law: Law) -> tuple[Tensor, Tensor, Tensor]:
    """Whether each sample lies in a known wave, how far above it that one is centred, and its height, (B, N) each."""
    wave = law.known & (law.alpha > _SLOWEST)
    alpha = torch.where(wave, law.alpha, 1.0)
    above = torch.where(wave, law.curvature / alpha, 0.0)
    return wave, above, torch.where(wave, (d * d / alpha + above * above).sqrt(), 0.0)


def _own(samples: Samples, law: Law, level: Tensor) -> Tensor:
    """What is known of each sample and of its piece, (B, N, _OWN): sizes in jumps, lengths in tenths."""
    x, v, d, piece = seen(samples)
    jump, known = Shape().jump, law.known
    wave, above, height = waves(v, d, law)

    def of_pieces(value: Tensor, start: float, way: str) -> Tensor:
        return x.new_full((len(x), PIECES), start).scatter_reduce_(1, piece, value, way)

    count = of_pieces(torch.ones_like(x), 0.0, "sum")
    first, last = of_pieces(x, 2.0, "amin"), of_pieces(x, -1.0, "amax")
    before = pad(last.cummax(dim=1).values[:, :-1].clamp_min(0.0), (1, 0))
    after = pad(first.flip(1).cummin(dim=1).values.flip(1)[:, 1:].clamp_max(1.0), (0, 1), value=1.0)
    count, first, last, before, after = (part.gather(1, piece) for part in (count, first, last, before, after))
    parts = [
        (v - level) / jump,
        (d * (REACH / jump)).asinh(),
        torch.where(known, law.curvature * (REACH**2 / jump), 0.0).asinh(),
        torch.where(wave, law.alpha, 0.0).sqrt() * REACH,
        known,
        wave,
        torch.where(wave, v + above - level, 0.0) / jump,
        height,
        count == 1,
        count == 2,
        10.0 * (x - first),
        10.0 * (last - x),
        10.0 * (first - before),
        10.0 * (after - last),
    ]
    return torch.stack([part.double() for part in parts], dim=-1)


def seen(samples: Samples) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """x, f, f' and piece index, (B, N) each."""
    d, piece = (samples.feature(name, "inet")[..., 0, 0] for name in ("derivative", "piece"))
    return samples.x[..., 0], samples.value[..., 0, 0], d, piece


def moved(part: Tensor, by: int) -> Tensor:
    """What lies `by` samples farther on (B, N, ...), zeros beyond the ends."""
    tail = (0, 0) * (part.ndim - 2)
    return pad(part, (*tail, 0, by))[:, by:] if by > 0 else pad(part, (*tail, -by, 0))[:, :by]


def _beside(own: Tensor, x: Tensor, piece: Tensor, by: int) -> Tensor:
    """The sample `by` places farther on, (B, N, _BESIDE); beyond the ends of the row, the end of [0, 1]."""
    there = moved(torch.ones_like(x), by)
    end = float(by > 0)
    far = torch.where(there > 0.0, moved(x, by), end)
    hop = (torch.where(there > 0.0, moved(piece, by), (PIECES - 1) * int(by > 0)) - piece).abs()
    away = (far - x).abs()
    parts = [there, 10.0 * away, away.clamp_min(1e-6).log() / 4.0, hop == 0, hop == 1, hop]
    return torch.cat([moved(own, by), torch.stack([part.double() for part in parts], dim=-1)], dim=-1)


def continued(t: Tensor, alpha: Tensor, curvature: Tensor, value: Tensor, slope: Tensor) -> Tensor:
    """f at distances t (B, N, K) from points where all else (B, N) is known."""
    alpha, curvature, value, slope = (part[..., None] for part in (alpha, curvature, value, slope))
    return propagate(alpha, t, value, slope, curvature)[0]


def in_wave(at: Tensor, value: Tensor, wave: Tensor, above: Tensor, height: Tensor) -> Tensor:
    """Where in the wave of a sample with that value, as `waves` tells it, heights stand: -1 .. 1; 0 in no wave."""
    return torch.where(wave, (at - value - above) / height.clamp_min(1e-12), 0.0).clamp(-2.0, 2.0)


def _across(samples: Samples, law: Law) -> Tensor:
    """Both laws over the gap to the right of each sample, (B, N, 3 _NODES): their difference, the left one, and how
    high the right one stands if it is a wave, of its own height."""
    x, v, d, _ = seen(samples)
    u = torch.linspace(0.0, 1.0, _NODES, dtype=x.dtype, device=x.device)
    there = moved(torch.ones_like(x), 1)[..., None]
    step = (torch.where(there[..., 0] > 0.0, moved(x, 1), 1.0) - x)[..., None]
    laws = *(torch.where(law.known, part, 0.0) for part in (law.alpha, law.curvature)), v, d, *waves(v, d, law)

    beyond = [moved(part, 1) for part in laws]
    left, right = continued(u * step, *laws[:4]), continued((u - 1.0) * step, *beyond[:4])
    _, _, value, _, wave, above, height = (part[..., None] for part in beyond)
    jump = Shape().jump
    parts = [(right - left) / jump * there, (left - v[..., None]) / jump]
    return torch.cat(
        [*(part.clamp(-_LARGEST, _LARGEST).asinh() for part in parts), in_wave(right, value, wave, above, height)],
        dim=-1,
    )


def _spread(v: Tensor) -> Tensor:
    """Logarithm of the standard deviation of values, (B, 1)."""
    return (row_mean((v - row_mean(v)[:, None]).square())[:, None].sqrt() + 1e-30).log()


def _row(samples: Samples, law: Law, level: Tensor) -> Tensor:
    """What the whole row tells, (B, 1, _ROW): the spread of values, and the mean centre of the waves."""
    _, v, d, _ = seen(samples)
    jump = Shape().jump
    wave, above, _ = waves(v, d, law)
    off = torch.where(wave, v - level + above, 0.0)
    count = wave.sum(dim=1, keepdim=True)
    centre = row_sum(off)[:, None] / count.clamp_min(1)
    low, high = (end[:, None] - level for end in v.aminmax(dim=1))
    middle = v.median(dim=1, keepdim=True).values - level
    parts = [low / jump, high / jump, middle / jump, centre / jump, (count > 0).to(v.dtype), _spread(v)]
    return torch.stack(parts, dim=-1)


def law_tokens(samples: Samples, gaps: GapIntegrals | None = None) -> Tensor:
    """Quantities of samples sorted by x, (B, N, 1, size) float32; those of `toy_tokens` come first.

    `gaps` is what `ToyHermite` says of them, if that is known.
    """
    x, v, _, piece = seen(samples)
    level = row_mean(v)[:, None]
    gaps = gaps or ToyHermite().gaps(samples)
    own = _own(samples, gaps.law, level)
    h = gaps.edges.diff(dim=1)[:, 1:]
    mean = gaps.integral[:, 1:] / h.clamp_min(1e-12) - level
    doubt = toy_doubt(samples) / samples.n
    parts = [
        own,
        *(_beside(own, x, piece, by) for by in (-2, -1, 1, 2)),
        _across(samples, gaps.law),
        (mean / Shape().jump).asinh()[..., None],
        (doubt.clamp_min(1e-9).log() / 4.0)[..., None],
        x[..., None],
        _row(samples, gaps.law, level).expand(*x.shape, _ROW),
    ]
    return torch.cat([toy_tokens(samples)[:, :, 0], torch.cat(parts, dim=-1).float()], dim=-1)[:, :, None]


def _checked(samples: Samples) -> Tensor:
    """What tells whether data resemble the family, (B, N, 1, 2) float32: slopes, and the spread of values."""
    slope = toy_checked(samples)
    return torch.cat([slope, _spread(samples.value[..., 0, 0]).float()[..., None, None].expand_as(slope)], dim=-1)


def pieces_of(batch: Batch) -> Pieces:
    """The integrands of a batch."""
    if not isinstance(batch.problem, ToyProblem):
        raise TypeError(f"batch: expected integrals of ToyProblem, got {type(batch.problem).__name__}")
    return batch.problem.pieces


def answered(gaps: Tensor) -> Tensor:
    """What each of N samples answers for, (B, N), of N + 1 gaps: the one to its right; the first, both."""
    return torch.cat([gaps[:, :1] + gaps[:, 1:2], gaps[:, 2:]], dim=1)


def missed(batch: Batch, samples: Samples) -> Tensor:
    """What `ToyHermite` misses of the gaps that each of the sorted samples answers for, (B, N) float64."""
    gaps = ToyHermite().gaps(samples)
    return answered(pieces_of(batch).antiderivative(gaps.edges).diff(dim=1) - gaps.integral)


LAW_TOKENS = Extra(
    _SIZE,
    law_tokens,
    checked=(*TOY_TOKENS.checked, _SIZE - 1),
    check=_checked,
    foreign=TOY_TOKENS.foreign,
    doubt=toy_doubt,
)
