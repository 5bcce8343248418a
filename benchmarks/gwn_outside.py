"""Shapes outside the training family (Fig. 25): all pieces together, or in parts of at most six pieces.

    python benchmarks/gwn_outside.py [--quick]

A house (5 segments), an impossible triangle (18), two knots (30 quadratics) and outlines of glyphs; the networks know
at most six pieces. "decomp" gives every part of at most six pieces 32 samples and adds up the answers; "together" shows
networks the whole curve with piece indices modulo six, and averages as many independent estimates of 32 samples as
there are parts. Monte Carlo spends as many samples on the whole. Draws docs/gwn-outside.png: fields and errors.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparison import LEARNED, SEED, N, Pair, pairs_for, rule_named, trained_sampler
from figures import DOCS, figure, save
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import write

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.families import house, impossible, knots
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.learn.zoo import Model
from nqr_geom.integrator.rules import Rule

SIX = 6
NEAREST = 1e-3
PIXELS = 96
FLOOR = 1e-4  # errors below it look alike
Floats = NDArray[np.float64]


def glyph(text: str) -> ng.Curve:
    """The outline of a character, as wide or high as most of [-1, 1]^2."""
    curve = ng.Curve.from_text(text)
    x0, y0, x1, y1 = curve.bounds
    fit = 1.6 / max(x1 - x0, y1 - y0)
    return curve.transformed([[fit, 0.0], [0.0, fit]], [-0.5 * fit * (x0 + x1), -0.5 * fit * (y0 + y1)])


def shapes() -> dict[str, ng.Curve]:
    """Everything that is measured, by name."""
    plain = {"house": house(), "impossible": impossible(), "knots": knots()}
    return plain | {f"glyph {text}": glyph(text) for text in ("S", "&")}


def grid(pixels: int) -> Floats:
    """Centres of a grid over [-1, 1]^2, x running fastest."""
    line = (np.arange(pixels) + 0.5) * (2.0 / pixels) - 1.0
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def without_limits(rule: Rule) -> Rule:
    """A network without its card's limits: it takes piece indices modulo those it knows."""
    return rule.learned if isinstance(rule, Model) else rule


def monte_carlo(problem: GwnProblem, parts: int, seed: int) -> Floats:
    """Plain Monte Carlo on the whole, with as many samples as all parts get."""
    return run(problem, registry.make("sampler", "random"), registry.make("rule", "mc"), N * parts, seed=seed).value


def together(problem: GwnProblem, pair: Pair, parts: int, seed: int) -> Floats:
    """The mean of as many estimates of the whole as there are parts."""
    sampler, rule = registry.make("sampler", pair[0]), without_limits(rule_named(pair[1]))
    return run(problem, sampler, rule, N, replicates=parts, seed=seed).value


def decomposed(curve: ng.Curve, problem: GwnProblem, pair: Pair, seed: int) -> Floats:
    """The sum over parts; every part has rows of its own, so that no two share their random numbers."""
    sampler, rule = registry.make("sampler", pair[0]), rule_named(pair[1])
    total = np.zeros((problem.batch, 1))
    for k, part in enumerate(curve.split_pieces(SIX)):
        piece = replace(GwnProblem.of(part, problem.points.numpy()), rows=problem.rows + 2**40 * k)
        total += run(piece, sampler, rule, N, seed=seed).value
    return total


def rows_of(label: str, curve: ng.Curve, pixels: int, runs: int) -> list[dict[str, Any]]:
    """One row for each strategy and pair; intervals over runs."""
    points = grid(pixels)
    problem = GwnProblem.of(curve, points[ng.distance(curve, points) >= NEAREST])
    parts, truth = len(curve.split_pieces(SIX)), problem.reference()
    seeds = [SEED + parts * r for r in range(runs)]
    bootstrap = Bootstrap.of(problem.groups, runs, SEED)

    def row(strategy: str, pair: Pair, answers: list[Floats]) -> dict[str, Any]:
        e = np.concatenate([(answer - truth) ** 2 for answer in answers], axis=1)
        return {
            "problem": f"{label}, {curve.n_pieces} pieces",
            "strategy": strategy,
            "design": pair[0],
            "rule": pair[1],
            "samples": N * parts,
            "mse": float(e.mean()),
            "median": float(np.median(e)),
            "p99": float(np.quantile(e, 0.99)),
            "ratio": float(plain.mean() / e.mean()),
            "ratio_interval": bootstrap.ratio(plain, e),
        }

    whole = [monte_carlo(problem, parts, seed) for seed in seeds]
    plain = np.concatenate([(answer - truth) ** 2 for answer in whole], axis=1)
    rows = [row("together", ("random", "mc"), whole)]
    for pair in pairs_for("gwn", ()):
        if parts > 1:
            rows.append(row("together", pair, [together(problem, pair, parts, seed) for seed in seeds]))
        rows.append(row("decomp", pair, [decomposed(curve, problem, pair, seed) for seed in seeds]))
    return rows


def fields(curve: ng.Curve, pair: Pair) -> Mapping[str, Floats]:
    """What one line of the picture shows, each (PIXELS^2,)."""
    problem = GwnProblem.of(curve, grid(PIXELS))
    parts = len(curve.split_pieces(SIX))
    base = (pair[0], LEARNED["gwn"][0])
    return {
        "exact": ng.gwn(curve, grid(PIXELS)),
        "Monte Carlo": monte_carlo(problem, parts, SEED)[:, 0],
        "network, together": together(problem, pair, parts, SEED)[:, 0],
        "network, decomp": decomposed(curve, problem, pair, SEED)[:, 0],
        "structure-aware, decomp": decomposed(curve, problem, base, SEED)[:, 0],
    }


def draw(path: Path, pair: Pair) -> None:
    """One line a shape: the field, and errors of four methods with one range of colours."""
    from matplotlib.colors import LogNorm

    curves = {name: curve for name, curve in shapes().items() if name != "glyph S"}
    picture = figure(14.0, 2.75 * len(curves) + 0.7)
    axes = picture.subplots(len(curves), 5)
    look: dict[str, Any] = {"origin": "lower", "extent": (-1, 1, -1, 1), "interpolation": "nearest"}
    for line, (label, curve) in zip(axes, curves.items(), strict=True):
        shown = fields(curve, pair)
        outline = curve.to_polyline(1e-3).control[:, :2]
        parts = len(curve.split_pieces(SIX))
        far = (ng.distance(curve, grid(PIXELS)) >= NEAREST).reshape(PIXELS, PIXELS)
        for panel, (title, values) in zip(line, shown.items(), strict=True):
            values = values.reshape(PIXELS, PIXELS)
            if title == "exact":
                field = panel.imshow(values, cmap="RdBu_r", vmin=-2, vmax=2, **look)
                panel.set_ylabel(f"{label}: {curve.n_pieces} pieces,\n{N * parts} samples", fontsize=9)
            else:
                off = np.abs(values - shown["exact"].reshape(PIXELS, PIXELS))
                error = panel.imshow(off.clip(FLOOR), cmap="magma", norm=LogNorm(FLOOR, 1.0), **look)
                title = f"{title}\nMSE {np.mean(off[far] ** 2):.1e}"
            for a, b in outline:
                panel.plot(*zip(a, b, strict=True), color="0.1" if panel is line[0] else "0.75", lw=0.6)
            panel.set(xticks=[], yticks=[], xlim=(-1, 1), ylim=(-1, 1))
            panel.set_title("winding number" if title == "exact" else title, fontsize=9)
    picture.colorbar(field, ax=axes[:, 0], location="bottom", shrink=0.9, aspect=22, pad=0.01)
    bar = picture.colorbar(error, ax=axes[:, 1:], location="bottom", shrink=0.5, aspect=50, pad=0.01, extend="both")
    bar.set_label("absolute error")
    picture.suptitle(f"shapes outside the training family, {pair[0]} samples, {pair[1]}", fontsize=11)
    save(picture, path)


def show(rows: list[dict[str, Any]]) -> None:
    """Print the rows as a table."""
    table = Table("shape", "strategy", "samples", "rule", "MSE", "median", "p99", "x MC", "95%")
    for row in rows:
        cells = [f"{row[key]:.2e}" for key in ("mse", "median", "p99")]
        low, high = row["ratio_interval"]
        names = [row[key] for key in ("problem", "strategy", "design", "rule")]
        table.add_row(*names, *cells, f"{row['ratio']:.3g}", f"{low:.3g} .. {high:.3g}")
    Console(width=150).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a coarse grid and two runs; writes no results")
    parser.add_argument("--out", type=Path, help="the picture, by default docs/gwn-outside.png; none with --quick")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    pixels, runs = (8, 2) if arguments.quick else (16, 5)
    rows = [row for label, curve in shapes().items() for row in rows_of(label, curve, pixels, runs)]
    show(rows)
    out = arguments.out or (None if arguments.quick else DOCS / "gwn-outside.png")
    if out is not None:
        draw(out, trained_sampler("gwn") or ("random", LEARNED["gwn"][2]))
    if not arguments.quick:
        print(write("gwn_outside", rows, n=N, seed=SEED, pixels=pixels, runs=runs, nearest=NEAREST))


if __name__ == "__main__":
    main()
