"""Where samples of a transmittance lie and what they weigh, and errors as pictures: Figs. 48 and 49 of the paper.

    python benchmarks/transmittance_strategy.py [--out FOLDER]

24 queries a ray. Numbers are of rays through held-out clouds that meet density at all: how much of a ray's length and
of its samples lies where nothing absorbs, where the density changes, and where it is at its largest, and the mean
weight W there (1: plain Monte Carlo). The structured rule and the network on it have no weights to speak of: what they
answer is the expectation of the density between all samples. Two rays and three volumes are drawn.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from figures import DOCS, figure, save
from numpy.typing import NDArray
from shapes import write
from transmittance import ROWS, N, estimate, problem_of, truth

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.samplers import Grid
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.streams import Stream

Floats = NDArray[np.float64]
CLOUDS, RESOLUTION, DENSE, SIZE = 8, 16, 512, 48
METHODS = ("stratified", "structured", "inet", "nqr")
RAYS = {"through the thick of it": (4.2, 5.3), "through a small puff": (8.2, 3.0)}
SHOWN = ("random", "ratio tracking", "stratified", "trapezoid", "INet", "structured, bounds", "SNet + INet")
CLASSES = ("nothing", "changing", "full")
CLEAR, FULL = 1e-3, 0.999  # of the largest density


def ways() -> dict[str, tuple[str, str]]:
    """Those of the methods that there are."""
    return {m: registry.method(m, "transmittance") for m in METHODS if f"transmittance:{m}" in registry.ALIASES}


def looked(problem: TransmittanceProblem, pair: tuple[str, str]) -> tuple[Floats, Floats, Floats, Floats]:
    """Distance, density over the largest, and weight of every sample, (B, N) each, and transmittances (B,)."""
    with torch.no_grad():
        drawn = registry.make("sampler", pair[0]).draw(problem, N, Stream(0, "test", "samples/0"))
        samples, link = problem.finalize(drawn)
        result = registry.make("rule", pair[1]).combine(samples)
        answer = (result.link or link)(result.estimate(samples))
    features = samples.seen.features
    density = samples.value / features["optical_length"].clamp_min(1e-300)
    weights = result.weights.expand_as(samples.value)
    t = features["t"][..., 0].reshape(density.shape[:2])
    return t.numpy(), density[..., 0, 0].numpy(), weights[..., 0, 0].numpy(), answer[:, 0].numpy()


def kinds(density: Floats) -> list[NDArray[np.bool_]]:
    """Where nothing absorbs, where the density changes, where it is at its largest."""
    return [density < CLEAR, (density >= CLEAR) & (density <= FULL), density > FULL]


def weighs(weights: Floats) -> bool:
    """Whether the estimate is mainly made of weighted values."""
    return float(np.abs(weights).mean()) > 0.1


def summary(problem: TransmittanceProblem) -> list[dict[str, Any]]:
    """One row for the rays' length, one a method."""
    with torch.no_grad():
        dense = Grid().draw(problem, DENSE, Stream(0))
    along = (dense.value / dense.seen.features["optical_length"].clamp_min(1e-300))[..., 0, 0].numpy()
    hit = (along > CLEAR).any(axis=1)
    shares = {c: float(of[hit].mean()) for c, of in zip(CLASSES, kinds(along), strict=True)}
    rows: list[dict[str, Any]] = [{"method": "length of the rays", "shares": shares}]
    for name, pair in ways().items():
        _, density, weights, _ = looked(problem, pair)
        classes = dict(zip(CLASSES, kinds(density), strict=True))
        row = {"method": name, "n": N, "shares": {c: float(of[hit].mean()) for c, of in classes.items()}}
        if weighs(weights):
            row["weights"] = {c: float(weights[of & hit[:, None]].mean()) for c, of in classes.items()}
        rows.append(row)
    return rows


def draw_rays(path: Path) -> None:
    """Fig. 49: density along two rays with the samples of every method, coloured by their weight."""
    cloud = ng.datasets.volumes(1, seed=0)[0]
    origins = np.array([[*place, 0.0] for place in RAYS.values()])
    problem = TransmittanceProblem.of(cloud, origins, np.tile([0.0, 0.0, 1.0], (len(RAYS), 1)), 10.0)
    exact = ng.integrate(problem, 4096, method="stratified").value
    made = figure(12.5, 1.85 * len(ways()) + 0.9)
    axes = made.subplots(len(ways()), len(RAYS), sharex=True, sharey=True, squeeze=False)
    t, bar = np.linspace(0.0, 10.0, 2001), None
    for (name, pair), line in zip(ways().items(), axes, strict=True):
        at, density, weights, answers = looked(problem, pair)
        for k, (axis, place) in enumerate(zip(line, RAYS.values(), strict=True)):
            points = np.column_stack([np.full_like(t, place[0]), np.full_like(t, place[1]), t])
            axis.fill_between(t, cloud.components(points).density, color="0.88", lw=0)
            look: dict[str, Any] = {"c": "#D55E00"}
            if weighs(weights):
                look = {"c": weights[k], "cmap": "coolwarm", "vmin": 0.0, "vmax": 2.0}
            dots = axis.scatter(at[k], density[k], s=24, ec="black", lw=0.4, zorder=3, **look)
            bar = dots if weighs(weights) else bar
            axis.set_title(f"{name}: {answers[k]:.4f}, truth {exact[k, 0]:.4f}", fontsize=9)
            axis.set(xlim=(0, 10), ylim=(-0.06, 1.1))
        line[0].set_ylabel("density")
    for axis, name in zip(axes[-1], RAYS, strict=True):
        axis.set_xlabel(f"distance along the ray {name}")
    made.colorbar(bar, ax=axes, shrink=0.6, label="weight W (1: plain Monte Carlo)", extend="max")
    save(made, path)


def draw_errors(path: Path) -> None:
    """Fig. 48: three volumes, and what methods get wrong, with their mean squared errors."""
    sets = {"cloud": ng.datasets.volumes(1, seed=0)[0], "donut": ng.datasets.donut(), "letters": ng.datasets.letters()}
    made = figure(1.75 * (len(SHOWN) + 1), 1.95 * len(sets))
    axes = made.subplots(len(sets), len(SHOWN) + 1)
    for (label, volume), line in zip(sets.items(), axes, strict=True):
        answer, _ = truth([volume], SIZE)
        problem = problem_of([volume], SIZE, "bounds")
        line[0].imshow(answer.reshape(SIZE, SIZE).T, origin="lower", cmap="gray", vmin=0.0, vmax=1.0)
        line[0].set_ylabel(label)
        for axis, name in zip(line[1:], SHOWN, strict=True):
            method, support, _ = ROWS[name]
            assert support == "bounds"
            off = estimate(problem, method, 0).value[:, 0] - answer
            shown = axis.imshow(off.reshape(SIZE, SIZE).T, origin="lower", cmap="RdBu", vmin=-0.05, vmax=0.05)
            axis.set_xlabel(f"{(off**2).mean():.1e}", fontsize=9)
        for axis in line:
            axis.set(xticks=[], yticks=[])
    for axis, name in zip(axes[0], ("transmittance", *SHOWN), strict=True):
        axis.set_title(name.removesuffix(", bounds"), fontsize=9)
    made.colorbar(shown, ax=axes, shrink=0.7, label="error")
    save(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    rows = summary(problem_of(ng.datasets.volumes(CLOUDS, seed=0), RESOLUTION, "bounds"))
    for row in rows:
        print(row)
    draw_rays(out / "transmittance-strategy.png")
    draw_errors(out / "transmittance-errors.png")
    if out == DOCS:
        print(write("transmittance_strategy", rows, n=N, clouds=CLOUDS, resolution=RESOLUTION))


if __name__ == "__main__":
    main()
