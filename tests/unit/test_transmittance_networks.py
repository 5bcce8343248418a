"""`method="inet"` and `"nqr"` of transmittances: their doors, what is far from their clouds, and what is not there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom import registry, render
from nqr_geom.cli import main
from nqr_geom.integrator.estimate import Estimate
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.volume import Volume
from nqr_geom.render.volume_families import view

METHODS = ("inet", "nqr")


def seen(volume: Volume, method: str, resolution: int = 16, seed: int = 0, **options: object) -> Estimate:
    result = render.transmittance(
        volume, *view(volume, resolution), method=method, seed=seed, full_output=True, **options
    )  # type: ignore[call-overload]
    assert isinstance(result, Estimate)
    return result


def error(volume: Volume, method: str, resolution: int = 16) -> float:
    truth = TransmittanceProblem.of(volume, *view(volume, resolution), support="pieces").reference()
    return float(np.mean((seen(volume, method, resolution).value - truth) ** 2))


def test_the_doors_lead_to_the_same_answer() -> None:
    assert registry.method("inet", "transmittance") == ("uniform-jitter", "inet-transmittance-uniform")
    assert registry.method("nqr", "transmittance") == ("snet-transmittance-nqr", "inet-transmittance-nqr")
    cloud = ng.datasets.volumes(1, 3)[0]
    for method in METHODS:
        direct = ng.integrate(ng.problems.transmittance(cloud, *view(cloud, 6)), 24, method=method, seed=5)
        np.testing.assert_array_equal(seen(cloud, method, 6, 5).value, direct.value)
        assert not direct.fallback.any()
        assert direct.counts["queries"] == 36 * 24


@pytest.mark.parametrize("name", ["cloud", "donut", "letters"])
def test_networks_are_better_than_ray_marching(name: str) -> None:
    """On a cloud of the test split and on shapes unlike those of the training, where the paper's INet fails."""
    volume: Volume = {
        "cloud": lambda: ng.datasets.volumes(1, 3)[0], "donut": ng.datasets.donut, "letters": ng.datasets.letters
    }[name]()  # fmt: skip
    plain = error(volume, "stratified")
    assert error(volume, "inet") < plain
    assert error(volume, "nqr") < plain / 4.0


def test_rays_through_the_hole_of_a_ring_are_not_stopped_by_a_shape_that_is_not_there() -> None:
    """Beside its axis a squared distance to a ring bends downwards, which must not be carried on."""
    donut = ng.datasets.donut()
    rays_of_all = view(donut, 32)
    for row, seed in ((527, 1000), (528, 1003), (530, 1011), (563, 1011)):
        rays = [part[row : row + 1] for part in rays_of_all]
        truth = TransmittanceProblem.of(donut, *rays, support="pieces").reference()[:, 0]
        got = render.transmittance(donut, *rays, method="nqr", seed=seed, rows=np.array([row]))
        np.testing.assert_allclose(got, truth, atol=0.02)


def test_nothing_is_guessed_where_nothing_absorbs() -> None:
    cloud = render.Spheres([[5.0, 5.0, 5.0]], [1.0], [0.0] * 3, [10.0] * 3, noise=render.Noise())
    aside = [[0.5, 0.5, 0.0], [20.0, 5.0, 0.0], [9.5, 0.5, 0.0]], [[0.0, 0.0, 1.0]] * 3, [10.0, 10.0, 0.0]
    for method in METHODS:
        assert render.transmittance(cloud, *aside, method=method) == pytest.approx([1.0] * 3, abs=2e-3)
        assert render.transmittance(cloud, *aside, method=method)[1:].tolist() == [1.0, 1.0]


def test_what_is_far_from_the_clouds_gets_the_consistent_rule() -> None:
    """Without noise, with a finer one and with a hundred times the density: flagged, and by the rule that is safe."""
    cloud = ng.datasets.volumes(1, 3)[0]
    assert cloud.noise is not None
    others = {
        "smooth": replace(cloud, noise=None),
        "fine": replace(cloud, noise=replace(cloud.noise, frequency=40.0)),
        "dark": replace(cloud, density=100.0),
    }
    for name, volume in others.items():
        made = seen(volume, "inet", 6)
        assert made.fallback.all(), name
        safe = render.transmittance(volume, *view(volume, 6), method="trapezoid")
        np.testing.assert_array_equal(made.value[:, 0], safe)
        assert seen(volume, "nqr", 6).fallback.all(), name


def test_answers_stay_within_zero_and_one_whatever_the_volume() -> None:
    noise = render.Noise(amplitude=1.9, frequency=1.9, octaves=7, gain=0.6)
    volume = render.Spheres([[5.0, 5.0, 5.0], [2.0, 2.0, 2.0]], [3.0, 0.01], [0.0] * 3, [10.0] * 3, 3.9, noise)
    for method in METHODS:
        for n in (1, 2, 24, 100):
            value = render.transmittance(volume, *view(volume, 5), method=method, n=n)
            assert np.isfinite(value).all()
            assert ((value >= 0.0) & (value <= 1.0)).all()


@pytest.mark.parametrize("method", METHODS)
def test_the_command_line_takes_networks(method: str, tmp_path: Path) -> None:
    out = tmp_path / "donut.npy"
    main(["transmittance", "donut", "--method", method, "--resolution", "8", "--out", str(out)])
    assert ((np.load(out) >= 0.0) & (np.load(out) <= 1.0)).all()
