"""Solving twice to know the error, and again on better meshes until it is small enough."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.space import NotConverged, Solution

__all__ = ["Solver", "solve_to_tolerance", "solve_twice"]

_MARKED = 0.6  # share of the squared error that the triangles to split make up (Doerfler 1996)


class Solver(Protocol):
    """Solves a problem on a mesh, starting from a solution on a coarser one if that helps."""

    def __call__(self, mesh: Mesh, start: Solution | None) -> Solution: ...


def solve_twice(solve: Solver, mesh: Mesh, start: Solution | None = None) -> Solution:
    """The solution with all edges of the mesh halved, with the one on the mesh itself as `coarse`."""
    coarse = solve(mesh, start)
    fine = solve(mesh.refined(), coarse)
    return replace(fine, coarse=coarse, iterations=fine.iterations + coarse.iterations)


def solve_to_tolerance(
    solve: Solver, mesh: Mesh, tol: float, points: ArrayLike | None = None, max_triangles: int = 400_000
) -> Solution:
    """Refine where the error is until its estimate is at most `tol` at the points, or everywhere without points.

    Raises
    ------
    NotConverged
        If that would take more than `max_triangles`.
    """
    tol = check.number("tol", tol, low=0.0, open_low=True)
    found = None
    while True:
        found = solve_twice(solve, mesh, found)
        error = found.error if points is None else float(found.error_at(points).max(initial=0.0))
        if error <= tol:
            return found
        marked = _largest(_indicators(found))
        if 4 * (len(mesh.triangles) + 2 * np.count_nonzero(marked)) > max_triangles:
            raise NotConverged(f"estimated error {error:.2e} > tol = {tol:.2e} with {found.triangles} triangles")
        mesh = mesh.refined(marked)


def _indicators(found: Solution) -> NDArray[np.float64]:
    """Error indicator (t,) of the coarse triangles: their size times the L2 norm of the gradients' difference."""
    before = found.coarse
    if before is None:
        raise ValueError("found: expected a solution with a coarser one")
    fine, coarse = found.space.mesh, before.space.mesh
    middles = fine.points[fine.triangles].mean(axis=1)
    parent, _ = coarse.locate_in_frame(middles)
    places = fine.outline.centre + fine.outline.size * middles
    difference = found.gradient(places, outside="nan") - before.gradient(places, outside="nan")
    area = np.abs(np.linalg.det(fine.points[fine.triangles[:, 1:]] - fine.points[fine.triangles[:, :1]]))
    share = np.nan_to_num(area**2 * (difference**2).sum(axis=1))
    return np.asarray(np.bincount(np.maximum(parent, 0), share, minlength=len(coarse.triangles)), dtype=np.float64)


def _largest(share: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The fewest triangles that carry the wanted part of the error."""
    order = np.argsort(-share, kind="stable")
    count = int(np.searchsorted(np.cumsum(share[order]), _MARKED * share.sum())) + 1
    marked = np.zeros(len(share), dtype=bool)
    marked[order[:count]] = True
    return marked
