"""The command line: files come out, and bad input gives one clear line and exit code 2."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom import cli

SQUARE = "M0 0 H1 V1 H0 Z"


def test_values_of_a_square(tmp_path: Path) -> None:
    out = tmp_path / "field.npy"
    assert cli.main(["gwn", SQUARE, "--resolution", "13", "--out", str(out)]) == 0
    field = np.load(out)
    assert field.shape == (13, 13)
    assert set(np.unique(field.round(9))) <= {-1.0, -0.5, -0.25, 0.0}  # drawn clockwise on screen
    assert np.count_nonzero(field == -1.0) == 81


def test_sampled_methods_and_polyline_files(tmp_path: Path) -> None:
    points = tmp_path / "points.npy"
    np.save(points, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    out = tmp_path / "sd.npy"
    arguments = ["sd", str(points), "--method", "structured", "-n", "16", "--resolution", "8", "--out", str(out)]
    assert cli.main(arguments) == 0
    first = np.load(out)
    assert cli.main(arguments) == 0
    np.testing.assert_array_equal(first, np.load(out))


def test_every_band_of_a_picture_has_its_own_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = []

    def record(curve: ng.Curve, points: np.ndarray, *, method: str, n: int, seed: int, **_) -> np.ndarray:
        seeds.append(seed)
        return np.zeros(len(points))

    monkeypatch.setattr(ng, "gwn", record)
    arguments = ["gwn", SQUARE, "--method", "mc", "--seed", "3", "--resolution", "182"]
    assert cli.main([*arguments, "--out", str(tmp_path / "field.npy")]) == 0
    assert seeds[0] == 3
    assert len(set(seeds)) == len(seeds) >= 2


@pytest.mark.parametrize("ending", ["png", "vti", "vtp"])
def test_pictures_and_grids(tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"distance.{ending}"
    assert cli.main(["distance", "o", "--text", "--signed", "--resolution", "40", "--out", str(out)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    import pyvista as pv

    if ending == "png":
        pixels = pv.read(out)["PNGImage"][:, :3]
        assert len(np.unique(pixels, axis=0)) > 50
    else:
        values = pv.read(out).point_data["distance"]
        assert values.min() < 0.0 < values.max()


def test_p_harmonic_values_of_a_square(tmp_path: Path) -> None:
    square, values, out = tmp_path / "square.npy", tmp_path / "values.npy", tmp_path / "u.npy"
    np.save(square, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    np.save(values, [0.0, 1.0, 1.0, 0.0])
    arguments = ["p-laplace", str(square), "--values", str(values), "--p", "4", "--resolution", "26"]
    assert cli.main([*arguments, "--out", str(out)]) == 0
    field = np.load(out)
    inside = np.isfinite(field)
    assert np.count_nonzero(inside) == 400
    grid = np.broadcast_to((np.arange(26) - 12.5) * 1.3 / 26 + 0.5, (26, 26))
    np.testing.assert_allclose(field[inside], grid[inside], atol=1e-9)


@pytest.mark.parametrize("method", ["auto", "fem", "wos"])
def test_harmonic_function_of_an_array_with_values(method: str, tmp_path: Path) -> None:
    """Values 0, 1, 1, 0 at the corners of the unit square: u = x, NaN outside."""
    square, values, out = tmp_path / "square.npy", tmp_path / "values.npy", tmp_path / "u.npy"
    np.save(square, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    np.save(values, [0.0, 1.0, 1.0, 0.0])
    arguments = ["laplace", str(square), "--values", str(values), "--method", method, "-n", "400"]
    assert cli.main([*arguments, "--resolution", "26", "--out", str(out)]) == 0
    field = np.load(out)
    inside = np.isfinite(field)
    assert np.count_nonzero(inside) == 400
    grid = np.broadcast_to((np.arange(26) - 12.5) * 1.3 / 26 + 0.5, (26, 26))
    tolerance = 0.12 if method == "wos" else 1e-5  # five standard errors of 400 walks
    np.testing.assert_allclose(field[inside], grid[inside], atol=tolerance)


def test_p_harmonic_picture_of_an_svg_outline(tmp_path: Path) -> None:
    out = tmp_path / "u.png"
    assert cli.main(["p-laplace", SQUARE, "--p", "1.5", "--resolution", "40", "--out", str(out)]) == 0
    assert out.stat().st_size > 5_000


def test_frontier_writes_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "toy.json"
    arguments = ["frontier", "toy", "--shapes", "20", "--methods", "mc", "--methods", "trapezoid"]
    assert cli.main([*arguments, "--budgets", "8", "--runs", "4", "--out", str(out)]) == 0
    assert "trapezoid" in capsys.readouterr().out
    assert json.loads(out.read_text())["points"]


def test_lists_every_rule(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list", "rule"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ng.rules())


BAD = {
    "missing file": (["gwn", "nowhere.svg"], "path_or_d"),
    "missing array": (["gwn", "nowhere.npy"], "source: expected an existing file"),
    "malformed path": (["gwn", "M0 0 L1 Q"], "path_or_d"),
    "unknown method": (["gwn", SQUARE, "--method", "magic"], "method: expected one of"),
    "unknown rule": (["gwn", SQUARE, "--method", "random+magic"], "rule: expected one of"),
    "no samples": (["gwn", SQUARE, "--method", "mc", "-n", "0"], "n: expected an integer >= 1, got 0"),
    "negative alpha": (["sd", SQUARE, "--alpha", "-1"], "alpha: expected a number > 0"),
    "bad ending": (["gwn", SQUARE, "--out", "field.jpeg"], "out: expected one of .png, .npy, .vti, .vtp"),
    "tiny grid": (["gwn", SQUARE, "--resolution", "1"], "resolution: expected an integer >= 2"),
    "unknown problem": (["frontier", "magic"], "problem: expected one of toy, gwn, sd"),
    "toy has no curve": (["frontier", "toy", "--input", SQUARE], "problem: expected gwn or sd"),
    "no shapes": (["frontier", "gwn", "--shapes", "0"], "shapes: expected an integer >= 1"),
    "unknown kind": (["list", "nothing"], "kind: expected one of"),
    "p of one": (["p-laplace", SQUARE, "--p", "1"], "p: expected a number > 1"),
    "unknown values": (["p-laplace", SQUARE, "--values", "z"], "values: expected one of x, y, saddle, waves"),
    "missing values": (["p-laplace", SQUARE, "--values", "no.npy"], "values: expected an existing file"),
    "open outline": (["p-laplace", "M0 0 L1 0 L1 1"], "polygon: expected a closed curve"),
    "unknown solver": (["laplace", SQUARE, "--method", "magic"], "method: expected one of auto, wos"),
    "laplace has no curve": (["frontier", "laplace", "--input", SQUARE], "problem: expected gwn or sd"),
    "unknown command": (["magic"], "magic"),
    "not a number": (["gwn", SQUARE, "-n", "many"], "many"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_exits_with_2_and_one_line(
    name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, message = BAD[name]
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    text = captured.out + captured.err
    assert message in text
    assert "Traceback" not in text
    if text.startswith("error: "):
        assert text.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_named_in_full(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    assert cli.main(["gwn", SQUARE, "--method", "mc"]) == 2
    assert 'pip install "nqr-geom[learn]"' in capsys.readouterr().err


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert ng.__version__ in capsys.readouterr().out


def completed(script: Path, *words: str) -> list[str]:
    """What bash offers for the last word."""
    quoted = " ".join(words)
    line = f"""source {script}; COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; _nqr_geom nqr-geom
    echo "${{COMPREPLY[@]}}\""""
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True).stdout.split()


def test_bash_completes_commands_and_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", "bash"]) == 0
    script = tmp_path / "nqr-geom"
    script.write_text(capsys.readouterr().out)
    assert completed(script, "nqr-geom", "p-l") == ["p-laplace"]
    assert completed(script, "nqr-geom", "gwn", "--res") == ["--resolution"]
    assert completed(script, "nqr-geom", "completion", "fi") == ["fish"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_completion_installs_where_it_is_told(shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    out = tmp_path / "completion" / "nqr-geom"
    assert cli.main(["--install-completion", "--shell", shell, "--output", str(out)]) == 0
    assert "p-laplace" in out.read_text()


def test_python_runs_the_package() -> None:
    told = subprocess.run([sys.executable, "-m", "nqr_geom.cli", "list", "nothing"], capture_output=True, text=True)
    assert told.returncode == 2
    assert told.stderr.startswith("error: kind: expected one of")


def test_the_command_line_loads_nothing_heavy() -> None:
    heavy = "{'torch', 'numba', 'scipy', 'vtk', 'pyvista', 'warp', 'matplotlib', 'dask', 'plotly'}"
    line = f"import sys, nqr_geom.cli; print(sorted({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", line], capture_output=True, text=True).stdout.strip() == "[]"
