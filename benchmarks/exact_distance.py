"""How fast and how right are exact distances, next to libigl's in the same run?

    python benchmarks/exact_distance.py [--quick]

libigl builds its tree in every call, so both are given many queries; ours is built once and timed apart.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import igl
import igl.cycodebase
import numpy as np
from exact_gwn import cubics
from shapes import best_seconds, show_beside_libigl, soup, spiral, star, write, zigzag

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.distance import distance
from nqr_geom.curves.tree import tree_of

SEED = 0


def cases(quick: bool) -> list[tuple[str, Curve]]:
    sizes = (100, 1_000, 10_000) if quick else (100, 1_000, 10_000, 100_000)
    result = [(f"star, {n:,} segments", Curve.polyline(star(n), closed=True)) for n in sizes]
    result += [
        ("spiral, 10,000 segments", Curve.polyline(spiral(10_000), closed=True)),
        ("zigzag, 10,000 segments", Curve.polyline(zigzag(10_000), closed=True)),
        ("open soup, 10,000 segments", Curve.bezier(soup(10_000))),
        ("spline, 1,000 cubics", cubics(1_000)),
    ]
    return result


def measure(name: str, curve: Curve, points: np.ndarray, quick: bool) -> dict[str, Any]:
    n = len(curve)
    start = time.perf_counter()
    _ = tree_of(curve).clusters
    build = time.perf_counter() - start
    ours = best_seconds(lambda: distance(curve, points), 3 if quick else 9)
    if curve.degree.max() == 1:
        vertices = np.concatenate([curve.control[:, 0], curve.control[:, 3]])
        edges = np.stack([np.arange(n), np.arange(n) + n], axis=1)

        def peer() -> np.ndarray:
            return igl.point_mesh_squared_distance(points, vertices, edges)[0]
    else:
        vertices, index = curve.control.reshape(-1, 2), np.arange(4 * n).reshape(-1, 4)
        tree = igl.cycodebase.spline_eytzinger_aabb(vertices, index)

        def peer() -> np.ndarray:
            return igl.cycodebase.point_spline_squared_distance(points, vertices, index, *tree)[0]

    theirs = best_seconds(peer, 3 if quick else 5)
    difference = np.abs(np.sqrt(peer()) - distance(curve, points))
    return {
        "case": name,
        "pieces": n,
        "queries": len(points),
        "build_ms": 1e3 * build,
        "us_per_query": 1e6 * ours / len(points),
        "libigl_us_per_query": 1e6 * theirs / len(points),
        "ratio": theirs / ours,
        "largest_difference": float(difference.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few seconds, rough numbers")
    quick = parser.parse_args().quick
    points = np.random.default_rng(SEED).uniform(-1, 1, (20_000, 2))
    distance(cubics(4), points)  # compile
    rows = [measure(name, curve, points, quick) for name, curve in cases(quick)]
    show_beside_libigl(rows)
    print(write("exact_distance", rows, seed=SEED, quick=quick, queries=len(points)))


if __name__ == "__main__":
    main()
