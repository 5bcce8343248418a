"""What a network reads: one token for each sample, built from the problem's schema and from what a rule would use.

Positions get Fourier frequencies, indices a one-hot code (the first linear layer is their embedding), scalars a
logarithmic compression, directions nothing. In one dimension the samples come sorted, and a token also knows its
rank, the gaps to its neighbours and whether they share its index. Everything is finite for any finite input.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Feature, Samples
from nqr_geom.integrator.sums import row_mean

__all__ = ["Extra", "TokenConfig", "compress", "flat", "sort_samples", "standard", "tokenize"]

_LIMIT = 16.0  # no network input exceeds this: e^16 spans every scale that a float64 problem needs after compression


@dataclass(frozen=True)
class Extra:
    """Quantities that an application adds to its tokens: invariants that its own rules use.

    Parameters
    ----------
    size : int
        How many.
    compute : callable
        Samples (sorted along x in one dimension) to a tensor (B, N, T, size).
    checked : tuple of int
        Those of them that tell whether data resemble a family; a model does not answer outside their trained range.
    beside : callable, optional
        Samples to further values of the integrand's kind that were seen with each, (B, N, T, C, K).
    check : callable, optional
        The checked ones alone, (B, N, T, len(checked)), of samples in any order, where that is cheaper.
    taught : tuple of str
        Features that only the samples of a training family bring, or of another problem with the same samples.
    foreign : callable, optional
        Samples to integrals, (B,) bool, that are unlike the family though each of their quantities is within its range.
    doubt : callable, optional
        Samples to what the application's own rule leaves open beside each of them: its expected squared error is the
        mean over N of doubt^2 / N, (B, N).
    """

    size: int
    compute: Callable[[Samples], Tensor]
    checked: tuple[int, ...] = ()
    beside: Callable[[Samples], Tensor] | None = None
    check: Callable[[Samples], Tensor] | None = None
    taught: tuple[str, ...] = ()
    foreign: Callable[[Samples], Tensor] | None = None
    doubt: Callable[[Samples], Tensor] | None = None


def flat(samples: Samples, part: float = 5e-2) -> Tensor:
    """Integrals whose values differ by no more than a part of the largest, (B,) bool.

    Classical rules are exact on constants. Networks are off by their error on the family, whatever the values.
    """
    value = samples.value.flatten(1)
    return value.amax(dim=1) - value.amin(dim=1) <= part * value.abs().amax(dim=1)


@dataclass(frozen=True)
class TokenConfig:
    """Which quantities make a token.

    Parameters
    ----------
    features : tuple of Feature
        Those of the problem's schema that are read. An index beyond its `levels` is taken modulo `levels`.
    dim, channels : int
        D and C of the problem.
    frequencies : int
        Octaves of the Fourier code of each position, starting at half a period over [0, 1].
    extra : int
        Quantities that the application computes itself.
    unit : float or None
        Natural size of a value; None takes the mean of |f| over the row, which makes the rule homogeneous.
    centred : bool
        Read values, and measure their size, from the row's mean: the rule then does not see an added constant.
    blind : bool
        Read no values: the rule is then linear in them, and all channels share its weights.
    """

    features: tuple[Feature, ...] = ()
    dim: int = 1
    channels: int = 1
    frequencies: int = 6
    extra: int = 0
    unit: float | None = None
    centred: bool = False
    blind: bool = False

    @property
    def width(self) -> int:
        """Numbers in a token."""
        width = 2 * self.frequencies * self.dim + (_NEIGHBOUR if self.dim == 1 else 1) + self.extra
        width += 0 if self.blind else self.channels
        for feature in self.features:
            width += _size(feature, self)
        return width

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a model card; `from_dict` is its inverse."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TokenConfig:
        """The configuration that `to_dict` wrote."""
        return cls(**{**data, "features": tuple(Feature(**feature) for feature in data["features"])})


_NEIGHBOUR = 6  # rank, log N, two gaps, two end flags
_INDEX_NEIGHBOUR = 7  # for each index in one dimension: same and jump to both sides, their count, outermost flags


def _size(feature: Feature, config: TokenConfig) -> int:
    if feature.kind == "position":
        return 2 * config.frequencies * feature.size
    if feature.kind == "index":
        return feature.size * feature.levels + (_INDEX_NEIGHBOUR if config.dim == 1 else 0)
    return feature.size


def compress(value: Tensor, unit: Tensor | float = 1.0) -> Tensor:
    """sign(v) log(1 + |v| / unit), which keeps signs and tames any size.

    Examples
    --------
    >>> compress(torch.tensor([-1.0, 0.0])).tolist()
    [-0.6931471824645996, 0.0]
    """
    return value.sign() * torch.log1p(value.abs() / unit)


def fourier(x: Tensor, frequencies: int) -> Tensor:
    """sin and cos of pi 2^k x for k < frequencies, (..., D) -> (..., 2 D frequencies)."""
    octaves = math.pi * 2.0 ** torch.arange(frequencies, device=x.device, dtype=x.dtype)
    angle = (x[..., None] * octaves).flatten(-2)  # (..., D K)
    return torch.cat([angle.sin(), angle.cos()], dim=-1)


def standard(value: Tensor, config: TokenConfig) -> tuple[Tensor, Tensor]:
    """Values (B, N, T, C) from their row's centre, and the row's unit (B, 1, 1, C) as `config` defines it.

    The unit of a row of zeros is 1.
    """
    if config.centred:
        value = value - row_mean(value)[:, None]
    if config.unit is not None:
        return value, value.new_full((value.shape[0], 1, 1, value.shape[3]), config.unit)
    # The largest is taken out first, so that rows near the end of the float range do not overflow in the sum.
    largest = value.abs().amax(dim=(1, 2))[:, None, None]
    safe = torch.where((largest > 0.0) & largest.isfinite(), largest, 1.0)
    mean = row_mean((value / safe).abs().mean(dim=2))[:, None, None] * safe
    return value, torch.where((mean > 0.0) & mean.isfinite(), mean, 1.0)


def sort_samples(samples: Samples) -> Samples:
    """Samples in the order of x; in more than one dimension nothing is moved."""
    if samples.dim != 1:
        return samples
    return samples.permuted(samples.x[..., 0].argsort(dim=1, stable=True))


def _neighbours(x: Tensor) -> Tensor:
    """Rank, log N, gaps to both sides in units of 1/N and end flags of sorted x (B, N) -> (B, N, 6)."""
    batch, n = x.shape
    rank = torch.arange(n, device=x.device, dtype=x.dtype)
    edge = torch.cat([torch.zeros_like(x[:, :1]), x, torch.ones_like(x[:, :1])], dim=1)
    gap = torch.log((n * edge.diff(dim=1)).clamp_min(1e-4)) / 3.0  # (B, N+1)
    ends = torch.stack([rank == 0, rank == n - 1], dim=-1).to(x.dtype)
    count = x.new_full((n, 1), math.log(n / 32.0))
    row = torch.cat([(rank[:, None] + 0.5) / n, count, ends], dim=-1)
    return torch.cat([row.expand(batch, n, 4), gap[:, :-1, None], gap[:, 1:, None]], dim=-1)


def _index_neighbours(index: Tensor) -> Tensor:
    """What the neighbours in x say about an index, (B, N) -> (B, N, 7)."""
    n = index.shape[1]
    jump = index.diff(dim=1).double()
    inner = torch.nn.functional.pad(jump, (1, 1), value=4.0)  # nothing beyond the ends
    same = (inner == 0.0).double()
    hop = inner.clamp(-4.0, 4.0) / 2.0
    count = (index[:, :, None] == index[:, None]).double().sum(-1)
    outermost = (same[:, :-1] + same[:, 1:] == 0.0).double()
    parts = [same[:, :-1], same[:, 1:], hop[:, :-1], hop[:, 1:], torch.log2(count) / 3.0, count / n, outermost]
    return torch.stack(parts, dim=-1)


def tokenize(
    samples: Samples, config: TokenConfig, extra: Extra | None = None, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Network inputs of samples that are sorted in one dimension, (B, N, T, width).

    Parameters
    ----------
    samples : Samples
        B rows of N samples with the features that `config` names.
    config : TokenConfig
        What to read.
    extra : Extra, optional
        The application's own quantities; its size is `config.extra`.
    dtype : torch.dtype
        Of the result.

    Raises
    ------
    ValueError
        If a feature is missing or `extra` does not fit the configuration.
    """
    if (extra.size if extra else 0) != config.extra:
        raise ValueError(f"extra: expected {config.extra} quantities, got {extra.size if extra else 0}")
    x, value = samples.x, samples.value
    techniques = value.shape[2]
    shape = (*value.shape[:3], -1)

    def spread(part: Tensor) -> Tensor:
        return part[:, :, None].expand(*part.shape[:2], techniques, part.shape[-1])

    parts = [spread(fourier(x, config.frequencies))]
    if not config.blind:
        parts.append(compress(*standard(value, config)))
    if config.dim == 1:
        parts.append(spread(_neighbours(x[..., 0])))
    else:
        parts.append(x.new_full((*value.shape[:3], 1), math.log(samples.n / 32.0)))
    for feature in config.features:
        seen = samples.feature(feature.name, "inet")
        if feature.kind == "index":
            code = torch.nn.functional.one_hot(seen.long() % feature.levels, feature.levels)
            parts.append(code.flatten(-2).double())
            if config.dim == 1:
                parts.append(spread(_index_neighbours(seen[:, :, 0, 0])))
        elif feature.kind == "position":
            parts.append(fourier(seen, config.frequencies))
        else:
            parts.append(seen if feature.kind == "direction" else compress(seen))
    if extra is not None:
        parts.append(extra.compute(samples))
    tokens = torch.cat([part.to(dtype).expand(*shape[:3], part.shape[-1]) for part in parts], dim=-1)
    return tokens.nan_to_num_(nan=0.0, posinf=_LIMIT, neginf=-_LIMIT).clamp_(-_LIMIT, _LIMIT)
