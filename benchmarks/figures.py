"""How the benchmarks' figures look: one colour a rule, light grids, no window system."""

from __future__ import annotations

from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1] / "docs"

# A colour-blind safe set (Okabe and Ito), greys for classical rules.
SEVERAL = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
COLOURS = {
    "mc": "0.15",
    "trapezoid": "0.5",
    "regression-3": "#E69F00",
    "regression-5": "#F0C060",
    "toy-hermite": "#009E73",
    "gwn-hermite": "#009E73",
    "inet-toy-structured": "#0072B2",
    "inet-gwn-structured": "#0072B2",
    "inet-toy-uniform": "#D55E00",
    "inet-gwn-uniform": "#D55E00",
    "inet-toy-told": "#CC79A7",
}


def figure(width: float, height: float) -> Any:
    """A figure of its own, not pyplot's: no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained", dpi=110)
    FigureCanvasAgg(made)
    return made


def outlined(axis: Any, corners: Any, lw: float = 0.8) -> None:
    """The closed polygon with these corners, (n, 2), on an axis without ticks or frame."""
    axis.plot(*[[*line, line[0]] for line in corners.T], color="0.15", lw=lw, zorder=1)
    axis.set(xticks=[], yticks=[], aspect="equal")
    for spine in axis.spines.values():
        spine.set_visible(False)


def save(made: Any, path: Path) -> None:
    """Write a figure and say where."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made.savefig(path)
    print(path)
