"""The sampling network: a causal transformer that says where to look next (Section 5, Fig. 13).

Each sample becomes a token when it is seen and attends to all earlier ones, whose keys and values are kept. A head
turns the newest state into a density with exact probabilities: `GapHead` (one dimension) chooses a gap between earlier
samples and a place in it, relative to a base sampler; `GridHead` (the paper's) is piecewise constant on the cube. Both
start as their base: an untrained network is its base sampler. A small part of every density is uniform.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from nqr_geom import check
from nqr_geom.integrator.learn.gaps import Gaps
from nqr_geom.integrator.learn.inet import Block
from nqr_geom.integrator.learn.tokens import TokenConfig, tokenize
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import Sampler, Stratified
from nqr_geom.streams import Stream

__all__ = ["LearnedSampler", "Rollout", "SNet", "SNetConfig"]

TILE_ROWS = 256  # float32 products change with the batch size, so the network always sees this many rows
_COUNTS = 3  # is there a sample yet, i / n, log n
_CLOSED = -1e9


@dataclass(frozen=True)
class SNetConfig:
    """Architecture of a sampling network.

    Parameters
    ----------
    tokens : TokenConfig
        What is read of a sample by itself.
    layers, width, heads, expansion : int
        As for `INetConfig`.
    head : {"gap", "grid"}
        See the module.
    gap_size : int
        Features of a gap, `Gaps.size`.
    sharpness : float
        Base of the gap head: a gap is chosen with probability proportional to its worth to this power; 0 is the
        uniform density.
    profile : tuple of float
        Base of the gap head: probabilities of equal bins within a gap.
    grid : tuple of tuple of int
        Cells of the grid head: one tuple for each group of axes that has a joint density; groups are independent.
    floor : float
        Part of the density that is uniform, in (0, 1).
    """

    tokens: TokenConfig = field(default_factory=TokenConfig)
    layers: int = 2
    width: int = 48
    heads: int = 2
    expansion: int = 3
    head: Literal["gap", "grid"] = "gap"
    gap_size: int = 0
    sharpness: float = 0.0
    profile: tuple[float, ...] = (0.1,) * 10
    grid: tuple[tuple[int, ...], ...] = ()
    floor: float = 0.02

    def __post_init__(self) -> None:
        check.number("floor", self.floor, low=0.0, high=1.0, open_low=True)
        if self.head == "gap" and (self.tokens.dim != 1 or self.gap_size < 1):
            raise ValueError(f"head: 'gap' needs one dimension and gaps, got {self.tokens.dim} and {self.gap_size}")
        if self.head == "grid" and sum(map(len, self.grid)) != self.tokens.dim:
            raise ValueError(f"grid: expected {self.tokens.dim} axes in all, got {self.grid}")

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a model card; `from_dict` is its inverse."""
        return {**asdict(self), "tokens": self.tokens.to_dict()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> SNetConfig:
        """The configuration that `to_dict` wrote."""
        grid = tuple(tuple(axes) for axes in data["grid"])
        tokens = TokenConfig.from_dict(data["tokens"])
        return cls(**{**data, "tokens": tokens, "profile": tuple(data["profile"]), "grid": grid})


class Rollout:
    """Sequences of samples and what scoring them again takes.

    Not a dataclass: Fabric would round the tensors of one to half precision on their way into a network.

    Parameters
    ----------
    samples : Samples
        In order of placement, with the density of each given those before it.
    tokens : Tensor, (B, N, width), float32
        What the network had read before each choice; the last sample is not read.
    trace : dict of str to Tensor
        The head's own record.
    """

    def __init__(self, samples: Samples, tokens: Tensor, trace: dict[str, Tensor]) -> None:
        self.samples, self.tokens, self.trace = samples, tokens, trace


class CausalBlock(Block):
    """A transformer block that can also take one token at a time, beside the keys and values of those before."""

    def one(self, x: Tensor, cache: Tensor, at: int) -> Tensor:
        """The newest token x (B, E); `cache` (2, B, H, N, E/H) is written in place at index `at`."""
        b, e = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(b, 3, self.heads, e // self.heads).unbind(dim=1)  # (B, H, E/H)
        cache[0, :, :, at], cache[1, :, :, at] = k, v
        keys, values = cache[:, :, :, : at + 1]  # (B, H, at+1, E/H)
        score = (keys * (q * (e // self.heads) ** -0.5)[..., None, :]).sum(
            dim=-1
        )  # (B, H, at+1); faster than a product
        mix = (score.softmax(dim=-1)[..., None, :] @ values)[..., 0, :]  # (B, H, E/H)
        x = x + self.out(mix.reshape(b, e))
        return x + self.down(self.up(self.norm2(x)).relu())  # (B, E)


class Trunk(nn.Module):
    """Tokens to states; state i has seen the tokens 0 .. i."""

    def __init__(self, size: int, config: SNetConfig) -> None:
        super().__init__()
        self.config = config
        self.embed_in, self.embed_out = nn.Linear(size, 2 * config.width), nn.Linear(2 * config.width, config.width)
        self.blocks = nn.ModuleList(
            CausalBlock(config.width, config.heads, config.expansion) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(config.width)

    def forward(self, tokens: Tensor) -> Tensor:
        """All states (B, N, E) of tokens (B, N, size) at once."""
        n = tokens.shape[1]
        later = torch.full((n, n), -torch.inf, device=tokens.device).triu(1)[None, None]
        x = self.embed_out(self.embed_in(tokens).relu())
        for block in self.blocks:
            x = block(x, later)
        states: Tensor = self.norm(x)
        return states

    def cache(self, batch: int, n: int) -> list[Tensor]:
        """Room for the keys and values of n tokens."""
        c, like = self.config, self.embed_in.weight
        return [like.new_empty(2, batch, c.heads, n, c.width // c.heads) for _ in self.blocks]

    def one(self, token: Tensor, cache: list[Tensor], at: int) -> Tensor:
        """State (B, E) after the token (B, size) with index `at`."""
        x = self.embed_out(self.embed_in(token).relu())
        for block, kept in zip(self.blocks, cache, strict=True):
            x = cast(CausalBlock, block).one(x, kept, at)
        state: Tensor = self.norm(x)
        return state


class Head(nn.Module):
    """Turns a state into a density on the cube, chooses a point by it and scores the choice again."""

    numbers: int  # uniform numbers a choice takes

    @abstractmethod
    def begin(self, problem: Problem, n: int) -> Any:
        """What the head keeps while n samples are placed."""

    @abstractmethod
    def choose(self, kept: Any, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Point (B, D), its density (B,) and a record of the choice, from a state (B, E) and numbers u in (0, 1)."""

    @abstractmethod
    def observe(self, kept: Any, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        """Take note of what was seen at x (B, D); what the next token holds of it, (B, K)."""

    @abstractmethod
    def trace(self, kept: Any, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        """All that `log_density` needs."""

    @abstractmethod
    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        """Logarithm of the density of every choice, (B, N), given all states (B, N, E)."""


def _pick(probability: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Index drawn by inversion from probabilities (B, K), and the part of its interval that u (B,) left over."""
    total = probability.double().cumsum(dim=1)
    at = u * total[:, -1]
    index = torch.searchsorted(total, at[:, None], right=True).clamp_max(total.shape[1] - 1)
    below = torch.where(index > 0, total.gather(1, (index - 1).clamp_min(0)), 0.0)
    size = (total.gather(1, index) - below).clamp_min(1e-300)
    return index[:, 0], ((at[:, None] - below) / size).clamp(0.0, 1.0 - 2.0**-53)[:, 0]


class GridHead(Head):
    """Piecewise constant densities on grids over groups of axes, independent of each other; uniform at the start."""

    def __init__(self, config: SNetConfig) -> None:
        super().__init__()
        self.axes, self.floor = config.grid, config.floor
        self.cells = [math.prod(axes) for axes in config.grid]
        self.logits = nn.Linear(config.width, sum(self.cells))
        nn.init.zeros_(self.logits.weight)
        nn.init.zeros_(self.logits.bias)
        self.numbers = 1 + len(config.grid) + config.tokens.dim
        self.extra = 0

    def begin(self, problem: Problem, n: int) -> None:
        return None

    def choose(self, kept: None, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        anywhere = u[:, 0] < self.floor
        inside = u[:, 1 + len(self.axes) :]
        parts, first = [], 0
        logs = [part.log_softmax(dim=-1) for part in self.logits(state).float().split(self.cells, dim=-1)]
        for group, axes in enumerate(self.axes):
            cell, _ = _pick(logs[group].exp(), u[:, 1 + group])
            for axis, size in enumerate(axes):
                below = math.prod(axes[axis + 1 :])
                parts.append(((cell // below) % size + inside[:, first]) / size)
                first += 1
        x = torch.where(anywhere[:, None], inside, torch.stack(parts, dim=1)).clamp_max(1.0 - 2.0**-53)
        cells = self._cells_of(x)
        return x, self._density(logs, cells[:, None]).double()[:, 0].exp(), {"cell": cells}

    def _cells_of(self, x: Tensor) -> Tensor:
        """Cell of every group, (B, groups)."""
        cells, first = [], 0
        for axes in self.axes:
            cell = torch.zeros(len(x), dtype=torch.int64, device=x.device)
            for size in axes:
                cell = cell * size + (x[:, first] * size).long().clamp_max(size - 1)
                first += 1
            cells.append(cell)
        return torch.stack(cells, dim=1)

    def _density(self, logs: list[Tensor], cells: Tensor) -> Tensor:
        """Logarithm of the density in cells (B, N, groups), of log probabilities (B, K) or (B, N, K)."""
        total = torch.zeros(cells.shape[:2], device=cells.device)
        for group, log in enumerate(logs):
            table = log if log.ndim == 3 else log[:, None]
            total = total + table.gather(2, cells[..., group, None])[..., 0] + math.log(self.cells[group])
        return _floored(total, self.floor)

    def observe(self, kept: None, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        return x.new_zeros(len(x), 0).float()

    def trace(self, kept: None, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        return {"cell": torch.stack([record["cell"] for record in records], dim=1)}

    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        logits = self.logits(states).float().split(self.cells, dim=-1)
        return self._density([part.log_softmax(dim=-1) for part in logits], trace["cell"])


def _floored(log_density: Tensor, floor: float) -> Tensor:
    """Logarithm of (1 - floor) times a density plus floor."""
    return torch.logaddexp(log_density + math.log1p(-floor), log_density.new_tensor(math.log(floor)))


@dataclass
class _Kept:
    gaps: Gaps
    keys: Tensor
    keyed: int = 0


class GapHead(Head):
    """A gap between earlier samples, then one of equal bins in it.

    A gap's logit is its base's plus the product of a key (the gap's features and the state when it opened) and a
    query (the state now); a bin's logit is the base profile's plus a small network's of both.
    """

    def __init__(self, config: SNetConfig, gaps: Callable[[Problem, int], Gaps]) -> None:
        super().__init__()
        width = config.width
        self.gaps, self.floor, self.sharpness = gaps, config.floor, config.sharpness
        self.key_in, self.key_out = nn.Linear(config.gap_size + width, width), nn.Linear(width, width)
        self.query, self.bias = nn.Linear(width, width), nn.Linear(width, 1)
        self.bin_key, self.bin_state = nn.Linear(width, width), nn.Linear(width, width, bias=False)
        self.bins = nn.Linear(width, len(config.profile))
        for layer in (self.query, self.bias, self.bins):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        profile = torch.tensor(config.profile)
        self.register_buffer("profile", (profile / profile.sum()).log(), persistent=False)
        self.numbers = 3
        self.extra = 2 * config.gap_size

    def begin(self, problem: Problem, n: int) -> _Kept:
        gaps = self.gaps(problem, n)
        return _Kept(gaps, gaps.features.new_zeros(*gaps.open.shape, self.query.out_features))

    def _keys(self, features: Tensor, states: Tensor) -> Tensor:
        return self.key_out(self.key_in(torch.cat([features, states], dim=-1)).relu())

    def _base(self, gaps: Gaps) -> Tensor:
        """Base logits of all slots, (B, S) float32; closed ones get none."""
        used = slice(0, gaps.used)
        base = torch.full(gaps.open.shape, _CLOSED, device=gaps.open.device)
        if self.sharpness > 0.0:
            worth = self.sharpness * gaps.worth()
        else:
            worth = (gaps.right[:, used] - gaps.left[:, used]).clamp_min(1e-300).log()
        base[:, used] = torch.where(gaps.open[:, used], worth, _CLOSED).float()
        return base

    def _bins(self, keys: Tensor, states: Tensor) -> Tensor:
        """Log probabilities of the bins of gaps with these keys."""
        logits = self.bins((self.bin_key(keys) + self.bin_state(states)).relu()).float()
        return (self.profile + logits).log_softmax(dim=-1)

    def choose(self, kept: _Kept, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        gaps, at = kept.gaps, torch.arange(len(state), device=state.device)
        fresh = slice(kept.keyed, gaps.used)
        new = gaps.features[:, fresh]
        kept.keys[:, fresh] = self._keys(new, state[:, None].expand(*new.shape[:2], -1))
        kept.keyed = gaps.used
        base = self._base(gaps)
        used = slice(0, gaps.used)
        keys = kept.keys[:, used]
        query = self.query(state) * keys.shape[-1] ** -0.5
        logits = (keys * query[:, None]).sum(dim=-1) + self.bias(keys)[..., 0]
        log_gap = (base[:, used] + logits).log_softmax(dim=-1)
        slot, rest = _pick(log_gap.exp(), u[:, 0])
        log_bin = self._bins(keys[at, slot], state)
        count = log_bin.shape[1]
        bin_, _ = _pick(log_bin.exp(), u[:, 1])
        v = (bin_ + u[:, 2]) / count
        x = gaps.left[at, slot] + v * (gaps.right[at, slot] - gaps.left[at, slot])
        # What is left of the first number is uniform again: it decides whether the point is uniform on [0, 1].
        anywhere = rest < self.floor
        x = torch.where(anywhere, u[:, 2], x).clamp_max(1.0 - 2.0**-53)
        slot = torch.where(anywhere, gaps.containing(x), slot)
        width = (gaps.right[at, slot] - gaps.left[at, slot]).clamp_min(1e-300)
        bin_ = ((x - gaps.left[at, slot]) / width * count).long().clamp(0, count - 1)
        log_bin = torch.where(anywhere[:, None], self._bins(keys[at, slot], state), log_bin)
        scale = math.log(count) - width.log()
        inside = log_gap.gather(1, slot[:, None])[:, 0] + log_bin.gather(1, bin_[:, None])[:, 0]
        density = _floored(inside.double() + scale, self.floor).exp()
        return x[:, None], density, {"slot": slot, "bin": bin_, "scale": scale, "base": base}

    def observe(self, kept: _Kept, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        return kept.gaps.cut(record["slot"], x[:, 0], seen)

    def trace(self, kept: _Kept, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        trace = {name: torch.stack([record[name] for record in records], dim=1) for name in records[0]}
        slots = kept.gaps.start + 2 * (len(records) - 1)
        trace["base"] = trace["base"][..., :slots]
        trace["features"] = kept.gaps.features[:, :slots]
        return trace

    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        slot, features = trace["slot"], trace["features"]
        n = slot.shape[1]
        start = features.shape[1] - 2 * (n - 1)
        opened = torch.arange(1, n, device=slot.device).repeat_interleave(2)
        opened = torch.cat([opened.new_zeros(start), opened])  # the state that saw a slot open
        keys = self._keys(features, states[:, opened])  # (B, S, E)
        product = (self.query(states) * keys.shape[-1] ** -0.5) @ keys.transpose(1, 2)  # (B, N, S)
        logits = product.float() + self.bias(keys).float().transpose(1, 2)
        log_gap = (trace["base"] + logits).log_softmax(dim=-1).gather(2, slot[..., None])[..., 0]
        chosen = keys.gather(1, slot[..., None].expand(-1, -1, keys.shape[-1]))
        log_bin = self._bins(chosen, states).gather(2, trace["bin"][..., None])[..., 0]
        return _floored(log_gap + log_bin + trace["scale"].float(), self.floor)


class SNet(nn.Module):
    """A sampling network.

    Parameters
    ----------
    config : SNetConfig
        Architecture.
    gaps : callable, optional
        (problem, n) to the `Gaps` that the gap head chooses among.

    Raises
    ------
    ValueError
        If the gap head has no `gaps`.
    """

    def __init__(self, config: SNetConfig, gaps: Callable[[Problem, int], Gaps] | None = None) -> None:
        super().__init__()
        self.config = config
        if config.head == "gap" and gaps is None:
            raise ValueError("gaps: the head 'gap' needs them, got None")
        self.head: Head = GridHead(config) if gaps is None else GapHead(config, gaps)
        self.trunk = Trunk(config.tokens.width + self.head.extra + _COUNTS, config)

    def forward(self, rollout: Rollout) -> Tensor:
        """Logarithm of the density of every sample given those before it, (B, N) float32."""
        return self.head.log_density(self.trunk(rollout.tokens), rollout.trace)

    log_prob = forward

    def sample(self, problem: Problem, n: int, stream: Stream, keys: Tensor | None = None) -> Rollout:
        """Place n samples of every integral, one after the other.

        Parameters
        ----------
        problem : Problem
            B integrals.
        n : int
            Samples, >= 1.
        stream : Stream
            Of the random numbers.
        keys : Tensor, (B,), int64, optional
            What keys each row's numbers, `problem.rows` if not given: rows that repeat an integral need their own.
        """
        keys = problem.rows if keys is None else keys
        axis = torch.arange(self.head.numbers, device=keys.device)
        cache, kept = self.trunk.cache(problem.batch, n), self.head.begin(problem, n)
        token = torch.zeros(problem.batch, self.trunk.embed_in.in_features, device=keys.device)
        points, densities, looks, tokens, records = [], [], [], [], []
        for i in range(n):
            token[:, -_COUNTS:] = token.new_tensor([float(i > 0), i / n, math.log(n / 32.0)])
            tokens.append(token)
            state = self.trunk.one(token, cache, i)
            u = stream.uniform(keys[:, None], torch.tensor(i, device=keys.device), axis)
            x, density, record = self.head.choose(kept, state, u)
            look = problem.evaluate(x[:, None])
            points.append(x)
            densities.append(density)
            looks.append(look)
            records.append(record)
            beside = self.head.observe(kept, x, look, record)
            own = tokenize(Samples(x[:, None], look, None, "snet"), self.config.tokens).mean(dim=2)[:, 0]
            token = torch.cat([own, beside, own.new_empty(len(own), _COUNTS)], dim=1)
        pdf = torch.stack(densities, dim=1)[..., None].expand(-1, -1, problem.techniques)
        samples = Samples(torch.stack(points, dim=1), Observation.join(looks), pdf, "snet")
        return Rollout(samples, torch.stack(tokens, dim=1), self.head.trace(kept, records))


@dataclass(frozen=True)
class LearnedSampler(Sampler):
    """A sampling network as a sampler.

    Parameters
    ----------
    net : SNet
        The network.
    problem : str
        Name of the only problem it knows, or "" for any of its dimension.
    most : int
        Samples that it places; those beyond are stratified, so that the cost stays linear in n.
    name : str
        Its own.
    """

    net: SNet
    problem: str = ""
    most: int = 64
    name: str = "snet"

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        dim = self.net.config.tokens.dim
        if problem.dim != dim or self.problem not in ("", problem.name):
            raise ValueError(
                f"sampler: {self.name!r} needs a problem {self.problem or 'of any name'!r} in {dim} dimensions, "
                f"{problem.name!r} has {problem.dim}"
            )
        parts = []
        with torch.inference_mode():
            for start in range(0, problem.batch, TILE_ROWS):
                count = min(TILE_ROWS, problem.batch - start)
                index = torch.arange(start, start + TILE_ROWS, device=problem.rows.device).clamp_max(problem.batch - 1)
                placed = self.net.sample(problem.take(index), min(n, self.most), stream).samples
                parts.append(placed.take(slice(0, count)))
        placed = replace(Samples.stack(parts), design=self.name)
        if n <= self.most:
            return placed
        rest = Stratified().draw(problem, n - self.most, stream.child("rest"))
        pdf = None if placed.pdf is None or rest.pdf is None else torch.cat([placed.pdf, rest.pdf], dim=1)
        x = torch.cat([placed.x, rest.x], dim=1)
        return replace(placed, x=x, seen=Observation.join([placed.seen, rest.seen]), pdf=pdf)
