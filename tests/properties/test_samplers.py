"""Laws of every sampler in the registry: where points may lie, what keys them, and how evenly they fill the cube."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch
from scipy.stats import qmc

from nqr_geom import registry
from nqr_geom.integrator.samplers import BayesianDesign, FixedDesign, cells_per_axis, gauss_legendre
from nqr_geom.streams import Stream
from tests import fixtures
from tests.integrands import smooth

SAMPLERS = registry.entries("sampler")
every_sampler = pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda entry: entry.name)
DETERMINISTIC = ("grid", "gauss-legendre")
POWERS = [1, 2, 4, 8, 32, 128]


def positions(name, n, dim, rows=8, seed=0):
    """Points (rows, n, dim) of a fixed design."""
    design = registry.make("sampler", name)
    assert isinstance(design, FixedDesign)
    return design.points(torch.arange(rows), n, dim, Stream(seed)).numpy()


@every_sampler
@pytest.mark.parametrize("n", [1, 2, 5, 8, 32, 100])
def test_shape_range_and_type(sampler, n):
    for name in fixtures.problems_for(sampler):
        problem = fixtures.problem(name)
        samples = fixtures.draw(name, sampler.name, n)
        assert samples.x.shape == (problem.batch, n, problem.dim)
        assert samples.x.dtype == samples.value.dtype == torch.float64
        assert samples.value.shape == (problem.batch, n, problem.techniques, problem.channels)
        assert samples.x.min() >= 0.0
        assert samples.x.max() < 1.0
        assert samples.seen.queries >= problem.batch * n
        for field in (samples.pdf, samples.stratum, samples.volume):
            assert field is None or field.shape[:2] == (problem.batch, n)
        assert samples.pdf is None or (samples.pdf > 0.0).all()
        assert samples.design == registry.make("sampler", sampler.name).name
        assert set(problem.schema.names) <= set(samples.seen.features)  # some bring more, for rules


@every_sampler
def test_every_sampler_declares_whether_it_looks(sampler):
    assert sampler.adaptive != isinstance(registry.make("sampler", sampler.name), FixedDesign)


@every_sampler
@pytest.mark.parametrize("n", [1, 7, 33])
def test_same_points_alone_reordered_and_again(sampler, n):
    """Points belong to a row's global index: no tile, order or earlier draw changes a bit of them."""
    made = registry.make("sampler", sampler.name)
    for name in fixtures.problems_for(sampler):
        problem = fixtures.problem(name)
        whole = made.draw(problem, n, Stream(0)).x
        assert torch.equal(made.draw(problem, n, Stream(0)).x, whole)
        backwards = torch.arange(problem.batch - 1, -1, -1)
        assert torch.equal(made.draw(problem.take(backwards), n, Stream(0)).x, whole[backwards])
        for part in (slice(0, 2), slice(2, None), slice(problem.batch - 1, problem.batch)):
            assert torch.equal(made.draw(problem.take(part), n, Stream(0)).x, whole[part]), name


@every_sampler
def test_seeds_splits_streams_and_rows_differ(sampler):
    made = registry.make("sampler", sampler.name)
    name = fixtures.problems_for(sampler)[0]
    problem = fixtures.problem(name)
    streams = [Stream(0), Stream(1), Stream(0, "train"), Stream(0, name="other")]
    drawn = [made.draw(problem, 8, stream).x for stream in streams]
    random = sampler.name not in DETERMINISTIC
    for one, two in combinations(drawn, 2):
        assert torch.equal(one, two) != random
    if random:
        assert len({tuple(row.ravel().tolist()) for row in drawn[0]}) == problem.batch


@every_sampler
def test_a_one_dimensional_sampler_refuses_a_square(sampler):
    made = registry.make("sampler", sampler.name)
    if sampler.dims == "1":
        with pytest.raises(ValueError, match=f"sampler: '{made.name}'"):
            made.draw(smooth(2), 4, Stream(0))
    elif not sampler.needs:
        assert made.draw(smooth(2), 4, Stream(0)).x.shape == (3, 4, 2)


@every_sampler
def test_a_sampler_for_one_problem_refuses_the_others(sampler):
    if sampler.needs:
        with pytest.raises(ValueError, match="sampler: "):
            registry.make("sampler", sampler.name).draw(smooth(), 4, Stream(0))


def test_no_sum_rounds_up_to_one():
    """Random numbers next to 1 in the last cell: (n - 1 + u) / n would round to 1, a piece index out of range."""

    class Highest(Stream):
        def uniform(self, *counters):
            shape = torch.broadcast_shapes(*(counter.shape for counter in counters))
            return torch.full(shape, 1.0 - 2.0**-53, dtype=torch.float64)

    for sampler in SAMPLERS:
        if not sampler.needs:
            x = registry.make("sampler", sampler.name).draw(smooth(), 32, Highest(0)).x
            assert x.max() < 1.0
            assert (x * 6.0).floor().max() <= 5.0


# --- how the points fill the cube ---------------------------------------------------------------------


def cells_hit_once(x, axes):
    """Whether each of the prod(axes) boxes holds the same number of the points (B, n, dim), in every row."""
    index = np.floor(x * np.array(axes)).astype(int)
    flat = np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), axes)
    counts = np.stack([np.bincount(row, minlength=np.prod(axes)) for row in flat])
    return bool((counts == x.shape[1] / np.prod(axes)).all())


@pytest.mark.parametrize("n", [1, 2, 7, 12, 32, 90])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_stratified_and_grid_put_one_point_in_each_cell(n, dim):
    axes = cells_per_axis(n, dim)
    assert np.prod(axes) == n
    for name in ("stratified", "grid"):
        x = positions(name, n, dim)
        assert cells_hit_once(x, axes)
        corner = np.stack(np.unravel_index(np.arange(n), axes), axis=-1)
        np.testing.assert_array_equal(np.floor(x * np.array(axes)), np.broadcast_to(corner, x.shape))
    np.testing.assert_allclose(positions("grid", n, dim) * np.array(axes) % 1.0, 0.5, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 7, 32, 100])
@pytest.mark.parametrize("dim", [1, 3])
def test_latin_hypercube_hits_every_stratum_of_every_axis_once(n, dim):
    x = positions("latin-hypercube", n, dim)
    assert all(cells_hit_once(x[..., d : d + 1], (n,)) for d in range(dim))


@pytest.mark.parametrize("n", POWERS)
def test_every_elementary_interval_of_a_pair_of_axes_holds_its_share(n):
    """(0,2) points: all boxes 2^-a by 2^-b of area 1/n, for Sobol' in its first pair, for PMJ in every pair."""
    level = n.bit_length() - 1
    for name, pairs in (("sobol", [(0, 1)]), ("pmj", [(0, 1), (2, 3), (4, 5)])):
        x = positions(name, n, 6)
        for pair in pairs:
            for a in range(level + 1):
                assert cells_hit_once(x[..., pair], (2**a, 2 ** (level - a))), (name, pair, a)
        assert all(cells_hit_once(x[..., d : d + 1], (n,)) for d in range(6))


def test_pmj_is_progressive():
    """The first 2^k of the first pair are stratified too; the other pairs are when n is a power of two."""
    x = positions("pmj", 32, 4)
    for pair in ((0, 1), (2, 3)):
        for k in range(5):
            for a in range(k + 1):
                assert cells_hit_once(x[:, : 2**k, pair], (2**a, 2 ** (k - a)))


def test_pmj_shuffles_its_pairs_against_each_other():
    """Unshuffled, the halves of axes 0 and 2 follow the same bit of the index: two of four quadrants stay empty."""
    x = positions("pmj", 16, 4, rows=100)[..., [0, 2]]
    quadrants = (np.floor(2 * x) @ [2, 1]).astype(int)
    occupied = np.array([len(set(row)) for row in quadrants.tolist()])
    assert (occupied == 4).mean() > 0.9


def test_scrambled_sobol_is_scipys_sequence_scrambled():
    """Nested scrambling keeps, digit by digit, which points share a box; scipy's own net is the witness."""
    ours = positions("sobol", 64, 5, rows=2)
    theirs = qmc.Sobol(5, scramble=False).random_base2(6)
    for level in range(1, 7):
        boxes = np.floor(theirs * 2**level)
        for row in ours:
            mine = np.floor(row * 2**level)
            for d in range(5):
                np.testing.assert_array_equal(
                    boxes[:, None, d] == boxes[None, :, d], mine[:, None, d] == mine[None, :, d]
                )


@pytest.mark.parametrize(
    ("name", "bound"), [("stratified", 0.5), ("latin-hypercube", 0.6), ("sobol", 0.12), ("pmj", 0.12)]
)
def test_discrepancy_by_an_independent_measure(name, bound):
    """Centred L2 discrepancy of 64 points in the square by scipy, against that of random points."""
    plain = np.mean([qmc.discrepancy(row) for row in positions("random", 64, 2, rows=32)])
    ours = np.mean([qmc.discrepancy(row) for row in positions(name, 64, 2, rows=32)])
    assert ours < bound * plain


@pytest.mark.parametrize("n", [1, 2, 5, 32, 64])
def test_gauss_legendre_nodes_are_numpys(n):
    nodes, weights = np.polynomial.legendre.leggauss(n)
    np.testing.assert_allclose(gauss_legendre(n)[0], (nodes + 1.0) / 2.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(gauss_legendre(n)[1], weights / 2.0, rtol=0, atol=1e-14)


def test_many_gauss_legendre_nodes_need_little_memory():
    nodes, weights = gauss_legendre(5000)
    assert weights.sum() == pytest.approx(1.0, abs=1e-13)
    assert weights @ nodes**2 == pytest.approx(1.0 / 3.0, abs=1e-13)


def test_bayesian_design_takes_the_most_uncertain_point():
    """Each point maximises the Gaussian process's posterior variance, worked out from scratch, on the same grid."""
    design = BayesianDesign(length=0.1, candidates=64)
    x = design.points(torch.arange(3), 8, 1, Stream(5))[..., 0].numpy()
    for row in x:
        grid = (row[0] * 64 % 1.0 + np.arange(64)) / 64
        kernel = np.exp(-0.5 * ((grid[:, None] - row) / 0.1) ** 2)
        gram = np.exp(-0.5 * ((row[:, None] - row) / 0.1) ** 2)
        for k in range(1, 8):
            variance = 1.0 - np.einsum("ik,ki->i", kernel[:, :k], np.linalg.solve(gram[:k, :k], kernel[:, :k].T))
            chosen = np.abs(grid - row[k]).argmin()
            assert np.abs(grid - row[k]).min() < 1e-12
            assert variance[chosen] >= variance.max() - 1e-7


def test_bayesian_design_goes_on_where_nothing_is_uncertain():
    x = positions("bayesian-quadrature", 400, 1, rows=2)[..., 0]
    for row in x:
        gaps = np.diff(np.sort(row))
        assert gaps.min() > 0.0
        assert gaps.max() < 0.02
