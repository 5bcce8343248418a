"""Where samples lie and what they weigh for a smoothed distance: Fig. 47 of the paper.

    python benchmarks/sd_strategy.py [--out FOLDER]

Draws docs/sd-strategy.png: three held-out shapes with a query (the star), the 32 samples of a design with the weights
that the network gives them, and the weights against what the plain mean would give. The paper finds more samples near
the query and smaller weights there; the structured method's own sampler and, once there is one, the trained sampler
show the first, and the network's weights on their samples the second.
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
from nqr_geom.curves.problems import SdProblem
from nqr_geom.streams import Stream

SHOWN = 3


def sampled(problem: SdProblem, pair: Pair) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (B, N, 2), weights and shares of the estimate W f / sum W f, (B, N) each."""
    with torch.no_grad():
        drawn = registry.make("sampler", pair[0]).draw(problem, N, Stream(SEED, "test", "samples/0"))
        samples, _ = problem.finalize(drawn)
        terms = registry.make("rule", pair[1]).combine(samples).weights.expand_as(samples.value)[..., 0, 0]
        share = terms * samples.value[..., 0, 0]
    at = samples.seen.features["relative"][:, :, 0] + problem.points[:, None]
    return at.numpy(), terms.numpy(), (share / share.sum(dim=1, keepdim=True)).numpy()


def chosen() -> SdProblem:
    """One query for each of the first held-out shapes, about a tenth of the square away from the curve."""
    problem = SdProblem.family(SHOWN, SEED, "test", resolution=16)
    truth = problem.reference()
    assert truth is not None
    picks = [np.abs(np.where(problem.groups == k, truth[:, 0], np.inf) - 0.2).argmin() for k in range(SHOWN)]
    return problem.take(torch.tensor(picks))


def draw(pairs: list[Pair], path: Path) -> None:
    """One row a design, one column a shape, and the weights against the distance from the query."""
    problem = chosen()
    picture = figure(3.3 * (SHOWN + 1), 3.2 * len(pairs))
    axes = picture.subplots(len(pairs), SHOWN + 1, squeeze=False)
    for row, pair in zip(axes, pairs, strict=True):
        at, weight, share = sampled(problem, pair)
        for k in range(SHOWN):
            panel = row[k]
            for piece in problem.curves[k].split_pieces(1):
                panel.plot(*piece.sample(np.linspace(0.0, 1.0 - 1e-9, 80)).T, color="0.7", lw=1.2, zorder=1)
            size = 12.0 + 160.0 * np.sqrt(np.maximum(share[k], 0.0))
            colour = np.log10(np.maximum(weight[k], 1e-2))
            dots = panel.scatter(
                *at[k].T, s=size, c=colour, cmap="coolwarm", vmin=-1.5, vmax=1.5, zorder=2, lw=0.3, ec="k"
            )
            panel.plot(*problem.points[k].numpy(), "*", color=SEVERAL[2], ms=13, zorder=3)
            panel.set(xticks=[], yticks=[], aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
        row[0].set_ylabel(f"{pair[0]}\n+ {pair[1]}", fontsize=9)
        away = np.linalg.norm(at - problem.points.numpy()[:, None], axis=-1)
        for k in range(SHOWN):
            row[-1].plot(away[k] - away[k].min(), np.maximum(weight[k], 1e-2), "o", ms=4, color=SEVERAL[k], alpha=0.7)
        row[-1].axhline(1.0, color="0.6", lw=0.8, ls="--")
        row[-1].set(yscale="log", ylabel="weight", xlabel="distance behind the nearest sample", ylim=(8e-3, 1e2))
        picture.colorbar(dots, ax=row[SHOWN - 1], shrink=0.8, label="log10 of the weight")
    picture.suptitle("samples (large: they make the estimate) and weights; dashed: the plain mean", fontsize=11)
    save(picture, path)


def summary(pairs: list[Pair]) -> list[dict[str, Any]]:
    """How many samples lie near the nearest point and what they weigh, over many queries."""
    problem = SdProblem.family(8, SEED, "test", resolution=16)
    rows = []
    for pair in pairs:
        at, weight, share = sampled(problem, pair)
        away = np.linalg.norm(at - problem.points.numpy()[:, None], axis=-1)
        near = away - away.min(axis=1, keepdims=True) < 1.0 / problem.alpha
        rows.append(
            {
                "design": pair[0],
                "rule": pair[1],
                "n": N,
                "near_share": float(near.mean()),
                "median_weight_near": float(np.median(weight[near])),
                "median_weight_far": float(np.median(weight[~near])),
                "estimate_from_near": float(np.median(np.where(near, share, 0.0).sum(axis=1))),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the picture; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    designs = ["random", "stratified", registry.method("structured", "sd")[0]]
    pairs: list[Pair] = [(design, "inet-sd-uniform") for design in designs]
    joint = trained_sampler("sd")
    pairs += [joint] if joint is not None else []
    draw(pairs, out / "sd-strategy.png")
    rows = summary(pairs)
    for row in rows:
        print(
            f"{row['design']}: {row['near_share']:.0%} of the samples within 1/alpha of the nearest, "
            f"weights {row['median_weight_near']:.3g} there, {row['median_weight_far']:.3g} elsewhere"
        )
    if out == DOCS:
        print(write("sd_strategy", rows, n=N, seed=SEED))


if __name__ == "__main__":
    main()
