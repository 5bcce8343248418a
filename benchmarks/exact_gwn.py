"""How fast and how right are exact winding numbers, next to libigl's in the same run?

    python benchmarks/exact_gwn.py [--quick]

libigl visits all pairs, so it gets fewer queries on the large shapes; both times are per query. Both use all cores.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import igl
import igl.cycodebase
import igl.predicates
import numpy as np
from shapes import best_seconds, show_beside_libigl, soup, spiral, star, write, zigzag

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.tree import tree_of
from nqr_geom.curves.winding import gwn

SEED = 0
PAIRS = 2e8  # work libigl is given on one shape


def cases(quick: bool) -> list[tuple[str, Curve]]:
    sizes = (100, 1_000, 10_000) if quick else (100, 1_000, 10_000, 100_000)
    result = [(f"star, {n:,} segments", Curve.polyline(star(n), closed=True)) for n in sizes]
    result += [
        ("spiral, 10,000 segments", Curve.polyline(spiral(10_000), closed=True)),
        ("zigzag, 10,000 segments", Curve.polyline(zigzag(10_000), closed=True)),
        ("open soup, 1,000 segments", Curve.bezier(soup(1_000))),
    ]
    return result


def cubics(n: int) -> Curve:
    """A smooth closed spline through a star's vertices."""
    v = star(n, SEED)
    handle = (np.roll(v, -1, axis=0) - np.roll(v, 1, axis=0)) / 6
    after = np.roll(v, -1, axis=0)
    return Curve.bezier(np.stack([v, v + handle, after - np.roll(handle, -1, axis=0), after], axis=1))


def measure(name: str, curve: Curve, points: np.ndarray, quick: bool) -> dict[str, Any]:
    n = len(curve)
    start = time.perf_counter()
    tree_of(curve)
    build = time.perf_counter() - start
    ours = best_seconds(lambda: gwn(curve, points), 3 if quick else 7) / len(points)
    few = points[: max(int((PAIRS / 10 if quick else PAIRS) / n), 200)]
    if curve.degree.max() == 1:
        vertices = np.concatenate([curve.control[:, 0], curve.control[:, 3]])
        edges = np.stack([np.arange(n), np.arange(n) + n], axis=1)

        def peer() -> np.ndarray:
            return igl.winding_number(vertices, edges, few)
    else:
        vertices, index = curve.control.reshape(-1, 2), np.arange(4 * n).reshape(-1, 4)
        tree = igl.cycodebase.spline_eytzinger_aabb(vertices, index)

        def peer() -> np.ndarray:
            return igl.predicates.spline_winding_number(vertices, index, *tree, few)

    theirs = best_seconds(peer, 3) / len(few)
    difference = np.abs(peer() - gwn(curve, few))
    return {
        "case": name,
        "pieces": n,
        "queries": len(points),
        "build_ms": 1e3 * build,
        "us_per_query": 1e6 * ours,
        "libigl_us_per_query": 1e6 * theirs,
        "ratio": theirs / ours,
        "largest_difference": float(difference.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few seconds, rough numbers")
    quick = parser.parse_args().quick
    points = np.random.default_rng(SEED).uniform(-1, 1, (20_000, 2))
    gwn(Curve.polyline(star(8)), points)  # compile
    shapes = [*cases(quick), ("spline, 1,000 cubics", cubics(1_000))]
    rows = [measure(name, curve, points, quick) for name, curve in shapes]
    show_beside_libigl(rows)
    print(write("exact_gwn", rows, seed=SEED, quick=quick, queries=len(points)))


if __name__ == "__main__":
    main()
