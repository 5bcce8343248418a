"""Rays through the random clouds of Fig. 40 with accurate answers, in batches: what networks learn from.

Every integral has its own cloud and its own ray. Equal steps that are fine against the noise tell the depth to a
hundredth of what a network can hope for (`tests/unit/test_learn_transmittance.py` measures it), so that the bias of
their exponential is not seen.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.samplers import UniformJitter
from nqr_geom.integrator.sums import row_mean
from nqr_geom.render.clouds import Spheres, through_balls
from nqr_geom.render.medium import Medium
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.rays import Rays, slab, stretches
from nqr_geom.render.volume import Noise
from nqr_geom.render.volume_families import SIDE, CloudFamily, balls
from nqr_geom.streams import Stream

__all__ = ["transmittance_batch"]

Floats = NDArray[np.float64]

QUERIES = 128  # of an answer; the paper's number
_OTHER = 4  # of so many training integrals one has other constants and one only the stretches that can hold density
_TRIES = 3  # most rays miss all balls: of so many the first that does not
# Ranges of the constants that are not the family's, all but the last three log-uniform.
_DENSITY, _AMPLITUDE, _FREQUENCY = (0.25, 4.0), (0.25, 2.0), (0.5, 2.0)
_OCTAVES, _GAIN, _LACUNARITY = (3, 7), (0.35, 0.65), (1.8, 2.2)


def _between(ends: tuple[float, float], u: Floats, log: bool = False) -> Floats:
    low, high = ends
    return low * (high / low) ** u if log else low + (high - low) * u


def _constants(rows: NDArray[np.int64], stream: Stream, other: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Densities (m,), and amplitude, frequency, octaves, gain and lacunarity of the noise (m, 5)."""
    u = stream.uniform(rows[:, None], np.arange(6)).T
    usual = CloudFamily().noise
    drawn = [
        _between(_DENSITY, u[0], True),
        _between(_AMPLITUDE, u[1], True),
        _between(_FREQUENCY, u[2], True),
        np.floor(_between((_OCTAVES[0], _OCTAVES[1] + 1), u[3])),
        _between(_GAIN, u[4]),
        _between(_LACUNARITY, u[5]),
    ]
    family = (1.0, usual.amplitude, usual.frequency, usual.octaves, usual.gain, usual.lacunarity)
    numbers = np.where(other[:, None], np.stack(drawn, axis=1), np.array(family, dtype=float))
    return numbers[:, 0], numbers[:, 1:]


def _medium(centers: Floats, radii: Floats, seeds: NDArray[np.int64], density: Floats, noise: Floats) -> Medium:
    """m clouds with constants of their own, packed as `Medium.of` packs one."""
    one = Medium.of([Spheres(centers[0], radii[0], [0.0] * 3, [SIDE] * 3, noise=Noise())])
    many = {name: tensor.expand(len(radii), *tensor.shape[1:]).clone() for name, tensor in one.tensors.items()}
    amplitude, frequency, octaves, gain, lacunarity = noise.T
    # An octave reaches as far as the first, times its gain.
    bound = Noise(octaves=1).bound * amplitude * (1.0 - gain**octaves) / (1.0 - gain)
    many["density"] = torch.from_numpy(density)
    many["parts"][:, :, :3], many["parts"][:, :, 3] = torch.from_numpy(centers), torch.from_numpy(radii)
    many["noise"][:, :5] = torch.from_numpy(np.stack([amplitude, frequency, gain, lacunarity, bound], axis=1))
    many["octaves"][:] = torch.from_numpy(np.stack([octaves, seeds], axis=1))
    return Medium(one.kind, one.noisy, many)


def _lines(
    rows: NDArray[np.int64], stream: Stream, slanted: NDArray[np.bool_], tries: int
) -> tuple[Floats, Floats, Floats]:
    """Entries and directions (m, tries, 3) and lengths (m, tries) of rays: along z, or through two uniform points."""
    u = SIDE * stream.uniform(rows[:, None, None], np.arange(tries)[:, None], np.arange(6)).reshape(-1, 6)
    slanted = np.repeat(slanted, tries)[:, None]
    start = np.where(slanted, u[:, :3], u[:, :3] * [1.0, 1.0, 0.0])
    way = np.where(slanted, u[:, 3:] - u[:, :3], [0.0, 0.0, 1.0])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    near, far = slab(start, way, np.full(3, SIDE))
    entry = np.clip(start + near[:, None] * way, 0.0, SIDE)
    shape = (len(rows), tries)
    return entry.reshape(*shape, 3), way.reshape(*shape, 3), (far - near).reshape(shape)


def _rays(centers: Floats, reach: Floats, lines: tuple[Floats, Floats, Floats], pieces: NDArray[np.bool_]) -> Rays:
    """The first line of each row (m, tries) that meets a ball of radius `reach` (m, 16), or the last.

    Where `pieces` (m,) says so, the integral is over the stretches within balls, if there are any.
    """
    tries = lines[0].shape[1]
    entry, way, length = (part.reshape(-1, *part.shape[2:]) for part in lines)
    offset = np.repeat(centers, tries, axis=0) - entry[:, None]
    starts, ends = through_balls(offset, way, np.repeat(reach, tries, axis=0))
    start, parts = stretches(np.zeros_like(length), length, starts, ends)
    hits = (parts.sum(axis=1) > 0.0).reshape(-1, tries)
    chosen = np.where(hits.any(axis=1), hits.argmax(axis=1), tries - 1) + tries * np.arange(len(hits))
    entry, way, length, start, parts = (part[chosen] for part in (entry, way, length, start, parts))
    first = np.arange(parts.shape[1]) == 0
    whole = ~(pieces & (parts.sum(axis=1) > 0.0))[:, None]
    start = np.where(whole, 0.0, start)
    parts = np.where(whole, np.where(first, length[:, None], 0.0), parts)
    tensors = (entry, way, np.zeros(len(way)), np.arange(len(way), dtype=np.int32), start, parts, parts.sum(axis=1))
    return Rays(*(torch.from_numpy(np.ascontiguousarray(part)) for part in tensors))


def transmittance_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Transmittances through random clouds, one cloud and one ray along z for each of `rows` (B,).

    Of the training integrals one in four has another density, noise and direction, and one in four is over the
    stretches that balls and noise can reach; where a ray misses them, up to two others are tried. Validation and test
    are the paper's.
    """
    index = rows.cpu().numpy()
    stream = Stream(seed, split, "rays")
    varied = np.full(len(index), split == "train")
    other, pieces = varied & (index % _OTHER == 0), varied & (index % _OTHER == 1)
    centers, radii, seeds = balls(index, seed, split, CloudFamily())
    density, noise = _constants(index, stream.child("constants"), other)
    medium = _medium(centers, radii, seeds, density, noise)
    reach = radii * np.sqrt(1.0 + medium.tensors["noise"][:, 4:5].numpy())
    lines = _lines(index, stream, other, _TRIES if split == "train" else 1)
    everywhere = np.ones_like(pieces)
    fine = TransmittanceProblem(medium, _rays(centers, reach, lines, everywhere), rows.cpu())
    x = UniformJitter().points(fine.rows, QUERIES, 1, stream.child("answers"))
    answer = torch.exp(-row_mean(fine.evaluate(x).value[:, :, 0]))
    problem = TransmittanceProblem(medium, _rays(centers, reach, lines, pieces), rows.cpu())
    device = rows.device
    return Batch(problem if device.type == "cpu" else problem.to(device), answer.to(device))
