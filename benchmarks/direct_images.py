"""Direct light as eyes judge it: PSNR, SSIM, DSSIM and FLIP of pictures, and flicker on a camera path (Table 13).

    pip install "nqr-geom[bench]"
    python benchmarks/direct_images.py [--quick]

Scenes outside the training family at 16 passes a pixel. PSNR, SSIM (Wang et al. 2004), DSSIM = (1 - SSIM) / 2 and FLIP
(Andersson et al. 2020, 67 pixels a degree) are of pictures as they are shown: exposed to the truth's 97th percentile,
in sRGB. Flicker is the mean square of how much the error changes from one frame to the next,
|(P' - P) - (T' - T)|^2, as in the temporal loss of Chaitanya et al. (Interactive Reconstruction of Monte Carlo Image
Sequences, 2017), in linear radiance; the camera goes around the scene in 16 frames, each with random numbers of its
own. Errors that stay do not flicker: noise alone gives twice the squared error. Truths are means of 4,096 passes. LPIPS
is not told: its package fetches the layers below its weights from elsewhere.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from direct_ways import OUTSIDE, PASSES, turned, ways
from figures import DOCS, figure, save
from flip_evaluator import evaluate as flip
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import write
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from nqr_geom import render
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.render.film import exposed
from nqr_geom.render.scene import Scene
from nqr_geom.render.scene_gallery import gallery

Floats = NDArray[np.float64]
TRUTH_PASSES, TRUTH_SEED = 4096, 2**30
FRAMES, TURN = 16, 12.0  # frames, and degrees from the first to the last
SHOWN = ("teaser", "staircase", "plates")
MEASURES = ("psnr", "ssim", "dssim", "flip")


def judged(shown: Floats, truth: Floats) -> tuple[dict[str, float], Floats]:
    """What eyes see of the difference of two pictures (h, w, 3) in sRGB, and FLIP's map of it (h, w)."""
    ssim = float(structural_similarity(truth, shown, data_range=1.0, channel_axis=2))
    single = (image.astype(np.float32) for image in (truth, shown))
    seen, mean, _ = flip(*single, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=True)
    told = {
        "psnr": float(peak_signal_noise_ratio(truth, shown, data_range=1.0)),
        "ssim": ssim,
        "dssim": 0.5 * (1.0 - ssim),
        "flip": float(mean),
    }
    return told, np.asarray(seen, dtype=np.float64).squeeze()


def flicker(frames: Floats, truths: Floats) -> float:
    """Mean squared change of the error between consecutive frames (f, h, w, 3)."""
    return float((np.diff(frames - truths, axis=0) ** 2).mean())


def answered(scene: Scene) -> tuple[Floats, float]:
    """The truth (h, w, 3), and its own mean squared error."""
    told = render.direct(scene, method="reference", spp=TRUTH_PASSES, seed=TRUTH_SEED, full_output=True)
    return told.value.reshape(scene.camera.height, scene.camera.width, 3), float((told.stderr**2).mean())


def still(name: str, size: int, seeds: int) -> tuple[list[dict[str, Any]], dict[str, tuple[Floats, Floats | None]]]:
    """Rows of one view, means over seeds; and pictures as they are shown, with FLIP's map."""
    scene = gallery(name, size, size)
    truth, truth_mse = answered(scene)
    white = float(np.quantile(truth.max(axis=2), 0.97))
    shown_truth = exposed(truth, white)
    rows, pictures = [], {}
    for way in ways():
        made = [render.direct(scene, method=way, spp=PASSES, seed=seed) for seed in range(seeds)]
        told = [judged(exposed(image, white), shown_truth) for image in made]
        rows.append(
            {
                "scene": name,
                "method": way,
                "n": PASSES,
                "mse": float(np.mean([(image - truth) ** 2 for image in made])),
                "truth_mse": truth_mse,
                **{key: float(np.mean([one[key] for one, _ in told])) for key in MEASURES},
            }
        )
        pictures[way] = exposed(made[0], white), told[0][1]
    return rows, pictures | {"truth": (shown_truth, None)}


def moving(name: str, size: int, frames: int) -> dict[str, dict[str, float]]:
    """Flicker and mean squared error of every way on the camera path, seed by frame."""
    scenes = [turned(gallery(name, size, size), angle) for angle in np.linspace(-0.5 * TURN, 0.5 * TURN, frames)]
    answers = [answered(s) for s in scenes]
    truths, truth_mse = np.stack([truth for truth, _ in answers]), float(np.mean([mse for _, mse in answers]))
    found = {}
    for way in ways():
        path = np.stack([render.direct(s, method=way, spp=PASSES, seed=k) for k, s in enumerate(scenes)])
        found[way] = {"flicker": flicker(path, truths), "path_mse": float(((path - truths) ** 2).mean()),
                      "path_truth_mse": truth_mse}  # fmt: skip
    return found


def together(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over scenes, and flicker and FLIP against random sampling's with intervals over scenes.

    Flicker counts in a scene's own unit, that of random sampling: else the brightest scene would be all.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    bootstrap = Bootstrap.of(np.arange(len(scenes)), 1, 0)
    of = {key: {way: np.array([r[key] for r in rows if r["method"] == way]) for way in ways()}
          for key in (*MEASURES, "flicker", "path_mse")}  # fmt: skip
    means = []
    for way in ways():
        row: dict[str, Any] = {"scene": "all", "method": way, "n": PASSES}
        row |= {key: float(of[key][way].mean()) for key in MEASURES}
        for key in ("flip", "flicker"):
            unit = of[key]["random"]
            plain, mine = np.ones((len(scenes), 1)), (of[key][way] / unit)[:, None]
            row[f"{key}_ratio"] = float(plain.mean() / mine.mean())
            row[f"{key}_interval"] = bootstrap.ratio(plain, mine)
        row["noise_share"] = float((of["flicker"][way] / (2.0 * of["path_mse"][way])).mean())
        means.append(row)
    return means


def draw(pictures: dict[str, dict[str, tuple[Floats, Floats | None]]], path: Path) -> None:
    """Pictures by every way and the truth, FLIP's maps below."""
    columns = [*ways(), "truth"]
    made = figure(2.0 * len(columns), 4.25 * len(pictures))
    axes = made.subplots(2 * len(pictures), len(columns))
    for axis in axes.flat:
        axis.set_axis_off()
    for line, (name, of) in enumerate(pictures.items()):
        for column, way in enumerate(columns):
            image, seen = of[way]
            above, below = axes[2 * line : 2 * line + 2, column]
            above.imshow(image)
            above.set_title(f"{name}: {way}" if column == 0 else way, fontsize=10)
            if seen is not None:
                shown = below.imshow(seen, cmap="magma", vmin=0.0, vmax=0.6)
                below.set_title(f"FLIP {seen.mean():.3f}", fontsize=9)
    bar = axes[1, -1].inset_axes([0.1, 0.1, 0.08, 0.8])
    made.colorbar(shown, cax=bar, label="FLIP")
    save(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small pictures, four frames; writes nothing")
    quick = parser.parse_args().quick
    size, path_size, frames, seeds = (32, 16, 4, 1) if quick else (128, 40, FRAMES, 4)
    rows: list[dict[str, Any]] = []
    pictures = {}
    for name in OUTSIDE:
        seen, shown = still(name, size, seeds)
        along = moving(name, path_size, frames)
        rows += [row | along[row["method"]] for row in seen]
        if name in SHOWN:
            pictures[name] = shown
    rows += together(rows)
    table = Table(
        "scene", "method", "PSNR", "SSIM", "DSSIM", "FLIP", "x random", "flicker", "x random", "noise's share"
    )
    for row in rows:
        ratios = [f"{row[key]:.3g}" if key in row else "" for key in ("flip_ratio", "flicker", "flicker_ratio")]
        table.add_row(
            row["scene"], row["method"], f"{row['psnr']:.1f}", *(f"{row[key]:.3g}" for key in MEASURES[1:]), *ratios,
            f"{row['noise_share']:.2f}" if "noise_share" in row else "",
        )  # fmt: skip
    Console(width=130).print(table)
    if quick:
        return
    draw(pictures, DOCS / "direct-images.png")
    settings = {"resolution": size, "path_resolution": path_size, "frames": frames, "degrees": TURN, "seeds": seeds}
    print(write("direct_images", rows, passes=PASSES, truth_passes=TRUTH_PASSES, **settings))


if __name__ == "__main__":
    main()
