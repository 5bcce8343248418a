"""What it saves to run only what a scene calls for: the same pictures by kernels made for it and with everything on."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from nqr_geom import render

__all__ = ["of_scene", "table"]

Row = dict[str, Any]

_PASSES, _QUERIES = 16, 24


def _in_turns(one: Callable[[], Any], two: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Least processor seconds of two jobs that take turns, after a first round that compiles: others may be busy."""
    spent: tuple[list[float], list[float]] = ([], [])
    for turn in range(repeats + 1):
        for job, times in zip((one, two), spent, strict=True):
            start = time.process_time()
            job()
            if turn:
                times.append(time.process_time() - start)
    return min(spent[0]), min(spent[1])


def of_scene(name: str, scene: render.Scene, repeats: int) -> Row:
    """Direct light of a scene with what it calls for, and with everything on.

    Returns
    -------
    dict
        application, case, effects, seconds and seconds with everything, work done and the largest difference.
    """
    from nqr_geom.integrator.estimate import run
    from nqr_geom.integrator.rules import BalanceHeuristic
    from nqr_geom.integrator.samplers import Pmj
    from nqr_geom.render.direct_problem import DirectProblem
    from nqr_geom.render.effects import ALL

    lean, full = (DirectProblem.of(scene, effects=effects) for effects in (None, ALL | scene.effects()))
    jobs = [partial(run, problem, Pmj(), BalanceHeuristic(), _PASSES) for problem in (lean, full)]
    seconds = _in_turns(jobs[0], jobs[1], repeats)
    rays, pictures = [], []
    for problem in (lean, full):
        problem.rays.update(dict.fromkeys(problem.rays, 0))
        pictures.append(run(problem, Pmj(), BalanceHeuristic(), _PASSES).value)
        rays.append(problem.rays["material"] + problem.rays["light"])
    return _row("direct", name, scene.effects(), seconds, "shadow rays", rays, *pictures)


def _of_volume(name: str, volume: render.Volume, rays: tuple[Any, Any, Any], repeats: int) -> Row:
    def seen(everything: bool) -> Any:
        return render.transmittance(volume, *rays, n=_QUERIES, full_output=True, everything=everything)

    seconds = _in_turns(lambda: seen(False), lambda: seen(True), repeats)
    lean, full = seen(False), seen(True)
    work = [estimate.counts["queries"] + estimate.counts.get("noise", 0) for estimate in (lean, full)]
    return _row("transmittance", name, lean.effects, seconds, "queries and noise", work, lean.value, full.value)


def _row(
    application: str,
    case: str,
    effects: Any,
    seconds: tuple[float, float],
    kind: str,
    work: list[int],
    one: Any,
    two: Any,
) -> Row:
    return {
        "application": application,
        "case": case,
        "effects": sorted(effects),
        "seconds": seconds[0],
        "seconds_everything": seconds[1],
        "work": kind,
        "count": int(work[0]),
        "count_everything": int(work[1]),
        "difference": float(np.abs(one - two).max()),
    }


def _rooms(size: int) -> dict[str, render.Scene]:
    """Scenes that call for more and more."""
    from nqr_geom.render.scene_gallery import gallery

    lights = [render.SphereLight([-0.5, 0.2, 1.5], 0.2, 6.0), render.SphereLight([0.6, -0.3, 1.2], 0.1, 9.0)]
    ball = render.Sphere([0.2, 0.1, 0.4], 0.4, render.Diffuse(0.5))

    def room(*things: Any, count: int = 1, gloss: bool = False) -> render.Scene:
        floor = render.Plastic(0.5, 0.2) if gloss else render.Diffuse(0.6)
        walls = [
            render.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], floor),
            render.Quad([-1, 1, 0], [2, 0, 0], [0, 0, 2], render.Diffuse(0.6)),
            render.Quad([-1, -1, 0], [0, 2, 0], [0, 0, 2], render.Diffuse(0.6)),
        ]
        camera = render.Camera([0.8, -3, 1], [0, 0, 0.8], width=size, height=size)
        return render.Scene(camera, [*walls, *things], lights[:count])

    return {
        "an empty room, one light": room(),
        "two lights": room(count=2),
        "a glossy floor": room(gloss=True),
        "a ball that casts a shadow": room(ball),
        "two metal and plastic balls, three lights": gallery("two-spheres", size, size),
    }


def _volumes(size: int) -> dict[str, tuple[render.Volume, tuple[Any, Any, Any]]]:
    """Volumes that lack something, and rays through them."""
    from nqr_geom.render.volume_families import view, volumes

    cloud = volumes(1)[0]
    box = [0.0] * 3, [10.0] * 3
    rays = view(cloud, size)
    wide = ((rays[0] - 5.0) * [4.0, 4.0, 1.0] + 5.0, rays[1], rays[2])
    return {
        "a grid of equal densities": (render.Grid(np.full((16, 16, 16), 0.3), *box), rays),
        "a cloud without noise": (replace(cloud, noise=None), rays),
        "15 of 16 rays miss the cloud": (cloud, wide),
        "a cloud with noise": (cloud, rays),
    }


def table(applications: tuple[str, ...], size: int, repeats: int) -> list[Row]:
    """Rows for the applications that have effects.

    Parameters
    ----------
    applications : tuple of str
        "direct", "transmittance" or both; others have no effects to leave out.
    size : int
        Pixels along a side.
    repeats : int
        Of the measurement, after a first one; the best counts.
    """
    rows = []
    if "direct" in applications:
        rows += [of_scene(name, scene, repeats) for name, scene in _rooms(size).items()]
    if "transmittance" in applications:
        rows += [_of_volume(name, *made, repeats) for name, made in _volumes(size).items()]
    return rows
