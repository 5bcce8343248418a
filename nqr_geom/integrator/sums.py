"""Sums and small linear systems whose bits depend on the row alone.

An answer must not change with the tile a row happens to lie in. Torch and the libraries below it choose the order of
a sum by the shape of the whole batch, by the thread that gets it and by the address of a matrix; here the order is
fixed: samples innermost, in blocks too short to be shared out, and matrices that all start on a cache line.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

__all__ = ["cholesky_weights", "least_norm", "power_sums", "row_mean", "row_sum"]

_BLOCK = 2**14  # below the 2^15 numbers from which torch splits a single sum over threads
_LINE = 8  # float64 numbers in a cache line


def row_sum(terms: Tensor) -> Tensor:
    """Sum over axis 1, (B, N, ...) -> (B, ...).

    Examples
    --------
    >>> row_sum(torch.ones(2, 3, 1))
    tensor([[3.],
            [3.]])
    """
    inner = terms.movedim(1, -1).contiguous()
    first, *others = inner.split(_BLOCK, dim=-1)
    total = first.sum(dim=-1)
    for block in others:
        total = total + block.sum(dim=-1)
    return total


def row_mean(terms: Tensor) -> Tensor:
    """Mean over axis 1, (B, N, ...) -> (B, ...)."""
    return row_sum(terms) / terms.shape[1]


def power_sums(off: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sums of the second to fourth powers of deviations over axis 1, (B, N, ...) -> (B, ...) each."""
    square = off.square()
    return row_sum(square), row_sum(square * off), row_sum(square.square())


def _aligned(matrix: Tensor, diagonal: float) -> Tensor:
    """Square matrices (B, M, M) grown to a multiple of a cache line by a block `diagonal` times the identity."""
    size = matrix.shape[-1]
    extra = -size % _LINE
    grown = pad(matrix, (0, extra, 0, extra))
    grown.diagonal(dim1=1, dim2=2)[:, size:] = diagonal
    return grown


def cholesky_weights(kernel: Tensor, mean: Tensor) -> Tensor:
    """Solve K w = z for positive definite K (B, N, N) and z (B, N)."""
    size = mean.shape[1]
    factor = torch.linalg.cholesky(_aligned(kernel, 1.0))
    padded = pad(mean, (0, factor.shape[-1] - size))
    return torch.cholesky_solve(padded[..., None], factor)[:, :size, 0]


def least_norm(gram: Tensor, moment: Tensor, cutoff: float) -> Tensor:
    """Least-norm solution of G c = m for symmetric G (B, M, M) >= 0 and m (B, M).

    Eigenvalues up to `cutoff` count as zero. It is absolute: where all of G is rounding error nothing can be solved.
    """
    size = moment.shape[1]
    values, vectors = torch.linalg.eigh(_aligned(gram, 0.0))
    kept = values > cutoff
    vectors = vectors[:, :size]
    along = row_sum(vectors * moment[..., None])
    along = torch.where(kept, along / torch.where(kept, values, 1.0), 0.0)
    return row_sum((vectors * along[:, None]).transpose(1, 2))
