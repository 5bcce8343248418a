"""How the figures of direct light stand in tables."""

from __future__ import annotations

from page import Row, interval, markdown, short

OUTSIDE = ("teaser", "white-room", "living-room", "staircase", "plates")


def methods(rows: list[Row]) -> str:
    picture = "\n![Five rooms at 16 passes, times below random passes, and the truth](direct-light-methods.png)\n"
    return (
        picture
        + "\n"
        + markdown(
            ["16 passes a pixel", "mean squared error", "x random", "95%", "paper", "median", "99%", *OUTSIDE],
            [
                [
                    row["method"],
                    short(row["mse"]),
                    short(row["ratio"]),
                    interval(row),
                    short(row["paper_ratio"]) if row["paper_ratio"] else "",
                    short(row["median"]),
                    short(row["p99"]),
                    *(f"{short(row[where])} ({row[f'{where}, x']:.2f}x)" for where in OUTSIDE),
                ]
                for row in rows
            ],
        )
    )


def mitsuba(rows: list[Row]) -> str:
    return markdown(
        ["128 x 128, 16 + 16 directions", "ms", "Mitsuba ms", "times faster", "means differ by"],
        [
            [r["case"], short(r["ms"]), short(r["mitsuba_ms"]), short(r["ratio"]), f"{r['mean_difference']:+.2%}"]
            for r in rows
        ],
    )


def effects(rows: list[Row]) -> str:
    return markdown(
        [
            "the scene calls for",
            "ms",
            "with everything on",
            "time saved",
            "shadow rays",
            "with everything",
            "differs by",
        ],
        [
            [
                r["case"],
                short(r["ms"]),
                short(r["ms_with_everything"]),
                f"{r['saved']:.0%}",
                f"{r['rays']:,}",
                f"{r['rays_with_everything']:,}",
                f"{r['largest_difference']:.0e}" if r["largest_difference"] else "0",
            ]
            for r in rows
        ],
    )
