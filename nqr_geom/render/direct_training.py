"""Pixels of the random rooms of Fig. 39 with accurate answers, in batches: what networks for direct light learn from.

Rooms take a while to build and answers to compute, so a fixed number of rooms is seen through random points of all
pixels, and asked again and again with fresh passes; the answers are kept on disk. Rooms of the three splits have
nothing in common.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from nqr_geom.files import cache_folder
from nqr_geom.integrator.learn.recipe import Batch

if TYPE_CHECKING:  # its kernels load Warp, which a recipe can do without
    from nqr_geom.render.direct_problem import DirectProblem

__all__ = ["Pool", "direct_batch", "doubtful_batch", "pool"]

ROOMS = {"train": 480, "validation": 24, "test": 24}
RESOLUTION = 16  # pixels along each side, as in the paper
PASSES, RUNS = 256, 4  # of an answer
_TRIED, _MOST = 8, 30.0  # runs that tell how doubtful a pixel is, and the largest weight over the mean


@dataclass(frozen=True, eq=False)
class Pool:
    """Pixels with their answers.

    Attributes
    ----------
    problem : DirectProblem
        All pixels, room after room.
    answer : Tensor, (B, 3), float64
        Radiance.
    lit : Tensor, (M,), int64
        Those that any light reaches.
    """

    problem: DirectProblem
    answer: Tensor
    lit: Tensor


def _answers(problem: DirectProblem, seed: int, split: str) -> np.ndarray:
    """Means of some structured runs: of as many passes the balance heuristic's errors are those of the rule at 16."""
    from nqr_geom.integrator.estimate import run
    from nqr_geom.render.direct_rules import KnownLight
    from nqr_geom.render.direct_sampler import LampSpread

    def answers() -> np.ndarray:
        return run(problem, LampSpread(), KnownLight(), PASSES, replicates=RUNS, seed=2**31 - 2, split=split).value

    return _kept(problem, f"{split}-{seed}-slopes-{PASSES}x{RUNS}", answers)


def _kept(problem: DirectProblem, name: str, make: Callable[[], np.ndarray]) -> np.ndarray:
    """What `make` gives for a problem, kept on disk."""
    surfaces = hashlib.sha256(problem.surfaces.tobytes()).hexdigest()[:16]
    path = cache_folder() / "direct" / f"{name}-{surfaces}.npy"
    if path.exists():
        kept: np.ndarray = np.load(path)
        return kept
    made = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f"{path.stem}.{os.getpid()}.npy")
    np.save(aside, made)
    aside.replace(path)  # there in full or not at all
    return made


@lru_cache(maxsize=3)
def pool(split: str, seed: int) -> Pool:
    """The rooms of a split; answers that are not on disk are computed first."""
    from nqr_geom.render.direct_problem import DirectProblem

    problem = DirectProblem.family(ROOMS[split], seed, split, RESOLUTION)
    answer = torch.from_numpy(_answers(problem, seed, split))
    return Pool(problem, answer, (answer > 0.0).any(dim=1).nonzero()[:, 0])


def direct_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Direct light at a pixel for each of `rows` (B,), spread over all rooms of the split.

    In training only pixels that light reaches: on the others every rule is right.
    """
    everything = pool(split, seed)
    pixels = everything.lit if split == "train" else torch.arange(len(everything.answer))
    # A step that is prime to any number of pixels goes through all of them before it meets one again.
    index = pixels[(rows.cpu() * 999_983) % len(pixels)]
    problem = replace(everything.problem.take(index), rows=rows.cpu())
    device = rows.device
    return Batch(problem, everything.answer[index].to(device))


@lru_cache(maxsize=3)
def doubts(split: str, seed: int) -> Tensor:
    """Root mean square error of `direct-known` at 16 stratified passes by some runs, (B,), for every pixel."""
    from nqr_geom.integrator.estimate import run
    from nqr_geom.integrator.samplers import Pmj
    from nqr_geom.render.direct_rules import KnownLight

    everything = pool(split, seed)

    def errors() -> np.ndarray:
        total = np.zeros(len(everything.answer))
        for k in range(_TRIED):
            value = run(everything.problem, Pmj(), KnownLight(), 16, seed=2**31 - 3 - k, split=split).value
            total += ((value - everything.answer.numpy()) ** 2).mean(axis=1)
        made: np.ndarray = np.sqrt(total / _TRIED)
        return made

    return torch.from_numpy(_kept(everything.problem, f"{split}-{seed}-slopes-doubt-{_TRIED}", errors))


@lru_cache(maxsize=3)
def _by_doubt(seed: int) -> tuple[Tensor, Tensor]:
    """How often each training pixel is drawn, (M,), and its sums: three quarters go by doubt, the rest evenly."""
    lit = pool("train", seed).lit
    doubt = doubts("train", seed)[lit]
    weight = doubt.clamp_max(_MOST * doubt.mean().clamp_min(1e-300))
    share = 0.75 * weight / weight.sum().clamp_min(1e-300) + 0.25 / len(lit)
    share = share / share.sum()
    return share, share.cumsum(dim=0)


def doubtful_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Direct light as of `direct_batch`, in training mostly where `direct-known` errs at 16 passes, with weights."""
    if split != "train":
        return direct_batch(rows, seed, split)
    everything = pool(split, seed)
    # Multiples of the golden section fill the unit interval evenly.
    place = torch.remainder((rows.cpu().double() + 0.5) * 0.6180339887498949, 1.0)
    share, ends = _by_doubt(seed)
    at = torch.searchsorted(ends, place).clamp_max(len(everything.lit) - 1)
    index, weight = everything.lit[at], 1.0 / (len(share) * share[at])
    problem = replace(everything.problem.take(index), rows=rows.cpu())
    return Batch(problem, everything.answer[index].to(rows.device), weight.to(rows.device))
