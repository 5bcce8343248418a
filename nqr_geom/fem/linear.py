"""Laplace, Poisson and screened Poisson problems: -laplace(u) + screening u = source, u = boundary on the edge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.fem.adapt import solve_to_tolerance, solve_twice
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.outline import BoundaryValues
from nqr_geom.fem.space import Solution, Space

__all__ = ["laplace", "solve_spd"]

Floats = NDArray[np.float64]
Source = Callable[[Floats], ArrayLike] | float | None


def laplace(
    polygon: Any,
    boundary: BoundaryValues,
    *,
    source: Source = None,
    screening: float = 0.0,
    n: int = 8000,
    order: int = 2,
    graded: bool = True,
    tol: float | None = None,
    points: ArrayLike | None = None,
    max_triangles: int = 400_000,
) -> Solution:
    """Solve -laplace(u) + screening u = source in a polygon, u = boundary on its edge.

    Parameters
    ----------
    polygon : shapely Polygon, (n, 2) array_like, Outline or Mesh
        The domain; a `Mesh` is taken as the coarser of the two meshes that the error is estimated from.
    boundary : callable or (k,) array_like
        Values as a function (m, 2) -> (m,), or one for each vertex in given order (holes after the outer ring), linear
        along the edges. Vertices given twice may carry a jump.
    source : callable or float, optional
        Right-hand side as a function (m, 2) -> (m,) or a number, in value per unit of length squared.
    screening : float
        At least 0, in one over length squared.
    n : int
        About how many triangles (without grading); a start when `tol` is given.
    order : {1, 2}
        Degree of the elements.
    graded : bool
        Smaller triangles towards corners where the solution is singular.
    tol : float, optional
        Refine until the estimated absolute error is at most this at `points` (everywhere without them).
    points : (m, 2) array_like, optional
        Where `tol` must hold.
    max_triangles : int
        Where refinement gives up.

    Returns
    -------
    Solution
        Callable at points; `error_at(points)` and `error` estimate its error.

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range.
    NotConverged
        If `tol` would take more than `max_triangles`.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> u = laplace(square, lambda x: x[:, 0] ** 2 - x[:, 1] ** 2, n=200)
    >>> u([[0.5, 0.25]]).round(6)
    array([0.1875])
    """
    screening = check.number("screening", screening, low=0.0)
    if source is not None and not callable(source):
        source = check.number("source", source) or None

    def solve(mesh: Mesh, start: Solution | None) -> Solution:
        return _solve(Space(mesh, order), boundary, source, screening)

    # The mesh that is solved on at last has every edge of this one halved.
    mesh = polygon if isinstance(polygon, Mesh) else Mesh.of(polygon, max(1, n // 4), order=order, graded=graded)
    if tol is not None:
        return solve_to_tolerance(solve, mesh, tol, points, max_triangles)
    return solve_twice(solve, mesh)


def _solve(space: Space, boundary: BoundaryValues, source: Source, screening: float) -> Solution:
    from scipy.sparse import diags

    values = space.boundary_values(boundary)
    offset = 0.5 * float(values[space.fixed].min()) + 0.5 * float(values[space.fixed].max())
    values[space.fixed] -= offset
    unit = space.mesh.outline.size**2
    stiffness = space.gradient.T @ diags(np.tile(space.weights, 2)) @ space.gradient
    load = np.zeros(space.size)
    if screening:
        stiffness = stiffness + unit * screening * (space.value.T @ diags(space.source_weights) @ space.value)
        load -= unit * screening * offset * (space.value.T @ space.source_weights)
    if source is not None:
        at = space.source_points
        density = (
            check.array("source(points)", source(at), (len(at),)) if callable(source) else np.full(len(at), source)
        )
        load += unit * (space.value.T @ (space.source_weights * density))
    free, fixed = space.free, space.fixed
    rows = stiffness.tocsr()[free]
    values[free] = solve_spd(rows[:, free], load[free] - rows[:, fixed] @ values[fixed])
    return Solution(space, values, offset)


def solve_spd(matrix: Any, right: Floats) -> Floats:
    """Solve a sparse symmetric positive definite system whose rows may differ by many orders of magnitude."""
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    if not len(right):
        return right
    scale = 1.0 / np.sqrt(matrix.diagonal())
    scaled = (diags(scale) @ matrix @ diags(scale)).tocsc()
    factors = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(scale * factors.solve(scale * right))
