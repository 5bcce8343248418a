"""Problem objects for the integrator, built from what a user has: `ng.problems.gwn(curve, points)` and its like."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.problems import GwnProblem, SdProblem
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.volume import Volume
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.wos.problems import STEPS, LaplaceProblem, PLaplaceProblem

if TYPE_CHECKING:  # a scene's problem loads Warp
    from nqr_geom.render.direct_problem import DirectProblem
    from nqr_geom.render.scene import Scene

__all__ = ["direct", "gwn", "laplace", "p_laplace", "sd", "toy", "transmittance"]


def direct(scenes: Scene | Sequence[Scene]) -> DirectProblem:
    """Direct light in every pixel of one or more scenes (Section 6.1).

    Parameters
    ----------
    scenes : Scene or sequence of Scene
        One behind the other, each row by row from the top left.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> problem = ng.problems.direct(ng.datasets.scenes(2, resolution=4))
    >>> problem.batch, problem.dim, problem.techniques, problem.channels
    (32, 6, 2, 3)
    """
    from nqr_geom.render.direct_problem import DirectProblem

    return DirectProblem.of(scenes)


def gwn(curve: Curve | Sequence[Curve], points: ArrayLike) -> GwnProblem:
    """Winding numbers as integrals (Eq. 5).

    Parameters
    ----------
    curve : Curve or sequence of Curve
        One curve, or several that each see all points.
    points : (m, 2) array_like
        Query points.

    Returns
    -------
    GwnProblem
        m integrals per curve, curve after curve.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> ng.problems.gwn(square, [[0.5, 0.5]]).batch
    1
    """
    return GwnProblem.of(curve, points)


def sd(curve: Curve | Sequence[Curve], points: ArrayLike, alpha: float = 35.0) -> SdProblem:
    """Smoothed distances as integrals behind a logarithm (Eq. 50).

    Parameters
    ----------
    curve, points
        As for `gwn`.
    alpha : float
        Sharpness, > 0, in units of one over length.
    """
    return SdProblem.of(curve, points, alpha)


def laplace(
    polygon: Any, boundary: Any, points: ArrayLike, *, max_steps: int = STEPS, epsilon: float = 1e-3
) -> LaplaceProblem:
    """Harmonic functions as means over walks on spheres (Section 6.4).

    Parameters
    ----------
    polygon, boundary, points
        As for `solve_laplace`; all points inside.
    max_steps : int
        Steps a walk may take, the dimension of the integral.
    epsilon : float
        Shell in which a walk ends, as a part of the local size.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> problem = ng.problems.laplace([[0, 0], [1, 0], [1, 1], [0, 1]], [0.0, 1.0, 1.0, 0.0], [[0.5, 0.5]])
    >>> problem.dim, problem.batch
    (12, 1)
    """
    return LaplaceProblem.of(polygon, boundary, points, max_steps=max_steps, epsilon=epsilon)


def p_laplace(polygon: Any, boundary: Any, points: ArrayLike, p: float = 3.0) -> PLaplaceProblem:
    """p-harmonic functions by walks on spheres, which know of no p: what networks learn from (Appendix E.2).

    Parameters
    ----------
    polygon, boundary, points, p
        As for `solve_p_laplace`; all points inside.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> problem = ng.problems.p_laplace([[0, 0], [1, 0], [1, 1], [0, 1]], [0.0, 1.0, 1.0, 0.0], [[0.5, 0.5]], p=4.0)
    >>> problem.name, problem.p.tolist()
    ('p-laplace', [4.0])
    """
    return PLaplaceProblem.like(LaplaceProblem.of(polygon, boundary, points), p)


def transmittance(
    volume: Volume | Sequence[Volume],
    origins: ArrayLike,
    directions: ArrayLike,
    t_max: ArrayLike,
    *,
    support: str = "bounds",
) -> TransmittanceProblem:
    """Transmittances as integrals behind an exponential (Eq. 6).

    Parameters
    ----------
    volume : Volume or sequence of Volume
        One volume, or several of one kind that each see all rays.
    origins, directions, t_max
        As for `nqr_geom.render.transmittance`.
    support : {"bounds", "pieces"}
        Whether the integral is over a ray inside the volume's box, or only over what parts of its shape can reach.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> from nqr_geom import render
    >>> ball = render.Spheres([[0, 0, 0]], [1.0], [-5, -5, -5], [5, 5, 5])
    >>> ray = [[-9, 0, 0]], [[1, 0, 0]], 20.0
    >>> [ng.problems.transmittance(ball, *ray, support=s).rays.total.tolist() for s in ("bounds", "pieces")]
    [[10.0], [2.0]]
    """
    return TransmittanceProblem.of(volume, origins, directions, t_max, support=support)


def toy(n: int, seed: int = 0, split: str = "test") -> ToyProblem:
    """The first n integrands of the one-dimensional family of Fig. 37.

    Parameters
    ----------
    n : int
        How many.
    seed : int
        Which family.
    split : {"test", "train", "validation"}
        The same seed gives other integrands in another split.
    """
    return ToyProblem.family(n, seed=seed, split=split)
