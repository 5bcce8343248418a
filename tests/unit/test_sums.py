"""Sums and small systems: right, and with bits that depend on the row alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nqr_geom.integrator.sums import cholesky_weights, least_norm, row_mean, row_sum


def random(*shape, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).normal(size=shape))


@pytest.mark.parametrize("n", [1, 7, 100, 2**14, 2**14 + 1, 50_000])
def test_sums(n):
    terms = random(2, n, 3)
    np.testing.assert_allclose(row_sum(terms), terms.numpy().sum(axis=1), atol=1e-11 * n**0.5)
    torch.testing.assert_close(row_mean(terms), row_sum(terms) / n, rtol=0, atol=0)


@pytest.mark.parametrize("n", [5, 100, 50_000])
def test_neither_layout_nor_batch_changes_a_bit(n):
    """A tensor stored sample by sample is summed down its columns, in another order, if nobody minds."""
    terms = random(13, n, 1)
    expected = row_sum(terms)
    assert torch.equal(row_sum(terms.transpose(0, 1).contiguous().transpose(0, 1)), expected)
    assert torch.equal(row_sum(terms.expand(13, n, 3))[:, 1:2], expected)
    for row in range(13):
        assert torch.equal(row_sum(terms[row : row + 1]), expected[row : row + 1])


@pytest.mark.parametrize("n", [1, 5, 8, 33])
def test_cholesky_weights_solve_their_system_row_by_row(n):
    root, mean = random(9, n, n), random(9, n, seed=1)
    kernel = root @ root.mT + n * torch.eye(n)
    got = cholesky_weights(kernel, mean)
    np.testing.assert_allclose(got, np.linalg.solve(kernel.numpy(), mean.numpy()[..., None])[..., 0], rtol=1e-9)
    for row in range(9):
        assert torch.equal(cholesky_weights(kernel[row : row + 1].clone(), mean[row : row + 1]), got[row : row + 1])


@pytest.mark.parametrize(("size", "rank"), [(1, 1), (5, 5), (6, 3), (9, 2), (4, 0)])
def test_least_norm_is_the_pseudo_inverse(size, rank):
    root = random(7, size, rank)
    gram, moment = root @ root.mT, random(7, size, seed=1)
    got = least_norm(gram, moment, 1e-10)
    expected = np.linalg.pinv(gram.numpy(), rcond=1e-9, hermitian=True) @ moment.numpy()[..., None]
    np.testing.assert_allclose(got, expected[..., 0], rtol=1e-7, atol=1e-9)
    for row in range(7):
        assert torch.equal(least_norm(gram[row : row + 1].clone(), moment[row : row + 1], 1e-10), got[row : row + 1])
