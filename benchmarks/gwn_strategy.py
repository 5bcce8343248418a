"""What samples weigh on a curve, and where adaptive ones go: Fig. 26 of the paper.

    python benchmarks/gwn_strategy.py [--out FOLDER]

Draws docs/gwn-strategy-NAME.png, one line a query (the star): the winding number around it, the 32 samples on the curve
and on the integrand f(s), coloured by weight. The structured method rebuilds the curve from its samples and keeps all
of its answer in the additive term, so its samples have no weights to show.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import LEARNED, SEED, N, Pair, trained_sampler
from figures import DOCS, figure, save
from shapes import write

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator.problem import Samples
from nqr_geom.streams import Stream

SHAPE = 3  # of the held-out ones
GRID = 160
DENSE = 12000
TICKS = (-100.0, -10.0, -3.0, -1.0, 0.0, 1.0, 3.0, 10.0, 100.0)
LIMIT = 3.0  # weights beyond it share the last colour


def chosen(curve: ng.Curve) -> np.ndarray:
    """Three queries: far from the curve, near it, and deep where the winding number is most negative, (3, 2)."""
    line = np.linspace(-0.97, 0.97, 98)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    away, turns = ng.distance(curve, grid), ng.gwn(curve, grid)
    far = np.argmax(away - np.abs(turns))
    near = np.argmin(np.abs(away - 0.03) + 0.1 * np.abs(np.abs(turns) - 0.4))
    deep = np.argmin(np.where(away > 0.04, turns, np.inf))
    return grid[[far, near, deep]]


def sampled(problem: GwnProblem, pair: Pair) -> tuple[Samples, np.ndarray, np.ndarray]:
    """Samples, weights (B, N) and estimates (B,)."""
    with torch.no_grad():
        samples = registry.make("sampler", pair[0]).draw(problem, N, Stream(SEED, "test", "samples/0"))
        result = registry.make("rule", pair[1]).combine(samples)
    weights = result.weights.expand_as(samples.value)[..., 0, 0]
    return samples, weights.numpy(), result.estimate(samples)[:, 0].numpy()


def draw(name: str, curve: ng.Curve, points: np.ndarray, pair: Pair, folder: Path) -> None:
    """Field, curve with samples, integrand with samples."""
    problem = GwnProblem.of(curve, points)
    samples, weights, estimates = sampled(problem, pair)
    truth = ng.gwn(curve, points)
    s = samples.x[..., 0].numpy()
    line = (np.arange(GRID) + 0.5) * (2.0 / GRID) - 1.0
    field = ng.gwn(curve, np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)).reshape(GRID, GRID)
    dense = (np.arange(DENSE) + 0.5) / DENSE
    f = problem.evaluate(torch.from_numpy(dense).expand(len(points), -1)[..., None]).value[..., 0, 0].numpy()
    outline = curve.sample(dense).reshape(curve.n_pieces, -1, 2)
    most = float(np.abs(field).max())
    weighs = bool(np.any(weights))
    look: dict[str, Any] = {"c": "#D55E00"}
    picture = figure(12.5, 3.6 * len(points))
    axes = picture.subplots(len(points), 3, width_ratios=(1.0, 1.0, 1.7))
    for k, (left, middle, right) in enumerate(axes):
        image = left.imshow(field, origin="lower", extent=(-1, 1, -1, 1), cmap="RdBu_r", vmin=-most, vmax=most)
        for panel in (left, middle):
            for piece in outline:
                panel.plot(*piece.T, color="0.2" if panel is left else "0.7", lw=1.2)
            panel.plot(*points[k], "*", ms=15, color="#009E73", mec="black", mew=0.7, zorder=5)
            panel.set(xlim=(-1.02, 1.02), ylim=(-1.02, 1.02), aspect="equal", xticks=[], yticks=[])
        if weighs:
            look = {"c": weights[k], "cmap": "coolwarm", "vmin": 1.0 - LIMIT, "vmax": 1.0 + LIMIT}
        at = curve.sample(s[k])
        dots = middle.scatter(*at.T, s=34, edgecolors="black", linewidths=0.5, zorder=4, **look)
        for piece in np.split(np.arange(DENSE), curve.n_pieces):
            right.plot(dense[piece], f[k, piece], color="0.7", lw=1.0)
        right.scatter(s[k], samples.value[k, :, 0, 0], s=30, edgecolors="black", linewidths=0.5, zorder=4, **look)
        for joint in np.arange(1, curve.n_pieces) / curve.n_pieces:
            right.axvline(joint, color="0.85", lw=0.8, zorder=0)
        right.set_yscale("asinh", linear_width=0.5)
        ticks = [tick for tick in TICKS if min(f[k].min(), 0.0) <= tick <= max(f[k].max(), 0.0)]
        right.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        right.minorticks_off()
        right.set(xlim=(0.0, 1.0), ylabel="f(s)")
        right.set_title(f"winding number {truth[k]:.3f}, estimate {estimates[k]:.3f}", fontsize=10)
    axes[-1, 2].set_xlabel("s")
    axes[0, 0].set_title("winding number", fontsize=10)
    axes[0, 1].set_title(f"{N} samples on the curve", fontsize=10)
    picture.colorbar(image, ax=axes[:, 0], location="bottom", shrink=0.8, aspect=30, pad=0.01)
    if weighs:
        bar = picture.colorbar(dots, ax=axes[:, 1:], location="bottom", shrink=0.6, aspect=50, pad=0.01, extend="both")
        bar.set_label("weight W (1: plain Monte Carlo)")
    picture.suptitle(f"{name}: {pair[0]} + {pair[1]}", fontsize=11)
    save(picture, folder / f"gwn-strategy-{name}.png")


def summary(name: str, pair: Pair) -> dict[str, Any]:
    """Weights far from and near the curve, over queries on many shapes."""
    problem = GwnProblem.family(20, SEED, "test", resolution=16)
    samples, weights, _ = sampled(problem, pair)
    distance = np.sqrt(samples.seen.features["distance2"][..., 0, 0].numpy())
    nearest = distance.min(axis=1)
    far, near = nearest > 0.3, nearest < 0.05
    return {
        "method": name,
        "n": N,
        "median_weight_far_queries": float(np.median(weights[far])),
        "median_weight_of_nearest_sample_near_queries": float(np.median(weights[near][distance[near].argmin(axis=1)])),
        "median_distance_of_nearest_sample": float(np.median(nearest)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    pairs: dict[str, Pair | None] = {
        "inet": ("stratified", LEARNED["gwn"][2]),
        "structured": registry.method("structured", "gwn"),
        "nqr": trained_sampler("gwn"),
    }
    there = {name: pair for name, pair in pairs.items() if pair is not None}
    curve = ng.datasets.curves(SHAPE + 1, seed=SEED)[SHAPE]
    points = chosen(curve)
    for name, pair in there.items():
        draw(name, curve, points, pair, out)
    rows = [summary(name, pair) for name, pair in there.items()]
    for row in rows:
        print(row)
    if out == DOCS:
        print(write("gwn_strategy", rows, n=N, seed=SEED))


if __name__ == "__main__":
    main()
