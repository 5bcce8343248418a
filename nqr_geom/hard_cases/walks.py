"""Laplace problems by a rule over few walks: Latin hypercube, sorted, structured and weighed by a network."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import nqr_geom as ng
from nqr_geom.hard_cases.case import Case, refusal
from nqr_geom.hard_cases.laplace import TABLE, UNIT, Row, _constant, _maximum, _outside, _truth, outside_refused

__all__ = ["cases"]

METHODS = ("wos-lhs", "wos-rqmc", "structured", "inet")

# 12 steps leave walks unfinished, so that their own bias is in the error of all of them alike.
_ROWS = ("jump on the square", "re-entrant corner", "channel", "comb with teeth 0.02 wide", "sieve of 20 holes",
         "needle with an angle of 1e-3", "snowflake", "shift 1e6")  # fmt: skip
_RESOLVED = 1e-3  # of the spread of the data: what the panels of a rebuilt boundary resolve


def _beside_monte_carlo(row: Row, method: str) -> float:
    """Root mean square error over that of 32 independent walks of 12 steps, or over what panels resolve."""
    truth, points = np.tile(_truth(row), 24), np.tile(np.asarray(row.points, dtype=float), (24, 1))
    solve = partial(ng.solve_laplace, row.polygon, row.boundary, points, n=32)

    def rms(**how: Any) -> float:
        return float(np.sqrt(np.mean((np.asarray(solve(**how)) - truth) ** 2)))

    outline = row.polygon.exterior.coords if hasattr(row.polygon, "exterior") else row.polygon
    data = row.boundary(np.asarray(outline, dtype=float)) if callable(row.boundary) else row.boundary
    return rms(method=method) / max(rms(method="wos", max_steps=12), _RESOLVED * float(np.ptp(data)))


def _plain_mean(value: float) -> float:
    """What a sum over 50 walks makes of a constant."""
    return abs(sum([value] * 50) / 50 - value)


_REFUSED: tuple[tuple[str, dict[str, Any], str], ...] = (
    (
        "screening for capped walks",
        {"method": "wos-lhs", "screening": 1.0},
        "screening: expected none with method 'wos-lhs'",
    ),
    ("a source for the network", {"method": "inet", "source": 1.0}, "source: expected none with method 'inet'"),
    ("walks the network knows not", {"method": "inet", "max_steps": 20}, "max_steps: expected 12 with method 'inet'"),
)


def cases() -> list[Case]:
    """Walks under a rule."""
    group, made = "walks", []
    for row in TABLE:
        for method in METHODS:
            if row.name in _ROWS:
                run = partial(_beside_monte_carlo, row, method)
                made.append(Case(group, f"32 walks: {row.name} [{method}]", run, 1.2))
    for method in METHODS:
        for value in (0.1, -7.0, 1e60):
            naive = partial(_plain_mean, value) if value == 0.1 else None
            made.append(Case(group, f"a constant [{value:g}, {method}]", partial(_constant, method, value), 0.0, naive))
        made.append(Case(group, f"NaN outside [{method}]", partial(_outside, method), 0.0))
        made.append(outside_refused(group, method))
        if method != "inet":  # its weights may be negative
            made.append(Case(group, f"maximum principle [{method}]", partial(_maximum, method), 1e-9))
    for name, change, words in _REFUSED:
        arguments = {"polygon": UNIT, "boundary": np.zeros(4), "points": [[0.5, 0.5]], **change}
        made.append(refusal(group, name, partial(ng.solve_laplace, **arguments), words))
    return made
