"""Direct light beside Mitsuba 3's: the same scene, the same number of directions by light and by material.

    python benchmarks/mitsuba_direct.py [--quick]

Mitsuba is no dependency: install it for this script alone (pip install mitsuba). Both render a picture of 128 x 128
pixels with 16 directions of each kind in a pixel on all cores, in turns, the best of several repetitions; nothing is
left of compilation. Pictures of many passes are compared pixel by pixel.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import best_seconds, write

from nqr_geom import render
from nqr_geom.render.materials import Checker, Conductor, Diffuse
from nqr_geom.render.scene import Scene
from nqr_geom.render.scene_gallery import gallery
from nqr_geom.render.world import lights_seen

NAMES = ("two-spheres", "white-room", "living-room", "staircase", "teaser")


def _material(material: Any) -> dict[str, Any]:
    def colour(values: Any) -> dict[str, Any]:
        if isinstance(values, Checker):
            to_uv = mi.ScalarTransform4f().scale([values.squares / 2.0, values.squares / 2.0, 1.0])
            ends = {"color0": colour(values.even), "color1": colour(values.odd)}
            return {"type": "checkerboard", "to_uv": to_uv} | ends
        return {"type": "rgb", "value": [float(v) for v in values]}

    if isinstance(material, Diffuse):
        inner: dict[str, Any] = {"type": "diffuse", "reflectance": colour(material.albedo)}
    elif isinstance(material, Conductor):
        inner = {"type": "roughconductor", "distribution": "ggx", "alpha": material.roughness}
        inner |= {"eta": colour(material.eta), "k": colour(material.k)}
    else:
        inner = {"type": "roughplastic", "distribution": "ggx", "alpha": material.roughness, "int_ior": material.ior}
        inner |= {"ext_ior": 1.0, "diffuse_reflectance": colour(material.albedo), "nonlinear": False}
    return {"type": "twosided", "material": inner}


def _mesh(k: int, mesh: render.Mesh) -> Any:
    """A Mitsuba mesh with our vertices, normals and texture coordinates."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_material(mesh.material))
    if mesh.normals is None:
        properties["face_normals"] = True
    made = mi.Mesh(
        f"mesh{k}", len(mesh.vertices), len(mesh.faces), has_vertex_normals=mesh.normals is not None,
        has_vertex_texcoords=mesh.uv is not None, props=properties,
    )  # fmt: skip
    given = mi.traverse(made)
    given["vertex_positions"] = np.ascontiguousarray(mesh.vertices.ravel(), dtype=np.float32)
    given["faces"] = np.ascontiguousarray(mesh.faces.ravel(), dtype=np.uint32)
    if mesh.normals is not None:
        given["vertex_normals"] = np.ascontiguousarray(mesh.normals.ravel(), dtype=np.float32)
    if mesh.uv is not None:
        given["vertex_texcoords"] = np.ascontiguousarray(mesh.uv.ravel(), dtype=np.float32)
    given.update()
    return made


def translated(scene: Scene) -> Any:
    """The same scene for Mitsuba."""
    camera = scene.camera
    frame = mi.ScalarTransform4f().look_at(
        origin=camera.position.tolist(), target=camera.look_at.tolist(), up=camera.up.tolist()
    )
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}}
    parts: dict[str, Any] = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": camera.fov, "fov_axis": "y", "to_world": frame, "film": film},
    }
    for k, mesh in enumerate(scene.meshes):
        parts[f"mesh{k}"] = _mesh(k, mesh)
    for k, sphere in enumerate(scene.spheres):
        place = {"center": sphere.center.tolist(), "radius": sphere.radius}
        parts[f"sphere{k}"] = {"type": "sphere", "bsdf": _material(sphere.material)} | place
    for k, light in enumerate(scene.lights):
        place = {"center": light.center.tolist(), "radius": light.radius}
        shine = {"type": "area", "radiance": {"type": "rgb", "value": light.emission.tolist()}}
        parts[f"light{k}"] = {"type": "sphere", "emitter": shine} | place
    return mi.load_dict(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one scene, fewer passes")
    quick = parser.parse_args().quick
    mi.set_variant("scalar_rgb")
    repeats = 3 if quick else 9
    rows: list[dict[str, Any]] = []
    for name in NAMES[:1] if quick else NAMES:
        scene = gallery(name)
        theirs = translated(scene)
        direct = {"type": "direct", "emitter_samples": 16, "bsdf_samples": 16, "hide_emitters": True}
        integrator = mi.load_dict(direct)

        def mitsuba(spp: int = 1, seed: int = 0) -> Any:
            picture = np.array(mi.render(theirs, integrator=integrator, spp=spp, seed=seed))  # noqa: B023
            return picture[..., :3].astype(np.float64)

        def ours() -> Any:
            return render.direct(scene, spp=16)  # noqa: B023

        ours(), mitsuba()
        turns = [(best_seconds(ours, 1), best_seconds(mitsuba, 1)) for _ in range(repeats)]
        seconds = np.min(turns, axis=0).tolist()
        truth = render.direct(scene, spp=1024, method="structured")
        open_view = lights_seen(scene).sum(axis=2) == 0.0  # hidden lights are black here, and not there in Mitsuba
        many = np.mean([mitsuba(4 if quick else 16, seed) for seed in range(2 if quick else 8)], axis=0)
        # Mitsuba moves its samples inside a pixel; edges of things and of squares differ by that.
        smooth = open_view & (
            np.abs(np.diff(np.pad(truth, ((0, 0), (0, 1), (0, 0)), mode="edge"), axis=1)).max(axis=2) < 0.02
        )
        smooth &= np.abs(np.diff(np.pad(truth, ((0, 1), (0, 0), (0, 0)), mode="edge"), axis=0)).max(axis=2) < 0.02
        rows.append(
            {
                "case": name,
                "ms": 1e3 * seconds[0],
                "mitsuba_ms": 1e3 * seconds[1],
                "ratio": seconds[1] / seconds[0],
                "mean": float(truth.mean()),
                "mean_difference": float((many - truth)[open_view].mean() / truth.mean()),
                "median_pixel_difference": float(np.median(np.abs(many - truth)[smooth] / truth.mean())),
            }
        )
    table = Table("scene", "ms", "Mitsuba ms", "times faster", "means differ by", "median pixel differs by")
    for row in rows:
        table.add_row(
            row["case"], *(f"{row[k]:.3g}" for k in ("ms", "mitsuba_ms", "ratio")),
            f"{row['mean_difference']:+.2%}", f"{row['median_pixel_difference']:.2%}",
        )  # fmt: skip
    Console().print(table)
    if not quick:
        threads = os.environ.get("OMP_NUM_THREADS", "all")
        print(
            write(
                "mitsuba_direct", rows, repeats=repeats, mitsuba=mi.__version__, variant=mi.variant(), threads=threads
            )
        )


if __name__ == "__main__":
    main()
