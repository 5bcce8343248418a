"""The compiled pass over walks and `walk-fit` gives what the two give in turn; neither hangs on rounding."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from numba import njit
from numpy.testing import assert_array_equal

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.samplers import LatinHypercube
from nqr_geom.keyed import mixed, unsigned
from nqr_geom.streams import Stream
from nqr_geom.wos import fused
from nqr_geom.wos.average import _sort
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import polygons, queries
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.spread import WalkSpread
from nqr_geom.wos.structured import WalkFit

SAMPLERS = ("random", "latin-hypercube", "walk-spread")


class Plain(LaplaceProblem):
    """The same problem without its compiled pass."""

    def compiled(self, sampler: object, rule: object, n: int) -> None:
        return None


def plain(problem: LaplaceProblem) -> Plain:
    return Plain(**{field.name: getattr(problem, field.name) for field in fields(problem)})


def with_a_hole() -> LaplaceProblem:
    from shapely import Polygon

    outline, hole = [[0, 0], [4, 0], [4, 3], [0, 3]], [[1, 1], [2, 1], [2, 2]]
    points = [[0.5, 0.4], [3.0, 1.5], [2.1, 1.2], [0.9, 2.5], [2.0001, 1.5]]
    return LaplaceProblem.of(Polygon(outline, [hole]), [0.0, 1.0, 2.0, -1.0, 0.5, 3.0, 0.25], points)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("n", [1, 2, 7, 32, 63, 100])
def test_the_compiled_pass_is_the_pair(sampler: str, n: int) -> None:
    for problem in (LaplaceProblem.family(4, points=24), with_a_hole()):
        pair = registry.make("sampler", sampler), WalkFit()
        assert (problem.compiled(*pair, n) is None) == (sampler == "walk-spread" and n > 64)
        one, two = run(problem, *pair, n, seed=3), run(plain(problem), *pair, n, seed=3)
        np.testing.assert_allclose(one.value, two.value, rtol=0.0, atol=1e-11)
        assert_array_equal(one.fallback, two.fallback)
        assert one.counts["samples"] == two.counts["samples"] == n * problem.batch
        assert one.counts["queries"] <= two.counts["queries"]  # within the rim nothing is left to see
        assert one.counts["walks_boundary"] + one.counts["walks_capped"] == n * problem.batch


@pytest.mark.parametrize("sampler", ["random", "latin-hypercube"])
@pytest.mark.parametrize("n", [1, 2, 33, 100])
def test_means_of_ends_are_those_of_the_pair(sampler: str, n: int) -> None:
    for problem in (LaplaceProblem.family(4, points=24), with_a_hole()):
        pair = registry.make("sampler", sampler), registry.make("rule", "mc")
        one, two = run(problem, *pair, n, seed=3), run(plain(problem), *pair, n, seed=3)
        np.testing.assert_allclose(one.value, two.value, rtol=0.0, atol=1e-13)
        assert one.counts == two.counts
        assert (one.stderr is None) == (two.stderr is None)
        for name in ("m2", "m3", "m4"):
            mine, theirs = getattr(one.statistics, name), getattr(two.statistics, name)
            assert (mine is None) == (theirs is None)
            if mine is not None:
                np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_rows_in_doubt_are_means_of_whole_walks(sampler: str) -> None:
    problem = LaplaceProblem.family(2, points=12)
    pair = registry.make("sampler", sampler), WalkFit(doubt=-1.0)  # in doubt of everything
    one, two = run(problem, *pair, 8), run(plain(problem), *pair, 8)
    assert one.fallback.all()
    np.testing.assert_allclose(one.value, two.value, rtol=0.0, atol=1e-14)


def test_other_pairs_go_the_long_way() -> None:
    problem, rule = LaplaceProblem.family(1, points=2), WalkFit()
    assert problem.compiled(WalkSpread(), registry.make("rule", "mc"), 8) is None
    assert problem.compiled(registry.make("sampler", "sobol"), rule, 8) is None
    assert problem.compiled(WalkSpread(rim=0.1), rule, 8) is None


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_function_is_asked_where_walks_saw_the_boundary(sampler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some queries at a time, on domains of which some have linear values."""
    monkeypatch.setattr(fused, "_ASKED", 1700)  # room for four queries
    family, outline = (
        LaplaceProblem.family(3, points=5),
        [[10.0, 0.0], [14.0, 0.0], [14.0, 3.0], [12.0, 1.0], [10.0, 3.0]],
    )
    own = Domain.of(outline)
    bent = own.boundary(lambda p: np.cos(p[:, 0]) * p[:, 1])
    inside = own.to_frame([[10.5, 0.5], [13.0, 1.0], [13.8, 2.0]])
    framed = [family.points[family.groups == k].numpy() for k in range(3)]
    problem = LaplaceProblem.joined([*family.boundaries, bent], [*framed, inside], 12, 1e-3)
    problem = problem.take(torch.tensor([0, 16, 1, 2, 6, 17, 7, 15, 12]))
    pair = registry.make("sampler", sampler), WalkFit()
    one, two = run(problem, *pair, 32, seed=3), run(plain(problem), *pair, 32, seed=3)
    np.testing.assert_allclose(one.value, two.value, rtol=0.0, atol=1e-11)
    assert_array_equal(one.fallback, two.fallback)
    wrong = replace(problem, boundaries=(*family.boundaries, own.boundary(lambda p: p)))
    with pytest.raises(ValueError, match="boundary: expected a callable that gives shape"):
        run(wrong, *pair, 8)


@njit
def latin(key: np.uint64, order: np.uint64, row: int, n: int, most: int) -> np.ndarray:
    x = np.empty((n, most))
    points(mixed(key, row), mixed(order, row), n, most, np.empty(n, np.int64), x)
    return x


points = fused._latin


@pytest.mark.parametrize("n", [1, 2, 32, 64, 65, 200])
def test_latin_hypercubes_are_those_of_the_sampler(n: int) -> None:
    stream = Stream(4, "validation")
    x = LatinHypercube().points(torch.tensor([0, 5, 10**12]), n, 12, stream).numpy()
    keys = unsigned(stream.key), unsigned(stream.child("order").key)
    for k, row in enumerate((0, 5, 10**12)):
        assert_array_equal(latin(*keys, row, n, 12), x[k])


@pytest.mark.parametrize("n", [2, 5, 300, 5000])
@pytest.mark.parametrize("spread", [1.0, 1e-3, 0.0])
def test_samples_are_sorted_wherever_they_lie(n: int, spread: float) -> None:
    """Evenly, all in one small place (where buckets do not help), or all at one."""
    arc = 0.37 + spread * 0.5 * np.random.default_rng(n).random(n)
    arc[0] = 1.0
    keys = (arc * 2.0**40).astype(np.int64) << 22 | np.arange(n)
    expected = np.sort(keys)
    _sort(keys, np.empty_like(keys), np.empty(2 * n + 2, np.int64), n)
    assert_array_equal(keys, expected)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_no_answer_hangs_on_rounding(sampler: str) -> None:
    """Panels as long as others, corners met by way of both edges: a hair more or less decides nothing."""
    rule, rng = WalkFit(), np.random.default_rng(0)
    for seed in (2, 3):
        vertices, values = (part[0] for part in polygons(1, seed=seed))
        inside = queries(Domain.of(vertices), 400, 0, seed)
        moved = vertices + 1e-15 * rng.standard_normal(vertices.shape)
        told = [LaplaceProblem.of(corners, values, inside) for corners in (vertices, moved)]
        answers = [run(problem, registry.make("sampler", sampler), rule, 32).value for problem in told]
        assert np.abs(answers[0] - answers[1]).max() < 1e-10


def test_values_with_a_constant_added() -> None:
    problem = LaplaceProblem.family(1, points=50)
    higher = replace(problem, boundaries=tuple(b.less(-1.0) for b in problem.boundaries))
    one, two = (run(p, LatinHypercube(), WalkFit(), 32).value for p in (problem, higher))
    np.testing.assert_allclose(one + 1.0, two, rtol=0.0, atol=1e-9)
