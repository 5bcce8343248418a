"""How pictures, samples and times of direct light stand in tables."""

from __future__ import annotations

from page import Row, markdown, picture, short, span


def images(rows: list[Row]) -> str:
    """Means over the scenes, then every scene; the picture of some."""
    head = [
        "16 passes, five scenes",
        "PSNR",
        "SSIM",
        "DSSIM",
        "FLIP",
        "x less than random, 95%",
        "flicker, x less",
        "95%",
    ]
    means = markdown(
        [*head, "flicker over twice the squared error"],
        [
            [
                row["method"],
                f"{row['psnr']:.1f}",
                f"{row['ssim']:.4f}",
                *(short(row[key]) for key in ("dssim", "flip")),
                f"{short(row['flip_ratio'])}, {span(row['flip_interval'])}",
                short(row["flicker_ratio"]),
                span(row["flicker_interval"]),
                f"{row['noise_share']:.0%}",
            ]
            for row in rows
            if row["scene"] == "all"
        ],
    )
    methods = list(dict.fromkeys(row["method"] for row in rows))
    scenes = [name for name in dict.fromkeys(row["scene"] for row in rows) if name != "all"]
    of = {(row["scene"], row["method"]): row for row in rows}
    each = markdown(
        ["PSNR / DSSIM / FLIP", *methods],
        [
            [name]
            + [" / ".join([f"{of[name, m]['psnr']:.1f}", *(short(of[name, m][k], 2) for k in ("dssim", "flip"))])
               for m in methods]
            for name in scenes
        ],
    )  # fmt: skip
    return f"{means}\n{each}\n" + picture(
        "direct-images.png", "pictures by every method (structured: pmj+direct-unhidden), and FLIP's maps below"
    )


def strategy(rows: list[Row]) -> str:
    """Figs. 20 to 23: numbers over held-out scenes, then pictures."""
    kinds = ("matt", "glossy")
    head = ["16 passes, held-out scenes", "scatter", "towards lights", "by the material"]
    head += [f"part by the material, {kind}" for kind in kinds]
    head += [f"weight where it meets a lamp, {kind}" for kind in kinds]
    head += ["lights chosen for nothing", "choice off by", "on the rim", "weight there"]
    table = markdown(
        head,
        [
            [
                row["method"],
                *(f"{row[key]:.1%}" for key in ("scatter", "scatter_light", "scatter_material")),
                *(f"{row[f'material_part_{kind}']:.1%}" for kind in kinds),
                *(short(row[f"material_weight_{kind}"]) for kind in kinds),
                *(f"{row[key]:.1%}" for key in ("for_nothing", "choice_off", "rim_samples")),
                short(row["rim_weight"]),
            ]
            for row in rows
        ],
    )
    pictures = (
        ("parts", "light by directions to lights above, five times that by the material below"),
        ("lights", "lights that bring light, and how often they are chosen"),
        ("places", "where samples lie on lights and in the hemisphere, and what they weigh"),
    )
    return table + "\n" + "\n".join(picture(f"direct-strategy-{name}.png", what) for name, what in pictures)


def times(rows: list[Row]) -> str:
    """Tables 15 to 17: milliseconds an image, and times Monte Carlo's at the largest."""
    sizes = sorted({row["resolution"] for row in rows})
    lines = []
    for row in rows:
        if row["resolution"] != sizes[-1]:
            continue
        same = {r["resolution"]: r for r in rows if all(r[k] == row[k] for k in ("scene", "method", "n"))}
        lines.append(
            [f"{row['scene']}: {row['method']}", str(row["n"])]
            + [f"{short(same[size]['milliseconds'])} ({short(same[size]['times_mc'])})" for size in sizes]
            + [short(row["ns_per_pass"]), short(row["processor_times_mc"])]
            + [short(row[key]) if row[key] else "" for key in ("paper", "goal")]
        )
    head = ["scene: method", "passes", *(f"{size} x {size}, ms (x random)" for size in sizes), "ns a pass"]
    table = markdown([*head, "processor time, x random", "paper", "goal"], lines)
    return f"{table}\n" + picture("direct-time.png", "milliseconds by passes and by pixels")
