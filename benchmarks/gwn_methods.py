"""Winding number and smoothed distance without a network: the baseline rows of Table 11, and the structured rules.

    python benchmarks/gwn_methods.py [--quick]

Queries are the centres of a 128 x 128 grid over [-1, 1]^2 that are at least 1e-3 away from the curve (64 x 64 for the
smoothed distance and the black boxes). Ratios are means over means against plain Monte Carlo with as many samples,
intervals by bootstrap over shapes.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import write

import nqr_geom as ng
from nqr_geom.curves import families
from nqr_geom.curves.problems import GwnProblem, SdProblem
from nqr_geom.integrator.frontier import Frontier, frontier
from nqr_geom.integrator.problem import Problem

N = 32
SEED = 0


def grid(resolution: int) -> np.ndarray:
    line = (np.arange(resolution) + 0.5) * (2.0 / resolution) - 1.0
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def rows_of(measured: Frontier, problem: str) -> list[dict[str, Any]]:
    keep = ("method", "n", "queries", "mse", "mse_interval", "median", "p99", "ratio", "ratio_interval", "fallback")
    return [
        {"problem": problem, **{key: row[key] for key in keep}} for row in measured.table if row["kind"] == "sampled"
    ]


def family(
    problem: type[GwnProblem] | type[SdProblem], shapes: int, resolution: int, runs: int
) -> list[dict[str, Any]]:
    """The random shapes of Fig. 38."""
    made = problem.family(shapes, seed=SEED, resolution=resolution)
    methods = ["mc", "stratified", "random+trapezoid", "trapezoid", "random+regression-3", "sobol+mc"]
    rule = f"{made.name}-hermite"
    measured = frontier(
        made, [*methods, f"random+{rule}", f"stratified+{rule}", "structured"], [N], runs=runs, seed=SEED
    )
    rows = rows_of(measured, f"{made.name}, family")
    if made.name == "gwn":
        rows.append(per_shape(made))
    return rows


def per_shape(problem: Problem) -> dict[str, Any]:
    """Stratified Monte Carlo shape by shape: Table 11 lists six, and their median is what a family can be held to."""
    truth = problem.reference()
    assert truth is not None
    error = (ng.integrate(problem, N, seed=SEED).value - truth)[:, 0] ** 2
    shapes = [error[problem.groups == k].mean() for k in np.unique(problem.groups)]
    return {
        "problem": "gwn, family",
        "method": "stratified, median over shapes",
        "n": N,
        "mse": float(np.median(shapes)),
    }


def black_box_quadratics(shapes: int, resolution: int) -> dict[str, Any]:
    """How often the structured method is right to 1e-10 when it only sees points, and whether it knows when not."""
    points = grid(resolution)
    right = total = unflagged = 0
    for curve in ng.datasets.curves(shapes, seed=SEED):
        far = points[ng.distance(curve, points) > 1e-3]
        box = ng.Curve.from_callable(curve.sample, pieces=curve.n_pieces)
        estimate = ng.gwn(box, far, method="structured", n=N, full_output=True)
        good = np.abs(estimate.value[:, 0] - ng.gwn(curve, far)) < 1e-10
        right, total = right + int(good.sum()), total + len(far)
        unflagged += int((~good & ~estimate.fallback).sum())
    return {
        "problem": "gwn, black-box quadratics",
        "n": N,
        "queries": total,
        "right": right / total,
        "unflagged": unflagged,
    }


def smooth_black_boxes(curves: int, resolution: int, runs: int) -> list[dict[str, Any]]:
    """Lissajous and Fourier curves: no polynomials, one piece, only points."""
    boxes = [families.lissajous(a, b, phase) for a, b, phase in ((3, 4, 0.5), (2, 3, 1.0), (1, 2, 0.3), (5, 4, 0.7))]
    boxes += [families.fourier(seed) for seed in range(curves)]
    rows = []
    for k, box in enumerate(boxes):
        polygon = ng.Curve.polyline(box.sample(np.arange(200_000) / 200_000), closed=True)
        points = grid(resolution)
        points = points[ng.distance(polygon, points) > 1e-3]
        truth = ng.gwn(polygon, points)

        def mse(method: str, seed: int) -> float:
            return float(np.mean((ng.gwn(box, points, method=method, n=N, seed=seed) - truth) ** 2))  # noqa: B023

        plain = np.mean([mse("mc", seed) for seed in range(4 * runs)])
        structured = np.mean([mse("structured", seed) for seed in range(runs)])
        rows.append({"curve": k, "mc": float(plain), "structured": float(structured)})
    plain, ours = (np.array([row[key] for row in rows]) for key in ("mc", "structured"))
    draws = np.random.default_rng(SEED).integers(0, len(rows), (2000, len(rows)))
    ratios = plain[draws].sum(axis=1) / np.maximum(ours[draws].sum(axis=1), 1e-30)
    interval = [float(q) for q in np.quantile(ratios, (0.025, 0.975))]
    summary = {
        "problem": "gwn, Lissajous and Fourier",
        "method": "structured",
        "n": N,
        "mse": float(ours.mean()),
        "ratio": float(plain.sum() / max(ours.sum(), 1e-30)),
        "ratio_interval": interval,
        "curves": rows,
    }
    return [summary]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a minute, wide intervals")
    quick = parser.parse_args().quick
    shapes, resolution, runs = (8, 32, 3) if quick else (16, 128, 2)
    rows = family(GwnProblem, shapes, resolution, runs)
    rows += family(SdProblem, shapes, resolution // 2, runs)
    rows.append(black_box_quadratics(shapes, resolution // 2))
    rows += smooth_black_boxes(2 if quick else 8, resolution // 2, 1 if quick else 2)
    table = Table(title=f"{N} samples")
    for column in ("problem", "method", "MSE", "x MC", "95%", "median", "flagged"):
        table.add_column(column)
    for row in rows:
        if "right" in row:
            table.add_row(
                row["problem"], "structured", f"right {row['right']:.4%}", "", "", "", f"{row['unflagged']} not"
            )
            continue
        low, high = row.get("ratio_interval") or (np.nan, np.nan)
        ratio = row.get("ratio")
        table.add_row(
            row["problem"],
            row["method"],
            f"{row['mse']:.2e}",
            "" if ratio is None else f"{ratio:.4g}",
            "" if np.isnan(low) else f"{low:.3g} .. {high:.3g}",
            f"{row['median']:.1e}" if "median" in row else "",
            f"{row['fallback']:.2%}" if "fallback" in row else "",
        )
    Console(width=140).print(table)
    print(write("gwn_methods", rows, seed=SEED, shapes=shapes, resolution=resolution, runs=runs))


if __name__ == "__main__":
    main()
