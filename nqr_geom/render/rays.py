"""Rays through volumes, cut to the stretches where there can be density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from nqr_geom import check
from nqr_geom.render.volume import Volume

__all__ = ["SUPPORTS", "Rays", "slab", "stretches"]

Floats = NDArray[np.float64]

SUPPORTS = ("bounds", "pieces", "ray")


def _lengths(t_max: ArrayLike, m: int) -> Floats:
    """Lengths (m,) >= 0 of one number or (m,); infinity is a ray without end."""
    given = np.asarray(t_max)
    lengths = check.array("t_max", given, () if given.ndim == 0 else (m,), finite=False)
    if not (lengths >= 0.0).all():  # NaN too
        bad = np.atleast_1d(lengths)[~(np.atleast_1d(lengths) >= 0.0)][0]
        raise ValueError(f"t_max: expected lengths >= 0, got {bad}")
    return np.broadcast_to(lengths, (m,))


def checked(origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Origins (m, 3), unit directions (m, 3) and lengths (m,), or an error that names the argument."""
    starts = check.array("origins", origins, ("m", 3))
    ways = check.array("directions", directions, (len(starts), 3))
    largest = np.abs(ways).max(axis=1, keepdims=True, initial=0.0)
    if not (largest > 0.0).all():
        raise ValueError(f"directions: expected none of zero length, got one at index {int(np.argmin(largest))}")
    ways = ways / largest  # squares of 1e200 would overflow
    return starts, ways / np.linalg.norm(ways, axis=1, keepdims=True), _lengths(t_max, len(starts))


def slab(origins: Floats, directions: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Distances (m,) at which lines enter and leave the box [0, size]; the end comes first where they miss it."""
    flat = directions == 0.0
    safe = np.where(flat, 1.0, directions)
    with np.errstate(over="ignore"):  # nearly parallel to a face: it is met at infinity
        ends = np.sort(np.stack([-origins / safe, (size - origins) / safe]), axis=0)
    inside = (origins >= 0.0) & (origins <= size)
    near = np.where(flat, np.where(inside, -np.inf, np.inf), ends[0]).max(axis=1)
    far = np.where(flat, np.where(inside, np.inf, -np.inf), ends[1]).min(axis=1)
    return near, far


def stretches(near: Floats, far: Floats, starts: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """The union of intervals (m, k), cut to [near, far], as starts and lengths (m, k) of disjoint ones in order."""
    order = np.argsort(starts, axis=1)
    begin = np.take_along_axis(np.maximum(starts, near[:, None]), order, axis=1)
    end = np.take_along_axis(np.minimum(ends, far[:, None]), order, axis=1)
    covered = np.maximum.accumulate(end, axis=1)
    begin[:, 1:] = np.maximum(begin[:, 1:], covered[:, :-1])
    length = np.where(end > begin, end - begin, 0.0)
    return np.where(length > 0.0, begin, near[:, None]), length


@dataclass(frozen=True)
class Rays:
    """B rays, each through one volume; lengths along a ray are from where it enters the box.

    Parameters
    ----------
    entry, direction : Tensor, (B, 3)
        Where the ray enters, relative to the box's low corner, and its unit direction.
    near : Tensor, (B,)
        Distance from the ray's origin to the entry.
    volume : Tensor, (B,), int32
        Which volume it goes through.
    start, length : Tensor, (B, K)
        Disjoint stretches in order; those of no length are not there.
    total : Tensor, (B,)
        Sum of the lengths; zero where there is nothing to march through.
    """

    entry: Tensor
    direction: Tensor
    near: Tensor
    volume: Tensor
    start: Tensor
    length: Tensor
    total: Tensor

    @classmethod
    def through(
        cls, volumes: Sequence[Volume], origins: Floats, directions: Floats, t_max: Floats, support: str
    ) -> Rays:
        """The same m rays (unit directions) through each volume, volume after volume.

        Parameters
        ----------
        volumes : sequence of Volume
            At least one.
        origins, directions, t_max : (m, 3), (m, 3) and (m,) float64
            As `checked` gives them.
        support : {"bounds", "pieces", "ray"}
            Which part of a ray the integral is over: within the box; within what parts of the shape and their noise can
            reach; or all of its length inside the box, even where the volume has no density at all.
        """
        check.choice("support", support, SUPPORTS)
        return cls.joined([cls._one(v, origins, directions, t_max, support) for v in volumes])

    @classmethod
    def joined(cls, made: Sequence[Rays]) -> Rays:
        """Rays through one volume each, one volume after the other."""
        widest = max(rays.start.shape[1] for rays in made)

        def widened(tensor: Tensor) -> Tensor:
            return torch.nn.functional.pad(tensor, (0, widest - tensor.shape[1])) if tensor.ndim == 2 else tensor

        joined = {}
        for field in fields(cls):
            parts = [getattr(rays, field.name) for rays in made]
            if field.name == "volume":
                parts = [torch.full_like(part, k) for k, part in enumerate(parts)]
            joined[field.name] = torch.cat([widened(p) if field.name in ("start", "length") else p for p in parts])
        return cls(**joined)

    @classmethod
    def _one(cls, volume: Volume, origins: Floats, directions: Floats, t_max: Floats, support: str) -> Rays:
        low, high = volume.bounds
        offset = origins - low
        near, far = slab(offset, directions, high - low)
        near, far = np.maximum(near, 0.0), np.minimum(far, t_max)
        hit = far > near
        near = np.where(hit, near, 0.0)
        entry = np.clip(offset + near[:, None] * directions, 0.0, high - low)  # far origins round
        far = np.where(hit, far - near, 0.0)
        if volume.majorant == 0.0 and support != "ray":
            far = np.zeros_like(far)
        nowhere = np.zeros_like(far)
        starts, ends = volume.chords(entry, directions) if support == "pieces" else (nowhere[:, None], far[:, None])
        start, length = stretches(nowhere, far, starts, ends)
        tensors = (entry, directions, near, np.zeros(len(near), np.int32), start, length, length.sum(axis=1))
        return cls(*(torch.from_numpy(np.ascontiguousarray(a)) for a in tensors))

    @property
    def batch(self) -> int:
        """Number of rays, B."""
        return self.near.shape[0]

    def take(self, index: slice | Tensor) -> Rays:
        """Some of the rays."""
        return Rays(*(getattr(self, field.name)[index].contiguous() for field in fields(self)))

    def to(self, device: torch.device | str) -> Rays:
        """The same rays on another device."""
        return Rays(*(getattr(self, field.name).to(device) for field in fields(self)))

    @cached_property
    def packed(self) -> Any:
        """The rays as kernels take them."""
        from nqr_geom._warp import array, wp
        from nqr_geom.render.kernels_march import Rays as Packed

        types = {"entry": wp.vec3d, "direction": wp.vec3d, "volume": wp.int32}
        struct = Packed()
        for field in fields(self):
            setattr(struct, field.name, array(getattr(self, field.name), types.get(field.name, wp.float64)))
        return struct
