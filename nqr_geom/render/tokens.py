"""What a sample along a ray tells a network beyond its density, free of the scene's unit of length.

Lengths count in the length of the ray and of a gap, the noise's frequency in cells of a gap. A token carries what the
structure-aware rule makes of the gaps to both sides (`nqr_geom.render.clamped`): the expected density there, how
uncertain it is, and what the sample would have to count for the rule's answer.
"""

from __future__ import annotations

import torch
from torch import Tensor

from nqr_geom.integrator.learn.tokens import Extra, compress
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.sums import row_mean
from nqr_geom.render.clamped import between, in_order, over_nodes

__all__ = ["CONSTANTS", "VOLUME_TOKENS"]

CONSTANTS = 6  # quantities of a ray, which are checked: depth, cells of noise, amplitude, octaves, gain, lacunarity
_SMALL = 1e-3  # densities below are alike, in units of the largest
_NODES = 8


def _logarithm(ratio: Tensor) -> Tensor:
    return ratio.clamp(1e-12, 1e12).log() / 3.0


def _constants(samples: Samples) -> Tensor:
    """What is the same for all samples of a ray, (B, N, 1, 6) float32."""
    depth, length, noise = (samples.feature(name, "inet") for name in ("optical_length", "length", "noise"))
    amplitude, frequency, octaves, gain, lacunarity = noise.split(1, dim=-1)
    parts = [_logarithm(depth), _logarithm(length * frequency), _logarithm(amplitude), octaves / 8.0, gain, lacunarity]
    return torch.cat(parts, dim=-1).float()


def _beside(column: Tensor, shift: int) -> Tensor:
    """Of every sample's neighbour `shift` places further, (B, N); nothing beyond the ends."""
    size = abs(shift)
    padded = torch.nn.functional.pad(column, (size, size))
    return padded[:, size + shift : size + shift + column.shape[1]]


def volume_tokens(samples: Samples) -> Tensor:
    """Quantities of samples sorted by x, those of the whole ray first, (B, N, 1, 44) float32.

    Parameters
    ----------
    samples : Samples
        With the features of a transmittance.
    """
    x, features = in_order(samples, "inet")
    gaps = between(x, features, _NODES)
    n, half = samples.n, _NODES // 2
    length, depth = features["length"][:, :1], features["optical_length"][:, :1]
    u = samples.value[:, :, 0, 0] / depth.clamp_min(1e-300)
    field = (1.0 - features["u_geo"] + features["u_fbm"]).clamp(-4.0, 2.0)
    near, far = over_nodes(gaps.mean[..., :half]), over_nodes(gaps.mean[..., half:])  # halves of each gap, (B, N+1)
    # The part of x that a sample stands for: half of the gaps to both sides, and all beyond the outermost.
    parts = torch.stack([far, near], dim=1) * (0.5 * gaps.width)[:, None]
    own = parts[:, 0, :-1] + parts[:, 1, 1:]
    own = (
        own
        + torch.nn.functional.pad(parts[:, 1, :1], (0, n - 1))
        + torch.nn.functional.pad(parts[:, 0, -1:], (n - 1, 0))
    )
    own = own * n
    doubt = over_nodes(gaps.variance).sqrt()
    cells = gaps.width * (length * features["noise"][:, 1:2])
    steps = gaps.width * length
    learned, plain = row_mean(own)[:, None] * depth, row_mean(samples.value[:, :, 0, 0])[:, None]
    columns = [
        u,
        field,
        features["u_fbm"],
        compress(features["u_geo"]),
        own,
        _logarithm((own + _SMALL) / (u + _SMALL)),
        own * depth,
        (own - u) * depth,
        near[:, :-1], far[:, :-1], near[:, 1:], far[:, 1:],
        doubt[:, :-1], doubt[:, 1:],
        doubt[:, :-1] * gaps.width[:, :-1] * depth * n, doubt[:, 1:] * gaps.width[:, 1:] * depth * n,
        _logarithm(cells[:, :-1]), _logarithm(cells[:, 1:]),
        compress(features["slope"] * steps[:, :-1]), compress(features["slope"] * steps[:, 1:]),
        compress(features["bend"] * steps[:, :-1].square()), compress(features["bend"] * steps[:, 1:].square()),
        *(_beside(column, shift) for column in (field, features["u_fbm"]) for shift in (-2, -1, 1, 2)),
        *(_beside(u, shift) for shift in (-1, 1)),
        learned.expand_as(u), plain.expand_as(u), 8.0 * (learned - plain).expand_as(u),
        torch.exp(-learned).expand_as(u), torch.exp(-plain).expand_as(u),
        16.0 * (row_mean(doubt.square() * gaps.width.square()).sqrt()[:, None] * depth).expand_as(u),
    ]  # fmt: skip
    return torch.cat([_constants(samples), torch.stack(columns, dim=-1).float()[:, :, None]], dim=-1)


VOLUME_TOKENS = Extra(CONSTANTS + 38, volume_tokens, checked=tuple(range(CONSTANTS)), check=_constants)
