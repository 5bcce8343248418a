"""Peters' jackknife: two independent optical depths, combined so that most of the exponential's bias cancels."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from nqr_geom.integrator.problem import ExpLink, Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.integrator.sums import row_sum

__all__ = ["Jackknife", "JackknifeLink"]


@dataclass(frozen=True)
class JackknifeLink(ExpLink):
    """G(F) = exp(-F) cos(apart), for depths F + apart and F - apart.

    Its expectation is e^-F up to third moments of the errors. Values may be negative.

    Parameters
    ----------
    apart : Tensor, (B, C)
        Half the difference of the two depths.
    """

    apart: Tensor = field(default_factory=lambda: torch.zeros(1, 1, dtype=torch.float64))

    def __call__(self, inner: Tensor) -> Tensor:
        return super().__call__(inner) * torch.cos(self.apart)

    def slope(self, inner: Tensor) -> Tensor:
        return super().slope(inner) * torch.cos(self.apart)


class Jackknife(Rule):
    """exp(-(t1 + t2)/2) cos((t1 - t2)/2) for the depths t1 and t2 of two independent halves of the samples.

    References
    ----------
    Peters, Jackknife transmittance and MIS weight estimation, 2025.
    """

    name = "jackknife"

    def combine(self, samples: Samples) -> Combination:
        self._need_one_technique(samples)
        if samples.design != "jitter-pair" or samples.stratum is None:
            raise ValueError(f"rule: 'jackknife' needs two independent halves, these are {samples.design!r} points")
        samples.feature("optical_length", self.name)  # only an optical depth lies behind this exponential
        second = samples.stratum[..., None] == 1
        value = samples.value[:, :, 0]
        n = samples.n
        one = row_sum(torch.where(second, 0.0, value)) / (n - n // 2)
        two = row_sum(torch.where(second, value, 0.0)) / (n // 2) if n > 1 else one
        weights = [0.5 * n / (n - n // 2) if n > 1 else 1.0, 0.5 * n / max(1, n // 2)]
        share = value.new_tensor(weights)[samples.stratum]
        return Combination(share[..., None, None], link=JackknifeLink(apart=0.5 * (one - two)))
