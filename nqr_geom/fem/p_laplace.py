"""The p-Laplace equation div(|grad u|^(p-2) grad u) = 0: the minimiser of the integral of |grad u|^p / p.

Newton's method with Armijo's rule on the energy, along p = 2, ..., p geometric in p - 1. Energies are compared through
the part of their difference that remains once the linear one is taken out: both sides of Armijo's inequality are then
sums of positive terms, and rounding does not end the iteration early where a few triangles hold nearly all the energy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.fem.adapt import solve_to_tolerance, solve_twice
from nqr_geom.fem.linear import solve_spd
from nqr_geom.fem.mesh import Mesh
from nqr_geom.fem.outline import BoundaryValues
from nqr_geom.fem.space import NotConverged, Solution, Space

__all__ = ["default_order", "p_laplace"]

Floats = NDArray[np.float64]

_EPSILON = 1e-6  # of the root mean square gradient of the solution for p = 2
_STEP = 1e-9  # largest last Newton step, of the range of the boundary values
_ARMIJO = 1e-4
_NEWTON_STEPS = 60
_RATIO = 1.5  # of p - 1 from one exponent to the next, as long as Newton converges
_LEAST_RATIO = 1.01


def p_laplace(
    polygon: Any,
    boundary: BoundaryValues,
    p: float = 3.0,
    *,
    n: int = 8000,
    order: int | None = None,
    graded: bool = True,
    tol: float | None = None,
    points: ArrayLike | None = None,
    max_triangles: int = 200_000,
) -> Solution:
    """Solve div(|grad u|^(p-2) grad u) = 0 in a polygon, u = boundary on its edge.

    Parameters
    ----------
    polygon, boundary, n, graded, tol, points, max_triangles
        As for `nqr_geom.fem.linear.laplace`.
    p : float
        Greater than 1. From 1.05 to 50 the solver is tested; beyond it converges or says that it did not.
    order : {1, 2}, optional
        Degree of the elements; by default 2 for p from 1.2 to 10. Beyond, where the gradient vanishes, the quadratic
        ones cost many Newton steps and show their accuracy only on fine meshes: 1 is the default there.

    Returns
    -------
    Solution
        With the Newton `iterations` and the `exponents` that it went through on the finer mesh.

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range.
    NotConverged
        If Newton's method or the refinement stops before its goal; the message has the numbers.

    Notes
    -----
    |grad u|^2 is replaced by |grad u|^2 + eps^2 with eps = 1e-6 of the root mean square gradient for p = 2, so that no
    power of zero occurs.

    Examples
    --------
    >>> square = [[1, 0], [2, 0], [2, 1], [1, 1]]
    >>> angle = p_laplace(square, lambda x: np.arctan2(x[:, 1], x[:, 0]), p=6.0, n=2000)
    >>> float(abs(angle([[1.5, 0.5]])[0] - np.arctan2(0.5, 1.5))) < 1e-3
    True
    """
    p = check.number("p", p, low=1.0, open_low=True)
    degree = default_order(p) if order is None else check.integer("order", order, low=1, high=2)

    def solve(mesh: Mesh, start: Solution | None) -> Solution:
        return _solve(Space(mesh, degree), boundary, p, start)

    mesh = polygon if isinstance(polygon, Mesh) else Mesh.of(polygon, max(1, n // 4), order=degree, graded=graded)
    if tol is not None:
        return solve_to_tolerance(solve, mesh, tol, points, max_triangles)
    return solve_twice(solve, mesh)


def default_order(p: float) -> int:
    """Degree of the elements where none is asked for: quadratic for p from 1.2 to 10, linear beyond."""
    return 2 if 1.2 <= p <= 10.0 else 1


def _solve(space: Space, boundary: BoundaryValues, p: float, start: Solution | None) -> Solution:
    """Bring the boundary values to [-1/2, 1/2], continue in p, and bring the solution back."""
    values = space.boundary_values(boundary)
    low, high = float(values[space.fixed].min()), float(values[space.fixed].max())
    offset, scale = 0.5 * low + 0.5 * high, high - low
    if not np.isfinite(scale):
        raise ValueError(f"boundary: expected values whose range is finite, got {low} to {high}")
    if scale <= 4.0 * np.finfo(float).eps * max(abs(low), abs(high)):
        return Solution(space, np.zeros(space.size), offset, exponents=(p,))
    values[space.fixed] = (values[space.fixed] - offset) / scale
    path = _Path(space, values)
    if start is not None and p != 2.0 and path.try_from(start, offset, scale, p):
        exponents: tuple[float, ...] = (p,)
    else:
        exponents = path.follow(p)
    return Solution(space, scale * path.u, offset, iterations=path.steps, exponents=exponents)


class _Path:
    """Minimisers of the energy for a growing or falling p, each the start of the next one."""

    def __init__(self, space: Space, values: Floats) -> None:
        self.space = space
        self.u = values
        self.steps = 0
        self.u = values + self._newton_step(values, np.ones(len(space.weights)), np.zeros((2, len(space.weights))), 2.0)
        slope = self._slope(self.u)
        mean = float((space.weights * (slope**2).sum(axis=0)).sum() / space.weights.sum())
        self.epsilon = _EPSILON * np.sqrt(mean)

    def try_from(self, start: Solution, offset: float, scale: float, p: float) -> bool:
        """Newton for p at once, from a solution on a coarser mesh."""
        mesh = self.space.mesh
        outline = mesh.outline
        guess = self.u.copy()
        nodes = self.space.free[self.space.free < len(mesh.points)]
        guess[nodes] = (start(outline.centre + outline.size * mesh.points[nodes]) - offset) / scale
        if self.space.order == 2:
            middle = np.zeros(self.space.size)
            middle[self.space.dofs[:, 3:]] = 0.5 * (
                guess[self.space.dofs[:, [0, 1, 0]]] + guess[self.space.dofs[:, [1, 2, 2]]]
            )
            others = self.space.free[self.space.free >= len(mesh.points)]
            guess[others] = middle[others]
        found, _ = self._newton(guess, p)
        if found is not None:
            self.u = found
        return found is not None

    def follow(self, p: float) -> tuple[float, ...]:
        """Go to p by steps geometric in p - 1, smaller ones where Newton fails."""
        exponents, here, ratio = [2.0], 2.0, _RATIO
        while here != p:
            factor = np.clip((p - 1.0) / (here - 1.0), 1.0 / ratio, ratio)
            there = p if 1.0 / ratio < factor < ratio else 1.0 + (here - 1.0) * float(factor)
            found, last = self._newton(self.u, there)
            if found is None:
                ratio = np.sqrt(ratio)
                if ratio < _LEAST_RATIO:
                    raise NotConverged(
                        f"p-Laplacian: Newton's method did not get from p = {here:.6g} to {there:.6g} on the way to "
                        f"{p:.6g} in {_NEWTON_STEPS} steps; its last one was {last:.1e} of the boundary values' range"
                    )
                continue
            self.u, here, ratio = found, there, min(_RATIO, ratio**1.5)
            exponents.append(here)
        return tuple(exponents)

    def _slope(self, u: Floats) -> Floats:
        return np.asarray((self.space.gradient @ u).reshape(2, -1))

    def _newton(self, u: Floats, p: float) -> tuple[Floats | None, float]:
        """The minimiser for p, or None, and the size of the last step."""
        size = np.inf
        for _ in range(_NEWTON_STEPS):
            self.steps += 1
            slope = self._slope(u)
            s = (slope**2).sum(axis=0) + self.epsilon**2
            # Powers relative to the largest one: neither overflow nor underflow matters then.
            log = (0.5 * p - 1.0) * np.log(s)
            strength = np.exp(np.maximum(log - log.max(), -600.0))
            direction = self._newton_step(u, strength, slope / np.sqrt(s), p)
            size = float(np.abs(direction).max())
            if not np.isfinite(size):
                return None, size
            t = self._armijo(s, slope, self._slope(direction), strength, p)
            if t == 0.0:
                return None, size
            u = u + t * direction
            if t == 1.0 and size <= _STEP:
                return u, size
        return None, size

    def _newton_step(self, u: Floats, strength: Floats, unit: Floats, p: float) -> Floats:
        """The step that solves the energy's second-order model; `unit` (2, Q) is the gradient over sqrt(s)."""
        from scipy.sparse import bmat, diags

        space, free = self.space, self.space.free
        w = space.weights * strength
        xx, xy, yy = (w * (float(i == j) + (p - 2.0) * unit[i] * unit[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        gradient: Any = space.gradient[:, free]
        hessian = gradient.T @ bmat([[diags(xx), diags(xy)], [diags(xy), diags(yy)]], format="csr") @ gradient
        force = gradient.T @ (np.tile(w, 2) * self._slope(u).ravel())
        step = np.zeros(space.size)
        step[free] = solve_spd(hessian, -force)
        return step

    def _armijo(self, s: Floats, slope: Floats, along: Floats, strength: Floats, p: float) -> float:
        """The first of 1, 1/2, 1/4, ... that lowers the energy by its share of the slope, 0 if none does."""
        dot, square = (slope * along).sum(axis=0), (along**2).sum(axis=0)
        weight = self.space.weights * strength
        decrement = float((weight * (square + (p - 2.0) * dot**2 / s)).sum())
        t = 1.0
        for _ in range(40):
            growth = (2.0 * t * dot + t * t * square) / s
            with np.errstate(over="ignore"):
                beyond = float((weight * (s / p * _remainder(growth, 0.5 * p) + 0.5 * t * t * square)).sum())
            if beyond <= (1.0 - _ARMIJO) * t * decrement:
                return t
            t *= 0.5
        return 0.0


def _remainder(x: Floats, a: float) -> Floats:
    """(1 + x)^a - 1 - a x, x > -1, without cancellation at small x."""
    series = 0.5 * a * (a - 1.0) * x**2 * (1.0 + (a - 2.0) / 3.0 * x * (1.0 + (a - 3.0) / 4.0 * x))
    safe = np.maximum(x, -1.0 + 1e-16)
    return np.where(np.abs(x) * max(a, 1.0) < 1e-3, series, np.expm1(a * np.log1p(safe)) - a * x)
