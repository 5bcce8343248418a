"""What products in bfloat16 are worth on this processor: answers and lessons of every network with attention layers.

    python benchmarks/precision.py [--quick]

Processor time of a network's answers, and of a training step without the optimiser, on the same integrals in float32
and with products in bfloat16; medians of repetitions that take turns, on one thread. Networks take bfloat16 by default
where a processor multiplies it by tiles (AMX).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from learned_time import interleaved
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.integrator.learn.inet import INet, has_bfloat16
from nqr_geom.integrator.learn.train import draw_batch, loss
from nqr_geom.recipes import RECIPES, model

SEED = 0
NAMES = tuple(name for name, recipe in RECIPES.items() if recipe.config.layers)
PRECISIONS = {"float32": False, "bfloat16": True}


def jobs_of(name: str, integrals: int) -> dict[str, dict[str, Callable[[], Any]]]:
    """Answers and lessons of a network in both precisions."""
    recipe, rule = RECIPES[name], model(name).learned
    n = max(recipe.sizes, key=lambda pair: pair[1])[0]
    batch, samples = draw_batch(recipe, torch.arange(integrals), n, SEED, "validation")
    samples = batch.problem.finalize(samples)[0]
    net = INet(recipe.config)
    net.load_state_dict(rule.net.state_dict())

    def lesson(half: bool) -> None:
        net.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            value = loss(recipe, net, batch, samples)
        value.backward()

    answers = {told: replace(rule, half=half) for told, half in PRECISIONS.items()}
    return {
        "answers": {told: (lambda one=one: one.combine(samples)) for told, one in answers.items()},
        "lessons": {told: (lambda half=half: lesson(half)) for told, half in PRECISIONS.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few integrals, one network; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = []
    names, integrals = (NAMES[:1], 64) if quick else (NAMES, 512)
    for name in names:
        for kind, jobs in jobs_of(name, integrals).items():
            spent = {told: 1e6 * took[1] / integrals for told, took in interleaved(jobs, 5).items()}
            rows.append({"network": name, "kind": kind, **spent, "ratio": spent["bfloat16"] / spent["float32"]})
    table = Table("network", "", "float32, us an integral", "bfloat16", "ratio", title=f"AMX: {has_bfloat16()}")
    for row in rows:
        table.add_row(row["network"], row["kind"], *(f"{row[key]:.3g}" for key in (*PRECISIONS, "ratio")))
    Console().print(table)
    if not quick:
        print(write("precision", rows, seed=SEED, tiles=has_bfloat16()))


if __name__ == "__main__":
    main()
