"""Which sampling networks place their points on curves in the compiled pass."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from nqr_geom.curves.gaps import CurveGaps
from nqr_geom.curves.shapes import PackedShapes
from nqr_geom.integrator.learn.heads import GapHead
from nqr_geom.integrator.learn.snet import CausalBlock, SNet
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.problem import Feature
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.curves.compiled_snet import Weights
    from nqr_geom.curves.problems import GwnProblem

__all__ = ["CURVE_SAMPLE", "placing", "weights_of"]

# What a sampling network reads of a sample on a curve by itself.
CURVE_SAMPLE = TokenConfig((Feature("piece", "index", levels=6), Feature("normal", "direction", 2)), unit=1.0)


def _array(tensor: Tensor, *axes: int) -> NDArray[np.float32]:
    """A tensor as an array, its `axes` padded with zeros to multiples of four."""
    array: NDArray[np.float32] = tensor.detach().numpy()
    more = [(0, -size % 4 if k in axes else 0) for k, size in enumerate(array.shape)]
    return np.ascontiguousarray(np.pad(array, more))


def _both(layer: nn.LayerNorm) -> Tensor:
    """Scale and shift of a norm, (2, E)."""
    return torch.stack([layer.weight, layer.bias])


def weights_of(net: SNet) -> Weights:
    """The network as arrays."""
    from nqr_geom.curves.compiled_snet import Weights

    trunk, head, blocks = net.trunk, net.head, [cast(CausalBlock, block) for block in net.trunk.blocks]
    if not isinstance(head, GapHead):
        raise ValueError(f"net: expected one with the head 'gap', got {net.config.head!r}")
    many: dict[str, NDArray[np.float32]] = {}
    for name in ("qkv", "out", "up", "down"):
        many[name] = _array(torch.stack([getattr(block, name).weight for block in blocks]))
        many[f"{name}_bias"] = _array(torch.stack([getattr(block, name).bias for block in blocks]))
    single = {"embed_in": trunk.embed_in, "embed_out": trunk.embed_out}
    single |= {name: getattr(head, name) for name in ("key_in", "key_out", "query", "bin_key")}
    for name, layer in single.items():
        many[name], many[f"{name}_bias"] = _array(layer.weight, 1), _array(layer.bias)
    return Weights(
        **many,
        norms=_array(torch.stack([torch.stack([_both(block.norm1), _both(block.norm2)]) for block in blocks])),
        last_norm=_array(_both(trunk.norm)),
        bias=_array(head.bias.weight),
        bias_bias=_array(head.bias.bias),
        bin_state=_array(head.bin_state.weight),
        no_bias=np.zeros(net.config.width, np.float32),
        bins=_array(head.bins.weight, 0),
        bins_bias=_array(head.bins.bias, 0),
        profile=_array(cast(Tensor, head.profile)),
    )


def placing(problem: GwnProblem, net: object, n: int) -> Callable[[Stream], tuple[Tensor, Tensor]] | None:
    """The compiled pass of a sampling network over a problem on a CPU, if it is one with gaps on polynomial pieces.

    Parameters
    ----------
    problem : GwnProblem
        Winding numbers.
    net : SNet
        Any other object gets None.
    n : int
        Samples an integral.

    Returns
    -------
    callable or None
        Stream to points (B, n, 1) and their densities (B, n).
    """
    shapes = problem.shapes
    if not isinstance(net, SNet) or not isinstance(shapes, PackedShapes) or problem.points.device.type != "cpu":
        return None
    head, config = net.head, net.config
    known = isinstance(head, GapHead) and head.gaps is CurveGaps and config.tokens == CURVE_SAMPLE
    if not known or config.width % 4 or next(net.parameters()).dtype != torch.float32:
        return None

    def place(stream: Stream) -> tuple[Tensor, Tensor]:
        from nqr_geom.curves.compiled_snet import placed

        c, k, shape, points = (t.numpy() for t in (shapes.coefficients, shapes.pieces, problem.shape, problem.points))
        numbers = stream.uniform(problem.rows[:, None, None], torch.arange(n)[:, None], torch.arange(3))
        x, pdf = placed(
            c, k, shape, points, numbers.numpy(), config.heads, len(config.profile), config.sharpness, config.floor,
            weights_of(net),
        )  # fmt: skip
        return torch.from_numpy(x)[..., None], torch.from_numpy(pdf)

    return place
