"""Table 11 of the paper: winding numbers on six held-out shapes, mean squared errors at 32 samples.

    python benchmarks/gwn_tables.py [--quick]

Queries are the centres of a 128 x 128 grid over [-1, 1]^2, without those nearer than 1e-3 to the curve.
"""

from __future__ import annotations

import argparse

import torch
from comparison import DESIGNS, SEED, N, pairs_for, rows_of, show
from shapes import write

from nqr_geom.curves.problems import GwnProblem

SHAPES = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a coarse grid; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    problem = GwnProblem.family(SHAPES, SEED, "test", resolution=16 if quick else 128)
    pairs = pairs_for("gwn", ("mc", "trapezoid"), DESIGNS)
    rows = rows_of("six shapes", problem, pairs, shapes=True)
    show("six held-out shapes", rows)
    for row in rows:
        print(f"{row['design']} + {row['rule']}: " + ", ".join(f"{mse:.2e}" for mse in row["by_shape"]))
    if not quick:
        print(write("gwn_tables", rows, n=N, seed=SEED, resolution=128))


if __name__ == "__main__":
    main()
