"""How much memory a block needed, as the operating system saw it."""

from __future__ import annotations

import ctypes
import gc
import os
from functools import cache
from types import TracebackType

import numpy as np

__all__ = ["PeakMemory", "keep_blocks", "release"]

_PROCESS = "/proc/self"
_STATUS, _CLEAR = f"{_PROCESS}/status", f"{_PROCESS}/clear_refs"
_BLOCK = 31 * 2**20  # bytes; glibc learns from blocks of less than 32 MiB


def _status(key: bytes) -> int | None:
    """A line of the process's status, in bytes; read as it is, since every estimate asks for it twice."""
    try:
        file = os.open(_STATUS, os.O_RDONLY)
    except OSError:
        return None
    try:
        told = os.read(file, 2**16)
    finally:
        os.close(file)
    found = told.partition(b"\n" + key + b":")[2].split(None, 1)
    return int(found[0]) * 1024 if found else None


@cache
def keep_blocks() -> None:
    """Have the C library keep freed blocks of up to 31 MiB for what comes next.

    It may hand them back to the system, and then every array of every tile is fresh memory, which the system clears
    page by page (`benchmarks/fresh_memory.py`). glibc keeps blocks as large as the largest that was freed so far, so
    one is; it is never written to, and takes no memory. Elsewhere, or where MALLOC_TRIM_THRESHOLD_ is set, nothing
    happens.

    Examples
    --------
    >>> keep_blocks()
    """
    np.empty(_BLOCK, dtype=np.uint8)


def release() -> None:
    """Hand memory that is free but still held back to the system, so that what comes next shows in full.

    Examples
    --------
    >>> release()
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.path.exists(_PROCESS) else None
    if trim is not None:
        trim(0)


class PeakMemory:
    """Context manager: `peak` is the resident memory reached above the level at entry, in bytes.

    None where the system does not tell (anything but Linux). Memory that the process already held and reuses does
    not show, so the first of several equal runs reads highest.

    Examples
    --------
    >>> with PeakMemory() as memory:
    ...     block = bytearray(50_000_000)
    >>> memory.peak is None or memory.peak > 0
    True
    """

    peak: int | None = None

    def __enter__(self) -> PeakMemory:
        try:
            file = os.open(_CLEAR, os.O_WRONLY)
            try:
                os.write(file, b"5")  # resets the high-water mark
            finally:
                os.close(file)
            self._start = _status(b"VmRSS")
        except OSError:
            self._start = None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        high = _status(b"VmHWM")
        if self._start is not None and high is not None:
            self.peak = max(0, high - self._start)
