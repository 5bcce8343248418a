"""What a measurement ran on: it travels with every figure, because times mean nothing without it."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["cores", "machine", "versions"]


def _processor() -> str:
    """The processor's model name, where the system tells."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def cores(limit: str = "") -> int:
    """Cores this process may use, or fewer if the environment variable called `limit` says so.

    Examples
    --------
    >>> cores("NUMBA_NUM_THREADS") >= 1
    True
    """
    share = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    told = os.environ.get(limit, "")
    return min(share, int(told)) if told.isdigit() and int(told) > 0 else share


def machine() -> dict[str, str | int]:
    """Processor, cores this process may use, system, and threads that torch would use if it is loaded.

    Examples
    --------
    >>> machine()["cores"] >= 1
    True
    """
    told: dict[str, str | int] = {"processor": _processor(), "cores": cores(), "system": platform.system()}
    if "torch" in sys.modules:
        told["torch_threads"] = sys.modules["torch"].get_num_threads()
    return told


def versions(*packages: str) -> dict[str, str]:
    """Version of Python, of this package and of the named ones; those that are not installed are left out.

    Examples
    --------
    >>> sorted(versions("numpy", "no-such-package"))
    ['nqr-geom', 'numpy', 'python']
    """
    found = {"python": platform.python_version()}
    for package in ("nqr-geom", *packages):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
