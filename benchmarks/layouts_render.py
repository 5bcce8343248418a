"""How the figures of rendering stand in tables."""

from __future__ import annotations

from page import Row, interval, markdown, picture, short, span


def transmittance(rows: list[Row]) -> str:
    return markdown(
        [
            "24 queries a ray",
            "mean squared error",
            "x random",
            "95%",
            "paper",
            "median",
            "99%",
            "queries",
            "noise",
        ],
        [
            [
                f"{row['set']}: {row['method']}",
                short(row["mse"]),
                short(row["ratio"]),
                interval(row),
                short(row["paper_ratio"]) if row["paper_ratio"] else "",
                short(row["median"]),
                short(row["p99"]),
                f"{row['queries_a_ray']:.1f}",
                f"{row['noise_a_ray']:.1f}",
            ]
            for row in rows
            if "ratio" in row
        ],
    )


def learned_transmittance(rows: list[Row]) -> str:
    """Networks beside their bases on the same queries of whole rays; those of cloudy stretches are in the JSON."""
    return markdown(
        ["24 queries a ray", "mean squared error", "x random", "95%", "x its base", "95%"],
        [
            [f"{row['set']}: {row['design']} + {row['rule']}", short(row["mse"]), short(row["ratio"]), interval(row)]
            + ([short(row["gain"]), span(row["gain_interval"])] if "gain" in row else ["", ""])
            for row in rows
            if row["support"] == "bounds" and row["rule"] != "uniform"
        ],
    )


def transmittance_bias(rows: list[Row]) -> str:
    """A squared bias below what the mean of all runs still holds of noise is not told from none; with the picture."""
    table = markdown(
        ["mean of 256 runs", "mean squared error of one", "squared bias", "share of it"],
        [
            [
                f"{row['set']}: {row['method']}",
                short(row["mse"]),
                short(row["bias2"]) if row["bias2"] > row["noise"] else f"below {short(row['noise'])}",
                f"{max(row['bias2'], row['noise']) / row['mse']:.1%}",
            ]
            for row in rows
            if "bias2" in row
        ],
    )
    return f"{table}\n![Errors of one run and of the mean of 256](transmittance.png)\n"


def effects(rows: list[Row]) -> str:
    return markdown(
        ["what is absent", "ms", "with everything on", "times", "queries", "of", "noise evaluations", "of"],
        [
            [row["absent"], short(row["ms"]), short(row["everything_ms"]), short(row["times"])]
            + [f"{count:,}" for pair in (row["queries"], row["noise"]) for count in pair]
            for row in rows
        ],
    )


def ablation(rows: list[Row]) -> str:
    """Fig. 27; a squared bias below what chance leaves of the mean is not told from none."""
    table = markdown(
        ["variant", "mean squared error", "median", "99%", "x stratified", "95%", "squared bias"],
        [
            [
                row["variant"],
                *(short(row[key]) for key in ("mse", "median", "p99", "ratio")),
                interval(row),
                short(row["bias2"]) if row["bias2"] > row["bias_noise"] else f"below {short(row['bias_noise'])}",
            ]
            for row in rows
        ],
    )
    length = f"{rows[0]['iterations']} iterations of {rows[0]['batch']} integrals each, from the same weights, "
    return f"{length}{rows[0]['n']} queries a ray.\n\n{table}\n" + picture(
        "transmittance-ablation.png", "learning curves, and errors and biases on held-out clouds"
    )


def strategy(rows: list[Row]) -> str:
    """Figs. 48 and 49: where samples go, and pictures."""
    classes = list(rows[0]["shares"])
    table = markdown(
        ["24 queries a ray: share", *(f"density {c}" for c in classes), *(f"weight there, {c}" for c in classes)],
        [
            [row["method"], *(f"{row['shares'][c]:.1%}" for c in classes)]
            + [short(row["weights"][c]) if "weights" in row else "" for c in classes]
            for row in rows
        ],
    )
    pictures = (
        ("transmittance-strategy.png", "density along two rays, with samples and their weights"),
        ("transmittance-errors.png", "errors of one run on a cloud, a donut and letters"),
    )
    return table + "\n" + "\n".join(picture(*one) for one in pictures)
