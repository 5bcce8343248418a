"""What accuracy costs on the toy family: error against samples and time for rules of every kind, measured here."""

from __future__ import annotations

from pathlib import Path

import pyvista as pv

import nqr_geom as ng

METHODS = ("mc", "stratified", "trapezoid", "bayesian-quadrature", "structured")


def main(out: Path = Path("out"), integrands: int = 400, runs: int = 4) -> float:
    """Draw both charts and return how many times the structured method beats plain Monte Carlo at 32 samples."""
    measured = ng.frontier(ng.problems.toy(integrands), METHODS, (4, 8, 16, 32, 64), runs=runs)
    plotter = pv.Plotter(shape=(1, 2), off_screen=True, window_size=(1500, 700), border=False)
    axes = (("samples per integral", lambda p: p.n), ("microseconds per integral", lambda p: 1e6 * p.seconds))
    for column, (label, cost) in enumerate(axes):
        plotter.subplot(0, column)
        chart = pv.Chart2D()
        for method, color in zip(METHODS, ("gray", "royalblue", "seagreen", "purple", "crimson"), strict=True):
            points = [p for p in measured.points if p.method == method]
            chart.line([cost(p) for p in points], [p.mse for p in points], color=color, width=3.0, label=method)
            chart.scatter([cost(p) for p in points], [p.mse for p in points], color=color, size=10)
        chart.x_axis.log_scale = chart.y_axis.log_scale = True
        chart.x_label, chart.y_label = label, "mean squared error"
        plotter.add_chart(chart)
    out.mkdir(parents=True, exist_ok=True)
    plotter.screenshot(out / "toy_frontier.png")
    plotter.close()
    ratio = next(p.ratio for p in measured.points if p.method == "structured" and p.n == 32)
    return float(ratio or 0.0)


if __name__ == "__main__":
    print(f"structured: {main():.0f} times better than plain Monte Carlo at 32 samples")
