"""What is known of direct light before a ray is traced: the radiance of lights that nothing hides, and their choice."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from nqr_geom._warp import array, launch, wp
from nqr_geom.integrator.problem import Whole
from nqr_geom.integrator.samplers import Pmj, Random
from nqr_geom.keyed_warp import unsigned
from nqr_geom.render import kernels_bsdf, kernels_known
from nqr_geom.render.kernels_gloss import gauss_points
from nqr_geom.render.kernels_numbers import numbers
from nqr_geom.render.world import rows_of
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.render.direct_problem import DirectProblem

__all__ = ["Room", "compiled", "design", "in_kernels", "known", "room", "spans"]

_LEAST = 8  # rays of slopes; others follow the root of the number of passes


def _points(n: int) -> Any:
    """Gauss's rule for n passes, points and weights."""
    return array(gauss_points(max(_LEAST, 2 * math.isqrt(n))), wp.vec2d)


def _most_lights(problem: DirectProblem) -> int:
    return max(1, max(len(scene.lights) for scene in problem.world.scenes))


def known(problem: DirectProblem, n: int) -> Tensor:
    """Radiance that each light would send to the viewer by one reflection if nothing hid it.

    Closed form on diffuse surfaces; elsewhere by quadrature over the slopes of microfacets, see `kernels_gloss`.

    Parameters
    ----------
    problem : DirectProblem
        B pixels.
    n : int
        Passes that it stands beside: with more of them it is more accurate.

    Returns
    -------
    Tensor, (B, L, 3), float64
        In the order of the scene's lights, L the most of any scene; 0 behind the last one.
    """
    radiance = np.zeros((problem.batch, _most_lights(problem), 3))
    surfaces = rows_of(kernels_bsdf.Surface, problem.surfaces)
    arguments = [problem.world.struct, surfaces, _points(n), array(radiance, wp.vec3d)]
    launch(kernels_known.known(problem.variant[1]), problem.batch, arguments)
    return torch.from_numpy(radiance)


def spans(problem: DirectProblem) -> Tensor:
    """Lower end and length of the part of axis 3 that chooses each light, (B, L, 2) as for `known`."""
    span = np.zeros((problem.batch, _most_lights(problem), 2))
    surfaces = rows_of(kernels_bsdf.Surface, problem.surfaces)
    launch(kernels_known.spans, problem.batch, [problem.world.struct, surfaces, array(span, wp.vec2d)])
    return torch.from_numpy(span)


class Room(NamedTuple):
    """The first arguments of kernels that keep passes: what they see, and what they fill in."""

    world: Any
    surfaces: Any
    rows: Any
    points: Any  # Gauss's rule
    known: Any  # (B, L)
    lamps: Any  # (B, L)
    records: Any  # (B, n, 2)


def room(problem: DirectProblem, n: int) -> Room:
    """Room for n passes of every pixel."""
    from nqr_geom.render.kernels_lamps import Lamp, Record

    most = _most_lights(problem)
    return Room(
        problem.world.struct,
        rows_of(kernels_bsdf.Surface, problem.surfaces),
        array(np.ascontiguousarray(problem.rows.cpu().numpy()), wp.int64),
        _points(n),
        array(np.zeros((problem.batch, most, 3)), wp.vec3d),
        wp.zeros((problem.batch, most), dtype=Lamp, device="cpu"),
        wp.empty((problem.batch, n, 2), dtype=Record, device="cpu"),
    )


def in_kernels(sampler: object) -> bool:
    """Whether `design` knows a sampler."""
    from nqr_geom.render.direct_sampler import LampSpread

    return type(sampler) in (Random, Pmj, LampSpread)


def design(problem: DirectProblem, sampler: object, n: int, stream: Stream) -> list[Any]:
    """The next arguments: what places n passes by "random", "pmj" or "lamp-spread"."""
    from nqr_geom.render.direct_sampler import LampSpread
    from nqr_geom.render.kernels_lamps import Rounds

    rounds = Rounds()
    if isinstance(sampler, LampSpread):
        rounds.early, rounds.even = sampler.early(n), sampler.even
        starts = [stream.child(f"round {done}").key for done in (0, rounds.early)]
        rounds.start_0, rounds.start_1 = map(unsigned, starts)
        lamps = stream.child("lamps")
        rounds.key, rounds.scramble = unsigned(lamps.key), unsigned(lamps.child("scramble").key)
    return [numbers(stream, problem.batch, n, pmj=not isinstance(sampler, Random)), rounds, n]


def compiled(problem: DirectProblem, sampler: object, n: int) -> Callable[[Stream], Whole] | None:
    """One pass of `direct-known` over the points of "random", "pmj" or "lamp-spread"; None for those of others."""
    from nqr_geom.render.direct_sampler import LampSpread
    from nqr_geom.render.kernels_lamps import kernel

    if not in_kernels(sampler):
        return None

    def whole(stream: Stream) -> Whole:
        mean, traced = np.zeros((problem.batch, 3)), np.zeros((problem.batch, 3), np.int32)
        placed = [*room(problem, n), *design(problem, sampler, n, stream)]
        results = [array(mean, wp.vec3d), array(traced, wp.int32)]
        launch(kernel(True, isinstance(sampler, LampSpread), *problem.variant), problem.batch, placed + results)
        problem.count(traced)
        fallback = torch.zeros(problem.batch, dtype=torch.bool)
        return Whole(torch.from_numpy(mean), fallback, 2 * problem.batch * n, None)

    return whole
