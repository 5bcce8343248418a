"""Transmittance through the clouds of Fig. 40, a donut and letters, 24 queries a ray (Table 12, Figs. 28 and 29).

    python benchmarks/transmittance.py [--quick] [--networks]

Mean squared errors beside the paper's ratios, with 95% bootstrap intervals over clouds; squared bias from 256 runs; the
queries and noise evaluations that were needed. References are unbiased marches with 2048 queries, and the difference of
two independent ones says how far off they are. "independent jitter" draws every step's place anew; "pieces" marches
only where the balls and their noise can reach. The networks were trained on other clouds of the family, and on no ring
or letter; `learned_transmittance.py` shows them beside other rules on the same samples. Their biases are of 16 x 16
rays, of which those that meet no coat of a shape count as right. --networks measures these alone and keeps the rest.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import RESULTS, write

import nqr_geom as ng
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.render import estimators
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.unbiased import march
from nqr_geom.render.volume import Volume
from nqr_geom.render.volume_families import view
from nqr_geom.streams import Stream

Floats = NDArray[np.float64]
N = 24
BIASED = ("random", "stratified", "trapezoid", "cubic regression", "jackknife", "structured")
NETWORKS = ("INet", "SNet + INet")
PICTURE = Path(__file__).parents[1] / "docs" / "transmittance.png"
# Row, method, support, and the paper's mean squared errors: test scenes, donut, letters (Tables 4 and 12).
ROWS: dict[str, tuple[str, str, tuple[float, float, float] | None]] = {
    "random": ("random", "bounds", (7.49e-3, 6.67e-3, 5.33e-3)),
    "track length": ("track-length", "bounds", (1.71e-2, 1.63e-2, 1.10e-2)),
    "ratio tracking": ("ratio", "bounds", (9.38e-3, 8.46e-3, 7.27e-3)),
    "trapezoid": ("trapezoid", "bounds", (1.33e-4, 8.21e-5, 5.84e-5)),
    "cubic regression": ("regression", "bounds", (1.63e-4, 8.81e-5, 6.49e-5)),
    "stratified": ("stratified", "bounds", (1.50e-4, 8.57e-5, 5.82e-5)),
    "jackknife": ("jackknife", "bounds", (6.65e-4, 3.79e-4, 2.60e-4)),
    "unbiased ray marching": ("unbiased-raymarching", "bounds", None),
    "independent jitter": ("stratified+mc", "bounds", None),
    "stratified, pieces": ("stratified", "pieces", None),
    "INet": ("inet", "bounds", (1.05e-4, 7.75e-5, 1.85e-4)),
    "SNet + INet": ("nqr", "bounds", (2.39e-5, 1.30e-5, 3.99e-5)),
    "INet, pieces": ("inet", "pieces", None),
    "SNet + INet, pieces": ("nqr", "pieces", None),
    "structured, bounds": ("structured", "bounds", None),
    "structured": ("structured", "pieces", None),
}


def problem_of(volumes: list[Volume], resolution: int, support: str) -> TransmittanceProblem:
    """Every volume seen through the same grid of rays along z."""
    return TransmittanceProblem.of(volumes, *view(volumes[0], resolution), support=support)


def estimate(problem: TransmittanceProblem, method: str, seed: int) -> Any:
    if method in estimators.TRACKERS:
        return estimators.tracked(problem, method, N, seed)
    return ng.integrate(problem, N, method=method, seed=seed)


def truth(volumes: list[Volume], resolution: int) -> tuple[Floats, float]:
    """References (B,) and their mean squared error."""
    problem = problem_of(volumes, resolution, "pieces")
    one, two = (march(problem, 2048, Stream(seed, "validation", "benchmark")).value.numpy() for seed in (0, 1))
    return 0.5 * (one + two), float(((one - two) ** 2).mean() / 4.0)


def measure(name: str, place: int, volumes: list[Volume], resolution: int, runs: int) -> list[dict[str, Any]]:
    """One row a method, for one set of volumes."""
    answer, reference_mse = truth(volumes, resolution)
    problems = {support: problem_of(volumes, resolution, support) for support in ("bounds", "pieces")}
    errors, rows = {}, []
    resample = Bootstrap.of(problems["bounds"].groups, runs, 0)
    for row, (method, support, paper) in ROWS.items():
        made = [estimate(problems[support], method, seed) for seed in range(runs)]
        errors[row] = np.stack([(e.value[:, 0] - answer) ** 2 for e in made], axis=1)
        mse = float(errors[row].mean())
        low, high = resample.ratio(errors["random"], errors[row])
        paper_ratio = paper and ROWS["random"][2][place] / paper[place]
        ratio = float(errors["random"].mean()) / mse
        rays = problems[support].batch * runs
        rows.append({
            "set": name, "method": row, "mse": mse, "median": float(np.median(errors[row])),
            "p99": float(np.quantile(errors[row], 0.99)), "paper_mse": paper and paper[place], "ratio": ratio,
            "ratio_interval": [low, high], "paper_ratio": paper_ratio,
            "ratio_off": paper_ratio and ratio / paper_ratio - 1.0,
            "queries_a_ray": sum(e.counts["queries"] for e in made) / rays,
            "noise_a_ray": sum(e.counts["noise"] for e in made) / rays,
            "us_a_ray": 1e6 * min(e.seconds for e in made) / problems[support].batch,
            "reference_mse": reference_mse,
        })  # fmt: skip
    return rows


def bias(
    name: str, volume: Volume, resolution: int, runs: int, methods: tuple[str, ...]
) -> tuple[list[dict[str, Any]], dict[str, Floats]]:
    """Squared bias of each biased method from the mean of many runs, their own noise taken off; and the images.

    Rays that nothing can meet are not asked about where networks are; all count in the means.
    """
    answer, _ = truth([volume], resolution)
    whole = problem_of([volume], resolution, "pieces").rays
    asked = np.arange(whole.batch) if methods != NETWORKS else np.flatnonzero(whole.total.numpy() > 0.0)
    answer, counted = answer[asked], len(asked) / whole.batch
    rows, images = [], {"reference": answer}
    for row in methods:
        method, support, _ = ROWS[row]
        problem = problem_of([volume], resolution, support).take(torch.from_numpy(asked))
        values = np.stack([estimate(problem, method, seed).value[:, 0] for seed in range(runs)])
        mean, noise = values.mean(axis=0), values.var(axis=0, ddof=1) / runs
        rows.append({"set": name, "method": row, "rays": len(answer),
                     "bias2": counted * float(((mean - answer) ** 2 - noise).mean()),
                     "noise": counted * float(noise.mean()),
                     "mse": counted * float(((values - answer) ** 2).mean())})  # fmt: skip
        images[f"{row}: one run"] = values[0] - answer
        images[f"{row}: mean of {runs}"] = mean - answer
    return rows, images


def show(biases: list[dict[str, Any]]) -> None:
    for r in biases:
        print(f"{r['set']:8} {r['method']:18} bias^2 {r['bias2']:.2e}  (noise of the mean {r['noise']:.1e})")


def picture(images: dict[str, Floats], resolution: int) -> None:
    """The cloud, errors of one run above and of the mean of all runs below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = ["random", "stratified", "cubic regression", "jackknife", "structured"]
    runs = next(key for key in images if "mean of" in key).rpartition(" ")[2]
    figure, axes = plt.subplots(2, len(names) + 1, figsize=(2.1 * (len(names) + 1), 4.6), layout="constrained")
    shown = axes[0, 0].imshow(
        images["reference"].reshape(resolution, -1).T, origin="lower", cmap="gray", vmin=0, vmax=1
    )
    axes[0, 0].set_title("transmittance")
    figure.colorbar(shown, ax=axes[1, 0], location="top", shrink=0.8)
    axes[1, 0].set_visible(True)
    for k, name in enumerate(names, start=1):
        for line, (kind, limit) in enumerate((("one run", 0.1), (f"mean of {runs}", 0.01))):
            image = images[f"{name}: {kind}"].reshape(resolution, -1).T
            drawn = axes[line, k].imshow(image, origin="lower", cmap="RdBu", vmin=-limit, vmax=limit)
        axes[0, k].set_title(name)
    figure.colorbar(drawn, ax=axes[1, :], shrink=0.7, label="error of the mean: bias")
    for line, label in ((0, "error of one run, $\\pm$0.1"), (1, f"mean of {runs} runs, $\\pm$0.01")):
        axes[line, 1].set_ylabel(label)
    for axis in axes.ravel():
        axis.set(xticks=[], yticks=[])
    axes[1, 0].axis("off")
    figure.savefig(PICTURE, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer clouds, rays and runs")
    parser.add_argument("--networks", action="store_true", help="only the networks' biases; other rows are kept")
    arguments = parser.parse_args()
    quick = arguments.quick
    torch.set_num_threads(1)
    clouds, resolution, runs, many = (4, 16, 2, 16) if quick else (16, 32, 4, 256)
    sets: dict[str, Callable[[], list[Volume]]] = {
        "clouds": lambda: ng.datasets.volumes(clouds, seed=0),
        "donut": lambda: [ng.datasets.donut()],
        "letters": lambda: [ng.datasets.letters()],
    }
    if arguments.networks:
        kept = json.loads((RESULTS / "transmittance.json").read_text())
        rest = [r for r in kept["rows"] if not ("bias2" in r and r["method"] in NETWORKS)]
        found = [r for name, volumes in sets.items() for r in bias(name, volumes()[0], 16, many, NETWORKS)[0]]
        show(found)
        if not quick:
            write("transmittance", rest + found, **kept["settings"])
        return
    rows, table = [], Table("set", "method", "MSE", "x random", "95%", "paper", "queries", "noise", "us / ray")
    for place, (name, volumes) in enumerate(sets.items()):
        measured = measure(name, place, volumes(), resolution, runs)
        rows += measured
        for r in measured:
            table.add_row(
                name, r["method"], f"{r['mse']:.2e}", f"{r['ratio']:.3g}",
                "{:.3g} .. {:.3g}".format(*r["ratio_interval"]),
                f"{r['paper_ratio']:.3g} ({r['ratio_off']:+.0%})" if r["paper_ratio"] else "",
                f"{r['queries_a_ray']:.1f}", f"{r['noise_a_ray']:.1f}", f"{r['us_a_ray']:.1f}",
            )  # fmt: skip
    Console(width=120).print(table)
    biases = []
    for name, volumes in sets.items():
        found, images = bias(name, volumes()[0], resolution if name == "clouds" else 16, many, BIASED)
        biases += found + bias(name, volumes()[0], 16, many, NETWORKS)[0]
        if name == "clouds" and not quick:
            picture(images, resolution)
    show(biases)
    settings = {"clouds": clouds, "resolution": resolution, "runs": runs, "bias_runs": many, "queries": N}
    print(write("transmittance", rows + biases, **settings))


if __name__ == "__main__":
    main()
