"""What a gap between samples along a ray shows to a sampling network: its density and doubt by the structured rule."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from nqr_geom.integrator.learn.gaps import Gaps
from nqr_geom.integrator.learn.tokens import compress
from nqr_geom.integrator.problem import Observation, Problem
from nqr_geom.render.clamped import Ends, inside, over_nodes
from nqr_geom.render.problems import TransmittanceProblem

__all__ = ["VolumeGaps"]

_ENDS = ("u_geo", "slope", "bend", "u_fbm", "known")
_NODES = 4
_HIDDEN = 3e-5  # variance of the density that counts for a shape hidden in a gap as wide as the nearest one's radius
_FLOOR = 1e-12


def _logarithm(ratio: Tensor) -> Tensor:
    return ratio.clamp(1e-12, 1e12).log() / 3.0


class VolumeGaps(Gaps):
    """Gaps along rays; `worth` is the error that the structured rule expects of a gap, were its density constant.

    Lengths count in the length of the ray and in cells of the noise, so nothing depends on the unit of length.

    Parameters
    ----------
    problem : Problem
        A transmittance.
    n : int
        Samples that will be placed.

    Raises
    ------
    ValueError
        If the problem is another one.
    """

    size: ClassVar[int] = 20

    def __init__(self, problem: Problem, n: int) -> None:
        if not isinstance(problem, TransmittanceProblem):
            raise ValueError(f"sampler: expected a transmittance, got {problem.name!r}")
        super().__init__(problem, n)
        self.length = problem.rays.total[:, None]
        volume = problem.rays.volume.long()
        self.noise = problem.medium.constants[volume]
        self.depth = self.length * problem.medium.tensors["density"][volume][:, None]
        shape = (*self.open.shape, 2)  # both ends of every slot
        self.ends = {name: self.left.new_full(shape, math.inf if name == "u_geo" else 0.0) for name in _ENDS}
        self.error = self.left.new_ones(self.open.shape)

    def worth(self) -> Tensor:
        return self.error[:, : self.used].clamp_min(_FLOOR).log()

    def enter(self, slot: Tensor, x: Tensor, seen: Observation, new: slice) -> None:
        at = torch.arange(len(x), device=x.device)
        for name, table in self.ends.items():
            value = torch.ones_like(x) if name == "known" else seen.features[name][:, 0, 0, 0]
            # The new sample is the right end of the left part and the left end of the right one.
            table[:, new.start, 0], table[:, new.start, 1] = table[at, slot, 0], value
            table[:, new.start + 1, 0], table[:, new.start + 1, 1] = value, table[at, slot, 1]
        self._fill(new)

    def _fill(self, new: slice) -> None:
        width = (self.right - self.left)[:, new]
        start, end = (Ends(*(self.ends[name][:, new, side] for name in _ENDS)) for side in (0, 1))
        between = inside(width, start, end, self.length, self.noise, _NODES)
        half = _NODES // 2
        bend = torch.maximum(start.bend, end.bend)
        hidden = _HIDDEN * (width * self.length).square() * bend
        variance = over_nodes(between.variance)
        self.error[:, new] = width * (variance + hidden).sqrt()
        steps = width * self.length
        parts = [
            _logarithm(width),
            _logarithm(steps * self.noise[:, 1:2]),
            _logarithm(self.depth * width),
            _logarithm(self.error[:, new].clamp_min(_FLOOR)),
            over_nodes(between.mean[..., :half]),
            over_nodes(between.mean[..., half:]),
            variance.sqrt(),
            hidden.clamp_max(1.0).sqrt(),
            start.known,
            end.known,
            *(_field(side) for side in (start, end)),
            *(side.u_fbm for side in (start, end)),
            *(compress(side.u_geo.clamp_max(1e6)) * side.known for side in (start, end)),
            *(compress(side.slope * steps) for side in (start, end)),
            *(compress(side.bend * steps.square()) for side in (start, end)),
        ]
        self.features[:, new] = torch.stack(parts, dim=-1).float()


def _field(end: Ends) -> Tensor:
    """The field whose clamped value is the density; 0 where there is no sample."""
    return torch.where(end.known > 0.0, (1.0 - end.u_geo + end.u_fbm).clamp(-4.0, 2.0), 0.0)
