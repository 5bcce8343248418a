"""What the samples of a cloud tell about the density between them, as a rule and as a sampler.

Eq. 9 clamps a field 1 - u_geo + u_fBm to [0, 1]. Between two samples u_geo is known from both ends: each tells its
value, slope and bend, and the nearer shape wins. The noise there is a Gaussian process whose correlation follows from
its constants, pinned at both ends. So the density's expectation has a closed form, clamp included, and so has what is
still uncertain about it: the rule adds up the former, the sampler goes where the latter is largest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.integrator.samplers import Sampler, UniformJitter
from nqr_geom.integrator.sums import row_sum
from nqr_geom.streams import Stream

__all__ = ["Between", "ClampedNoise", "Ends", "NoiseRefine", "between", "in_order", "inside", "over_nodes"]

# Warp's gradient noise of frequency 1: variance, and decay of the correlation exp(-_DECAY r^2) (measured to 0.03).
_VARIANCE = 0.0366
_DECAY = 3.5
_OCTAVES = 16  # no noise has more
_NODES = 8  # midpoints in each gap for the answer; the sampler looks at half of them
_NEEDS = ("length", "optical_length", "u_geo", "slope", "bend", "u_fbm", "noise")


@dataclass(frozen=True)
class Between:
    """The field at midpoints of the N+1 gaps of sorted samples, each (B, N+1, nodes).

    Parameters
    ----------
    width : Tensor, (B, N+1)
        Of each gap, in x.
    mean, variance : Tensor
        Expectation of the clamped field, and how uncertain it is there.
    """

    width: Tensor
    mean: Tensor
    variance: Tensor


def over_nodes(values: Tensor) -> Tensor:
    """Mean over the last axis in a fixed order, (B, N+1, nodes) -> (B, N+1)."""
    first, *others = values.unbind(dim=-1)
    for node in others:
        first = first + node
    return first / values.shape[-1]


def _correlation(distance: Tensor, noise: Tensor) -> Tensor:
    """Correlation of fBm at a distance (B, N+1, nodes), for noise constants (B, 5)."""
    octaves = min(_OCTAVES, int(noise[:, 2].max()))
    total = power = torch.zeros_like(noise[:, :1, None])
    result = torch.zeros_like(distance)
    scale, share = noise[:, 1, None, None], torch.ones_like(power)
    for k in range(octaves):
        here = torch.where(noise[:, 2, None, None] > k, share, 0.0)
        result = result + here * torch.exp(-_DECAY * (scale * distance).square())
        total = total + here
        scale, share = scale * noise[:, 4, None, None], share * noise[:, 3, None, None].square()
    return result / total.clamp_min(1e-300)


def _spread(noise: Tensor) -> Tensor:
    """Standard deviation of fBm (B, 1, 1)."""
    square = noise[:, 3].square()
    total = sum(torch.where(noise[:, 2] > k, square**k, 0.0) for k in range(min(_OCTAVES, int(noise[:, 2].max()))))
    return (noise[:, 0] * torch.sqrt(_VARIANCE * torch.as_tensor(total)))[:, None, None].expand(-1, 1, 1)


def _above(mean: Tensor, spread: Tensor) -> Tensor:
    """Expectation of max(Y, 0) for normal Y."""
    z = mean / spread.clamp_min(1e-12)
    density = torch.exp(-0.5 * z.square()) / math.sqrt(2.0 * math.pi)
    smooth = mean * torch.special.ndtr(z) + spread * density
    return torch.where(spread > 1e-9, smooth, mean.clamp_min(0.0))


@dataclass(frozen=True)
class Ends:
    """What is known at one end of G gaps, each (B, G); nothing where `known` is 0.

    Parameters
    ----------
    u_geo, slope, bend, u_fbm : Tensor
        Features of the sample there; infinity for `u_geo` and zero for the others where there is none.
    known : Tensor
        1 where there is a sample, 0 where there is none.
    """

    u_geo: Tensor
    slope: Tensor
    bend: Tensor
    u_fbm: Tensor
    known: Tensor


def _pinned(
    left: Tensor, right: Tensor, noise: Tensor, start: Ends, end: Ends, spread: Tensor
) -> tuple[Tensor, Tensor]:
    """Mean and variance of the noise between the ends of gaps, at distances (B, G, nodes) from them."""
    to_left = _correlation(left, noise) * start.known[..., None]
    to_right = _correlation(right, noise) * end.known[..., None]
    across = _correlation(left[..., :1] + right[..., :1], noise) * (start.known * end.known)[..., None]
    determinant = (1.0 - across.square()).clamp_min(1e-9)
    from_left = (to_left - across * to_right) / determinant
    from_right = (to_right - across * to_left) / determinant
    mean = from_left * start.u_fbm[..., None] + from_right * end.u_fbm[..., None]
    left_over = 1.0 - from_left * to_left - from_right * to_right
    return mean, spread.square() * left_over.clamp_min(0.0)


def inside(width: Tensor, start: Ends, end: Ends, length: Tensor, noise: Tensor, nodes: int = _NODES) -> Between:
    """The field within gaps, of which one end at least is known.

    Parameters
    ----------
    width : Tensor, (B, G)
        Of the gaps, in x.
    start, end : Ends
        What is known at both ends.
    length : Tensor, (B, 1)
        What x = 1 is.
    noise : Tensor, (B, 5)
        Constants of the noise.
    nodes : int
        Midpoints in each gap.
    """
    at = (torch.arange(nodes, device=width.device, dtype=width.dtype) + 0.5) / nodes
    step = (width * length)[..., None]
    left, right = step * at, step * (1.0 - at)
    ahead = start.u_geo[..., None] + left * (start.slope[..., None] + left * start.bend[..., None])
    back = end.u_geo[..., None] - right * (end.slope[..., None] - right * end.bend[..., None])
    geometry = torch.minimum(ahead, back).clamp_min(0.0)
    if bool((noise[:, 0] > 0.0).any()):
        mean, variance = _pinned(left, right, noise, start, end, _spread(noise))
    else:
        mean = variance = torch.zeros_like(geometry)
    field, sigma = 1.0 - geometry + mean, variance.sqrt()
    expected = _above(field, sigma) - _above(field - 1.0, sigma)
    # Where the field is clamped its uncertainty does not count.
    safe = sigma.clamp_min(1e-9)
    free = torch.special.ndtr(field / safe) - torch.special.ndtr((field - 1.0) / safe)
    return Between(width, expected, variance * free)


def between(x: Tensor, features: dict[str, Tensor], nodes: int = _NODES) -> Between:
    """The field between samples at sorted x (B, N) with features (B, N) each, except "noise" (B, 5)."""
    zero, one = torch.zeros_like(x[:, :1]), torch.ones_like(x[:, :1])
    width = torch.cat([zero, x, one], dim=1).diff(dim=1)

    def padded(column: Tensor, pad: float = 0.0) -> Tensor:
        return torch.nn.functional.pad(column, (1, 1), value=pad)

    columns = [padded(features["u_geo"], math.inf), *(padded(features[name]) for name in ("slope", "bend", "u_fbm"))]
    columns.append(padded(torch.ones_like(x)))
    start, end = Ends(*(c[:, :-1] for c in columns)), Ends(*(c[:, 1:] for c in columns))
    return inside(width, start, end, features["length"][:, :1], features["noise"], nodes)


def _valid(noise: Tensor) -> Tensor:
    """Constants (B, 5) within what `Noise` allows, so that no power of gain or lacunarity overflows."""
    most = noise.new_tensor([1e100, 1e100, _OCTAVES, 1.0, 1e3])
    return torch.minimum(noise, most)


def in_order(samples: Samples, rule: str) -> tuple[Tensor, dict[str, Tensor]]:
    """x (B, N) in order and the features that go with it."""
    order = samples.x[..., 0].argsort(dim=1, stable=True)
    features = {}
    for name in _NEEDS:
        column = samples.feature(name, rule)[:, :, 0]
        features[name] = _valid(column[:, 0]) if name == "noise" else column[..., 0].gather(1, order)
    return samples.x[..., 0].gather(1, order), features


class ClampedNoise(Rule):
    """Expected optical depth given what all samples tell about shape and noise; looks at features alone.

    Examples
    --------
    >>> from nqr_geom import render
    >>> ball = render.Spheres([[0, 0, 0]], [1.0])  # depth along a chord: 4/3 half^3
    >>> ray = [[-2, 0.6, 0]], [[1, 0, 0]], 4.0
    >>> render.transmittance(ball, *ray, method="structured", full_output=True).inner.round(3)
    array([[0.683]])
    """

    name = "clamped-noise"

    def combine(self, samples: Samples) -> Combination:
        self._need_1d(samples)
        x, features = in_order(samples, self.name)
        gaps = between(x, features)
        inner = row_sum(gaps.width * over_nodes(gaps.mean)) * features["optical_length"][:, 0]
        return Combination(torch.zeros_like(samples.value), inner[:, None])


@dataclass(frozen=True)
class NoiseRefine(Sampler):
    """Uniformly jittered points, then in a few rounds the middles of the gaps that are most uncertain.

    Parameters
    ----------
    first : float
        Share of the points that are placed before looking.
    rounds : int
        In how many rounds the others are placed.
    """

    first: float = 0.4
    rounds: int = 4

    name = "noise-refine"

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        if not set(_NEEDS) <= set(problem.schema.names):
            raise ValueError(f"sampler: {self.name!r} needs the problem 'transmittance', got {problem.name!r}")
        start = n if n < 4 else max(2, math.ceil(self.first * n))
        x = UniformJitter().points(problem.rows, start, 1, stream)
        seen = [problem.evaluate(x)]
        places = [x]
        while (have := sum(p.shape[1] for p in places)) < n:
            samples = self._samples(places, seen)
            ordered, features = in_order(samples, self.name)
            gaps = between(ordered, features, _NODES // 2)
            doubt = gaps.width.square() * over_nodes(gaps.variance) + 1e-9 * gaps.width.square()
            more = min(n - have, math.ceil((n - start) / self.rounds), have + 1)
            worst = doubt.argsort(dim=1, descending=True, stable=True)[:, :more].sort(dim=1).values
            edge = torch.nn.functional.pad(ordered, (1, 0))
            middle = (edge + 0.5 * gaps.width).gather(1, worst)
            places.append(middle[..., None])
            seen.append(problem.evaluate(places[-1]))
        return self._samples(places, seen)

    def _samples(self, places: list[Tensor], seen: list[Observation]) -> Samples:
        return Samples(torch.cat(places, dim=1), Observation.join(seen), None, self.name)
