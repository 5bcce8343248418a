"""Walks that go where no walk has ended yet.

Before each long step the directions from the walk's position are weighed by the ends of the earlier walks of the same
query: how many lie in a direction's sector, and how far from where the step would land the nearest one is. So the walks
do not see the near parts of the boundary again and again. Rules that do not ask how walks are distributed (`walk-fit`,
networks) profit from it, since their error comes from boundary that no walk came near. One walk in four is uniform: the
mean of those is what a rule in doubt can fall back to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from nqr_geom import check
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import LatinHypercube, Sampler
from nqr_geom.streams import Stream
from nqr_geom.wos.explore import spread_directions
from nqr_geom.wos.problems import LaplaceProblem

__all__ = ["FullWalkSpread", "WalkSpread"]


@dataclass(frozen=True)
class WalkSpread(Sampler):
    """Walks one after the other, three in four drawn towards boundary that those before them have not met.

    The density of a direction is proportional to the distance from its landing place to the nearest earlier end, over
    the fourth power of one plus the number of earlier ends in its sector; the first step also avoids the sectors in
    which earlier walks began. The samples carry the density, so that weights of 1/pdf stay unbiased (if useless: they
    are products over all steps).

    Parameters
    ----------
    bins : int
        Sectors of directions, the first beginning at the closest boundary point.
    floor : float
        Part of every direction's density that is uniform, in (0, 1).
    most : int
        Walks that look at each other; those beyond are a Latin hypercube, so that the cost stays linear in n.
    smallest : float
        Steps shorter than this part of the first one are uniform: what they meet is met already.
    rim : float
        A walk counts as ended where the boundary is nearer to it than this times the distance between query and
        boundary there; what is left of it is uniform.

    Examples
    --------
    >>> samples = WalkSpread().draw(LaplaceProblem.family(2, points=3), 32, Stream(0))
    >>> samples.x.shape, samples.independent
    (torch.Size([6, 32, 12]), False)
    """

    bins: int = 16
    floor: float = 0.05
    most: int = 64
    smallest: float = 0.4
    rim: float = 0.02

    name = "walk-spread"

    def __post_init__(self) -> None:
        check.integer("bins", self.bins, low=2)
        check.number("floor", self.floor, low=0.0, high=1.0, open_low=True)
        check.integer("most", self.most, low=1)
        check.number("smallest", self.smallest, low=0.0)
        check.number("rim", self.rim, low=0.0)

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        if not isinstance(problem, LaplaceProblem):
            raise ValueError(f"sampler: {self.name!r} needs the problem 'laplace', got {problem.name!r}")
        few = min(n, self.most)
        x, density = spread_directions(problem, self, few, stream)
        at = torch.from_numpy(x)
        samples = Samples(at, problem.evaluate(at), torch.from_numpy(density)[..., None], self.name)
        if n <= few:
            return samples
        rest = LatinHypercube().draw(problem, n - few, stream.child("rest"))
        pdf = torch.cat([torch.from_numpy(density)[..., None], torch.ones_like(rest.x[..., :1])], dim=1)
        seen = Observation.join([samples.seen, rest.seen])
        return replace(samples, x=torch.cat([at, rest.x], dim=1), seen=seen, pdf=pdf)


@dataclass(frozen=True)
class FullWalkSpread(WalkSpread):
    """`WalkSpread` that directs every step as far as the shell, by finer sectors: slower, and better in channels.

    Examples
    --------
    >>> sampler = FullWalkSpread()
    >>> sampler.bins, sampler.smallest, sampler.rim
    (24, 0.0, 0.0)
    """

    bins: int = 24
    smallest: float = 0.0
    rim: float = 0.0

    name = "walk-spread-full"
