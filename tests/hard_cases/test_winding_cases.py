"""Laws of the winding number on every curve of the catalogue."""

from __future__ import annotations

import numpy as np
import pytest

from nqr_geom.curves.winding import gwn, gwn_gradient
from nqr_geom.hard_cases.shapes import SQUARE
from nqr_geom.hard_cases.winding import TABLE

NAMES = [row.name for row in TABLE]


@pytest.mark.parametrize("row", TABLE, ids=NAMES)
def test_reversal_changes_the_sign(row):
    np.testing.assert_allclose(gwn(row.curve.reversed(), row.points), -gwn(row.curve, row.points), rtol=0, atol=1e-15)


@pytest.mark.parametrize("row", TABLE, ids=NAMES)
def test_gradient_is_finite_off_the_open_ends(row):
    assert np.isfinite(gwn_gradient(row.curve, [(0.31, 0.77), (-1e5, 3.0), (1e200, -1e300)])).all()


def test_no_queries():
    assert gwn(SQUARE, np.empty((0, 2))).shape == (0,)
