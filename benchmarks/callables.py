"""What the structured method costs on curves that are callables, compiled and by tensors, 32 samples.

    python benchmarks/callables.py [--quick]

A smooth closed curve given as a function of s, of which points are asked and tangents by differences. Wall time of
Monte Carlo, of the structured method, and of its two parts (the sampler, and the rule on stratified samples); "tensors"
are the same formulas on torch tensors, as a GPU would run them. Medians of repetitions that take turns, all cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from learned_time import interleaved
from rich.console import Console
from rich.table import Table
from shapes import write

import nqr_geom as ng
from nqr_geom.curves.problems import GwnProblem, SdProblem
from nqr_geom.curves.structured import CurveRefine, GwnHermite, SdHermite
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import MonteCarlo
from nqr_geom.integrator.samplers import Random, Stratified
from nqr_geom.streams import Stream

N, SEED, PIECES = 32, 0, 5


class RefineByTensors(CurveRefine):
    """The sampler without kernels."""

    by_kernel = CurveRefine.by_tensors


class GwnByTensors(GwnHermite):
    """The rule without kernels."""

    by_kernel = GwnHermite.by_tensors


class SdByTensors(SdHermite):
    """The rule without kernels."""

    by_kernel = SdHermite.by_tensors


RULES = {"gwn": (GwnHermite(), GwnByTensors()), "sd": (SdHermite(), SdByTensors())}


def flower(s: np.ndarray) -> np.ndarray:
    """Five petals, (m, 2)."""
    angle = 2.0 * np.pi * s
    radius = 0.6 + 0.2 * np.cos(5.0 * angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def jobs_of(problem: GwnProblem | SdProblem) -> dict[str, Callable[[], Any]]:
    """Everything that is timed, by name."""
    fast, slow = RULES[problem.name]
    stream = Stream(SEED)
    samples = problem.finalize(Stratified().draw(problem, N, stream))[0]
    return {
        "Monte Carlo": lambda: run(problem, Random(), MonteCarlo(), N, seed=SEED),
        "structured": lambda: run(problem, CurveRefine(), fast, N, seed=SEED),
        "structured, tensors": lambda: run(problem, RefineByTensors(), slow, N, seed=SEED),
        "sampler": lambda: CurveRefine().draw(problem, N, stream),
        "sampler, tensors": lambda: RefineByTensors().draw(problem, N, stream),
        "rule": lambda: fast.combine(samples),
        "rule, tensors": lambda: slow.combine(samples),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few queries; writes nothing")
    quick = parser.parse_args().quick
    curve = ng.Curve.from_callable(flower, pieces=PIECES)
    rows: list[dict[str, Any]] = []
    for kind in (GwnProblem, SdProblem):
        for queries in (100,) if quick else (100, 1000, 10000):
            points = np.random.default_rng(SEED).uniform(-1.0, 1.0, (queries, 2))
            problem = kind.of(curve, points)
            for job in jobs_of(problem.take(slice(0, 8))).values():
                job()  # compiled and loaded before
            spent = {name: 1e6 * took[0] / queries for name, took in interleaved(jobs_of(problem), 5).items()}
            for name in ("structured", "sampler", "rule"):
                rows.append(
                    {
                        "problem": problem.name,
                        "queries": queries,
                        "part": name,
                        "us": spent[name],
                        "tensors_us": spent[f"{name}, tensors"],
                        "ratio": spent[f"{name}, tensors"] / spent[name],
                        "mc_us": spent["Monte Carlo"],
                        "times_mc": spent[name] / spent["Monte Carlo"],
                    }
                )
    table = Table("problem", "queries", "", "us a query", "by tensors", "times as long", "times Monte Carlo")
    for row in rows:
        numbers = (f"{row[key]:.3g}" for key in ("us", "tensors_us", "ratio", "times_mc"))
        table.add_row(row["problem"], f"{row['queries']:,}", row["part"], *numbers)
    Console(width=110).print(table)
    if not quick:
        print(write("callables", rows, n=N, seed=SEED, pieces=PIECES))


if __name__ == "__main__":
    main()
