"""The law of a smooth piece: f'' + alpha f = gamma, and how samples of f and f' tell alpha and gamma.

Lines and parabolas obey it with alpha = 0, waves A sin(omega x + phi) + c with alpha = omega^2. A function that obeys
it is known everywhere from f, f' and f'' at one point, through the Stumpff functions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["Law", "fit", "fit_pairs", "propagate", "stumpff"]

_TRUST = 1e-9  # relative disagreement from which samples count as not obeying a law


def stumpff(z: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Stumpff functions c_k(z) = sum_j (-z)^j / (k + 2j)! for k = 0..4 and z >= 0.

    With z = alpha t^2, f(t) = f(0) + f'(0) t c1 + f''(0) t^2 c2 obeys f'' + alpha f = const; its derivative is
    f'(0) c0 + f''(0) t c1, its integral f(0) t + f'(0) t^2 c2 + f''(0) t^3 c3, and so on: each integral raises k.

    Parameters
    ----------
    z : Tensor, any shape, float64
        Non-negative.

    Returns
    -------
    tuple of Tensor
        c0 .. c4, to a few units of rounding.

    Examples
    --------
    >>> [round(c.item(), 4) for c in stumpff(torch.zeros((), dtype=torch.float64))]
    [1.0, 1.0, 0.5, 0.1667, 0.0417]
    """
    half = 0.5 * z.sqrt()
    sine, cosine = half.sin(), half.cos()
    # The closed forms of c3 and c4 cancel for small z; there their series is exact to rounding.
    small = z < 0.25
    near = torch.where(small, z, 0.0)
    far = torch.where(small, 1.0, z)
    sinc = sine / torch.where(half > 0.0, half, 1.0)
    sinc = torch.where(half > 0.0, sinc, 1.0)
    c1 = sinc * cosine
    c2 = 0.5 * sinc * sinc
    c3 = torch.where(small, _series(near, 3), (1.0 - c1) / far)
    c4 = torch.where(small, _series(near, 4), (0.5 - c2) / far)
    return cosine * cosine - sine * sine, c1, c2, c3, c4


def _series(z: Tensor, k: int) -> Tensor:
    """c_k(z) for z < 1/4 by seven terms of its series (Horner)."""
    total = torch.ones_like(z)
    for j in range(6, 0, -1):
        total = 1.0 - z / ((k + 2 * j - 1) * (k + 2 * j)) * total
    return total / (6.0 if k == 3 else 24.0)


def propagate(alpha: Tensor, t: Tensor, value: Tensor, slope: Tensor, curvature: Tensor) -> tuple[Tensor, Tensor]:
    """f and f' at distance t (of either sign) from a point where f, f' and f'' are known."""
    c0, c1, c2, _, _ = stumpff(alpha * t * t)
    return value + t * (slope * c1 + t * curvature * c2), slope * c0 + t * curvature * c1


@dataclass(frozen=True)
class Law:
    """What is known of the piece that each sample lies in.

    Parameters
    ----------
    alpha : Tensor, (B, N), float64
        omega^2, 0 for lines and parabolas.
    curvature : Tensor, (B, N)
        f'' at each sample.
    known : Tensor, (B, N), bool
        Whether the piece's samples determine its law and agree with it.
    foreign : Tensor, (B, N), bool
        Whether three or more samples disagree with every law.
    """

    alpha: Tensor
    curvature: Tensor
    known: Tensor
    foreign: Tensor


def fit(x: Tensor, value: Tensor, slope: Tensor, piece: Tensor, pieces: int) -> Law:
    """The law of every piece from its samples, ordered by x.

    A law conserves f'^2 + alpha f^2 - 2 gamma f, which is linear in alpha and gamma: least squares over the samples of
    a piece. Three samples determine it (two, if the piece is a parabola); then each sample must follow from its left
    neighbour, or the piece counts as unknown.

    Parameters
    ----------
    x, value, slope : Tensor, (B, N), float64
        Positions in rising order, f and f' there.
    piece : Tensor, (B, N), int64
        Piece of each sample, 0 .. pieces - 1.
    pieces : int
        Number of pieces.

    Returns
    -------
    Law
    """

    def total(terms: Tensor) -> Tensor:
        return terms.new_zeros(terms.shape[0], pieces).scatter_add_(1, piece, terms)

    count = total(torch.ones_like(x)).clamp_min(1.0)
    mean = total(value) / count
    f = value - mean.gather(1, piece)
    unit = f.abs().amax(dim=1, keepdim=True)
    unit = torch.where(unit > 0.0, unit, 1.0)
    f = f / unit
    energy = (slope / unit) ** 2
    square = f * f
    f_f = total(square)
    f_square = total(square * f)
    usable = f_f > 0.0
    tilt = torch.where(usable, f_square / torch.where(usable, f_f, 1.0), 0.0)
    q = square - (f_f / count).gather(1, piece) - tilt.gather(1, piece) * f
    q_q = total(q * q)
    # Up to rounding there is nothing left of f^2 beside 1 and f: two samples, or a line.
    bent = (q_q > 1e-24 * total(square * square)) & (count > 2.5)
    energy = energy - (total(energy) / count).gather(1, piece)
    alpha = torch.where(bent, -total(q * energy) / torch.where(bent, q_q, 1.0), 0.0).clamp_min(0.0)
    gamma = (total(f * energy) + alpha * f_square) / torch.where(usable, 2.0 * f_f, 1.0)
    alpha = alpha.gather(1, piece)
    curvature = unit * (gamma.gather(1, piece) - alpha * f)

    off = _strays(x.diff(dim=1), value, slope, alpha, curvature) & (piece[:, 1:] == piece[:, :-1])
    wrong = total(torch.cat([torch.zeros_like(x[:, :1]), off.to(x.dtype)], dim=1)) > 0.5
    known = (~wrong & (count > 1.5)).gather(1, piece)
    return Law(alpha, curvature, known, (wrong & (count > 2.5)).gather(1, piece))


def _strays(step: Tensor, value: Tensor, slope: Tensor, alpha: Tensor, curvature: Tensor) -> Tensor:
    """Samples (B, N) that do not follow from their left neighbours, (B, N - 1) bool, under laws that broadcast."""
    left, right = slice(None, -1), slice(1, None)
    alpha = alpha.expand_as(value)[:, left]
    guess, guess_slope = propagate(alpha, step, value[:, left], slope[:, left], curvature[:, left])
    # Close samples agree with many laws, so the measure is the step itself.
    rise, slopes = value.diff(dim=1), slope[:, left].abs() + slope[:, right].abs()
    rounding = 1e-14 * (value[:, left].abs() + value[:, right].abs())
    off = (guess - value[:, right]).abs() > _TRUST * (rise.abs() + step * slopes) + rounding
    return off | ((guess_slope - slope[:, right]).abs() > 1e3 * _TRUST * slopes + rounding / step.clamp_min(1e-300))


def _root(ratio: Tensor) -> Tensor:
    """theta in (0, 2 pi) with theta cot(theta / 2) = ratio, for ratios below 2."""
    low, high = torch.zeros_like(ratio), torch.full_like(ratio, 2.0 * math.pi)
    for _ in range(50):
        middle = 0.5 * (low + high)
        above = middle / torch.tan(0.5 * middle) > ratio
        low, high = torch.where(above, middle, low), torch.where(above, high, middle)
    return 0.5 * (low + high)


def _polished(omega: Tensor, h: Tensor, rise: Tensor, both: Tensor) -> Tensor:
    """omega (M, 1) brought to fit all steps h with their rises and sums of slopes (M, K), by Gauss and Newton."""
    for _ in range(4):
        theta = omega * h
        sine, cosine = (0.5 * theta).sin(), (0.5 * theta).cos()
        off = rise * theta * cosine - h * both * sine
        by = h * (rise * (cosine - 0.5 * theta * sine) - 0.5 * h * both * cosine)
        square = by.square().sum(dim=1, keepdim=True)
        omega = omega - (off * by).sum(dim=1, keepdim=True) / torch.where(square > 0.0, square, 1.0)
    return omega


def fit_pairs(law: Law, x: Tensor, value: Tensor, slope: Tensor, piece: Tensor, highest: float) -> Law:
    """Fill in the law of pieces that `fit` does not tell, from two neighbours closer than the shortest period.

    A wave's values and slopes at distance h obey h (f0' + f1') / (f1 - f0) = theta cot(theta / 2), theta = omega h.
    The right side falls from 2 to -infinity over one period, so that bisection finds the only root. Where there are
    more than two samples (`fit` sees squares of f and f' alone, which say nothing where two values are equal), Newton's
    method makes the root fit all neighbours, and then each sample must follow from its left one, as there.

    Parameters
    ----------
    law : Law
        What `fit` found.
    x, value, slope : Tensor, (B, N), float64
        Positions in rising order, f and f' there.
    piece : Tensor, (B, N), int64
        Piece of each sample.
    highest : float
        Largest omega there is.

    Returns
    -------
    Law
    """
    starts = torch.nn.functional.pad(piece[:, 1:] != piece[:, :-1], (1, 0), value=True)
    run = starts.cumsum(dim=1)
    row, first = (starts & ~law.known).nonzero(as_tuple=True)
    count = (run[row] == run[row, first][:, None]).sum(dim=1)
    row, first, count = row[count > 1, None], first[count > 1, None], count[count > 1, None]
    if not len(row):
        return law
    at = torch.arange(int(count.max()), device=x.device)
    column = first + torch.minimum(at, count - 1)  # (M, K): the last sample over and over
    x, f, d, many = x[row, column], value[row, column], slope[row, column], count > 2
    h, rise, both = x.diff(dim=1), f.diff(dim=1), d[:, 1:] + d[:, :-1]  # (M, K - 1)
    # Of what is close enough, the pair that rounding hurts least.
    told = (h > 0.0) & (h * highest < 2.0 * math.pi) & (rise != 0.0)
    pair = torch.where(told, (h * rise).abs(), -1.0).argmax(dim=1, keepdim=True)
    ratio = (h * both / torch.where(told, rise, 1.0)).gather(1, pair)
    step = torch.where(told, h, 1.0).gather(1, pair)
    omega = _root(ratio) / step
    found = told.gather(1, pair) & (ratio < 2.0) & (omega <= highest)
    omega = torch.where(many, _polished(omega, h, rise, both), omega).clamp(0.0, highest)
    alpha, half = omega.square(), 0.5 * omega * step
    turned = torch.where(half > 0.0, half / torch.where(half > 0.0, half, 1.0).tan(), 1.0)
    f0, f1, d0, d1 = (part.gather(1, pair + k) for part in (f, d) for k in (0, 1))
    bend = (d1 - d0) / step * turned + alpha * (0.5 * (f0 + f1) - f)
    found = found & ~(many & _strays(h, f, d, alpha, bend).any(dim=1, keepdim=True))
    # A parabola may be told as badly.
    even = ((d[:, -1:] - d[:, :1]) / (x[:, -1:] - x[:, :1]).clamp_min(1e-300)).expand_as(f)
    parabola = many & ~_strays(h, f, d, torch.zeros_like(alpha), even).any(dim=1, keepdim=True)
    bend, alpha = torch.where(parabola, even, bend), torch.where(parabola, 0.0, alpha)
    keep = (found | parabola).expand_as(column)
    row, column = row.expand_as(column)[keep], column[keep]
    result = Law(*(part.clone() for part in (law.alpha, law.curvature, law.known, law.foreign)))
    result.alpha[row, column] = alpha.expand_as(keep)[keep]
    result.curvature[row, column] = bend[keep]
    result.known[row, column] = True
    result.foreign[row, column] = False
    return result
