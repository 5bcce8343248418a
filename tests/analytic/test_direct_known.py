"""What lamps would send if nothing hid them, and the samples that are shared out by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom import registry, render
from nqr_geom.integrator.estimate import run
from nqr_geom.render.direct_known import known as known_radiance
from nqr_geom.render.direct_known import spans
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.direct_sampler import LampSpread
from nqr_geom.streams import Stream
from tests.scenes import looking_down, open_floor, two_spheres

LAMPS = [render.SphereLight([0.3, 0.2, 1.0], 0.3, [4.0, 2.0, 1.0]), render.SphereLight([-0.6, 0.0, 0.5], 0.1, 20.0)]
MATERIALS = [
    render.Diffuse(0.6),
    render.Conductor("gold", 0.3),
    render.Conductor("gold", 0.02),
    render.Plastic(0.5, 0.1),
]


@pytest.mark.parametrize("material", MATERIALS, ids=["diffuse", "gold", "sharp gold", "plastic"])
def test_known_light_is_what_each_lamp_alone_gives_where_nothing_hides_it(material: render.Material) -> None:
    problem = DirectProblem.of(open_floor(material=material, lights=LAMPS))
    known = known_radiance(problem, 16)
    for j, lamp in enumerate(LAMPS):
        alone = DirectProblem.of(open_floor(material=material, lights=[lamp]))
        truth = run(alone, registry.make("sampler", "pmj"), registry.make("rule", "balance-heuristic"), 512,
                    replicates=16)  # fmt: skip
        assert truth.stderr is not None
        on = problem.surfaces["kind"] >= 0  # the other lamp stands before some pixels
        assert on.sum() > 8
        off = np.abs(known[:, j].numpy() - truth.value)[on]
        truth = replace(truth, value=truth.value[on], stderr=truth.stderr[on])
        assert truth.stderr is not None
        assert (off <= 6.0 * truth.stderr + 0.01 * truth.value.max()).all()
        assert off.mean() < 0.01 * truth.value.mean()
    np.testing.assert_allclose(
        known.sum(dim=1).numpy(),
        run(problem, LampSpread(), registry.make("rule", "direct-known"), 256).value,
        rtol=0.05, atol=0.02 * float(known.max()),
    )  # fmt: skip


def test_one_pass_is_exact_where_nothing_hides_a_diffuse_surface() -> None:
    problem = DirectProblem.of(open_floor(lights=LAMPS))
    exact = known_radiance(problem, 1).sum(dim=1).numpy()
    for sampler in ("random", "pmj", "lamp-spread"):
        pair = registry.make("sampler", sampler), registry.make("rule", "direct-known")
        np.testing.assert_allclose(run(problem, *pair, 4).value, exact, rtol=1e-12)


def test_spans_are_where_lights_are_chosen() -> None:
    problem = DirectProblem.of(two_spheres(8))
    low, length = spans(problem).unbind(dim=-1)
    on = torch.from_numpy(problem.surfaces["kind"] >= 0)
    whole = length.sum(dim=1)
    assert (whole <= 1.0 + 1e-12).all()
    assert ((whole - 1.0).abs() < 1e-12)[on].double().mean() > 0.9  # others have lamps behind them
    lamps = low.shape[1]
    x = Stream(1).uniform(problem.rows[:, None, None], torch.arange(lamps)[:, None], torch.arange(6))
    x[..., 3] = low + length * x[..., 3]
    light = problem.evaluate(x).features["light"][:, :, 1, 0]
    possible = on[:, None] & (length > 0.0)
    assert possible.sum() > 40
    assert (light == torch.arange(lamps))[possible].all()


def test_samples_go_to_lamps_by_what_they_bring_and_later_by_doubt() -> None:
    lamps = [render.SphereLight([0, 0, 2], 0.2, 50.0), render.SphereLight([1.5, 0, 2], 0.2, 0.5)]
    problem = DirectProblem.of(open_floor(lights=lamps))
    light = LampSpread().draw(problem, 32, Stream(0)).seen.features["light"][:, :, 1, 0]
    assert ((light == 0).sum(dim=1) >= 28).all()
    # A ball hides half of one of two equal lamps from what lies below it: that lamp gets most of the second round.
    ball = render.Sphere([0.6, 0, 1], 0.25, render.Diffuse(0.4))
    even = [render.SphereLight([-0.6, 0, 2], 0.2, 10.0), render.SphereLight([0.6, 0, 2], 0.2, 10.0)]
    floor = render.Quad([-4, -4, 0], [8, 0, 0], [0, 8, 0], render.Diffuse(0.5))
    shaded = DirectProblem.of(render.Scene(looking_down(), [floor, ball], even))
    samples = LampSpread(even=0.0).draw(shaded, 32, Stream(0))
    its, visible = (samples.seen.features[name][:, :, 1, 0] for name in ("light", "visible"))
    early = [((its == j) * visible)[:, :16].sum(dim=1) / (its == j)[:, :16].sum(dim=1) for j in (0, 1)]
    torn = (early[0] == 1.0) & (early[1] > 0.2) & (early[1] < 0.8)
    assert torn.sum() >= 2
    before, after = ((its == 1)[torn, part].sum(dim=1).double() for part in (slice(0, 16), slice(16, 32)))
    assert (after > before).all()
    assert after.mean() > 1.15 * before.mean()


def test_a_lamps_samples_are_spread_over_it() -> None:
    """The points of one lamp are the first of a (0,2)-sequence: one in each of four quarters."""
    problem = DirectProblem.of(open_floor(lights=LAMPS[:1]))
    x = LampSpread().draw(problem, 16, Stream(2)).x
    for axes in (4, 5):
        assert ((x[:, :4, axes] * 4).floor().sort(dim=1).values == torch.arange(4)).all()


def test_lamp_spread_refuses_other_problems() -> None:
    with pytest.raises(ValueError, match="sampler: 'lamp-spread' needs the problem 'direct'"):
        LampSpread().draw(ng.datasets.toy(1), 4, Stream(0))
