"""Winding number and smoothed distance as integrals over the curve parameter, with all that a sample tells.

A problem holds S shapes and B query points, each of one shape. It sees a curve only through point queries: position
and tangent at s, and the piece that s lies in (Section 6.2). The exact answers serve as its reference only.
"""

from __future__ import annotations

import importlib.util
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from nqr_geom import check
from nqr_geom.curves.curve import BlackBoxCurve, Curve
from nqr_geom.curves.shapes import BlackBoxShape, PackedShapes, Shapes
from nqr_geom.curves.structured import CurveRefine, GwnHermite, SdHermite, scaled
from nqr_geom.integrator.problem import Feature, Link, LogLink, Observation, Problem, Samples, Schema, Whole
from nqr_geom.integrator.rules import MonteCarlo
from nqr_geom.integrator.samplers import Random, Stratified
from nqr_geom.streams import Stream

__all__ = ["CurveProblem", "GwnProblem", "SdProblem"]

_LARGEST = 1e120
_ROW_BITS = 40  # of a row that number its query
_TINY = 1e-280  # squared distances are kept above it, so that a query on the curve stays finite


def _check_size(name: str, coordinates: NDArray[np.float64]) -> None:
    """Refuse coordinates whose squares, or whose differences' squares, float64 cannot hold."""
    largest = float(np.abs(coordinates).max(initial=0.0))
    if largest > _LARGEST or 0.0 < largest < 1.0 / _LARGEST:
        raise ValueError(
            f"{name}: expected coordinates between {1.0 / _LARGEST:.0e} and {_LARGEST:.0e} in size for a sampled "
            f"method, got {largest:.3g}; scale the shape"
        )


@dataclass(frozen=True)
class CurveProblem(Problem):
    """What the winding number and the smoothed distance share.

    Parameters
    ----------
    shapes : Shapes
        S curves.
    points : Tensor, (B, 2), float64
        Query points.
    shape : Tensor, (B,), int64
        Which curve each query looks at.
    rows : Tensor, (B,), int64
        Global index of each integral.
    curves : sequence of Curve, optional
        The curves themselves, for the reference.
    """

    shapes: Shapes
    points: Tensor
    shape: Tensor
    rows: Tensor
    curves: tuple[Curve, ...] = ()

    dim = 1

    @classmethod
    def _parts(
        cls, curve: Curve | Sequence[Curve], points: ArrayLike
    ) -> tuple[Shapes, Tensor, Tensor, Tensor, tuple[Curve, ...]]:
        curves = (curve,) if isinstance(curve, Curve) else tuple(curve)
        if not curves or not all(isinstance(c, Curve) for c in curves):
            raise TypeError(f"curve: expected a Curve or a sequence of them, got {curve!r}")
        queries = torch.from_numpy(check.array("points", points, ("m", 2)).copy())
        for known in curves:
            if not isinstance(known, BlackBoxCurve) and known.n_pieces:
                _check_size("curve", known.control)
        _check_size("points", queries.numpy())
        shapes: Shapes
        if isinstance(curves[0], BlackBoxCurve):
            if len(curves) > 1:
                raise ValueError(f"curve: expected one black-box curve at a time, got {len(curves)}")
            shapes = BlackBoxShape(curves[0])
        else:
            shapes = PackedShapes.from_curves(curves)
        shape = torch.arange(len(curves)).repeat_interleave(len(queries))
        # The upper bits of a row number its curve: what a query draws does not depend on how many others there are.
        rows = (shape << _ROW_BITS) + torch.arange(len(queries)).repeat(len(curves))
        return shapes, queries.repeat(len(curves), 1), shape, rows, curves

    @classmethod
    @abstractmethod
    def of(cls, curve: Curve | Sequence[Curve], points: ArrayLike) -> CurveProblem:
        """The problem on `points` (m, 2) for a curve, or for each of several."""

    @classmethod
    def family(cls, n: int, seed: int = 0, split: str = "test", resolution: int = 128) -> CurveProblem:
        """n random shapes of Fig. 38, each on the centres of a grid over [-1, 1]^2 that are not on the curve.

        Monte Carlo's variance grows like 1/d towards the curve, so its mean over all queries would diverge: centres
        closer than 1e-3 are left out.

        Parameters
        ----------
        n : int
            Number of shapes.
        seed, split
            Which shapes, see `nqr_geom.curves.families.curves`.
        resolution : int
            Grid lines per side.
        """
        from nqr_geom.curves.distance import distance
        from nqr_geom.curves.families import curves

        shapes = curves(n, seed=seed, split=split)
        line = (np.arange(check.integer("resolution", resolution, low=1)) + 0.5) * (2.0 / resolution) - 1.0
        grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        whole = cls.of(shapes, grid)
        far = np.concatenate([distance(curve, grid) >= 1e-3 for curve in shapes])
        return whole.take(torch.from_numpy(np.flatnonzero(far)))

    @property
    def groups(self) -> NDArray[np.int64]:
        return self.shape.cpu().numpy()

    @property
    def schema(self) -> Schema:  # type: ignore[override]
        """Everything of Section 6.2, and the speed that turns the normal into a tangent."""
        return Schema(
            (
                Feature("relative", "scalar", 2),
                Feature("normal", "direction", 2),
                Feature("piece", "index", levels=int(self.shapes.pieces.max())),
                Feature("pieces", "scalar"),
                Feature("distance2", "scalar"),
                Feature("inverse_distance2", "scalar"),
                Feature("speed", "scalar"),
            )
        )

    def _observe(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """Relative position, tangent, squared distance and all features at x (B, N, 1)."""
        position, tangent, piece = self.shapes.at(self.shape, x[..., 0])
        relative = position - self.points[:, None]
        distance2 = relative.square().sum(-1).clamp_min(_TINY)
        speed = torch.linalg.vector_norm(tangent, dim=-1)
        unit = tangent / speed.clamp_min(_TINY)[..., None]
        normal = torch.stack([unit[..., 1], -unit[..., 0]], dim=-1)
        features = {
            "relative": relative[:, :, None],
            "normal": normal[:, :, None],
            "piece": piece[:, :, None, None],
            "pieces": self.shapes.pieces[self.shape][:, None, None, None].expand(*piece.shape, 1, 1),
            "distance2": distance2[:, :, None, None],
            "inverse_distance2": 1.0 / distance2[:, :, None, None],
            "speed": speed[:, :, None, None],
        }
        return relative, tangent, distance2, features

    def _count(self, x: Tensor) -> int:
        return x.shape[0] * x.shape[1] * self.shapes.queries_per_sample

    def take(self, index: slice | Tensor) -> CurveProblem:
        return replace(self, points=self.points[index], shape=self.shape[index], rows=self.rows[index])

    def peers(self) -> dict[str, Callable[[], NDArray[np.float64]]]:
        return {"exact": self._reference} if self._known else {}

    @property
    def _known(self) -> bool:
        """Whether the curves themselves are there, and not only their points."""
        return bool(self.curves) and not any(isinstance(curve, BlackBoxCurve) for curve in self.curves)

    def reference(self) -> NDArray[np.float64] | None:
        return self._reference() if self._known else None

    @abstractmethod
    def _reference(self) -> NDArray[np.float64]:
        """Exact answers (B, 1)."""

    def _exact(self, answer: Callable[[Curve, NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
        """`answer` for each query on its own curve, (B, 1)."""
        result = np.empty((self.batch, 1))
        points, shape = self.points.cpu().numpy(), self.shape.cpu().numpy()
        for k in np.unique(shape):
            result[shape == k, 0] = answer(self.curves[k], points[shape == k])
        return result


@dataclass(frozen=True)
class GwnProblem(CurveProblem):
    """The generalised winding number as an integral over s (Eq. 5).

    Examples
    --------
    >>> import nqr_geom as ng
    >>> square = ng.Curve.polyline([[0, 0], [1, 0], [1, 1], [0, 1]], closed=True)
    >>> problem = GwnProblem.of(square, [[0.5, 0.5], [2.0, 0.5]])
    >>> problem.reference().ravel().tolist()
    [1.0, 0.0]
    """

    name = "gwn"

    @classmethod
    def of(cls, curve: Curve | Sequence[Curve], points: ArrayLike) -> GwnProblem:
        """Winding numbers of `points` (m, 2) with respect to a curve, or to each of several."""
        return cls(*cls._parts(curve, points))

    def evaluate(self, x: Tensor) -> Observation:
        relative, tangent, distance2, features = self._observe(x)
        cross = relative[..., 0] * tangent[..., 1] - relative[..., 1] * tangent[..., 0]
        value = cross / (2.0 * math.pi * distance2)
        return Observation(value[:, :, None, None], features, queries=self._count(x))

    def _reference(self) -> NDArray[np.float64]:
        from nqr_geom.curves.winding import gwn

        return self._exact(gwn)

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        """Plain Monte Carlo, the rebuilt curve and students, for polynomial pieces on a CPU."""
        shapes = self.shapes
        if not isinstance(shapes, PackedShapes) or self.points.device.type != "cpu":
            return None
        if type(sampler) in (Random, Stratified) and type(rule) is not MonteCarlo:
            from nqr_geom.curves.student import whole_of

            return whole_of(self, shapes, type(sampler) is Stratified, rule, n)
        plain = type(rule) is MonteCarlo and type(sampler) in (Random, Stratified)
        refine = sampler if type(rule) is GwnHermite and isinstance(sampler, CurveRefine) else None
        if not plain and (refine is None or n < 2 * int(shapes.pieces.max())):
            return None

        def whole(stream: Stream) -> Whole:
            from nqr_geom.curves import compiled

            c, k, shape, points, rows = (
                t.numpy() for t in (shapes.coefficients, shapes.pieces, self.shape, self.points, self.rows)
            )
            queries = self.batch * n * shapes.queries_per_sample
            nowhere = torch.zeros(self.batch, dtype=torch.bool)
            if refine is None:
                of = compiled.sampled(c, k, shape, points, rows, stream.key, n, type(sampler) is Stratified)
                mean, m2, m3, m4 = torch.from_numpy(of)[..., None]
                if type(sampler) is Stratified or n == 1:
                    return Whole(mean, nowhere, queries)
                return Whole(mean, nowhere, queries, m2, m3=m3, m4=m4)
            value, doubtful = compiled.refined(c, k, shape, points, rows, stream.key, n, refine.spread, refine.end)
            return Whole(torch.from_numpy(value)[:, None], torch.from_numpy(doubtful), queries)

        return whole

    def placing(self, net: object, n: int) -> Callable[[Stream], tuple[Tensor, Tensor]] | None:
        from nqr_geom.curves.placing import placing

        return placing(self, net, n)

    def peers(self) -> dict[str, Callable[[], NDArray[np.float64]]]:
        """The exact answer, and libigl's on polygons within 1e-3 of the curves' size where it is installed."""
        peers = super().peers()
        if peers and importlib.util.find_spec("igl") is not None:
            peers["libigl, flattened"] = self._libigl
        return peers

    def _libigl(self) -> NDArray[np.float64]:
        import igl

        def flattened(curve: Curve, points: NDArray[np.float64]) -> NDArray[np.float64]:
            xmin, ymin, xmax, ymax = curve.bounds
            edges = curve.to_polyline(1e-3 * (max(xmax - xmin, ymax - ymin) or 1.0)).control[:, :2]
            index = np.arange(2 * len(edges)).reshape(-1, 2)
            answer: NDArray[np.float64] = igl.winding_number(edges.reshape(-1, 2), index, points)
            return answer

        return self._exact(flattened)


@dataclass(frozen=True)
class SdProblem(CurveProblem):
    """The smoothed distance -ln(integral of exp(-alpha |x - p|) dl) / alpha as an integral over s (Eq. 50).

    Once all samples are there, the smallest distance among them is taken out of the exponential and put back by the
    link, so that no alpha under- or overflows.

    Examples
    --------
    >>> import nqr_geom as ng
    >>> segment = ng.Curve.polyline([[-1, 0], [1, 0]])
    >>> SdProblem.of(segment, [[0.0, 0.5]], alpha=35.0).reference().round(3).tolist()
    [[0.534]]
    """

    alpha: float = 35.0

    name = "sd"

    @classmethod
    def of(cls, curve: Curve | Sequence[Curve], points: ArrayLike, alpha: float = 35.0) -> SdProblem:
        """Smoothed distances of `points` (m, 2) to a curve, or to each of several; alpha > 0."""
        alpha = check.number("alpha", alpha, low=0.0, open_low=True)
        return cls(*cls._parts(curve, points), alpha)

    def evaluate(self, x: Tensor) -> Observation:
        _, _, distance2, features = self._observe(x)
        features["alpha"] = x.new_full((*x.shape[:2], 1, 1), self.alpha)
        value = torch.exp(-self.alpha * distance2.sqrt()) * features["speed"][..., 0, 0]
        return Observation(value[:, :, None, None], features, queries=self._count(x))

    @property
    def schema(self) -> Schema:  # type: ignore[override]
        """As for the winding number, and the sharpness."""
        return Schema((*super().schema.features, Feature("alpha", "scalar")))

    def finalize(self, samples: Samples) -> tuple[Samples, Link]:
        distance = samples.seen.features["distance2"][..., 0, 0].sqrt()
        shift = distance.min(dim=1, keepdim=True).values
        value = torch.exp(-self.alpha * (distance - shift)) * samples.seen.features["speed"][..., 0, 0]
        seen = replace(samples.seen, value=value[:, :, None, None])
        return replace(samples, seen=seen), LogLink(alpha=self.alpha, shift=shift)

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        """Plain Monte Carlo and the rebuilt curve, for polynomial pieces on a CPU."""
        shapes = self.shapes
        if not isinstance(shapes, PackedShapes) or self.points.device.type != "cpu":
            return None
        refine = sampler if isinstance(sampler, CurveRefine) else None
        if type(rule) not in (MonteCarlo, SdHermite) or type(sampler) not in (Random, Stratified, CurveRefine):
            return None
        if refine is not None and (type(rule) is MonteCarlo or n < 2 * int(shapes.pieces.max())):
            return None

        def whole(stream: Stream) -> Whole:
            from nqr_geom.curves import compiled_smooth

            c, k, shape, points, rows = (
                t.numpy() for t in (shapes.coefficients, shapes.pieces, self.shape, self.points, self.rows)
            )
            queries, jittered = self.batch * n * shapes.queries_per_sample, type(sampler) is Stratified
            if type(rule) is MonteCarlo:
                of, near = compiled_smooth.sampled(c, k, shape, points, rows, stream.key, n, jittered, self.alpha)
                mean, m2, m3, m4 = torch.from_numpy(of)[..., None]
                link = LogLink(alpha=self.alpha, shift=torch.from_numpy(near)[:, None])
                nowhere = torch.zeros(self.batch, dtype=torch.bool)
                if jittered or n == 1:
                    return Whole(mean, nowhere, queries, link=link)
                return Whole(mean, nowhere, queries, m2, link, m3=m3, m4=m4)
            found = compiled_smooth.rebuilt(
                c, k, shape, points, rows, stream.key, n,
                refine=refine is not None, jittered=jittered, spread=refine.spread if refine else 0.0,
                end=refine.end if refine else 0.0, alpha=self.alpha,
            )  # fmt: skip
            exponent, total, shift, missing = map(torch.from_numpy, found)
            value, own, lost = scaled(exponent, total, torch.full_like(shift, self.alpha), shift)
            return Whole(value, missing | lost, queries, link=own)

        return whole

    def _reference(self) -> NDArray[np.float64]:
        from nqr_geom.curves.smooth import sd

        return self._exact(lambda curve, points: sd(curve, points, alpha=self.alpha))
