"""The networks of direct light in compiled passes: samples, tokens and sums in kernels, matrix products in torch.

An integrator without attention reads what `kernels_tokens` writes; the sampler's rounds are those of `direct_rounds`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from nqr_geom._warp import array, launch, wp
from nqr_geom.integrator.learn.inet import INetConfig
from nqr_geom.integrator.learn.snet import LearnedSampler
from nqr_geom.integrator.learn.zoo import Model, mix
from nqr_geom.integrator.problem import Whole
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.render import direct_known, direct_rounds
from nqr_geom.render.direct_rules import KnownLight
from nqr_geom.render.direct_tokens import LAMP_TOKENS
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.render.direct_problem import DirectProblem

__all__ = ["compiled"]

_ROWS = 4096  # pixels whose tokens are at hand at once


def _is_student(rule: Model) -> bool:
    """Whether a model reads `LAMP_TOKENS` without attention and corrects the balance heuristic."""
    config = rule.card.config
    read, plain = config.tokens, INetConfig(config.tokens, layers=0, width=config.width, positive=True)
    alone = type(rule.learned.base) is BalanceHeuristic and type(rule.consistent) in (BalanceHeuristic, KnownLight)
    bare = not read.frequencies and not read.features and read.blind and read.unit is None
    return rule.learned.extra is LAMP_TOKENS and config == plain and alone and bare


def compiled(problem: DirectProblem, sampler: object, rule: Model, n: int) -> Callable[[Stream], Whole] | None:
    """A student's answers on the points of "random", "pmj", "lamp-spread" or a network; None for others.

    Parameters
    ----------
    problem : DirectProblem
        B pixels.
    sampler : Sampler
        Any.
    rule : Model
        Any. Where a student has no share its answer needs no network, and no pass of its own.
    n : int
        Passes.
    """
    placed = direct_known.in_kernels(sampler) or direct_rounds.in_kernels(sampler, n)
    share = rule.card.share(n)
    if not placed or not _is_student(rule) or share == 0.0:
        return None

    def whole(stream: Stream) -> Whole:
        parts = [
            _answers(problem.take(slice(start, start + _ROWS)), sampler, rule, n, stream)
            for start in range(0, problem.batch, _ROWS)
        ]
        learned, safe, inside, gave_way = (torch.cat(tensors) for tensors in zip(*parts, strict=True))
        value = mix(share * inside.double()[:, None], learned, safe)
        flags = ~inside | gave_way | (share < 0.5 * max(rule.card.shares))
        return Whole(value, flags, 2 * problem.batch * n)

    return whole


def _answers(
    problem: DirectProblem, sampler: object, rule: Model, n: int, stream: Stream
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What the network says of every pixel, what its consistent rule; what is in the box, and what gave way."""
    from nqr_geom.render.direct_sampler import LampSpread
    from nqr_geom.render.kernels_lamps import kernel
    from nqr_geom.render.kernels_tokens import Told, told, weighed

    batch = problem.batch
    room, traced = direct_known.room(problem, n), np.zeros((batch, 3), np.int32)
    if isinstance(sampler, LearnedSampler):
        direct_rounds.draw(problem, sampler.net, n, stream, room, traced)
    else:
        placed = [*room, *direct_known.design(problem, sampler, n, stream)]
        results = [array(np.empty((0, 3)), wp.vec3d), array(traced, wp.int32)]
        launch(kernel(False, isinstance(sampler, LampSpread), *problem.variant), batch, placed + results)
    problem.count(traced)
    tokens = torch.empty(batch, 2 * n, rule.card.config.tokens.width)
    steady = np.empty((batch, 3))
    # Under the balance heuristic, bounded by the unit, and the unit.
    values = [array(np.empty(shape), wp.vec3d) for shape in ((batch, 2 * n, 3), (batch, 2 * n, 3), (batch, 3))]
    inside, lights = np.empty(batch, np.bool_), wp.zeros(room.known.shape, dtype=Told, device="cpu")
    box = [wp.vec3d(*end) for end in rule.card.box]
    written = [array(tokens, wp.float32), *values, array(steady, wp.vec3d), array(inside, wp.bool)]
    launch(told, batch, [room.world, room.surfaces, n, room.known, room.records, lights, *box, *written])
    outputs = array(rule.learned.outputs(tokens), wp.float32)
    learned, plain, gave_way = np.empty((batch, 3)), np.empty((batch, 3)), np.zeros(batch, np.bool_)
    results = [array(learned, wp.vec3d), array(plain, wp.vec3d), array(gave_way, wp.bool)]
    launch(weighed, batch, [n, outputs, rule.card.config.growth, *values, *results])
    safe = steady if isinstance(rule.consistent, KnownLight) else plain
    return torch.from_numpy(learned), torch.from_numpy(safe), torch.from_numpy(inside), torch.from_numpy(gave_way)
