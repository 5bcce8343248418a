"""SciPy's adaptive quadrature on our integrands: what somebody would reach for who does not know this library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from nqr_geom.integrator.estimate import Estimate, exactly
from nqr_geom.integrator.problem import Problem
from nqr_geom.reporting.contenders import Contender

__all__ = ["tanh_sinh"]

Floats = NDArray[np.float64]

_LEVELS = (19, 35, 67, 131, 259, 515, 1027, 2051)  # evaluations at the levels 0, 1, ... of the tanh-sinh rule


def tanh_sinh(problem: Problem, link: Callable[[Floats], Floats] = lambda inner: inner) -> Contender:
    """`scipy.integrate.tanhsinh` on one-dimensional integrals, each refined on its own.

    Parameters
    ----------
    problem : Problem
        One dimension, one technique, one channel.
    link : callable
        What stands outside the integral, (B,) -> (B,).

    Returns
    -------
    Contender
        Of kind "library"; n samples are the highest level that takes no more evaluations.

    Examples
    --------
    >>> from nqr_geom.toy.problem import ToyProblem
    >>> estimate = tanh_sinh(ToyProblem(3)).answer(256, 0)
    >>> estimate.value.shape, estimate.counts["queries"] // 3
    ((3, 1), 131)
    """

    def answer(n: int, seed: int) -> Estimate:
        from scipy.integrate import tanhsinh

        level = sum(size <= n for size in _LEVELS) - 1
        spent = 0

        def integrand(x: Floats, row: NDArray) -> Floats:
            nonlocal spent
            rows = np.broadcast_to(row, x.shape)[..., 0] if x.ndim == 2 else row
            places = torch.from_numpy(np.ascontiguousarray(x.reshape(len(rows), -1)))
            index = torch.from_numpy(rows.astype(np.int64))
            spent += x.size
            value = problem.take(index).evaluate(places.clamp(0.0, 1.0)[..., None]).value
            return value[:, :, 0, 0].numpy().reshape(x.shape)

        def solve() -> Floats:
            rows = np.arange(problem.batch, dtype=np.float64)
            # Never satisfied, so that it goes to the level that is asked for.
            found = tanhsinh(integrand, 0.0, 1.0, args=(rows,), minlevel=0, maxlevel=level, rtol=1e-300, atol=0.0)
            return link(np.asarray(found.integral, dtype=np.float64))

        estimate = exactly(solve, problem.name)
        return replace(estimate, counts={"samples": spent, "queries": spent}, stages={"all": estimate.seconds})

    def refused(n: int) -> str | None:
        return None if n >= _LEVELS[0] else f"the coarsest level takes {_LEVELS[0]} evaluations"

    return Contender("SciPy tanh-sinh", "library", ("", ""), answer, refused)
