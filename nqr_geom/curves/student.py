"""Which models of winding numbers are students, and their compiled pass as the integrator takes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch

from nqr_geom.curves.shapes import PackedShapes
from nqr_geom.curves.stencil import STENCIL_TOKENS
from nqr_geom.integrator.learn.inet import INet, INetConfig, UniformWeights
from nqr_geom.integrator.learn.zoo import Model
from nqr_geom.integrator.problem import Whole
from nqr_geom.integrator.rules import Trapezoid
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.curves.compiled_student import Layers
    from nqr_geom.curves.problems import GwnProblem

__all__ = ["layers_of", "whole_of"]


def is_student(rule: object) -> bool:
    """Whether a rule is a model that the compiled pass computes: stencil tokens, no attention, plain weights."""
    if not isinstance(rule, Model):
        return False
    config = rule.card.config
    plain = isinstance(rule.learned.base, UniformWeights) and isinstance(rule.consistent, Trapezoid)
    return plain and config.width % 4 == 0 and config == INetConfig(STENCIL_TOKENS, layers=0, width=config.width)


def layers_of(net: INet) -> Layers:
    """Weights of a network without attention, in its own precision."""
    from nqr_geom.curves.compiled_student import Layers

    parts = (net.embed_in, net.embed_out, net.head)
    return Layers(*((part.weight.detach().numpy(), part.bias.detach().numpy()) for part in parts))


def whole_of(
    problem: GwnProblem, shapes: PackedShapes, jittered: bool, rule: object, n: int
) -> Callable[[Stream], Whole] | None:
    """The compiled pass of a student over random or jittered points, or None for another rule.

    Parameters
    ----------
    problem : GwnProblem
        On a CPU.
    shapes : PackedShapes
        Its shapes.
    jittered : bool
        One sample in each of n equal cells, instead of independent ones.
    rule : Rule
        Any.
    n : int
        Samples an integral. Where the student's share at n is 0 its rule does without the network, and so without this.
    """
    if not isinstance(rule, Model) or not is_student(rule) or rule.card.share(n) == 0.0:
        return None

    def whole(stream: Stream) -> Whole:
        from nqr_geom.curves.compiled_student import estimated

        c, k, shape, points, rows = (
            t.numpy() for t in (shapes.coefficients, shapes.pieces, problem.shape, problem.points, problem.rows)
        )
        box, share = np.array(rule.card.box), rule.card.share(n)
        learned, safe, inside = estimated(
            c, k, shape, points, rows, stream.key, n, jittered, box, layers_of(rule.learned.net)
        )
        # Either part alone where it counts for all: the other one may then be anything.
        mixed = learned if share == 1.0 else share * learned + (1.0 - share) * safe
        value = torch.from_numpy(np.where(inside, mixed, safe))
        flags = torch.from_numpy(~inside) if share >= 0.5 else torch.ones(len(inside), dtype=torch.bool)
        return Whole(value[:, None], flags, problem.batch * n * shapes.queries_per_sample)

    return whole
