"""A sampler for pieces with hidden breaks: always split the gap that leaves the largest expected squared error."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from nqr_geom import check
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import Sampler, Stratified
from nqr_geom.streams import Stream
from nqr_geom.toy.family import PIECES, Shape

__all__ = ["Gap", "Seen", "ToySplit"]


@dataclass(frozen=True)
class Seen:
    """Samples in the order of placement, after two columns for the ends of [0, 1]; tables of shape (B, n + 2).

    `settled` counts what determines the law of each piece, (B, PIECES + 1): from 3 on its smooth gaps are exact. The
    last column belongs to gaps with breaks and stays 0.
    """

    x: Tensor
    value: Tensor
    slope: Tensor
    piece: Tensor
    settled: Tensor

    @classmethod
    def empty(cls, like: Tensor, n: int) -> Seen:
        """Room for n samples a row, on the device of `like` (B, ...)."""
        x, value, slope = like.new_zeros(3, like.shape[0], n + 2)
        x[:, 1] = 1.0
        piece = torch.zeros_like(x, dtype=torch.int64)
        piece[:, 1] = PIECES - 1
        return cls(x, value, slope, piece, like.new_zeros(like.shape[0], PIECES + 1))

    def enter(self, at: int, x: Tensor, look: Observation) -> None:
        """Put samples x (B, k) into columns at, at + 1, ..."""
        columns = slice(at, at + x.shape[1])
        self.x[:, columns] = x
        self.value[:, columns] = look.value[..., 0, 0]
        self.slope[:, columns] = look.features["derivative"][..., 0, 0]
        self.piece[:, columns] = look.features["piece"][..., 0, 0]
        self.settled.scatter_add_(1, self.piece[:, columns], torch.ones_like(x))


@dataclass(frozen=True)
class Gap:
    """What gaps between columns of `Seen` tell, each (B, k).

    Parameters
    ----------
    width : Tensor
        h.
    known : Tensor, (B, k, 2) bool
        Whether the left and the right end are samples, not ends of [0, 1].
    piece, breaks : Tensor
        Piece index at the left end, and how many breaks hide.
    rise : Tensor
        Difference of the values.
    ahead, behind : Tensor
        Slope at the left and at the right end times h.
    score, idle : Tensor
        As in `_Gaps`.
    parabola : Tensor
        Whether both ends agree with a parabola.
    """

    width: Tensor
    known: Tensor
    piece: Tensor
    breaks: Tensor
    rise: Tensor
    ahead: Tensor
    behind: Tensor
    score: Tensor
    idle: Tensor
    parabola: Tensor

    @property
    def off(self) -> Tensor:
        """What the trapezoid of the slopes misses of the rise: 0 for a parabola."""
        return self.rise - 0.5 * (self.ahead + self.behind)

    @classmethod
    def between(cls, seen: Seen, left: Tensor, right: Tensor, shape: Shape) -> Gap:
        """The gaps from columns `left` to columns `right` (B, k)."""
        h = seen.x.gather(1, right) - seen.x.gather(1, left)
        piece = seen.piece.gather(1, left)
        breaks = seen.piece.gather(1, right) - piece
        known = torch.stack([left >= 2, right >= 2], dim=-1)
        inside, smooth = known.all(dim=-1), breaks == 0
        ahead, behind = h * seen.slope.gather(1, left), h * seen.slope.gather(1, right)
        rise = seen.value.gather(1, right) - seen.value.gather(1, left)
        off = rise - 0.5 * (ahead + behind)
        spread, least = (2.0 * shape.jump) ** 2, (0.5 * shape.jump) ** 2
        jump = torch.where(inside, off * off, spread).clamp_max(2.0 * spread) + least
        # An end of [0, 1] is reached by a tangent, whose rise may be wrong.
        tangent = (ahead + behind).square().clamp_max(spread) + least
        bend = torch.where(inside, off * off, tangent)
        noise = 1e-9 * (rise.abs() + ahead.abs() + behind.abs())
        # Close samples may tell the law badly, so that a wide gap is worth a look once all breaks are found.
        idle = 1e-8 * h * h
        score = h * h / 12.0 * torch.where(smooth, bend, jump)
        return cls(h, known, piece, breaks, rise, ahead, behind, score, idle, inside & smooth & (off.abs() <= noise))


@dataclass(frozen=True)
class _Gaps:
    """The gaps between neighbouring samples: tables of shape (B, n + 1).

    `left` and `right` are columns of `Seen`; `score` is the expected squared error of the integral over the gap,
    `idle` what remains of it once the law of `piece` is settled.
    """

    left: Tensor
    right: Tensor
    piece: Tensor
    score: Tensor
    idle: Tensor

    @classmethod
    def empty(cls, like: Tensor, n: int) -> _Gaps:
        """Room for n + 1 gaps a row."""
        index = torch.zeros(3, like.shape[0], n + 1, dtype=torch.int64, device=like.device)
        return cls(*index, *like.new_zeros(2, like.shape[0], n + 1))


@dataclass(frozen=True)
class ToySplit(Sampler):
    """A few stratified samples, then bisection of the gap with the largest expected squared error.

    A gap with a hidden break of jump J and width h leaves J^2 h^2 / 12. A smooth gap leaves nothing once its piece has
    three samples (two, if they agree with a parabola); before, it counts by how far it is from a parabola. The first
    samples are random, the others follow from what was seen, so there is no density.

    Parameters
    ----------
    first : int
        Stratified samples at the start, >= 1.
    shape : Shape
        What is known of the family: size of jumps and spread of values.

    References
    ----------
    Section 5 of the paper, whose network learns to sample next to the breaks (Fig. 16).

    Examples
    --------
    >>> from nqr_geom.toy.problem import ToyProblem
    >>> samples = ToySplit().draw(ToyProblem(2), 32, Stream(0))
    >>> samples.x.shape, samples.pdf is None
    (torch.Size([2, 32, 1]), True)
    """

    first: int = 6
    shape: Shape = field(default_factory=Shape)

    name = "toy-split"

    def __post_init__(self) -> None:
        check.integer("first", self.first, low=1)

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        missing = {"derivative", "piece"} - set(problem.schema.names)
        if problem.dim != 1 or missing:
            raise ValueError(
                f"sampler: {self.name!r} needs a 1-D problem with the features 'derivative' and 'piece', "
                f"{problem.name!r} has {problem.dim} dimensions and {', '.join(problem.schema.names) or 'no features'}"
            )
        first = min(n, self.first)
        x = Stratified().points(problem.rows, first, 1, stream)
        looks = [problem.evaluate(x)]
        seen, gaps = Seen.empty(x, n), _Gaps.empty(x, n)
        seen.enter(2, x[..., 0], looks[0])
        column = torch.tensor([0, *range(2, first + 2), 1], device=x.device).expand(problem.batch, first + 2)
        self._fill(seen, gaps, slice(0, first + 1), column[:, :-1], column[:, 1:])
        row = torch.arange(problem.batch, device=x.device)[:, None]
        for placed in range(first, n):
            open_gaps = slice(0, placed + 1)
            settled = seen.settled.gather(1, gaps.piece[:, open_gaps]) > 2.5
            score = torch.where(settled, gaps.idle[:, open_gaps], gaps.score[:, open_gaps])
            gap = score.argmax(dim=1, keepdim=True)
            left, right = gaps.left[row, gap], gaps.right[row, gap]
            new = 0.5 * (seen.x[row, left] + seen.x[row, right])
            looks.append(problem.evaluate(new[..., None]))
            seen.enter(placed + 2, new, looks[-1])
            middle = torch.full_like(left, placed + 2)
            target = torch.cat([gap, torch.full_like(gap, placed + 1)], dim=1)
            self._fill(seen, gaps, (row, target), torch.cat([left, middle], dim=1), torch.cat([middle, right], dim=1))
        return Samples(seen.x[:, 2:, None], Observation.join(looks), None, self.name)

    def _fill(self, seen: Seen, gaps: _Gaps, where: slice | tuple[Tensor, Tensor], left: Tensor, right: Tensor) -> None:
        """Write the gaps between columns `left` and `right` (B, k) of the samples into the table."""
        at = where if isinstance(where, tuple) else (slice(None), where)
        gap = Gap.between(seen, left, right, self.shape)
        seen.settled.scatter_add_(1, gap.piece, 3.0 * gap.parabola.to(gap.width.dtype))
        gaps.left[at], gaps.right[at] = left, right
        gaps.piece[at] = torch.where(gap.breaks == 0, gap.piece, PIECES)
        gaps.score[at], gaps.idle[at] = gap.score, gap.idle
