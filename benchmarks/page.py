"""Markdown that the pages of figures are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Row = dict[str, Any]

# What rules are called in tables and figures.
NAMES = {
    "mc": "MC",
    "trapezoid": "Trapz",
    "regression-3": "Poly-3",
    "regression-5": "Poly-5",
    "toy-hermite": "structure-aware",
    "gwn-hermite": "structure-aware",
    "sd-hermite": "structure-aware",
    "inet-toy-structured": "INet on it",
    "inet-gwn-structured": "INet on it",
    "inet-toy-uniform": "INet, uniform base",
    "inet-gwn-uniform": "INet, uniform base",
    "inet-toy-told": "INet, uniform base, told",
    "inet-gwn-student": "student of it",
    "inet-gwn-student-uniform": "student, uniform base",
    "inet-sd-uniform": "INet, uniform base",
    "uniform": "W = 1",
    "pieces known": "pieces known",
}


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is text and whose others are numbers."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def short(value: float, digits: int = 3) -> str:
    """A number for people: 1.23e-05, 0.5, 12,300; what only counts roundings is a bound."""
    if abs(value) >= 1e9:
        return "> 1e9"
    if abs(value) >= 1000:
        return f"{float(f'{value:.{digits}g}'):,.0f}"
    return f"{value:.{digits}g}"


def span(interval: Sequence[float] | None) -> str:
    """An interval, or nothing where there is none."""
    return "" if interval is None else " .. ".join(map(short, interval))


def interval(row: Row) -> str:
    """The 95% interval of a row's ratio."""
    return span(row["ratio_interval"])


def picture(path: str, what: str) -> str:
    """A picture beside the page."""
    return f"![{what}]({path})\n"
