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

    step = x.diff(dim=1)
    guess, guess_slope = propagate(alpha[:, :-1], step, value[:, :-1], slope[:, :-1], curvature[:, :-1])
    # Close samples agree with many laws, so the measure is the step itself.
    rise, slopes = value.diff(dim=1), slope[:, :-1].abs() + slope[:, 1:].abs()
    rounding = 1e-14 * (value[:, :-1].abs() + value[:, 1:].abs())
    off = (guess - value[:, 1:]).abs() > _TRUST * (rise.abs() + step * slopes) + rounding
    off = off | ((guess_slope - slope[:, 1:]).abs() > 1e3 * _TRUST * slopes + rounding / step.clamp_min(1e-300))
    off = off & (piece[:, 1:] == piece[:, :-1])
    wrong = total(torch.cat([torch.zeros_like(x[:, :1]), off.to(x.dtype)], dim=1)) > 0.5
    known = (~wrong & (count > 1.5)).gather(1, piece)
    return Law(alpha, curvature, known, (wrong & (count > 2.5)).gather(1, piece))


def fit_pairs(law: Law, x: Tensor, value: Tensor, slope: Tensor, piece: Tensor, highest: float) -> Law:
    """Fill in the law of pieces with two samples, where these are closer than the shortest period.

    A wave's values and slopes at distance h obey h (f0' + f1') / (f1 - f0) = theta cot(theta / 2), theta = omega h. The
    right side falls from 2 to -infinity over one period, so that bisection finds the only root.

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
    same = piece[:, 1:] == piece[:, :-1]
    none = torch.zeros_like(same[:, :1])
    pair = same & ~torch.cat([same[:, 1:], none], dim=1) & ~torch.cat([none, same[:, :-1]], dim=1)
    pair = pair & ~law.known[:, 1:] & (x.diff(dim=1) * highest < 2.0 * math.pi) & (value.diff(dim=1) != 0.0)
    row, left = torch.nonzero(pair, as_tuple=True)
    right = left + 1
    h = x[row, right] - x[row, left]
    rise = value[row, right] - value[row, left]
    ratio = h * (slope[row, left] + slope[row, right]) / rise
    low, high = torch.zeros_like(h), torch.full_like(h, 2.0 * math.pi)
    for _ in range(50):
        middle = 0.5 * (low + high)
        above = middle / torch.tan(0.5 * middle) > ratio
        low, high = torch.where(above, middle, low), torch.where(above, high, middle)
    omega = 0.5 * (low + high) / h
    found = (ratio < 2.0) & (omega <= highest)
    row, left, right, rise, alpha = row[found], left[found], right[found], rise[found], omega[found] ** 2
    bend = (slope[row, right] - slope[row, left]) * ((slope[row, right] + slope[row, left]) / rise)
    gamma = 0.5 * (bend + alpha * (value[row, right] + value[row, left]))
    result = Law(law.alpha.clone(), law.curvature.clone(), law.known.clone(), law.foreign)
    for index in (left, right):
        result.alpha[row, index] = alpha
        result.curvature[row, index] = gamma - alpha * value[row, index]
        result.known[row, index] = True
    return result
