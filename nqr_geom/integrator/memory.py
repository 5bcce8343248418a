"""How much memory a block needed, as the operating system saw it."""

from __future__ import annotations

import ctypes
import gc
import os
from pathlib import Path
from types import TracebackType

__all__ = ["PeakMemory", "release"]

_PROCESS = Path("/proc/self")


def _status(key: bytes) -> int | None:
    """A line of the process's status, in bytes; read as it is, since every estimate asks for it twice."""
    try:
        file = os.open(_PROCESS / "status", os.O_RDONLY)
    except OSError:
        return None
    try:
        told = os.read(file, 2**16)
    finally:
        os.close(file)
    found = told.partition(b"\n" + key + b":")[2].split(None, 1)
    return int(found[0]) * 1024 if found else None


def release() -> None:
    """Hand memory that is free but still held back to the system, so that what comes next shows in full.

    Examples
    --------
    >>> release()
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if _PROCESS.exists() else None
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
            (_PROCESS / "clear_refs").write_text("5")  # resets the high-water mark
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
