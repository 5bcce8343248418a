"""How pictures and numbers of walks stand in tables."""

from __future__ import annotations

from page import Row, markdown, picture, short


def fields(rows: list[Row]) -> str:
    """Figs. 32 and 33: mean squared errors over the pixels of each domain, then the pictures."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    mse = {(row["problem"], row["method"]): row["mse"] for row in rows}
    lines = []
    for name in dict.fromkeys(row["problem"] for row in rows):
        plain = mse[name, methods[0]]
        cells = [f"{short(mse[name, method])} ({short(plain / mse[name, method])} x)" for method in methods[1:]]
        lines.append([name, short(plain), *cells])
    pictures = (
        ("walk-fields.png", "errors by method on held-out polygons"),
        ("walk-fields-outside.png", "errors by method on a letter, a comb and a coast"),
    )
    table = markdown(["mean squared error (x MC)", *methods], lines)
    return table + "\n" + "\n".join(picture(*one) for one in pictures)


def strategy(rows: list[Row]) -> str:
    """Figs. 34 and 35: how straight walks are, how even their ends, and what the network gives to them."""
    head = [
        "32 walks",
        "way to the end over length",
        "largest gap between ends, of the boundary",
        "rank correlation of weight and distance",
        "given to points on the way",
    ]
    lines = [
        [
            row["method"],
            short(row["straightness"]),
            f"{row['largest_gap']:.1%}",
            short(row["rank_correlation"]) if "rank_correlation" in row else "",
            f"{row['share_of_ways']:.0%}" if "share_of_ways" in row else "",
        ]
        for row in rows
    ]
    pictures = (
        ("walk-strategy.png", "walks of each sampler, and their first two directions"),
        ("walk-weights.png", "ends of walks coloured by weight"),
    )
    return markdown(head, lines) + "\n" + "\n".join(picture(*one) for one in pictures)


def solvers(rows: list[Row]) -> str:
    """All solvers of Laplace's equation: 32 walks, and the tolerances of those without walks."""
    head = ["domain", "method", "walks or tolerance", "mean squared error", "us a query"]
    lines = [
        [row["domain"], row["method"], f"{row['tol']:g}" if "tol" in row else str(row["n"]), short(row["mse"]),
         short(row["us"])]
        for row in rows
        if row["n"] in (0, 32)
    ]  # fmt: skip
    return picture("walk-solvers.png", "error against time of all solvers") + "\n" + markdown(head, lines)


def nonlinear(rows: list[Row]) -> str:
    """Fig. 50: three polygons, p = 3 by the network and the exact solution for p = 2."""
    head = ["p = 3, polygon", "exact p = 2, mean squared error", "INet", "times better"]
    lines = [
        [str(row["polygon"]), short(row["mse_two"]), short(row["mse"]), short(row["mse_two"] / row["mse"])]
        for row in rows
    ]
    return markdown(head, lines) + "\n" + picture("p-fields.png", "p = 3 by finite elements and by walks, and errors")
