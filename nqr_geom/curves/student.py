"""Which rules for winding numbers run compiled on fixed points: students, and the rebuilt curve by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from nqr_geom.curves.shapes import PackedShapes
from nqr_geom.curves.stencil import STENCIL_TOKENS
from nqr_geom.curves.structured import GwnHermite
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
    """Whether a rule is a model that the compiled pass computes: stencil tokens, no attention, one of two bases."""
    if not isinstance(rule, Model) or rule.card.config.width % 4:
        return False
    base, fades_to = type(rule.learned.base), type(rule.consistent)
    plain = INetConfig(STENCIL_TOKENS, layers=0, width=rule.card.config.width)
    if rule.card.config == plain:
        return base is UniformWeights and fades_to is Trapezoid
    on_curve = replace(plain, offset=True, doubtful_only=True)
    return rule.card.config == on_curve and base is GwnHermite and fades_to is GwnHermite


def layers_of(net: INet) -> Layers:
    """Weights of a network without attention, in its own precision."""
    from nqr_geom.curves.compiled_student import Layers

    parts = (net.embed_in, net.embed_out, net.head)
    return Layers(*((part.weight.detach().numpy(), part.bias.detach().numpy()) for part in parts))


def no_layers() -> Layers:
    """What leaves the rebuilt curve as it is."""
    from nqr_geom.curves.compiled_student import Layers

    none = np.zeros((0, STENCIL_TOKENS.width)), np.zeros(0)
    return Layers(none, (np.zeros((0, 0)), np.zeros(0)), (np.zeros((3, 0)), np.zeros(3)))


def whole_of(
    problem: GwnProblem, shapes: PackedShapes, jittered: bool, rule: object, n: int
) -> Callable[[Stream], Whole] | None:
    """The compiled pass of a student, or of the rebuilt curve, over random or jittered points; None for another rule.

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
        Samples an integral. Where a student of plain weights has no share, its rule is one that needs no network.
    """
    box, share, layers = np.array([[-np.inf] * 2, [np.inf] * 2]), 1.0, no_layers()
    if isinstance(rule, Model) and is_student(rule):
        box, share, layers = np.array(rule.card.box), rule.card.share(n), layers_of(rule.learned.net)
        if share == 0.0 and not layers.structured:
            return None
    elif type(rule) is not GwnHermite:
        return None

    def whole(stream: Stream) -> Whole:
        from nqr_geom.curves.compiled_student import estimated

        c, k, shape, points, rows = (
            t.numpy() for t in (shapes.coefficients, shapes.pieces, problem.shape, problem.points, problem.rows)
        )
        got = estimated(c, k, shape, points, rows, stream.key, n, jittered, box, layers)
        # Either part alone where it counts for all: the other one may then be anything.
        mixed = got.learned if share == 1.0 else share * got.learned + (1.0 - share) * got.safe
        value = torch.from_numpy(np.where(got.inside, mixed, got.safe))
        flags = got.doubtful if layers.structured else ~got.inside | (share < 0.5)
        return Whole(value[:, None], torch.from_numpy(flags), problem.batch * n * shapes.queries_per_sample)

    return whole
