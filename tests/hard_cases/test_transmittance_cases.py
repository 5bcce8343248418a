"""No rays are no work."""

from __future__ import annotations

import numpy as np

from nqr_geom import render
from nqr_geom.hard_cases.transmittance import cloud


def test_no_rays_at_all():
    got = render.transmittance(cloud(), np.empty((0, 3)), np.empty((0, 3)), 1.0, method="structured", full_output=True)
    assert got.value.shape == (0, 1)
    assert render.transmittance(cloud(), np.empty((0, 3)), np.empty((0, 3)), 1.0, method="ratio").shape == (0,)
