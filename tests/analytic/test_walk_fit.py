"""The rule that rebuilds the boundary walks have seen: harmonic measures, rebuilt polygons, and what comes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.hard_cases.laplace import TABLE
from nqr_geom.integrator.problem import WalkProblem
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Domain
from nqr_geom.wos.families import queries
from nqr_geom.wos.harmonic import _minus_half_logs, harmonic_measure
from nqr_geom.wos.outlines import outlines
from nqr_geom.wos.panels import panels_of
from nqr_geom.wos.problems import LaplaceProblem
from nqr_geom.wos.rebuild import parts_of, room
from nqr_geom.wos.structured import WalkFit
from nqr_geom.wos.tokens import boundary_values

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])


def panels(polygon, each):
    along = np.arange(each)[:, None] / each
    points = np.concatenate([a + along * (b - a) for a, b in zip(polygon, np.roll(polygon, -1, 0), strict=True)])
    return np.hstack([points, np.roll(points, -1, 0)])


def measure(ends, at, scale=0.2):
    m = len(ends)
    result = np.empty(m)
    lost = harmonic_measure(ends, *at, scale, np.empty((m, m)), np.empty((8, m)), result)
    return result, lost


def ring(radius, n=96):
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_harmonic_measure_of_the_sides_of_a_square():
    got, lost = measure(panels(SQUARE, 8), (0.5, 0.5))
    np.testing.assert_allclose(got.reshape(4, 8).sum(axis=1), 0.25, atol=2e-6)
    assert lost < 1e-9
    # u = x and u = x^2 - y^2 are harmonic: their means under the measure are their values at the point.
    errors = []
    for each in (8, 16, 32):
        ends = panels(SQUARE, each)
        x, y = (0.5 * (ends[:, :2] + ends[:, 2:])).T
        weight, _ = measure(ends, (0.2, 0.35))
        errors.append([abs(weight @ x - 0.2), abs(weight @ (x**2 - y**2) - (0.2**2 - 0.35**2))])
    assert np.max(errors[-1]) < 2e-4
    assert (np.array(errors[0]) > 8 * np.array(errors[-1])).all()  # second order, 16 times


def test_panels_that_lie_on_others_change_nothing():
    """Parts that are guessed may coincide: a side given twice, and one more that lies inside another."""
    once = panels(SQUARE, 8)
    inner = np.array([[0.02, 0.0, 0.10, 0.0]])
    got, lost = measure(np.concatenate([once, once[8:16], inner]), (0.4, 0.3))
    shares = got[:32].reshape(4, 8).sum(axis=1)
    shares[1] += got[32:40].sum()
    shares[0] += got[40]
    np.testing.assert_allclose(shares, measure(once, (0.4, 0.3))[0].reshape(4, 8).sum(axis=1), atol=3e-3)
    assert lost < 0.05


def test_logarithms_in_vector_registers_are_those_of_the_library():
    x = np.concatenate(
        [np.exp(np.random.default_rng(0).uniform(-60.0, 60.0, 5000)), 1.0 + np.linspace(-1e-3, 1e-3, 99)]
    )
    found = x.copy()
    _minus_half_logs(found, np.empty_like(x))
    np.testing.assert_allclose(found, -0.5 * np.log(x), rtol=0.0, atol=1e-13)


def test_harmonic_measure_of_a_hole_is_a_logarithm():
    ends = np.concatenate([panels(ring(2.0), 2), panels(ring(1.0)[::-1], 2)])
    got, _ = measure(ends, (1.5, 0.0), 0.2)
    assert abs(got[192:].sum() - np.log(2 / 1.5) / np.log(2.0)) < 7e-4


@pytest.mark.parametrize("turn", [1, -1])
def test_any_set_of_panels_has_a_measure(turn):
    """Crossing squares, in either direction, and an open set: positive, of mass one."""
    crossing = np.concatenate([panels(SQUARE[::turn], 6), panels(0.7 * SQUARE + 0.45, 6)])
    for ends in (crossing, crossing[:11]):
        got, lost = measure(ends, (0.6, 0.6))
        assert got.min() >= 0.0
        assert abs(got.sum() - 1.0) < 1e-12
        assert lost < 0.2


def seen_of(polygon, values, spots):
    """Samples of every edge of a polygon at `spots`, as the rule collects them."""
    domain = Domain.of(polygon)
    edge = np.repeat(np.arange(len(domain)), len(spots))
    t = np.tile(spots, len(domain))
    normal = (domain.end - domain.start)[edge][:, ::-1] * [1.0, -1.0]
    arc = domain.arc[edge] + t * domain.lengths[edge]
    point = domain.at(edge, t)
    return domain, np.column_stack([arc, point, domain.boundary(values).at(edge, t), normal])


def rebuilt(seen, loops, fade=0.07):
    k = len(seen)
    parts = np.empty((room(k), 7))
    made = parts_of(seen, np.asarray(loops), fade, np.empty(k), np.empty(k), np.empty(k, np.bool_), parts)
    return parts[:made]


def test_three_samples_an_edge_give_the_polygon_and_its_linear_values():
    vertices, values = (a[0] for a in ng.datasets.polygons(1, seed=3))
    domain, seen = seen_of(vertices, values, [0.3, 0.5, 0.6])
    parts = rebuilt(seen, [domain.arc[-1] + domain.lengths[-1]])
    assert not parts[:, 6].any()
    ends = np.concatenate([parts[:, :3], parts[:, 3:6]])
    expected = np.column_stack([domain.start, values])
    apart = np.abs(ends[None] - expected[:, None]).max(axis=2).min(axis=1)
    assert apart.max() < 1e-8


def test_hidden_parts_bulge_outwards_and_fade_to_the_mean():
    domain, seen = seen_of(SQUARE, [1.0, 2.0, 2.0, 1.0], [0.4, 0.6])
    hidden = rebuilt(seen[:4], [domain.arc[-1] + domain.lengths[-1]], fade=0.05)
    guess = hidden[hidden[:, 6] == 1.0]
    corner, guess = guess[:2], guess[2:]
    assert abs(np.hypot(*(corner[:, 3:5] - corner[:, :2]).T).sum() - (seen[2, 0] - seen[1, 0])) < 1e-9  # its value
    length = np.hypot(*(guess[:, 3:5] - guess[:, :2]).T).sum()
    whole = domain.lengths.sum()
    assert abs(length - (whole - (seen[3, 0] - seen[0, 0]))) < 0.03 * whole
    middle = guess[len(guess) // 2]
    assert 1.2 < middle[2] < 2.0
    assert middle[0] < 0.0  # on the far side of the two edges that were seen


def test_pockets_stay_behind_their_chords():
    """A deep channel of which only the mouth was seen: its guess does not spread sideways over others."""
    comb = np.array([[-1, -1], [1, -1], [1, 0], [0.02, 0], [0.02, 0.9], [-0.02, 0.9], [-0.02, 0], [-1, 0.0]])
    domain, seen = seen_of(comb, np.arange(8.0), [0.0, 0.3, 0.7])
    seen = np.delete(seen, [10, 11, 12, 13, 14, 15, 16, 17], axis=0)  # what lies in the channel
    corner = domain.start[[3, 6]]
    seen[:, 1:3] -= corner.mean(axis=0) - [0.0, 0.3]  # the query below the mouth
    parts = rebuilt(seen, [domain.arc[-1] + domain.lengths[-1]])
    beyond = np.concatenate([parts[:, :2], parts[:, 3:5]])
    beyond = beyond[beyond[:, 1] > 0.3 + 1e-9]
    assert len(beyond)
    assert np.abs(beyond[:, 0]).max() <= 0.5 * (corner[0] - corner[1])[0] + 1e-9


def test_panels_are_as_long_as_they_are_far():
    parts = np.array([[-1.0, -1e-3, 0.0, 1.0, -1e-3, 2.0, 0.0]])
    made = np.empty((200, 6))
    count = panels_of(parts, 1, 0.0, 0.0, 1e-6, 0.5, made)
    length = made[:count, 2] - made[:count, 0]
    away = np.hypot(0.5 * (made[:count, 0] + made[:count, 2]), 1e-3)
    assert (length < 0.6 * away + 1e-12).all()
    assert abs(length.sum() - 2.0) < 1e-12
    assert abs((length * made[:count, 4]).sum() / 2.0 - 1.0) < 1e-12
    assert panels_of(parts, 1, 0.0, 0.0, 1e-6, 0.01, made) == -1


def test_compiled_walks_are_those_that_go_step_by_step():
    problem = LaplaceProblem.family(3, points=8)
    x = registry.make("sampler", "random").points(problem.rows, 6, problem.dim, Stream(1))
    one, two = problem.evaluate(x), WalkProblem.evaluate(problem, x)
    assert (one.queries, one.work) == (two.queries, two.work)
    assert one.work["walks_capped"] + one.work["walks_boundary"] == problem.batch * 6
    torch.testing.assert_close(one.value, two.value, rtol=0.0, atol=1e-12)
    assert set(one.features) == set(two.features)
    for name, tensor in one.features.items():
        torch.testing.assert_close(tensor, two.features[name], rtol=0.0, atol=1e-9)


def test_fifteen_times_monte_carlo_on_the_same_walks():
    problem = LaplaceProblem.family(12, points=48, seed=5)
    truth = problem.reference()[:, 0]
    samples = registry.make("sampler", "random").draw(problem, 32, Stream(0))
    combined = WalkFit().combine(samples)
    plain = np.mean((samples.value.mean(dim=(1, 2, 3)).numpy() - truth) ** 2)
    error = (combined.estimate(samples)[:, 0].numpy() - truth) ** 2
    assert plain > 13.0 * error.mean()
    assert not combined.fallback.any()
    many = registry.make("sampler", "random").draw(problem, 512, Stream(0))
    assert ((WalkFit().combine(many).estimate(many)[:, 0].numpy() - truth) ** 2).mean() < error.mean() / 8.0


@pytest.mark.parametrize("name", ["letter", "comb", "coast"])
def test_better_than_latin_hypercube_far_from_the_family(name):
    """Harmonic values that oscillate five times over the box: exp(k y) cos(k x), scaled."""
    vertices = outlines()[name].vertices
    assert len(vertices) == {"letter": 107, "comb": 96, "coast": 286}[name]
    k = 15.0

    def wave(p):
        return np.exp(k * (p[:, 1] - 1.0)) * np.cos(k * p[:, 0]) + np.exp(-k * (p[:, 1] + 1.0)) * np.sin(k * p[:, 0])

    points = queries(Domain.of(vertices), 150, 2)
    settings = {"seed": 4, "full_output": True}
    plain = ng.solve_laplace(vertices, wave, points, method="wos-lhs", **settings)
    fit = ng.solve_laplace(vertices, wave, points, method="structured", **settings)
    mse = [np.mean((got.value[:, 0] - wave(points)) ** 2) for got in (plain, fit)]
    assert mse[1] < 0.5 * mse[0]
    assert fit.counts["samples"] == plain.counts["samples"]


@pytest.mark.parametrize(
    "name", ["annulus", "annulus, hole turned", "re-entrant corner", "argument of a point outside", "channel"]
)
def test_better_than_latin_hypercube_on_hard_cases(name):
    """Holes are closed behind what was seen of them, channels and corners keep their shape."""
    polygon, boundary, points, expected = next(row[1:5] for row in TABLE if row.name == name)
    truth = boundary(np.asarray(points)) if expected is None else np.broadcast_to(expected, len(points))
    mse = {}
    for method in ("wos-lhs", "structured"):
        found = [ng.solve_laplace(polygon, boundary, points, method=method, seed=k) - truth for k in range(12)]
        mse[method] = np.mean(np.square(found))
    assert mse["structured"] < 0.25 * mse["wos-lhs"]


def test_boundary_values_of_several_kinds_are_answered_as_one_by_one():
    batch = three_kinds()
    together = WalkFit().combine(batch)
    for channel in (0, 2):
        features = {
            **batch.seen.features,
            "known": batch.seen.features["known"].unflatten(-1, (3, -1))[..., channel, :],
        }
        seen = replace(batch.seen, value=batch.value[..., channel : channel + 1], features=features)
        alone = WalkFit().combine(replace(batch, seen=seen))
        assert torch.equal(together.offset[:, channel], alone.offset[:, 0])
        assert torch.equal(together.doubt, alone.doubt)


def three_kinds():
    """Samples with three kinds of values: the boundary's own, places and squares of them."""
    samples = registry.make("sampler", "walk-spread").draw(LaplaceProblem.family(2, points=6), 32, Stream(0))
    known = boundary_values(samples)  # (B, N, 1, 1, D)
    three = torch.cat([known, known**2, known.abs().sqrt()], dim=3)
    value = torch.cat([samples.value, samples.value**2, samples.value.abs().sqrt()], dim=3)
    return replace(samples, seen=replace(samples.seen, value=value,
                                         features={**samples.seen.features, "known": three.flatten(3)}))  # fmt: skip


def test_one_closest_point_is_not_enough_and_says_so():
    problem = ng.problems.laplace(SQUARE, [0.0, 1.0, 1.0, 0.0], [[0.5, 1e-9]], max_steps=1)
    samples = registry.make("sampler", "random").draw(problem, 1, Stream(0))
    combined = WalkFit().combine(samples)
    assert combined.fallback.tolist() == [True]
    assert combined.estimate(samples)[0, 0] == samples.value[0, 0, 0, 0]


def test_sorted_walks_beat_latin_hypercube_ones():
    problem = LaplaceProblem.family(10, points=40, seed=6)
    truth = problem.reference()[:, 0]
    mse = {}
    for design in ("random", "latin-hypercube", "array-rqmc"):
        found = [
            registry.make("sampler", design).draw(problem, 32, Stream(k)).value.mean(dim=(1, 2, 3)).numpy() - truth
            for k in range(3)
        ]
        mse[design] = np.mean(np.square(found))
    assert mse["array-rqmc"] < 0.9 * mse["latin-hypercube"] < 0.8 * mse["random"]
    short = ng.problems.laplace(SQUARE, [0.0, 1.0, -1.0, 0.5], [[0.3, 0.4]], max_steps=40, epsilon=1e-4)
    runs = ng.integrate(short, 8, sampler="array-rqmc", rule="mc", replicates=200)
    assert abs(runs.value[0, 0] - short.reference()[0, 0]) < 4.5 * runs.stderr[0, 0] + 1e-4
