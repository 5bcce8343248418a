"""What it costs a network that the C library hands freed blocks back to the system between tiles.

    python benchmarks/fresh_memory.py [--quick]

Two processes of their own that take turns do what `gwn_time.py` does, 32 samples at 32, 64 and 128 squared by several
methods: one as it is, the other without `memory.keep_blocks`. Milliseconds of `inet-gwn-uniform` on the largest
picture, best of three in each process and the median of those, and the fresh pages that it took.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import Any

from shapes import write

REPEATS, SEED = 5, 0
METHODS = ("mc", "trapezoid", "structured", "stratified+inet-gwn-structured", "stratified+inet-gwn-uniform")
PICTURES = """
import json, resource, sys, time
import nqr_geom as ng
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.integrator import memory

keep, methods, sizes, seed = json.loads(sys.argv[1])
if not keep:
    memory.keep_blocks = lambda: None
told = []
for size in sizes:
    problem = GwnProblem.family(1, seed=seed, resolution=size)
    for method in methods:
        for _ in range(4):  # the first is not counted
            pages, start = resource.getrusage(resource.RUSAGE_SELF).ru_minflt, time.perf_counter()
            ng.integrate(problem, 32, method=method, seed=seed)
            spent = time.perf_counter() - start
            told.append((spent, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - pages))
print(json.dumps(min(told[-3:])))
"""


def pictures(keep: bool, sizes: tuple[int, ...]) -> tuple[float, int]:
    """Seconds and fresh pages of the last method on the last picture."""
    asked = json.dumps([keep, METHODS, sizes, SEED])
    done = subprocess.run([sys.executable, "-c", PICTURES, asked], capture_output=True, text=True, check=True)
    seconds, pages = json.loads(done.stdout)
    return seconds, pages


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small picture; writes nothing")
    quick = parser.parse_args().quick
    sizes = (16,) if quick else (32, 64, 128)
    found: dict[bool, list[tuple[float, int]]] = {True: [], False: []}
    for _ in range(1 if quick else REPEATS):
        for keep, runs in found.items():
            runs.append(pictures(keep, sizes))
    middle = {keep: sorted(runs)[len(runs) // 2] for keep, runs in found.items()}
    rows: list[dict[str, Any]] = [
        {
            "blocks": "kept" if keep else "handed back",
            "milliseconds": 1e3 * seconds,
            "pages": pages,
            "times_kept": seconds / middle[True][0],
        }
        for keep, (seconds, pages) in middle.items()
    ]
    for row in rows:
        print(row)
    if not quick:
        print(write("fresh_memory", rows, seed=SEED, repeats=REPEATS, resolution=sizes[-1], methods=METHODS))


if __name__ == "__main__":
    main()
