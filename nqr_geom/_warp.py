"""NVIDIA Warp, brought in when a kernel file is first imported: quiet, one launch split over all cores.

Only files that hold kernels import this one, and they are imported inside functions, so that nothing loads Warp before
it is used. A kernel's first parameter is `first`, the row at which its range starts: its row is ``first + wp.tid()``.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from nqr_geom import check
from nqr_geom.machine import cores


def _without_driver_warning(start: Callable[[], None]) -> None:
    """Call `start` and drop the line that Warp's native part writes to stderr where there is no GPU, and only that."""
    try:
        kept = os.dup(2)
    except OSError:  # no stderr at all
        start()
        return
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            start()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            said.seek(0)
            rest = [line for line in said if not line.startswith(b"Warp CUDA warning: Could not find")]
            if rest:
                os.write(2, b"".join(rest))


if TYPE_CHECKING:
    import warp as wp
else:
    _known = "warp" in sys.modules  # whoever has loaded Warp before has set its log to their liking
    wp = check.require("warp", "render", "volumes and scenes")
    if not _known:
        wp.config.log_level = wp.LOG_WARNING  # no banner, no line for every kernel that is compiled
    _without_driver_warning(wp.init)  # loading does not start it; starting it twice does nothing

__all__ = ["array", "launch", "wp"]

_ROWS_A_CHUNK = 256  # a launch costs about 30 us; a row of any kernel here at least a few


def array(value: Any, dtype: Any) -> Any:
    """A Warp array over the memory of a C-contiguous NumPy array or torch tensor, on the tensor's device.

    Parameters
    ----------
    value : ndarray or Tensor
        Kept alive by the array.
    dtype : Warp type
        `wp.float64`, `wp.vec3d`, ...; a vector type takes the last axis.

    Examples
    --------
    >>> array(np.zeros((4, 3)), wp.vec3d).shape
    (4,)
    """
    if isinstance(value, np.ndarray):
        return wp.array(value, dtype=dtype, device="cpu", copy=False)
    return wp.from_torch(value, dtype=dtype, requires_grad=False)


def launch(kernel: Any, count: int, arguments: list[Any], device: str = "cpu") -> None:
    """Run a kernel on rows 0 .. count-1; on a CPU the rows are shared among all cores.

    A CPU launch runs on one thread and releases the GIL. Rows are independent, so the chunks change no bit.

    Parameters
    ----------
    kernel : Warp kernel
        Its first parameter is the first row of its range, int32; `arguments` are the others.
    count : int
        Rows, below 2^31.
    arguments : list
        Arrays from `array`, scalars and structs. Arrays that are written to are among them.
    device : str
        Where the arrays lie.

    Raises
    ------
    ValueError
        If there are too many rows.

    Examples
    --------
    >>> @wp.kernel
    ... def double(first: wp.int32, values: wp.array(dtype=wp.float64)):
    ...     row = first + wp.tid()
    ...     values[row] = wp.float64(2.0) * values[row]
    >>> values = np.arange(4.0)
    >>> launch(double, 4, [array(values, wp.float64)])
    >>> values
    array([0., 2., 4., 6.])
    """
    count = check.integer("count", count, low=0, high=2**31 - 1)
    if not count:
        return
    # Compiles, if need be, before the threads start. One thread a block is how a CPU launch runs.
    kernel.module.load(device, 1 if device == "cpu" else None)
    if device != "cpu":
        with wp.ScopedStream(wp.stream_from_torch(device)):  # after what torch still has to do to the arrays
            wp.launch(kernel, dim=count, inputs=[0, *arguments], device=device)
        return

    def rows(start: int, stop: int) -> None:
        wp.launch(kernel, dim=stop - start, inputs=[start, *arguments], device=device)

    workers = min(cores("OMP_NUM_THREADS"), -(-count // _ROWS_A_CHUNK))
    if workers <= 1:
        rows(0, count)
        return
    edges = np.linspace(0, count, 4 * workers + 1).astype(int).tolist()  # uneven work levels out
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(rows, edges[:-1], edges[1:]))
