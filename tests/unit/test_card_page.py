"""Every model has a page that says what its card says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from nqr_geom.integrator.learn.card_page import page
from nqr_geom.integrator.learn.zoo import Card, write_card
from nqr_geom.recipes import RECIPES, folder

SHIPPED = [
    path for recipe in RECIPES.values() if (path := folder(recipe.problem) / f"{recipe.name}.json").exists()
]  # fmt: skip


def cells(text: str, first: str) -> list[str]:
    """The cells of the line of a table that begins with `first`."""
    (line,) = re.findall(rf"^\| {re.escape(first)} \|.*$", text, re.MULTILINE)
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_there_are_models() -> None:
    assert {"toy-uniform", "gwn-uniform"} <= {path.stem for path in SHIPPED}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_page_and_card_agree(path: Path) -> None:
    assert path.with_suffix(".md").read_text() == page(Card.from_json(path.read_text()))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_page_tells_the_numbers_of_the_card(path: Path) -> None:
    text, data = path.with_suffix(".md").read_text(), json.loads(path.read_text())
    assert data["sha256"] in text
    assert f"{data['iterations']:,} iterations of {data['batch']} integrals" in text
    shares = cells(text, "share of the network")[1:]
    assert [float(cell) for cell in shares] == pytest.approx(data["shares"], rel=6e-3)
    for design, row in data["table"].items():
        seen = cells(text, design)
        told = [row[key] for key in ("mse", "mse_error", "median", "p99") if key in row]
        assert [float(cell) for cell in seen[1:5] if cell] == pytest.approx(told, rel=6e-3)
        if row["ratio"] < 1e9:
            assert float(seen[5]) == pytest.approx(row["ratio"], rel=6e-3)


def test_card_and_page_are_written_together(tmp_path: Path) -> None:
    card = Card.from_json(SHIPPED[0].read_text())
    write_card(tmp_path, card)
    assert Card.from_json((tmp_path / f"{card.name}.json").read_text()) == card
    assert (tmp_path / f"{card.name}.md").read_text() == page(card)
