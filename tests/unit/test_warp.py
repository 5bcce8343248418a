"""Warp as the package uses it: the same random numbers as everywhere, split launches, and not a word at start-up."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch
from numba import njit

from nqr_geom import keyed, keyed_warp
from nqr_geom._warp import array, launch, wp
from nqr_geom.streams import Stream


@wp.kernel(enable_backward=False)
def _numbers(
    first: wp.int32,
    key: wp.uint64,
    counters: wp.array(dtype=wp.int64),
    bits: wp.array(dtype=wp.uint64),
    numbers: wp.array(dtype=wp.float64),
):
    row = first + wp.tid()
    state = keyed_warp.mixed(keyed_warp.mixed(key, wp.int64(row)), counters[row])
    bits[row] = state
    numbers[row] = keyed_warp.unit(state)


@njit
def _compiled(key, counters):
    bits = np.empty(len(counters), np.uint64)
    for row in range(len(counters)):
        bits[row] = keyed.mixed(keyed.mixed(key, row), counters[row])
    return bits


@pytest.mark.parametrize("stream", [Stream(0), Stream(-7, "train"), Stream(2**63 + 5, name="shapes")])
def test_random_numbers_are_those_of_numpy_torch_and_numba(stream):
    rows = np.arange(3000)
    counters = rows**3 - 5 * rows - 2**40  # large and negative ones too
    counters[:2] = -1, 2**63 - 1
    bits, numbers = np.zeros(len(rows), np.uint64), np.zeros(len(rows))
    key = keyed_warp.unsigned(stream.key)
    launch(_numbers, len(rows), [key, array(counters, wp.int64), array(bits, wp.uint64), array(numbers, wp.float64)])
    np.testing.assert_array_equal(bits.view(np.int64), stream.bits(rows, counters))
    np.testing.assert_array_equal(numbers, stream.uniform(rows, counters))
    np.testing.assert_array_equal(numbers, stream.uniform(*map(torch.from_numpy, (rows, counters))).numpy())
    assert bits[:500].tolist() == _compiled(keyed.unsigned(stream.key), counters[:500]).tolist()


@wp.kernel(enable_backward=False)
def _visits(first: wp.int32, seen: wp.array(dtype=wp.int32)):
    row = first + wp.tid()
    seen[row] = seen[row] + row + 1


@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 513, 10_007])
def test_every_row_runs_once_whatever_the_number_of_threads(monkeypatch, count):
    for cores in (1, 2, 5):
        monkeypatch.setattr("nqr_geom._warp.cores", lambda _, cores=cores: cores)
        seen = np.zeros(10_007, np.int32)
        launch(_visits, count, [array(seen, wp.int32)])
        np.testing.assert_array_equal(seen, np.where(np.arange(10_007) < count, np.arange(1, 10_008), 0))


def test_arrays_share_the_memory_of_numpy_and_torch():
    for values in (np.zeros(300, np.int32), torch.zeros(300, dtype=torch.int32)):
        launch(_visits, 300, [array(values, wp.int32)])
        assert int(values[-1]) == 300


def test_too_many_rows_are_refused():
    with pytest.raises(ValueError, match="count: expected an integer >= 0 and <= 2147483647, got 2147483648"):
        launch(_visits, 2**31, [])


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)


def test_starting_warp_says_nothing():
    done = run("from nqr_geom._warp import wp; wp.zeros(3, device='cpu')")
    assert (done.stdout, done.stderr) == ("", "")


def test_only_the_line_about_the_driver_is_dropped():
    code = (
        "import os\nfrom nqr_geom._warp import _without_driver_warning as call\n"
        "call(lambda: os.write(2, b'Warp CUDA warning: Could not find it.\\nkept\\n'))"
    )
    assert run(code).stderr == "kept\n"


def test_a_warp_that_was_there_before_keeps_its_settings():
    code = "import warp; before = warp.config.log_level; import nqr_geom._warp; print(before == warp.config.log_level)"
    assert run(code).stdout.endswith("True\n")


def test_a_warp_that_was_loaded_but_not_started_is_started():
    code = (
        "import warp\nfrom nqr_geom import render\nball = render.Spheres([[0, 0, 0]], [1.0])\n"
        "print(render.transmittance(ball, [[-5, 2, 0]], [[1, 0, 0]], 9.0))"
    )
    assert run(code).stdout.endswith("[1.]\n")


def test_a_missing_warp_is_one_clear_sentence():
    code = (
        "import sys; sys.modules['warp'] = None\ntry: import nqr_geom._warp\nexcept ImportError as error: print(error)"
    )
    assert run(code).stdout == 'volumes and scenes need warp: pip install "nqr-geom[render]"\n'
