"""Heads of the sampling network: a state becomes a density with exact probabilities, and a point drawn from it.

Every density has a uniform part, so that no region is left out for ever; untrained heads are their base.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from nqr_geom.integrator.learn.gaps import Gaps
from nqr_geom.integrator.learn.slabs import Slabs
from nqr_geom.integrator.problem import Observation, Problem

__all__ = ["GapHead", "GridHead", "Head", "floored", "pick"]

_CLOSED = -1e9
_BELOW_ONE = 1.0 - 2.0**-53
_KEEN = 4.0  # how much faster than others the few coefficients of what is known of slabs are learned


class Head(nn.Module):
    """Turns a state into a density on the cube, chooses points by it and scores the choice again."""

    numbers: int  # uniform numbers a choice takes
    extra: int  # what `before` and `observe` add to a token

    @abstractmethod
    def begin(self, problem: Problem, n: int) -> Any:
        """What the head keeps while n samples are placed."""

    @abstractmethod
    def choose(self, kept: Any, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """A round of k points (B, k, D), their densities (B, k, groups) and a record of the choice.

        It takes a state (B, E) and numbers u (B, k, numbers) in (0, 1).
        """

    def before(self, kept: Any, state: Tensor) -> Tensor:
        """What the first token holds, (B, extra), on the device of `state`."""
        return state.new_zeros(len(state), self.extra)

    def evaluate(self, kept: Any, problem: Problem, x: Tensor) -> Observation:
        """Observe a round of points."""
        return problem.evaluate(x)

    @abstractmethod
    def observe(self, kept: Any, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        """Take note of what was seen at x (B, k, D); what the tokens of the round hold of it, (B, extra)."""

    @abstractmethod
    def trace(self, kept: Any, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        """All that `log_density` needs."""

    @abstractmethod
    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        """Logarithm of the density of every choice, (B, N, groups), given the states of all rounds (B, rounds, E)."""


def pick(probability: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Index drawn by inversion from probabilities (B, K), and the part of its interval that u (B,) left over."""
    total = probability.double().cumsum(dim=1)
    at = u * total[:, -1]
    index = torch.searchsorted(total, at[:, None], right=True).clamp_max(total.shape[1] - 1)
    below = torch.where(index > 0, total.gather(1, (index - 1).clamp_min(0)), 0.0)
    size = (total.gather(1, index) - below).clamp_min(1e-300)
    return index[:, 0], ((at[:, None] - below) / size).clamp(0.0, _BELOW_ONE)[:, 0]


class GridHead(Head):
    """Piecewise constant densities on grids over groups of axes, independent of each other; uniform at the start.

    Points are drawn by inversion, one axis of a group after the other, so that evenly spread numbers give evenly spread
    points. The logarithm of a density is linear in what is known of its slabs, beside what the state says of each cell.

    Parameters
    ----------
    width : int
        Of the states.
    axes : tuple of tuple of int
        Cells along each axis, a tuple for each group that has a joint density.
    floor : float
        Uniform part of each group's density.
    together : int
        Samples of a round.
    slabs : type of Slabs
        What is known of them.
    """

    def __init__(
        self, width: int, axes: tuple[tuple[int, ...], ...], floor: float, together: int, slabs: type[Slabs]
    ) -> None:
        super().__init__()
        self.axes, self.floor, self.together, self.slabs = axes, floor, together, slabs
        self.cells = [math.prod(group) for group in axes]
        self.counts = tuple(group[0] for group in axes)
        self.logits = nn.Linear(width, sum(self.cells))
        self.query = nn.Linear(width, len(axes) * slabs.size) if slabs.size else None
        for layer in (self.logits, self.query):
            if layer is not None:
                nn.init.zeros_(layer.weight)
                nn.init.zeros_(layer.bias)
        self.numbers = sum(map(len, axes))
        self.extra = slabs.context

    def begin(self, problem: Problem, n: int) -> Slabs:
        return self.slabs(problem, n, self.counts)

    def before(self, kept: Slabs, state: Tensor) -> Tensor:
        return kept.seen()

    def evaluate(self, kept: Slabs, problem: Problem, x: Tensor) -> Observation:
        return kept.evaluate(x)

    def logs(self, states: Tensor, ahead: Tensor) -> list[Tensor]:
        """Logarithm of every group's probabilities without their floor, (B, R, cells), of states (B, R, E)."""
        parts = list(self.logits(states).float().split(self.cells, dim=-1))
        if self.query is not None:
            queries = (_KEEN * self.query(states).float()).unflatten(-1, (len(self.axes), -1)).unbind(dim=2)
            for group, known in enumerate(ahead.split(self.counts, dim=2)):
                worth = (known @ queries[group][..., None])[..., 0]  # (B, R, slabs)
                parts[group] = parts[group] + worth.repeat_interleave(self.cells[group] // self.counts[group], dim=-1)
        return [part.log_softmax(dim=-1) for part in parts]

    def choose(self, kept: Slabs, state: Tensor, u: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        ahead = kept.ahead()
        logs = self.logs(state[:, None], ahead[:, None])
        parts, first = [], 0
        for axes, log in zip(self.axes, logs, strict=True):
            table = (1.0 - self.floor) * log[:, 0].detach().double().exp() + self.floor / log.shape[-1]
            parts.append(_inverted(table, axes, u[..., first : first + len(axes)]))
            first += len(axes)
        x = torch.cat(parts, dim=-1).clamp_max(_BELOW_ONE)
        cells = self._cells_of(x)
        return x, self._densities(logs, cells).double().exp(), {"cell": cells, "ahead": ahead}

    def _cells_of(self, x: Tensor) -> Tensor:
        """Cell of every group that x (B, k, D) lies in, (B, k, groups)."""
        cells, first = [], 0
        for axes in self.axes:
            cell = torch.zeros(x.shape[:2], dtype=torch.int64, device=x.device)
            for size in axes:
                cell = cell * size + (x[..., first] * size).long().clamp_max(size - 1)
                first += 1
            cells.append(cell)
        return torch.stack(cells, dim=-1)

    def _densities(self, logs: list[Tensor], cells: Tensor) -> Tensor:
        """Logarithm of the groups' densities in cells (B, N, groups), whose rounds have the tables (B, R, cells)."""
        rounds = torch.arange(cells.shape[1], device=cells.device) // self.together
        found = [
            log[torch.arange(len(log), device=log.device)[:, None], rounds, cells[..., group]]
            for group, log in enumerate(logs)
        ]
        sizes = torch.tensor(self.cells, device=cells.device).log()
        return floored(torch.stack(found, dim=-1) + sizes, self.floor)

    def observe(self, kept: Slabs, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        kept.note(seen)
        return kept.seen()

    def trace(self, kept: Slabs, records: list[dict[str, Tensor]]) -> dict[str, Tensor]:
        cells = torch.cat([record["cell"] for record in records], dim=1)
        return {"cell": cells, "ahead": torch.stack([record["ahead"] for record in records], dim=1)}

    def log_density(self, states: Tensor, trace: dict[str, Tensor]) -> Tensor:
        return self._densities(self.logs(states, trace["ahead"]), trace["cell"])


def _inverted(table: Tensor, axes: tuple[int, ...], u: Tensor) -> Tensor:
    """Points (B, k, d) of the piecewise constant density with cell probabilities (B, cells), from as many numbers u."""
    left = table[:, None].expand(*u.shape[:2], -1)  # probabilities of what the axes so far have left open
    parts = []
    for axis, size in enumerate(axes):
        left = left.unflatten(-1, (size, -1))
        index, rest = pick(left.sum(dim=-1).flatten(0, 1), u[..., axis].flatten())
        index, rest = index.view(u.shape[:2]), rest.view(u.shape[:2])
        parts.append((index + rest) / size)
        left = left.gather(2, index[..., None, None].expand(-1, -1, 1, left.shape[-1]))[:, :, 0]
    return torch.stack(parts, dim=-1)


def floored(log_density: Tensor, floor: float) -> Tensor:
    """Logarithm of (1 - floor) times a density plus floor."""
    return torch.logaddexp(log_density + math.log1p(-floor), log_density.new_tensor(math.log(floor)))


@dataclass
class _Kept:
    gaps: Gaps
    keys: Tensor
    bias: Tensor
    keyed: int = 0


class GapHead(Head):
    """A gap between earlier samples, then one of equal bins in it.

    A gap's logit is its base's plus the product of a key (the gap's features and the state when it opened) and a
    query (the state now); a bin's logit is the base profile's plus a small network's of both.

    Parameters
    ----------
    width : int
        Of the states.
    gaps : type of Gaps
        What is chosen among, built from a problem and n.
    sharpness : float
        Base: a gap's probability is proportional to its worth to this power; 0 is the uniform density on [0, 1].
    profile : tuple of float
        Base: probabilities of equal bins within a gap.
    floor : float
        Uniform part of the density.
    """

    def __init__(
        self, width: int, gaps: type[Gaps], sharpness: float, profile: tuple[float, ...], floor: float
    ) -> None:
        super().__init__()
        self.gaps, self.floor, self.sharpness = gaps, floor, sharpness
        self.key_in, self.key_out = nn.Linear(gaps.size + width, width), nn.Linear(width, width)
        self.query, self.bias = nn.Linear(width, width), nn.Linear(width, 1)
        self.bin_key, self.bin_state = nn.Linear(width, width), nn.Linear(width, width, bias=False)
        self.bins = nn.Linear(width, len(profile))
        for layer in (self.query, self.bias, self.bins):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        base = torch.tensor(profile)
        self.register_buffer("profile", (base / base.sum()).log(), persistent=False)
        self.numbers = 3
        self.extra = 2 * gaps.size

    def begin(self, problem: Problem, n: int) -> _Kept:
        gaps = self.gaps(problem, n)
        room = gaps.features.new_zeros(*gaps.open.shape, self.query.out_features)
        return _Kept(gaps, room, torch.zeros_like(gaps.features[..., 0]))

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
        gaps, at, u = kept.gaps, torch.arange(len(state), device=state.device), u[:, 0]
        fresh = slice(kept.keyed, gaps.used)
        new = gaps.features[:, fresh]
        made = self._keys(new, state[:, None].expand(*new.shape[:2], -1))
        kept.keys[:, fresh], kept.bias[:, fresh] = made, self.bias(made)[..., 0]
        kept.keyed = gaps.used
        base = self._base(gaps)
        used = slice(0, gaps.used)
        keys = kept.keys[:, used]
        query = self.query(state) * keys.shape[-1] ** -0.5
        logits = (keys * query[:, None]).sum(dim=-1) + kept.bias[:, used]
        log_gap = (base[:, used] + logits).log_softmax(dim=-1)
        slot, rest = pick(log_gap.exp(), u[:, 0])
        # What is left of the first number is uniform again: it decides whether the point is uniform on [0, 1].
        anywhere = rest < self.floor
        if bool(anywhere.any()):
            slot = torch.where(anywhere, gaps.containing(u[:, 2].clamp_max(_BELOW_ONE)), slot)
        log_bin = self._bins(keys[at, slot], state)
        count = log_bin.shape[1]
        bin_, _ = pick(log_bin.exp(), u[:, 1])
        left, right = gaps.left[at, slot], gaps.right[at, slot]
        x = torch.where(anywhere, u[:, 2], left + (bin_ + u[:, 2]) / count * (right - left)).clamp_max(_BELOW_ONE)
        width = (right - left).clamp_min(1e-300)
        bin_ = ((x - left) / width * count).long().clamp(0, count - 1)
        scale = math.log(count) - width.log()
        inside = log_gap.gather(1, slot[:, None])[:, 0] + log_bin.gather(1, bin_[:, None])[:, 0]
        density = floored(inside.double() + scale, self.floor).exp()
        return x[:, None, None], density[:, None, None], {"slot": slot, "bin": bin_, "scale": scale, "base": base}

    def observe(self, kept: _Kept, x: Tensor, seen: Observation, record: dict[str, Tensor]) -> Tensor:
        return kept.gaps.cut(record["slot"], x[:, 0, 0], seen)

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
        return floored(log_gap + log_bin + trace["scale"].float(), self.floor)[..., None]
