"""Light samples where they matter: `LampSpread` shares them out by what each lamp can bring and by what is in doubt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import BELOW_ONE, Pmj, Sampler, scrambled, sobol_reversed
from nqr_geom.render.direct_known import known as known_radiance
from nqr_geom.render.direct_known import spans
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.direct_slabs import lamp_doubt, luminance
from nqr_geom.streams import Stream

__all__ = ["LampSpread"]


@dataclass(frozen=True)
class LampSpread(Sampler):
    """Samples towards lamps by their known unhidden radiance, each lamp's spread evenly over it; later ones by doubt.

    Directions by the material are those of "pmj". The first round of directions towards lamps is shared out among them
    in proportion to what each would send if nothing hid it; in the second those count more whose samples disagree on
    whether they are visible. The density of a round's choice is the share that each lamp really got.

    Parameters
    ----------
    first : float
        Part of the samples in the first round, which does not look at values.
    even : float
        Part of each round that goes to lamps as the scene's own light tree chooses.
    """

    first: float = 0.5
    even: float = 0.1

    name = "lamp-spread"

    def early(self, n: int) -> int:
        """Samples of the first round."""
        return min(n, max(1, round(self.first * n)))

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        if not isinstance(problem, DirectProblem):
            raise ValueError(f"sampler: {self.name!r} needs the problem 'direct', got {problem.name!r}")
        x = Pmj().points(problem.rows, n, problem.dim, stream)
        known = known_radiance(problem, n)
        low, length = spans(problem).unbind(dim=-1)  # (B, L)
        worth = torch.where(length > 0.0, luminance(known), 0.0)
        taken = torch.zeros_like(worth)
        seen: list[Observation] = []
        done = 0
        early = self.early(n)
        for count in (early, n - early):
            if not count:
                continue
            doubt = worth if not seen else worth * lamp_doubt(Observation.join(seen), worth.shape[1])
            total = doubt.sum(dim=1, keepdim=True)
            share = torch.where(total > 0.0, (1.0 - self.even) * doubt / total, 0.0)
            share = share + (1.0 - share.sum(dim=1, keepdim=True)) * length
            part = x[:, done : done + count]
            lamp = _systematic(share, count, stream.child(f"round {done}").uniform(problem.rows))
            picked = torch.nn.functional.one_hot(lamp, worth.shape[1])  # (B, count, L)
            rank = (picked.cumsum(dim=1) - 1 + taken.long()[:, None]).gather(2, lamp[..., None])[..., 0]
            taken = taken + picked.sum(dim=1)
            part[..., 3] = _inside(low.gather(1, lamp), length.gather(1, lamp), part[..., 3])
            part[..., 4:] = _spread(problem.rows, lamp, rank, n, stream)
            x[:, done : done + count] = part
            seen.append(problem.evaluate(part.clamp_max(BELOW_ONE), known))
            done += count
        look = Observation.join(seen)
        # A lamp's density on axis 3, by the share of samples that it got.
        density = torch.where(length > 0.0, taken / (n * length.clamp_min(1e-300)), 0.0)
        light = look.features["light"][..., 0].long()  # (B, N, T)
        its = density.gather(1, light.clamp_min(0).flatten(1)).view_as(light)
        its = torch.where(light >= 0, its, 1.0)
        pdf = torch.stack([torch.ones_like(its[..., 0]), its[..., 1]], dim=-1)
        densities = torch.cat([look.features["bsdf_pdf"], look.features["nee_pdf"] * its[..., None]], dim=-1)
        look = replace(look, technique_pdf=densities)
        return Samples(x.clamp_max(BELOW_ONE), look, torch.where(pdf > 0.0, pdf, 1.0), self.name)


def _systematic(share: Tensor, count: int, u: Tensor) -> Tensor:
    """Index for each of `count` samples so that each gets its share (B, L) of them, rounded at random, (B, count)."""
    total = share.cumsum(dim=1)
    at = (torch.arange(count, device=share.device) + u[:, None]) / count * total[:, -1:]
    return torch.searchsorted(total, at, right=True).clamp_max(share.shape[1] - 1)


def _inside(low: Tensor, length: Tensor, u: Tensor) -> Tensor:
    return low + length * u


def _spread(rows: Tensor, lamp: Tensor, rank: Tensor, n: int, stream: Stream) -> Tensor:
    """Point `rank` of a scrambled (0,2)-sequence of each lamp's own, (B, count, 2)."""
    base = torch.as_tensor(sobol_reversed(n, 2), device=rows.device)[rank]
    axes = torch.arange(2, device=rows.device)
    keys = (rows[:, None, None] * 4096 + lamp[..., None], rank[..., None], axes)
    return scrambled(base, keys, stream.child("lamps"))
