"""Smoothed distances by every method at 32 samples: Figs. 45 and 46 of the paper.

    python benchmarks/sd_methods.py [--quick] [--methods SAMPLER+RULE ...]

Held-out shapes; the queries are every eighth centre of a 128 x 128 grid over [-1, 1]^2 along both axes, without those
nearer than 1e-3 to the curve (every sixteenth for the bias). Mean squared errors, and the squared bias from 256 runs:
the logarithm of an unbiased mean is biased. Ratios are to plain Monte Carlo with random samples. Draws
docs/sd-fields.png and docs/sd-bias.png, and fills in the table of the network's card. Further methods may be named; a
trained sampler joins as soon as the registry knows it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import DESIGNS, PLAIN, SEED, N, Pair, errors_of, rows_of, show, trained_sampler
from figures import DOCS, figure, save
from learned import NEAREST, grid_queries, write_cards
from page import NAMES
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import check, registry
from nqr_geom.curves.distance import distance
from nqr_geom.curves.families import curves
from nqr_geom.curves.problems import SdProblem
from nqr_geom.integrator.bootstrap import Bootstrap

RULES = ("mc", "trapezoid", "regression-3", "sd-hermite", "inet-sd-uniform")
RUNS = 256


def label(pair: Pair) -> str:
    """A pair for people."""
    place = {"random": "random", "stratified": "stratified", "curve-refine": "refined"}.get(pair[0], pair[0])
    return f"{NAMES.get(pair[1], pair[1])}, {place}"


def held_out(shapes: int, stride: int = 1) -> SdProblem:
    """Every `stride`-th of the queries along both axes, around as many held-out shapes."""
    family = curves(shapes, SEED, "test")
    side = round(len(grid_queries()) ** 0.5)
    queries = grid_queries().reshape(side, side, 2)[stride // 2 :: stride, stride // 2 :: stride].reshape(-1, 2)
    far = np.concatenate([distance(curve, queries) >= NEAREST for curve in family])
    return SdProblem.of(family, queries).take(torch.from_numpy(np.flatnonzero(far)))


def bias_rows(problem: SdProblem, pairs: list[Pair], runs: int) -> list[dict[str, Any]]:
    """Squared bias of each pair, free of the variance that is left in the mean of the runs, and its ratio."""
    bootstrap = Bootstrap.of(problem.groups, runs, SEED)
    rows: list[dict[str, Any]] = []
    for pair in pairs:
        errors = errors_of(problem, pair, runs)
        bias, interval = bootstrap.squared_bias(errors.deviations[..., None])
        rows.append(
            {
                "design": pair[0],
                "rule": pair[1],
                "runs": runs,
                "mse": float(errors.squared.mean()),
                "squared_bias": bias,
                "squared_bias_interval": interval,
                "as_averaged": float((errors.deviations.mean(axis=1) ** 2).mean()),
            }
        )
        # Where nothing but noise is left the ratio has only a lower bound.
        rows[-1]["ratio"] = rows[0]["squared_bias"] / bias if interval[0] > 0.0 else None
        rows[-1]["ratio_at_least"] = rows[0]["squared_bias"] / max(interval[1], 1e-30)
    return rows


def maps(pairs: list[Pair], resolution: int, runs: int) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Label, first estimate and mean error of each pair over a whole grid around the first held-out shape."""
    problem = SdProblem.family(1, SEED, "test", resolution=resolution)
    line = (np.arange(resolution) + 0.5) * (2.0 / resolution) - 1.0
    whole = SdProblem.of(problem.curves[0], np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2))
    truth = whole.reference()
    assert truth is not None
    shape = (resolution, resolution)
    found = [("exact", truth.reshape(shape), np.full(shape, np.nan))]
    for pair in pairs:
        e = errors_of(whole, pair, runs).deviations
        found.append((label(pair), (truth[:, 0] + e[:, 0]).reshape(shape), e.mean(axis=1).reshape(shape)))
    return found


def draw(found: list[tuple[str, np.ndarray, np.ndarray]], name: str, title: str, numbers: dict[str, float]) -> None:
    """One column a method: the field above, the squared error below."""
    picture = figure(2.3 * len(found) + 1.2, 5.2)
    axes = picture.subplots(2, len(found))
    exact = found[0][1]
    for k, (text, field, error) in enumerate(found):
        top, low = axes[:, k]
        shown = top.imshow(
            field, origin="lower", extent=(-1, 1, -1, 1), cmap="viridis", vmin=exact.min(), vmax=exact.max()
        )
        top.contour(
            field, levels=np.linspace(0.0, exact.max(), 8), colors="white", linewidths=0.5, extent=(-1, 1, -1, 1)
        )
        top.set_title(text, fontsize=9)
        if k == 0:
            low.axis("off")
        else:
            squared = np.log10(np.maximum(error**2, 1e-12))
            map_ = low.imshow(squared, origin="lower", extent=(-1, 1, -1, 1), cmap="magma", vmin=-9.0, vmax=-1.0)
            low.set_xlabel(f"mean {numbers[text]:.1e}", fontsize=9)
        for panel in (top, low):
            panel.set(xticks=[], yticks=[])
    picture.colorbar(shown, ax=axes[0].tolist(), shrink=0.8)
    picture.colorbar(map_, ax=axes[1].tolist(), shrink=0.8, label="log10 of the square")
    picture.suptitle(title, fontsize=11)
    save(picture, DOCS / name)


def add(problem: SdProblem, pairs: list[Pair]) -> None:
    """Measure `pairs` and put them beside what the JSON holds."""
    rows = rows_of("sd", problem, pairs)
    show("smoothed distances", rows)
    write_cards(rows)
    path = Path(__file__).parent / "results" / "sd_methods.json"
    report = json.loads(path.read_text())
    mine = {(row["design"], row["rule"]) for row in rows}
    kept = [row for row in report["rows"] if "squared_bias" in row or (row["design"], row["rule"]) not in mine]
    print(write("sd_methods", rows + kept, **report["settings"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few shapes and runs; writes nothing")
    parser.add_argument("--methods", nargs="*", default=[], help="more methods, such as sobol+trapezoid")
    parser.add_argument("--add", nargs="*", default=[], help="methods whose errors join those in the JSON; no biases")
    arguments = parser.parse_args()
    quick = arguments.quick
    torch.set_num_threads(1)
    more = [registry.method(name, "sd") for name in arguments.methods]
    named = list(more)
    joint = trained_sampler("sd")
    if joint is not None:
        more += [(joint[0], rule) for rule in dict.fromkeys(("mc", joint[1], "sd-hermite", "inet-sd-uniform"))]
    structured = registry.method("structured", "sd")
    problem = held_out(10 if quick else 100)
    if arguments.add:
        add(problem, [registry.method(name, "sd") for name in arguments.add])
        return
    pairs = [(design, rule) for design in DESIGNS for rule in RULES] + [
        structured,
        (structured[0], "inet-sd-uniform"),
        *more,
    ]
    rows = rows_of("sd", problem, pairs)
    show("smoothed distances", rows)
    compared = [PLAIN, ("stratified", "mc"), ("random", "sd-hermite"), ("random", "inet-sd-uniform")]
    compared += [("stratified", "inet-sd-uniform"), structured, *named]
    compared += [joint] if joint is not None else []  # of a network's samples only what weighs them: they take long
    runs = check.integer("runs", 8 if quick else RUNS)
    small = held_out(2 if quick else 16, stride=2)
    biases = bias_rows(small, compared, runs)
    table = Table("samples", "rule", "MSE", "squared bias", "x MC", title=f"{runs} runs")
    for row in biases:
        ratio = f"> {row['ratio_at_least']:.3g}" if row["ratio"] is None else f"{row['ratio']:.3g}"
        cells = f"{row['mse']:.2e}", f"{row['squared_bias']:.2e}", ratio
        table.add_row(row["design"], row["rule"], *cells)
    Console(width=120).print(table)
    if quick:
        return
    write_cards(rows)
    print(write("sd_methods", rows + biases, n=N, seed=SEED, runs=runs, nearest=NEAREST))
    shown = [pair for pair in compared if pair[1] != "sd-hermite" or pair == ("random", "sd-hermite")]
    mse = {label((row["design"], row["rule"])): row["mse"] for row in rows}
    draw(maps(shown, 96, 1), "sd-fields.png", "smoothed distance, 32 samples: fields and squared errors", mse)
    bias = {label((row["design"], row["rule"])): row["squared_bias"] for row in biases}
    draw(maps(shown, 24, runs), "sd-bias.png", f"mean of {runs} runs: fields of one run and squared biases", bias)


if __name__ == "__main__":
    main()
