"""The sampling network: a causal transformer that says where to look next (Section 5, Fig. 13).

Each sample becomes a token when it is seen and attends to all earlier ones, whose keys and values are kept. A head
turns the newest state into a density with exact probabilities: "gap" (one dimension) chooses a gap between earlier
samples and a place in it, relative to a base sampler; "grid" (the paper's) is piecewise constant on the cube; "step"
chooses a walk step by step. All start as their base: an untrained network is its base sampler.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from nqr_geom import check
from nqr_geom.integrator.learn.gaps import Gaps
from nqr_geom.integrator.learn.heads import GapHead, GridHead, Head
from nqr_geom.integrator.learn.inet import Block
from nqr_geom.integrator.learn.slabs import Slabs
from nqr_geom.integrator.learn.steps import StepHead, Walks
from nqr_geom.integrator.learn.tokens import Extra, TokenConfig, tokenize
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import BELOW_ONE, Pmj, Sampler, Stratified
from nqr_geom.streams import Stream

__all__ = ["COUNTS", "LearnedSampler", "Rollout", "SNet", "SNetConfig", "View"]

View = type[Gaps] | type[Walks] | type[Slabs]

TILE_ROWS = 256  # float32 products change with the batch size, so the network always sees this many rows
COUNTS = 3  # is there a sample yet, i / n, log n


@dataclass(frozen=True)
class SNetConfig:
    """Architecture of a sampling network.

    Parameters
    ----------
    tokens : TokenConfig
        What is read of a sample by itself.
    layers, width, heads, expansion : int
        As for `INetConfig`.
    head : {"gap", "grid", "step"}
        See the module.
    sharpness : float
        Base of the gap head: a gap is chosen with probability proportional to its worth to this power; 0 is the
        uniform density.
    profile : tuple of float
        Base of the gap head: probabilities of equal bins within a gap.
    grid : tuple of tuple of int
        Cells of the grid head: one tuple for each group of axes that has a joint density; groups are independent.
    techniques : int
        Techniques of the problem. Of several, each depends on the axes of one group alone (they are in the same order),
        and its samples have that group's density.
    together : int
        Samples that the grid head places in one round, by one density: their numbers are spread evenly.
    bins : int
        Bins of a direction's density for the step head.
    floor : float
        Part of the density that is uniform, in (0, 1).
    """

    tokens: TokenConfig = field(default_factory=TokenConfig)
    layers: int = 2
    width: int = 48
    heads: int = 2
    expansion: int = 3
    head: Literal["gap", "grid", "step"] = "gap"
    sharpness: float = 0.0
    profile: tuple[float, ...] = (0.1,) * 10
    grid: tuple[tuple[int, ...], ...] = ()
    techniques: int = 1
    together: int = 1
    bins: int = 32
    floor: float = 0.02

    def __post_init__(self) -> None:
        check.number("floor", self.floor, low=0.0, high=1.0, open_low=True)
        if self.head == "gap" and self.tokens.dim != 1:
            raise ValueError(f"head: 'gap' needs one dimension, got {self.tokens.dim}")
        if self.head == "grid" and sum(map(len, self.grid)) != self.tokens.dim:
            raise ValueError(f"grid: expected {self.tokens.dim} axes in all, got {self.grid}")
        if self.techniques > 1 and self.techniques != len(self.grid):
            raise ValueError(f"grid: expected a group for each of {self.techniques} techniques, got {len(self.grid)}")
        check.integer("together", self.together, low=1)
        if self.together > 1 and self.head != "grid":
            raise ValueError(f"together: expected 1 of the head {self.head!r}, got {self.together}")

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
        return self._attended(x, q, keys, values)

    def last(self, x: Tensor) -> Tensor:
        """The newest (B, E) of tokens (B, N, E)."""
        b, n, e = x.shape
        normed = self.norm1(x)
        q = nn.functional.linear(normed[:, -1], self.qkv.weight[:e], self.qkv.bias[:e])
        others = nn.functional.linear(normed, self.qkv.weight[e:], self.qkv.bias[e:])
        keys, values = others.view(b, n, 2, self.heads, e // self.heads).permute(2, 0, 3, 1, 4)  # (B, H, N, E/H)
        return self._attended(x[:, -1], q.view(b, self.heads, -1), keys, values)

    def _attended(self, x: Tensor, q: Tensor, keys: Tensor, values: Tensor) -> Tensor:
        """A token x (B, E) whose queries (B, H, E/H) have seen keys and values (B, H, N, E/H)."""
        b, e = x.shape
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

    def last(self, tokens: Tensor) -> Tensor:
        """The last state (B, E) of tokens (B, N, size) at once; of the last block only what that takes."""
        n = tokens.shape[1]
        x = self.embed_out(self.embed_in(tokens).relu())
        if len(self.blocks) > 1:
            later = torch.full((n, n), -torch.inf, device=tokens.device).triu(1)[None, None]
            for block in self.blocks[:-1]:
                x = block(x, later)
        state: Tensor = self.norm(cast(CausalBlock, self.blocks[-1]).last(x))
        return state

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


def _head(config: SNetConfig, view: View | None) -> Head:
    if config.head == "grid":
        view = Slabs if view is None else view
        if not issubclass(view, Slabs):
            raise ValueError(f"view: the head 'grid' needs a type of Slabs, got {view}")
        return GridHead(config.width, config.grid, config.floor, config.together, view)
    wanted = Gaps if config.head == "gap" else Walks
    if view is None or not issubclass(view, wanted):
        raise ValueError(f"view: the head {config.head!r} needs a type of {wanted.__name__}, got {view}")
    if issubclass(view, Gaps):
        return GapHead(config.width, view, config.sharpness, config.profile, config.floor)
    return StepHead(config.width, config.tokens.dim, config.bins, config.floor, view)


class SNet(nn.Module):
    """A sampling network.

    Parameters
    ----------
    config : SNetConfig
        Architecture.
    view : type of Gaps, of Walks or of Slabs, optional
        What the gap head chooses among, what the step head sees, or what is known of a grid's slabs.
    extra : Extra, optional
        The application's own quantities, if `config.tokens` counts some.

    Raises
    ------
    ValueError
        If the head has no view.
    """

    def __init__(self, config: SNetConfig, view: View | None = None, extra: Extra | None = None) -> None:
        super().__init__()
        self.config, self.extra = config, extra
        self.head = _head(config, view)
        self.trunk = Trunk(config.techniques * config.tokens.width + self.head.extra + COUNTS, config)

    def forward(self, rollout: Rollout) -> Tensor:
        """Logarithm of the density of every sample given the rounds before it, (B, N, groups) float32."""
        return self.head.log_density(self.trunk(rollout.tokens)[:, :: self.config.together], rollout.trace)

    def log_prob(self, rollout: Rollout) -> Tensor:
        """`forward` of all groups together, (B, N)."""
        return self(rollout).sum(dim=-1)

    def sample(
        self, problem: Problem, n: int, stream: Stream, keys: Tensor | None = None, *, even: bool = True
    ) -> Rollout:
        """Place n samples of every integral, round after round.

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
        even : bool
            Spread the numbers of a round evenly. Only without that does `forward` give the likelihood of all of them
            together; the density of each is right either way.
        """
        keys = problem.rows if keys is None else keys
        axis = torch.arange(self.head.numbers, device=keys.device)
        cache, kept = self.trunk.cache(problem.batch, n), self.head.begin(problem, n)
        token = torch.zeros(problem.batch, self.trunk.embed_in.in_features, device=keys.device)
        token[:, -COUNTS - self.head.extra : -COUNTS] = self.head.before(kept, token)
        points, densities, looks, records = [], [], [], []
        tokens: list[Tensor] = []
        for first in range(0, n, self.config.together):
            count = min(self.config.together, n - first)
            state = self._read(token, cache, tokens, n)
            if even and count > 1:
                u = Pmj().points(keys, count, len(axis), stream.child(f"round {first}")).clamp_max(BELOW_ONE)
            else:
                index = torch.arange(first, first + count, device=keys.device)[:, None]
                u = stream.uniform(keys[:, None, None], index, axis)
            x, density, record = self.head.choose(kept, state, u)
            density = density if self.config.techniques > 1 else density.prod(dim=-1, keepdim=True)
            density = density.expand(-1, -1, problem.techniques)
            look = self.head.evaluate(kept, problem, x)
            points.append(x)
            densities.append(density)
            looks.append(look)
            records.append(record)
            beside = self.head.observe(kept, x, look, record)
            own = tokenize(Samples(x, look, density, "snet"), self.config.tokens, self.extra)  # (B, k, T, width)
            own = own.flatten(2) if self.config.techniques > 1 else own.mean(dim=2)
            for i in range(count):
                token = torch.cat([own[:, i], beside, own.new_empty(len(own), COUNTS)], dim=1)
                if i < count - 1:
                    self._read(token, cache, tokens, n)
        samples = Samples(torch.cat(points, dim=1), Observation.join(looks), torch.cat(densities, dim=1), "snet")
        return Rollout(samples, torch.stack(tokens, dim=1), self.head.trace(kept, records))

    def _read(self, token: Tensor, cache: list[Tensor], tokens: list[Tensor], n: int) -> Tensor:
        """The state after one more token, which is told its place and kept."""
        at = len(tokens)
        token[:, -COUNTS:] = token.new_tensor([float(at > 0), at / n, math.log(n / 32.0)])
        tokens.append(token)
        return self.trunk.one(token, cache, at)


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

        place = problem.placing(self.net, min(n, self.most))

        def tile(start: int) -> Samples:
            count = min(TILE_ROWS, problem.batch - start)
            index = torch.arange(start, start + TILE_ROWS, device=problem.rows.device).clamp_max(problem.batch - 1)
            with torch.inference_mode():
                placed = self.net.sample(problem.take(index), min(n, self.most), stream).samples
            return placed.take(slice(0, count))

        if place is not None:
            x, density = place(stream)
            placed = Samples(x, problem.evaluate(x), density[..., None].expand(-1, -1, problem.techniques), self.name)
        else:
            # The operations are too small to be shared out themselves.
            with ThreadPoolExecutor(torch.get_num_threads()) as pool:
                parts = list(pool.map(tile, range(0, problem.batch, TILE_ROWS)))
            placed = replace(Samples.stack(parts), design=self.name)
        if n <= self.most:
            return placed
        rest = Stratified().draw(problem, n - self.most, stream.child("rest"))
        pdf = None if placed.pdf is None or rest.pdf is None else torch.cat([placed.pdf, rest.pdf], dim=1)
        x = torch.cat([placed.x, rest.x], dim=1)
        return replace(placed, x=x, seen=Observation.join([placed.seen, rest.seen]), pdf=pdf)
