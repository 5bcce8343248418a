"""What this installation consists of and whether it is sound: packages, devices, kernel caches, models.

Every check gives findings; one that is not as it should be says so in a line and what to do about it. A missing extra
is no fault: the core does without, and the finding says how to get it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from nqr_geom import registry
from nqr_geom.files import cache_folder
from nqr_geom.machine import cores, machine, versions

__all__ = ["Finding", "examine"]

_PACKAGE = Path(__file__).parent
_MODULES = {  # of packages that are imported by another name
    "fonttools": "fontTools",
    "lightning-fabric": "lightning_fabric",
    "scikit-fem": "skfem",
    "warp-lang": "warp",
}
_TOOLS = ("all", "bench", "docs", "test")  # extras for those who change the library
_KERNELS = ("nqr_geom.curves.closest", "nqr_geom.wos.nearest")  # one compiled module a room


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Parameters
    ----------
    section, name : str
        What it belongs to and what it is.
    told : str
        What was found.
    problem : str
        One line if it is not as it should be, else "".
    """

    section: str
    name: str
    told: str
    problem: str = ""


def examine() -> list[Finding]:
    """Look at everything; takes some seconds, because packages are imported to see whether they can be.

    Returns
    -------
    list of Finding
        By section: machine, packages, extras, devices, kernels, models, files.

    Examples
    --------
    >>> [finding.problem for finding in examine() if finding.section == "models" and finding.problem]
    []
    """
    checks = (_machine, _packages, _extras, _devices, _kernels, _models, _files)
    return [finding for check in checks for finding in check()]


def _machine() -> Iterator[Finding]:
    told = machine()
    yield Finding("machine", "processor", f"{told['processor']}, {told['cores']} cores for this process")
    yield Finding("machine", "python", f"{versions()['python']} on {told['system']}")
    yield Finding("machine", "threads", f"exact kernels {cores('NUMBA_NUM_THREADS')}, Warp {cores('OMP_NUM_THREADS')}")


def _numbers(version: str) -> tuple[int, ...]:
    """The release numbers a version begins with: (2, 13, 0) of "2.13.0+cpu"."""
    return tuple(int(part) for part in re.split(r"\D+", version.partition("+")[0]) if part)


def _requirements() -> Iterator[tuple[str, str, str]]:
    """Package, least version, and extra ("" for the core) of everything that the installed metadata names."""
    for line in metadata.requires("nqr-geom") or []:
        found = re.match(r"([\w.-]+)(?:\[[\w, -]*\])?\s*(?:>=\s*([\d.]+))?", line)
        extra = re.search(r"extra\s*==\s*[\"']([\w-]+)[\"']", line)
        if found and found[1] != "nqr-geom":
            yield found[1], found[2] or "", extra[1] if extra else ""


def _tested() -> dict[str, str]:
    """Versions that the tests run with, in a checkout."""
    path = _PACKAGE.parent / "constraints.txt"
    lines = path.read_text().splitlines() if path.is_file() else []
    return {name.lower(): version for name, equals, version in (line.partition("==") for line in lines) if equals}


def _packages() -> Iterator[Finding]:
    """Every package that should be there or may be there and is: new enough, and can be imported."""
    tested = _tested()
    yield Finding("packages", "nqr-geom", versions()["nqr-geom"])
    least: dict[str, tuple[str, str]] = {}
    for package, version, extra in _requirements():
        if extra not in _TOOLS:
            least.setdefault(package, (version, extra))
    for package, (version, extra) in least.items():
        have = versions(package).get(package, "")
        if not have:
            if not extra:
                yield Finding("packages", package, "missing", f"{package} is missing: pip install {package}")
            continue
        pinned = tested.get(package.lower(), "")
        told = have if pinned in ("", have.partition("+")[0]) else f"{have}, tested with {pinned}"
        problem = _unsound(package)
        if version and _numbers(have) < _numbers(version):
            problem = f'{package} {have} is too old: pip install "{package}>={version}"'
        yield Finding("packages", package, told, problem)


def _unsound(package: str) -> str:
    """Why a package that is installed cannot be imported, "" if it can."""
    module = _MODULES.get(package, package)
    try:
        import_module("nqr_geom._warp" if module == "warp" else module)  # which starts Warp without a banner
    except Exception as error:  # whatever a broken package raises
        return f"{package} is installed and cannot be imported: {_line(error)}"
    return ""


def _line(error: BaseException) -> str:
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def _extras() -> Iterator[Finding]:
    wanted: dict[str, list[str]] = {}
    for package, _, extra in _requirements():
        if extra and extra not in _TOOLS:
            wanted.setdefault(extra, []).append(package)
    for extra, packages in wanted.items():
        missing = [package for package in packages if package not in versions(package)]
        how = f'missing {", ".join(missing)}: pip install "nqr-geom[{extra}]"'
        yield Finding("extras", extra, how if missing else "installed")


def _devices() -> Iterator[Finding]:
    """What torch and Warp can run on, where they are installed."""
    if not _unsound("torch"):
        import torch

        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        names = [f"cuda:{k} {torch.cuda.get_device_name(k)}" for k in range(count)]
        yield Finding("devices", "torch", ", ".join([*names, f"cpu with {torch.get_num_threads()} threads"]))
    if "warp-lang" in versions("warp-lang") and not _unsound("warp-lang"):
        from nqr_geom._warp import wp

        yield Finding("devices", "warp", ", ".join(f"{d.alias} {d.name}".strip() for d in wp.get_devices()))


def _folder(section: str, name: str, folder: Path, pattern: str, advice: str) -> Finding:
    """A folder that is written to: what lies there, and whether more can be."""
    there = folder
    while not there.exists() and there != there.parent:  # it is made when first needed
        there = there.parent
    files = [path.stat().st_size for path in folder.glob(pattern) if path.is_file()]
    told = f"{folder}: {len(files)} files, {sum(files) / 2**20:.1f} MiB"
    writable = there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    return Finding(section, name, told, "" if writable else f"{folder} cannot be written to: {advice}")


def _kernels() -> Iterator[Finding]:
    """Where compiled kernels are kept."""
    for module in _KERNELS:
        name = "numba: " + module.split(".")[1]
        try:
            kernels = [k for k in vars(import_module(module)).values() if hasattr(k, "stats") and hasattr(k, "py_func")]
        except Exception as error:  # numba refuses to cache where it can write nowhere
            yield Finding("kernels", name, "none", f"{module} cannot be compiled: {_line(error)}; set NUMBA_CACHE_DIR")
            continue
        folders = {Path(kernel.stats.cache_path) for kernel in kernels if kernel.stats.cache_path}
        for folder in sorted(folders):
            yield _folder("kernels", name, folder, "*.nb[ci]", "set NUMBA_CACHE_DIR to a folder of yours")
    if "warp-lang" in versions("warp-lang") and not _unsound("warp-lang"):
        from nqr_geom._warp import wp

        advice = "set WARP_CACHE_PATH to a folder of yours"
        yield _folder("kernels", "warp", Path(wp.config.kernel_cache_dir), "**/*", advice)


def _models() -> Iterator[Finding]:
    """Every trained model of the registry: weights and card are there and belong together."""
    cards = {path.stem: path for path in _PACKAGE.glob("*/models/*.json")}
    for name in [entry.name for entry in registry.entries("model")]:
        if name not in cards:
            yield Finding("models", name, "missing", f"model {name}: its card is missing, install nqr-geom again")
            continue
        told, problem = _model(cards[name])
        yield Finding("models", name, told, problem and f"model {name}: {problem}, install nqr-geom again")


def _model(path: Path) -> tuple[str, str]:
    """What a card says of its weights, and what is wrong with them."""
    try:
        card: dict[str, Any] = json.loads(path.read_text())
        digest, told = str(card["sha256"]), f"for {card['problem']}, {card['iterations']} iterations"
    except (OSError, ValueError, KeyError, TypeError) as error:
        return "unreadable card", f"its card cannot be read ({_line(error)})"
    weights = path.with_suffix(".safetensors")
    if not weights.is_file():
        return told, f"its weights {weights.name} are missing"
    found = hashlib.sha256(weights.read_bytes()).hexdigest()
    if found != digest:
        return told, f"its weights have sha256 {found[:12]}..., its card says {digest[:12]}..."
    return f"{told}, {weights.stat().st_size / 2**20:.2f} MiB, sha256 as on its card", ""


def _files() -> Iterator[Finding]:
    yield _folder("files", "cache", cache_folder(), "**/*", "set NQR_GEOM_CACHE to a folder of yours")
