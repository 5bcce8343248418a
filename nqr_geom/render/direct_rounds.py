"""The rounds of direct light's sampling network: kernels place and read passes, torch turns that into densities."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom._warp import array, launch, wp
from nqr_geom.integrator.learn.heads import GridHead
from nqr_geom.integrator.learn.snet import COUNTS, TILE_ROWS, LearnedSampler, SNet
from nqr_geom.render.direct_known import Room
from nqr_geom.render.direct_slabs import SIGHT_TOKENS, SLABS, LampSlabs
from nqr_geom.render.kernels_numbers import numbers
from nqr_geom.render.kernels_rounds import CONTEXT, SIGHT, TABLE, begin, place
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.render.direct_problem import DirectProblem

__all__ = ["draw", "in_kernels"]


def in_kernels(sampler: object, n: int) -> bool:
    """Whether a sampler is a network whose rounds of n passes the kernels place."""
    if not isinstance(sampler, LearnedSampler) or sampler.problem not in ("", "direct") or n > sampler.most:
        return False
    net, config = sampler.net, sampler.net.config
    slabs = isinstance(net.head, GridHead) and net.head.slabs is LampSlabs and config.grid == ((SLABS,) * 3,) * 2
    spread = config.together > 1 and n % config.together != 1  # a round of one has numbers of another kind
    return slabs and spread and net.extra is SIGHT_TOKENS and config.techniques == 2


def draw(problem: DirectProblem, net: SNet, n: int, stream: Stream, room: Room, traced: NDArray[np.int32]) -> None:
    """Place n passes of every pixel, round after round.

    Parameters
    ----------
    problem : DirectProblem
        B pixels.
    net : SNet
        One whose rounds are placed `in_kernels`.
    n : int
        Passes.
    stream : Stream
        Of the random numbers.
    room : Room
        For the passes; known radiance, lamps and records are filled in.
    traced : ndarray, (B, 3), int32
        Rays and density queries so far, which are counted on.
    """
    seen = [room.world, room.surfaces]
    batch = problem.batch
    context = np.empty((batch, CONTEXT), np.float32)
    beside = torch.from_numpy(context)
    told = array(context, wp.float32)
    launch(begin(problem.variant[1]), batch, [*seen, room.points, room.known, room.lamps, told])
    read = torch.zeros(batch, n, net.trunk.embed_in.in_features)
    read[..., -1] = math.log(n / 32.0)
    read[:, 0, -COUNTS - CONTEXT : -COUNTS] = beside
    for first in range(0, n, net.config.together):
        count = min(net.config.together, n - first)
        later = first + count < n
        table = _tables(net, read[:, : first + 1], beside)
        sight = torch.empty(batch, 2 * count if later else 0, SIGHT)
        spread = numbers(stream.child(f"round {first}"), batch, count, pmj=True)
        given = [room.rows, spread, first, count, array(table, wp.float32), room.known, room.lamps, room.records]
        results = [told, array(sight, wp.float32), array(traced, wp.int32)]
        launch(place(*problem.variant), batch, [*seen, *given, *results])
        if later:
            new = read[:, first + 1 : first + 1 + count]
            new[..., : 2 * SIGHT] = sight.view(batch, count, 2 * SIGHT)
            new[..., -COUNTS - CONTEXT : -COUNTS] = beside[:, None]
            new[..., -COUNTS] = 1.0
            new[..., 1 - COUNTS] = torch.arange(first + 1, first + 1 + count) / n


def _tables(net: SNet, read: Tensor, beside: Tensor) -> Tensor:
    """Probabilities of slabs, columns and cells of both groups after the tokens `read` (B, k, width), (B, 2, TABLE)."""
    head, floor = cast(GridHead, net.head), net.config.floor  # it is one `in_kernels`
    tables = torch.empty(len(read), 2, TABLE)

    def tile(start: int) -> None:
        part = slice(start, min(start + TILE_ROWS, len(read)))
        more = TILE_ROWS - (part.stop - start)
        tokens, known = (torch.nn.functional.pad(t[part], (0, 0) * (t.ndim - 1) + (0, more)) for t in (read, beside))
        ahead = torch.nn.functional.pad(known[:, : 2 * SLABS].unflatten(1, (2, SLABS)).mT, (0, 0, SLABS, 0))
        with torch.inference_mode():
            logs = head.logs(net.trunk.last(tokens)[:, None], ahead[:, None])
            cells = torch.cat(logs, dim=1).exp()[: part.stop - start]  # (k, 2, cells)
            cells = (1.0 - floor) * cells + floor / cells.shape[-1]
            columns = cells.unflatten(-1, (-1, SLABS)).sum(dim=-1)
            tables[part] = torch.cat([columns.unflatten(-1, (-1, SLABS)).sum(dim=-1), columns, cells], dim=-1)

    # The operations are too small to be shared out themselves.
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        list(pool.map(tile, range(0, len(read), TILE_ROWS)))
    return tables
