"""A rule for pieces with hidden breaks: what the samples determine is exact, the rest is a posterior mean.

Inside a piece the law of `law.py` gives the integral between two samples (for parabolas it is the Hermite-corrected
trapezoid). Between samples of different pieces a break hides: both sides are continued into the gap, and the break is
integrated out, likelier where the continuations meet.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Combination, Rule, interval_weights
from nqr_geom.integrator.sums import row_mean, row_sum
from nqr_geom.toy.family import PIECES, Shape
from nqr_geom.toy.law import Law, fit, fit_pairs, propagate, stumpff

__all__ = ["GapIntegrals", "ToyHermite"]

_NODES = 8  # positions of a break that are weighed against each other


@dataclass(frozen=True)
class _Points:
    """Samples in rising order, with both ends of [0, 1] added: all (B, N + 2)."""

    x: Tensor
    value: Tensor
    slope: Tensor
    piece: Tensor
    law: Law


@dataclass(frozen=True)
class GapIntegrals:
    """Integrals over the gaps of B rows.

    Parameters
    ----------
    edges : Tensor, (B, N + 2), float64
        0, the samples in rising order, 1.
    integral : Tensor, (B, N + 1)
        Over each gap.
    law : Law
        Of the piece that each of the N samples lies in.
    """

    edges: Tensor
    integral: Tensor
    law: Law


@dataclass(frozen=True)
class ToyHermite(Rule):
    """Exact inside pieces whose law the samples determine, posterior mean over the hidden breaks elsewhere.

    The weights are those of the trapezoidal rule; the additive term holds everything else that values, derivatives
    and piece indices tell. It is exact for any pieces of the family with at least three samples each (two for a
    parabola) and no room between the last sample of one piece and the first of the next.

    Parameters
    ----------
    shape : Shape
        What is known of the family: size of jumps, shortest piece, highest frequency.
    reach : float
        Distance over which a sample is believed whose piece's law is not determined.

    References
    ----------
    The task of Sections 4 and 5 and Fig. 37 of the paper; its networks learn this behaviour.

    Examples
    --------
    >>> from nqr_geom.integrator.samplers import Stratified
    >>> from nqr_geom.streams import Stream
    >>> from nqr_geom.toy.problem import ToyProblem
    >>> problem = ToyProblem(100)
    >>> samples = Stratified().draw(problem, 32, Stream(0))
    >>> error = ToyHermite().combine(samples).estimate(samples).numpy() - problem.reference()
    >>> bool((error**2).mean() < 2e-4)
    True
    """

    shape: Shape = field(default_factory=Shape)
    reach: float = 0.04

    name = "toy-hermite"

    def combine(self, samples: Samples) -> Combination:
        weights = interval_weights(samples.x[..., 0])
        trapezoid = row_mean(weights * samples.value[..., 0, 0])[:, None]
        total = row_sum(self.gaps(samples).integral)[:, None]
        return Combination(weights[..., None, None], total - trapezoid)

    def gaps(self, samples: Samples) -> GapIntegrals:
        """What the rule says of every gap between neighbouring samples, and of those to both ends of [0, 1].

        Parameters
        ----------
        samples : Samples
            B rows of N samples with derivative and piece index, in any order.

        Returns
        -------
        GapIntegrals
        """
        self._need_1d(samples)
        self._need_one_technique(samples)
        x, order = samples.x[..., 0].sort(dim=1)
        value = samples.value[..., 0, 0].gather(1, order)
        slope = samples.feature("derivative", self.name)[..., 0, 0].gather(1, order)
        piece = samples.feature("piece", self.name)[..., 0, 0].gather(1, order)
        if int(piece.min()) < 0 or int(piece.max()) >= PIECES:
            raise ValueError(f"piece: expected indices 0 .. {PIECES - 1}, got {int(piece.min())} .. {int(piece.max())}")
        level = row_mean(interval_weights(x) * value)[:, None]
        law = fit(x, value, slope, piece, PIECES)
        law = fit_pairs(law, x, value, slope, piece, self.shape.frequency[1])
        points = self._with_ends(_Points(x, value, slope, piece, law), level)
        return GapIntegrals(points.x, self._gaps(points, level), law)

    def _faded(self, level: Tensor, t: Tensor, value: Tensor, slope: Tensor) -> Tensor:
        """Continuation of a sample of unknown law by t: its tangent near it, the level farther away."""
        return level + (value - level + slope * t) * torch.exp(-0.5 * (t / self.reach) ** 2)

    def _with_ends(self, p: _Points, level: Tensor) -> _Points:
        """Continue the first and the last sample to 0 and 1; where other pieces lie between, put the level there."""
        ends = []
        for column, at, last in ((slice(0, 1), 0.0, 0), (slice(-1, None), 1.0, PIECES - 1)):
            t = at - p.x[:, column]
            value, slope = p.value[:, column], p.slope[:, column]
            alpha, curvature, known = p.law.alpha[:, column], p.law.curvature[:, column], p.law.known[:, column]
            same = p.piece[:, column] == last
            sure = same & known
            there, slope_there = propagate(alpha, t, value, slope, curvature)
            there = torch.where(sure, there, torch.where(same, self._faded(level, t, value, slope), level))
            bend = torch.where(sure, curvature - alpha * (there - value), 0.0)
            law = Law(torch.where(sure, alpha, 0.0), bend, sure, torch.zeros_like(sure))
            slope_there = torch.where(sure, slope_there, 0.0)
            ends.append(
                _Points(torch.full_like(t, at), there, slope_there, torch.full_like(same, last, dtype=torch.int64), law)
            )

        def join(*columns: Tensor) -> Tensor:
            return torch.cat(columns, dim=1)

        a, z = ends
        law = Law(
            join(a.law.alpha, p.law.alpha, z.law.alpha),
            join(a.law.curvature, p.law.curvature, z.law.curvature),
            join(a.law.known, p.law.known, z.law.known),
            join(a.law.foreign, p.law.foreign, z.law.foreign),
        )
        return _Points(
            join(a.x, p.x, z.x),
            join(a.value, p.value, z.value),
            join(a.slope, p.slope, z.slope),
            join(a.piece, p.piece, z.piece),
            law,
        )

    def _gaps(self, p: _Points, level: Tensor) -> Tensor:
        """Integral over each gap between neighbouring points, (B, N + 1)."""
        h = p.x.diff(dim=1)
        breaks = p.piece.diff(dim=1)
        smooth = (breaks == 0) & p.law.known[:, 1:] & p.law.known[:, :-1]
        # The mean of what follows from the left and from the right point.
        _, _, c2, c3, _ = stumpff(torch.where(smooth, p.law.alpha[:, :-1], 0.0) * h * h)
        trapezoid = 0.5 * h * (p.value[:, 1:] + p.value[:, :-1])
        bend = c2 * -p.slope.diff(dim=1) + h * c3 * (p.law.curvature[:, 1:] + p.law.curvature[:, :-1])
        # Where no law holds: the Hermite-corrected trapezoid, exact for cubics.
        foreign = (breaks == 0) & p.law.foreign[:, 1:] & p.law.foreign[:, :-1]
        bend = torch.where(foreign, -p.slope.diff(dim=1) / 6.0, bend)
        result = trapezoid + 0.5 * h * h * bend
        row, gap = torch.nonzero(~(smooth | foreign), as_tuple=True)
        result[row, gap] = self._broken(p, level[row], row, gap, h[row, gap, None], breaks[row, gap, None])
        return result

    def _broken(self, p: _Points, level: Tensor, row: Tensor, gap: Tensor, h: Tensor, breaks: Tensor) -> Tensor:
        """Posterior mean of the integral over gaps with hidden breaks, or without any but of unknown law, (G,)."""
        u = (torch.arange(_NODES, device=h.device) + 0.5) / _NODES
        # A steep parabola is not believed beyond what values the integrand takes, and once more their range.
        low, high = (bound[row, None] for bound in p.value.aminmax(dim=1))
        low, high = 2.0 * low - high, 2.0 * high - low

        def side(index: Tensor, t: Tensor) -> Tensor:
            value, slope, alpha, curvature, known = (
                tensor[row, index, None] for tensor in (p.value, p.slope, p.law.alpha, p.law.curvature, p.law.known)
            )
            sure, _ = propagate(alpha, t, value, slope, curvature)
            return torch.where(known, sure.clamp(low, high), self._faded(level, t, value, slope))

        left, right = side(gap, u * h), side(gap + 1, (u - 1.0) * h)
        # One break: uniform in the gap, times how likely its jump is. `stays` is the chance to be still left of it.
        jump = ((right - left) / self.shape.jump).clamp(-1e100, 1e100)
        chance = torch.softmax(-0.5 * jump * jump, dim=1)
        one = 1.0 - (chance.cumsum(dim=1) - 0.5 * chance)
        # Several: order statistics of uniform breaks that leave room for the pieces between them.
        room = 1.0 - self.shape.shortest * ((breaks - 1) / h.clamp_min(1e-300))  # integers times a float are float32
        stretch = 1.0 / room.clamp(0.05, 1.0)
        first = (1.0 - stretch * u).clamp_min(0.0) ** breaks
        last = (1.0 - stretch * (1.0 - u)).clamp_min(0.0) ** breaks
        # No break, unknown law: fade from one side to the other.
        several = breaks > 1
        stays = torch.where(several, first, torch.where(breaks == 1, one, 1.0 - u))
        came = torch.where(several, last, 1.0 - stays)
        return h[:, 0] * row_mean(stays * left + came * right + (1.0 - stays - came) * level)
