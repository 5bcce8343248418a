"""A curve rebuilt from samples: Hermite cubics between neighbours, and what follows from them exactly.

Position and tangent at two samples of one piece fix a cubic. It is the piece itself where that is a quadratic or a
cubic, and fourth-order close where it is smooth. Beyond the outermost samples the piece is extended to its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nqr_geom.curves.gauss import BEND, BENT, COUNT, LONGEST, NODES, STRAIGHT, WEIGHTS
from nqr_geom.integrator.problem import Samples

__all__ = ["Segments", "child_errors", "log_integral", "reconstruct", "tangents", "winding"]

_LEVELS = 60  # halvings after which a query is taken to lie on the segment
UNSEEN = 36.0  # an exponent that far below the nearest is not seen in double precision
_TINY = 1e-300
_QUADRATIC = 1e-9  # a cubic term below this part of the linear one is rounding


@dataclass(frozen=True)
class Segments:
    """Cubic pieces of the rebuilt curves, relative to their query.

    Parameters
    ----------
    control : Tensor, (M, 4, 2), float64
        Bezier control points minus the query.
    row : Tensor, (M,), int64
        Which integral each belongs to, ascending.
    error : Tensor, (M,)
        How far the true curve may be off, estimated from samples left out.
    missing : Tensor, (B,) bool
        Integrals with a piece that no two samples fell on: its shape is a guess.
    """

    control: Tensor
    row: Tensor
    error: Tensor
    missing: Tensor


def tangents(samples: Samples, rule: str) -> Tensor:
    """dx/ds (B, N, 2) from the normal and the speed."""
    normal = samples.feature("normal", rule)[:, :, 0]
    speed = samples.feature("speed", rule)[:, :, 0]
    return speed * torch.stack([-normal[..., 1], normal[..., 0]], dim=-1)


def cubic_terms(chord: Tensor, here: Tensor, there: Tensor, gap: Tensor) -> tuple[Tensor, Tensor]:
    """Coefficients c2, c3 of r + T u + c2 u^2 + c3 u^3 through a neighbour at signed distance `gap` (..., 1)."""
    mean = chord / gap
    c2 = (3.0 * mean - 2.0 * here - there) / gap
    c3 = (here + there - 2.0 * mean) / gap**2
    # For a quadratic the last term is rounding, which an extension would blow up.
    size = torch.linalg.vector_norm(c3, dim=-1, keepdim=True) * gap**2
    pace = torch.linalg.vector_norm(here, dim=-1, keepdim=True) + torch.linalg.vector_norm(there, dim=-1, keepdim=True)
    return c2, torch.where(size > _QUADRATIC * pace, c3, 0.0)


def bezier_of(r0: Tensor, t0: Tensor, r1: Tensor, t1: Tensor, length: Tensor) -> Tensor:
    """Control points (..., 4, 2) of the cubic from (r0, t0) to (r1, t1) over a parameter length (...)."""
    third = length[..., None] / 3.0
    return torch.stack([r0, r0 + third * t0, r1 - third * t1, r1], dim=-2)


def _extension(r: Tensor, t: Tensor, c2: Tensor, c3: Tensor, gap: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Position and tangent at signed distance `reach` (...) by the neighbouring cubic, tamed where it reaches far.

    A quadratic is trusted to any distance; a cubic as far as its own gap, then without its last term, and beyond
    three gaps only the tangent is followed.
    """
    far = reach.abs() / gap.abs()
    quadratic = (c3 == 0.0).all(dim=-1)
    c2 = torch.where((quadratic | (far <= 3.0))[..., None], c2, 0.0)
    c3 = torch.where((far <= 1.0)[..., None], c3, 0.0)
    u = reach[..., None]
    return r + u * (t + u * (c2 + u * c3)), t + u * (2.0 * c2 + u * (3.0 * c3))


def _errors(s: Tensor, r: Tensor, t: Tensor, c3: Tensor, gap: Tensor, joined: Tensor) -> Tensor:
    """Estimated distance of the true curve from the cubic in each gap, (B, N-1).

    A sample that the cubic through its two neighbours misses by e vouches for the gaps beside it: the error of a
    Hermite cubic is K v^2 (1-v)^2 gap^4, which gives K, and K gap^4 / 16 for the smaller gaps (kept four times). A
    gap with no such witness is judged by its cubic term, zero for quadratics.
    """
    error = torch.linalg.vector_norm(c3 * gap**3, dim=-1) / 4.0
    if s.shape[1] < 3:
        return error
    witnessed = joined[:, 1:] & joined[:, :-1]
    outer = torch.stack([s[:, :-2], torch.where(witnessed, s[:, 2:], s[:, :-2] + 1.0)], dim=-1)
    inside = torch.where(witnessed, s[:, 1:-1], s[:, :-2] + 0.5)
    pairs = torch.stack([r[:, :-2], r[:, 2:]], dim=-2), torch.stack([t[:, :-2], t[:, 2:]], dim=-2)
    left, right = child_errors(outer, *pairs, inside, r[:, 1:-1])
    unseen = -torch.ones_like(error[:, :1])
    left, right = torch.where(witnessed, left, -1.0), torch.where(witnessed, right, -1.0)
    seen = torch.maximum(torch.cat([left, unseen], dim=1), torch.cat([unseen, right], dim=1))
    return torch.where(seen >= 0.0, seen, error)


def child_errors(ends: Tensor, r: Tensor, t: Tensor, s: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    """Errors of the cubics left and right of s, from how far the one over the whole gap missed it.

    Parameters
    ----------
    ends, s : Tensor, (..., 2) and (...)
        The gap and a parameter in it.
    r, t : Tensor, (..., 2, 2)
        Positions and tangents at the gap's ends.
    seen : Tensor, (..., 2)
        The position at s.
    """
    h = (ends[..., 1] - ends[..., 0])[..., None]
    v = (s - ends[..., 0])[..., None] / h
    w = 1.0 - v
    predicted = (1.0 + 2.0 * v) * w**2 * r[..., 0, :] + v**2 * (1.0 + 2.0 * w) * r[..., 1, :]
    predicted = predicted + v * w * h * (w * t[..., 0, :] - v * t[..., 1, :])
    miss = torch.linalg.vector_norm(predicted - seen, dim=-1) / 4.0
    return miss * (v / w)[..., 0] ** 2, miss * (w / v)[..., 0] ** 2


def reconstruct(samples: Samples, rule: str) -> Segments:
    """Rebuild every integral's curve from its samples.

    Parameters
    ----------
    samples : Samples
        With the features "relative", "normal", "speed", "piece" and "pieces".
    rule : str
        Who asks, for the error message.

    Returns
    -------
    Segments
        One cubic between neighbours on a piece, one from its first sample back to its start and one from its last
        to its end.
    """
    samples = samples.permuted(samples.x[..., 0].argsort(dim=1, stable=True))
    s = samples.x[..., 0]
    r = samples.feature("relative", rule)[:, :, 0]
    t = tangents(samples, rule)
    piece = samples.feature("piece", rule)[:, :, 0, 0]
    count = samples.feature("pieces", rule)[:, :, 0, 0]
    low, high = piece.double() / count, (piece + 1).double() / count

    step = s.diff(dim=1)
    changes = piece.diff(dim=1) != 0
    joined = ~changes & (step > 0.0)  # neighbours on one piece, and not the same point
    gap = torch.where(joined, step, 1.0)[..., None]
    chord = r.diff(dim=1)
    # A sample that is alone on its piece is followed along its tangent.
    forth, back = (
        [torch.where(joined[..., None], c, 0.0) for c in cubic_terms(sign * chord, here, there, sign * gap)]
        for sign, here, there in ((1.0, t[:, :-1], t[:, 1:]), (-1.0, t[:, 1:], t[:, :-1]))
    )
    error = _errors(s, r, t, forth[1], gap, joined)

    # The ends of a piece: the first sample is extended by the cubic to its right, the last by the one to its left.
    right = [_padded(c, after=True) for c in (*forth, gap, error[..., None])]
    left = [_padded(c, after=False) for c in (*back, gap, error[..., None])]
    r_start, t_start = _extension(r, t, right[0], right[1], right[2][..., 0].clamp_min(_TINY), low - s)
    r_end, t_end = _extension(r, t, left[0], left[1], left[2][..., 0].clamp_min(_TINY), high - s)
    alone = torch.linalg.vector_norm(t, dim=-1)
    has_right, has_left = _padded(joined, after=True), _padded(joined, after=False)
    true = torch.ones_like(piece[:, :1], dtype=torch.bool)

    parts = [
        (bezier_of(r[:, :-1], t[:, :-1], r[:, 1:], t[:, 1:], step), error, joined),
        (
            bezier_of(r_start, t_start, r, t, s - low),
            torch.where(has_right, right[3][..., 0], alone * (s - low)),
            torch.cat([true, changes], dim=1) & (s > low),
        ),
        (
            bezier_of(r, t, r_end, t_end, high - s),
            torch.where(has_left, left[3][..., 0], alone * (high - s)),
            torch.cat([changes, true], dim=1) & (s < high),
        ),
    ]
    used = torch.cat([part[2] for part in parts], dim=1)
    rows = torch.arange(len(s), device=s.device)[:, None].expand(used.shape)
    control = torch.cat([part[0] for part in parts], dim=1)[used]
    return Segments(control, rows[used], torch.cat([part[1] for part in parts], dim=1)[used], _missing(piece, count))


def _padded(tensor: Tensor, after: bool) -> Tensor:
    """(B, N-1, ...) filled up to N with zeros, behind or before."""
    filler = torch.zeros_like(tensor[:, :1]) if tensor.shape[1] else tensor.new_zeros(len(tensor), 1, *tensor.shape[2:])
    return torch.cat([tensor, filler] if after else [filler, tensor], dim=1)


def _missing(piece: Tensor, count: Tensor) -> Tensor:
    """Integrals with a piece that fewer than two samples fell on, (B,) bool."""
    hits = torch.zeros(len(piece), int(count.max()), dtype=torch.int64, device=piece.device)
    hits.scatter_add_(1, piece, torch.ones_like(piece))
    there = torch.arange(hits.shape[1], device=piece.device) < count[:, :1]
    return ((hits < 2) & there).any(dim=1)


def halves(control: Tensor) -> Tensor:
    """De Casteljau at 1/2: (M, 4, 2) to (2M, 4, 2), left and right one after the other."""
    p0, p1, p2, p3 = control.unbind(dim=1)
    a, b, c = (p0 + p1) / 2.0, (p1 + p2) / 2.0, (p2 + p3) / 2.0
    d, e = (a + b) / 2.0, (b + c) / 2.0
    middle = (d + e) / 2.0
    return torch.stack([p0, a, d, middle, middle, e, c, p3], dim=1).reshape(-1, 4, 2)


def winding(segments: Segments) -> tuple[Tensor, Tensor]:
    """Winding number of the rebuilt curves around their queries.

    A segment whose box does not hold the query subtends the angle between its ends; the others are halved. One that
    has shrunk to the size of its own error cannot tell the side the query lies on.

    Returns
    -------
    value : Tensor, (B,), float64
    doubtful : Tensor, (B,), bool
        Where a segment could not tell.
    """
    control, row, error = segments.control, segments.row, segments.error
    value = torch.zeros(len(segments.missing), dtype=torch.float64, device=control.device)
    doubtful = torch.zeros_like(segments.missing)
    for _ in range(_LEVELS):
        low, high = control.amin(dim=1), control.amax(dim=1)
        holds = ((low <= 0.0) & (high >= 0.0)).all(dim=1)
        small = holds & ((high - low).amax(dim=1) <= error)
        doubtful[row[small]] = True
        done = ~holds | small
        value.index_add_(0, row[done], _angle(control[done]))
        control, row, error = control[~done], row[~done], error[~done]
        if not len(row):
            break
        control = halves(control)
        row, error = row.repeat_interleave(2), error.repeat_interleave(2)
    else:
        doubtful[row] = True
        value.index_add_(0, row, _angle(control))
    return value / (2.0 * math.pi), doubtful


def _angle(control: Tensor) -> Tensor:
    """Angle between the ends as seen from the origin, (M,)."""
    start, end = control[:, 0], control[:, 3]
    return angle(start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0], (start * end).sum(dim=1))


def angle(y: Tensor, x: Tensor) -> Tensor:
    """atan2(y, x) with the same bits wherever a number stands in its tensor, which torch.atan2 does not promise.

    Examples
    --------
    >>> angle(torch.tensor([0.0, 1.0, -2.0]), torch.tensor([-1.0, 1.0, 0.0])) / math.pi
    tensor([ 1.0000,  0.2500, -0.5000])
    """
    size = torch.maximum(x.abs(), y.abs())
    size = torch.where(size > 0.0, size, 1.0)
    x, y = x / size, y / size
    radius = (x * x + y * y).sqrt()
    # Half the angle, by the quotient that does not cancel; on the negative axis (radius - x) / 0 is an infinity.
    front = torch.where(radius > 0.0, radius + x, 1.0)
    half = torch.where(x >= 0.0, y / torch.where(x >= 0.0, front, 1.0), (radius - x) / torch.where(x < 0.0, y, 1.0))
    return 2.0 * torch.atan(half)


def log_integral(segments: Segments, alpha: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
    """Integral of exp(-alpha (|x| - shift)) dl over the rebuilt curves, as exp(exponent) times a sum.

    Segments are halved until a Gauss rule is sure of them (`gauss`): the distance varies by less than 14 / alpha or, if
    it bends, 3 / alpha, by more the less they count; they are no longer than four fifths of their distance (closer by,
    |x| has a kink), and their velocity changes by no more than the least of it (at a cusp it has a kink, too), unless
    too short to matter. What lies 36 / alpha farther than the nearest point so far cannot be seen in float64 and is
    left out. The curve may come closer than every sample, so the largest exponent is kept apart.

    Parameters
    ----------
    segments : Segments
        From `reconstruct`.
    alpha, shift : Tensor, (B,)
        Sharpness, and the distance of the nearest sample.

    Returns
    -------
    exponent, total : Tensor, (B,)
        The integral is exp(exponent) * total.
    """
    control, row = segments.control, segments.row
    exponent, total = torch.full_like(shift, -torch.inf), torch.zeros_like(shift)
    closest = shift  # of the points that have been seen, the new ends of segments included
    for level in range(_LEVELS):
        legs, nearest, farthest = _ranges(control)
        turn, even = _turns(control)
        sharp = alpha[row]
        ends = torch.linalg.vector_norm(control[:, [0, 3]], dim=-1).amin(dim=1)
        closest = closest.scatter_reduce(0, row, ends, "amin")
        seen = sharp * (nearest - closest[row]) < UNSEEN
        farther = 1.0 + (sharp * (nearest - shift[row])).clamp_min(0.0) / (2.0 * COUNT)
        spread, bend = sharp * (farthest - nearest), sharp * (0.125 * legs / nearest.clamp_min(_TINY) + 0.75 * turn)
        tame = (spread <= BENT * farther) | (spread + BEND * bend <= STRAIGHT * farther)
        sure = (tame & even & (legs <= LONGEST * nearest**2)) | (legs <= (1e-5 / sharp) ** 2)
        done = seen & (sure | (level == _LEVELS - 1))
        powers, lengths = _gauss(control[done], sharp[done], shift[row[done]])
        largest = exponent.scatter_reduce(0, row[done], powers.amax(dim=1), "amax")
        total = torch.where(total > 0.0, total * torch.exp(exponent - largest), total)
        total.index_add_(0, row[done], (torch.exp(powers - largest[row[done], None]) * lengths).sum(dim=1))
        exponent = largest
        rest = seen & ~done
        if not rest.any():
            break
        control, row = halves(control[rest]), row[rest].repeat_interleave(2)
    return exponent, total


def _turns(control: Tensor) -> tuple[Tensor, Tensor]:
    """Largest difference of two neighbouring legs of the control polygon (M,), and where no two of its legs differ by
    more than the shortest, (M,) bool."""
    leg = control.diff(dim=1)
    square = leg.diff(dim=1).square().sum(dim=-1).amax(dim=1)
    apart = torch.maximum(square, (leg[:, 2] - leg[:, 0]).square().sum(dim=-1))
    return square.sqrt(), apart <= leg.square().sum(dim=-1).amin(dim=1)


def _ranges(control: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Bounds of each segment's squared length, and of its smallest and largest distance from the origin, (M,) each."""
    legs = 3.0 * control.diff(dim=1).square().sum(dim=(1, 2))
    start, chord = control[:, 0], control[:, 3] - control[:, 0]
    along = -(start * chord).sum(dim=-1) / chord.square().sum(dim=-1).clamp_min(_TINY)
    foot = start + along.clamp(0.0, 1.0)[:, None] * chord
    thirds = torch.linspace(0.0, 1.0, 4, dtype=control.dtype, device=control.device)[:, None]
    off = torch.linalg.vector_norm(control - start[:, None] - thirds * chord[:, None], dim=-1).amax(dim=-1)
    nearest = (torch.linalg.vector_norm(foot, dim=-1) - off).clamp_min(0.0)
    return legs, nearest, torch.linalg.vector_norm(control[:, [0, 3]], dim=-1).amax(dim=-1) + off


def _gauss(control: Tensor, alpha: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
    """Exponents and length elements (M, G) of the Gauss-Legendre rule on each segment."""
    nodes, weights = (torch.as_tensor(a, device=control.device) for a in (NODES, WEIGHTS))
    u = 1.0 - nodes
    basis = torch.stack([u**3, 3.0 * nodes * u**2, 3.0 * nodes**2 * u, nodes**3], dim=1)
    slope = torch.stack([u**2, 2.0 * nodes * u, nodes**2], dim=1)
    position = _combined(basis, control)
    speed = 3.0 * torch.linalg.vector_norm(_combined(slope, control.diff(dim=1)), dim=-1)
    distance = torch.linalg.vector_norm(position, dim=-1)
    return -alpha[:, None] * (distance - shift[:, None]), speed * weights


def _combined(basis: Tensor, control: Tensor) -> Tensor:
    """Points (M, G, 2) of basis (G, K) and control (M, K, 2); not a matrix product, whose bits depend on M."""
    point = basis[:, 0, None] * control[:, None, 0]
    for k in range(1, basis.shape[1]):
        point = point + basis[:, k, None] * control[:, None, k]
    return point
