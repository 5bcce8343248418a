"""Linear and quadratic elements on a mesh as sparse operators, and functions in them that can be asked anywhere."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.outline import BoundaryValues

__all__ = ["NotConverged", "Solution", "Space"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class NotConverged(RuntimeError):
    """A solver that stopped before its goal; the message says where it stood."""


class Space:
    """Continuous functions that are polynomials of degree `order` on every triangle.

    With Q quadrature points in all, ``gradient`` (2 Q, dofs) and ``value`` (Q, dofs) are sparse matrices that give both
    components of the gradient, and the value, at every point; ``weights`` (Q,) integrates. All in frame coordinates.

    Parameters
    ----------
    mesh : Mesh
    order : {1, 2}
    """

    def __init__(self, mesh: Mesh, order: int) -> None:
        from skfem import Basis, ElementTriP1, ElementTriP2, MeshTri

        self.mesh = mesh
        self.order = check.integer("order", order, low=1, high=2)
        element = ElementTriP1() if order == 1 else ElementTriP2()
        shape = MeshTri(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.triangles.T), sort_t=False)
        # Gradients of linear elements are constant: one point integrates any function of them.
        self._basis = Basis(shape, element, intorder=1 if order == 1 else 4)
        self._sources = Basis(shape, element, intorder=3 if order == 1 else 5)
        self.dofs: Integers = self._basis.element_dofs.T  # (t, 3 or 6): corners, then edges 01, 12, 02
        self.size = int(self._basis.N)
        edge_dof = np.zeros(len(mesh.edges.nodes), dtype=np.int64)
        if order == 2:
            edge_dof[mesh.edges.of_triangle[:, [2, 0, 1]]] = self.dofs[:, 3:]
        self._middles = edge_dof[mesh.segment_number] if order == 2 else edge_dof[:0]
        self.fixed = np.union1d(np.flatnonzero(mesh.boundary), self._middles)
        self.free = np.setdiff1d(np.arange(self.size), self.fixed)

    @cached_property
    def weights(self) -> Floats:
        """Quadrature weights (Q,) that go with `gradient`."""
        return np.asarray(self._basis.dx.ravel())

    @cached_property
    def gradient(self) -> Any:
        """Both components of the gradient at the quadrature points, (2 Q, dofs)."""
        return self._operator(self._basis, [b[0].grad for b in self._basis.basis])

    @cached_property
    def value(self) -> Any:
        """Values at the points where sources are integrated, (Q', dofs)."""
        shape = self._sources.dx.shape
        return self._operator(
            self._sources, [np.broadcast_to(np.asarray(b[0]), shape)[None] for b in self._sources.basis]
        )

    @property
    def source_points(self) -> Floats:
        """Points (Q', 2), in the user's coordinates, where sources are integrated with `source_weights`."""
        outline = self.mesh.outline
        places = np.asarray(self._sources.global_coordinates())
        return outline.centre + outline.size * places.reshape(2, -1).T

    @property
    def source_weights(self) -> Floats:
        """Quadrature weights (Q',) that go with `value`."""
        return np.asarray(self._sources.dx.ravel())

    def boundary_values(self, boundary: BoundaryValues) -> Floats:
        """Boundary values at the fixed degrees of freedom, 0 at the others, (dofs,)."""
        result = np.zeros(self.size)
        nodes, middles = self.mesh.boundary_values(boundary, self.order)
        result[: len(nodes)] = nodes
        result[self._middles] = middles
        return result

    def shape_functions(self, weights: Floats) -> Floats:
        """Values (m, 3 or 6) of the shape functions at barycentric coordinates (m, 3)."""
        if self.order == 1:
            return weights
        a, b, c = weights.T
        return np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * a * c], axis=1)

    def _operator(self, basis: Any, fields: list[Floats]) -> Any:
        """The matrix of shape functions' fields (components, t, q) against dofs."""
        from scipy.sparse import csr_matrix

        stacked = np.stack(fields, axis=-1)  # (components, t, q, functions)
        rows = stacked.shape[:3]
        columns = np.broadcast_to(self.dofs[None, :, None, :], stacked.shape)
        pointer = np.arange(0, stacked.size + 1, stacked.shape[3])
        matrix = csr_matrix((stacked.ravel(), columns.ravel(), pointer), shape=(int(np.prod(rows)), self.size))
        matrix.sort_indices()
        return matrix


@dataclass(frozen=True, eq=False)
class Solution:
    """A function on a polygon, found once and asked anywhere.

    Attributes
    ----------
    space : Space
    coefficients : (dofs,) float64 ndarray
        Nodal values less `offset`.
    offset : float
        Added to every value; constant solutions are exact by it.
    coarse : Solution or None
        The same problem on triangles twice as long, from which the error is estimated.
    iterations : int
        Newton steps, 0 for linear problems.
    exponents : tuple of float
        The values of p that the solver went through.
    """

    space: Space
    coefficients: Floats
    offset: float = 0.0
    coarse: Solution | None = None
    iterations: int = 0
    exponents: tuple[float, ...] = field(default=(2.0,))

    def __call__(self, points: ArrayLike, *, outside: str = "raise") -> Floats:
        """Values (m,) at points (m, 2); those outside the polygon are refused, or NaN with ``outside="nan"``."""
        triangle, weights = self._locate(points, outside)
        shape = self.space.shape_functions(weights)
        values = self.offset + (shape * self.coefficients[self.space.dofs[triangle]]).sum(axis=1)
        return np.where(triangle >= 0, values, np.nan)

    def gradient(self, points: ArrayLike, *, outside: str = "raise") -> Floats:
        """Gradient (m, 2) in the triangle that holds each point (m, 2)."""
        triangle, weights = self._locate(points, outside)
        corners = self.space.mesh.points[self.space.mesh.triangles[triangle]]
        opposite = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
        twice = opposite[:, 0, 0] * opposite[:, 1, 1] - opposite[:, 0, 1] * opposite[:, 1, 0]
        slopes = np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / twice[:, None, None]  # of barycentrics
        a, b, c = (weights[:, k, None] for k in range(3))
        if self.space.order == 2:
            ga, gb, gc = (slopes[:, k] for k in range(3))
            functions = [(4 * a - 1) * ga, (4 * b - 1) * gb, (4 * c - 1) * gc]
            functions += [4 * (a * gb + b * ga), 4 * (b * gc + c * gb), 4 * (a * gc + c * ga)]
            slopes = np.stack(functions, axis=1)
        result = (slopes * self.coefficients[self.space.dofs[triangle]][..., None]).sum(axis=1)
        result /= self.space.mesh.outline.size
        return np.where((triangle >= 0)[:, None], result, np.nan)

    def error_at(self, points: ArrayLike, *, outside: str = "raise") -> Floats:
        """Estimated absolute error (m,): the difference to the solution on triangles twice as long."""
        if self.coarse is None:
            raise ValueError("error_at: expected a solution with a coarser one, got one from a single mesh")
        return np.abs(self(points, outside=outside) - self.coarse(points, outside=outside))

    @cached_property
    def error(self) -> float:
        """Largest estimated absolute error over the inner nodes and the triangles' centres."""
        if self.coarse is None:
            raise ValueError("error: expected a solution with a coarser one, got one from a single mesh")
        mesh = self.space.mesh
        places = np.concatenate([mesh.points[~mesh.boundary], mesh.points[mesh.triangles].mean(axis=1)])
        return float(self.error_at(mesh.outline.centre + mesh.outline.size * places).max())

    @property
    def triangles(self) -> int:
        """Number of triangles."""
        return len(self.space.mesh.triangles)

    def _locate(self, points: ArrayLike, outside: str) -> tuple[Integers, Floats]:
        places = check.array("points", points, ("m", 2))
        check.choice("outside", outside, ["raise", "nan"])
        triangle, weights = self.space.mesh.locate(places)
        if outside == "raise" and (triangle < 0).any():
            row = int(np.flatnonzero(triangle < 0)[0])
            raise ValueError(
                f'points: expected points inside the polygon (or outside="nan"), got {places[row]} at row {row}'
            )
        return triangle, weights
