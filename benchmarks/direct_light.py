"""Direct light: errors of the classical and the structured methods in the layout of Tables 3 and 10.

    python benchmarks/direct_light.py [--quick]

Scenes of Fig. 39 that nothing was trained on, and scenes outside the family, at 16 passes a pixel. Errors are means of
squares over pixels, channels and seeds against 4,096 passes of another seed; ratios are of means over all scenes, with
a 95% interval by a bootstrap over scenes. PSNR and SSIM (scikit-image, not a dependency) where it is installed.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from comparison import trained_sampler
from figures import DOCS, figure, save
from learned import write_cards
from page import short
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import recipes, registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.learn.snet import LearnedSampler
from nqr_geom.integrator.samplers import Sampler
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.film import exposed
from nqr_geom.render.scene_gallery import gallery

PASSES = 16
JOINT = "SNet + INet"
METHODS = {
    "MC random": ("random", "balance-heuristic"),
    "Poly random": ("random", "direct-regression-1"),
    "MC stratified": ("pmj", "balance-heuristic"),
    "Poly stratified": ("pmj", "direct-regression-1"),
    "closed forms": ("pmj", "direct-unhidden"),
    "known light": ("pmj", "direct-known"),
    "structured": ("lamp-spread", "direct-known"),
    "known light, random": ("random", "direct-known"),
    "MC, lamp-spread": ("lamp-spread", "balance-heuristic"),
    "INet random": ("random", "inet-direct-mis"),
    "INet stratified": ("pmj", "inet-direct-mis"),
    "INet": ("lamp-spread", "inet-direct-mis"),
}
PAIR = trained_sampler("direct")
UNTRAINED = "MC, untrained SNet"  # where the pair began: stratified rounds
if PAIR is not None:
    METHODS |= {UNTRAINED: ("untrained", "balance-heuristic"), "MC, SNet": (PAIR[0], "balance-heuristic"),
                "known light, SNet": (PAIR[0], "direct-known"), JOINT: PAIR}  # fmt: skip
# What a network is measured against: sampler and rule that it began as.
BEGAN = {"INet random": "MC random", "INet stratified": "MC stratified", "INet": "MC, lamp-spread", JOINT: UNTRAINED}
# Means of Table 10, as multiples of random Monte Carlo's error taken from it.
PAPER = {"MC random": 1.0, "Poly random": 0.34, "MC stratified": 4.1, "Poly stratified": 0.45, "INet random": 9.2,
         "INet stratified": 16.6, JOINT: 30.4}  # fmt: skip
SHOWN = ("MC random", "MC stratified", "structured", "INet random", "INet", JOINT)  # as pictures
OUTSIDE = ("teaser", "white-room", "living-room", "staircase", "plates")


def untrained() -> Sampler:
    """The sampling network of the pair before training."""
    return LearnedSampler(recipes.JOINT["direct-nqr"].snet().eval())


def errors(problem: DirectProblem, seeds: int) -> dict[str, Any]:
    """Squared errors (seeds, pixels, 3) and the last picture by method."""
    from nqr_geom.integrator.rules import BalanceHeuristic
    from nqr_geom.integrator.samplers import Pmj

    truth = run(problem, Pmj(), BalanceHeuristic(), 256, replicates=16, seed=2**30).value
    found: dict[str, Any] = {"truth": truth}
    for name, (sampler, rule) in METHODS.items():
        pair = untrained() if sampler == "untrained" else registry.make("sampler", sampler), registry.make("rule", rule)
        pictures = np.stack([run(problem, *pair, PASSES, seed=seed).value for seed in range(seeds)])
        found[name] = (pictures - truth) ** 2
        found[name, "picture"] = pictures[0]
    return found


def quality(picture: Any, truth: Any, size: int) -> dict[str, float]:
    """PSNR and SSIM of pictures as they are shown."""
    try:
        from skimage.metrics import peak_signal_noise_ratio, structural_similarity
    except ModuleNotFoundError:
        return {}
    white = float(np.quantile(truth.max(axis=-1), 0.97)) or 1.0
    a, b = (exposed(image.reshape(size, size, 3), white) for image in (picture, truth))
    return {
        "psnr": float(peak_signal_noise_ratio(b, a, data_range=1.0)),
        "ssim": float(structural_similarity(b, a, data_range=1.0, channel_axis=2)),
    }


def draw(outside: dict[str, Any], path: Path) -> None:
    """Every scene outside the family by the methods that are `SHOWN`, with what they gain on it."""
    names = [name for name in SHOWN if name in METHODS]
    made = figure(1.55 * (len(names) + 1), 1.75 * len(outside))
    axes = made.subplots(len(outside), len(names) + 1)
    for line, (scene, found) in zip(axes, outside.items(), strict=True):
        white = float(np.quantile(found["truth"].max(axis=1), 0.97))
        plain = found["MC random"].mean()
        for axis, name in zip(line, [*names, "truth"], strict=True):
            picture = found["truth"] if name == "truth" else found[name, "picture"]
            side = int(np.sqrt(len(picture)))
            axis.imshow(exposed(picture.reshape(side, side, 3), white), interpolation="nearest")
            axis.set(xticks=[], yticks=[])
            axis.set_xlabel("" if name == "truth" else f"x {short(plain / found[name].mean())}", fontsize=8)
            if scene == next(iter(outside)):
                axis.set_title(name, fontsize=8)
        line[0].set_ylabel(scene, fontsize=8)
    save(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer scenes and pixels; nothing is written")
    quick = parser.parse_args().quick
    count, size, seeds = (6, 12, 2) if quick else (24, 24, 4)
    family = DirectProblem.family(count, seed=17, resolution=size)
    inside = errors(family, seeds)
    outside = {name: errors(DirectProblem.of(gallery(name, *(2 * [16 if quick else 48]))), 2) for name in OUTSIDE}
    rows: list[dict[str, Any]] = []
    bootstrap = Bootstrap.of(np.arange(count), 1, 17)
    base = inside["MC random"].mean(axis=(0, 2)).reshape(count, -1).mean(axis=1)
    for name in METHODS:
        square = inside[name].mean(axis=(0, 2))
        each = square.reshape(count, -1).mean(axis=1)
        row = {
            "method": name,
            "n": PASSES,
            "mse": float(square.mean()),
            "mse_error": bootstrap.standard_error(each[:, None]),
            "ratio": float(base.mean() / each.mean()),
            "ratio_interval": list(bootstrap.ratio(base[:, None], each[:, None]) or ()),
            "median": float(np.median(square)),
            "p99": float(np.quantile(square, 0.99)),
            "paper_ratio": PAPER.get(name),
            "scenes_no_worse_than_stratified": int(
                (each <= 1.02 * inside["MC stratified"].mean(axis=(0, 2)).reshape(count, -1).mean(axis=1)).sum()
            ),
            "scenes": count,
        }
        for where, found in outside.items():
            row[where] = float(found[name].mean())
            row[f"{where}, x"] = float(found["MC random"].mean() / found[name].mean())
            pixels = int(np.sqrt(len(found["truth"])))
            for key, value in quality(found[name, "picture"], found["truth"], pixels).items():
                row[f"{where}, {key}"] = value
        rows.append(row)
    table = Table("method", "MSE, test scenes", "x random", "95%", "paper", *OUTSIDE)
    for row in rows:
        table.add_row(
            row["method"], f"{row['mse']:.3g}", f"{row['ratio']:.2f}",
            "{:.2f} .. {:.2f}".format(*row["ratio_interval"]), str(row["paper_ratio"] or ""),
            *(f"{row[f'{where}, x']:.2f}" for where in OUTSIDE),
        )  # fmt: skip
    Console().print(table)
    if quick:
        return
    for row in rows:
        if row["method"] in BEGAN:
            under, each = (
                inside[name].mean(axis=(0, 2)).reshape(count, -1).mean(axis=1)
                for name in (BEGAN[row["method"]], row["method"])
            )
            row["gain"] = float(under.mean() / each.mean())
            row["gain_interval"] = list(bootstrap.ratio(under[:, None], each[:, None]) or ())
            design, rule = METHODS[row["method"]]
            base = recipes.rule_of(rule.removeprefix("inet-")).base
            write_cards([row | {"problem": "direct", "design": design, "rule": rule, "base": base}])
    print(write("direct_light", rows, scenes=count, resolution=size, seeds=seeds, passes=PASSES))
    draw(outside, DOCS / "direct-light-methods.png")


if __name__ == "__main__":
    main()
