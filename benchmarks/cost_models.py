"""What methods cost and how far they are off: the models behind `tol=` and `budget=`.

    cd benchmarks && python cost_models.py [--only gwn,sd] [--errors] [--out ../nqr_geom/data/cost_models.json]

Times are processor seconds on one thread, which a busy machine does not stretch: the shortest of a few runs at several
numbers of integrals and samples, and a few named terms are fitted to them. Errors are measured on the random families,
split "validation", which no test and no training meets: median and 95% quantile of the absolute error over queries, in
the units of `Goal.scale`. "factor" is what a bound that a run states of itself has to be multiplied with so that 97 in
100 hold, "bound" the 95% quantile of what comes out. With --errors times stay as they were measured before; with --only
new ones are told in seconds of the machine that the others were measured on.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import planner_problems as problems
import torch

from nqr_geom.files import write_whole
from nqr_geom.integrator.bounds import bound_of_samples, bound_of_values
from nqr_geom.integrator.models import TERMS, Cost
from nqr_geom.integrator.plan import Way, sizes_of
from nqr_geom.integrator.pursue import _joined
from nqr_geom.machine import cores, machine, versions
from nqr_geom.speed import measured

OUT = Path(__file__).resolve().parents[1] / "nqr_geom" / "data" / "cost_models.json"
COVERED = 0.97
PERIODS = 3  # of a timing; the shortest counts
MOST = 8.0  # times a bound; what is farther off has not been seen at all
LEAST = 0.1  # times a bound; two runs may agree by chance


def shortest(call: Callable[[], Any], least: float = 0.0) -> float:
    """Seconds of the fastest of a few calls after a first one."""
    call()
    spent = []
    for _ in range(PERIODS):
        start = time.process_time()
        call()
        spent.append(time.process_time() - start)
        if sum(spent) > 0.5:
            break
    return max(min(spent), least)


def level(way: Way, rows: Any, n: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Value and bound of a level as the planner runs it, without its factor."""
    assert way.draw is not None
    parts = [way.draw(rows, size, k + j) for j, size in enumerate(sizes_of(way, n))]
    if way.independent:
        return parts[0].value, bound_of_samples(parts[0].statistics)
    return _joined(parts).value, bound_of_values(np.stack([part.value for part in parts]))


def errors_of(case: problems.Case, way: Way, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors and bounds in units of the scale, and their ratio; where the truth knows no better the bound is right."""
    value, bound = level(way, np.arange(len(case.truth)), n, 0)
    error = np.abs(value - case.truth).max(axis=1)
    ratio = np.where(error <= case.floor, 0.0, error / np.maximum(bound, 1e-300))
    return error / case.scale, bound / case.scale, ratio


def rounded(value: float, least: float) -> float:
    return float(f"{max(value, least):.3g}")


def monotone(errors: Sequence[float]) -> list[float]:
    """Errors do not grow with samples; where two measurements say so it is noise."""
    return [float(v) for v in np.minimum.accumulate(errors)]


def sampled(name: str, cases: Sequence[problems.Case], method: str, sizes: Sequence[int], times: Any,
            before: dict[str, Any] | None) -> dict[str, Any]:  # fmt: skip
    """Model of a sampled method on some cases of one kind; its times are those of the model `before`."""
    spent = []
    pieces = cases[0].size if name.partition("-")[0] in ("gwn", "sd") else 0.0  # where samples count by the piece
    per = [case.size / pieces if pieces else 1.0 for case in cases]
    ways = [case.way(method) for case in cases]
    # Where there are fewer pieces than usual the fewest samples are more a piece.
    own = [n for n in sizes if all(max(n, n * p) >= way.least for p, way in zip(per, ways, strict=True))]
    told: dict[str, list[float]] = {"typical": [], "high": [], "factor": [], "bound": []}
    for n in own:
        parts = [errors_of(case, way, max(way.least, round(n * p)))
                 for case, way, p in zip(cases, ways, per, strict=True)]  # fmt: skip
        error, bound, ratio = (np.concatenate(part) for part in zip(*parts, strict=True))
        told["typical"].append(rounded(float(np.median(error)), 1e-15))
        told["high"].append(rounded(float(np.quantile(error, 0.95)), 1e-15))
        told["factor"].append(rounded(min(float(np.quantile(ratio, COVERED)), MOST), LEAST))
        told["bound"].append(rounded(told["factor"][-1] * float(np.quantile(bound, 0.95)), 1e-15))
    told |= {key: monotone(told[key]) for key in ("typical", "high", "bound")}
    if before is not None:
        print(f"{name}:{method}: {told}")
        return {**before, "sizes": own, **told}
    for j, case in enumerate(cases):
        for rows in times["rows"] if j < times["cases"] else ():
            timed, index = case.of_rows(rows).way(method), np.arange(rows)
            for n in times["n"]:
                if n >= timed.least:
                    spent.append((rows, n, case.size, shortest(lambda w=timed, i=index, m=n: w.draw(i, m, 0))))
    if len({n for _, n, *_ in spent}) < 2:  # what a sample costs would be anyone's guess
        raise ValueError(f"n: expected two sizes of {ways[0].least} or more to time {name}:{method}, got {times['n']}")
    cost = Cost.fit(times["terms"], spent)
    off = max(abs(np.log(cost.seconds(*row[:3]) / row[3])) for row in spent)
    print(f"{name}:{method}: cost {dict(cost.terms)}, worst off by {np.exp(off):.2f}; {told}")
    return {"cost": dict(cost.terms), "sizes": own, **told, "size": pieces,
            "threads": times.get("threads", True)}  # fmt: skip


def solved(name: str, cases: Sequence[problems.Case], method: str, tols: Sequence[float], terms: Sequence[str],
           rows: Sequence[int], threads: bool = True) -> dict[str, Any]:  # fmt: skip
    """Model of a method without samples; one over the tolerance is its number of samples."""
    if len(set(rows)) < 2 and any("rows" in term for term in terms):  # a call and a query would be anyone's guess
        raise ValueError(f"rows: expected two numbers of queries or more to time {name}:{method}, got {rows}")
    spent, reached = [], {tol: [] for tol in tols}
    for case in cases:
        for tol in tols:
            for m in rows:
                way = case.of_rows(m).way(method)
                assert way.solve is not None
                seconds = shortest(lambda w=way, t=tol * case.scale: w.solve(t))
                spent.append((m, 1.0 / tol, case.size, seconds))
            found = case.way(method).solve(tol * case.scale)  # type: ignore[misc]
            reached[tol].append(float(np.abs(found.value - case.truth).max()) / case.scale)
    cost = Cost.fit(terms, spent)
    off = max(abs(np.log(cost.seconds(*row[:3]) / row[3])) for row in spent)
    high = [max(float(np.max(reached[tol])), min(tol, 1e-11)) for tol in tols]
    print(f"{name}:{method}: cost {dict(cost.terms)}, worst off by {np.exp(off):.2f}; reached {high}")
    sizes = [round(1.0 / tol) for tol in tols]
    # It aims at the tolerance and checks itself: that is what it can be trusted with.
    law = [max(tol, 1e-15) for tol in tols] if len(tols) > 1 else [float(f"{high[0]:.2g}")]
    return {"cost": dict(cost.terms), "sizes": sizes, "typical": law, "high": law, "factor": [1.0] * len(law),
            "size": 0.0, "threads": threads}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--errors", action="store_true", help="keep the times")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = "1"
    torch.set_num_threads(1)
    names = options.only.split(",") if options.only else list(problems.STUDIES)
    whole: dict[str, Any] = {"models": {}}
    if (options.only or options.errors) and options.out.exists():
        whole = json.loads(options.out.read_text())
    models, now, kept = whole["models"], measured(), whole.get("speed")
    for name in names:
        start, cases = time.perf_counter(), problems.cases(name, "validation")
        for method, study in problems.STUDIES[name].items():
            key = f"{name}:{method}"
            if "tols" not in study:
                before = models.get(key) if options.errors else None
                models[key] = sampled(name, cases, method, **study, before=before)
            elif not options.errors:
                models[key] = solved(name, cases, method, **study)
            if kept is not None and not options.errors:  # in seconds of the machine that the other rows are from
                cost = models[key]["cost"]
                models[key]["cost"] = {k: rounded(v * kept[TERMS[k]] / now[TERMS[k]], 1e-30) for k, v in cost.items()}
        print(f"  {name}: {time.perf_counter() - start:.0f} s", flush=True)
        if kept is None:
            whole = {"machine": machine(), "versions": versions("numpy", "numba", "torch", "scipy"),
                     "cores": cores("NUMBA_NUM_THREADS"), "speed": now, "models": models}  # fmt: skip
        write_whole(options.out, json.dumps(whole, indent=1) + "\n")


if __name__ == "__main__":
    main()
