"""Which light is chosen (as in Fig. 21): a strong lamp behind a screen takes the samples of a weak one that shines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import nqr_geom as ng
from nqr_geom import registry, render
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.streams import Stream

POINTS = {"behind the screen": (0.0, 0.9), "in the open": (0.0, -1.5)}  # x and y on the floor


def room(size: int) -> render.Scene:
    """A floor under a lamp ten times as strong as the one beside it, with a screen below the strong one."""
    matt = render.Diffuse(0.6)
    shapes = [
        render.Quad([-3, -3, 0], [6, 0, 0], [0, 6, 0], matt),
        render.Quad([-1.2, 0.0, 1.1], [2.4, 0, 0], [0, 1.8, 0], render.Diffuse([0.3, 0.2, 0.15])),
    ]
    lights = [
        render.SphereLight([0, 0.9, 2.2], 0.2, 40.0),
        render.SphereLight([1.2, -0.4, 0.7], 0.2, 4.0),
    ]
    return render.Scene(render.Camera([0, -5.5, 2.8], [0, 0.2, 0.4], 40.0, size, size), shapes, lights)


def pixels_around(problem: DirectProblem, place: tuple[float, float], size: int) -> np.ndarray:
    """The 5 x 5 pixels that see the floor nearest to a place; positions count in the scene's frame."""
    scene = problem.world.scenes[0]
    away = np.linalg.norm(problem.surfaces["position"] - scene.frame(np.array([*place, 0.0])), axis=1)
    y, x = divmod(int(np.where(problem.surfaces["kind"] < 0, np.inf, away).argmin()), size)
    return np.array([(y + j) * size + x + i for j in range(-2, 3) for i in range(-2, 3)])


def shares(problem: DirectProblem, rows: np.ndarray, passes: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each light: its share of the directions that are sent to lights, and of the light that arrives."""
    samples = registry.make("sampler", "pmj").draw(problem.take(torch.from_numpy(rows)), passes, Stream(0))
    weights = registry.make("rule", "balance-heuristic").combine(samples).weights
    light = samples.seen.features["light"][..., 0].numpy()
    given = (weights * samples.value).sum(dim=3).numpy()
    chosen = np.array([(light[:, :, 1] == k).mean() for k in range(2)])  # technique 1: towards lights
    brought = np.array([given[light == k].sum() for k in range(2)])
    return chosen, brought / brought.sum()


def main(out: Path = Path("out"), size: int = 128, passes: int = 256) -> dict[str, float]:
    """Draw the room and bars for two places; return the share of directions that go to the strong lamp at each."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from nqr_geom.render.film import exposed
    from nqr_geom.render.world import lights_seen

    scene = room(size)
    problem = ng.problems.direct(scene)
    picture = render.direct(scene, method="structured", spp=16)
    figure, (image, *bars) = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained", width_ratios=[1.2, 1, 1])
    image.imshow(exposed(picture + lights_seen(scene), 0.8))
    image.set_axis_off()
    found = {}
    for axis, (name, place) in zip(bars, POINTS.items(), strict=True):
        rows = pixels_around(problem, place, size)
        chosen, brought = shares(problem, rows, passes)
        found[name] = float(chosen[0])
        y, x = divmod(int(rows[12]), size)
        image.plot(x, y, "*", ms=14, color="#009E73", mec="white")
        image.annotate(name, (x, y), xytext=(-9, -4), textcoords="offset points", color="white", ha="right", fontsize=9)
        for shift, (label, share, colour) in enumerate(
            (("light that arrives", brought, "0.3"), ("directions sent there", chosen, "#0072B2"))
        ):
            axis.bar(np.arange(2) + 0.38 * (shift - 0.5), share, 0.38, label=label, color=colour)
        axis.set(title=name, ylim=(0, 1.05), xticks=[0, 1], xticklabels=["strong lamp", "weak lamp"])
    bars[0].set_ylabel("share")
    bars[-1].legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "light_selection.png", dpi=120)
    plt.close(figure)
    return found


if __name__ == "__main__":
    for where, share in main().items():
        print(f"{where}: {share:.1%} of the directions go to the strong lamp")
