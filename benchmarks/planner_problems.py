"""Questions on which costs and errors are measured (split "validation") and plans are judged (split "test").

A case is one call as a user makes it: a curve, a polygon, a volume or a scene with its queries and their true answers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import nqr_geom as ng
from nqr_geom.curves.families import fourier, lissajous
from nqr_geom.integrator.plan import Way
from nqr_geom.integrator.ways import sampled_way

Floats = np.ndarray


@dataclass(frozen=True)
class Case:
    """One question.

    Parameters
    ----------
    points : ndarray, (m, ...)
        Queries; rays are rows of six numbers, pixels are numbers.
    truth : ndarray, (m, C)
    scale, size : float
        As in `Goal`.
    ways : callable
        ``ways(points, methods)`` are the ways in which the door would answer.
    ask : callable
        ``ask(points, **options)`` is the public function with full output.
    label : str
    floor : float
        How far the truth itself may be off.
    """

    points: Floats
    truth: Floats
    scale: float
    size: float
    ways: Callable[[Floats, list[str]], list[Way]]
    ask: Callable[..., Any]
    label: str
    floor: float = 1e-12

    def way(self, method: str) -> Way:
        """One method on all queries."""
        return self.ways(self.points, [method])[0]

    def of_rows(self, m: int) -> Case:
        """The same question with m queries, over and over the same ones."""
        index = np.arange(m) % len(self.points)
        return replace(self, points=self.points[index], truth=self.truth[index])


# --- curves ---------------------------------------------------------------------------------------------


def _off(curve: Any, count: int, seed: int) -> Floats:
    """Queries in [-1, 1]^2 that are 1e-3 and more from the curve, as in the family."""
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (4 * count, 2))
    return points[ng.distance(curve, points) > 1e-3][:count]


def _on_curve(name: str, curve: Any, known: Any, points: Floats, label: str) -> Case:
    """A winding number or a smoothed distance; `known` is the curve that gives the truth."""
    from nqr_geom.plans import curve_unit, curve_ways

    make = {"gwn": ng.problems.gwn, "sd": ng.problems.sd}[name]
    answer = {"gwn": ng.gwn, "sd": ng.sd}[name]

    def ways(points: Floats, methods: list[str]) -> list[Way]:
        return curve_ways(name, curve, lambda: answer(curve, points), lambda c: make(c, points), seed=0,
                          methods=methods)  # fmt: skip

    def ask(points: Floats, **options: Any) -> Any:
        return answer(curve, points, full_output=True, **options)

    truth = answer(known, points)[:, None]
    return Case(points, truth, **curve_unit(name, curve), ways=ways, ask=ask, label=label)


def _curves(name: str, split: str, count: int, queries: int) -> list[Case]:
    base = 1000 if split == "validation" else 5000
    cases = []
    for k, curve in enumerate(ng.datasets.curves(count, seed=11, split=split)):
        cases.append(_on_curve(name, curve, curve, _off(curve, queries, base + k), f"shape {k}"))
    word = ng.Curve.from_text("Nq" if split == "validation" else "Rg", size=1.0)
    xmin, ymin, xmax, ymax = word.bounds
    points = np.random.default_rng(base + 99).uniform([xmin, ymin], [xmax, ymax], (4 * queries, 2))
    points = points[ng.distance(word, points) > 1e-3][:queries]
    return [*cases, _on_curve(name, word, word, points, "letters")]


def _callables(name: str, split: str, count: int, queries: int) -> list[Case]:
    """Black boxes: shapes of the family, and smooth curves that no polynomial is."""
    base = 2000 if split == "validation" else 6000
    cases = []
    for k, curve in enumerate(ng.datasets.curves(count, seed=12, split=split)):
        box = ng.Curve.from_callable(curve.sample, pieces=curve.n_pieces)
        cases.append(_on_curve(name, box, curve, _off(curve, queries, base + k), f"shape {k}"))
    smooth = {f"fourier {k}": (fourier(seed=40 + k, split=split), 4) for k in range(2)}
    smooth["lissajous"] = (lissajous(*((3, 2) if split == "validation" else (3, 4))), 8)
    for k, (label, (closed, pieces)) in enumerate(smooth.items()):
        # Not all of it: around a closed curve a winding number is an integer, which is easy to be right about.
        box = ng.Curve.from_callable(lambda s, closed=closed: closed.sample(0.8 * s), pieces=pieces)
        fine = ng.Curve.polyline(closed.sample(0.8 * np.arange(2**15 + 1) / 2**15))
        points = _off(fine, queries, base + 50 + k)
        cases.append(_on_curve(name, box, fine, points, label))
    return cases


# --- the others -----------------------------------------------------------------------------------------


def _laplace(split: str, count: int, queries: int) -> list[Case]:
    from nqr_geom.pde import ways_of
    from nqr_geom.wos.domain import Domain
    from nqr_geom.wos.families import polygons
    from nqr_geom.wos.families import queries as inside

    vertices, values = polygons(count, seed=13, split=split)
    given = [(f"star {k}", v, u) for k, (v, u) in enumerate(zip(vertices, values, strict=True))]
    outlines = ng.datasets.outlines()
    for label in list(outlines)[:1] if split == "validation" else list(outlines)[1:2]:
        shape = np.asarray(outlines[label].vertices)
        given.append((label, shape, np.sin(3.0 * shape[:, 0]) + shape[:, 1]))
    cases = []
    for k, (label, shape, data) in enumerate(given):
        domain = Domain.of(shape)
        points = inside(domain, queries, k, 14, split)
        truth = ng.solve_laplace(shape, data, points, method="boundary", tol=1e-9)[:, None]

        def ways(points: Floats, methods: list[str], shape: Any = shape, data: Any = data) -> list[Way]:
            return ways_of(shape, data, points, methods)

        def ask(points: Floats, shape: Any = shape, data: Any = data, **options: Any) -> Any:
            return ng.solve_laplace(shape, data, points, full_output=True, **options)

        cases.append(Case(points, truth, float(np.ptp(data)), float(len(shape)), ways, ask, label))
    return cases


def _transmittance(split: str, count: int, queries: int) -> list[Case]:
    from nqr_geom import render
    from nqr_geom.render.plans import transmittance_ways
    from nqr_geom.render.problems import TransmittanceProblem

    cases = []
    for k, volume in enumerate(ng.datasets.volumes(count, seed=15, split=split)):
        rng = np.random.default_rng(3000 + k)
        origins = np.column_stack([rng.uniform(0.5, 9.5, (queries, 2)), np.full(queries, -1.0)])
        rays = np.concatenate([origins, np.broadcast_to([0.0, 0.0, 1.0], (queries, 3))], axis=1)

        def ways(rays: Floats, methods: list[str], volume: Any = volume) -> list[Way]:
            return transmittance_ways(
                lambda support: TransmittanceProblem.of(volume, rays[:, :3], rays[:, 3:], np.inf, support=support),
                methods, seed=0,
            )  # fmt: skip

        def ask(rays: Floats, volume: Any = volume, **options: Any) -> Any:
            return render.transmittance(volume, rays[:, :3], rays[:, 3:], np.inf, full_output=True, **options)

        truth = TransmittanceProblem.of(volume, rays[:, :3], rays[:, 3:], np.inf).reference()
        cases.append(Case(rays, truth, 1.0, 1.0, ways, ask, f"cloud {k}", 2e-5))
    return cases


def _direct(split: str, count: int, pixels: int) -> list[Case]:
    from nqr_geom import render
    from nqr_geom.render.direct_problem import DirectProblem
    from nqr_geom.render.plans import direct_ways

    cases = []
    for k, scene in enumerate(ng.datasets.scenes(count, seed=16, split=split, resolution=pixels)):
        problem = DirectProblem.of(scene)
        truth = problem.reference()

        def ways(points: Floats, methods: list[str], problem: Any = problem, scene: Any = scene) -> list[Way]:
            if len(points) > problem.batch:
                side = round(len(points) ** 0.5)
                camera = replace(scene.camera, width=side, height=side)
                problem = DirectProblem.of(replace(scene, camera=camera))
            return direct_ways(problem, methods, seed=0)

        def ask(points: Floats, scene: Any = scene, **options: Any) -> Any:
            return render.direct(scene, full_output=True, **options)

        scale = float(truth.mean())
        cases.append(Case(np.arange(problem.batch), truth, scale, 1.0, ways, ask, f"scene {k}", 5e-3 * scale))
    return cases


def _toy(split: str, count: int) -> list[Case]:
    whole = ng.problems.toy(count, seed=17, split=split)

    def ways(points: Floats, methods: list[str]) -> list[Way]:
        problem = ng.problems.toy(len(points), seed=17, split=split)
        return [sampled_way(problem, method, seed=0, least=4) for method in methods]

    def ask(points: Floats, **options: Any) -> Any:
        return ng.integrate(ng.problems.toy(len(points), seed=17, split=split), **options)

    return [Case(np.arange(count), np.asarray(whole.reference()), 1.0, 1.0, ways, ask, "toy")]


def cases(name: str, split: str) -> list[Case]:
    """The questions of one application in a split."""
    some = split == "test"
    if name in ("gwn", "sd"):
        return _curves(name, split, 5 if some else 3, 150)
    if name in ("gwn-callable", "sd-callable"):
        return _callables(name.partition("-")[0], split, 4 if some else 3, 120)
    if name == "laplace":
        return _laplace(split, 5 if some else 3, 30)
    if name == "transmittance":
        return _transmittance(split, 5 if some else 4, 150)
    if name == "direct":
        return _direct(split, 4 if some else 3, 12)
    return _toy(split, 300)


_SAMPLED = ["1", "n", "rows", "rows*n"]
_SORTED = [*_SAMPLED, "rows*n*n"]
_PLAIN_TIMES: dict[str, Any] = {"cases": 1, "rows": (20, 1000), "n": (32, 256), "terms": _SAMPLED}
_BOX_TIMES: dict[str, Any] = {"cases": 1, "rows": (20, 500), "n": (32, 256), "terms": _SAMPLED}
_LONG = (16, 64, 256, 1024)
_SHORT = (12, 16, 24, 32, 48, 64, 128, 256)


def _on_curves(times: dict[str, Any]) -> dict[str, dict[str, Any]]:
    plain = {"sizes": _LONG, "times": times}
    structured = {"sizes": _SHORT, "times": {**times, "terms": _SORTED}}
    return {"structured": structured, "trapezoid": plain, "stratified": plain, "mc": plain}


_EXACT: dict[str, Any] = {"tols": (1e-9,), "rows": (10, 1000), "terms": ["1", "size", "rows", "rows*log"]}
_WALKS: dict[str, Any] = {"cases": 1, "rows": (10, 100), "n": (32, 128), "terms": _SORTED}
_RAYS: dict[str, Any] = {"cases": 1, "rows": (20, 1000), "n": (8, 32, 128), "terms": _SORTED}

STUDIES: dict[str, dict[str, dict[str, Any]]] = {
    "gwn": {"exact": _EXACT, **_on_curves(_PLAIN_TIMES)},
    "sd": {"exact": _EXACT, **_on_curves(_PLAIN_TIMES)},
    "gwn-callable": _on_curves(_BOX_TIMES),
    "sd-callable": _on_curves(_BOX_TIMES),
    "laplace": {
        "boundary": {"tols": (1e-8,), "rows": (10, 40, 1000), "terms": ["1", "size", "size*size", "rows", "rows*size"]},
        "fem": {"tols": (1e-1, 1e-2, 1e-3), "rows": (40, 2000), "terms": ["1", "n", "size", "rows"], "threads": False},
        "wos": {"sizes": (16, 64, 256, 1024), "times": {**_WALKS, "terms": _SAMPLED, "n": (64, 1024)}},
        "structured": {"sizes": (8, 16, 32, 64, 128), "times": _WALKS},
        "wos-lhs": {"sizes": (8, 16, 32, 64, 128, 512), "times": _WALKS},
        "wos-rqmc": {"sizes": (8, 16, 32, 64, 128, 512), "times": _WALKS},
    },
    "transmittance": {
        "structured": {"sizes": (6, 8, 12, 16, 24, 32, 64, 128), "times": _RAYS},
        "stratified": {"sizes": (4, 8, 16, 32, 64, 256, 1024), "times": _RAYS},
        "trapezoid": {"sizes": (4, 8, 16, 32, 64, 256, 1024), "times": _RAYS},
        "random": {"sizes": (16, 64, 256, 1024), "times": _RAYS},
    },
    "direct": {
        "structured": {"sizes": (2, 4, 8, 16, 32, 64, 128), "times": {**_RAYS, "rows": (144, 1024)}},
        "mis": {"sizes": (2, 4, 8, 16, 32, 64, 128), "times": {**_RAYS, "rows": (144, 1024)}},
        "random": {"sizes": (4, 8, 16, 32, 64, 128), "times": {**_RAYS, "rows": (144, 1024)}},
    },
    "toy": {
        "structured": {"sizes": (12, 16, 24, 32, 48, 64, 128), "times": {**_RAYS, "rows": (20, 300)}},
        "trapezoid": {"sizes": _LONG[:3], "times": {**_RAYS, "rows": (20, 300)}},
        "stratified": {"sizes": _LONG[:3], "times": {**_RAYS, "rows": (20, 300)}},
    },
}
