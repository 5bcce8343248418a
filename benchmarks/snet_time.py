"""What placing samples by a network costs in time, compiled and not: winding numbers, 32 samples, one run.

    python benchmarks/snet_time.py [--quick]

Processor seconds of the sampling network alone and of the pair, beside compiled Monte Carlo on a picture of one shape;
the shortest of three runs for Monte Carlo, one for networks. "torch" is the same network without the compiled pass.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import torch
from shapes import write

from nqr_geom import registry
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler
from nqr_geom.streams import Stream

N, SEED, REPEATS = 32, 0, 3


class Uncompiled(GwnProblem):
    """The same integrals for a network that places its samples by torch."""

    def placing(self, net: object, n: int) -> None:
        return None


def made(method: str) -> tuple[Sampler, Rule]:
    """The sampler and the rule of a method."""
    sampler, rule = registry.method(method, "gwn")
    return registry.make("sampler", sampler), registry.make("rule", rule)


def seconds(call: Callable[[], Any], repeats: int) -> float:
    """Processor seconds of the fastest call."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        spent.append(time.process_time() - start)
    return min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a small picture; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    resolution = 16 if quick else 128
    compiled = GwnProblem.family(1, seed=SEED, resolution=resolution)
    plain = Uncompiled(**vars(compiled))
    pairs = {name: made(name) for name in ("mc", "nqr")}
    jobs: dict[str, tuple[Callable[[], Any], int]] = {
        "Monte Carlo": (lambda: run(compiled, *pairs["mc"], N, seed=SEED), REPEATS),
        "SNet, compiled": (lambda: pairs["nqr"][0].draw(compiled, N, Stream(SEED)), 1),
        "SNet + INet, compiled": (lambda: run(compiled, *pairs["nqr"], N, seed=SEED), 1),
        "SNet, torch": (lambda: pairs["nqr"][0].draw(plain, N, Stream(SEED)), 1),
        "SNet + INet, torch": (lambda: run(plain, *pairs["nqr"], N, seed=SEED), 1),
    }
    few = compiled.take(slice(0, 256)), plain.take(slice(0, 256))
    for part in few:
        run(part, *pairs["nqr"], N, seed=SEED)  # compiled and loaded before
    jobs["Monte Carlo"][0]()
    rows: list[dict[str, Any]] = []
    for name, (job, repeats) in jobs.items():
        spent = seconds(job, repeats)
        rows.append({"method": name, "resolution": resolution, "n": N, "seconds": spent,
                     "us_per_query": 1e6 * spent / compiled.batch,
                     "times_mc": spent / (rows[0]["seconds"] if rows else spent)})  # fmt: skip
        print(rows[-1], flush=True)
    if not quick:
        print(write("snet_time", rows, seed=SEED, repeats=REPEATS))


if __name__ == "__main__":
    main()
