"""Tables of what plans promise and what came of it."""

from __future__ import annotations

from page import Row, markdown, short


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.1%}"


def _number(value: float | None) -> str:
    return "" if value is None else short(value)


def plans(rows: list[Row]) -> str:
    """Tolerances, then budgets; tolerances are in units of the problem's scale."""
    within = [
        [
            row["application"],
            f"{row['tol']:g}",
            str(row["cases"]),
            _share(row["said_met"]),
            _share(row["within"]),
            _number(row["cost"]),
            ", ".join(row["methods"]),
        ]
        for row in rows
        if "tol" in row
    ]
    timed = [
        [
            row["application"],
            f"{row['budget']:g} s",
            str(row["cases"]),
            _share(row["kept"]),
            _number(row["error_over_best"]),
            ", ".join(row["methods"]),
        ]
        for row in rows
        if "budget" in row
    ]
    by_tolerance = markdown(
        ["", "tolerance", "calls", "said to be met", "answers within", "time over the cheapest's", "chosen"], within
    )
    by_budget = markdown(["", "budget", "calls", "kept", "error over the best's", "chosen"], timed)
    return f"{by_tolerance}\n{by_budget}"
