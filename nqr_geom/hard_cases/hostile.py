"""Inputs that trained models were not made for, fixed before any model was measured on them.

Each is a batch of integrals with known answers and a way to place their samples. A list belongs to a problem; every
model of that problem is held to all of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import shapely
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.curves.curve import Curve
from nqr_geom.curves.problems import GwnProblem, SdProblem
from nqr_geom.hard_cases.laplace import CHANNEL, COMB, ELL, SIEVE, UNIT
from nqr_geom.hard_cases.shapes import SQUARE, circle_of_cubics, joined, koch, ring, scaled
from nqr_geom.integrator.problem import Problem
from nqr_geom.integrator.samplers import FixedDesign, Random
from nqr_geom.streams import Stream
from nqr_geom.toy.family import Pieces, Shape, draw
from nqr_geom.toy.problem import ToyProblem

__all__ = ["KINDS", "Hostile", "hostile"]

KINDS = ("far outside", "constant", "extreme values", "repeated samples", "few or many samples")

Floats = NDArray[np.float64]


_RANDOM = Random()


@dataclass(frozen=True)
class Hostile:
    """A batch that a model was not made for.

    Parameters
    ----------
    name : str
        What is hostile about it.
    kind : str
        One of `KINDS`; squared errors are averaged over all of a kind.
    make : callable
        The integrals.
    answer : callable
        True answers (B, 1) of the problem.
    n : int
        Samples an integral.
    design : FixedDesign
        Where samples lie, for rules that take any; models with a sampler of their own place them themselves.
    unit : float
        Errors are counted in it: the size of values, one turn, or the spread of boundary data.
    """

    name: str
    kind: str
    make: Callable[[], Problem]
    answer: Callable[[Any], Floats]
    n: int = 32
    design: FixedDesign = _RANDOM
    unit: float = 1.0


class Placed(FixedDesign):
    """Random points pressed through a map of (0, 1): repeated, crowded or at the ends."""

    def __init__(self, name: str, to: Callable[[Tensor], Tensor]) -> None:
        self.name = name
        self.to = to

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        return self.to(Random().points(rows, n, dim, stream))


TWICE = Placed("each twice", lambda x: torch.cat([x[:, ::2], x[:, ::2]], dim=1)[:, : x.shape[1]])
ONCE = Placed("all one", lambda x: x[:, :1].expand_as(x).contiguous())
CORNER = Placed("all in a corner", lambda x: 0.01 * x)
ENDS = Placed("both ends among them", lambda x: torch.cat([0.0 * x[:, :1], x[:, 2:], 0.0 * x[:, :1] + 1.0], dim=1))
CROWDED = Placed("crowded within 1e-12", lambda x: 0.3 + 1e-12 * x)
_DESIGNS = (TWICE, ONCE, CORNER, ENDS, CROWDED)

# ------------------------------------------------------------------------------------------------------------ toy

_ROWS = torch.arange(100)


def _toy(shape: Shape | None = None, times: float = 1.0, plus: float = 0.0, edges: Any = None) -> ToyProblem:
    """Pieces of a shape, scaled and shifted, perhaps between other breaks."""
    pieces = draw(_ROWS, Stream(3, "test", "hostile"), shape)
    if edges is not None:
        pieces = replace(pieces, edges=torch.tensor(edges, dtype=torch.float64).expand_as(pieces.edges).contiguous())
    scaled = {name: times * getattr(pieces, name) for name in ("slope", "curvature")}
    return ToyProblem(_ROWS, pieces=replace(pieces, value=times * pieces.value + plus, **scaled))


def _constant(value: float) -> ToyProblem:
    zero = torch.zeros(100, 5, dtype=torch.float64)
    edges = torch.linspace(0.0, 1.0, 6, dtype=torch.float64).expand(100, 6)
    return ToyProblem(_ROWS, pieces=Pieces(edges, zero + value, zero, zero, zero))


def _toy_answer(problem: ToyProblem) -> Floats:
    return problem.reference()


def _of(
    kind: str, *rows: tuple[str, Callable[[], Problem]], answer: Any = _toy_answer, unit: float = 1.0
) -> list[Hostile]:
    return [Hostile(name, kind, make, answer, unit=unit) for name, make in rows]


def _sampled(make: Callable[[], Problem], answer: Any, most: int) -> list[Hostile]:
    """A usual batch with unusual samples."""
    placed = [Hostile(design.name, "repeated samples", make, answer, design=design) for design in _DESIGNS]
    return [*placed, *(Hostile(f"{n} samples", "few or many samples", make, answer, n=n) for n in (1, 2, 3, 100, most))]


_TOY = [
    *_of("constant", ("a constant", lambda: _constant(2.5)), ("the constant 0", lambda: _constant(0.0))),
    *_of(
        "extreme values", ("the constant 1e30", lambda: _constant(1e30)), ("1e30", lambda: _toy(times=1e30)), unit=1e30
    ),
    *_of("extreme values", ("1e-30", lambda: _toy(times=1e-30)), unit=1e-30),
    *_of("extreme values", ("small on top of 1e6", lambda: _toy(plus=1e6))),
    *_of(
        "far outside",
        ("upside down", lambda: _toy(times=-1.0)),
        ("jumps of 1e3", lambda: _toy(Shape(jump=1e3))),
        ("waves ten times as fast", lambda: _toy(Shape(frequency=(500.0, 1100.0)))),
        ("nothing but lines", lambda: _toy(Shape(linear=1.0, quadratic=0.0))),
        ("bulges of 100", lambda: _toy(Shape(linear=0.0, quadratic=1.0, bulge=100.0))),
        ("all breaks within 1e-6", lambda: _toy(edges=[0, 0.5, 0.5 + 1e-7, 0.5 + 2e-7, 0.5 + 1e-6, 1])),
        ("all breaks at the start", lambda: _toy(edges=[0, 1e-9, 2e-9, 3e-9, 4e-9, 1])),
    ),
    *_sampled(_toy, _toy_answer, 5000),
]

# --------------------------------------------------------------------------------------------------------- curves

_SPREAD = np.random.default_rng(11).uniform(-1, 1, (60, 2))
_SCRIBBLE = Curve.bezier(np.random.default_rng(12).uniform(-1, 1, (6, 3, 2)))
_NEAR = _SCRIBBLE.sample(np.linspace(0.01, 0.99, 60))
_CIRCLE = circle_of_cubics(6, radius=0.5)
_LINE = Curve.polyline(np.stack([np.linspace(-1, 1, 7), np.zeros(7)], axis=1))
_SPECK = Curve.bezier(_SCRIBBLE.control[:, :3] * np.array([1, 1, 1, 1, 1, 1e-9])[:, None, None])
_LOOPS = Curve.bezier(np.random.default_rng(13).uniform(-1, 1, (6, 4, 2)))

# Name, curve, queries. What is larger or smaller than the family's square of side 2 is outside every card's range.
_CURVES: list[tuple[str, Curve, Floats]] = [
    ("queries 1e-6 beside the curve", _SCRIBBLE, _NEAR + 1e-6),
    ("queries 1e-12 beside the curve", _SCRIBBLE, _NEAR + 1e-12),
    ("queries 1e3 away", _SCRIBBLE, 1e3 + _SPREAD),
    ("queries 1e30 away", _SCRIBBLE, 1e30 * (1.5 + _SPREAD)),
    ("a world 1e30 wide", scaled(_SCRIBBLE, 1e30), 1e30 * _SPREAD),
    ("a world 1e-30 wide", scaled(_SCRIBBLE, 1e-30), 1e-30 * _SPREAD),
    ("a world 1e6 away", scaled(_SCRIBBLE, 1.0, 1e6), _SPREAD + 1e6),
    ("a circle from its centre: constant", _CIRCLE, np.zeros((60, 2))),
    ("a circle", _CIRCLE, 0.7 * _SPREAD),
    ("one segment", Curve.polyline([(-0.5, 0), (0.5, 0)]), _SPREAD),
    ("six segments in a line, queries on it", _LINE, np.stack([np.linspace(-2, 2, 60), np.zeros(60)], axis=1)),
    ("a square: corners and edges", SQUARE, np.random.default_rng(14).uniform(0.01, 0.99, (60, 2))),
    ("one piece a billionth of the others", _SPECK, _SPREAD),
    ("cubics with loops", _LOOPS, _SPREAD),
    ("the same piece six times", joined(*[_SCRIBBLE.split_pieces(1)[0]] * 6), _SPREAD),
    ("a page of 40 pieces in the place of six", joined(*[_SCRIBBLE] * 7), _SPREAD),
]


def _gwn(curve: Curve, points: Floats) -> GwnProblem:
    return GwnProblem.of(curve, points)


def _reference(problem: GwnProblem | SdProblem) -> Floats:
    return np.asarray(problem.reference())


def _on_curves(make: Callable[[Curve, Floats], Problem]) -> list[Hostile]:
    lists = [_of(_kind(name), (name, partial(make, c, p)), answer=_reference) for name, c, p in _CURVES]
    return [*(one for each in lists for one in each), *_sampled(lambda: make(_SCRIBBLE, _SPREAD), _reference, 5000)]


def _kind(name: str) -> str:
    if "constant" in name:
        return "constant"
    return "extreme values" if "1e30" in name or "1e-30" in name else "far outside"


def _sd(alpha: float) -> Callable[[Curve, Floats], SdProblem]:
    return lambda curve, points: SdProblem.of(curve, points, alpha=alpha)


# What exact smoothed distances refuse (beyond 1e300), sampled ones refuse or bear; there is no truth to hold them to.
_SD = [
    *(one for one in _on_curves(_sd(35.0)) if one.name != "a world 1e30 wide"),
    *_of(
        "far outside",
        *((f"alpha {a:g}", lambda a=a: _sd(a)(_SCRIBBLE, _SPREAD)) for a in (1e-3, 1e4)),
        answer=_reference,
    ),
]

# ---------------------------------------------------------------------------------------------------------- walks


def _affine(p: Floats) -> Floats:
    return np.asarray(0.3 + p[:, 0] - 2.0 * p[:, 1])


def _walked(polygon: Any, points: Any, times: float = 1.0, shift: float = 0.0, scale: float = 1.0) -> Callable[[], Any]:
    """Affine data, which solve Laplace's equation and its kin for every p, in a world scaled and then shifted."""

    def make() -> Any:
        from nqr_geom import problems

        at = shapely.transform(shapely.Polygon(polygon), lambda p: scale * p + shift)
        data = lambda p: times * _affine((p - shift) / scale)  # noqa: E731
        return problems.laplace(at, data, scale * np.asarray(points, dtype=float) + shift)

    return make


def _affine_answer(points: Any, times: float = 1.0) -> Callable[[Any], Floats]:
    return lambda _: times * _affine(np.asarray(points, dtype=float))[:, None]


def _inside(polygon: Any, m: int = 40) -> Floats:
    """m random points inside."""
    shape = shapely.Polygon(polygon)
    random, kept = np.random.default_rng(15), np.empty((0, 2))
    low, high = np.reshape(shape.bounds, (2, 2))
    while len(kept) < m:
        points = random.uniform(low, high, (400, 2))
        kept = np.concatenate([kept, points[shapely.contains_xy(shape, *points.T)]])
    return kept[:m]


_NEEDLE = np.array([[0, 0], [1, -5e-4], [1, 5e-4]])
_STAR = (0.6 + 0.39 * np.cos(15 * np.pi * np.arange(300) / 150))[:, None] * ring(300)
_DOMAINS: list[tuple[str, Any, Any]] = [
    ("needle", _NEEDLE, [[x, 0.0] for x in np.linspace(0.01, 0.99, 40)]),
    ("channel", CHANNEL, [[x, 0.004] for x in np.linspace(0.1, 9.9, 40)]),
    ("comb", COMB, _inside(COMB)),
    ("sieve", SIEVE, _inside(SIEVE)),
    ("L-shape", ELL, _inside(ELL)),
    ("snowflake of 192 edges", koch(3), _inside(koch(3))),
    ("star of 300 edges", _STAR, _inside(_STAR)),
    ("triangle", ring(3), _inside(ring(3))),
    ("annulus", shapely.Polygon(2 * ring(60), [ring(60)]), _inside(shapely.Polygon(2 * ring(60), [ring(60)]))),
    ("1e-6 above an edge", UNIT, [[x, 1e-6] for x in np.linspace(0.1, 0.9, 40)]),
    ("1e-12 above an edge", UNIT, [[x, 1e-12] for x in np.linspace(0.1, 0.9, 40)]),
    ("on an edge", UNIT, [[x, 0.0] for x in np.linspace(0.1, 0.9, 40)]),
]
_USUAL = _inside(UNIT)


def _walk_row(kind: str, name: str, polygon: Any, points: Any, unit: float = 1.0, **how: float) -> Hostile:
    answer = _affine_answer(points, how.get("times", 1.0))
    return Hostile(name, kind, _walked(polygon, points, **how), answer, unit=unit)


_WALKS = [
    *(_walk_row("far outside", *row) for row in _DOMAINS),
    _walk_row("extreme values", "data of 1e30", UNIT, _USUAL, 1e30, times=1e30),
    _walk_row("extreme values", "data of 1e-30", UNIT, _USUAL, 1e-30, times=1e-30),
    _walk_row("constant", "the constant 0", UNIT, _USUAL, times=0.0),
    _walk_row("extreme values", "a world 1e6 wide", UNIT, _USUAL, scale=1e6),
    _walk_row("extreme values", "a world 1e-6 wide", UNIT, _USUAL, scale=1e-6),
    _walk_row("extreme values", "a world 1e6 away", UNIT, _USUAL, shift=1e6),
    *_sampled(_walked(UNIT, _USUAL), _affine_answer(_USUAL), 2000),
]


def _three(make: Callable[[], Any]) -> Any:
    from nqr_geom.wos.problems import PLaplaceProblem

    return PLaplaceProblem.like(make(), 3.0)


_LISTS = {
    "toy": _TOY,
    "gwn": _on_curves(_gwn),
    "sd": _SD,
    "laplace": _WALKS,
    "p-laplace": [replace(one, make=partial(_three, one.make)) for one in _WALKS],
}


def hostile(problem: str) -> list[Hostile]:
    """The list of a problem; empty where there is none.

    Examples
    --------
    >>> [one.name for one in hostile("toy")][:3]
    ['a constant', 'the constant 0', 'the constant 1e30']
    """
    return _LISTS.get(problem, [])
