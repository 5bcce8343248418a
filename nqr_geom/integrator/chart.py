"""A frontier as a picture: error against queries and against time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nqr_geom import check

if TYPE_CHECKING:
    from nqr_geom.integrator.frontier import Frontier, Point

__all__ = ["draw"]

_MARKERS = "osD^vPXdph"
_SMALLEST = 1e-20  # errors below 1e-10 count as none: where an answer is exact the logarithm has to end


def draw(frontier: Frontier, path: Path) -> Path:
    """Write the two panels to `path`.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    check.require("matplotlib", "plot", "frontier plots")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # A figure of its own, not pyplot's: no global state and no window system.
    figure = Figure(figsize=(11.0, 4.8), layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    curves: dict[str, list[Point]] = {}
    for point in frontier.points:
        if point.kind == "sampled":
            curves.setdefault(point.method, []).append(point)
    peers = [point for point in frontier.points if point.kind == "exact"]
    # Best last error at the bottom of the legend as in the picture.
    for k, (method, points) in enumerate(sorted(curves.items(), key=lambda item: -item[1][-1].mse)):
        look = {"color": f"C{k % 10}", "marker": _MARKERS[k % len(_MARKERS)]}
        _curve(left, points, [point.queries or point.n or 1 for point in points], method, look)
        _curve(right, points, [1e6 * point.seconds for point in points], method, look)
    bottom = _limits(left, [point for points in curves.values() for point in points])
    for k, peer in enumerate(peers):
        inside = peer.mse >= bottom
        label = peer.method if inside else f"{peer.method} (error {peer.mse:.0g})"
        right.plot(
            [1e6 * peer.seconds],
            [max(peer.mse, bottom)],
            "*",
            ms=15,
            color=f"C{(len(curves) + k) % 10}",
            mec="black",
            mew=0.6,
            ls="none",
            label=label,
            clip_on=False,
            zorder=5,
        )
    for axes, title in ((left, "integrand queries per integral"), (right, "microseconds per integral")):
        axes.set_xscale("log")
        axes.set_xlabel(title)
        axes.grid(True, which="major", alpha=0.3)
    left.set_ylabel("mean squared error")
    figure.suptitle(
        f"{frontier.problem}: {frontier.batch} integrals, {frontier.runs} runs, "
        f"bands are 95% intervals over {frontier.intervals_over}",
        fontsize=10,
    )
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", frameon=False, fontsize=9)
    figure.savefig(path)
    return path


def _curve(axes: Any, points: list[Point], x: list[float], label: str, look: dict[str, str]) -> None:
    low, high = ([max(p.mse_interval[end], _SMALLEST) for p in points] for end in (0, 1))
    axes.loglog(x, [max(p.mse, _SMALLEST) for p in points], lw=1.4, ms=4.5, label=label, **look)
    axes.fill_between(x, low, high, color=look["color"], alpha=0.18, lw=0)


def _limits(axes: Any, points: list[Point]) -> float:
    """Fit the vertical range to the sampled methods, so that an exact peer does not squash it; gives its lower end."""
    values = [max(value, _SMALLEST) for point in points for value in (*point.mse_interval, point.mse)]
    bottom, top = min(values) / 3.0, max(values) * 3.0
    axes.set_ylim(bottom, top)
    return bottom
