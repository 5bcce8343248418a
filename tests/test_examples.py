"""Every example runs, writes its picture, and gives the number it is about."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(autouse=True)
def examples_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES.parent)


def test_no_example_is_left_out() -> None:
    names = {path.stem for path in EXAMPLES.glob("*.py")} - {"__init__"}
    assert names == {
        "gwn_of_svg",
        "light_selection",
        "light_through_a_cloud",
        "own_integral",
        "p_laplace_values",
        "p_three_from_walks",
        "room_by_four_methods",
        "sd_of_text",
        "toy_frontier",
        "toy_rules",
        "walks_from_a_point",
    }


def test_gwn_of_svg(tmp_path: Path) -> None:
    area = import_module("examples.gwn_of_svg").main(tmp_path, resolution=200)
    assert area == pytest.approx(3.52e4, rel=0.01)
    assert (tmp_path / "gwn_of_svg.png").stat().st_size > 10_000


def test_sd_of_text(tmp_path: Path) -> None:
    gap = import_module("examples.sd_of_text").main(tmp_path, resolution=120)
    assert gap == pytest.approx(-0.0145, abs=2e-3)
    assert (tmp_path / "sd_of_text.png").stat().st_size > 10_000


def test_toy_rules(tmp_path: Path) -> None:
    errors = import_module("examples.toy_rules").main(tmp_path)
    assert abs(errors["stratified", "toy-hermite"]) < 2e-3 < abs(errors["stratified", "trapezoid"])
    assert (tmp_path / "toy_rules.png").stat().st_size > 10_000


def test_toy_frontier(tmp_path: Path) -> None:
    assert import_module("examples.toy_frontier").main(tmp_path, integrands=200, runs=2) > 4000.0
    assert (tmp_path / "toy_frontier.png").stat().st_size > 10_000


def test_p_three_from_walks(tmp_path: Path) -> None:
    by_two, by_walks = import_module("examples.p_three_from_walks").main(tmp_path, resolution=40)
    assert by_two == pytest.approx(1.6e-4, rel=0.3)
    assert by_walks < 0.4 * by_two
    assert (tmp_path / "p_three_from_walks.png").stat().st_size > 10_000


def test_p_laplace_values(tmp_path: Path) -> None:
    centre = import_module("examples.p_laplace_values").main(tmp_path, resolution=80)
    assert centre[2.0] == pytest.approx(0.25, abs=1e-6)
    assert centre[3.0] == pytest.approx(0.33582, abs=1e-4)
    assert (tmp_path / "p_laplace_values.png").stat().st_size > 10_000


def test_light_through_a_cloud(tmp_path: Path) -> None:
    gain = import_module("examples.light_through_a_cloud").main(tmp_path, resolution=64)
    assert gain == pytest.approx(53.5, rel=0.05)
    assert (tmp_path / "light_through_a_cloud.png").stat().st_size > 10_000


def test_light_selection(tmp_path: Path) -> None:
    sent = import_module("examples.light_selection").main(tmp_path, size=64)
    assert sent["behind the screen"] == pytest.approx(0.94, abs=0.02)  # for nothing: the screen hides the lamp
    assert sent["in the open"] == pytest.approx(0.81, abs=0.02)
    assert (tmp_path / "light_selection.png").stat().st_size > 10_000


def test_room_by_four_methods(tmp_path: Path) -> None:
    errors = import_module("examples.room_by_four_methods").main(tmp_path, size=48, truth_passes=512)
    assert errors["random"] / errors["mis"] == pytest.approx(8.3, rel=0.25)
    assert errors["structured"] < errors["mis"]
    assert (tmp_path / "room_by_four_methods.png").stat().st_size > 10_000


def test_walks_from_a_point(tmp_path: Path) -> None:
    gap = import_module("examples.walks_from_a_point").main(tmp_path, resolution=80)
    assert gap == pytest.approx(0.0040, abs=2e-4)
    assert (tmp_path / "walks_from_a_point.png").stat().st_size > 10_000


def test_own_integral(tmp_path: Path) -> None:
    """Equal steps around a closed curve converge faster than any power of n; Monte Carlo does not."""
    errors = import_module("examples.own_integral").main(tmp_path, ellipses=50)
    assert errors["grid+trapezoid"] < 1e-10 < errors["gauss-legendre"] < 1e-8 < errors["stratified"] < errors["mc"]
    assert errors["mc"] == pytest.approx(0.018, rel=0.3)
    assert (tmp_path / "own_integral.png").stat().st_size > 10_000
