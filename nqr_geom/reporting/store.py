"""Cells that have been measured, one small file each: a report that was killed goes on where it stopped."""

from __future__ import annotations

import json
import re
from hashlib import sha256
from pathlib import Path
from typing import Any

from nqr_geom.files import write_whole

__all__ = ["Store"]


class Store:
    """A folder of measured cells that belong to one configuration.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    configuration : dict
        What all cells have in common, as JSON can hold it. A folder of another configuration is refused.

    Raises
    ------
    ValueError
        If the folder holds cells of another configuration; the message names what differs.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     Store(Path(folder), {"seed": 0}).put("gwn: mc, n = 4", {"mse": 0.5})
    ...     Store(Path(folder), {"seed": 0}).get("gwn: mc, n = 4")
    {'mse': 0.5}
    """

    def __init__(self, folder: Path, configuration: dict[str, Any]) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        mark = folder / "configuration.json"
        if not mark.exists():
            if any(folder.glob("*.json")):
                raise ValueError(f"out: expected cells of a report, {str(folder)!r} has no configuration.json")
            write_whole(mark, json.dumps(configuration, indent=1) + "\n")
            return
        found = _read(mark)
        for key in sorted(found.keys() | configuration.keys()):
            old, new = found.get(key), json.loads(json.dumps(configuration.get(key)))
            if old != new:
                raise ValueError(
                    f"out: expected a folder of the same configuration, {str(folder.parent)!r} was measured with "
                    f"{key} {_short(old)}, now it is {_short(new)}; give another folder"
                )

    def _path(self, key: str) -> Path:
        readable = re.sub(r"[^a-z0-9]+", "-", key.lower()).strip("-")[:60]
        return self.folder / f"{readable}-{sha256(key.encode()).hexdigest()[:8]}.json"

    def get(self, key: str) -> Any:
        """What was kept under this key, or None."""
        path = self._path(key)
        return _read(path)["cell"] if path.exists() else None

    def put(self, key: str, cell: Any) -> None:
        """Keep a cell, in full or not at all."""
        write_whole(self._path(key), json.dumps({"key": key, "cell": cell}, allow_nan=False) + "\n")


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(
            f"out: expected JSON in {str(path)!r} ({error}); delete the file to measure it again"
        ) from error


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
