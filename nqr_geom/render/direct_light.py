"""Pictures of direct light: `render.direct`."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check, registry
from nqr_geom.render.scene import Scene

__all__ = ["direct"]

REFERENCE_PASSES, REFERENCE_RUNS = 256, 16


def direct(
    scene: Scene,
    *,
    spp: int = 16,
    method: str = "mis",
    tol: float | None = None,
    budget: float | None = None,
    seed: int = 0,
    full_output: bool = False,
) -> NDArray[np.float64] | Any:
    """Light that reaches the camera by one reflection from spherical lights (Section 6.1).

    Parameters
    ----------
    scene : Scene
    spp : int
        Passes a pixel; each is one direction by the material and one towards a light, both through the pixel's middle.
    method : str
        "random", "mis" (progressive multi-jittered points, balance heuristic), "regression" (of degree 1, for each
        technique apart), "structured" (the light of every lamp as it would be if nothing hid it, gloss included, times
        its sampled visibility; samples go to lamps that can bring much, then to those half hidden), "inet" (a network
        weighs the structured method's passes), "nqr" (another one places passes of its own, in rounds of eight),
        "reference" (at least 4096 passes in 16 runs, with a standard error), or any "sampler+rule" that fits. With
        `tol` or `budget` also "auto".
    tol : float, optional
        Absolute error of a pixel's radiance to reach in place of spp: "auto" takes the method that should get there at
        the least cost, a method that is named as many passes as that needs, pixel by pixel. Bounds on the error are
        checked on the way; the full output's `error` has them, and its `plan` what was done and why.
    budget : float, optional
        Seconds to spend in place of spp: the most accurate picture within that time. Imports, compilation, the scene's
        set-up and a first call for one pixel do not count. With `tol` too, the cheapest within `tol`, as long as the
        time lasts.
    seed : int
        The same seed gives the same picture, whatever part of it is asked for.
    full_output : bool
        Return the `Estimate` instead, one row a pixel: with effects, kernels, rays by kind and seconds by stage.

    Returns
    -------
    (h, w, 3) float64 ndarray, or Estimate
        Radiance in red, green and blue, linear, without light that the camera sees directly.

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind or range.

    Notes
    -----
    Positions and directions are float64. Whether a triangle is in the way is decided by a float32 tree after the scene
    has been moved and scaled to [-1, 1]^3; what is closer than 1e-5 of that to a surface casts no shadow on it.

    Examples
    --------
    >>> from nqr_geom import render
    >>> floor = render.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], render.Diffuse(0.5))
    >>> camera = render.Camera([0, -3, 1], [0, 0, 0], width=1, height=1)
    >>> scene = render.Scene(camera, [floor], [render.SphereLight([0, 0, 2], 0.5, 10.0)])
    >>> round(float(render.direct(scene, method="structured")[0, 0, 0]), 9)  # albedo, radiance, (radius / distance)^2
    0.3125
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}")
    spp = check.integer("spp", spp, low=1)
    planned = tol is not None or budget is not None
    if planned and method == "reference":
        raise ValueError(f"method: expected another one than 'reference' with tol or budget, got {method!r}")
    named = "mis" if method == "reference" or (planned and method == "auto") else method
    sampler, rule = registry.method(named, "direct")
    replicates = 1
    if method == "reference":
        spp, replicates = max(spp // REFERENCE_RUNS, REFERENCE_PASSES), REFERENCE_RUNS
    check.require("torch", "render", "pictures of scenes")
    from nqr_geom.integrator.estimate import run
    from nqr_geom.render.direct_problem import DirectProblem

    start = time.perf_counter()
    problem = DirectProblem.of(scene)
    seen = time.perf_counter() - start
    if planned:
        from nqr_geom.integrator.plan import Clock, Goal
        from nqr_geom.integrator.pursue import pursue
        from nqr_geom.render.plans import brightness, direct_ways

        unit = brightness(problem, seed)  # compiles what the scene calls for
        clock = Clock.start()
        goal = Goal.checked(problem.batch, tol, budget, scale=unit)
        estimate = pursue(direct_ways(problem, None if method == "auto" else [method], seed=seed), goal, clock)
    else:
        pair = registry.make("sampler", sampler), registry.make("rule", rule)
        estimate = run(problem, *pair, spp, replicates=replicates, seed=seed)
    if not full_output:
        camera = scene.camera
        return estimate.value.reshape(camera.height, camera.width, 3)
    rays = {
        "camera rays": problem.batch,
        "shadow rays, material": problem.rays["material"],
        "shadow rays, light": problem.rays["light"],
        "density queries": problem.rays["density queries"],
    }
    return replace(
        estimate,
        seconds=estimate.seconds + seen,
        counts=estimate.counts | rays,
        stages={"scene and camera rays": seen} | estimate.stages,
        plan=estimate.plan | {"kernels": problem.kernels},
    )
