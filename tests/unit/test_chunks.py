"""Dask arrays of queries: the values of the whole, bit for bit, on threads, in processes and after one is lost."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import dask
import dask.array as da
import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom import render

POINTS = np.random.default_rng(5).uniform(-0.9, 0.9, (60, 2))
INSIDE = np.random.default_rng(6).uniform(0.05, 0.95, (60, 2))
CHUNKS = ((60,), (7, 30, 1, 22), (20, 20, 20))

SHAPE = ng.datasets.curves(1, 3)[0]
LONG = ng.Curve.from_text("gq")
SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
CLOUD = render.Spheres([[0, 0, 0]], [1.0], [-2, -2, -2], [2, 2, 2], noise=render.Noise(amplitude=1.0))


def saddle(points: np.ndarray) -> np.ndarray:
    return np.cos(3.0 * points[:, 0]) * points[:, 1]


def laplace(points: Any, **options: Any) -> Any:
    return ng.solve_laplace(SQUARE, saddle, points, **options)


def through(points: Any, **options: Any) -> Any:
    """Rays through a cloud, from points on a screen before it."""
    ones = points[:, :1] * 0.0 + 1.0
    stack = da.concatenate if isinstance(points, da.Array) else np.concatenate
    origins = stack([points, -5.0 * ones], axis=1)
    return render.transmittance(CLOUD, origins, np.tile([0.0, 0.0, 1.0], (len(points), 1)), 20.0, **options)


FUNCTIONS: dict[str, tuple[Callable[[Any], Any], np.ndarray]] = {
    "gwn": (lambda p: ng.gwn(SHAPE, p), POINTS),
    "gwn by Monte Carlo": (lambda p: ng.gwn(SHAPE, p, method="mc", seed=3), POINTS),
    "gwn, structured": (lambda p: ng.gwn(SHAPE, p, method="structured"), POINTS),
    "gwn by a network, in parts": (lambda p: ng.gwn(LONG, p, method="inet"), POINTS),
    "gwn by both networks": (lambda p: ng.gwn(SHAPE, p, method="nqr", n=8), POINTS),
    "sd": (lambda p: ng.sd(SHAPE, p), POINTS),
    "sd by Monte Carlo": (lambda p: ng.sd(SHAPE, p, method="mc"), POINTS),
    "distance": (lambda p: ng.distance(SHAPE, p), POINTS),
    "signed distance": (lambda p: ng.signed_distance(LONG, p, sign="even-odd"), POINTS),
    "gradient of gwn": (lambda p: ng.gwn_gradient(SHAPE, p), POINTS),
    "gradient of sd": (lambda p: ng.sd_gradient(SHAPE, p, alpha=20.0), POINTS),
    "gradient of distance": (lambda p: ng.distance_gradient(SHAPE, p), POINTS),
    "laplace, solved": (lambda p: laplace(p, method="boundary"), INSIDE),
    "laplace by walks": (lambda p: laplace(p, method="wos", n=20, source=1.0), INSIDE),
    "laplace, structured": (lambda p: laplace(p, method="structured"), INSIDE),
    "laplace by a network": (lambda p: laplace(p, method="inet"), INSIDE),
    "laplace with points outside": (lambda p: laplace(p, method="wos-lhs", outside="nan"), POINTS),
    "laplace solved with points outside": (lambda p: laplace(p, method="boundary", outside="nan"), POINTS),
    "gradient of laplace": (lambda p: ng.laplace_gradient(SQUARE, saddle, p, n=16), INSIDE),
    "transmittance": (through, POINTS),
    "transmittance, structured": (lambda p: through(p, method="structured"), POINTS),
    "transmittance by tracking": (lambda p: through(p, method="ratio"), POINTS),
    "transmittance without bias": (lambda p: through(p, method="unbiased-raymarching"), POINTS),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_are_those_of_the_whole_whatever_the_chunks(name: str) -> None:
    function, points = FUNCTIONS[name]
    whole = function(points)
    assert np.ptp(np.nan_to_num(whole)) > 0.0
    for rows in CHUNKS:
        answer = function(da.from_array(points, chunks=(rows, 1)))  # columns apart too
        assert isinstance(answer, da.Array)
        assert answer.chunks[0] == rows
        assert (answer.dtype, answer.shape) == (whole.dtype, whole.shape)
        np.testing.assert_array_equal(answer.compute(scheduler="threads", num_workers=2), whole)


def test_parts_that_know_their_rows_are_parts_of_the_whole() -> None:
    for function, part in (
        (lambda p, **rows: ng.gwn(LONG, p, method="inet", **rows), slice(20, 45)),
        (lambda p, **rows: ng.sd(SHAPE, p, method="random+mc", n=4, **rows), slice(59, 60)),
        (lambda p, **rows: through(p, **rows), slice(3, 9)),
    ):
        rows = np.arange(60)[part]
        np.testing.assert_array_equal(function(POINTS[part], rows=rows), function(POINTS)[part])
        assert (function(POINTS[part]) != function(POINTS)[part]).any()
    backwards = ng.gwn(SHAPE, POINTS[::-1], method="mc", rows=np.arange(60)[::-1])
    np.testing.assert_array_equal(backwards[::-1], ng.gwn(SHAPE, POINTS, method="mc"))
    lazy = ng.gwn(SHAPE, da.from_array(POINTS[::-1].copy(), chunks=(25, 2)), method="mc", rows=np.arange(60)[::-1])
    np.testing.assert_array_equal(lazy.compute(), backwards)


def test_nothing_is_read_before_it_is_asked_for_and_chunks_by_themselves() -> None:
    read = []

    def points(block: np.ndarray, block_info: Any = None) -> np.ndarray:
        read.append(block_info[None]["chunk-location"][0])
        return block

    lazy = da.from_array(POINTS, chunks=(15, 2)).map_blocks(points, dtype=float, meta=np.empty((0, 2)))
    answer = ng.gwn(SHAPE, lazy, method="mc")
    assert read == []
    part = answer[20:28].compute(scheduler="synchronous")
    assert read == [1]
    np.testing.assert_array_equal(part, ng.gwn(SHAPE, POINTS, method="mc")[20:28])


def test_unlike_arguments_are_refused_at_once() -> None:
    lazy = da.from_array(POINTS, chunks=(15, 2))
    unknown = lazy[lazy[:, 0] > 0.0]
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: ng.gwn(SHAPE, lazy, full_output=True), "full_output: expected False with dask arrays"),
        (lambda: ng.gwn(SHAPE, unknown), "points: expected rows in chunks of known size"),
        (lambda: ng.gwn(SHAPE, lazy[:, :1]), r"points: expected shape \(m, 2\), got \(0, 1\)"),
        (lambda: ng.gwn(SHAPE, lazy, method="magic"), "method: expected one of"),
        (lambda: ng.gwn(SHAPE, lazy, method="mc", n=0), "n: expected an integer >= 1"),
        (lambda: ng.gwn(SHAPE, lazy, method="mc", rows=np.arange(59)), "rows: expected 60 rows, got 59"),
        (lambda: ng.gwn(SHAPE, POINTS, method="mc", rows=-np.arange(60)), "rows: expected integers from 0"),
        (lambda: ng.gwn(SHAPE, POINTS, method="mc", rows=np.arange(59)), r"rows: expected shape \(60,\)"),
        (lambda: ng.gwn(SHAPE, lazy, method="mc", tol=0.1), "tol: expected None with dask arrays"),
        (lambda: laplace(lazy, method="fem"), "method: expected 'boundary', 'wos' with n, or a rule"),
        (lambda: laplace(lazy, method="wos"), "method: expected .* got 'wos'"),
        (lambda: laplace(lazy, source=1.0), "source: expected none with method 'boundary'"),
        (lambda: laplace(lazy, tol=0.0), "tol: expected a number > 0"),
        (lambda: laplace(lazy, outside="maybe"), "outside: expected one of raise, nan"),
        (lambda: through(lazy, n=0), "n: expected an integer >= 1"),
    ]
    for call, message in refused:
        with pytest.raises(ValueError, match=message):
            call()
    with pytest.raises(TypeError, match=r"boundary: expected it in memory, got a dask array; points may be one"):
        ng.solve_laplace(SQUARE, da.ones(4), lazy)
    with pytest.raises(TypeError, match=r"rows: expected integers, got array"):
        ng.gwn(SHAPE, POINTS, method="mc", rows=np.ones(60))
    bad = da.from_array(np.where(np.arange(60)[:, None] == 31, np.nan, POINTS), chunks=(15, 2))
    with pytest.raises(ValueError, match=r"points: expected finite numbers, got nan at index \(1, 0\)"):
        ng.gwn(SHAPE, bad).compute()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A scheduler here and two worker processes."""
    from distributed import Client, LocalCluster

    settings = {"distributed.admin.large-graph-warning-threshold": "1GiB"}
    with (
        dask.config.set(settings),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as local,
        Client(local) as client,
    ):
        yield client


def test_two_processes_give_the_values_of_one(cluster: Any) -> None:
    """Kernels, a network and the solution of an equation, all at once."""
    names = ["gwn by a network, in parts", "laplace, solved", "transmittance"]
    assert len(set(cluster.run(os.getpid).values()) | {os.getpid()}) == 3
    asked = [FUNCTIONS[name] for name in names]
    answers = dask.compute(*(f(da.from_array(points, chunks=(15, 2))) for f, points in asked), scheduler=cluster)
    for answer, (function, points) in zip(answers, asked, strict=True):
        np.testing.assert_array_equal(answer, function(points))


def slowly(block: np.ndarray) -> np.ndarray:
    time.sleep(0.1)
    return block


def test_a_killed_worker_loses_nothing(cluster: Any) -> None:
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (160, 2))
    slow = da.from_array(points, chunks=(10, 2)).map_blocks(slowly, dtype=float, meta=np.empty((0, 2)))
    answer = cluster.persist(ng.gwn(SHAPE, slow, method="mc", seed=9))
    before = cluster.run(os.getpid)
    deadline = time.monotonic() + 20.0
    victim = ""
    while not victim:  # one that holds answers, and works on others
        held = [address for keys in cluster.who_has().values() for address in keys]
        busy = [address for address, tasks in cluster.processing().items() if tasks]
        victim = next((address for address in busy if held.count(address) >= 2), "")
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.kill(before[victim], signal.SIGKILL)
    np.testing.assert_array_equal(answer.compute(scheduler=cluster), ng.gwn(SHAPE, points, method="mc", seed=9))
    assert before[victim] not in cluster.run(os.getpid).values()
