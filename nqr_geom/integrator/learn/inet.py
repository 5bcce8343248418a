"""The integration network: a bidirectional transformer that corrects a base rule (Section 4, Fig. 7).

F = a + (1/N) sum (W_i + dW_i) f_i + (1/N) sum o_i, where W and a are the base rule's. The heads start at zero, so an
untrained network is its base rule bit for bit; with the base "uniform" and no offset it is the paper's Eq. 1, with the
offset Eq. 52. The network works in float32, the combination in float64.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any, Literal

import torch
from torch import Tensor, nn

from nqr_geom import check
from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, standard, tokenize
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.integrator.sums import row_mean

__all__ = ["INet", "INetConfig", "LearnedRule", "UniformWeights", "correct", "doubt", "least_change"]

TILE_TOKENS = 256 * 32  # float32 products change with the batch size, so a network always sees this many tokens
_LEAST_GROWTH = -30.0
_NOTHING = 1e-3  # of a row's unit


@dataclass(frozen=True)
class INetConfig:
    """Architecture; 3 layers of 64 hold 0.16 M parameters, 0.6 MB.

    Parameters
    ----------
    tokens : TokenConfig
        What the network reads.
    layers, width, heads, expansion : int
        Transformer blocks, channels of a token, attention heads, and hidden width of an MLP over `width`. With 0 layers
        every token is read alone, by an MLP of two hidden layers: a student, which a compiled pass can afford.
    weights : {"relative", "additive", "kept"}
        How a weight is corrected. "kept": not at all. "additive" is the plain form, W = base + h. "relative" is
        W = base e^g + h c with c = min(1, unit / |f|): a weight at a near singularity of f can become as small as 1/f
        without the network having to hit it to that accuracy, and what h adds to an estimate is bounded.
    offset : bool
        Whether there is an offset head, in the row's unit.
    spread : bool
        The offset is not added: weights change as little as they can, in squares, to move the integral as far and to
        keep constants. So the rule has weights alone, and yet a network can add what its tokens tell of an integral.
    unit_mass : bool
        Take the mean out of the correction, so that constants are integrated as by the base rule.
    doubtful_only : bool
        Correct only the integrals that the base rule itself flags, where it is exact or nearly so elsewhere.
    beside : int
        Values that the application has seen beside each sample's own (`Extra.beside`). Each gets a weight, which
        counts from the mean of the row: an added constant is not seen.
    growth : float
        Largest g.
    in_doubt : bool
        All outputs are in units of what the base rule leaves open beside each sample (`Extra.doubt`): a network whose
        outputs are right to a part in a hundred does no harm where the base rule is nearly exact.
    gated : bool
        The network's own rule, on plain weights whatever the base is, stands beside the base's answer, and the network
        says for every integral which part of the answer it is: none before training, so that it begins as its base.
    positive : bool
        The integrals are known not to be negative: where the corrected estimate is not positive, a model answers with
        its base, and says so unless the base has seen nothing either. In training the clamp of Eq. 56 takes care of it.
    direct : bool
        The heads read the tokens themselves, too: what a token already tells, two layers need not copy.
    reach : int
        Samples on either side that a block's MLP reads beside its own, where samples lie in a row (D = 1). Attention
        can find neighbours, but has to learn where they are.

    Raises
    ------
    ValueError
        If an offset shall be spread that there is not, or samples without an order shall reach for their neighbours.
    """

    tokens: TokenConfig = field(default_factory=TokenConfig)
    layers: int = 3
    width: int = 64
    heads: int = 2
    expansion: int = 3
    weights: Literal["relative", "additive", "kept"] = "relative"
    offset: bool = False
    spread: bool = False
    unit_mass: bool = False
    doubtful_only: bool = False
    beside: int = 0
    growth: float = 3.0
    in_doubt: bool = False
    gated: bool = False
    positive: bool = False
    direct: bool = False
    reach: int = 0

    def __post_init__(self) -> None:
        if self.spread and not self.offset:
            raise ValueError("spread: expected False for a network without an offset, got True")
        check.integer("reach", self.reach, low=0)
        if self.reach and self.tokens.dim != 1:
            raise ValueError(f"reach: expected 0 for samples in {self.tokens.dim} dimensions, got {self.reach}")

    @property
    def skips(self) -> bool:
        """Whether tokens that the base rule leaves nothing open beside are not read: no other token looks at them."""
        return self.in_doubt and self.layers == 0

    @property
    def outputs(self) -> int:
        """Numbers a token gives: for each channel g (if weights are relative), h (unless they are kept), and o (if
        there is an offset); then the weights of the values beside, and the gate."""
        heads = {"relative": 2, "additive": 1, "kept": 0}[self.weights] + self.offset
        return self.tokens.channels * heads + self.beside + self.gated

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a model card; `from_dict` is its inverse."""
        return {**asdict(self), "tokens": self.tokens.to_dict()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> INetConfig:
        """The configuration that `to_dict` wrote."""
        return cls(**{**data, "tokens": TokenConfig.from_dict(data["tokens"])})


class Block(nn.Module):
    """Pre-norm transformer block; what no gradient needs is overwritten: fresh memory costs as much as products do."""

    def __init__(self, width: int, heads: int, expansion: int, reach: int = 0) -> None:
        super().__init__()
        self.heads, self.reach = heads, reach
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.up = nn.Linear((2 * reach + 1) * width, expansion * width)
        self.down = nn.Linear(expansion * width, width)

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        """x (B, L, E); bias (B, 1, 1, L) is 0 for tokens and -inf for padding."""
        b, n, e = x.shape
        qkv = self.qkv(self.norm1(x)).view(b, n, 3, self.heads, e // self.heads)  # (B, L, 3, H, E/H)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)  # (B, H, L, E/H) each
        mix = nn.functional.scaled_dot_product_attention(q, k, v, None if bias is None else bias.to(q.dtype))
        x = self.out(mix.transpose(1, 2).reshape(b, n, e)).add_(x)  # (B, L, E)
        y = self.norm2(x)
        if self.reach:
            if bias is not None:
                y = y.masked_fill(bias[:, 0, 0, :, None] < 0.0, 0.0)  # as beyond the ends
            beside = nn.functional.pad(y, (0, 0, self.reach, self.reach))
            y = torch.cat([beside[:, k : k + n] for k in range(2 * self.reach + 1)], dim=-1)
        return self.down(self.up(y).relu_()).add_(x)  # (B, L, E)


class INet(nn.Module):
    """Tokens (B, L, width) to the heads' raw outputs (B, L, outputs), zero before training.

    Parameters
    ----------
    config : INetConfig
        Architecture.
    """

    def __init__(self, config: INetConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.embed_in, self.embed_out = nn.Linear(config.tokens.width, 2 * width), nn.Linear(2 * width, width)
        sizes = width, config.heads, config.expansion, config.reach
        self.blocks = nn.ModuleList(Block(*sizes) for _ in range(config.layers))
        self.norm = nn.LayerNorm(width) if config.layers else nn.ReLU()
        self.head = nn.Linear(width + config.direct * config.tokens.width, config.outputs)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, tokens: Tensor, padding: Tensor | None = None) -> Tensor:
        """Raw outputs; `padding` (B, L) is True where a token is to be ignored."""
        x = self.embed_out(self.embed_in(tokens).relu_())  # (B, L, E)
        bias = None
        if padding is not None:
            bias = torch.zeros_like(padding, dtype=x.dtype).masked_fill(padding, -torch.inf)[:, None, None]
        for block in self.blocks:
            x = block(x, bias)  # (B, L, E)
        x = self.norm(x)
        own, direct = self.head.weight.split([x.shape[-1], self.head.in_features - x.shape[-1]], dim=1)
        raw = nn.functional.linear(x, own, self.head.bias)
        if self.config.direct:
            raw = raw + nn.functional.linear(tokens, direct)
        return raw if raw.dtype == torch.float64 else raw.float()  # (B, L, outputs)


def correct(
    raw: Tensor, base: Combination, samples: Samples, config: INetConfig, extra: Extra | None = None
) -> Combination:
    """Apply raw outputs (B, N, T, outputs) to the base rule's combination, in float64.

    Where all outputs are zero the result is the base rule's, bit for bit. `extra` brings the values beside, if any.
    """
    value, unit = standard(samples.value, config.tokens)
    raw = raw.to(value.dtype)
    if config.gated:
        raw, gate = raw.split([config.outputs - 1, 1], dim=-1)
        plain = Combination(UniformWeights().combine(samples).weights, doubt=base.doubt)
        own = correct(raw, plain, samples, replace(config, gated=False), extra)
        return _gated(torch.tanh(row_mean(gate.sum(dim=2))), own, base)  # (B, 1)
    if config.in_doubt:
        raw = raw * doubt(samples, extra)[..., None, None]
    raw, beside = raw.split([config.outputs - config.beside, config.beside], dim=-1)
    parts = list(raw.split(config.tokens.channels, dim=-1))
    weights = base.weights
    if config.weights == "relative":
        # Not base + base expm1(g): beside a singularity the weight must be right relative to itself, not to 1.
        weights = weights * torch.exp(parts.pop(0).clamp(_LEAST_GROWTH, config.growth))  # g
    if config.weights != "kept":
        change = parts.pop(0)  # h
        if config.weights == "relative":
            change = change * (unit / torch.maximum(value.abs(), unit))
        if config.unit_mass:
            change = change - row_mean(weights - base.weights + change)[:, None]
        weights = weights + change
    shift = row_mean((parts.pop(0) * unit).sum(dim=2)) if config.offset else None  # (B, C)
    if config.spread and shift is not None:
        weights, shift = weights + least_change(shift, samples.value), None
    if config.beside:
        if extra is None or extra.beside is None:
            raise ValueError(f"extra: expected one that brings {config.beside} values beside each sample's, got none")
        away = extra.beside(samples) - row_mean(samples.value)[:, None, ..., None]  # (B, N, T, C, K)
        more = row_mean((beside[..., None, :] * away).sum(dim=-1).sum(dim=2))  # (B, C)
        shift = more if shift is None else shift + more
    if config.doubtful_only and base.fallback is not None:
        weights = torch.where(base.fallback[:, None, None, None], weights, base.weights)
        shift = None if shift is None else torch.where(base.fallback[:, None], shift, 0.0)
    offset = base.offset
    if shift is not None and offset is not None:
        offset = offset + (shift[:, None] if offset.ndim == 3 else shift)
    elif shift is not None:
        offset = shift
    return replace(base, weights=weights, offset=offset)


def least_change(shift: Tensor, value: Tensor) -> Tensor:
    """The smallest change of weights, in squares, that adds `shift` (B, C) to the integral and keeps constants.

    Parameters
    ----------
    shift : Tensor, (B, C)
        Added to the mean over N of the sum over T; nothing is where values do not vary.
    value : Tensor, (B, N, T, C)
        Values of the samples.

    Returns
    -------
    Tensor, (B, N, T, C)

    Examples
    --------
    >>> value = torch.tensor([1.0, 2.0, 6.0], dtype=torch.float64)[None, :, None, None]
    >>> change = least_change(torch.tensor([[0.7]], dtype=torch.float64), value)
    >>> round((change * value).mean().item(), 12), abs(change.mean().item()) < 1e-12
    (0.7, True)
    """
    away = value - (row_mean(value.sum(dim=2)) / value.shape[2])[:, None, None]
    square = row_mean(away.square().sum(dim=2))  # (B, C)
    varies = square > 0.0
    return torch.where(varies, shift / torch.where(varies, square, 1.0), 0.0)[:, None, None] * away


def _gated(part: Tensor, own: Combination, base: Combination) -> Combination:
    """part (B, 1) of a network's own rule and the rest of its base: exactly that where the part is 0."""
    none = part.new_zeros(1, 1)
    mine, theirs = (none if offset is None else offset for offset in (own.offset, base.offset))
    weights = base.weights + part[..., None, None] * (own.weights - base.weights)
    offset = theirs + (part[:, None] if theirs.ndim == 3 else part) * (mine - theirs)
    return replace(base, weights=weights, offset=offset)


def doubt(samples: Samples, extra: Extra | None) -> Tensor:
    """What the application's own rule leaves open beside each sample, (B, N)."""
    if extra is None or extra.doubt is None:
        raise ValueError("extra: expected one that tells its rule's doubt, got none")
    return extra.doubt(samples)


def _kept_positive(mine: Combination, base: Combination, samples: Samples, tokens: TokenConfig) -> Combination:
    """The base's answer where a corrected estimate is not positive, and a flag if that answer is not nothing."""
    wrong = ~(mine.estimate(samples) > 0.0).all(dim=1)  # (B,)
    offset = mine.offset
    if offset is not None:
        before = offset.new_zeros(1, 1) if base.offset is None else base.offset
        shape = (-1, *[1] * (offset.ndim - 1))
        offset = torch.where(wrong.view(shape), before[:, None] if before.ndim < offset.ndim else before, offset)
    weights = torch.where(wrong[:, None, None, None], base.weights, mine.weights)
    gave_way = wrong & (base.estimate(samples) > _NOTHING * standard(samples.value, tokens)[1][:, 0, 0]).any(dim=1)
    flags = gave_way if mine.fallback is None else gave_way | mine.fallback
    return replace(mine, weights=weights, offset=offset, fallback=flags)


class UniformWeights(Rule):
    """W = 1 whatever placed the points: the paper's base, which only a network makes right for adaptive samples."""

    name = "uniform"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        return Combination(samples.value.new_ones(1, 1, 1, 1))


@dataclass(frozen=True)
class LearnedRule(Rule):
    """A base rule corrected by a network.

    Parameters
    ----------
    net : INet
        The network.
    base : Rule
        What it corrects.
    extra : Extra, optional
        Quantities of the application that its tokens hold.
    half : bool, optional
        Whether matrices are multiplied in bfloat16, as in training; by default where the processor does so by
        tiles (AMX) and there are attention layers to gain from it.
    """

    net: INet
    base: Rule
    extra: Extra | None = None
    half: bool | None = None

    name = "inet"

    def combine(self, samples: Samples) -> Combination:
        base = self.base.combine(samples)
        if self.net.config.doubtful_only and base.fallback is not None:
            doubtful = base.fallback.nonzero()[:, 0]
            raw = self.net.head.weight.new_zeros(*samples.value.shape[:3], self.net.config.outputs)
            if len(doubtful):
                raw[doubtful] = self._raw(samples.take(doubtful))
        else:
            raw = self._raw(samples)
        corrected = correct(raw, base, samples, self.net.config, self.extra)
        if not self.net.config.positive:
            return corrected
        return _kept_positive(corrected, base, samples, self.net.config.tokens)

    def outputs(self, tokens: Tensor) -> Tensor:
        """The network's outputs for tokens (B, L, width) in its own precision, (B, L, outputs).

        Rows go through in tiles of a size that depends on the length alone; the last tile is filled up.
        """
        b, length = tokens.shape[:2]
        rows = max(1, TILE_TOKENS // length)
        raw = torch.empty(b, length, self.net.config.outputs, dtype=tokens.dtype, device=tokens.device)
        half = has_bfloat16() and self.net.config.layers > 0 if self.half is None else self.half
        half = half and tokens.device.type == "cpu" and tokens.dtype == torch.float32
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=half):
            for start in range(0, b, rows):
                tile = tokens[start : start + rows]
                full = torch.nn.functional.pad(tile, (0, 0, 0, 0, 0, rows - len(tile)))
                raw[start : start + rows] = self.net(full)[: len(tile)]
        return raw

    def _raw(self, samples: Samples) -> Tensor:
        """The network's outputs for every sample, (B, N, T, outputs).

        Rows go from tokens to outputs while they are in the cache. They are in the order of their first coordinate, so
        that another order of the same samples changes no bit.
        """
        order = samples.x[..., 0].argsort(dim=1, stable=True)
        ordered = samples.permuted(order) if samples.dim == 1 else samples
        b, n, t = samples.value.shape[:3]
        rows = max(1, TILE_TOKENS // (n * t))
        kind = self.net.head.weight.dtype
        raw = torch.zeros(b, n, t, self.net.config.outputs, dtype=kind, device=samples.x.device)
        read: list[Tensor] = []  # the tokens that are not skipped: few, so that those of many rows fill a tile
        at = doubt(samples, self.extra).gather(1, order) > 0.0 if self.net.config.skips else None
        for start in range(0, b, rows):
            part = slice(start, min(start + rows, b))
            tokens = tokenize(ordered.take(part), self.net.config.tokens, self.extra, kind)
            if samples.dim > 1:  # tokens do not know their neighbours, and are less to move than samples
                tokens = tokens.gather(1, order[part][..., None, None].expand_as(tokens))
            if at is None:
                raw[part] = self.outputs(tokens.flatten(1, 2)).unflatten(1, (n, t))
            else:
                read.append(tokens[at[part]])
        if at is not None and bool(at.any()):
            raw[at] = self.outputs(torch.cat(read))
        return torch.empty_like(raw).scatter(1, order[..., None, None].expand_as(raw), raw)


@cache
def has_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 matrices by tiles (AMX).

    By its vector unit alone (AVX-512) it does so no faster than in float32, and converting costs more than that: see
    `benchmarks/precision.py`.
    """
    told: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(told.get("amx_bf16"))
