"""Pictures of the light through a volume, and the command that draws them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nqr_geom import cli, datasets, render
from nqr_geom.through import named_volume, see_through


def test_rows_run_down_and_columns_right() -> None:
    """A wedge that is densest at large y and half as thick: T falls towards the top row, columns are alike."""
    ramp = render.Grid(np.broadcast_to(np.arange(3.0)[None, :, None], (3, 3, 3)), [0, 0, 0], [1, 2, 3])
    image, estimate = see_through(ramp, axis="z", resolution=8, method="trapezoid")
    assert image.shape == (8, 4)
    y = 2.0 - (np.arange(8) + 0.5) / 4.0
    np.testing.assert_allclose(image, np.broadcast_to(np.exp(-3.0 * y)[:, None], (8, 4)), rtol=1e-12)
    assert estimate.counts["queries"] == 32 * 24
    side, _ = see_through(ramp, axis="y", resolution=6, method="regression")
    np.testing.assert_allclose(side, np.exp(-2.0), rtol=1e-12)
    assert side.shape == (6, 2)


def test_a_file_of_densities(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = tmp_path / "fog.npy", tmp_path / "sub" / "fog.npy"
    np.save(data, np.full((5, 3, 3), 0.5))
    arguments = ["transmittance", str(data), "--density", "2", "--axis", "x", "--resolution", "4", "--report"]
    assert cli.main([*arguments, "--out", str(out)]) == 0
    np.testing.assert_allclose(np.load(out), np.exp(-1.0), rtol=1e-14)  # the longest side has length 1
    told = capsys.readouterr().out
    assert "homogeneous" in told
    assert "none" in told  # no kernel ran
    assert cli.main([*arguments[:2], "--resolution", "4", "--out", str(tmp_path / "fog.png")]) == 0
    assert (tmp_path / "fog.png").stat().st_size > 60


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["nothing"], "source: expected one of cloud, donut, got 'nothing'"),
        (["gone.npy"], "source: expected an existing file, got 'gone.npy'"),
        (["--axis", "w"], "axis: expected one of x, y, z, got 'w'"),
        (["--method", "magic"], "method: expected one of"),
        (["--density", "-1"], "density: expected a number >= 0"),
        (["--out", "cloud.tif"], "out: expected one of .png, .npy"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, match, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["transmittance", *arguments]) == 2
    assert match in " ".join(capsys.readouterr().err.split())


def test_families_are_keyed_by_index_seed_and_split() -> None:
    three, two = datasets.volumes(3, seed=4), datasets.volumes(2, seed=4)
    np.testing.assert_array_equal(three[1].centers, two[1].centers)
    assert three[1].noise == two[1].noise
    assert (datasets.volumes(1, seed=4, split="train")[0].radii != two[0].radii).all()
    assert two[0].noise != two[1].noise
    for cloud in three:
        assert cloud.bounds[0].tolist() == [0.0] * 3
        assert cloud.radii.min() >= 0.4
        assert cloud.radii.max() <= 1.4
    assert named_volume("donut", density=0.5).majorant == 0.5


def test_letters_are_dense_inside_and_empty_outside() -> None:
    word = named_volume("I", text=True)
    middle, corner = word.components([[5.0, 5.0, 5.0], [0.1, 0.1, 5.0]]).density
    assert corner == 0.0
    assert middle > 0.5
