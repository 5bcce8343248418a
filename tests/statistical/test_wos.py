"""Walk on spheres: its random numbers, its error bars, its counts, and the same walks from kernel and integrator."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch
from scipy.special import i0, i0e

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import polygons, queries
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.walk import bessel_i0, uniforms, walk

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
LEVEL = 4.5  # standard errors: one false alarm in 150,000
RIM = 2 * np.pi * np.arange(400) / 400
DISC = np.stack([np.cos(RIM), np.sin(RIM)], axis=1)
INSIDE = np.array([[0.0, 0.0], [0.5, 0.0], [0.1, 0.8]])


def star(n: int = 19) -> np.ndarray:
    angle = 2 * np.pi * np.arange(n) / n
    return (0.7 + 0.25 * np.cos(7 * angle + 0.3))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_random_numbers_are_those_of_the_stream_bit_for_bit():
    rng = np.random.default_rng(0)
    for seed, row, sample in rng.integers(0, 2**40, (50, 3)).tolist():
        stream = Stream(seed, "train", "samples/3")
        expected = stream.uniform(np.array([row]), np.array([sample]), np.arange(16))
        got = uniforms(np.uint64(stream.key & (2**64 - 1)), row, sample, 16)
        np.testing.assert_array_equal(got, expected)


def test_bessel_function_is_scipys():
    x = np.concatenate([np.linspace(0, 45, 500), [1e2, 1e3, 1e8]])
    np.testing.assert_allclose([bessel_i0(v) for v in x], i0e(x), rtol=1e-14)


def test_kernel_and_integrator_walk_alike():
    """The same (seed, row, walk, step): the same answers by `solve_laplace` and by `integrate`."""
    values = np.random.default_rng(3).normal(size=19)
    points = queries(Domain.of(star()), 30, 0)
    by_kernel = ng.solve_laplace(star(), values, points, method="wos", n=16, max_steps=12, seed=5, full_output=True)
    problem = ng.problems.laplace(star(), values, points)
    by_rule = ng.integrate(problem, 16, sampler="random", rule="mc", seed=5)
    np.testing.assert_allclose(by_kernel.value, by_rule.value, atol=1e-9)
    np.testing.assert_allclose(by_kernel.stderr, by_rule.stderr, atol=1e-9)
    assert by_kernel.counts["steps"] == by_rule.counts["queries"]


def test_latin_hypercube_walks_are_the_integrators():
    values, points = np.arange(19.0), queries(Domain.of(star()), 10, 0)
    direct = ng.solve_laplace(star(), values, points, method="wos-lhs", seed=2)
    problem = ng.problems.laplace(star(), values, points)
    other = ng.integrate(problem, 32, sampler="latin-hypercube", rule="mc", seed=2)
    np.testing.assert_allclose(direct, other.value[:, 0], atol=1e-12)


def test_a_walk_does_not_depend_on_its_company():
    values, points = np.random.default_rng(1).normal(size=19), queries(Domain.of(star()), 40, 0)
    whole = ng.solve_laplace(star(), values, points, method="wos", n=64)
    outside = np.insert(points, 20, [5.0, 5.0], axis=0)
    again = ng.solve_laplace(star(), values, outside, method="wos", n=64, outside="nan")
    np.testing.assert_array_equal(again[:20], whole[:20])
    domain, stream = Domain.of(star()), Stream(0, "test", "samples/0")
    framed, rows, of = domain.to_frame(points), np.arange(40), np.zeros(40, np.int64)
    together = walk(domain.nearest, of, framed, rows, np.arange(64), stream, epsilon=1e-3, max_steps=99)
    later = walk(domain.nearest, of[7:9], framed[7:9], rows[7:9], np.arange(32, 64), stream, epsilon=1e-3, max_steps=99)
    np.testing.assert_array_equal(together.t[7:9, 32:], later.t)
    np.testing.assert_array_equal(together.edge[7:9, 32:], later.edge)


def test_error_bars_cover_what_they_say():
    """95% intervals about the deterministic answer, over queries and seeds of one star."""
    values, points = np.random.default_rng(4).uniform(-1, 1, 19), queries(Domain.of(star()), 25, 1)
    truth = ng.solve_laplace(star(), values, points, method="boundary")
    hits = []
    for seed in range(60):
        got = ng.solve_laplace(star(), values, points, method="wos", n=128, epsilon=1e-4, seed=seed, full_output=True)
        hits.append(np.abs(got.value[:, 0] - truth) <= 1.96 * got.stderr[:, 0])
    assert 0.92 < np.mean(hits) < 0.98


def test_tolerance_is_met():
    values, points = np.random.default_rng(4).uniform(-1, 1, 19), queries(Domain.of(star()), 40, 1)
    truth = ng.solve_laplace(star(), values, points, method="boundary")
    got = ng.solve_laplace(star(), values, points, method="wos", tol=0.02, full_output=True)
    assert got.plan["met"]
    assert (got.error <= 0.02).all()
    off = np.abs(got.value[:, 0] - truth)
    assert np.mean(off <= 0.02) >= 0.925  # of 95 in 100 meant
    assert off.max() < 0.04
    few = ng.solve_laplace(star(), values, points, method="wos", n=8, full_output=True)
    assert (few.n, "met" in few.plan) == (8, False)


@pytest.mark.parametrize(("epsilon", "expected"), [(1e-2, 0.09), (1e-3, 0.25), (1e-4, 0.42)])
def test_capped_walks_are_counted(epsilon, expected):
    points = np.random.default_rng(0).random((400, 2))
    got = ng.solve_laplace(
        SQUARE, np.zeros(4), points, method="wos", n=64, max_steps=12, epsilon=epsilon, full_output=True
    )
    counts = got.counts
    assert counts["walks_boundary"] + counts["walks_capped"] == 400 * 64
    assert counts["walks_escaped"] == 0
    # Measured for an absolute shell; a local one is a little narrower.
    assert 0.8 * expected < counts["walks_capped"] / (400 * 64) < expected + 0.15


def test_poisson_and_screened_on_the_disc():
    """(1 - r^2)/4 and I0(sqrt(s) r)/I0(sqrt(s)), with sources as numbers and as functions, by walks and by elements."""
    r = np.hypot(*INSIDE.T)
    for source in (1.0, lambda p: np.ones(len(p))):
        got = ng.solve_laplace(DISC, np.zeros(400), INSIDE, method="wos", n=20000, source=source, full_output=True)
        assert (np.abs(got.value[:, 0] - (1 - r**2) / 4) < LEVEL * got.stderr[:, 0] + 5e-4).all()
    for s in (1.0, 50.0):
        truth = i0(np.sqrt(s) * r) / i0(np.sqrt(s))
        got = ng.solve_laplace(DISC, np.ones(400), INSIDE, method="wos", n=20000, screening=s, full_output=True)
        assert (np.abs(got.value[:, 0] - truth) < LEVEL * got.stderr[:, 0] + 1e-3).all()
        # u = 1 solves the screened equation with source s and boundary 1.
        got = ng.solve_laplace(DISC, np.ones(400), INSIDE, method="wos", n=20000, screening=s, source=s,
                               full_output=True)  # fmt: skip
        assert (np.abs(got.value[:, 0] - 1.0) < LEVEL * got.stderr[:, 0] + 1e-3).all()
        by_elements = ng.solve_laplace(DISC, np.ones(400), INSIDE, screening=s)
        np.testing.assert_allclose(by_elements, truth, atol=2e-3)


def test_absent_effects_are_not_compiled():
    from nqr_geom.wos.walk import _compiled

    for screened in (False, True):
        cached = _compiled(screened, False)
        ng.solve_laplace(SQUARE, np.zeros(4), [[0.5, 0.5]], method="wos", n=4, screening=float(screened))
        fresh = numba.njit(cached.py_func)  # code from the cache cannot be looked into
        fresh.compile(cached.signatures[0])
        code = fresh.inspect_llvm(fresh.signatures[0])
        assert ("bessel_i0" in code) == screened


def test_the_family_is_keyed_and_calibrated():
    vertices, values = polygons(4)
    again = polygons(2)
    np.testing.assert_array_equal(again.vertices, vertices[:2])
    assert (polygons(4, split="train").values != values).all()
    radius = np.hypot(*np.moveaxis(vertices, -1, 0))
    assert 0.3 < radius.min() < radius.max() < 1.0
    problem = LaplaceProblem.family(12, points=96)
    truth = problem.reference()[:, 0]
    mse = {}
    for design in ("random", "latin-hypercube"):
        error = [
            registry.make("sampler", design).draw(problem, 32, Stream(k)).value.mean(dim=(1, 2, 3)).numpy() - truth
            for k in range(2)
        ]
        mse[design] = np.mean(np.square(error))
    assert 0.7 * 2.62e-4 < mse["random"] < 1.4 * 2.62e-4
    assert 1.5 / 1.3 < mse["random"] / mse["latin-hypercube"] < 1.5 * 1.3


def test_what_a_walk_tells():
    problem = LaplaceProblem.family(2, points=8)
    seen = registry.make("sampler", "random").draw(problem, 5, Stream(0)).seen
    for feature in problem.schema.features:
        assert seen.features[feature.name].shape == (16, 5, 1, feature.size)
    steps = seen.features["steps"][:, :, 0].reshape(16, 5, 12, -1)
    alive = steps[..., -1] == 1.0
    assert (alive.sum(dim=2) == seen.features["length"][:, :, 0, 0]).all()
    assert (steps[~alive] == 0.0).all()
    state = problem.start(5)
    first = problem.observe(state)
    assert torch.allclose(first["from_start"], first["closest"])
    assert torch.allclose(torch.linalg.vector_norm(first["closest"], dim=-1), first["distance"][..., 0])
