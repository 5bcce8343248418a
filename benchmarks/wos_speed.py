"""How many walks on spheres a second does one thread take?

    python benchmarks/wos_speed.py [--quick]

Stars of 19 and 286 edges, queries uniform inside, walks to the epsilon shell. zombie (C++) takes 0.50 and 0.32 million
a second with a shell of an absolute 1e-3, nine steps a walk; ours is a part of the local size, so its walks are longer,
and steps a second stand beside.
"""

from __future__ import annotations

import argparse
import os

os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import best_seconds, star, write

from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import queries
from nqr_geom.wos.walk import walk

ZOMBIE = {19: 0.50, 286: 0.32}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer walks")
    walks = np.arange(50 if parser.parse_args().quick else 400)
    table = Table("edges", "M walks/s", "zombie", "steps a walk", "M steps/s", title="one thread")
    rows = []
    for n, peer in ZOMBIE.items():
        domain = Domain.of(star(n))
        points = domain.to_frame(queries(domain, 500, 0))
        index, of = np.arange(500), np.zeros(500, dtype=np.int64)
        run = lambda: walk(domain.nearest, of, points, index, walks, Stream(0), epsilon=1e-3, max_steps=10_000)  # noqa: B023, E731
        steps = run().counts()["steps"] / (500 * len(walks))
        rate = 500 * len(walks) / best_seconds(run, 5) / 1e6
        rows.append({"edges": n, "million_walks_a_second": rate, "zombie": peer, "steps": steps})
        table.add_row(str(n), f"{rate:.2f}", f"{peer:.2f}", f"{steps:.1f}", f"{rate * steps:.1f}")
    Console().print(table)
    print(write("wos_speed", rows, walks=len(walks), points=500))


if __name__ == "__main__":
    main()
