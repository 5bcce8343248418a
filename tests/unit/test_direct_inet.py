"""`render.direct(method="inet")`: its door, black pixels, and the scene that the paper's networks fail on."""

from __future__ import annotations

import numpy as np

from nqr_geom import registry, render
from nqr_geom.render.scene_gallery import gallery


def test_networks_are_better_than_stratified_passes_on_plates_and_lights() -> None:
    assert registry.method("inet", "direct") == ("lamp-spread", "inet-direct-mis")
    scene = gallery("plates", 24, 24)
    truth = render.direct(scene, method="reference", seed=9)
    plain, mine = (render.direct(scene, method=method, seed=1) for method in ("mis", "inet"))
    assert np.mean((mine - truth) ** 2) < np.mean((plain - truth) ** 2)
    assert not mine[(truth == 0.0).all(axis=-1)].any()
    assert (mine >= 0.0).all()
