"""Shapes as the integrator sees them: many curves, or a black box, that can be asked for points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from nqr_geom.curves.curve import BlackBoxCurve, Curve

__all__ = ["BlackBoxShape", "PackedShapes", "Shapes", "Told", "locate"]


class Shapes(Protocol):
    """S curves that can be asked for points."""

    @property
    def pieces(self) -> Tensor:
        """Number of pieces of each shape, (S,) int64, at least 1."""

    @property
    def queries_per_sample(self) -> int:
        """Point queries that a position with its tangent costs."""

    def at(self, shape: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position (B,N,2), tangent dx/ds (B,N,2) and piece (B,N) of shape (B,) at s (B,N)."""


@dataclass(frozen=True)
class PackedShapes:
    """Polynomial pieces of many shapes in one tensor, evaluated on any device.

    Parameters
    ----------
    coefficients : Tensor, (S, K, 4, 2), float64
        Power basis of each piece in its local parameter.
    pieces : Tensor, (S,), int64
        How many of the K pieces are used.
    """

    coefficients: Tensor
    pieces: Tensor
    queries_per_sample: int = 1

    @classmethod
    def from_curves(cls, curves: Sequence[Curve]) -> PackedShapes:
        """Pack curves; an empty one becomes a single piece of length zero."""
        most = max((curve.n_pieces for curve in curves), default=0)
        packed = np.zeros((len(curves), max(most, 1), 4, 2))
        for k, curve in enumerate(curves):
            packed[k, : curve.n_pieces] = curve.coefficients
        pieces = torch.tensor([max(curve.n_pieces, 1) for curve in curves])
        return cls(torch.from_numpy(packed), pieces)

    @classmethod
    def from_quadratics(cls, control: Tensor) -> PackedShapes:
        """Shapes of K quadratic Bezier pieces each, (S, K, 3, 2): the family while training."""
        p0, p1, p2 = control.unbind(dim=2)
        coefficients = torch.stack([p0, 2.0 * (p1 - p0), p0 - 2.0 * p1 + p2, torch.zeros_like(p0)], dim=2)
        return cls(coefficients, torch.full(control.shape[:1], control.shape[1], device=control.device))

    def at(self, shape: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        count = self.pieces[shape][:, None]
        piece, t = locate(s, count)
        c = self.coefficients[shape[:, None], piece]
        c0, c1, c2, c3 = c.unbind(dim=2)
        t = t[..., None]
        position = c0 + t * (c1 + t * (c2 + t * c3))
        tangent = count[..., None] * (c1 + t * (2.0 * c2 + t * (3.0 * c3)))
        return position, tangent, piece


@dataclass(frozen=True)
class BlackBoxShape:
    """One curve of which only points can be asked."""

    curve: BlackBoxCurve

    @property
    def pieces(self) -> Tensor:
        return torch.tensor([self.curve.n_pieces])

    @property
    def queries_per_sample(self) -> int:
        return 1 + self.curve.derivative_queries

    def at(self, shape: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        piece = locate(s, self.pieces[shape][:, None])[0]
        flat = s.cpu().numpy().ravel()
        position = torch.from_numpy(self.curve.sample(flat)).reshape(*s.shape, 2)
        tangent = torch.from_numpy(self.curve.derivative(flat)).reshape(*s.shape, 2)
        return position.to(s.device), tangent.to(s.device), piece


@dataclass(frozen=True)
class Told:
    """What shapes told of their points, to be told again.

    Parameters
    ----------
    shapes : Shapes
        That were asked.
    position, tangent, piece : Tensor
        What they answered; asked again for the same points, these do.
    """

    shapes: Shapes
    position: Tensor
    tangent: Tensor
    piece: Tensor

    @property
    def pieces(self) -> Tensor:
        return self.shapes.pieces

    @property
    def queries_per_sample(self) -> int:
        return self.shapes.queries_per_sample

    def at(self, shape: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return self.position, self.tangent, self.piece


def locate(s: Tensor, count: Tensor) -> tuple[Tensor, Tensor]:
    """Piece and local parameter in [0, 1] of s, where `count` equal pieces share [0, 1] (see `Curve.locate`)."""
    u = s * count
    joint = u.round()
    u = torch.where((u - joint).abs() <= 2.0**-52 * joint, joint, u)
    piece = torch.minimum(u.floor(), (count - 1).double()).long()
    return piece, (u - piece).clamp(0.0, 1.0)
