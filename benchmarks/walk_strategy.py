"""Where walks go and what they weigh: Figs. 34 and 35 of the paper.

    python benchmarks/walk_strategy.py [--out FOLDER]

Draws docs/walk-strategy.png: the 32 walks of each sampler from one query, and their first two directions. Then
docs/walk-weights.png: walks from several queries, their ends coloured by what the network's own rule makes of them,
1 being what the plain mean does. What a network gives to closest points on the way is counted in the table alone.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import SEED, N
from figures import DOCS, figure, outlined, save
from numpy.typing import NDArray
from scipy.stats import spearmanr
from shapes import write

from nqr_geom import registry
from nqr_geom.integrator.learn.inet import LearnedRule, UniformWeights, correct
from nqr_geom.integrator.problem import Samples
from nqr_geom.streams import Stream
from nqr_geom.wos.families import polygons
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.record import ALIVE, SEEN
from nqr_geom.wos.tokens import boundary_values

Floats = NDArray[np.float64]

SHAPE = 3  # of the held-out ones
QUERIES = np.array([[0.05, 0.0], [-0.2, 0.25], [0.3, -0.1]])
LIMIT = 1.2  # weights beyond it share the last colour


def samplers() -> dict[str, str]:
    """What is compared: a title and a sampler."""
    named = {"random": "random", "Latin hypercube": "latin-hypercube", "walk-spread": "walk-spread"}
    if "laplace:nqr" in registry.ALIASES:
        named["SNet"] = registry.method("nqr", "laplace")[0]
    return named


def drawn(problem: LaplaceProblem, sampler: str) -> Samples:
    """32 walks from every query."""
    with torch.no_grad():
        return registry.make("sampler", sampler).draw(problem, N, Stream(SEED, "test", "samples/0"))


def paths(samples: Samples, query: int, start: Floats) -> list[Floats]:
    """The corners of each walk in the domain's frame, its end last."""
    steps = samples.seen.features["steps"][query, :, 0].unflatten(-1, (-1, sum(SEEN.values()))).numpy()
    end = samples.seen.features["end"][query, :, 0, :2].numpy()
    made = []
    for walk, last in zip(steps, end, strict=True):
        there = walk[walk[:, ALIVE] > 0.0]
        made.append(start + np.concatenate([there[:, 5:7] - there[:, :2], last[None]]))
    return made


def straightness(samples: Samples) -> float:
    """Mean over walks of the way from query to end over the length of the walk."""
    ratios = []
    for query in range(len(samples.x)):
        for path in paths(samples, query, np.zeros(2)):
            length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
            ratios.append(np.linalg.norm(path[-1] - path[0]) / length if length > 0.0 else 1.0)
    return float(np.mean(ratios))


def evenness(samples: Samples) -> float:
    """Largest gap between neighbouring ends along the boundary, as a part of it; the mean over queries."""
    around = samples.seen.features["loops"][:, 0, 0, -1:].numpy()
    at = np.sort(samples.seen.features["end"][:, :, 0, 3].numpy() / around, axis=1)
    gaps = np.diff(np.concatenate([at, at[:, :1] + 1.0], axis=1), axis=1)
    return float(gaps.max(axis=1).mean())


def own_weights(samples: Samples, rule: LearnedRule) -> tuple[Floats, Floats]:
    """What the network's own rule gives to the end of each walk and to the points on its way, (B, N) each."""
    value = samples.value.clone().requires_grad_()
    known = boundary_values(samples).flatten(2)[:, :, None].clone().requires_grad_()
    seen = replace(samples.seen, value=value, features={**samples.seen.features, "known": known})
    watched = replace(samples, seen=seen)
    raw, config = rule._raw(samples), rule.net.config
    if config.gated:
        raw, config = raw[..., :-1], replace(config, gated=False)
    correct(raw, UniformWeights().combine(watched), watched, config, rule.extra).estimate(watched).sum().backward()
    assert value.grad is not None
    assert known.grad is not None
    alive = samples.seen.features["steps"][..., ALIVE :: sum(SEEN.values())][:, :, 0] > 0.0  # (B, N, D)
    ways = known.grad[:, :, 0]
    n = samples.n
    ends = n * (value.grad[:, :, 0, 0] + (ways * ~alive).sum(dim=2))
    return ends.numpy(), n * (ways * alive).sum(dim=2).numpy()


def draw_walks(problem: LaplaceProblem, path: Path) -> None:
    """Fig. 34: walks from the first query, and their first two directions."""
    named = samplers()
    made = figure(3.0 * len(named), 6.0)
    axes = made.subplots(2, len(named), height_ratios=(1.15, 1.0))
    start = problem.points[0].numpy()
    for (above, below), (title, sampler) in zip(axes.T, named.items(), strict=True):
        samples = drawn(problem, sampler)
        outlined(above, problem.boundaries[0].domain.start, 1.2)
        for corners in paths(samples, 0, start):
            above.plot(*corners.T, color="#0072B2", lw=0.8, alpha=0.55, zorder=2)
            above.plot(*corners[-1], "o", ms=4.5, color="#D55E00", mec="black", mew=0.4, zorder=4)
        above.plot(*start, "*", ms=14, color="#009E73", mec="black", mew=0.7, zorder=5)
        above.set_title(title, fontsize=11)
        x = samples.x[0, :, :2].numpy()
        below.plot(*x.T, "o", ms=5, color="#0072B2", mec="black", mew=0.4)
        below.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
        below.set_xlabel("first direction, turns")
        below.grid(alpha=0.3)
    axes[1, 0].set_ylabel("second direction, turns")
    save(made, path)


def draw_weights(problem: LaplaceProblem, rules: dict[str, tuple[str, LearnedRule]], path: Path) -> None:
    """Fig. 35: ends coloured by weight, one line a network and one column a query."""
    made = figure(3.4 * len(QUERIES), 3.4 * len(rules) + 0.7)
    axes = made.subplots(len(rules), len(QUERIES), squeeze=False)
    for line, (title, (sampler, rule)) in zip(axes, rules.items(), strict=True):
        samples = drawn(problem, sampler)
        weights = own_weights(samples, rule)[0]
        for k, axis in enumerate(line):
            outlined(axis, problem.boundaries[0].domain.start, 1.2)
            start = problem.points[k].numpy()
            ends = np.array([corners[-1] for corners in paths(samples, k, start)])
            for corners in paths(samples, k, start):
                axis.plot(*corners.T, color="0.8", lw=0.6, zorder=0)
            look = {"cmap": "YlOrRd", "vmin": 0.0, "vmax": LIMIT, "edgecolors": "black"}
            dots = axis.scatter(*ends.T, c=weights[k], s=38, linewidths=0.5, zorder=4, **look)
            axis.plot(*start, "*", ms=14, color="#009E73", mec="black", mew=0.7, zorder=5)
        line[0].set_ylabel(title, fontsize=11)
    bar = made.colorbar(dots, ax=axes, location="bottom", shrink=0.5, aspect=40, pad=0.02, extend="both")
    bar.set_label("weight of an end (1: plain mean); the rest goes to closest points on the way")
    save(made, path)


def summary(problem: LaplaceProblem, rules: dict[str, tuple[str, LearnedRule]]) -> list[dict[str, Any]]:
    """How straight walks are, how even their ends, and what near and far ends weigh, over queries of many polygons."""
    rows = []
    of = {sampler: (title, rule) for title, (sampler, rule) in rules.items()}
    for title, sampler in samplers().items():
        samples = drawn(problem, sampler)
        line: dict[str, Any] = {
            "method": title, "n": N, "straightness": straightness(samples), "largest_gap": evenness(samples),
        }  # fmt: skip
        if sampler in of:
            ends, ways = own_weights(samples, of[sampler][1])
            away = samples.seen.features["end"][:, :, 0, :2].norm(dim=2).numpy()
            ranks = [spearmanr(a, w).statistic for a, w in zip(away, ends, strict=True)]
            line |= {"network": of[sampler][0], "rank_correlation": float(np.mean(ranks)),
                     "share_of_ways": float(ways.mean())}  # fmt: skip
        rows.append(line)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    vertices, values = (part[SHAPE] for part in polygons(SHAPE + 1, SEED))
    problem = LaplaceProblem.of(vertices, values, QUERIES)
    rules = {"INet on random walks": ("random", registry.make("model", "laplace-uniform").learned),
             "INet on walk-spread": ("walk-spread", registry.make("model", "laplace-spread").learned)}  # fmt: skip
    if "laplace:nqr" in registry.ALIASES:
        rules["SNet + INet"] = (samplers()["SNet"], registry.make("model", "laplace-nqr").learned)
    draw_walks(problem, out / "walk-strategy.png")
    draw_weights(problem, rules, out / "walk-weights.png")
    rows = summary(LaplaceProblem.family(20, SEED, points=16), rules)
    for row in rows:
        print(row)
    if out == DOCS:
        print(write("walk_strategy", rows, n=N, seed=SEED))


if __name__ == "__main__":
    main()
