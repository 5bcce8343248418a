"""Where files are kept, and files that are there in full or not at all, whatever kills the process meanwhile."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["cache_folder", "write_whole"]


def cache_folder() -> Path:
    """Where arrays that take minutes to compute are kept: `NQR_GEOM_CACHE`, or `nqr_geom` in the user's cache.

    Examples
    --------
    >>> bool(cache_folder().name)
    True
    """
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("NQR_GEOM_CACHE") or Path(home) / "nqr_geom")


def write_whole(path: str | os.PathLike[str], text: str) -> Path:
    """Write text beside its place and rename it: who reads sees the old file or the new one, never a part.

    Parameters
    ----------
    path : str or path
        In a folder that exists; a file that is there is replaced.
    text : str
        Written as UTF-8.

    Returns
    -------
    Path

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     write_whole(Path(folder) / "note.txt", "all of it").read_text()
    'all of it'
    """
    target = Path(path)
    aside = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        aside.write_text(text, encoding="utf-8")
        aside.replace(target)
    finally:
        aside.unlink(missing_ok=True)
    return target
