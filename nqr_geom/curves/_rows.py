"""Run a compiled kernel over rows of queries on all cores the process may use."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from nqr_geom.curves.tree import morton
from nqr_geom.machine import cores

__all__ = ["over_rows", "spatial_order"]

_ROWS_A_CHUNK = 1024  # about 0.2 ms and more of work: far above the cost of handing a chunk to a thread


def over_rows(kernel: Callable[[int, int], None], count: int) -> None:
    """Call ``kernel(start, stop)`` on chunks that cover range(count).

    Kernels release the GIL, so plain threads scale. Numba's own parallel loops are not used: their runtimes forbid
    either concurrent calls from two threads or a later fork, and a library cannot know which of them its user does.
    Rows are answered one by one, so the chunks change nothing in the numbers.
    """
    workers = min(cores("NUMBA_NUM_THREADS"), -(-count // _ROWS_A_CHUNK))
    if workers <= 1:
        if count:
            kernel(0, count)
        return
    edges = np.linspace(0, count, max(4 * workers, 1) + 1).astype(np.int64)  # uneven work levels out
    first = int(edges[1])
    kernel(0, first)  # compiles, if need be, before the threads start
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(kernel, edges[1:-1].tolist(), edges[2:].tolist()))


def spatial_order(points: NDArray[np.float64], nodes: int) -> NDArray[np.int64] | None:
    """An order of the queries along a Morton curve where it pays: many queries, a tree larger than the cache."""
    if nodes < 20_000 or len(points) < 1_000:
        return None
    return np.argsort(morton(points))
