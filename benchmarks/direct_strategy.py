"""What samples of direct light do, as in Figs. 20 to 23: parts of the two techniques, choice of lights, places on them.

    python benchmarks/direct_strategy.py [--out FOLDER]

Numbers are of scenes of the family that nothing was trained on; pictures of a scene outside it. A technique's part is
the mean of W f over its samples, a constant of the rule counts with the directions to lights; how far a part scatters
is its standard deviation over seeds in root mean square over pixels, in the mean light of the pixel's scene. A light
is chosen for nothing where it brings less than a hundredth of the light that a pixel gets.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from direct_ways import PASSES, UNHIDDEN, ways
from figures import DOCS, SEVERAL, figure, save
from numpy.typing import NDArray
from shapes import write
from torch import Tensor

from nqr_geom import registry
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.film import exposed
from nqr_geom.render.kernels_bsdf import DIFFUSE
from nqr_geom.render.scene_gallery import gallery
from nqr_geom.streams import Stream

Floats = NDArray[np.float64]
SCENES, RESOLUTION, SEEDS = 16, 16, 8
SIZE, MANY, TILE = 96, 256, 1024
RIM = 0.75  # of a light's solid angle: the outer quarter
MATERIAL, LIGHT = 0, 1  # techniques
CIRCLE = np.cos(np.linspace(0.0, 2.0 * np.pi, 200)), np.sin(np.linspace(0.0, 2.0 * np.pi, 200))
METHODS = ("random", "mis", UNHIDDEN, "structured", "inet", "nqr")


@dataclass(frozen=True)
class Seen:
    """Samples, weights (B, N, 2, 3), and what the estimate is made of: parts (B, 2, 3) and a constant (B, 3)."""

    samples: Samples
    weights: Tensor
    parts: Tensor
    constant: Tensor


def looked(problem: DirectProblem, pair: tuple[str, str], seed: int = 0, n: int = PASSES) -> Seen:
    """Draw and weigh, some pixels at a time."""
    sampler, rule = registry.make("sampler", pair[0]), registry.make("rule", pair[1])
    found: list[Seen] = []
    with torch.no_grad():
        for rows in torch.arange(problem.batch).split(TILE):
            samples = sampler.draw(problem.take(rows), n, Stream(seed, "test", "samples/0"))
            result = rule.combine(samples)
            weights = result.weights.expand_as(samples.value)
            parts = (weights * samples.value).mean(dim=1)
            found.append(Seen(samples, weights, parts, result.estimate(samples) - parts.sum(dim=1)))
    return Seen(
        Samples.stack([part.samples for part in found]),
        *(torch.cat([getattr(part, name) for part in found]) for name in ("weights", "parts", "constant")),
    )


def brought(problem: DirectProblem) -> Tensor:
    """Share of each light in what a pixel gets, (B, lights), from many passes of both techniques; zero in the dark."""
    pair = Pmj(), BalanceHeuristic()
    most = max(len(scene.lights) for scene in problem.world.scenes)
    total = torch.zeros(problem.batch, most, dtype=torch.float64)
    for rows in torch.arange(problem.batch).split(TILE):
        samples = pair[0].draw(problem.take(rows), MANY, Stream(1, "validation", "lights"))
        light = samples.seen.features["light"][..., 0].long().flatten(1)
        given = (pair[1].combine(samples).weights * samples.value).sum(dim=3).flatten(1)
        total[rows] = torch.zeros(len(rows), most, dtype=torch.float64).scatter_add(1, light.clamp_min(0), given)
    return total / total.sum(dim=1, keepdim=True).clamp_min(1e-300)


def chosen(samples: Samples, lights: int) -> Tensor:
    """Share of each light in the directions towards lights, (B, lights)."""
    light = samples.seen.features["light"][:, :, LIGHT, 0].long()
    return torch.nn.functional.one_hot(light.clamp_min(0), lights).double().mean(dim=1)


def both(seen: Seen) -> Tensor:
    """Light by the material, towards lights, and together, (B, 3)."""
    light = seen.parts[:, LIGHT] + seen.constant
    return torch.stack([seen.parts[:, MATERIAL], light, seen.parts[:, MATERIAL] + light], dim=1).mean(dim=2)


def summary(name: str, pair: tuple[str, str], problem: DirectProblem, truth: Tensor) -> dict[str, Any]:
    """Numbers over all lit pixels."""
    seen = looked(problem, pair)
    lit = (truth.sum(dim=1) > 0.0) & torch.from_numpy(problem.surfaces["kind"] >= 0)
    matt = torch.from_numpy(problem.surfaces["kind"] == DIFFUSE)
    runs = torch.stack([both(looked(problem, pair, seed)) for seed in range(SEEDS)])  # (S, B, 3)
    scene = torch.from_numpy(problem.groups)
    unit = torch.stack([runs[:, scene == k, 2].mean() for k in range(SCENES)])[scene]
    scatter = (runs.std(dim=0) / unit[:, None]).square().mean(dim=0).sqrt()
    choice = chosen(seen.samples, truth.shape[1])
    features, weights = seen.samples.seen.features, seen.weights.mean(dim=3)
    shone = (features["visible"][:, :, LIGHT, 0] > 0.0) & lit[:, None]
    rim = seen.samples.x[:, :, 4] > RIM
    met = features["light"][:, :, MATERIAL, 0] >= 0.0
    row: dict[str, Any] = {"method": name, "n": PASSES}
    for kind, of in (("matt", lit & matt), ("glossy", lit & ~matt)):
        parts = seen.parts[of].mean(dim=(0, 2))
        row[f"material_part_{kind}"] = float(parts[MATERIAL] / (parts.sum() + seen.constant[of].mean()))
        row[f"material_weight_{kind}"] = float(weights[:, :, MATERIAL][met & of[:, None]].mean())
        row[f"met_{kind}"] = float(met[of].double().mean())
    return row | {
        "scatter_light": float(scatter[LIGHT]),
        "scatter_material": float(scatter[MATERIAL]),
        "scatter": float(scatter[2]),
        "for_nothing": float((choice * (truth < 0.01))[lit].sum(dim=1).mean()),
        "choice_off": float(0.5 * (choice - truth)[lit].abs().sum(dim=1).mean()),
        "rim_samples": float(rim[shone].double().mean()),
        "rim_weight": float(weights[:, :, LIGHT][shone & rim].mean() / weights[:, :, LIGHT][shone & ~rim].mean()),
    }


def draw_parts(problem: DirectProblem, seen: dict[str, Seen], path: Path) -> None:
    """Fig. 20: what comes by directions to lights, and five times what comes by the material."""
    made = figure(2.7 * len(seen), 5.7)
    axes = made.subplots(2, len(seen))
    white = float(np.quantile(seen["mis"].parts.sum(dim=1).numpy().max(axis=1), 0.97))
    for column, (name, of) in zip(axes.T, seen.items(), strict=True):
        images = (of.parts[:, LIGHT] + of.constant, 5.0 * of.parts[:, MATERIAL])
        for axis, image in zip(column, images, strict=True):
            axis.imshow(exposed(image.numpy().reshape(SIZE, SIZE, 3), white))
            axis.set(xticks=[], yticks=[])
        column[0].set_title(name)
    axes[0, 0].set_ylabel("towards lights")
    axes[1, 0].set_ylabel("by the material, x 5")
    save(made, path)


def stars(problem: DirectProblem, truth: Tensor, seen: Seen) -> dict[str, int]:
    """Pixels to look at: matt in half shadow, matt under several lights, metal that mirrors a lamp."""
    kind, roughness = (torch.from_numpy(problem.surfaces[name]) for name in ("kind", "roughness"))
    features = seen.samples.seen.features
    towards = features["light"][:, :, LIGHT, 0] == truth.argmax(dim=1)[:, None]
    visible = features["visible"][:, :, LIGHT, 0]
    shown = torch.where(towards, visible, 0.0).sum(dim=1) / towards.sum(dim=1).clamp_min(1)
    matt = (kind == DIFFUSE) & (truth.sum(dim=1) > 0.0)
    doubt = torch.where(matt, shown * (1.0 - shown), -1.0)
    even = torch.where(matt & (visible.std(dim=1) == 0.0), -(truth * truth.clamp_min(1e-12).log()).sum(dim=1), -1.0)
    mirror = torch.where((kind > DIFFUSE) & (roughness < 0.2), seen.parts[:, MATERIAL].mean(dim=1), -1.0)
    inner = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    inner[4:-4, 4:-4] = True
    picked = (torch.where(inner.flatten(), score, -2.0).argmax() for score in (doubt, even, mirror))
    return dict(zip(("half shadow", "several lights", "mirrored lamp"), (int(p) for p in picked), strict=True))


def draw_lights(problem: DirectProblem, truth: Tensor, seen: dict[str, Seen], at: dict[str, int], path: Path) -> None:
    """Fig. 21: which lights are chosen in the 5 x 5 pixels around a star, beside what they bring."""
    designs = {ways()[name][0]: of for name, of in seen.items()}
    made = figure(3.2 * (len(at) + 1), 3.3)
    image, *bars = made.subplots(1, len(at) + 1)
    mean = seen["inet"].parts.sum(dim=1) if "inet" in seen else seen["mis"].parts.sum(dim=1)
    image.imshow(exposed(mean.numpy().reshape(SIZE, SIZE, 3)))
    image.set(xticks=[], yticks=[])
    for (name, pixel), axis in zip(at.items(), bars, strict=True):
        y, x = divmod(pixel, SIZE)
        image.plot(x, y, "*", ms=13, color="#009E73", mec="white")
        side = {"ha": "left", "xytext": (5, 5)} if x < 0.6 * SIZE else {"ha": "right", "xytext": (-5, -12)}
        image.annotate(name, (x, y), textcoords="offset points", color="white", fontsize=8, **side)
        rows = torch.tensor([(y + j) * SIZE + x + i for j in range(-2, 3) for i in range(-2, 3)])
        shares = {"brought": truth[rows].mean(dim=0)} | {
            design: chosen(of.samples, truth.shape[1])[rows].mean(dim=0) for design, of in designs.items()
        }
        wide = 0.8 / len(shares)
        for k, ((label, share), colour) in enumerate(zip(shares.items(), ("0.3", *SEVERAL), strict=False)):
            axis.bar(
                np.arange(len(share)) + (k - 0.5 * len(shares) + 0.5) * wide, share, wide, label=label, color=colour
            )
        axis.set(title=name, xlabel="light", xticks=range(truth.shape[1]), ylim=(0.0, 1.0))
    bars[0].set_ylabel("share")
    bars[-1].legend(fontsize=8)
    save(made, path)


def draw_places(problem: DirectProblem, names: tuple[str, ...], at: dict[str, int], path: Path) -> None:
    """Figs. 22 and 23: samples on the discs of lights as the pixel sees them, and directions by the material.

    Directions lie in the hemisphere seen from above, lamps are where they shine (yellow) or are hidden (grey); samples
    that meet no lamp are rings.
    """
    lines = [("half shadow", LIGHT), ("half shadow", MATERIAL), ("mirrored lamp", MATERIAL)]
    made = figure(2.5 * len(names) + 0.6, 2.8 * len(lines))
    axes = made.subplots(len(lines), len(names))
    stars = problem.take(torch.tensor(list(at.values())))
    dense = looked(stars, ("random", "balance-heuristic"), 2, 4 * MANY)
    drawn = {name: [looked(stars, ways()[name], seed) for seed in range(SEEDS)] for name in names}
    for (where, technique), line in zip(lines, axes, strict=True):
        k = list(at).index(where)
        for axis, runs in zip(line, drawn.values(), strict=True):
            x = torch.cat([of.samples.x[k] for of in runs])
            seen = {
                name: torch.cat([of.samples.seen.features[name][k, :, technique] for of in runs])
                for name in ("direction", "light")
            }
            weight = torch.cat([of.weights[k, :, technique].mean(dim=1) for of in runs])
            met = seen["light"][:, 0] >= 0.0
            if technique == LIGHT:
                out, turn = x[:, 4].sqrt(), 2.0 * torch.pi * x[:, 5]
                place = torch.stack([out * turn.cos(), out * turn.sin()], dim=1)
            else:
                place = seen["direction"][:, :2]
                lamps = dense.samples.seen.features["direction"][k, :, LIGHT]
                bright = dense.samples.seen.features["visible"][k, :, LIGHT, 0] > 0.0
                for shines, colour in ((~bright, "0.6"), (bright, "#F0B000")):
                    shown = lamps[shines & (lamps[:, 2] > 0.0)]
                    axis.plot(shown[:, 0], shown[:, 1], ".", ms=2.0, color=colour, zorder=2)
            axis.scatter(*place[~met].T, s=14, fc="none", ec="0.55", lw=0.7)
            look = {"cmap": "coolwarm", "vmin": 0.0, "vmax": 2.0, "ec": "black", "lw": 0.5, "zorder": 3}
            dots = axis.scatter(*place[met].T, s=22, c=weight[met], **look)
            axis.plot(*CIRCLE, color="0.6", lw=0.8)
            axis.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), aspect="equal", xticks=[], yticks=[])
            axis.set_frame_on(False)
        line[0].set_ylabel(f"{where}:\n{'on the lights' if technique == LIGHT else 'by the material'}")
    for axis, name in zip(axes[0], names, strict=True):
        axis.set_title(name)
    made.colorbar(dots, ax=axes, shrink=0.5, label="weight W", extend="max")
    save(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the pictures; another one writes no results")
    out = parser.parse_args().out
    torch.set_num_threads(1)
    there = ways(METHODS)
    problem = DirectProblem.family(SCENES, seed=17, resolution=RESOLUTION)
    truth = brought(problem)
    rows = [summary(name, pair, problem, truth) for name, pair in there.items()]
    for row in rows:
        print({key: value if isinstance(value, str) else round(value, 4) for key, value in row.items()})
    scene = DirectProblem.of(gallery("teaser", SIZE, SIZE))
    seen = {name: looked(scene, pair) for name, pair in there.items()}
    shares = brought(scene)
    at = stars(scene, shares, seen["mis"])
    draw_parts(scene, seen, out / "direct-strategy-parts.png")
    draw_lights(scene, shares, seen, at, out / "direct-strategy-lights.png")
    draw_places(scene, tuple(seen), at, out / "direct-strategy-places.png")
    if out == DOCS:
        settings = {"scenes": SCENES, "resolution": RESOLUTION, "seeds": SEEDS, "passes": PASSES}
        print(write("direct_strategy", rows, **settings))


if __name__ == "__main__":
    main()
