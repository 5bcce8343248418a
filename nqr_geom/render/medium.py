"""Volumes packed for the kernels: several of one kind side by side, on any device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.render.volume import PART, Grid, Homogeneous, Noise, Volume

__all__ = ["Medium"]

Floats = NDArray[np.float64]


def _kind(volumes: Sequence[Volume]) -> tuple[str, bool]:
    """Which kernel serves all of these volumes, and whether it needs noise."""
    effects = frozenset[str]().union(*(volume.effects() for volume in volumes))
    kinds = sorted(effects - {"noise"}) or [Homogeneous.kind]  # of nothing at all any kernel gives zero
    if kinds == sorted({Grid.kind, Homogeneous.kind}):
        kinds = [Grid.kind] if all(isinstance(v, Grid) or v.majorant == 0.0 for v in volumes) else kinds
    if len(kinds) > 1:
        raise ValueError(f"volume: expected volumes of one kind, got {' and '.join(kinds)}")
    return kinds[0], "noise" in effects


@dataclass(frozen=True)
class Medium:
    """S volumes of one kind.

    Parameters
    ----------
    kind : str
        Which geometry the kernels are built for.
    noisy : bool
        Whether they evaluate noise.
    tensors : dict of str to Tensor
        The fields of `kernels_density.Packed`, on one device.
    """

    kind: str
    noisy: bool
    tensors: dict[str, Tensor]

    @classmethod
    def of(cls, volumes: Sequence[Volume], everything: bool = False) -> Medium:
        """Pack volumes.

        Parameters
        ----------
        volumes : sequence of Volume
            At least one; those with density all of one kind.
        everything : bool
            Build for their classes and for noise, even where the data call for less; for measuring what that saves.

        Raises
        ------
        ValueError
            If the volumes are of several kinds.
        TypeError
            If one is not a Volume.
        """
        for volume in volumes:
            if not isinstance(volume, Volume):
                raise TypeError(f"volume: expected a Volume, such as Homogeneous(low, high), got {volume!r}")
        if not volumes:
            raise ValueError("volume: expected at least one, got none")
        kind, noisy = (volumes[0].kind, True) if everything else _kind(volumes)
        fitting = [v if v.kind == kind or kind == Homogeneous.kind else None for v in volumes]
        parts = [np.zeros((1, PART)) if v is None or v.kind != kind else v.parts() for v in fitting]
        grids = [np.zeros((1, 1, 1)) if v is None or v.kind != kind else v.values() for v in fitting]
        packed = np.zeros((len(volumes), max(map(len, parts)), PART))
        for k, part in enumerate(parts):
            packed[k, : len(part)] = part
        noises = [v.noise for v in volumes]
        numbers = [(n.amplitude, n.frequency, n.gain, n.lacunarity, n.bound) if n else (0.0,) * 5 for n in noises]
        always = np.full((len(volumes), 1), float(everything))
        arrays: dict[str, NDArray[Any]] = {
            "size": np.stack([v.high - v.low for v in volumes]),
            "density": np.array([v.majorant for v in volumes]),
            "parts": packed,
            "count": np.array([len(part) for part in parts], np.int32),
            "values": np.concatenate([grid.ravel() for grid in grids]),
            "offset": np.cumsum([0] + [grid.size for grid in grids[:-1]]).astype(np.int64),
            "nodes": np.array([grid.shape for grid in grids], np.int32),
            "noise": np.concatenate([np.array(numbers), always], axis=1),
            "octaves": np.array([(n.octaves, n.seed) if n else (Noise.octaves, 0) for n in noises], np.int32),
        }
        return cls(kind, noisy, {name: torch.from_numpy(np.ascontiguousarray(a)) for name, a in arrays.items()})

    @property
    def device(self) -> torch.device:
        """Where the tensors lie."""
        return self.tensors["size"].device

    @property
    def effects(self) -> frozenset[str]:
        """What the kernels are built for; nothing where there is no density."""
        if not bool((self.tensors["density"] > 0.0).any()):
            return frozenset()
        return frozenset({self.kind, "noise"} if self.noisy else {self.kind})

    @property
    def name(self) -> str:
        """Of the kernel variant, as reports give it."""
        return f"{self.kind}+noise" if self.noisy else self.kind

    @cached_property
    def constants(self) -> Tensor:
        """Amplitude, frequency, octaves, gain and lacunarity of each volume's noise, (S, 5) float64."""
        noise = self.tensors["noise"]
        return torch.cat([noise[:, :2], self.tensors["octaves"][:, :1].double(), noise[:, 2:4]], dim=1)

    @cached_property
    def packed(self) -> Any:
        """The volumes as kernels take them."""
        from nqr_geom._warp import array, wp
        from nqr_geom.render.kernels_density import Packed

        types = {
            "size": wp.vec3d, "count": wp.int32, "offset": wp.int64, "nodes": wp.int32, "octaves": wp.int32
        }  # fmt: skip
        struct = Packed()
        for name, tensor in self.tensors.items():
            setattr(struct, name, array(tensor, types.get(name, wp.float64)))
        return struct

    def to(self, device: torch.device | str) -> Medium:
        """The same volumes on another device."""
        return Medium(self.kind, self.noisy, {name: tensor.to(device) for name, tensor in self.tensors.items()})

    def components(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Density, u_geo and u_fBm of the first volume at points (m, 3), which are relative to its box."""
        from nqr_geom.render.kernels_march import observe
        from nqr_geom.render.rays import Rays

        # A point is a ray that goes nowhere and has length 1.
        m = len(points)
        entry, nowhere, one = torch.from_numpy(points.copy()), torch.zeros(m, 1).double(), torch.ones(m, 1).double()
        volume = torch.zeros(m, dtype=torch.int32)
        rays = Rays(entry, torch.zeros_like(entry), nowhere[:, 0], volume, nowhere, one, one[:, 0])
        value, features, _ = observe(self, rays, nowhere)
        inside = ((entry >= 0.0) & (entry <= self.tensors["size"][0])).all(dim=1)
        density = torch.where(inside, value[:, 0], 0.0)
        return density.numpy(), features[:, 0, 1].numpy().copy(), features[:, 0, 2].numpy().copy()
