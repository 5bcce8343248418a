"""Structure-aware rules and sampler for curves: look where the rebuilt curve is uncertain, then integrate it exactly.

They see a curve only through point queries (position, tangent, piece), as the networks do, and need no network.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.curves import hermite
from nqr_geom.curves.shapes import Told
from nqr_geom.integrator.problem import LogLink, Observation, Problem, Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.integrator.samplers import Sampler, Stratified
from nqr_geom.streams import Stream

__all__ = ["CurveRefine", "GwnHermite", "SdHermite", "scaled"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LARGEST_EXPONENT = 600.0
_END = 1e-10  # how far inside its piece an end is asked, as a part of the piece


class GwnHermite(Rule):
    """The exact winding number of the curve rebuilt from its samples.

    All of it is the additive term `a`: the values themselves are not used. Exact for pieces that are quadratics (from
    two samples a piece) or cubics (two samples and both ends); integrals in doubt are flagged: a piece unseen, or a
    query closer to the rebuilt curve than that may be off.
    """

    name = "gwn-hermite"

    def combine(self, samples: Samples) -> Combination:
        if "alpha" in samples.seen.features:
            raise ValueError(f"rule: {self.name!r} gives winding numbers, these are samples of a smoothed distance")
        answer = self.by_kernel if samples.x.device.type == "cpu" else self.by_tensors
        value, doubtful = answer(samples)
        return Combination(samples.x.new_zeros(1, 1, 1, 1), value[:, None], doubtful)

    def by_tensors(self, samples: Samples) -> tuple[Tensor, Tensor]:
        """Winding numbers (B,) and which are in doubt (B,), on any device: the reference."""
        segments = hermite.reconstruct(samples, self.name)
        value, doubtful = hermite.winding(segments)
        return value, doubtful | segments.missing

    def by_kernel(self, samples: Samples) -> tuple[Tensor, Tensor]:
        """The same, compiled."""
        from nqr_geom.curves import compiled

        value, doubtful = compiled.winding(*seen_rows(samples, self.name))
        return torch.from_numpy(value), torch.from_numpy(doubtful)


class SdHermite(Rule):
    """The smoothed distance's integral over the curve rebuilt from its samples; all of it is the additive term."""

    name = "sd-hermite"

    def combine(self, samples: Samples) -> Combination:
        alpha = samples.feature("alpha", self.name)[:, 0, 0, 0]
        answer = self.by_kernel if samples.x.device.type == "cpu" else self.by_tensors
        exponent, total, shift, missing = answer(samples, alpha)
        value, link, lost = scaled(exponent, total, alpha, shift)
        return Combination(samples.x.new_zeros(1, 1, 1, 1), value, missing | lost, link)

    def by_tensors(self, samples: Samples, alpha: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Exponent, sum, distance of the nearest sample, and where a piece is unseen, (B,) each: the reference."""
        segments = hermite.reconstruct(samples, self.name)
        shift = samples.feature("distance2", self.name)[..., 0, 0].sqrt().amin(dim=1)
        return *hermite.log_integral(segments, alpha, shift), shift, segments.missing

    def by_kernel(self, samples: Samples, alpha: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The same, compiled."""
        from nqr_geom.curves import compiled_smooth

        found = compiled_smooth.integral(*seen_rows(samples, self.name), alpha.contiguous().numpy())
        exponent, total, shift, missing = map(torch.from_numpy, found)
        return exponent, total, shift, missing


def seen_rows(samples: Samples, rule: str) -> tuple[Floats, Floats, Floats, Ints, Ints]:
    """Samples for kernels: s (B, N), position from the query and dx/ds (B, N, 2), piece (B, N), pieces (B,)."""
    relative, piece, pieces = (samples.feature(name, rule)[:, :, 0] for name in ("relative", "piece", "pieces"))
    parts = samples.x[..., 0], relative, hermite.tangents(samples, rule), piece[..., 0].long(), pieces[:, 0, 0].long()
    s, r, t, on, of = (part.contiguous().numpy() for part in parts)
    return s, r, t, on, of


def scaled(exponent: Tensor, total: Tensor, alpha: Tensor, shift: Tensor) -> tuple[Tensor, LogLink, Tensor]:
    """The integral (B, 1) exp(exponent) times total, its link, and where it has no length, (B,) bool.

    Usually the scale is that of the values. Where the curve comes so much closer than every sample that the integral
    would overflow, or has no length, the answer brings a scale of its own.
    """
    lost = total <= 0.0
    extreme = (exponent > _LARGEST_EXPONENT) | lost
    own = torch.where(extreme & ~lost, exponent, 0.0)
    value = torch.where(lost, 1.0, total * torch.exp(torch.where(extreme, 0.0, exponent)))
    return value[:, None], LogLink(alpha=alpha[:, None], shift=(shift - own / alpha)[:, None]), lost


@dataclass(frozen=True)
class CurveRefine(Sampler):
    """Both ends of every piece, one point in its middle, then the gap that matters most to the query.

    What matters is how far the rebuilt curve may be off in a gap against the gap's distance from the query. With
    fewer than two samples a piece, jittered points are drawn instead.

    Parameters
    ----------
    spread : float
        A gap is cut at 1/2 +- spread/2 of its length, at random, so that repetitions differ.
    """

    spread: float = 0.2

    name = "curve-refine"
    end = _END

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        pieces = getattr(getattr(problem, "shapes", None), "pieces", None)
        if pieces is None:
            raise ValueError(f"sampler: {self.name!r} needs a problem on curves, got {problem.name!r}")
        count = pieces[problem.shape]  # type: ignore[attr-defined]
        result: list[tuple[Tensor, Samples]] = []
        for k in count.unique().tolist():
            index = (count == k).nonzero()[:, 0]
            part = problem.take(index)
            refine = self.by_kernel if part.rows.device.type == "cpu" else self.by_tensors
            result.append((index, (refine if n >= 2 * k else self._spread)(part, k, n, stream)))
        if len(result) == 1:
            return result[0][1]
        order = torch.cat([index for index, _ in result]).argsort()
        return Samples.stack([samples for _, samples in result]).take(order)

    def _spread(self, problem: Problem, k: int, n: int, stream: Stream) -> Samples:
        samples = Stratified().draw(problem, n, stream)
        return replace(samples, pdf=None, design=self.name, stratum=None, volume=None)

    def by_kernel(self, problem: Any, k: int, n: int, stream: Stream) -> Samples:
        """n samples for integrals over curves of k pieces: gaps are chosen in a compiled pass."""
        from nqr_geom.curves import compiled

        def look(s: Floats) -> tuple[Floats, Floats, Ints]:
            position, tangent, piece = problem.shapes.at(problem.shape, torch.from_numpy(s))
            return position.numpy(), tangent.numpy(), piece.numpy()

        points, rows = problem.points.numpy(), problem.rows.numpy()
        found = compiled.placed(look, points, rows, stream.key, k, n, self.spread, self.end)
        s, *told = map(torch.from_numpy, found)
        x = s[..., None]
        seen = replace(problem, shapes=Told(problem.shapes, *told)).evaluate(x)
        return Samples(x, seen, None, self.name)

    def by_tensors(self, problem: Problem, k: int, n: int, stream: Stream) -> Samples:
        """The same on any device: the reference."""
        device = problem.rows.device
        start = torch.arange(k, device=device).double()
        ends = torch.stack([start, start + 1.0 - _END], dim=1).reshape(1, 2 * k, 1) / k
        x = [ends.expand(problem.batch, 2 * k, 1)]
        seen = [problem.evaluate(x[0])]
        gaps = _Gaps.between_ends(x[0], seen[0], n)
        at = torch.arange(problem.batch, device=device)
        for i in range(2 * k, n):
            chosen = gaps.priority().argmax(dim=1)
            jitter = stream.uniform(problem.rows, torch.tensor(i, device=device)) - 0.5
            cut = 0.5 + self.spread * jitter
            s = gaps.s[at, chosen, 0] * (1.0 - cut) + gaps.s[at, chosen, 1] * cut
            x.append(s[:, None, None])
            seen.append(problem.evaluate(x[-1]))
            gaps.split(chosen, s, seen[-1])
        return Samples(torch.cat(x, dim=1), Observation.join(seen), None, self.name)


def _ends_of(seen: Observation) -> tuple[Tensor, Tensor]:
    """Relative positions and tangents (B, N, 2) of an observation."""
    probe = Samples(seen.value[..., 0], seen, None, "probe")
    return seen.features["relative"][:, :, 0], hermite.tangents(probe, "curve-refine")


class _Gaps:
    """The gaps of B integrals while they are refined: ends, tangents and estimated error, (B, G, ...)."""

    def __init__(self, s: Tensor, r: Tensor, t: Tensor, error: Tensor, capacity: int) -> None:
        batch, self.used = error.shape
        self.s, self.r = s.new_zeros(batch, capacity, 2), s.new_zeros(batch, capacity, 2, 2)
        self.t, self.error = s.new_zeros(batch, capacity, 2, 2), s.new_zeros(batch, capacity)
        self.nearest = s.new_ones(batch, capacity)
        self._store(slice(0, self.used), s, r, t, error)

    @classmethod
    def between_ends(cls, x: Tensor, seen: Observation, n: int) -> _Gaps:
        """One gap a piece; nothing is known of it, so its error is its whole size."""
        r, t = _ends_of(seen)
        batch, ends = r.shape[:2]
        s = x[..., 0].reshape(batch, ends // 2, 2)
        r, t = r.reshape(batch, -1, 2, 2), t.reshape(batch, -1, 2, 2)
        length = (s[..., 1] - s[..., 0]) * torch.linalg.vector_norm(t, dim=-1).mean(dim=-1)
        return cls(s, r, t, length, ends // 2 + n - ends)

    def _store(self, where: slice | tuple[Tensor, Tensor], s: Tensor, r: Tensor, t: Tensor, error: Tensor) -> None:
        key = (slice(None), where) if isinstance(where, slice) else where
        self.s[key], self.r[key], self.t[key], self.error[key] = s, r, t, error
        h = (s[..., 1] - s[..., 0])[..., None]
        middle = r.mean(dim=-2) + h * (t[..., 0, :] - t[..., 1, :]) / 8.0
        points = torch.cat([r, middle[..., None, :]], dim=-2)
        self.nearest[key] = torch.linalg.vector_norm(points, dim=-1).amin(dim=-1)

    def priority(self) -> Tensor:
        """What a cut may gain, (B, used): the chance to be on the wrong side, then sheer closeness."""
        error, distance = self.error[:, : self.used], self.nearest[:, : self.used]
        size = torch.linalg.vector_norm(self.r[:, : self.used, 1] - self.r[:, : self.used, 0], dim=-1)
        slack = error + 1e-9 * size
        return slack / (distance + slack).clamp_min(1e-300)

    def split(self, chosen: Tensor, s: Tensor, seen: Observation) -> None:
        """Cut the chosen gap of every integral at s (B,), where `seen` was observed."""
        r, t = _ends_of(seen)
        at = torch.arange(len(s), device=s.device)
        ends, rr, tt = self.s[at, chosen], self.r[at, chosen], self.t[at, chosen]
        left, right = hermite.child_errors(ends, rr, tt, s, r[:, 0])
        middle = torch.stack([ends[:, 0], s, ends[:, 1]], dim=1)
        points, slopes = torch.stack([rr[:, 0], r[:, 0], rr[:, 1]], 1), torch.stack([tt[:, 0], t[:, 0], tt[:, 1]], 1)
        new = torch.full_like(chosen, self.used)
        self._store((at, chosen), middle[:, :2], points[:, :2], slopes[:, :2], left)
        self._store((at, new), middle[:, 1:], points[:, 1:], slopes[:, 1:], right)
        self.used += 1
