"""Unbiased ray marching: the exponential's power series around a marched depth, cut by Russian roulette."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from nqr_geom.integrator.sums import row_mean
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.render.problems import TransmittanceProblem

__all__ = ["Marched", "march"]

# Terms of order 1 and 2 are taken together in one of ten marches, order k > 2 follows with probability 2/k.
_GO_ON, _FIRST = 0.1, 2
_MOST = 24  # is reached once in 10^19 marches


class Marched(NamedTuple):
    """Transmittances (B,), density queries, and noise evaluations among them."""

    value: Tensor
    queries: int
    noise: int


def _at_least() -> Tensor:
    """Probability that a march goes to order k or beyond, k = 0 .. _MOST."""
    chances = [1.0] + [_GO_ON] * _FIRST
    for k in range(_FIRST + 1, _MOST + 1):
        chances.append(chances[-1] * _FIRST / k)
    return torch.tensor(chances, dtype=torch.float64)


def _series(depths: Tensor) -> Tensor:
    """Transmittance (B,) from N + 1 independent unbiased depths (B, N + 1): each in turn is the series' centre.

    With X_i as centre, order k is the mean over all products of k different X_i - X_j, whose expectation is
    (X_i - tau)^k.
    """
    order = depths.shape[1] - 1
    apart = depths[:, :, None] - depths[:, None]  # (B, centre, other); a centre's own zero leaves all products alone
    symmetric = [torch.ones_like(depths)] + [torch.zeros_like(depths) for _ in range(order)]
    for other in range(order + 1):
        for k in range(order, 0, -1):
            symmetric[k] = symmetric[k] + apart[:, :, other] * symmetric[k - 1]
    total, ways = torch.zeros_like(depths), 1.0
    for k, chance in enumerate(_at_least()[: order + 1].tolist()):
        ways = ways * (order - k + 1) if k else 1.0  # k! times the number of products of k out of `order`
        total = total + symmetric[k] / (ways * chance)
    return row_mean(torch.exp(-depths) * total)


def march(problem: TransmittanceProblem, n: int, stream: Stream) -> Marched:
    """Unbiased transmittance with n density queries on average.

    Parameters
    ----------
    problem : TransmittanceProblem
        B rays.
    n : int
        Queries wanted on average; single marches take multiples of about 3/4 of it.
    stream : Stream
        Random numbers.

    References
    ----------
    Kettunen, d'Eon, Pantaleoni, Novak, An unbiased ray-marching transmittance estimator, 2021, whose roulette and use
    of every depth as centre this follows; the number of steps here is given, not taken from a control density.
    """
    steps = max(1, int(n / float(_at_least().sum())))
    rows = problem.rows
    chance = stream.child("order").uniform(rows)
    order = (chance[:, None] < _at_least()[None, 1:].to(chance.device)).sum(dim=1)
    value = torch.empty_like(chance)
    queries = noise = 0
    cells = torch.arange(steps, device=rows.device)
    for k in order.unique().tolist():
        part = torch.nonzero(order == k)[:, 0]
        shift = stream.child("shift").uniform(rows[part][:, None], torch.arange(k + 1, device=rows.device))
        x = (cells + shift[..., None]) / steps  # (b, k + 1, steps)
        seen = problem.take(part).evaluate(x.flatten(1)[..., None].clamp_max(1.0 - 2.0**-53))
        depths = seen.value[..., 0, 0].reshape(x.shape)
        value[part] = _series(row_mean(depths.transpose(1, 2)))
        queries += seen.queries
        noise += seen.work.get("noise", 0)
    return Marched(value, queries, noise)
