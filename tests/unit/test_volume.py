"""Only what a volume calls for runs, the report says so, and the answer is the same as with everything on."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import nqr_geom as ng
from nqr_geom import render
from nqr_geom.render.estimators import TRACKERS
from nqr_geom.render.kernels_track import track
from nqr_geom.render.medium import Medium
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.unbiased import march
from nqr_geom.streams import Stream

METHODS = ("random", "stratified", "trapezoid", "regression", "jackknife", "structured", *TRACKERS)
NOISE = render.Noise(amplitude=0.8, frequency=0.9, seed=1)
X = [1.0, 0.0, 0.0]


def balls(noise=None):
    return render.Spheres([[3, 5, 5], [6, 5, 4]], [1.5, 2.0], [0] * 3, [10] * 3, noise=noise)


def rays(m=40):
    """Half of them hit the box."""
    y = np.linspace(0.0, 20.0, m)
    return np.stack([np.full(m, -1.0), y, np.full(m, 4.7)], axis=1), np.tile([1.0, 0.001, 0.0], (m, 1)), 30.0


@pytest.mark.parametrize(
    ("volume", "effects"),
    [
        (render.Homogeneous([0] * 3, [1] * 3), {"homogeneous"}),
        (render.Homogeneous([0] * 3, [1] * 3, 0.0), set()),
        (render.Grid(np.eye(3)[None].repeat(3, 0), [0] * 3, [1] * 3), {"grid"}),
        (render.Grid(np.full((2, 2, 2), 3.0), [0] * 3, [1] * 3), {"homogeneous"}),
        (render.Grid(np.zeros((2, 2, 2)), [0] * 3, [1] * 3), set()),
        (balls(), {"spheres"}),
        (balls(NOISE), {"spheres", "noise"}),
        (balls(render.Noise(amplitude=0.0)), {"spheres"}),
        (render.Torus([0] * 3, X, 2, 1, noise=NOISE), {"torus", "noise"}),
        (render.Extrusion(np.zeros((2, 2)), 1, 1, [0] * 3, [1] * 3), {"extrusion"}),
    ],
)
def test_effects_are_what_the_data_call_for(volume, effects):
    assert volume.effects() == effects
    assert Medium.of([volume]).effects == effects


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("noise", [None, NOISE])
def test_the_report_counts_what_ran(method, noise):
    origins, ways, t_max = rays()
    got = render.transmittance(balls(noise), origins, ways, t_max, method=method, n=24, full_output=True)
    hits = int((origins[:, 1] + 0.001 <= 10.0).sum())
    queries, name = got.counts["queries"], "spheres" if noise is None else "spheres+noise"
    if method in TRACKERS:
        assert queries > 0
    elif method != "structured":
        assert queries == 24 * hits
    else:
        assert 0 < queries < 24 * hits  # rays between the balls are not marched
    if noise is None:
        assert "noise" not in got.counts
    else:  # noise is evaluated where it can matter
        assert 0 < got.counts["noise"] <= queries
        assert method in ("structured", "unbiased-raymarching") or got.counts["noise"] < 0.8 * queries
    assert got.effects == balls(noise).effects()
    verb = {"ratio": "track-ratio", "track-length": "track-length", "random": "march", "stratified": "march"}
    verb = verb.get(method, "observe")
    assert got.plan["kernels"] == (f"{verb}[{name}]",)
    assert sum(got.stages.values()) <= got.seconds * (1.0 + 1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_with_everything_on_the_answer_is_the_same(method):
    origins, ways, t_max = rays()
    for noise in (None, NOISE):
        lean, full = (
            render.transmittance(balls(noise), origins, ways, t_max, method=method, full_output=True, everything=e)
            for e in (False, True)
        )
        np.testing.assert_array_equal(lean.value, full.value)
        assert full.counts["queries"] >= lean.counts["queries"]
    if method not in ("structured", *TRACKERS):
        assert full.counts["queries"] == full.counts["noise"] == 24 * 40


def test_no_noise_is_evaluated_where_there_is_none(monkeypatch):
    """The kernels of smooth volumes hold no call to noise at all."""
    from nqr_geom.render import kernels_density

    source = kernels_density.components("spheres", False).adj.source
    assert "fbm" not in source
    assert "fbm" in kernels_density.components("spheres", True).adj.source


def test_a_ray_has_the_same_bits_whatever_it_travels_with():
    origins, ways, t_max = rays()
    problem = ng.problems.transmittance(balls(NOISE), origins, ways, t_max)
    some = torch.tensor([17, 3, 8])
    for ratio in (True, False):
        whole, part = (
            track(p.medium, p.rays, p.rows, Stream(4).key, ratio=ratio, enough=24, most=24)[0]
            for p in (problem, problem.take(some))
        )
        assert torch.equal(whole[some], part)
    whole, part = (march(p, 24, Stream(4)).value for p in (problem, problem.take(some)))
    assert torch.equal(whole[some], part)
    for method in METHODS:
        few = render.transmittance(balls(NOISE), origins[:7], ways[:7], t_max, method=method)
        np.testing.assert_array_equal(few, render.transmittance(balls(NOISE), origins, ways, t_max, method=method)[:7])


def test_seeds_differ_where_there_is_chance():
    origins, ways, t_max = rays()
    for method in METHODS:
        one, two, again = (
            render.transmittance(balls(NOISE), origins, ways, t_max, method=method, seed=s) for s in (0, 1, 0)
        )
        np.testing.assert_array_equal(one, again)
        assert (one != two).any(), method


def test_integrate_gives_the_same_numbers():
    origins, ways, t_max = rays()
    for method in ("random", "stratified", "trapezoid", "regression", "jackknife"):
        problem = ng.problems.transmittance(balls(NOISE), origins, ways, t_max)
        through = ng.integrate(problem, 24, method=method, seed=3)
        direct = render.transmittance(balls(NOISE), origins, ways, t_max, method=method, seed=3, full_output=True)
        np.testing.assert_array_equal(through.value, direct.value)
        np.testing.assert_array_equal(through.inner, direct.inner)


def test_several_volumes_of_one_kind_side_by_side():
    both = ng.problems.transmittance([balls(NOISE), balls()], *rays())
    for k, volume in enumerate((balls(NOISE), balls())):
        alone = ng.problems.transmittance(volume, *rays())
        x = torch.linspace(0.0, 0.99, 7, dtype=torch.float64).expand(40, 7)[..., None]
        joined = both.evaluate(x.repeat(2, 1, 1)).value[40 * k : 40 * (k + 1)]
        torch.testing.assert_close(joined, alone.evaluate(x).value, rtol=0, atol=0)
    assert both.groups.tolist() == [0] * 40 + [1] * 40
    with pytest.raises(ValueError, match="volume: expected volumes of one kind, got spheres and torus"):
        ng.problems.transmittance([balls(), render.Torus([0] * 3, X, 2, 1)], *rays())


def test_structured_samples_beat_every_classical_row():
    """Many times better than the best classical row on the training family, at the same number of queries."""
    problem, tight = (TransmittanceProblem.family(3, seed=7, resolution=16, support=s) for s in ("bounds", "pieces"))
    truth = tight.reference()
    errors = {
        name: ((ng.integrate(p, 24, method=name, seed=1).value - truth) ** 2).mean()
        for name, p in {"random": problem, "stratified": problem, "structured": tight}.items()
    }
    assert errors["random"] / errors["stratified"] > 25.0
    assert errors["random"] / errors["structured"] > 700.0


def test_features_continue_the_shape_along_the_ray():
    """u_geo at a step further is the quadratic of value, slope and bend, while the same ball is nearest."""
    for volume in (balls(), render.Torus([5, 5, 5], [0.2, 0.1, 1.0], 3, 1.2, [0] * 3, [10] * 3)):
        problem = ng.problems.transmittance(volume, [[-1, 4.5, 4.6]], [[1, 0.03, 0.02]], 30.0)
        step = 1e-4
        x = torch.tensor([[0.21, 0.21 + step, 0.21 - step]], dtype=torch.float64)[..., None]
        seen = problem.evaluate(x).features
        u, ahead, behind = seen["u_geo"][0, :, 0, 0].tolist()
        h = step * problem.rays.total.item()
        assert seen["slope"][0, 0, 0, 0].item() == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)
        assert seen["bend"][0, 0, 0, 0].item() == pytest.approx((ahead - 2 * u + behind) / (2 * h * h), rel=1e-3)
        t = seen["t"][0, :, 0, 0]
        assert (t[1] - t[0]).item() == pytest.approx(h, rel=1e-9)
    assert set(problem.schema.names) == set(seen)


def test_importing_the_package_loads_neither_warp_nor_torch():
    import subprocess
    import sys

    code = (
        "import sys; from nqr_geom import render\n"
        "fog = render.Spheres([[0]*3], [1.0], noise=render.Noise()); fog.effects(), fog.bounds\n"
        "print(sorted({'warp', 'torch', 'numba'} & set(sys.modules)), 'transmittance' in dir(render))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == "[] True\n"
    with pytest.raises(AttributeError, match=r"module 'nqr_geom.render' has no attribute 'magic'"):
        render.magic  # noqa: B018
