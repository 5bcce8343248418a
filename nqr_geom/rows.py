"""Run a compiled kernel over rows of a batch on all cores the process may use, and sum up what it sees in a row."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

from nqr_geom.machine import cores

__all__ = ["over_rows", "with_term"]

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


@njit(inline="always", error_model="numpy")
def with_term(f, i, total, squares, cubes, fourths):  # type: ignore[no-untyped-def]
    """Mean, and sums of powers 2 to 4 of the deviations, with term number i (Pebay 2008)."""
    step = f - total
    part = step / (i + 1)
    spread = step * (f - (total + part))
    # Higher moments before the second is brought up to date.
    fourths += part * (part * (spread * (i * i - i + 1) + 6.0 * squares) - 4.0 * cubes)
    cubes += part * (spread * (i - 1) - 3.0 * squares)
    return total + part, squares + spread, cubes, fourths
