"""Laplace's equation on a polygon to many digits, with a bound on the error: a boundary integral without corners.

The solution is a double layer potential, u = D mu + sum of a_k ln|z - z_k| with one logarithm a hole. Towards a corner
mu has singular powers and, where the data jumps, a jump; there a fine mesh is graded down to rounding. It is solved
for each corner alone, once for its own data and once for a polynomial field from elsewhere, so that the global system
only has the nodes of four coarse panels a corner (the compression of Helsing and Ojala 2008, without recursion: between
straight edges the local matrix depends on the angle alone and splits into an even and an odd half).

The potential is harmonic whatever its density, so by the maximum principle it is off by at most what it is off on the
boundary. That is measured between the nodes, panels where it is too large are refined, and what is left is returned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.rows import over_rows
from nqr_geom.wos.corner import Corner, corner_alone, nodes_for, rule_of
from nqr_geom.wos.domain import Boundary, Domain

__all__ = ["BoundarySolution", "solve"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_DENSE = 3000  # unknowns up to which the system is factorised
_MOST = 20_000  # unknowns: their matrix is 3.2 GB
_ROUNDS = 12
_TOUCH = 1e-13  # in the frame: as near as this the boundary value is the answer
_LEAST = 1e-7  # in the frame: nearer to a corner rounding of the coordinates alone turns the view


class Mesh(NamedTuple):
    """Coarse nodes: four panels a corner, then the mid panels."""

    reach: Floats  # (n,) length of a corner's panels
    mids: list[Floats]  # break points between the corners' parts of each edge
    z: Complexes
    source: Complexes
    edge: NDArray[np.int64]
    corner: NDArray[np.int64]
    t: Floats
    middle: Complexes
    half: Complexes


@dataclass(frozen=True, eq=False)
class BoundarySolution:
    """A harmonic function inside a polygon.

    Attributes
    ----------
    residual : float
        Largest difference to the boundary values at points that the solution was not fitted to: by the maximum
        principle a bound on the error inside, up to what happens between these points.
    unknowns : int
        Size of the last global system.
    rounds : int
        How often the mesh was refined.
    """

    domain: Domain
    boundary: Boundary
    residual: float
    unknowns: int
    rounds: int
    level: float
    fields: tuple[Any, ...]

    def __call__(self, points: ArrayLike) -> Floats:
        """The solution at points (m, 2) of the domain, (m,); outside it means nothing."""
        return self.at(self.domain.to_frame(points))

    def at(self, framed: Floats) -> Floats:
        """The solution at points (m, 2) in the domain's frame."""
        result = self._potential(framed[:, 0] + 1j * framed[:, 1], np.full(len(framed), -1)) + self.level
        edge, t, distance = self.domain.search(framed)
        touching = distance < _TOUCH
        result[touching] = self.boundary.at(edge[touching], t[touching])
        return result

    def _potential(self, z: Complexes, own: NDArray[np.int64]) -> Floats:
        from nqr_geom.wos.layer import evaluate

        result = np.empty(len(z))
        over_rows(lambda i, j: evaluate(*(z[i:j], own[i:j], *self.fields, result[i:j])), len(z))
        return result


def solve(domain: Domain, boundary: Boundary, tol: float = 1e-9) -> BoundarySolution:
    """Solve Laplace's equation with given boundary values.

    Parameters
    ----------
    domain : Domain
        A polygon, perhaps with holes, that touches itself nowhere.
    boundary : Boundary
        Values on its edge. Jumps and roots at vertices are fine, elsewhere they must be smooth along an edge.
    tol : float
        Largest boundary residual to aim for, relative to the spread of the values; refinement stops there, or when the
        system would grow beyond 20,000 unknowns, or when it no longer helps.

    Returns
    -------
    BoundarySolution
        Callable on points, with its `residual`.

    References
    ----------
    Helsing, Ojala, Corner singularities for elliptic problems, 2008; Greenbaum, Greengard, McFadden, Laplace's equation
    and the Dirichlet-Neumann map in multiply connected domains, 1993.

    Examples
    --------
    >>> from nqr_geom.wos.domain import Domain
    >>> square = Domain.of([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> jump = square.boundary(lambda p: (p[:, 1] == 1.0).astype(float))
    >>> bool(abs(solve(square, jump)([[0.5, 0.5]])[0] - 0.25) < 1e-9)
    True
    """
    tol = check.number("tol", tol, low=0.0, open_low=True)
    return _Solver(domain, boundary, max(tol, 1e-12)).run()


class _Solver:
    """State of one solve: the rule, the corners already solved, the best solution so far."""

    def __init__(self, domain: Domain, boundary: Boundary, tol: float) -> None:
        self.domain, self.boundary = domain, boundary
        self.rule = rule_of(nodes_for(tol))
        self.start = domain.start[:, 0] + 1j * domain.start[:, 1]
        along = domain.end - domain.start
        self.unit = (along[:, 0] + 1j * along[:, 1]) / domain.lengths
        self.previous = np.argsort(domain.following)
        turn = -self.unit[self.previous] / self.unit
        self.angle = np.angle(turn) % (2.0 * np.pi)
        self.tol = tol
        self.solved: dict[tuple[int, float], Corner] = {}
        probe = boundary.at(np.repeat(np.arange(len(domain)), 3), np.tile([0.1, 0.5, 0.9], len(domain)))
        self.level = float(probe[0])
        self.scale = float(np.ptp(probe)) or 1.0

    def run(self) -> BoundarySolution:
        reach, mids = self._first_mesh()
        mesh = self._mesh(reach, mids)
        best, corner_errors, mid_errors = self._solve(mesh, 0)
        wanted, stuck = self.tol * self.scale, 0
        for count in range(1, _ROUNDS):
            reach, mids, panels = self._refined(mesh, corner_errors > wanted, mid_errors > wanted)
            if not 0 < panels * len(self.rule.nodes) <= _MOST:
                break
            mesh = self._mesh(reach, mids)
            solution, corner_errors, mid_errors = self._solve(mesh, count)
            stuck = 0 if solution.residual < 0.5 * best.residual else stuck + 1
            if solution.residual < best.residual:
                best = solution
            if stuck == 2:
                break
        return best

    # --- mesh -----------------------------------------------------------------------------------------

    def _first_mesh(self) -> tuple[Floats, list[Floats]]:
        """Corners as large as their edges and their surroundings allow, mid panels no longer than far from a corner."""
        domain = self.domain
        reach = 0.25 * np.minimum(domain.lengths, domain.lengths[self.previous])
        clear = _clearance(domain, self.previous)
        if (clear < 1e-12).any():
            v = domain.from_frame(domain.start[[int(np.argmin(clear))]])[0].tolist()
            raise ValueError(f"polygon: method 'boundary' expects loops that touch nowhere, got a touching vertex {v}")
        reach = np.minimum(reach, 0.25 * clear)
        return reach, [self._graded(e, reach) for e in range(len(domain))]

    def _graded(self, e: int, reach: Floats, old: Floats | None = None) -> Floats:
        """Break points between the corners' parts of an edge; a panel is no longer than its distance to a corner."""
        length = self.domain.lengths[e]
        low, high = 2.0 * reach[e], length - 2.0 * reach[self.domain.following[e]]
        if high - low < 1e-9 * length:
            return np.array([low])
        points = np.array([low, high])
        if old is not None:
            points = np.concatenate([[low], old[(old > low) & (old < high)], [high]])
        while True:
            a, b = points[:-1], points[1:]
            long = (b - a) > np.maximum(1.0000001 * np.minimum(a, length - b), 1e-12)
            if not long.any():
                return points
            points = np.sort(np.concatenate([points, 0.5 * (a + b)[long]]))

    def _mesh(self, reach: Floats, mids: list[Floats]) -> Mesh:
        domain, rule = self.domain, self.rule
        n, p = len(domain), len(rule.nodes)
        # (corner, side, panel, node): distance from the apex.
        r = (np.array([[0.0], [1.0]]) + 0.5 + 0.5 * rule.nodes)[None, None] * reach[:, None, None, None]
        r = np.broadcast_to(r, (n, 2, 2, p))
        side = np.stack([self.unit, -self.unit[self.previous]], axis=1)[:, :, None, None]
        sign = np.array([1.0, -1.0])[:, None, None]
        z = self.start[:, None, None, None] + side * r
        source = np.broadcast_to(sign * side * (0.5 * reach[:, None, None, None]) * rule.weights, r.shape)
        edge = np.broadcast_to(np.stack([np.arange(n), self.previous], axis=1)[:, :, None, None], z.shape)
        length = domain.lengths[edge]
        t = np.where(sign > 0, r / length, 1.0 - r / length)
        corner = np.broadcast_to(np.arange(n)[:, None, None, None], z.shape)
        which = np.repeat(np.arange(n), [len(m) - 1 for m in mids])
        a = np.concatenate([m[:-1] for m in mids])
        b = np.concatenate([m[1:] for m in mids])
        middle = self.start[which] + self.unit[which] * 0.5 * (a + b)
        half = self.unit[which] * 0.5 * (b - a)
        along = 0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * rule.nodes
        return Mesh(
            reach,
            mids,
            np.concatenate([z.ravel(), (middle[:, None] + half[:, None] * rule.nodes).ravel()]),
            np.concatenate([source.ravel(), (half[:, None] * rule.weights).ravel()]),
            np.concatenate([edge.ravel(), np.repeat(which, p)]),
            np.concatenate([corner.ravel(), np.full(len(which) * p, -1)]),
            np.concatenate([t.ravel(), (along / domain.lengths[which][:, None]).ravel()]),
            middle,
            half,
        )

    def _refined(
        self, mesh: Mesh, corners: NDArray[np.bool_], panels: NDArray[np.bool_]
    ) -> tuple[Floats, list[Floats], int]:
        """Halved corners and panels, and how many panels there are then; 0 if nothing changed."""
        reach = np.where(corners & (mesh.reach > 1e-6), 0.5 * mesh.reach, mesh.reach)
        mids, at, changed = [], 0, bool((reach < mesh.reach).any())
        for e, old in enumerate(mesh.mids):
            bad = panels[at : at + len(old) - 1]
            at += len(old) - 1
            changed |= bool(bad.any())
            points = np.sort(np.concatenate([old, 0.5 * (old[:-1] + old[1:])[bad]]))
            mids.append(self._graded(e, reach, points))
        return reach, mids, (4 * len(reach) + sum(len(m) - 1 for m in mids)) if changed else 0

    # --- corners --------------------------------------------------------------------------------------

    def _corner(self, c: int, reach: float) -> Corner:
        key = (c, reach)
        if key not in self.solved:
            self.solved[key] = corner_alone(
                self.boundary, c, int(self.previous[c]), float(self.angle[c]), reach, self.tol, self.level
            )
        return self.solved[key]

    # --- the global system ----------------------------------------------------------------------------

    def _solve(self, mesh: Mesh, count: int) -> tuple[BoundarySolution, Floats, Floats]:
        n, p, total = len(self.domain), len(self.rule.nodes), len(mesh.z)
        corners = [self._corner(c, float(mesh.reach[c])) for c in range(n)]
        # Compressed density = given - response @ field from elsewhere, corner by corner; 2 on smooth panels.
        given = np.concatenate([(k.moments @ k.own.T).T.ravel() for k in corners]
                               + [2.0 * (self.boundary.at(mesh.edge, mesh.t) - self.level)[4 * p * n :]])  # fmt: skip
        response = np.stack([np.einsum("cf,bfsk->bcsk", k.moments, k.answer).reshape(4 * p, 4 * p) for k in corners])

        def respond(field: Floats) -> Floats:
            local = np.einsum("cij,cj->ci", response, field[: 4 * p * n].reshape(n, 4 * p)).ravel()
            return np.concatenate([local, 2.0 * field[4 * p * n :]])

        potential = self._matrix(mesh)
        poles, logs, constraint = self._holes(mesh)
        field, charge = self._system(potential, response, given, respond, logs, constraint)
        compressed = given - respond(field)
        local = field[: 4 * p * n].reshape(n, 2, 2 * p)
        densities = [k.own - np.einsum("bfsk,sk->bf", k.answer, local[c]) for c, k in enumerate(corners)]
        fine = np.concatenate([d.reshape(2, -1, p).transpose(1, 0, 2) for d in densities])
        smooth = compressed[4 * p * n :].reshape(-1, p)
        fields = (
            np.stack([np.arange(n), self.previous], axis=1),
            self.start,
            np.stack([self.unit, -self.unit[self.previous]], axis=1),
            mesh.reach,
            mesh.z,
            mesh.source * compressed,
            np.cumsum([0] + [len(k.radii) - 1 for k in corners]),
            np.concatenate([k.radii for k in corners]),
            fine,
            fine @ self.rule.inverse.T,
            mesh.middle,
            mesh.half,
            mesh.edge[4 * p * n :: p].copy(),
            smooth @ self.rule.inverse.T,
            poles,
            charge,
            self.rule.nodes,
            self.rule.weights,
        )
        solution = BoundarySolution(self.domain, self.boundary, np.inf, total, count, self.level, fields)
        corner_errors, mid_errors = self._errors(solution, mesh, corners)
        residual = float(max(corner_errors.max(initial=0.0), mid_errors.max(initial=0.0)))
        done = BoundarySolution(self.domain, self.boundary, residual, total, count, self.level, fields)
        return done, corner_errors, mid_errors

    def _matrix(self, mesh: Mesh) -> Floats:
        from nqr_geom.wos.layer import assemble

        total = len(mesh.z)
        # A corner's own fields are in `answer`; mid panels have no corner and see all but their own edge.
        corner = np.where(mesh.corner >= 0, mesh.corner, -1 - np.arange(total))
        result = np.empty((total, total))
        arrays = (mesh.z, mesh.source, mesh.edge, corner, mesh.middle, mesh.half, self.rule.weights, self.rule.inverse)
        over_rows(lambda i, j: assemble(*arrays, i, j, result), total)
        return result

    def _holes(self, mesh: Mesh) -> tuple[Complexes, Floats, Floats]:
        """A pole in every hole, its logarithm at the nodes (k, h), and the rows that make the density's mean zero."""
        import shapely

        poles, rows = [], []
        for hole in range(1, int(self.domain.loop[-1]) + 1):
            ring = self.domain.start[self.domain.loop == hole]
            inner = shapely.Polygon(ring).representative_point()
            poles.append(complex(inner.x, inner.y))
            rows.append(np.where(self.domain.loop[mesh.edge] == hole, np.abs(mesh.source), 0.0))
        z = np.array(poles, dtype=np.complex128)
        logs = np.log(np.abs(mesh.z[:, None] - z)) if poles else np.zeros((len(mesh.z), 0))
        return z, logs, np.array(rows).reshape(len(poles), len(mesh.z))

    def _system(
        self, potential: Floats, response: Floats, given: Floats, respond: Any, logs: Floats, constraint: Floats
    ) -> tuple[Floats, Floats]:
        """The field at the nodes from elsewhere, and the charges in the holes."""
        n, size, total, holes = len(response), response.shape[1], len(given), logs.shape[1]
        right = np.concatenate([potential @ given, constraint @ given])
        if total <= _DENSE:
            matrix = np.zeros((total + holes, total + holes))
            whole = np.concatenate([potential, constraint])
            near = whole[:, : n * size].reshape(-1, n, size).transpose(1, 0, 2) @ response
            matrix[:, : n * size] = near.transpose(1, 0, 2).reshape(total + holes, -1)
            matrix[:, n * size : total] = 2.0 * whole[:, n * size :]
            matrix[np.arange(total), np.arange(total)] += 1.0
            matrix[:total, total:] = -logs
            answer = np.linalg.solve(matrix, right)
            return answer[:total], answer[total:]
        from scipy.sparse.linalg import LinearOperator, gmres

        def apply(v: Floats) -> Floats:
            density = respond(v[:total])
            return np.concatenate([v[:total] + potential @ density - logs @ v[total:], constraint @ density])

        operator = LinearOperator((total + holes,) * 2, matvec=apply, dtype=np.float64)
        answer, _ = gmres(operator, right, rtol=0.03 * self.tol, atol=0.0, restart=80, maxiter=3)
        return answer[:total], answer[total:]

    # --- how far off ----------------------------------------------------------------------------------

    def _errors(self, solution: BoundarySolution, mesh: Mesh, corners: list[Corner]) -> tuple[Floats, Floats]:
        """Largest boundary residual on each corner's part and each mid panel, between the nodes."""
        n, p = len(self.domain), len(self.rule.nodes)
        s = np.array([-0.93, -0.31, 0.17, 0.77])
        powers = np.vander(s, p, increasing=True)
        first, radii, fine, lengths = solution.fields[6], solution.fields[7], solution.fields[9], self.domain.lengths
        panel = np.arange(len(fine))
        owner = np.searchsorted(first, panel, side="right") - 1
        a, b = radii[panel + owner], radii[panel + owner + 1]
        r = np.broadcast_to((0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * s)[:, None], (len(fine), 2, len(s)))
        edge = np.broadcast_to(np.stack([owner, self.previous[owner]], axis=1)[:, :, None], r.shape)
        t = np.stack([r[:, 0] / lengths[edge[:, 0]], 1.0 - r[:, 1] / lengths[edge[:, 1]]], axis=1)
        away = np.stack([self.unit[owner], -self.unit[self.previous[owner]]], axis=1)[:, :, None]
        z = self.start[owner][:, None, None] + away * r
        density = fine @ powers.T
        seen = r >= _LEAST
        near = np.zeros(r.shape)
        near[seen] = self._residual(solution, z[seen], edge[seen], t[seen], density[seen])
        corner_errors = np.zeros(n)
        np.maximum.at(corner_errors, owner, near.max(axis=(1, 2)))
        which, along = solution.fields[12], mesh.middle[:, None] + mesh.half[:, None] * s
        edge = np.broadcast_to(which[:, None], along.shape)
        t = np.abs(along - self.start[edge]) / lengths[edge]
        return corner_errors, self._residual(solution, along, edge, t, solution.fields[13] @ powers.T).max(axis=1)

    def _residual(
        self, solution: BoundarySolution, z: Complexes, edge: NDArray[np.int64], t: Floats, density: Floats
    ) -> Floats:
        potential = solution._potential(z.ravel(), edge.ravel()).reshape(z.shape)
        return np.abs(potential + 0.5 * density + self.level - self.boundary.at(edge, t))


def _clearance(domain: Domain, previous: NDArray[np.int64]) -> Floats:
    """Distance from the start of each edge to the edges that do not meet there."""
    edges = domain.nearest.edges
    result = np.empty(len(domain))
    for c, (x, y) in enumerate(domain.start):
        ax, ay = x - edges[:, 0], y - edges[:, 1]
        t = np.clip((ax * edges[:, 2] + ay * edges[:, 3]) * edges[:, 4], 0.0, 1.0)
        distance = np.hypot(ax - t * edges[:, 2], ay - t * edges[:, 3])
        distance[[c, previous[c]]] = np.inf
        result[c] = distance.min()
    return result
