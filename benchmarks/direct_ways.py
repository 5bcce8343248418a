"""The ways to direct light that the registry knows, and views of the scenes outside the family."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nqr_geom import registry
from nqr_geom.render.scene import Scene

PASSES = 16
OUTSIDE = ("teaser", "white-room", "living-room", "staircase", "plates")
UNHIDDEN = "pmj+direct-unhidden"  # lamps in closed form on matt surfaces, samples as for "mis"
WAYS = ("random", "mis", "regression", UNHIDDEN, "structured", "inet", "nqr")


def ways(wanted: tuple[str, ...] = WAYS) -> dict[str, tuple[str, str]]:
    """Name, sampler and rule of every way that there is; a trained sampler joins as soon as the registry names it."""
    there = (name for name in wanted if name in ("mis", UNHIDDEN) or f"direct:{name}" in registry.ALIASES)
    return {name: registry.method(name, "direct") for name in there}


def turned(scene: Scene, degrees: float) -> Scene:
    """The scene from a camera that has gone around what it looks at."""
    angle = np.radians(degrees)
    away = np.subtract(scene.camera.position, scene.camera.look_at)
    cosine, sine = np.cos(angle), np.sin(angle)
    gone = np.array([cosine * away[0] - sine * away[1], sine * away[0] + cosine * away[1], away[2]])
    return replace(scene, camera=replace(scene.camera, position=np.add(scene.camera.look_at, gone)))
