"""How fast and how right is the deterministic Laplace solver?

    python benchmarks/boundary_solver.py [--quick]

Stars of 19 and 300 edges and the classical hard cases, with boundary values whose solution is known; for random linear
data the boundary residual is the proof. Errors are the largest over points inside, relative to the spread of the data.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from shapes import Floats, star, write

from nqr_geom.wos.boundary import solve
from nqr_geom.wos.domain import Domain

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
ELL = np.array([[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1.0]])
Field = Callable[[Floats], Floats]


def complex_of(p: Floats) -> Any:
    return p[:, 0] + 1j * p[:, 1]


def ell(p: Floats) -> Floats:
    theta = np.arctan2(p[:, 1], p[:, 0])
    theta = np.where(theta < -1e-12, theta + 2 * np.pi, np.maximum(theta, 0.0))
    return np.hypot(*p.T) ** (2 / 3) * np.sin(2 * theta / 3)


def jump(p: Floats) -> Floats:
    """1 on the top of the unit square, 0 elsewhere: its Fourier series."""
    k = np.arange(1, 400, 2)[:, None] * np.pi
    scale = np.exp(k * (p[:, 1] - 1.0)) * (1.0 - np.exp(-2.0 * k * p[:, 1])) / (1.0 - np.exp(-2.0 * k))
    return (4.0 / k * np.sin(k * p[:, 0]) * scale).sum(axis=0)


def cases(n: int) -> list[tuple[str, Floats, Any, Field | None]]:
    cubic: Field = lambda p: (complex_of(p) ** 3).real  # noqa: E731
    log: Field = lambda p: np.log(np.abs(complex_of(p) - 1.1 - 0.4j))  # noqa: E731
    arg: Field = lambda p: np.angle(-(complex_of(p) - 1.1 - 0.4j))  # noqa: E731
    linear = np.random.default_rng(0).normal(size=n)
    return [
        (f"star of {n}, Re z^3", star(n), cubic, cubic),
        (f"star of {n}, ln|z - z0|", star(n), log, log),
        (f"star of {n}, arg(z - z0)", star(n), arg, arg),
        (f"star of {n}, random linear", star(n), linear, None),
    ]


def row(name: str, polygon: Floats, boundary: Any, truth: Field | None, tol: float, repeats: int) -> dict[str, Any]:
    domain = Domain.of(polygon)
    values = domain.boundary(boundary)
    solution = solve(domain, values, tol)
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        solution = solve(domain, values, tol)
        seconds.append(time.perf_counter() - start)
    framed = np.random.default_rng(1).uniform(domain.start.min(axis=0), domain.start.max(axis=0), (4000, 2))
    framed = framed[domain.contains(framed) & (domain.search(framed)[2] > 0.02)]
    probe = values.at(np.arange(len(domain)), np.full(len(domain), 0.5))
    spread = float(np.ptp(probe))
    error = None
    if truth is not None:
        error = float(np.abs(solution.at(framed) - truth(domain.from_frame(framed))).max()) / spread
    return {"case": name, "seconds": min(seconds), "error": error, "residual": solution.residual / spread,
            "unknowns": solution.unknowns, "tol": tol}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the 300 edges")
    quick = parser.parse_args().quick
    corners = np.repeat(SQUARE, 2, axis=0)
    small = [
        *cases(19),
        ("L-shape, r^(2/3)", ELL, ell, ell),
        ("jump on the square", corners, [0, 0, 0, 0, 0, 1, 1, 0], jump),
    ]
    rows = [row(*case, tol=1e-9, repeats=3) for case in small]
    rows += [] if quick else [row(*case, tol=1e-6, repeats=1) for case in cases(300)]
    table = Table("case", "seconds", "error", "residual", "unknowns", title="deterministic Laplace")
    for r in rows:
        error = "" if r["error"] is None else f"{r['error']:.1e}"
        table.add_row(r["case"], f"{r['seconds']:.2f}", error, f"{r['residual']:.1e}", str(r["unknowns"]))
    Console(width=100).print(table)
    print(write("boundary_solver", rows))


if __name__ == "__main__":
    main()
