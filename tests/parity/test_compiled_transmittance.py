"""The marched mean of transmittances is what sampler and rule give one after the other."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from nqr_geom import registry
from nqr_geom.integrator.estimate import run
from nqr_geom.render.problems import TransmittanceProblem


class Plain(TransmittanceProblem):
    """The same problem without its compiled pass."""

    def compiled(self, sampler: object, rule: object, n: int) -> None:
        return None


@pytest.mark.parametrize("sampler", ["random", "stratified", "uniform-jitter"])
@pytest.mark.parametrize("support", ["bounds", "pieces"])
@pytest.mark.parametrize("n", [1, 2, 33])
def test_means(sampler: str, support: str, n: int) -> None:
    problem = TransmittanceProblem.family(2, resolution=12, support=support)
    plain = Plain(**{field.name: getattr(problem, field.name) for field in fields(problem)})
    pair = registry.make("sampler", sampler), registry.make("rule", "mc")
    fast, slow = (run(p, *pair, n, seed=3, replicates=2) for p in (problem, plain))
    assert "compiled" in fast.stages
    assert "compiled" not in slow.stages
    np.testing.assert_allclose(fast.inner, slow.inner, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(fast.value, slow.value, rtol=1e-12)
    assert fast.counts == slow.counts
    assert (fast.stderr is None) == (slow.stderr is None)
    if fast.stderr is not None:
        np.testing.assert_allclose(fast.stderr, slow.stderr, rtol=1e-9, atol=1e-12)
