"""Whether plans hold: answers to a tolerance and within a time, on questions that no model was measured on.

    cd benchmarks && python planner.py [--only gwn,sd] [--out results/planner.json]

For every application and tolerance: the share of true errors within the tolerance; the share of calls whose every
answer is; and the cost over that of the cheapest fixed method and number of samples with 95 in 100 answers within the
tolerance, found by trying them all. For budgets: the share of calls that took at most 1.25 times their time, and the
error over the smallest that any fixed method reached in the time.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import planner_problems as problems

from nqr_geom.files import write_whole
from nqr_geom.machine import machine, versions

OUT = Path(__file__).resolve().parent / "results" / "planner.json"
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)  # of the scale
BUDGETS = (0.1, 0.4)
SLACK = 1.25
MOST_SECONDS = 1.0  # a fixed method that takes longer is not tried with more samples
SEED = 101


def clocked(call: Any) -> tuple[Any, float]:
    """A call's answer and its wall time."""
    start = time.perf_counter()
    answer = call()
    return answer, time.perf_counter() - start


def fixed(name: str, case: problems.Case) -> list[tuple[str, float, float]]:
    """Every method with every number of samples, as a user would call it: name, seconds, 95% quantile of the error."""
    found = []
    count = "spp" if name == "direct" else "n"
    for method, study in problems.STUDIES[name].items():
        least = case.way(method).least
        for amount in study["tols"] if "tols" in study else study["sizes"]:
            if "tols" in study:
                asked: dict[str, Any] = {"tol": amount * case.scale} if name == "laplace" else {}
            elif amount >= least:
                asked = {count: amount}
            else:
                continue
            ask = lambda a=asked, m=method: case.ask(case.points, method=m, seed=SEED, **a)  # noqa: E731
            ask()
            got, seconds = clocked(ask)
            found.append((method, seconds, quantile(got.value, case)))
            if seconds > MOST_SECONDS:
                break
    return found


def errors(value: np.ndarray, case: problems.Case) -> np.ndarray:
    return np.maximum(np.abs(value - case.truth).max(axis=1) - case.floor, 0.0) / case.scale


def quantile(value: np.ndarray, case: problems.Case) -> float:
    return float(np.quantile(errors(value, case), 0.95))


def tolerances(name: str, cases: list[problems.Case], tried: list[Any]) -> list[dict[str, Any]]:
    """A row a tolerance."""
    rows = []
    for tol in TOLERANCES:
        within, whole, cost, said, chosen = [], [], [], [], []
        for case, known in zip(cases, tried, strict=True):
            ask = lambda c=case, t=tol: c.ask(c.points, method="auto", tol=t * c.scale, seed=SEED)  # noqa: E731
            ask()
            got, seconds = clocked(ask)
            off = errors(got.value, case)
            good = [spent for _, spent, error in known if error <= tol]
            said.append(bool(got.plan["met"]))
            chosen.append(got.plan["method"])
            if got.plan["met"]:
                within.append(off <= tol)
                whole.append(bool((off <= tol).all()))
                if good:
                    cost.append(seconds / min(good))
        held = np.concatenate(within) if within else np.zeros(0)
        rows.append({"application": name, "tol": tol, "cases": len(cases), "said_met": float(np.mean(said)),
                     "within": float(held.mean()) if len(held) else None,
                     "calls_within": float(np.mean(whole)) if whole else None,
                     "cost": float(np.median(cost)) if cost else None,
                     "methods": sorted(set(chosen))})  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def budgets(name: str, cases: list[problems.Case], tried: list[Any]) -> list[dict[str, Any]]:
    """A row a budget."""
    rows = []
    for budget in BUDGETS:
        kept, ratio, chosen, refused = [], [], [], 0
        for case, known in zip(cases, tried, strict=True):
            ask = lambda c=case, b=budget: c.ask(c.points, method="auto", budget=b, seed=SEED)  # noqa: E731
            try:
                ask()
                got, seconds = clocked(ask)
            except ValueError:
                refused += 1
                continue
            kept.append(seconds - got.plan["warmup_seconds"] <= SLACK * budget)
            chosen.append(got.plan["method"])
            best = [error for _, spent, error in known if spent <= budget]
            if best:
                ratio.append((quantile(got.value, case) + 1e-6) / (min(best) + 1e-6))
        rows.append({"application": name, "budget": budget, "cases": len(cases), "refused": refused,
                     "kept": float(np.mean(kept)) if kept else None,
                     "error_over_best": float(np.median(ratio)) if ratio else None,
                     "methods": sorted(set(chosen))})  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    names = options.only.split(",") if options.only else list(problems.STUDIES)
    rows: list[dict[str, Any]] = []
    if options.only and options.out.exists():
        rows = json.loads(options.out.read_text())["rows"]
    for name in names:
        cases = problems.cases(name, "test")
        tried = [fixed(name, case) for case in cases]
        measured = tolerances(name, cases, tried) + budgets(name, cases, tried)
        rows = [row for row in rows if row["application"] != name] + measured
        told = {"benchmark": "planner", "machine": machine(), "versions": versions("numpy", "torch", "numba"),
                "settings": {"tolerances": TOLERANCES, "budgets": BUDGETS, "seed": SEED}}  # fmt: skip
        write_whole(options.out, json.dumps({**told, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
