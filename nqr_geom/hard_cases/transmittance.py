"""Transmittance where naive code breaks: nothing in the way, everything in the way, far worlds and grazed shapes.

Truths are closed forms and laws that hold whatever the medium: exp(-mu l), chords of balls, products along a ray,
scipy's error function, and no change where nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from nqr_geom import render
from nqr_geom.hard_cases.case import Case, deviation, refusal, sigmas
from nqr_geom.render.estimators import TRACKERS

__all__ = ["METHODS", "cases", "cloud"]

METHODS = ("random", "stratified", "trapezoid", "regression", "jackknife", "structured", *TRACKERS)
X = [1.0, 0.0, 0.0]
RAYS = np.array([[-1.0, 4.5, 4.5], [2.0, 5.0, 4.2], [-3.0, 6.1, 4.0]])
WAYS = np.array([[1.0, 0.02, 0.01], [0.9, 0.1, -0.1], [1.0, -0.1, 0.1]])
FOG = render.Homogeneous([0] * 3, [1] * 3)


def cloud(shift: float = 0.0, scale: float = 1.0, density: float = 1.0) -> render.Spheres:
    """Two balls with noise in a box of 10."""
    centers = shift + scale * np.array([[3.0, 5.0, 5.0], [6.0, 5.0, 4.0]])
    noise = render.Noise(amplitude=0.8, frequency=0.9 / scale, seed=1)
    box = [shift] * 3, [shift + 10.0 * scale] * 3
    return render.Spheres(centers, [1.5 * scale, 2.0 * scale], *box, density=density / scale, noise=noise)


def _through(volume: Any, *rays: Any, **how: Any) -> Any:
    return render.transmittance(volume, *rays, **how)


def _must(*conditions: object) -> float:
    """0 if all hold, else infinity."""
    return 0.0 if all(conditions) else float("inf")


def _nothing(method: str) -> float:
    """Zero length, a ray that misses, one that starts behind, one that ends before: exactly 1, and not one query."""
    origins = [[5, 5, 5], [-1, 20, 5], [11, 5, 5], [-5, 5, 5]]
    got = _through(cloud(), origins, [X] * 4, [0.0, 9.0, 9.0, 4.9], method=method, full_output=True)
    return max(deviation(got.value, 1.0), _must(got.counts["queries"] == got.counts["noise"] == 0))


def _naive_nothing() -> float:
    """The mean density along a ray is its depth over its length."""
    with np.errstate(invalid="ignore"):
        return deviation(np.exp(-(np.float64(0.0) / np.float64(0.0)) * 0.0), 1.0)


def _no_density(method: str) -> float:
    error = 0.0
    for empty in (render.Homogeneous([0] * 3, [1] * 3, 0.0), cloud(density=0.0)):
        got = _through(empty, RAYS, WAYS, 99.0, method=method, full_output=True)
        idle = got.counts["queries"] == 0 and got.effects == frozenset() and got.plan["kernels"] == ()
        error = max(error, deviation(got.value, 1.0), _must(idle))
    return error


def _density(method: str, density: float) -> float:
    """Depths from 1e-300 to 1e300: T may underflow to 0, the depth itself is told, nothing is NaN."""
    got = _through(cloud(density=density), RAYS, WAYS, 99.0, method=method, full_output=True)
    error = _must(np.isfinite(got.value).all(), np.isfinite(got.inner).all())
    if density < 1e-200:
        error = max(error, deviation(got.value, 1.0))
    if method == "structured" and density >= 30.0:
        error = max(error, _must((got.inner > 20.0).all(), (got.value <= np.exp(-20.0)).all()))
    return error


def _moved(method: str, shift: float, scale: float) -> float:
    """Against the plain world; noise sees its place in single precision."""
    plain = _through(cloud(), RAYS, WAYS, 12.0, method=method, n=16, seed=5)
    moved = _through(cloud(shift, scale), shift + scale * RAYS, WAYS, 12.0 * scale, method=method, n=16, seed=5)
    return deviation(moved / (plain + 5e-4), plain / (plain + 5e-4))


def _naive_moved() -> float:
    """Single precision from the door on: where a world of 10 lies 1e6 away, a place is known to 0.06."""
    return float(np.abs((RAYS + 1e6).astype(np.float32) - 1e6 - RAYS).max() / 10.0)


def _far_origin() -> float:
    """From 1e7 away, where a place is known to 2e-9, with directions 1e200 long."""
    near, ways = _through(cloud(), RAYS, WAYS, np.inf), WAYS / np.linalg.norm(WAYS, axis=1, keepdims=True)
    far = _through(cloud(), RAYS - 1e7 * ways, 1e200 * ways, np.inf)
    return deviation(far[[0, 2]] / near[[0, 2]], [1.0, 1.0])


def _short_directions() -> float:
    near, ways = _through(cloud(), RAYS, WAYS, np.inf), WAYS / np.linalg.norm(WAYS, axis=1, keepdims=True)
    return deviation(_through(cloud(), RAYS, 1e-200 * ways, np.inf) / near, np.ones(3))


def _parts(law: str) -> float:
    """T(a,c) = T(a,b) T(b,c), and a reversed ray, on a linear density where a cubic is exact."""
    axis = np.linspace(0.0, 2.0, 3)
    grid = render.Grid(0.1 + axis[:, None, None] + np.zeros((3, 2, 2)), [0] * 3, [2, 1, 1])
    start, way = np.array([0.1, 0.2, 0.3]), np.array([0.8, 0.3, 0.2])
    way /= np.linalg.norm(way)

    def through(a: float, b: float) -> float:
        return float(_through(grid, [start + a * way], [(b - a) * way], abs(b - a), method="regression")[0])

    other = through(0.0, 0.6) * through(0.6, 1.5) if law == "product" else through(1.5, 0.0)
    return abs(through(0.0, 1.5) / other - 1.0)


def _constant_grid(method: str) -> float:
    grid = render.Grid(np.full((3, 4, 5), 0.8), [0] * 3, [1, 2, 3])
    fog = render.Homogeneous([0] * 3, [1, 2, 3], density=0.8)
    rays = [[-1, 1, 1], [0.5, 0.5, -9]], [[1, 0.1, 0], [0, 0.1, 1]], 20.0
    same = deviation(_through(grid, *rays, method=method), _through(fog, *rays, method=method))
    return max(same, _must(grid.effects() == fog.effects() == {"homogeneous"}))


def _faces() -> float:
    """Rays along faces and edges count as inside, one a billionth beside does not."""
    fog = render.Homogeneous([0] * 3, [1] * 3, density=1.0)
    starts = [[-1, 0, 0.5], [-1, 1, 1], [-1, 0, 1 + 1e-9], [0, 0, 0]]
    got = _through(fog, starts, [X] * 3 + [[1, 1, 1]], 9.0)
    return deviation(got / np.exp([-1.0, -1.0, 0.0, -np.sqrt(3.0)]), np.ones(4))


def _touched() -> float:
    """Tangent, within rounding, and through a ball of 1e-9: a number next to 1."""
    balls = render.Spheres([[0, 0, 0], [3, 0, 0]], [1.0, 1e-9])
    starts = [[-5, 1, 0], [-5, 1 - 1e-12, 0], [-5, 0.999999, 0]]
    return deviation(_through(balls, starts, [X] * 3, 9.0, method="structured"), 1.0)


def _any_number(method: str) -> float:
    """One sample and many: finite, from 0 on, and no more than unbiased noise above 1."""
    values = [_through(cloud(), RAYS, WAYS, 12.0, method=method, n=n, seed=1) for n in (1, 2, 3, 257)]
    return _must(all(np.isfinite(value).all() for value in values))


def _fog(method: str, depth: float) -> float:
    """exp(-mu l) with no variance, from next to nothing to a denormal number; the depth itself to rounding."""
    fog = render.Homogeneous([0] * 3, [1] * 3, density=depth)
    got = _through(fog, [[-1, 0.5, 0.5]], [X], 9.0, method=method, full_output=True)
    return max(deviation(got.value[0], np.exp(-depth), max(np.exp(-depth), 5e-324)), abs(got.inner[0, 0] / depth - 1.0))


def _gaussian() -> float:
    """A Gaussian density on a fine grid: an error function, up to the grid's own interpolation."""
    from scipy.special import erf

    x = np.linspace(-1.0, 1.0, 401)
    grid = render.Grid(3.0 * np.exp(-8.0 * x**2)[:, None, None] + np.zeros((401, 2, 2)), [-1] * 3, [1] * 3)
    depth = 3.0 * np.sqrt(np.pi / 8.0) * erf(np.sqrt(8.0))
    got = _through(grid, [[-5, 0, 0]], [X], 20.0, method="trapezoid", n=4096, full_output=True)
    return float(abs(got.inner[0, 0] / depth - 1.0))


def _exponential() -> float:
    x = np.linspace(0.0, 1.0, 401)
    grid = render.Grid(np.exp(3.0 * x)[:, None, None] + np.zeros((401, 2, 2)), [0] * 3, [1] * 3)
    got = _through(grid, [[-5, 0.5, 0.5]], [X], 20.0, method="trapezoid", n=4096, full_output=True)
    return float(abs(got.inner[0, 0] / (np.expm1(3.0) / 3.0) - 1.0))


def _linear_grid() -> render.Grid:
    return render.Grid(np.linspace(0.0, 4.0, 3)[:, None, None] + np.zeros((3, 2, 2)), [0] * 3, [1] * 3)


def _tracked(method: str) -> float:
    """4,000 rays through a linear density of depth 2, one run each: their mean in standard errors."""
    m = 4000
    got = _through(_linear_grid(), [[-1.0, 0.5, 0.5]] * m, [X] * m, 9.0, method=method, n=1)
    return sigmas(np.mean(got), np.std(got) / np.sqrt(m), np.exp(-2.0))


def _ratio_variance() -> float:
    """Ratio tracking has variance exp(-2 tau)(exp(integral of mu^2 / majorant) - 1) a run, relative."""
    m, density = 20_000, _linear_grid()
    got = _through(density, [[-1.0, 0.5, 0.5]] * m, [X] * m, 9.0, method="ratio", n=1, full_output=True)
    runs = got.counts.get("runs", m) / m
    truth = np.exp(-4.0) * np.expm1((16.0 / 3.0) / 4.0) / runs
    return float(abs(np.var(got.value) / truth - 1.0))


def _two_balls() -> float:
    """The union of two equal balls one behind the other: chords add up."""
    balls = render.Spheres([[0, 0, 0], [3, 0, 0]], [1.0, 1.0], density=0.5)
    got = _through(balls, [[-9, 0.6, 0]], [X], 99.0, method="structured", n=64, full_output=True)
    ball = _through(
        render.Spheres([[0, 0, 0]], [1.0], density=0.5), [[-9, 0.6, 0]], [X], 99.0, method="structured", n=64
    )
    return float(abs(got.value[0, 0] / ball[0] ** 2 - 1.0))


def _refused() -> list[tuple[str, Callable[[], object], str, type[Exception]]]:
    one: list[Any] = [[0] * 3]
    table: list[tuple[str, Callable[[], object], str]] = [
        ("an origin of two numbers", partial(_through, FOG, [[0, 0]], [X], 1.0), r"origins: expected shape \(m, 3\)"),
        ("an origin that is no number", partial(_through, FOG, [[0, 0, np.nan]], [X], 1.0), "origins: expected finite"),
        ("too many directions", partial(_through, FOG, one, [X] * 2, 1.0), r"directions: expected shape \(1, 3\)"),
        ("no direction", partial(_through, FOG, one, one, 1.0), "directions: expected none of zero"),
        ("a negative length", partial(_through, FOG, one, [X], -1.0), "t_max: expected lengths >= 0, got -1"),
        ("a length that is no number", partial(_through, FOG, one, [X], np.nan), "t_max: expected lengths >= 0, got"),
        ("too many lengths", partial(_through, FOG, one, [X], [1, 2]), r"t_max: expected shape \(1,\)"),
        ("no samples", partial(_through, FOG, one, [X], 1.0, n=0), "n: expected an integer >= 1, got 0"),
        ("no such method", partial(_through, FOG, one, [X], 1.0, method="x"), "method: .*jackknife.*got 'x'"),
        ("a flat box", partial(render.Homogeneous, [0] * 3, [1, 1, 0]), "high: expected more than low"),
        ("a negative density", partial(render.Homogeneous, [0] * 3, [1] * 3, -1.0), "density: expected a number >= 0"),
        ("a box beyond squares", partial(render.Homogeneous, [0] * 3, [1e200] * 3), "high: expected a box between"),
        ("one node", partial(render.Grid, np.ones((1, 2, 2)), [0] * 3, [1] * 3), "data: expected at least two nodes"),
        ("negative data", partial(render.Grid, -np.ones((2, 2, 2)), [0] * 3, [1] * 3), "data: expected densities >= 0"),
        ("a ball of no size", partial(render.Spheres, one, [0.0]), "radii: expected numbers > 0, got 0"),
        ("no balls", partial(render.Spheres, np.empty((0, 3)), []), "centers: expected at least one"),
        ("too many radii", partial(render.Spheres, one, [1.0, 2.0]), r"radii: expected shape \(1,\)"),
        ("no axis", partial(render.Torus, [0] * 3, [0] * 3, 2, 1), "axis: expected a direction, got zero"),
        ("a tube wider than its ring", partial(render.Torus, [0] * 3, X, 1, 2), "major: expected a number >= 2"),
        ("letters in one dimension", partial(render.Extrusion, np.ones(3), 1, 1, one[0], [1] * 3),
         r"distance: expected shape \(nx, ny\)"),
        ("negative thickness", partial(render.Extrusion, np.ones((2, 2)), -1, 1, one[0], [1] * 3),
         "thickness: expected a number >= 0"),
        ("negative noise", partial(render.Noise, amplitude=-1), "amplitude: expected a number >= 0"),
        ("no octaves", partial(render.Noise, octaves=0), "octaves: expected an integer >= 1"),
        ("octaves that grow", partial(render.Noise, gain=1.5), "gain: expected a number"),
    ]  # fmt: skip
    balls: Any = partial(render.Spheres, one, [1.0])
    kinds: list[tuple[str, Callable[[], object], str]] = [
        ("no volume", partial(_through, 1.0, one, [X], 1.0), "volume: expected a Volume"),
        ("half a seed", partial(_through, FOG, one, [X], 1.0, seed=0.5), "seed: expected an integer"),
        ("noise that is a number", partial(balls, noise=3), "noise: expected a Noise or None, got 3"),
    ]
    return [*((*row, ValueError) for row in table), *((*row, TypeError) for row in kinds)]


def cases() -> list[Case]:
    """Light through volumes."""
    group, made = "transmittance", []

    def add(name: str, run: Callable[[], float], bound: float, naive: Callable[[], float] | None = None) -> None:
        made.append(Case(group, name, run, bound, naive))

    for method in METHODS:
        add(f"nothing in the way [{method}]", partial(_nothing, method), 0.0, _naive_nothing)
        add(f"no density is no work [{method}]", partial(_no_density, method), 0.0)
        for density in (1e-300, 30.0, 1e4, 1e300):
            name = f"any density gives a number [{density:g}, {method}]"
            if method in TRACKERS and density > 1e5:  # a run takes as many steps as the majorant's depth
                call = partial(_through, cloud(density=density), RAYS, WAYS, 99.0, method=method)
                words = f"volume: expected majorant times length up to 1e.06 for method {method!r}"
                made.append(refusal(group, name, call, words))
            else:
                add(name, partial(_density, method, density), 0.0)
        for shift, scale in ((1e6, 1.0), (0.0, 1e-6), (0.0, 1e6), (-64.0, 0.25)):
            run = partial(_moved, method, shift, scale)
            add(
                f"a world moved and scaled [{shift:g}, {scale:g}, {method}]",
                run,
                2e-6,
                _naive_moved if shift > 0 else None,
            )
        add(f"a constant grid is fog [{method}]", partial(_constant_grid, method), 0.0)
        add(f"one sample and many [{method}]", partial(_any_number, method), 0.0)
    for method in TRACKERS:
        add(f"mean of 4,000 rays through a linear density [{method}]", partial(_tracked, method), 4.0)
    for depth in (1e-12, 1.0, 100.0, 740.0):
        add(f"fog of any depth [{depth:g}]", partial(_fog, "stratified", depth), 1e-12 if depth < 200 else 2e-2)
    add("variance of a tracked ratio", _ratio_variance, 0.15)
    add("an origin 1e7 away, directions 1e200 long", _far_origin, 1e-5)
    add("directions 1e-200 long", _short_directions, 1e-12)
    add("parts of a ray multiply", partial(_parts, "product"), 1e-12)
    add("a ray reversed", partial(_parts, "reversal"), 1e-12)
    add("along faces and edges", _faces, 1e-12)
    add("a ball that is touched", _touched, 1e-8)
    add("two balls one behind the other", _two_balls, 1e-5)
    add("a Gaussian density", _gaussian, 1e-4)
    add("an exponential density", _exponential, 1e-4)
    made += [refusal(group, name, call, words, error) for name, call, words, error in _refused()]
    return made
