"""The package stays light: what is heavy, or comes with an extra, arrives when it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import nqr_geom

HEAVY = ("torch", "vtk", "vtkmodules", "pyvista", "warp", "numba", "matplotlib", "scipy", "shapely", "svgelements")


def loaded_by(code: str) -> set[str]:
    """Which heavy modules a fresh interpreter has after running some code."""
    script = f"{code}\nimport sys\nprint(*(m for m in {HEAVY!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "code",
    [
        "import nqr_geom; assert 'Curve' in dir(nqr_geom) and nqr_geom.__version__",
        "from nqr_geom import registry; registry.entry('rule', 'mc'); registry.method('structured', 'gwn')",
        "from nqr_geom import streams, check, machine; machine.machine()",
    ],
)
def test_nothing_heavy_is_loaded(code):
    assert loaded_by(code) == set()


def test_the_probe_can_tell():
    assert "torch" in loaded_by("import nqr_geom.integrator.problem")


def test_measuring_a_frontier_needs_no_plotting():
    assert "matplotlib" not in loaded_by("import nqr_geom.integrator.frontier, nqr_geom.integrator.chart")


def test_version_is_said_once():
    from importlib.metadata import version

    assert nqr_geom.__version__ == version("nqr-geom")


def test_unknown_names_are_refused():
    with pytest.raises(AttributeError, match="module 'nqr_geom' has no attribute 'magic'"):
        nqr_geom.magic  # noqa: B018
