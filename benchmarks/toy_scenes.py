"""Toy integrands that several benchmarks share, and samples with some of their information taken away."""

from __future__ import annotations

from dataclasses import replace

import torch

from nqr_geom.integrator.problem import Samples
from nqr_geom.streams import Stream
from nqr_geom.toy.family import draw
from nqr_geom.toy.problem import ToyProblem

SCENES = 5
SEED = 0


def scenes(runs: int, scene: int | None = None) -> ToyProblem:
    """The first five held-out integrands, or one of them, `runs` times each: every copy draws its own samples."""
    chosen = torch.arange(SCENES) if scene is None else torch.tensor([scene])
    pieces = draw(chosen, Stream(SEED, "test", "toy")).take(torch.arange(len(chosen)).repeat_interleave(runs))
    first = 0 if scene is None else scene * runs
    return ToyProblem(torch.arange(first, first + len(chosen) * runs), SEED, "test", pieces)


def blinded(samples: Samples) -> Samples:
    """The same samples with nothing but x and f: derivative and piece index are zero."""
    features = {name: torch.zeros_like(tensor) for name, tensor in samples.seen.features.items()}
    return replace(samples, seen=replace(samples.seen, features=features))
