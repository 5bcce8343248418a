"""The doctor: a sound installation gives 0, and each thing that is broken gives one line that names it."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest

import nqr_geom as ng
from nqr_geom import cli, doctor


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the shipped models that a test may break."""
    for folder in Path(ng.__file__).parent.glob("*/models"):
        shutil.copytree(folder, tmp_path / folder.parent.name / "models")
    monkeypatch.setattr(doctor, "_PACKAGE", tmp_path)
    return tmp_path


def problems() -> list[str]:
    return [finding.problem for finding in doctor.examine() if finding.problem]


def test_a_sound_installation(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["healthy"] is True
    assert told["problems"] == []
    assert set(told["models"]) == set(ng.models())
    assert told["packages"]["numpy"] == metadata.version("numpy")
    assert all(state == "installed" for state in told["extras"].values())
    assert set(told["kernels"]) == {"numba: curves", "numba: wos", "warp"}
    assert "cpu" in told["devices"]["torch"]
    assert cli.main(["doctor"]) == 0
    assert "no problems found" in capsys.readouterr().out


def flipped(models: Path) -> None:
    path = models / "curves/models/gwn-student.safetensors"
    weights = bytearray(path.read_bytes())
    weights[-1] ^= 1
    path.write_bytes(bytes(weights))


BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "one bit of the weights": (flipped, "model gwn-student: its weights have sha256"),
    "half a card": (
        lambda models: (models / "toy/models/toy-uniform.json").write_text('{"name": "toy-uniform", "prob'),
        "model toy-uniform: its card cannot be read",
    ),
    "a card of something else": (
        lambda models: (models / "toy/models/toy-uniform.json").write_text("[1, 2]"),
        "model toy-uniform: its card cannot be read",
    ),
    "no card": (lambda models: (models / "wos/models/p-laplace.json").unlink(), "model p-laplace: its card is missing"),
    "no weights": (
        lambda models: (models / "curves/models/sd-nqr.safetensors").unlink(),
        "model sd-nqr: its weights sd-nqr.safetensors are missing",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_models_give_one_line_and_exit_code_1(
    name: str, shipped: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    breaks, line = BROKEN[name]
    breaks(shipped)
    assert cli.main(["doctor"]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith(f"problem: {line}")
    assert cli.main(["doctor", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["healthy"] is False


def test_a_missing_extra_is_no_problem_and_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    known = doctor.versions
    hidden = ("warp-lang", "pyvista")
    monkeypatch.setattr(doctor, "versions", lambda *names: known(*(name for name in names if name not in hidden)))
    findings = {(finding.section, finding.name): finding for finding in doctor.examine()}
    assert findings["extras", "render"].told == 'missing warp-lang: pip install "nqr-geom[render]"'
    assert findings["extras", "plot"].told == 'missing pyvista: pip install "nqr-geom[plot]"'
    assert ("devices", "warp") not in findings
    assert not [finding for finding in findings.values() if finding.problem]


def test_packages_that_are_missing_too_old_or_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["numpy>=99.1", "no-such-package>=1", 'safetensors>=0.5; extra == "learn"', "rich"]
    monkeypatch.setattr(metadata, "requires", lambda name: lines)
    monkeypatch.setitem(sys.modules, "safetensors", None)
    said = problems()
    assert len(said) == 3
    assert said[0] == f'numpy {metadata.version("numpy")} is too old: pip install "numpy>=99.1"'
    assert said[1] == "no-such-package is missing: pip install no-such-package"
    assert said[2].startswith("safetensors is installed and cannot be imported: ModuleNotFoundError")


def test_a_cache_that_cannot_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("NQR_GEOM_CACHE", str(file / "below"))
    assert problems() == [f"{file / 'below'} cannot be written to: set NQR_GEOM_CACHE to a folder of yours"]
