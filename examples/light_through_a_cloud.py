"""Light through a cloud: its transmittance, and where the structured sampler looks along two rays (as in Fig. 49)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import nqr_geom as ng
from nqr_geom import registry, render
from nqr_geom.streams import Stream
from nqr_geom.through import see_through

RAYS = {"through the thick of it": (4.2, 5.3), "through a small puff": (8.2, 3.0)}


def density(cloud: render.Spheres, place: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Distance and density along a ray in z."""
    t = np.linspace(0.0, 10.0, 1001)
    points = np.column_stack([np.full_like(t, place[0]), np.full_like(t, place[1]), t])
    return t, cloud.components(points).density


def looked_at(cloud: render.Spheres, place: tuple[float, float], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Where n samples of the structured method lie along a ray, and the density there."""
    problem = ng.problems.transmittance(cloud, [[*place, 0.0]], [[0.0, 0.0, 1.0]], 10.0, support="pieces")
    samples = registry.make("sampler", "noise-refine").draw(problem, n, Stream(0, name="samples/0"))
    value = samples.value / samples.seen.features["optical_length"]
    return samples.seen.features["t"].flatten().numpy(), value.flatten().numpy()


def main(out: Path = Path("out"), resolution: int = 256, n: int = 24) -> float:
    """Draw the cloud and the two rays; return how many times less the structured method's squared error is."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    torch.set_num_threads(1)
    cloud = ng.datasets.volumes(1, seed=0)[0]
    image, _ = see_through(cloud, resolution=resolution, n=128)
    figure = plt.figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[1, 1.5])
    axis = left.subplots()
    axis.imshow(image, cmap="gray", vmin=0, vmax=1, extent=(0, 10, 0, 10))
    axis.set(title="transmittance", xlabel="x", ylabel="y")
    for line, (axis_of_ray, (name, place)) in enumerate(
        zip(right.subplots(2, 1, sharex=True), RAYS.items(), strict=True)
    ):
        color = f"C{line}"
        axis.plot(*place, "o", color=color, mec="white", ms=9)
        axis_of_ray.fill_between(*density(cloud, place), color="0.85", lw=0)
        axis_of_ray.plot(*density(cloud, place), color="0.4", lw=0.8)
        axis_of_ray.plot(*looked_at(cloud, place, n), "o", color=color, ms=5, mec="white", mew=0.5)
        axis_of_ray.set(title=f"{name}: {n} samples", ylabel="density", ylim=(-0.03, 1.1), xlim=(0, 10))
    axis_of_ray.set_xlabel("distance along the ray")
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "light_through_a_cloud.png", dpi=120)
    plt.close(figure)
    truth, _ = see_through(cloud, resolution=24, n=4096)
    errors = [
        ((see_through(cloud, resolution=24, n=n, method=method, seed=1)[0] - truth) ** 2).mean()
        for method in ("stratified", "structured")
    ]
    return float(errors[0] / errors[1])


if __name__ == "__main__":
    print(f"structured against stratified, mean squared error: {main():.0f} times less")
