"""What an exact smoothed distance costs, next to rules that see points of the curve only, in the same run.

    python benchmarks/exact_sd.py [--quick]

A shape of the training family, its outline in segments and a spiral, at three sharpnesses. "structured" and "Monte
Carlo" take 32 samples; "fixed rule" is one that an array program would take, 16 Gauss-Legendre points on each of 8
equal parts of every piece, in NumPy. Errors are times alpha: relative ones of the integral. All cores.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import best_seconds, spiral, write

import nqr_geom as ng
from nqr_geom.curves.families import curves

Floats = NDArray[np.float64]

SEED = 0
SHARPNESSES = (1.0, 35.0, 1000.0)
PARTS = 8


def cases() -> list[tuple[str, ng.Curve]]:
    shape = curves(1, SEED, "test")[0]
    outline = shape.to_polyline(1e-4)
    return [
        (f"family, {len(shape)} pieces", shape),
        (f"its outline, {len(outline)} segments", outline),
        ("spiral, 1,000 segments", ng.Curve.polyline(spiral(1_000), closed=True)),
    ]


def fixed_rule(curve: ng.Curve, points: Floats, alpha: float) -> Floats:
    """What an array program does: the same nodes for every query."""
    node, weight = np.polynomial.legendre.leggauss(16)
    parts = PARTS * len(curve)
    s = ((np.arange(parts)[:, None] + 0.5 * (node + 1.0)) / parts).ravel()
    x, length = curve.sample(s), np.linalg.norm(curve.derivative(s), axis=1) * np.tile(0.5 * weight / parts, parts)
    away = np.hypot(x[:, 0] - points[:, :1], x[:, 1] - points[:, 1:])
    nearest = away.min(axis=1)
    total = (np.exp(-alpha * (away - nearest[:, None])) * length).sum(axis=1)
    return np.asarray(nearest - np.log(total) / alpha)


def measure(name: str, curve: ng.Curve, points: Floats, alpha: float, repeats: int) -> dict[str, Any]:
    few = points[: max(1, len(points) // 20)]
    exact = np.asarray(ng.sd(curve, points, alpha=alpha))

    def sampled(method: str) -> Floats:
        return np.asarray(ng.sd(curve, points, alpha=alpha, method=method, seed=SEED))

    seconds = {
        "exact": best_seconds(lambda: ng.sd(curve, points, alpha=alpha), repeats),
        "gradient": best_seconds(lambda: ng.sd_gradient(curve, points, alpha=alpha), repeats),
        "fixed": best_seconds(lambda: fixed_rule(curve, few, alpha), repeats) * len(points) / len(few),
        "mc": best_seconds(lambda: sampled("mc"), repeats),
    }
    errors = {"fixed": fixed_rule(curve, few, alpha) - exact[: len(few)], "mc": sampled("mc") - exact}
    if 2 * len(curve) <= 32:  # two samples a piece at least
        seconds["structured"] = best_seconds(lambda: sampled("structured"), repeats)
        errors["structured"] = sampled("structured") - exact
    return {
        "case": name,
        "alpha": alpha,
        "queries": len(points),
        **{f"us_{key}": 1e6 * value / len(points) for key, value in seconds.items()},
        **{f"error_{key}": float(alpha * np.abs(value).max()) for key, value in errors.items()},
        "times_mc": seconds["exact"] / seconds["mc"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few queries; writes nothing")
    quick = parser.parse_args().quick
    points = np.random.default_rng(SEED).uniform(-1, 1, (500 if quick else 10_000, 2))
    rows = [measure(*case, points, alpha, 3 if quick else 5) for case in cases() for alpha in SHARPNESSES]
    table = Table(title="smoothed distance: us a query (largest error times alpha)")
    for heading in ("curve", "alpha", "exact", "gradient", "structured", "fixed rule", "Monte Carlo", "exact, x it"):
        table.add_column(heading)
    for row in rows:
        cells = [f"{row[f'us_{key}']:.3g}" for key in ("exact", "gradient")]
        cells += [
            f"{row[f'us_{key}']:.3g} ({row[f'error_{key}']:.0e})" if f"us_{key}" in row else ""
            for key in ("structured", "fixed", "mc")
        ]
        cells.append(f"{row['times_mc']:.3g}")
        table.add_row(row["case"], f"{row['alpha']:g}", *cells)
    Console(width=150).print(table)
    if not quick:
        print(write("exact_sd", rows, seed=SEED))


if __name__ == "__main__":
    main()
