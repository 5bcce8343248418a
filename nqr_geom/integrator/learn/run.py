"""What a training run leaves on disk: a checkpoint that survives a kill, and its loss curve."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import torch

__all__ = ["COLUMNS", "RunFolder"]

COLUMNS = ("iteration", "seconds", "learning_rate", "train_loss", "validation_mse", "base_mse")


class RunFolder:
    """State of a run on disk: `checkpoint.pt`, `loss.csv` and `loss.png` in one folder.

    Parameters
    ----------
    folder : Path
        Created if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.checkpoint, self.curve = folder / "checkpoint.pt", folder / "loss.csv"
        self.picture = folder / "loss.png"

    def save(self, state: dict[str, Any]) -> None:
        """Write aside, then rename: a kill leaves the old checkpoint or the new one."""
        aside = self.checkpoint.with_suffix(".new")
        torch.save(state, aside)
        os.replace(aside, self.checkpoint)

    def load(self) -> dict[str, Any] | None:
        """The last checkpoint; the loss curve is cut back to it."""
        if not self.checkpoint.exists():
            self._rewrite([])
            return None
        state: dict[str, Any] = torch.load(self.checkpoint, weights_only=True)
        with self.curve.open(newline="") as file:
            lines = [line for line in list(csv.reader(file))[1:] if int(line[0]) <= state["iteration"]]
        self._rewrite(lines)
        return state

    def _rewrite(self, lines: list[list[str]]) -> None:
        with self.curve.open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *lines])

    def log(self, line: tuple[float, ...]) -> None:
        """Append a line with the values of `COLUMNS`."""
        with self.curve.open("a", newline="") as file:
            csv.writer(file).writerow([f"{value:.6g}" if isinstance(value, float) else value for value in line])

    def plot(self) -> None:
        """Draw the loss curve, where matplotlib is installed."""
        try:
            from matplotlib.figure import Figure
        except ModuleNotFoundError:
            return
        with self.curve.open(newline="") as file:
            lines = list(csv.DictReader(file))
        figure = Figure(figsize=(6.0, 4.0), layout="constrained")
        axes = figure.add_subplot(xlabel="iteration", ylabel="mean squared error", yscale="log")
        at = [int(line["iteration"]) for line in lines]
        for column, label in zip(COLUMNS[3:], ("training (robust)", "validation", "base rule"), strict=True):
            axes.plot(at, [float(line[column]) for line in lines], label=label)
        axes.legend()
        aside = self.picture.with_suffix(".new.png")
        figure.savefig(aside, dpi=120)
        os.replace(aside, self.picture)
