"""A room by random, stratified, regression and structured sampling at 16 passes, over maps of what each gets wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nqr_geom import render
from nqr_geom.render.scene_gallery import gallery
from nqr_geom.render.world import lights_seen

METHODS = ("random", "mis", "regression", "structured")


def main(out: Path = Path("out"), size: int = 192, passes: int = 16, truth_passes: int = 2048) -> dict[str, float]:
    """Draw pictures and error maps side by side, and return each method's mean squared error."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from nqr_geom.render.film import exposed

    scene = gallery("teaser", size, size)
    truth = render.direct(scene, spp=truth_passes, method="mis", seed=1)
    pictures = {name: render.direct(scene, spp=passes, method=name) for name in METHODS}
    errors = {name: float(((picture - truth) ** 2).mean()) for name, picture in pictures.items()}
    lights = lights_seen(scene)
    white = float(np.quantile(truth.max(axis=2), 0.97))
    figure, axes = plt.subplots(2, 5, figsize=(15, 6.4), layout="constrained")
    for axis in axes.flat:
        axis.set_axis_off()
    for column, (name, picture) in enumerate({**pictures, "2,048 passes": truth}.items()):
        axes[0, column].imshow(exposed(picture + lights, white))
        axes[0, column].set_title(name)
        if name in errors:
            shown = axes[1, column].imshow(
                np.abs(picture - truth).mean(axis=2) / white, cmap="magma", vmin=0, vmax=0.25
            )
            axes[1, column].set_title(f"{errors['random'] / errors[name]:.3g} times less squared error", fontsize=10)
    figure.colorbar(shown, cax=axes[1, 4].inset_axes([0.05, 0.1, 0.06, 0.8]), label="|error| / white")
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "room_by_four_methods.png", dpi=110)
    plt.close(figure)
    return errors


if __name__ == "__main__":
    for method, error in main().items():
        print(f"{method}: {error:.3g}")
