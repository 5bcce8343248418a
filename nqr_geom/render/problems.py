"""Transmittance as an integral behind an exponential, with all that a sample tells (Eqs. 6 and 9)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from nqr_geom import check
from nqr_geom.integrator.problem import ExpLink, Feature, Link, Observation, Problem, Samples, Schema, Whole
from nqr_geom.integrator.rules import MonteCarlo
from nqr_geom.integrator.samplers import Random, Stratified, UniformJitter
from nqr_geom.render import rays as geometry
from nqr_geom.render.medium import Medium
from nqr_geom.render.rays import Rays
from nqr_geom.render.volume import Homogeneous, Volume
from nqr_geom.streams import Stream

__all__ = ["TransmittanceProblem"]

_FEATURES = ("t", "u_geo", "u_fbm", "slope", "bend")  # as `kernels_march.FEATURES`, which needs Warp


@dataclass(frozen=True)
class TransmittanceProblem(Problem):
    """T = exp(-integral of mu along a ray) for B rays, each through one of S volumes of one kind.

    A sample at x shows mu times the length L that the integral is over, the distance t along the ray, and u_geo and
    u_fBm of Eq. 9 (Section 6.3). For structure-aware rules it also tells how u_geo goes on along the ray, its slope and
    `bend`, half its second derivative; L, mu_max L, and the noise's amplitude, frequency, octaves, gain and lacunarity.

    Parameters
    ----------
    medium : Medium
        The volumes.
    rays : Rays
        The rays.
    rows : Tensor, (B,), int64
        Global index of each integral.
    everything : bool
        March through rays without density and evaluate noise of amplitude zero, too; for measuring what it costs.

    Examples
    --------
    >>> from nqr_geom import render
    >>> fog = render.Homogeneous([0, 0, 0], [1, 1, 1], density=2.0)
    >>> problem = TransmittanceProblem.of(fog, [[-1, 0.5, 0.5]], [[1, 0, 0]], 10.0)
    >>> problem.reference().round(6).tolist()
    [[0.135335]]
    """

    medium: Medium
    rays: Rays
    rows: Tensor
    everything: bool = False

    name = "transmittance"
    dim = 1
    schema = Schema(
        (
            Feature("t", "scalar"),
            Feature("u_geo", "scalar"),
            Feature("u_fbm", "scalar"),
            Feature("slope", "scalar"),
            Feature("bend", "scalar"),
            Feature("optical_length", "scalar"),
            Feature("length", "scalar"),
            Feature("noise", "scalar", 5),
        )
    )

    @classmethod
    def of(
        cls,
        volume: Volume | Sequence[Volume],
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike,
        *,
        support: str = "bounds",
        everything: bool = False,
    ) -> TransmittanceProblem:
        """The problem for m rays through a volume, or through each of several.

        Parameters
        ----------
        volume : Volume or sequence of Volume
            Several must be of one kind; each sees all rays, volume after volume.
        origins, directions : (m, 3) array_like
            Where rays start and go; directions of any length but zero.
        t_max : float or (m,) array_like
            Length of the rays, >= 0; infinity for all of the volume.
        support : {"bounds", "pieces"}
            What the integral is over: the ray inside the volume's box, or only where parts of the shape can reach it.
        everything : bool
            See the class.

        Raises
        ------
        ValueError, TypeError
            If an argument is of the wrong kind, shape or range.
        """
        volumes = (volume,) if isinstance(volume, Volume) else tuple(volume)
        medium = Medium.of(volumes, everything)
        check.choice("support", support, ("bounds", "pieces"))
        line = geometry.checked(origins, directions, t_max)
        rays = Rays.through(volumes, *line, "ray" if everything and support == "bounds" else support)
        return cls(medium, rays, torch.arange(rays.batch), everything)

    @classmethod
    def family(
        cls, n: int, seed: int = 0, split: str = "test", resolution: int = 32, support: str = "bounds"
    ) -> TransmittanceProblem:
        """n random clouds of Fig. 40, each seen through a grid of parallel rays.

        Parameters
        ----------
        n : int
            Number of volumes.
        seed, split
            Which volumes, see `nqr_geom.render.volume_families.volumes`.
        resolution : int
            Rays per side.
        support
            As for `of`.
        """
        from nqr_geom.render.volume_families import view, volumes

        made = volumes(n, seed=seed, split=split)
        medium = Medium.of(made)
        rays = Rays.joined([Rays.through([volume], *view(volume, resolution), support) for volume in made])
        return cls(medium, rays, torch.arange(rays.batch))

    @property
    def groups(self) -> NDArray[np.int64]:
        return self.rays.volume.cpu().numpy().astype(np.int64)

    @property
    def effects(self) -> frozenset[str]:
        return self.medium.effects

    def evaluate(self, x: Tensor) -> Observation:
        from nqr_geom.render.kernels_march import observe

        value, told, seen = observe(self.medium, self.rays, x[..., 0], self.everything)
        features = {name: told[..., None, k : k + 1] for k, name in enumerate(_FEATURES)}
        volume = self.rays.volume.long()

        def of_row(numbers: Tensor) -> Tensor:
            """What is the same for all samples of a ray, (B, size) to (B, N, 1, size)."""
            return numbers[:, None, None].expand(*x.shape[:2], 1, numbers.shape[1])

        features["length"] = of_row(self.rays.total[:, None])
        features["optical_length"] = of_row((self.rays.total * self.medium.tensors["density"][volume])[:, None])
        features["noise"] = of_row(self.medium.constants[volume])
        return Observation(value[:, :, None, None], features, queries=self._marched * x.shape[1], work=self._work(seen))

    @property
    def _marched(self) -> int:
        """Rays that are marched."""
        return self.batch if self.everything else int((self.rays.total > 0.0).sum())

    def _work(self, seen: Tensor) -> dict[str, int]:
        """Noise evaluations, where there is noise at all."""
        return {"noise": int(seen.sum())} if self.medium.noisy else {}

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        """Plain means of random, stratified and uniformly jittered queries."""
        if type(rule) is not MonteCarlo or type(sampler) not in (Random, Stratified, UniformJitter):
            return None
        design: str = sampler.name  # type: ignore[attr-defined]

        def whole(stream: Stream) -> Whole:
            from nqr_geom.render.kernels_march import mean

            out, seen = mean(self.medium, self.rays, self.rows, stream.key, n, design, self.everything)
            spread = out[:, 1:] if type(sampler) is Random and n > 1 else None
            nowhere = torch.zeros(self.batch, dtype=torch.bool, device=self.rows.device)
            return Whole(out[:, :1], nowhere, self._marched * n, spread, ExpLink(), self._work(seen))

        return whole

    def finalize(self, samples: Samples) -> tuple[Samples, Link]:
        return samples, ExpLink()

    def to(self, device: torch.device | str) -> TransmittanceProblem:
        """The same integrals on another device."""
        return replace(self, medium=self.medium.to(device), rays=self.rays.to(device), rows=self.rows.to(device))

    def take(self, index: slice | Tensor) -> TransmittanceProblem:
        return replace(self, rays=self.rays.take(index), rows=self.rows[index])

    def closed_depth(self) -> NDArray[np.float64]:
        """Optical depths (B, 1) of rays through homogeneous media; 0 where there is no medium."""
        if self.medium.kind != Homogeneous.kind:
            return np.zeros((self.batch, 1))
        density = self.medium.tensors["density"][self.rays.volume.long()]
        return (density * self.rays.total)[:, None].cpu().numpy()

    def reference(self) -> NDArray[np.float64]:
        """True answers (B, 1): closed form in homogeneous media, else unbiased marches with 2048 queries on average.

        The error of these is some 1e-6 on the random clouds (`benchmarks/transmittance.py` measures it).
        """
        if self.medium.kind == Homogeneous.kind and not self.medium.noisy:
            return np.exp(-self.closed_depth())
        from nqr_geom.integrator.estimate import tiles
        from nqr_geom.render.unbiased import march

        stream = Stream(0, "validation", "reference")
        parts = [march(self.take(tile), 2048, stream).value for tile in tiles(self.batch, 4096)]
        return torch.cat([*parts, self.rays.total[:0]])[:, None].cpu().numpy()
