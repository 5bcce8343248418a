"""Tables of what learned rules cost in time."""

from __future__ import annotations

from page import Row, markdown, short


def learned_time(rows: list[Row]) -> str:
    """Table 18's layout."""
    sizes = sorted({row["resolution"] for row in rows})
    lines = []
    for n in sorted({row["n"] for row in rows}, reverse=True):
        for method in dict.fromkeys(row["method"] for row in rows):
            of = {row["resolution"]: row for row in rows if row["method"] == method and row["n"] == n}
            last = of[sizes[-1]]
            told = (f"{short(of[size]['times_mc'])} ({short(of[size]['processor_times_mc'])})" for size in sizes)
            lines.append([f"{method}, {n}", *told, short(last["us_per_integral"]), short(last["ns_per_sample"])])
    squares = [f"{size} x {size}" for size in sizes]
    head = ["method, samples: times Monte Carlo, wall (processor)", *squares, "us an integral", "ns a sample"]
    return markdown(head, lines)


def equal_time(rows: list[Row]) -> str:
    """Who is best in equal time, and the cost of a query from which a rule wins."""
    return "![error against time](equal-time.png)\n" + _equal(rows) + _break_even(rows)


def _equal(rows: list[Row]) -> str:
    """Who is best within the time of so many Monte Carlo samples."""

    def best(point: Row | None) -> list[str]:
        return ["", ""] if point is None else [f"{point['method']}, {point['n']}", short(point["mse"])]

    lines = [
        [
            f"{row['application']}, {row['n']}",
            short(row["us"]),
            *best(row["classical"]),
            *best(row["other"]),
            short(row["ratio"]) if row["other"] else "nothing fits",
        ]
        for row in rows
        if row["kind"] == "equal time"
    ]
    head = [
        "time of so many Monte Carlo samples",
        "us",
        "best classical rule",
        "MSE",
        "best other",
        "MSE",
        "times better",
    ]
    return "\nThe best within equal processor time, on held-out integrals:\n\n" + markdown(head, lines)


def _break_even(rows: list[Row]) -> str:
    """Costs c* of a query."""
    lines = [
        [
            f"{row['application']}: {row['method']}, {row['n']}",
            short(row["mse"]),
            short(row["overhead_us"]),
            short(row["classical_samples"]) if row["classical_samples"] else f"more than {row['most_samples']}",
            "never"
            if row["cost_us"] is None
            else ("" if row["classical_samples"] else "at most ") + short(1000.0 * row["cost_us"]),
            short(1000.0 * row["query_us"]),
        ]
        for row in rows
        if row["kind"] == "break-even"
    ]
    head = ["method, samples", "MSE", "us beyond its queries", "classical samples for it", "break-even ns a query",
            "ns a query here"]  # fmt: skip
    return "\nFrom which cost of a query on each wins at equal time:\n\n" + markdown(head, lines)


def sampling(rows: list[Row]) -> str:
    """A sampling network alone and with its integrator, compiled and not."""
    size = rows[0]["resolution"]
    return markdown(
        [f"processor time, 32 samples, {size} x {size}", "us a query", "times Monte Carlo's"],
        [[row["method"], short(row["us_per_query"]), short(row["times_mc"])] for row in rows],
    )


def precision(rows: list[Row]) -> str:
    """Answers and lessons in float32 and with products in bfloat16."""
    return markdown(
        ["network: processor time, one thread", "float32, us an integral", "bfloat16", "bfloat16 over float32"],
        [
            [f"{row['network']}, {row['kind']}", *(short(row[key]) for key in ("float32", "bfloat16", "ratio"))]
            for row in rows
        ],
    )


def callables(rows: list[Row]) -> str:
    """The structured method and its parts on a callable, compiled and by tensors."""
    return markdown(
        ["32 samples: problem, queries", "", "us a query", "by tensors", "times as long", "times Monte Carlo"],
        [
            [
                f"{row['problem']}, {row['queries']:,}",
                row["part"],
                *(short(row[key]) for key in ("us", "tensors_us", "ratio", "times_mc")),
            ]
            for row in rows
        ],
    )


def fresh_memory(rows: list[Row]) -> str:
    """A network whose tiles keep their memory, and one whose tiles do not."""
    return markdown(
        ["freed blocks", "milliseconds a picture", "fresh pages", "times as long"],
        [[row["blocks"], *(short(row[key]) for key in ("milliseconds", "pages", "times_kept"))] for row in rows],
    )
