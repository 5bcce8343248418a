"""Reports measure what the frontier measures, draw the right conclusions, and survive being killed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nqr_geom as ng
from nqr_geom import cli
from nqr_geom.reporting import findings
from nqr_geom.reporting.applications import build
from nqr_geom.reporting.contenders import contenders_for, kind_of
from nqr_geom.reporting.own import own
from nqr_geom.reporting.scipy_peer import tanh_sinh
from nqr_geom.reporting.settings import MODES
from nqr_geom.reporting.store import Store
from tests.reports import TINY, tiny

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
ROOT = Path(__file__).resolve().parents[2]


def point(mse, seconds, n=None, method="m", kind="sampled", queries=None, ratio=None):
    interval = (0.5 * mse, 2.0 * mse)
    return {
        "method": method, "sampler": "", "rule": "", "kind": kind, "n": n, "queries": queries or n, "seconds": seconds,
        "peak_memory": 10**6, "mse": mse, "mse_interval": interval, "median": mse, "p99": mse, "squared_bias": 0.0,
        "squared_bias_interval": interval, "ratio": ratio, "ratio_interval": interval, "fallback": 0.0,
        "stages": {"draw": seconds},
    }  # fmt: skip


def record(*cells):
    """An application's record of (method, kind, n, mse, seconds)."""
    made = [
        {"method": m, "kind": k, "n": n, "setting": "", "pair": "", "refused": None, "point": point(e, s, n, m)}
        for m, k, n, e, s in cells
    ]
    options = {"scale": 1, "batch": 10, "groups": 2, "runs": 3, "seed": 0, "baseline": "mc", "intervals_over": "groups"}
    return {"name": "toy", "title": "Toy", "cells": made} | options


PLAIN = [("mc", "classical", n, 1.0 / n, 1e-6 * n) for n in (4, 16, 64, 256)]


def test_break_even_is_the_cost_at_which_both_take_the_same_time():
    """Error 1/n: 128 samples do what the network does with 32; c* (128 - 32) is what it takes beyond queries."""
    told = findings.break_even_costs(record(*PLAIN, ("net", "learned", 32, 1.0 / 128.0, 32e-6 + 9.6e-3)))
    assert [row["method"] for row in told] == ["net"]
    row = told[0]
    assert row["query"] == pytest.approx(1e-6)
    assert row["overhead"] == pytest.approx(9.6e-3)
    assert row["needed"] == pytest.approx(128.0)
    assert row["cost"] == pytest.approx(1e-4)
    assert row["verdict"] == "above"


def test_break_even_says_never_already_and_at_most():
    cells = [
        ("no better", "learned", 16, 1.0 / 16.0, 1.0),
        ("free", "structured", 16, 1.0 / 64.0, 16e-6),
        ("beyond the curve", "student", 16, 1e-9, 16e-6 + 2.4e-3),
        ("too many samples to tell", "student", 256, 1e-9, 1.0),
    ]
    told = {row["method"]: row for row in findings.break_even_costs(record(*PLAIN, *cells))}
    assert set(told) == {"no better", "free", "beyond the curve"}
    assert told["no better"]["verdict"] == "never"
    assert told["no better"]["cost"] is None
    assert told["free"]["verdict"] == "already"
    assert told["beyond the curve"]["needed"] is None
    assert told["beyond the curve"]["cost"] == pytest.approx(1e-5)  # 2.4 ms over the 240 samples that were measured


def test_equal_time_keeps_within_the_baselines_time():
    cells = [("net", "learned", 4, 1e-3, 60e-6), ("fast", "library", 16, 1e-2, 10e-6)]
    rows = {row["n"]: row for row in findings.equal_time(record(*PLAIN, *cells))}
    assert list(rows) == [4, 16, 64, 256]
    assert rows[4]["classical"]["method"] == "mc"
    assert rows[4]["other"] is None
    assert rows[16]["classical"] == {"method": "fast", "n": 16, "mse": 1e-2}
    assert rows[64]["other"] == {"method": "net", "n": 4, "mse": 1e-3}
    assert findings.headline(record(*PLAIN, *cells))["n"] == 16  # of 16 and 64, as near to 32 as can be, the smaller


@pytest.mark.parametrize(
    ("problem", "pair", "kind"),
    [
        ("gwn", ("random", "mc"), "classical"),
        ("gwn", ("stratified", "gwn-hermite"), "structured"),
        ("gwn", ("stratified", "inet-gwn-student"), "student"),
        ("gwn", ("snet-gwn-nqr", "trapezoid"), "learned"),
        ("laplace", ("array-rqmc", "mc"), "classical"),
        ("laplace", ("latin-hypercube", "walk-fit"), "structured"),
        ("direct", ("lamp-spread", "direct-known"), "structured"),
    ],
)
def test_kinds(problem, pair, kind):
    assert kind_of(problem, pair) == kind


def test_every_alias_that_fits_takes_part_once():
    from nqr_geom.integrator.frontier import fitting

    problem = ng.problems.toy(4)
    found = contenders_for(problem)
    assert set(fitting(problem, 32)) <= {one.name for one in found}
    assert len({one.pair for one in found}) == len(found)
    everything = contenders_for(problem, everything=True)
    assert {one.pair for one in found} < {one.pair for one in everything}
    assert ("stratified", "regression-5") in {one.pair for one in everything}
    assert "regression" not in " ".join(one.name for one in build("laplace", TINY, 0).contenders)  # 12 dimensions


def test_scipy_integrates_what_we_integrate():
    """An open quarter of a circle of lines around the origin: smooth, so that tanh-sinh gets it to rounding."""
    problem = ng.problems.gwn(ng.Curve.polyline([[1, -1], [1, 1]]), [[0.0, 0.0], [0.5, 0.1], [3.0, 0.0]])
    peer = tanh_sinh(problem)
    fine = peer.answer(300, 0)
    np.testing.assert_allclose(fine.value, problem.reference(), rtol=0.0, atol=1e-13)
    assert fine.counts["queries"] == 3 * 259
    coarse = peer.answer(19, 0)
    assert coarse.counts["queries"] == 3 * 19
    assert np.abs(coarse.value - problem.reference()).max() > 1e-9
    assert peer.refused(18) is not None
    assert peer.refused(19) is None


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    return folder, tiny(folder, apps=["toy"])


def test_a_report_measures_what_the_frontier_does(toy):
    folder, made = toy
    kept = json.loads((folder / "report.json").read_text())
    assert kept == json.loads(json.dumps(made))
    (application,) = kept["applications"]
    names = ["mc", "trapezoid", "structured"]
    direct = ng.frontier(ng.problems.toy(TINY.toy), names, TINY.budgets, runs=2)
    here = {(c["method"], c["n"]): c["point"] for c in application["cells"] if c["point"]}
    for there in direct.points:
        one = here[there.method, there.n]
        assert one["mse"] == there.mse
        assert tuple(one["mse_interval"]) == there.mse_interval
        assert one["ratio"] == there.ratio
        assert one["stages"].keys() == there.stages.keys()
    assert here["mc", 4]["ratio"] == 1.0
    assert kept["machine"]["cores"] >= 1
    assert {"python", "nqr-geom", "torch"} <= kept["versions"].keys()
    assert {row["n"] for row in application["coverage"]} == {8}
    assert ("inet", 16) not in here  # networks end at the largest budget that is theirs
    assert not any(name.startswith(".") for name in (entry.name for entry in folder.rglob("*.json")))


def test_budgets_that_take_too_long_are_left_out_and_said_so(tmp_path):
    made = tiny(tmp_path, apps=["toy"], sizes=replace(TINY, cell_seconds=0.0, always=4))
    cells = made["applications"][0]["cells"]
    assert {c["n"] for c in cells if c["point"]} == {4}
    refused = [c for c in cells if c["refused"] and c["n"] == 16 and c["method"] == "mc"]
    assert "more than the 0 s a cell may take" in refused[0]["refused"]
    assert next(c for c in cells if c["method"] == "SciPy tanh-sinh")["refused"].startswith("the coarsest level")


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.reports import tiny
def tick(done, total, label):
    if done == 9:
        os.kill(os.getpid(), signal.SIGKILL)
tiny(Path(sys.argv[1]), apps=["toy"], tick=tick)
"""


def test_a_killed_report_goes_on_where_it_stopped(toy, tmp_path):
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], cwd=ROOT, capture_output=True, timeout=120)
    assert done.returncode == -signal.SIGKILL
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "cells").iterdir()}
    assert len(before) == 1 + 9  # with the configuration
    for path in before:
        json.loads(path.read_text())
    assert not (tmp_path / "report.html").exists()
    steps = []
    made = tiny(tmp_path, apps=["toy"], tick=lambda *told: steps.append(told))
    assert {path: path.stat().st_mtime_ns for path in before} == before  # none was measured again
    assert steps[-1][0] == steps[-1][1] == made["cells"]

    def errors(report):
        """All that does not depend on the clock."""
        return [
            (c["method"], c["n"], c["point"]["mse"], c["point"]["mse_interval"], c["point"]["ratio_interval"])
            for c in report["applications"][0]["cells"]
            if c["point"]
        ]

    assert json.dumps(errors(made)) == json.dumps(errors(toy[1]))  # as if it had never been stopped


def test_a_folder_of_another_configuration_is_refused(toy, tmp_path):
    folder, _ = toy
    with pytest.raises(ValueError, match=r"out: expected a folder of the same configuration.* seed 0, now it is 1"):
        tiny(folder, apps=["toy"], seed=1)
    with pytest.raises(ValueError, match="input"):
        tiny(folder, apps=["gwn"], input=SQUARE)
    (tmp_path / "notes.json").write_text("{}")
    with pytest.raises(ValueError, match=r"has no configuration\.json"):
        Store(tmp_path, {"seed": 0})


def test_a_broken_cell_is_named(tmp_path):
    store = Store(tmp_path, {"seed": 0})
    store.put("cell", {"a": 1})
    path = next(path for path in tmp_path.iterdir() if path.name != "configuration.json")
    path.write_text('{"key": "cell", "ce')
    with pytest.raises(ValueError, match=path.name):
        store.get("cell")
    with pytest.raises(ValueError, match="Out of range float"):
        store.put("nan", {"mse": float("nan")})


def test_own_polygon_is_measured_in_every_application_that_fits(tmp_path):
    made = tiny(tmp_path, input=SQUARE, sizes=replace(TINY, p_triangles=(20, 40), budgets=(4,)))
    assert [application["name"] for application in made["applications"]] == ["gwn", "sd", "laplace", "p-laplace"]
    assert made["input"] == "5 points"
    assert made["hard"] == made["effects"] == []
    laplace = made["applications"][2]
    assert laplace["intervals_over"] == "runs"
    assert laplace["runs"] >= 6
    solved = [c for c in laplace["cells"] if c["kind"] == "exact"]
    assert [c["method"] for c in solved] == ["finite elements"]
    assert solved[0]["point"]["mse"] < 1e-4
    walks = next(c for c in laplace["cells"] if c["method"] == "mc")
    assert 1e-3 < walks["point"]["mse"] < 1.0  # four walks of values in [-1, 1]


def test_own_curves_of_many_pieces_are_shown_to_networks_in_parts():
    word = own("ab", text=True)
    assert word.label == "the text 'ab'"
    made = word.makers["gwn"](TINY)
    pieces = ng.Curve.from_text("ab").n_pieces
    assert made.scale >= pieces / 6 > made.scale / 2
    inet = next(one for one in made.contenders if one.name == "inet")
    n = 8 * made.scale
    estimate = inet.answer(n, 0)
    assert estimate.counts["queries"] <= n * made.problem.batch
    assert "fewer than 4 for each" in inet.refused(made.scale)
    error = ((estimate.value - made.truth()) ** 2).mean()
    assert error < 0.1


def test_what_does_not_fit_an_input_is_said_with_the_reason(tmp_path):
    bowtie = [[-1, -1], [1, 1], [1, -1], [-1, 1], [-1, -1]]
    found = own(bowtie)
    assert sorted(found.makers) == ["gwn", "sd"]
    with pytest.raises(ValueError, match=r"apps: 'laplace' does not fit the input: .*cross"):
        tiny(tmp_path, apps=["laplace"], input=bowtie)
    with pytest.raises(ValueError, match="apps: 'direct' does not fit the input: it needs no curve"):
        tiny(tmp_path, apps=["direct"], input=SQUARE)


@pytest.mark.parametrize(
    ("given", "error", "match"),
    [
        ("nowhere.npy", ValueError, "input: expected an existing file, got 'nowhere.npy'"),
        ("nowhere.json", ValueError, "nowhere.json"),
        (ng.Curve.from_callable(lambda s: np.stack([s, s], axis=-1)), ValueError, "input: .* a black box"),
        ([[0, 0], [0, 0]], ValueError, "input: expected a curve of positive length"),
        ([1.0, 2.0], ValueError, r"points: expected shape \(n, 2\), got \(2,\)"),
    ],
)
def test_bad_inputs_are_named(given, error, match):
    with pytest.raises(error, match=match):
        own(given)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"mode": "slow"}, ValueError, "mode: expected one of quick, full, got 'slow'"),
        ({"apps": "gwn"}, TypeError, "apps: expected a sequence of names, got the single name 'gwn'"),
        ({"apps": []}, ValueError, "apps: expected one or more different names"),
        ({"apps": ["magic"]}, ValueError, "apps: expected one of gwn, sd, toy"),
        ({"seed": 0.5}, TypeError, "seed: expected an integer"),
    ],
)
def test_bad_arguments_are_named(tmp_path, options, error, match):
    with pytest.raises(error, match=match):
        ng.report(tmp_path, **options)


def test_a_missing_extra_is_one_clear_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(ImportError, match=r'report pages need plotly: pip install "nqr-geom\[report\]"'):
        ng.report(tmp_path)


def test_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(MODES, "quick", TINY)
    assert cli.main(["report", "--apps", "toy", "--out", str(tmp_path / "r")]) == 0
    assert "report.html" in capsys.readouterr().out
    assert (tmp_path / "r" / "report.html").stat().st_size > 10**6
    assert cli.main(["report", "--apps", "toy", "--seed", "3", "--out", str(tmp_path / "r")]) == 2
    assert "seed 0, now it is 3" in capsys.readouterr().err.replace("\n", " ")
    assert cli.main(["report", "--quick", "--full", "--out", str(tmp_path / "s")]) == 2
