"""Integrals on the random shapes of Fig. 38 with exact answers, in batches on any device: what networks learn from.

Every integral has its own shape and its own query, uniform in the square but not closer to the curve than `NEAREST`:
the variance of Monte Carlo grows like one over the distance, so nearer queries would drown all others.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from nqr_geom.curves.families import control_points
from nqr_geom.curves.problems import GwnProblem
from nqr_geom.curves.shapes import PackedShapes
from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.streams import Stream

__all__ = ["NEAREST", "gwn_batch", "near_distance", "quadratic_winding", "queries", "roots_of"]

NEAREST = 1e-3
_TRIES = 4


def roots_of(control: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Complex roots (B, K, 2) of z(t) = p for quadratics (B, K, 3, 2) and queries (B, 2), with z''/2 (B, K)."""
    z = torch.view_as_complex(control.contiguous()) - torch.view_as_complex(points.contiguous())[:, None, None]
    c = z[..., 0]
    b = 2.0 * (z[..., 1] - z[..., 0])
    a = z[..., 0] - 2.0 * z[..., 1] + z[..., 2]
    root = torch.sqrt(b * b - 4.0 * a * c)
    # Of the two signs the one that does not cancel.
    q = -0.5 * (b + torch.where((b.conj() * root).real >= 0.0, root, -root))
    return torch.stack([q / a, c / q], dim=-1), a


def quadratic_winding(control: Tensor, points: Tensor) -> Tensor:
    """Exact winding numbers of quadratic pieces in general position, each query on its own shape.

    The angle that t in [0, 1] subtends is the sum over the roots t_k of z(t) = p of arg((t_k - 1) / t_k).

    Parameters
    ----------
    control : Tensor, (B, K, 3, 2), float64
        Control points; second differences must not vanish (on random shapes they do not).
    points : Tensor, (B, 2), float64
        Queries, off the curve.

    Returns
    -------
    Tensor, (B,)
        Winding numbers.

    Examples
    --------
    >>> arch = torch.tensor([[[[1.0, 0.0], [0.0, 2.0], [-1.0, 0.0]]]], dtype=torch.float64)
    >>> round(quadratic_winding(arch, torch.zeros(1, 2, dtype=torch.float64)).item(), 12)
    0.5
    """
    roots, _ = roots_of(control, points)
    return ((roots - 1.0) / roots).angle().sum(dim=(1, 2)) / (2.0 * math.pi)


def near_distance(control: Tensor, points: Tensor) -> Tensor:
    """Distance of each query from its shape where that is small against the curve's bends, an upper bound elsewhere.

    A root of z(t) = p lies beside the parameter of a near closest point, so the curve is measured there, at the
    real parts of the roots, and at the ends.

    Parameters
    ----------
    control : Tensor, (B, K, 3, 2), float64
        Control points of quadratics.
    points : Tensor, (B, 2), float64
        Queries.

    Returns
    -------
    Tensor, (B,)
        Distances.
    """
    roots, _ = roots_of(control, points)
    t = torch.cat([roots.real.clamp(0.0, 1.0), roots.real.new_tensor([0.0, 1.0]).expand(*roots.shape[:2], 2)], -1)
    t = t[..., None]
    p0, p1, p2 = (control[:, :, k, None] for k in range(3))
    at = (1.0 - t) ** 2 * p0 + 2.0 * t * (1.0 - t) * p1 + t**2 * p2
    return torch.linalg.vector_norm(at - points[:, None, None], dim=-1).amin(dim=(1, 2))


def queries(control: Tensor, rows: Tensor, stream: Stream) -> Tensor:
    """One query for each shape, uniform in (-1, 1)^2 off the curve, (B, 2): the first of four that is far enough."""
    axis = torch.arange(2, device=rows.device)
    points = 2.0 * stream.uniform(rows[:, None], axis) - 1.0
    for attempt in range(1, _TRIES):
        close = near_distance(control, points) < NEAREST
        again = 2.0 * stream.uniform(rows[:, None], axis + 2 * attempt) - 1.0
        points = torch.where(close[:, None], again, points)
    return points


def gwn_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Winding numbers on random shapes, one shape and one query for each of `rows` (B,)."""
    control = control_points(rows, seed, split)
    points = queries(control, rows, Stream(seed, split, "queries"))
    index = torch.arange(len(rows), device=rows.device)
    problem = GwnProblem(PackedShapes.from_quadratics(control), points, index, rows)
    return Batch(problem, quadratic_winding(control, points)[:, None])
