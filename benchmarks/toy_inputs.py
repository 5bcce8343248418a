"""Does the network use what a sample tells? One input randomised at a time: Table 8 of the paper.

    python benchmarks/toy_inputs.py [--quick]

The network on the uniform base sees samples whose position is a uniform random number, whose derivative is Gaussian
noise or whose piece index is a random integer; its weights then meet the true values. The network answers alone here,
without the limits that its card sets.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from comparison import LEARNED, SEED, N, span
from rich.console import Console
from rich.table import Table
from shapes import write
from toy_scenes import SCENES, scenes

from nqr_geom import registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.integrator.problem import Samples
from nqr_geom.recipes import model
from nqr_geom.streams import Stream
from nqr_geom.toy.family import PIECES
from nqr_geom.toy.problem import ToyProblem

INPUTS = ("X", "f'", "I", "none")


def randomised(samples: Samples, what: str) -> Samples:
    """The samples with one of their inputs replaced by random numbers."""
    generator = torch.Generator().manual_seed(SEED)
    shape, features = samples.value.shape, dict(samples.seen.features)
    if what == "X":
        return replace(samples, x=torch.rand(samples.x.shape, generator=generator, dtype=torch.float64))
    if what == "f'":
        features["derivative"] = torch.randn(shape, generator=generator, dtype=torch.float64)
    elif what == "I":
        features["piece"] = torch.randint(PIECES, shape, generator=generator)
    return replace(samples, seen=replace(samples.seen, features=features))


def rows_of(label: str, problem: ToyProblem) -> list[dict[str, Any]]:
    """One row an input, with its error as a multiple of Monte Carlo's on the same samples."""
    samples = draw_samples(problem, ("random",), N, Stream(SEED, "test", "samples/0"))
    truth = torch.from_numpy(problem.reference())
    rule = model(LEARNED["toy"][2].removeprefix("inet-")).learned
    plain = (registry.make("rule", "mc").combine(samples).estimate(samples) - truth).square().numpy()
    bootstrap = Bootstrap.of(problem.groups, 1, SEED)
    rows = []
    for what in INPUTS:
        # The weights of samples that are not what they seem, on the values as they are.
        e = (rule.combine(randomised(samples, what)).estimate(samples) - truth).square().numpy()
        row = {"problem": label, "randomised": what, "mse": float(e.mean()), "mc": float(plain.mean())}
        row |= {"median": float(np.median(e)), "p99": float(np.quantile(e, 0.99))}
        rows.append(row | {"times_mc": row["mse"] / row["mc"], "times_mc_interval": bootstrap.ratio(e, plain)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a twentieth of the runs; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = []
    for scene in range(SCENES):
        rows += rows_of(f"{scene + 1}", scenes(200 if quick else 4000, scene))
    rows += rows_of("held out", ToyProblem.family(1000 if quick else 20000, SEED, "test"))
    table = Table("integrand", "randomised", "MSE", "MC", "times MC", "95%", title=f"{N} random samples")
    for row in rows:
        cells = [f"{row['mse']:.2e}", f"{row['mc']:.2e}", f"{row['times_mc']:.3g}", span(row["times_mc_interval"])]
        table.add_row(row["problem"], row["randomised"], *cells)
    Console(width=120).print(table)
    if not quick:
        print(write("toy_inputs", rows, n=N, seed=SEED, runs=4000, integrands=20000))


if __name__ == "__main__":
    main()
