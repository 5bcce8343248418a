"""The user's own curve, polygon, volume or scene as applications."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.curves.curve import BlackBoxCurve, Curve
from nqr_geom.integrator.estimate import Estimate
from nqr_geom.reporting.applications import Application, on_curves, on_pixels, on_rays, toward_laplace, toward_p_laplace
from nqr_geom.reporting.contenders import Contender
from nqr_geom.reporting.settings import Sizes

__all__ = ["Own", "own"]

Floats = NDArray[np.float64]

_MESHES = (".ply", ".obj", ".stl", ".vtk", ".vtp")
_PIECES = 6  # pieces of a curve for which the usual numbers of samples are meant
_FINEST, _COARSEST = 1e-4, 1e-2  # of a curve's size: how far a flattened outline may be off


@dataclass(frozen=True)
class Own:
    """What a user brought.

    Attributes
    ----------
    label : str
        What the page calls it.
    identity : str
        Tells one input from another when a report goes on.
    makers : dict
        Name of each application that fits -> ``maker(sizes)``.
    unfit : dict
        Name of each that does not -> why.
    """

    label: str
    identity: str
    makers: Mapping[str, Callable[[Sizes], Application]]
    unfit: Mapping[str, str]


def own(given: Any, text: bool = False) -> Own:
    """Read what a user names or hands over.

    Parameters
    ----------
    given : str, path, Curve, Scene, Volume, or (n, 2) array_like
        An SVG file, path data, a .npy file with the points of a polyline (n, 2) or with densities (nx, ny, nz), a .json
        scene, a mesh file, or the object itself. An array is a polyline, closed if it ends where it begins.
    text : bool
        Take a string as text and use its outlines.

    Raises
    ------
    ValueError, TypeError
        If there is no such file or it holds none of these.

    Examples
    --------
    >>> sorted(own([[0, 0], [1, 0], [1, 1], [0, 0]]).makers)
    ['gwn', 'laplace', 'p-laplace', 'sd']
    """
    from nqr_geom.render.scene import Scene
    from nqr_geom.render.volume import Volume

    if isinstance(given, BlackBoxCurve):
        raise ValueError("input: expected a curve whose pieces are known, got a black box: there is no true answer")
    if isinstance(given, Curve):
        return _curve(given, repr(given), sha256(given.control.tobytes()).hexdigest())
    if isinstance(given, Scene):
        return _scene(given, "a scene", "scene object")
    if isinstance(given, Volume):
        return _volume(given, "a volume", repr(given))
    if isinstance(given, (str, Path)):
        return _named(str(given), text)
    points = np.asarray(given)
    made = _polyline(points)
    return _curve(made, f"{len(points)} points", sha256(made.control.tobytes()).hexdigest())


def _named(source: str, text: bool) -> Own:
    """What a string names."""
    if text:
        return _curve(Curve.from_text(source), f"the text {source!r}", f"text {source}")
    ending = Path(source).suffix.lower()
    if ending == ".json" or ending in _MESHES:
        from nqr_geom.render.scene_file import scene_named

        return _scene(scene_named(source, 64, 48), Path(source).name, _contents(source))
    if ending == ".npy":
        identity = _contents(source)
        data = np.load(source, allow_pickle=False)
        if data.ndim == 3:
            from nqr_geom.through import named_volume

            return _volume(named_volume(source), Path(source).name, identity)
        return _curve(_polyline(data), Path(source).name, identity)
    curve = Curve.from_svg(source, flip_y=True)
    if ending == ".svg":
        return _curve(curve, Path(source).name, _contents(source))
    return _curve(curve, f"path data of {curve.n_pieces} pieces", sha256(source.encode()).hexdigest())


def _contents(source: str) -> str:
    if not Path(source).is_file():
        raise ValueError(f"input: expected an existing file, got {source!r}")
    return sha256(Path(source).read_bytes()).hexdigest()


def _polyline(points: Any) -> Curve:
    closed = bool(len(points) > 2 and np.array_equal(points[0], points[-1]))
    return Curve.polyline(points[:-1] if closed else points, closed=closed)


def _curve(curve: Curve, label: str, identity: str) -> Own:
    """Winding numbers and distances, and what lives inside an outline that is one."""
    from nqr_geom.wos.domain import Domain

    if not curve.n_pieces or curve.length <= 0.0:
        raise ValueError(f"input: expected a curve of positive length, got {label}")
    makers = {name: partial(_on_curve, name, curve, label) for name in ("gwn", "sd")}
    unfit = dict.fromkeys(("toy", "transmittance", "direct"), "it needs no curve")
    try:
        Domain.of(curve, _COARSEST)
    except ValueError as error:
        unfit |= dict.fromkeys(("laplace", "p-laplace"), str(error))
    else:
        makers |= {name: partial(_inside, name, curve, label) for name in ("laplace", "p-laplace")}
    return Own(label, identity, makers, unfit)


def _on_curve(name: str, curve: Curve, label: str, sizes: Sizes) -> Application:
    """Queries on a grid around the curve, none closer to it than 1e-3 of its size."""
    from nqr_geom.pictures import Window

    size = max(curve.bounds[2] - curve.bounds[0], curve.bounds[3] - curve.bounds[1])
    places = Window.around(curve.bounds, 2 * sizes.grid).points
    places = places[ng.distance(curve, places) >= 1e-3 * size]
    alpha = 35.0 / (0.5 * size)
    problem = ng.problems.gwn(curve, places) if name == "gwn" else ng.problems.sd(curve, places, alpha)
    made = on_curves(name, f"{len(places):,} queries around {label}", problem, sizes.everything)
    pieces = curve.n_pieces
    if pieces <= _PIECES:
        return made
    # Networks that know few pieces see a long curve in parts, as the public functions show it to them.
    contenders = [_in_parts(one, name, curve, places, alpha) for one in made.contenders]
    return replace(made, contenders=contenders, scale=2 ** int(np.ceil(np.log2(pieces / _PIECES))))


def _in_parts(one: Contender, name: str, curve: Curve, places: Floats, alpha: float) -> Contender:
    most = registry.entry("rule", one.pair[1]).pieces if one.pair[1] else 0
    if not most or curve.n_pieces <= most:
        return one
    parts = len(curve.split_pieces(most))
    options = {"alpha": alpha} if name == "sd" else {}

    def answer(n: int, seed: int) -> Estimate:
        function: Any = getattr(ng, name)
        estimate: Estimate = function(
            curve, places, method="+".join(one.pair), n=n // parts, seed=seed, full_output=True, **options
        )
        return estimate

    def refused(n: int) -> str | None:
        return None if n >= 4 * parts else f"{n} samples are fewer than 4 for each of {parts} parts of the curve"

    return replace(one, answer=answer, refused=refused)


def _inside(name: str, curve: Curve, label: str, sizes: Sizes) -> Application:
    """Three waves of boundary values around the middle, queries on a grid inside."""
    from nqr_geom.pde import _polygon
    from nqr_geom.pictures import Window
    from nqr_geom.wos.domain import Domain
    from nqr_geom.wos.problems import LaplaceProblem

    flatness = _FINEST
    domain = Domain.of(curve, flatness)
    while len(domain) > sizes.edges and flatness < _COARSEST:  # dense systems of equations grow with the edges
        flatness *= 4.0
        domain = Domain.of(curve, flatness)
    low, high = np.reshape(curve.bounds, (2, 2))
    middle = 0.5 * (low + high)

    def waves(points: Floats) -> Floats:
        x, y = (points - middle).T
        result: Floats = np.cos(3.0 * np.arctan2(y, x))
        return result

    places = Window.around(curve.bounds, 2 * sizes.grid, margin=0.0).points
    places = places[domain.inside(places)]
    if not len(places):
        raise ValueError(f"input: expected an outline with room inside, none of the queries in the box of {label} is")
    problem = LaplaceProblem.of(domain, waves, places)
    inputs = f"{len(places):,} queries inside {label}, flattened to {len(domain)} edges, boundary values cos(3 angle)"
    make = toward_laplace if name == "laplace" else toward_p_laplace
    return make(inputs, problem, [(_polygon(domain, curve), waves)], sizes)


def _scene(scene: Any, label: str, identity: str) -> Own:
    def direct(sizes: Sizes) -> Application:
        problem = ng.problems.direct(scene)
        return on_pixels(f"{problem.batch:,} pixels of {label}", problem, sizes.everything)

    return Own(label, identity, {"direct": direct}, _others("direct", "it needs no scene"))


def _volume(volume: Any, label: str, identity: str) -> Own:
    def transmittance(sizes: Sizes) -> Application:
        from nqr_geom.render.volume_families import view

        problem = ng.problems.transmittance(volume, *view(volume, 2 * sizes.rays))
        return on_rays(f"{problem.batch:,} rays through {label}", problem, sizes.everything)

    return Own(label, identity, {"transmittance": transmittance}, _others("transmittance", "it needs no volume"))


def _others(fits: str, reason: str) -> dict[str, str]:
    from nqr_geom.reporting.applications import APPLICATIONS

    return dict.fromkeys((name for name in APPLICATIONS if name != fits), reason)
