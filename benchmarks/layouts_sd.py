"""Tables of the smoothed distance for the page of figures."""

from __future__ import annotations

from collections.abc import Sequence

from page import NAMES, Row, interval, markdown, picture, short, span


def _name(row: Row) -> str:
    return f"{NAMES.get(row['rule'], row['rule'])}, {row['design']}"


def methods(rows: Sequence[Row]) -> str:
    """Figs. 45 and 46: errors of every method, and squared biases."""
    errors = [
        [
            _name(row),
            *(short(row[key]) for key in ("mse", "median", "p99", "ratio")),
            interval(row),
            span(row["gain_interval"]) if "gain_interval" in row else "",
            f"{row['fallback']:.1%}",
        ]
        for row in rows
        if "squared_bias" not in row
    ]
    head = [
        "rule, samples",
        "mean squared error",
        "median",
        "99%",
        "x Monte Carlo",
        "95%",
        "x own base, 95%",
        "flagged",
    ]
    biases = [
        [
            _name(row),
            short(row["mse"]),
            short(row["squared_bias"]),
            f"> {short(row['ratio_at_least'])}" if row["ratio"] is None else short(row["ratio"]),
            span(row["squared_bias_interval"]),
        ]
        for row in rows
        if "squared_bias" in row
    ]
    runs = rows[-1]["runs"]
    below = ["rule, samples", f"mean squared error, {runs} runs", "squared bias", "x Monte Carlo", "squared bias, 95%"]
    pictures = picture("sd-fields.png", "fields and errors") + "\n" + picture("sd-bias.png", "squared biases")
    about = "\nOne held-out shape; the means below the pictures are those of the tables.\n\n"
    return markdown(head, errors) + "\n" + markdown(below, biases) + about + pictures


def ablation(rows: Sequence[Row]) -> str:
    """Fig. 44: one thing changed each."""
    first = rows[0]
    away = ["0 to 0.05", "0.05 to 0.2", "0.2 to 0.5", "over 0.5"]
    lines = [
        [row["variant"], short(row["mse"]), short(row["median"]), short(row["ratio"]), interval(row)]
        + [short(value) for value in row["mse_by_distance"]]
        for row in rows
    ]
    head = [
        "variant",
        "mean squared error",
        "median",
        "x Monte Carlo",
        "95%",
        *(f"at {text}" for text in away),
    ]
    about = f"{first['iterations']:,} iterations of {first['batch']} integrals each, from the same weights.\n\n"
    return about + markdown(head, lines) + "\n" + picture("sd-ablation.png", "learning curves and errors by distance")


def strategy(rows: Sequence[Row]) -> str:
    """Fig. 47: where samples lie and what they weigh."""
    head = [
        "samples",
        "within 1/alpha of the nearest",
        "their weight, median",
        "the others'",
        "their part of the estimate",
    ]
    lines = [
        [
            row["design"],
            f"{row['near_share']:.0%}",
            short(row["median_weight_near"]),
            short(row["median_weight_far"]),
            f"{row['estimate_from_near']:.0%}",
        ]
        for row in rows
    ]
    return markdown(head, lines) + "\n" + picture("sd-strategy.png", "samples and weights")
