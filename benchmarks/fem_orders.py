"""Do the finite elements converge as they should? L2 errors of p-harmonic functions on a ladder of meshes.

    python benchmarks/fem_orders.py [--quick]

Truths on the unit square for every p: the polar angle about a point outside, and |x - c|^((p-2)/(p-1)), log at p = 2.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.p_laplace import p_laplace
from nqr_geom.fem.space import Solution

Floats = NDArray[np.float64]
SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
OUTSIDE = np.array([-0.3, -0.2])
EXPONENTS = (1.05, 1.2, 1.5, 2.0, 3.0, 6.0, 10.0, 50.0)


def polar_angle(x: Floats) -> Floats:
    return np.arctan2(x[:, 1] - OUTSIDE[1], x[:, 0] - OUTSIDE[0])


def radial(p: float) -> Callable[[Floats], Floats]:
    def value(x: Floats) -> Floats:
        r = np.hypot(*(x - OUTSIDE).T)
        return np.log(r) if p == 2.0 else r ** ((p - 2.0) / (p - 1.0))

    return value


def l2_error(found: Solution, truth: Callable[[Floats], Floats]) -> float:
    """Root mean squared error over the domain, relative to the range of the truth there."""
    x, w = found.space.source_points, found.space.source_weights
    exact = truth(x)
    error = found.offset + found.space.value @ found.coefficients - exact
    return float(np.sqrt((w * error**2).sum() / w.sum()) / np.ptp(exact))


def measure(p: float, name: str, order: int, triangles: list[int]) -> dict[str, Any]:
    truth = polar_angle if name == "polar angle" else radial(p)
    mesh = Mesh.of(SQUARE, triangles[0] // 4, order=order)
    errors, counts, start = [], [], time.perf_counter()
    for _ in triangles:
        found = p_laplace(mesh, truth, p, order=order)
        errors.append(l2_error(found, truth))
        counts.append(found.triangles)
        mesh = mesh.refined()
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    return {
        "solution": name,
        "p": p,
        "order_of_elements": order,
        "triangles": counts,
        "relative_l2_errors": errors,
        "observed_orders": orders.tolist(),
        "newton_steps_on_the_last_two_meshes": found.iterations,
        "seconds": time.perf_counter() - start,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="three meshes, linear elements only")
    quick = parser.parse_args().quick
    triangles = [600, 2400, 9600] if quick else [600, 2400, 9600, 38400]
    rows = [
        measure(p, name, order, triangles if order == 1 else triangles[:3])
        for order in ((1,) if quick else (1, 2))
        for name in ("polar angle", "radial")
        for p in (EXPONENTS if order == 1 else EXPONENTS[1:-1])
    ]
    table = Table("elements", "solution", "p", "triangles", "relative L2 error", "observed orders", "Newton", "s")
    for row in rows:
        table.add_row(
            f"P{row['order_of_elements']}",
            row["solution"],
            f"{row['p']:g}",
            f"{row['triangles'][-1]:,}",
            f"{row['relative_l2_errors'][-1]:.1e}",
            ", ".join(f"{order:.2f}" for order in row["observed_orders"]),
            str(row["newton_steps_on_the_last_two_meshes"]),
            f"{row['seconds']:.1f}",
        )
    Console(width=140).print(table)
    print(write("fem_orders", rows, quick=quick, polygon="unit square", outside=OUTSIDE.tolist()))


if __name__ == "__main__":
    main()
