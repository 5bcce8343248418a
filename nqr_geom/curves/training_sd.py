"""Smoothed distances on the random shapes of Fig. 38 with accurate answers, in batches on any device.

On a quadratic piece z(t) the distance is |a| |t - t1| |t - t2| with the complex roots of z(t) = p, and the speed is
2 |a| |t - tm| with their mean: the integrand of Eq. 50 is smooth but beside these three points. Every piece is cut
below them, and Gauss panels shrink towards the cuts: none comes much closer to a branch point than its own size.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from nqr_geom.curves.families import control_points
from nqr_geom.curves.problems import SdProblem
from nqr_geom.curves.shapes import PackedShapes
from nqr_geom.curves.training import queries, roots_of
from nqr_geom.integrator.learn.recipe import Batch
from nqr_geom.integrator.samplers import gauss_legendre
from nqr_geom.streams import Stream

__all__ = ["ALPHA", "quadratic_sd", "sd_batch"]

ALPHA = 35.0  # of all experiments in Appendix E.1
SIZES = (1.0 / 8.0, 4.0)  # of the shapes that are not of the paper's size, log-uniform
_OTHER = 4  # one training integral in so many has another size
_NODES, _LEVELS, _RATIO = 12, 5, 0.25  # of a panel; panels on each half of an interval, and how they shrink
_PROBES = 16
_NEGLIGIBLE = 25.0  # exp(-25) is 1e-11


@lru_cache(maxsize=4)
def _graded(device: torch.device) -> tuple[Tensor, Tensor]:
    """Nodes and weights on [0, 1] of panels that shrink towards both ends, (P,) each."""
    nodes, weights = (torch.as_tensor(part, device=device) for part in gauss_legendre(_NODES))
    high = 0.5 * _RATIO ** torch.arange(_LEVELS, device=device, dtype=torch.float64)
    low = torch.cat([high[1:], high.new_zeros(1)])
    width = (high - low)[:, None]
    half, part = (low[:, None] + width * nodes).flatten(), (width * weights).flatten()
    return torch.cat([half, 1.0 - half]), torch.cat([part, part])


def quadratic_sd(control: Tensor, points: Tensor, alpha: float = ALPHA) -> Tensor:
    """Smoothed distances to quadratic pieces in general position, each query from its own shape.

    Parameters
    ----------
    control : Tensor, (B, K, 3, 2), float64
        Control points; second differences must not vanish (on random shapes they do not).
    points : Tensor, (B, 2), float64
        Queries, off the curve.
    alpha : float
        Sharpness, > 0; up to about 100 over the length of a piece the result is right to 1e-10.

    Returns
    -------
    Tensor, (B,)
        Smoothed distances (Eq. 50).

    Examples
    --------
    >>> arch = torch.tensor([[[[1.0, 0.0], [0.0, 2.0], [-1.0, 0.0]]]], dtype=torch.float64)
    >>> round(quadratic_sd(arch, torch.zeros(1, 2, dtype=torch.float64)).item(), 6)
    0.866031
    """
    roots, a = roots_of(control, points)  # (B, K, 2), (B, K)
    reach = 2.0 * torch.linalg.vector_norm(control.diff(dim=2), dim=-1).amax(dim=-1)  # the largest speed, (B, K)
    probes = torch.linspace(0.0, 1.0, _PROBES + 1, dtype=control.dtype, device=control.device)
    probes = torch.cat([probes.expand(*a.shape, -1), roots.real.clamp(0.0, 1.0)], dim=-1)
    seen = a.abs()[..., None] * (probes - roots[..., :1]).abs() * (probes - roots[..., 1:]).abs()
    nearest = seen.amin(dim=2)  # of what was probed, (B, K)
    shift = nearest.amin(dim=1)
    # No point of a piece is nearer than its probes by more than half the way between two of them.
    visible = alpha * (nearest - reach * (0.5 / _PROBES) - shift[:, None]) < _NEGLIGIBLE
    row, piece = visible.nonzero(as_tuple=True)
    t1, t2, size = *roots[row, piece].unbind(dim=-1), a[row, piece].abs()
    middle = 0.5 * (t1 + t2)
    cuts = torch.stack([t1.real, middle.real, t2.real], dim=-1).clamp(0.0, 1.0).sort(dim=-1).values  # (M, 3)
    cuts = torch.cat([torch.zeros_like(cuts[:, :1]), cuts, torch.ones_like(cuts[:, :1])], dim=-1)
    width = cuts.diff(dim=-1)
    which, interval = (width > 0.0).nonzero(as_tuple=True)
    nodes, weights = _graded(control.device)
    t = cuts[which, interval, None] + width[which, interval, None] * nodes  # (I, P)
    t1, t2, middle, size = (part[which, None] for part in (t1, t2, middle, size))

    def away2(root: Tensor) -> Tensor:
        return (t - root.real).square() + root.imag.square()

    distance = size * torch.sqrt(away2(t1) * away2(t2))
    values = torch.sqrt(away2(middle)) * torch.exp(-alpha * (distance - shift[row[which], None]))
    part = 2.0 * size[:, 0] * width[which, interval] * (values * weights).sum(dim=1)
    total = torch.zeros_like(shift).index_add_(0, row[which], part)
    return shift - torch.log(total) / alpha


def sd_batch(rows: Tensor, seed: int, split: str) -> Batch:
    """Smoothed distances on random shapes, one shape and one query for each of `rows` (B,).

    Sharpness is 35 for shapes in (-1, 1)^2, as in the paper. Of the training integrals one in four comes in another
    size, so that a network has also seen other sharpnesses: sd at scale s and sharpness alpha is s times sd at scale 1
    and sharpness s alpha. Validation and test are the paper's.
    """
    stream = Stream(seed, split, "queries")
    control = control_points(rows, seed, split)
    points = queries(control, rows, stream)
    if split == "train":
        low, high = SIZES
        size = low * (high / low) ** stream.uniform(rows, torch.tensor(64, device=rows.device))
        size = torch.where(rows % _OTHER == 0, size, 1.0)
        control, points = control * size[:, None, None, None], points * size[:, None]
    index = torch.arange(len(rows), device=rows.device)
    problem = SdProblem(PackedShapes.from_quadratics(control), points, index, rows, alpha=ALPHA)
    return Batch(problem, quadratic_sd(control, points)[:, None])
