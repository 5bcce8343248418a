"""Where adaptive samples go and what they weigh: Fig. 16 of the paper, for every sampler that looks before it places.

    python benchmarks/toy_strategy.py [--out FOLDER]

Draws docs/toy-strategy-NAME.png for four held-out integrands: the function with its breaks, the 32 samples in the order
in which they were placed (four new ones a line), the reweighted values, and the weights. The structured method keeps
what derivatives and breaks tell in an additive term, so its weights are those of the trapezoidal rule.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import SEED, N, Pair, trained_sampler
from figures import DOCS, SEVERAL, figure, save
from shapes import write

from nqr_geom import registry
from nqr_geom.streams import Stream
from nqr_geom.toy.problem import ToyProblem

SHOWN = 4
STEP = 4  # samples a line
NEAR = 0.01


def sampled(problem: ToyProblem, pair: Pair) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions in the order of placement, values and weights, (B, N) each."""
    with torch.no_grad():
        samples = registry.make("sampler", pair[0]).draw(problem, N, Stream(SEED, "test", "samples/0"))
        weights = registry.make("rule", pair[1]).combine(samples).weights.expand_as(samples.value)
    return samples.x[..., 0].numpy(), samples.value[..., 0, 0].numpy(), weights[..., 0, 0].numpy()


def breaks(problem: ToyProblem) -> np.ndarray:
    """Where the pieces meet, (B, 4)."""
    return problem.pieces.edges[:, 1:-1].numpy()


def draw(name: str, problem: ToyProblem, pair: Pair, folder: Path) -> None:
    """One column an integrand."""
    x, value, weight = sampled(problem, pair)
    edges = breaks(problem)
    picture = figure(14.0, 8.4)
    axes = picture.subplots(4, SHOWN, sharex=True, sharey="row", height_ratios=(1.3, 2.6, 1.1, 0.8))
    grid = np.linspace(0.0, 1.0, 4001)
    curve = problem.pieces.evaluate(torch.from_numpy(grid).expand(problem.batch, -1))
    f, piece = curve[0].numpy(), curve[2].numpy()
    for k in range(SHOWN):
        top, order, reweighted, weights = axes[:, k]
        for j in range(5):
            inside = piece[k] == j
            top.plot(grid[inside], f[k, inside], color=SEVERAL[j], lw=1.6)
        top.set_title(f"integrand {k + 1}", fontsize=10)
        for line, start in enumerate(range(0, N, STEP)):
            y = -float(line)
            order.plot(x[k, :start], np.full(start, y), "o", ms=3.0, color="#F3C9A5", zorder=2)
            order.plot(x[k, start : start + STEP], np.full(STEP, y), "o", ms=5.0, color=SEVERAL[1], zorder=3)
            order.axhline(y, color="0.9", lw=0.8, zorder=0)
        reweighted.vlines(x[k], 0.0, weight[k] * value[k], color="#F3C9A5", lw=0.9)
        reweighted.plot(x[k], weight[k] * value[k], "o", ms=3.5, color=SEVERAL[1])
        weights.vlines(x[k], 0.0, weight[k], color="#A9CCE3", lw=0.9)
        weights.plot(x[k], weight[k], "o", ms=3.5, color=SEVERAL[0])
        for panel in axes[:, k]:
            for at in edges[k]:
                panel.axvline(at, color="0.55", lw=0.7, ls="--", zorder=1)
        weights.set_xlabel("x")
        weights.set_xlim(-0.01, 1.01)
    axes[1, 0].set_yticks([-line for line in range(N // STEP)], [f"{i} to {i + STEP}" for i in range(0, N, STEP)])
    for line, text in enumerate(("f", "samples in order", "W f", "W")):
        axes[line, 0].set_ylabel(text)
    picture.suptitle(f"{name}: {pair[0]} + {pair[1]}; dashed: the breaks, which are not told", fontsize=11)
    save(picture, folder / f"toy-strategy-{name}.png")


def summary(name: str, problem: ToyProblem, pair: Pair) -> dict[str, Any]:
    """How close samples come to the breaks, over many integrands."""
    x = sampled(problem, pair)[0]
    off = np.abs(x[:, :, None] - breaks(problem)[:, None]).min(axis=2)
    gap = np.abs(x[:, :, None] - breaks(problem)[:, None]).min(axis=1)
    return {
        "method": name,
        "n": N,
        "near_by_fours": [float((off[:, i : i + STEP] < NEAR).mean()) for i in range(0, N, STEP)],
        "median_distance_of_breaks": float(np.median(gap)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    pairs: dict[str, Pair | None] = {"structured": registry.method("structured", "toy"), "nqr": trained_sampler("toy")}
    there = {name: pair for name, pair in pairs.items() if pair is not None}
    for name, pair in there.items():
        draw(name, ToyProblem.family(SHOWN, SEED, "test"), pair, out)
    many = ToyProblem.family(2000, SEED, "test")
    rows = [summary(name, many, pair) for name, pair in {"stratified": ("stratified", "mc"), **there}.items()]
    for row in rows:
        near = ", ".join(f"{share:.0%}" for share in row["near_by_fours"])
        print(f"{row['method']}: within {NEAR} of a break {near}; nearest {row['median_distance_of_breaks']:.1e}")
    if out == DOCS:
        print(write("toy_strategy", rows, n=N, seed=SEED, integrands=many.batch, near=NEAR))


if __name__ == "__main__":
    main()
