"""Files that are there in full or not at all, whatever kills the process meanwhile."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["write_whole"]


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
