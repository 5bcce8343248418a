"""Commands that draw light: `render` for scenes, `transmittance` for volumes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from nqr_geom import check
from nqr_geom.cli._app import app, out_console
from nqr_geom.cli._shared import Budget, Seed, Tol, show_estimate

__all__ = ["render", "transmittance"]


@app.command
def render(
    scene: Annotated[
        str,
        Parameter(
            help="two-spheres, teaser, white-room, living-room, staircase, plates, a .json scene, or a mesh file "
            "to stand on a floor."
        ),
    ] = "two-spheres",
    *,
    method: Annotated[
        str, Parameter(help="random, mis, regression, structured, inet, nqr, reference, or sampler+rule.")
    ] = "structured",
    spp: Annotated[int, Parameter(name=["--spp", "-n"], help="Passes a pixel.")] = 64,
    width: Annotated[int, Parameter(help="Pixels; a .json scene has its own.")] = 320,
    height: Annotated[int, Parameter(help="Pixels; a .json scene has its own.")] = 240,
    tol: Tol = None,
    budget: Budget = None,
    seed: Seed = 0,
    report: Annotated[bool, Parameter(help="Say what the scene calls for and what ran.")] = False,
    out: Annotated[Path, Parameter(help="A picture (.png), or linear radiance (.npy).")] = Path("render.png"),
) -> None:
    """Draw a scene under spherical lights by direct illumination."""
    from nqr_geom.render.scene_file import scene_named

    check.choice("out", out.suffix.lower(), (".png", ".npy"))
    made = scene_named(scene, width, height)
    from nqr_geom.render.direct_light import direct
    from nqr_geom.render.film import save_picture
    from nqr_geom.render.world import lights_seen

    estimate: Any = direct(made, spp=spp, method=method, tol=tol, budget=budget, seed=seed, full_output=True)
    image = estimate.value.reshape(made.camera.height, made.camera.width, 3)
    if out.suffix.lower() == ".png":
        image = image + lights_seen(made)
    path = save_picture(out, image)
    if report:
        show_estimate(f"{scene}: {method}, {spp} passes", estimate)
    out_console.print(f"wrote {path}", highlight=False)


@app.command
def transmittance(
    source: Annotated[
        str, Parameter(help="cloud, donut, or a .npy file of densities (nx, ny, nz), whose longest side has length 1.")
    ] = "cloud",
    *,
    text: Annotated[bool, Parameter(help="Take SOURCE as text and fill its letters with cloud.")] = False,
    density: Annotated[float, Parameter(help="Times the densities.")] = 1.0,
    axis: Annotated[str, Parameter(help="Direction of the rays: x, y or z.")] = "z",
    method: Annotated[
        str,
        Parameter(
            help="stratified, random, trapezoid, regression, jackknife, structured, inet, nqr, ratio, track-length, "
            "unbiased-raymarching, or sampler+rule."
        ),
    ] = "stratified",
    samples: Annotated[int, Parameter(name=["--samples", "-n"], help="Density queries per ray.")] = 24,
    resolution: Annotated[int, Parameter(help="Pixels of the picture's longer side.")] = 256,
    tol: Tol = None,
    budget: Budget = None,
    seed: Seed = 0,
    report: Annotated[bool, Parameter(help="Say what the volume calls for and what ran.")] = False,
    out: Annotated[Path, Parameter(help="A picture (.png) or values (.npy).")] = Path("transmittance.png"),
) -> None:
    """Draw the light that gets through a volume."""
    from nqr_geom.through import named_volume, save_image, see_through

    check.choice("out", out.suffix.lower(), (".png", ".npy"))
    volume = named_volume(source, text=text, density=density, seed=seed)
    asked: dict[str, Any] = {"method": method, "n": samples, "tol": tol, "budget": budget, "seed": seed}
    image, estimate = see_through(volume, axis=axis, resolution=resolution, **asked)
    if report:
        show_estimate(f"{source}: {method}, {samples} queries", estimate)
    out_console.print(f"wrote {save_image(out, image)}", highlight=False)
