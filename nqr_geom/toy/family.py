"""Integrands of five smooth pieces, each linear, quadratic or trigonometric, joined at random breaks (Fig. 37).

The paper leaves the constants open. These make its baseline rows come out (Tables 1, 2 and 6, at 32 samples):
`benchmarks/toy_calibration.py` prints both side by side.

All three kinds of piece solve f'' + alpha f = const, with alpha = omega^2 for A sin(omega x + phi) + c and alpha = 0
for a polynomial. So a piece is its value, slope and second derivative at its start together with alpha, and value,
derivative and integral are one formula in Stumpff functions for all kinds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from nqr_geom.integrator.sums import row_sum
from nqr_geom.streams import Stream
from nqr_geom.toy.law import propagate, stumpff

__all__ = ["PIECES", "Pieces", "Shape", "draw"]

PIECES = 5


@dataclass(frozen=True)
class Shape:
    """The open constants of the family.

    Parameters
    ----------
    shortest : float
        Least length of a piece; otherwise the breaks are uniform.
    linear, quadratic : float
        Probability that a piece is linear or quadratic; the rest are trigonometric.
    level, level_spread : float
        Each integrand has a level, uniform in level +- level_spread.
    band : float
        A polynomial piece ends at the level plus a uniform number in +- band.
    jump : float
        Root mean square of the (uniform) jump at a break.
    bulge : float
        A quadratic piece leaves its chord by a uniform number in +- bulge.
    frequency, amplitude : pair of float
        Ranges of omega and A of a trigonometric piece, both uniform.
    """

    shortest: float = 0.1
    linear: float = 0.25
    quadratic: float = 0.4
    level: float = 1.9
    level_spread: float = 0.3
    band: float = 0.5
    jump: float = 0.5
    bulge: float = 2.25
    frequency: tuple[float, float] = (5.0, 110.0)
    amplitude: tuple[float, float] = (0.5, 1.0)


@dataclass(frozen=True)
class Pieces:
    """B integrands in pieces.

    Parameters
    ----------
    edges : Tensor, (B, 6), float64
        Ends of the pieces, rising from 0 to 1.
    value, slope, curvature : Tensor, (B, 5)
        f, f' and f'' at the left end of each piece.
    alpha : Tensor, (B, 5)
        omega^2 of a trigonometric piece, 0 of a polynomial one.
    """

    edges: Tensor
    value: Tensor
    slope: Tensor
    curvature: Tensor
    alpha: Tensor

    def evaluate(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """f, f' and the piece index (int64) at x (B, N); a break belongs to the piece on its right."""
        piece = self._piece(x)
        t = x - self.edges.gather(1, piece)
        value, slope, curvature, alpha = (
            tensor.gather(1, piece) for tensor in (self.value, self.slope, self.curvature, self.alpha)
        )
        return *propagate(alpha, t, value, slope, curvature), piece

    def _piece(self, x: Tensor) -> Tensor:
        """Piece of each x (B, N); a break belongs to the one on its right."""
        return torch.searchsorted(self.edges[:, 1:-1].contiguous(), x.contiguous(), right=True)

    def integral(self) -> Tensor:
        """Exact integral over [0, 1], (B,)."""
        return row_sum(_from_start(self.edges.diff(dim=1), self.alpha, self.value, self.slope, self.curvature))

    def antiderivative(self, x: Tensor) -> Tensor:
        """Integral of f from 0 to x (B, N)."""
        laws = self.alpha, self.value, self.slope, self.curvature
        whole = _from_start(self.edges.diff(dim=1), *laws)
        before = torch.nn.functional.pad(whole.cumsum(dim=1), (1, 0))
        piece = self._piece(x)
        within = _from_start(x - self.edges.gather(1, piece), *(tensor.gather(1, piece) for tensor in laws))
        return before.gather(1, piece) + within

    def jumps(self) -> Tensor:
        """Right minus left limit at each break, (B, 4)."""
        end, _ = propagate(self.alpha, self.edges.diff(dim=1), self.value, self.slope, self.curvature)
        return self.value[:, 1:] - end[:, :-1]

    def break_variance(self, x: Tensor) -> Tensor:
        """Squared error that hidden breaks leave on average at points x (B, N) when the pieces are known, (B,).

        Each break is uniform in the gap between the points around it: the sum of jump^2 gap^2 / 12. A rule that also
        knows how large jumps are can do better.
        """
        points = torch.cat([self.edges[:, :1], x.sort(dim=1).values, self.edges[:, -1:]], dim=1)
        right = torch.searchsorted(points, self.edges[:, 1:-1].contiguous(), right=True)
        gap = points.gather(1, right) - points.gather(1, right - 1)
        return row_sum((self.jumps() * gap).square()) / 12.0

    def take(self, index: slice | Tensor) -> Pieces:
        """The integrands `index`."""
        return Pieces(*(getattr(self, field.name)[index] for field in fields(self)))


def _from_start(t: Tensor, alpha: Tensor, value: Tensor, slope: Tensor, curvature: Tensor) -> Tensor:
    """Integral of a piece over its first t."""
    _, _, c2, c3, _ = stumpff(alpha * t * t)
    return t * (value + t * (slope * c2 + t * curvature * c3))


def _breaks(u: Tensor, shortest: float) -> Tensor:
    """Edges (B, 6) from uniform numbers (B, 4): ordered uniform breaks with room of `shortest` between them."""
    inner = u.sort(dim=1).values * (1.0 - PIECES * shortest)
    inner = inner + shortest * torch.arange(1, PIECES, device=u.device)
    return torch.cat([torch.zeros_like(u[:, :1]), inner, torch.ones_like(u[:, :1])], dim=1)


def draw(rows: Tensor, stream: Stream, shape: Shape | None = None) -> Pieces:
    """Random integrands, each a function of its global row alone.

    A piece begins where the last one ended, plus a jump. A linear piece runs to a random value near the integrand's
    level, a quadratic one does so with a bulge, and a trigonometric one swings around that level.

    Parameters
    ----------
    rows : Tensor, (B,), int64
        Global indices of the integrands.
    stream : Stream
        Source of the random numbers.
    shape : Shape, optional
        Constants of the family; by default the calibrated ones.

    Returns
    -------
    Pieces

    References
    ----------
    Fig. 37 and Appendix A.1 of the paper.

    Examples
    --------
    >>> pieces = draw(torch.arange(3), Stream(0, "test", "toy"))
    >>> pieces.edges.shape, bool((pieces.edges.diff(dim=1) > 0).all())
    (torch.Size([3, 6]), True)
    """
    shape = shape or Shape()
    per_piece = 6
    u = stream.uniform(rows[:, None], torch.arange(PIECES + 1 + per_piece * PIECES, device=rows.device))
    signed = 2.0 * u - 1.0
    edges = _breaks(u[:, : PIECES - 1], shape.shortest)
    lengths = edges.diff(dim=1)
    level = shape.level + shape.level_spread * signed[:, PIECES - 1]
    end = level + shape.band * signed[:, PIECES]
    columns = []
    for k in range(PIECES):
        at = PIECES + 1 + per_piece * k
        kind, target, bulge, frequency, amplitude, jump = range(at, at + per_piece)
        start = end + (math.sqrt(3.0) * shape.jump) * signed[:, jump] if k else end
        length = lengths[:, k]
        target_value = level + shape.band * signed[:, target]
        chord = (target_value - start) / length
        # A parabola that leaves its chord by h in the middle has slope 4h/l at its start and f'' = -8h/l^2.
        lift = torch.where(u[:, kind] < shape.linear, 0.0, 4.0 * shape.bulge * signed[:, bulge] / length)
        omega = shape.frequency[0] + (shape.frequency[1] - shape.frequency[0]) * u[:, frequency]
        size = shape.amplitude[0] + (shape.amplitude[1] - shape.amplitude[0]) * u[:, amplitude]
        # The wave is centred on the level unless it must move to meet its start.
        height = torch.maximum(torch.minimum(start - level, 0.95 * size), -0.95 * size)
        rise = torch.where(u[:, bulge] < 0.5, -1.0, 1.0) * (size * size - height * height).sqrt()
        wave = u[:, kind] >= shape.linear + shape.quadratic
        alpha = torch.where(wave, omega * omega, 0.0)
        slope = torch.where(wave, omega * rise, chord + lift)
        curvature = torch.where(wave, -omega * omega * height, -2.0 * lift / length)
        columns.append(torch.stack([start, slope, curvature, alpha], dim=1))
        phase = omega * length
        end = torch.where(wave, start - height + height * phase.cos() + rise * phase.sin(), target_value)
    value, slope, curvature, alpha = torch.stack(columns, dim=2).unbind(dim=1)
    return Pieces(edges, value, slope, curvature, alpha)
