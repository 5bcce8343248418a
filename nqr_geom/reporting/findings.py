"""What follows from measured cells: who is best from which time on, at equal time, and from which cost of a query."""

from __future__ import annotations

from typing import Any

import numpy as np

from nqr_geom.integrator.break_even import break_even, samples_to_match
from nqr_geom.integrator.frontier import Frontier
from nqr_geom.integrator.measure import Point

__all__ = ["break_even_costs", "equal_time", "frontier_of", "headline", "points_of", "reference_budget"]

Record = dict[str, Any]

_USUAL = 32  # samples at which methods are compared, what networks are trained on
_CLASSICAL = ("classical", "tracking", "library")
_TIMES = (4, 16, 64, 256)  # samples' worth of the baseline's time


def points_of(record: Record, *kinds: str) -> list[Record]:
    """Cells of an application that have a point, of some kinds or of all that spend samples."""
    return [
        cell
        for cell in record["cells"]
        if cell["point"] and (cell["kind"] in kinds if kinds else cell["kind"] != "exact")
    ]


def reference_budget(record: Record) -> int:
    """The number of samples at which methods are compared: 32, or the nearest at which the baseline was measured."""
    sizes = [cell["n"] for cell in points_of(record) if cell["method"] == record["baseline"]]
    return min(sizes, key=lambda n: (abs(np.log(n / (_USUAL * record["scale"]))), n), default=_USUAL)


def frontier_of(record: Record) -> Frontier:
    """The cells as the frontier that `nqr_geom.frontier` gives."""
    return Frontier(
        problem=record["name"],
        batch=record["batch"],
        groups=record["groups"],
        runs=record["runs"],
        seed=record["seed"],
        baseline=record["baseline"],
        intervals_over=record["intervals_over"],
        points=[Point.from_dict(cell["point"]) for cell in record["cells"] if cell["point"]],
        refused={f"{cell['method']}, n = {cell['n']}": cell["refused"] for cell in record["cells"] if cell["refused"]},
    )


def _baseline(record: Record) -> dict[int, Record]:
    """Points of the baseline by number of samples."""
    return {cell["n"]: cell["point"] for cell in points_of(record) if cell["method"] == record["baseline"]}


def equal_time(record: Record) -> list[Record]:
    """Best classical method and best other one within the time of 4, 16, 64 and 256 samples of the baseline.

    Returns
    -------
    list of dict
        n, seconds, and for "classical" and "other" the method, its n and its mse, or None where nothing is so fast.
    """
    baseline = _baseline(record)
    rows = []
    for n in (record["scale"] * samples for samples in _TIMES):
        if n not in baseline:
            continue
        within = baseline[n]["seconds"]
        row: Record = {"n": n, "seconds": within}
        for label in ("classical", "other"):
            cells = [c for c in points_of(record) if (c["kind"] in _CLASSICAL) == (label == "classical")]
            fast = [c for c in cells if c["point"]["seconds"] <= within]
            best = min(fast, key=lambda c: c["point"]["mse"], default=None)
            row[label] = best and {"method": best["method"], "n": best["n"], "mse": best["point"]["mse"]}
        rows.append(row)
    return rows


def _classical_curve(record: Record) -> tuple[list[int], list[float]]:
    """Smallest error of a classical method at each number of samples."""
    cells = points_of(record, *_CLASSICAL)
    sizes = sorted({cell["n"] for cell in cells})
    errors = [min(cell["point"]["mse"] for cell in cells if cell["n"] == n) for n in sizes]
    kept = [(n, error) for n, error in zip(sizes, errors, strict=True) if error > 0.0]
    return [n for n, _ in kept], [error for _, error in kept]


def break_even_costs(record: Record) -> list[Record]:
    """From which cost of an integrand query on each costly method wins against the best classical one at equal time.

    With N samples that take t beyond their queries, and M classical samples for the same error, c* = t / (M - N).

    Returns
    -------
    list of dict
        method, kind, n, mse, `overhead` seconds beyond the queries, `needed` classical samples (None beyond what was
        measured), `cost` seconds a query (None if never, an upper bound if `needed` is None), `query` seconds that one
        takes here, and `verdict`: "already", "above", "never".
    """
    sizes, errors = _classical_curve(record)
    baseline = _baseline(record)
    if len(sizes) < 2 or not baseline:
        return []
    most = max(baseline)
    query = baseline[most]["seconds"] / most
    rows = []
    for cell in points_of(record, "structured", "student", "learned"):
        point, n = cell["point"], cell["n"]
        if n > max(sizes) // 4:  # the classical curve ends before it could tell
            continue
        overhead = max(0.0, point["seconds"] - n * query)
        needed = samples_to_match(sizes, errors, point["mse"])
        cost = break_even(sizes, errors, n, point["mse"], overhead)
        if not np.isfinite(needed):
            cost = overhead / (max(sizes) - n)
        verdict = "never" if not np.isfinite(cost) else "already" if cost <= query else "above"
        rows.append(
            {
                "method": cell["method"],
                "kind": cell["kind"],
                "n": n,
                "mse": point["mse"],
                "overhead": overhead,
                "needed": float(needed) if np.isfinite(needed) else None,
                "most": max(sizes),
                "cost": float(cost) if np.isfinite(cost) else None,
                "query": query,
                "verdict": verdict,
            }
        )
    return rows


def headline(record: Record) -> Record:
    """One line an application: best at equal samples, and best in the baseline's time for eight times as many."""
    n = reference_budget(record)
    at = [cell for cell in points_of(record) if cell["n"] == n]
    best = min(at, key=lambda cell: cell["point"]["mse"], default=None)
    rows = equal_time(record)
    return {"n": n, "best": best, "time": rows[-1] if rows else None}
