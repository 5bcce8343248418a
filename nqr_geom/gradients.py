"""Gradients of harmonic functions on polygons: `laplace_gradient`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.chunks import by_chunks
from nqr_geom.streams import Stream

if TYPE_CHECKING:
    from nqr_geom.integrator.estimate import Estimate

__all__ = ["laplace_gradient"]

Floats = NDArray[np.float64]


@by_chunks("points", columns=2)
def laplace_gradient(
    polygon: Any,
    boundary: Any,
    points: ArrayLike,
    *,
    n: int = 256,
    variates: str = "both",
    epsilon: float = 1e-3,
    max_steps: int = 10_000,
    outside: str = "raise",
    seed: int = 0,
    rows: ArrayLike | None = None,
    full_output: bool = False,
) -> Floats | Estimate:
    """Gradient by the query of the harmonic function with given boundary values, by walks on spheres.

    On the largest circle about a query the gradient is the mean of 2 u n/R, n the direction and R the radius; u is what
    a walk from there finds. Its variance grows like 1/R^2 unless the mean of u is taken out of it.

    Parameters
    ----------
    polygon, boundary : as for `solve_laplace`
        The domain and the values on its edge.
    points : (m, 2) array_like, or dask array
        Queries inside, not on the edge.
    n : int
        Walks a query, >= 2; rounded up to an even number where they come in pairs.
    variates : {"both", "antithetic", "control", "none"}
        "control": the boundary value nearest to the query is taken off u, which changes no mean. "antithetic": walks
        start in opposite pairs, so that every constant cancels. "both": these pairs, evenly spread over the circle; the
        standard error does not know of the spread and is too large.
    epsilon, max_steps, outside, seed, rows : as for `solve_laplace`
        The shell, the cap on steps, what to do with points outside, and which walks.
    full_output : bool
        Return the `Estimate` with its standard error.

    Returns
    -------
    (m, 2) float64 ndarray, or Estimate
        Derivatives by x and y, in values per length.

    Raises
    ------
    ValueError, TypeError
        If an argument is of the wrong kind, shape or range, or a point lies outside or on the edge.

    References
    ----------
    Sawhney, Crane, Monte Carlo geometry processing, 2020, section 3.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> gradient = ng.laplace_gradient(square, lambda p: 3.0 * p[:, 0], [[0.5, 0.5]], n=4096)
    >>> bool(abs(gradient[0] - [3.0, 0.0]).max() < 0.1)
    True
    """
    from nqr_geom.pde import inside_of, scattered
    from nqr_geom.pde_walks import walked
    from nqr_geom.wos.domain import Domain
    from nqr_geom.wos.gradient import gradient

    check.choice("variates", variates, ["both", "antithetic", "control", "none"])
    check.choice("outside", outside, ["raise", "nan"])
    n = check.integer("n", n, low=2)
    epsilon = check.number("epsilon", epsilon, low=1e-12, high=0.5)
    max_steps = check.integer("max_steps", max_steps, low=1)
    start = time.perf_counter()
    domain = Domain.of(polygon)
    values = domain.boundary(boundary)
    framed, inside = inside_of(domain, points, outside)
    keys = check.rows(rows, len(framed))[inside]
    stream = Stream(check.integer("seed", seed), "test", "gradient/0")
    on = domain.search(framed[inside])[2] <= 1e-14
    if on.any():
        row = int(np.flatnonzero(inside)[int(np.flatnonzero(on)[0])])
        raise ValueError(
            f"points: expected points off the edge, where the gradient is none, got one on it at row {row}"
        )
    statistics, counts = gradient(values, framed[inside], keys, n, variates, stream, epsilon, max_steps)
    seconds = time.perf_counter() - start
    what = {"sampler": "random", "rule": f"gradient, {variates}", "seeds": (seed,)}
    estimate = walked(statistics.mean, statistics, statistics.stderr, n, counts, seconds, **what)
    estimate = scattered(estimate, inside)
    return estimate if full_output else estimate.value
