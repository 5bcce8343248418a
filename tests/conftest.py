"""Small named shapes that many tests share, and the rule that a skipped test is an error where it counts."""

from __future__ import annotations

import os

import numpy as np
import pytest

from nqr_geom.curves.curve import Curve


@pytest.fixture(scope="session", autouse=True)
def few_lessons() -> None:
    """Families whose answers are solved for, once and for many minutes, are small ones in tests."""
    from nqr_geom import p_training
    from nqr_geom.render import direct_training
    from nqr_geom.wos import training

    training.SHAPES.update({"train": 128, "validation": 64, "test": 64})
    p_training.SHAPES.update({"train": 16, "validation": 16, "test": 16})
    p_training.BLOCK = 16
    direct_training.ROOMS.update({"train": 8, "validation": 8, "test": 8})


@pytest.fixture(scope="session")
def square() -> Curve:
    return Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)


@pytest.fixture(scope="session")
def bowtie() -> Curve:
    return Curve.polyline([[-1, -1], [1, 1], [1, -1], [-1, 1]], closed=True)


@pytest.fixture(scope="session")
def star19() -> Curve:
    angle = 2.0 * np.pi * np.arange(19) / 19.0
    radius = 0.7 + 0.25 * np.cos(7.0 * angle + 0.3)
    return Curve.polyline(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


@pytest.fixture(scope="session")
def glyph() -> Curve:
    return Curve.from_text("&")


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Under CI=true a skipped test fails the run, unless it needs a GPU."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if os.environ.get("CI") != "true" or reporter is None:
        return
    skipped = [report.nodeid for report in reporter.stats.get("skipped", []) if "gpu" not in report.keywords]
    if skipped and exitstatus == 0:
        reporter.write_line("skipped tests are errors here: " + ", ".join(skipped), red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
