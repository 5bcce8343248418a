"""Direct light as an integral over the unit cube in six dimensions, by two techniques (Section 6.1, Table 5).

Axes 0 and 1 turn into a direction by the material, 2 picks its lobe, 3 picks a light, 4 and 5 a direction towards it.
In this order every pair of axes that samplers stratify together means something.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom._warp import array, launch, wp
from nqr_geom.integrator.learn.zoo import Model
from nqr_geom.integrator.problem import Feature, Observation, Problem, Schema, Whole
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj, Random
from nqr_geom.render import direct_known, direct_student, kernels_bsdf, kernels_fused
from nqr_geom.render.direct_rules import KnownLight, UnhiddenLight, sure_chance
from nqr_geom.render.kernels_numbers import numbers
from nqr_geom.render.scene import Scene
from nqr_geom.render.world import Assembled, assemble, rows_of, see
from nqr_geom.streams import Stream

__all__ = ["LAYOUT", "DirectProblem"]

# What `observe` writes for each technique: name, first number, how many.
LAYOUT = {
    "direction": (0, 3),
    "nee_pdf": (3, 1),
    "nee_ratio": (4, 3),
    "bsdf_pdf": (7, 1),
    "bsdf": (8, 3),
    "light_direction": (11, 3),
    "light_distance": (14, 1),
    "light_radius": (15, 1),
    "chance": (16, 1),
    "lambert": (17, 1),
    "irradiance": (18, 1),
    "diffuse_share": (19, 3),
    "light": (22, 1),
    "radiance": (23, 3),
    "visible": (26, 1),
    "unhidden": (27, 3),
}

_PSS = ((2, 0, 1), (3, 4, 5))  # axes of each technique, as Table 5 has them: lobe and direction, light and point


@dataclass(frozen=True, eq=False)
class DirectProblem(Problem):
    """What light reaches B pixels of some scenes by one reflection, three channels each.

    Features beyond the schema are for rules: "light" (its number in the scene, -1 for none), "chance" of that light,
    "lambert" (cosine over density), "irradiance" of the unhidden light at radiance 1, its "radiance", the "visible"
    part of it, "diffuse_share" of the reflection, "unhidden", the irradiance of all lights at once, "known", the
    radiance that this light would send to the viewer if nothing hid it, "known_all", that of all lights, and
    "expected", the value if nothing hid the light.

    Parameters
    ----------
    world : Assembled
        The scenes.
    surfaces : structured ndarray, (B,)
        What each pixel sees.
    rows : Tensor, (B,), int64
        Global index of each pixel.
    calls_for : frozenset of str
        Effects that are computed; by default those of the scenes.
    rays : dict
        Shadow rays traced so far, by technique, and density queries along them; shared with parts of this problem.
    """

    world: Assembled
    surfaces: NDArray[Any]
    rows: Tensor
    calls_for: frozenset[str]
    rays: dict[str, int] = field(default_factory=lambda: {"material": 0, "light": 0, "density queries": 0})

    name = "direct"
    dim = 6
    techniques = 2
    channels = 3
    schema = Schema(
        (
            Feature("pss", "position", 3),
            Feature("direction", "direction", 3),
            Feature("incident", "scalar", 3),
            Feature("nee_pdf", "scalar"),
            Feature("nee_ratio", "scalar", 3),
            Feature("bsdf_pdf", "scalar"),
            Feature("bsdf", "scalar", 3),
            Feature("light_direction", "direction", 3),
            Feature("light_distance", "scalar"),
            Feature("light_radius", "scalar"),
        )
    )

    @classmethod
    def of(
        cls, scenes: Scene | Sequence[Scene], *, effects: frozenset[str] | None = None, jitter: Stream | None = None
    ) -> DirectProblem:
        """Every pixel of one or more scenes.

        Parameters
        ----------
        scenes : Scene or sequence of Scene
        effects : frozenset of str, optional
            What to compute; at least what the scenes call for (the default).
        jitter : Stream, optional
            Look through a random point of each pixel instead of its middle.

        Examples
        --------
        >>> import nqr_geom as ng
        >>> problem = ng.problems.direct(ng.datasets.scenes(1, resolution=4)[0])
        >>> problem.batch, problem.dim, problem.techniques, problem.channels
        (16, 6, 2, 3)
        """
        scenes = (scenes,) if isinstance(scenes, Scene) else tuple(scenes)
        for scene in scenes:
            if not isinstance(scene, Scene):
                raise TypeError(f"scenes: expected Scene objects, got {type(scene).__name__}")
        if not scenes:
            raise ValueError("scenes: expected at least one scene, got none")
        needed = frozenset[str]().union(*(scene.effects() for scene in scenes))
        if effects is not None and not needed <= effects:
            raise ValueError(f"effects: expected at least {sorted(needed)}, got {sorted(effects)}")
        world = assemble(scenes)
        streams = [jitter.child(f"pixels {k}") if jitter else None for k in range(len(scenes))]
        surfaces = np.concatenate([see(world, k, stream) for k, stream in enumerate(streams)])
        return cls(world, surfaces, torch.arange(len(surfaces)), needed if effects is None else effects)

    @classmethod
    def family(cls, n: int, seed: int = 0, split: str = "test", resolution: int = 16) -> DirectProblem:
        """n random scenes of Fig. 39 at `resolution` x `resolution` pixels.

        Parameters
        ----------
        n : int
            Number of scenes.
        seed, split
            Which scenes, see `nqr_geom.render.scene_families.scenes`.
        resolution : int
            Pixels along each side.
        """
        from nqr_geom.render.scene_families import scenes

        made = scenes(n, seed=seed, split=split, resolution=resolution)
        return cls.of(made, jitter=Stream(seed, split, "pixels"))

    @property
    def groups(self) -> NDArray[np.int64]:
        return self.surfaces["scene"].astype(np.int64)

    @property
    def effects(self) -> frozenset[str]:
        return self.calls_for

    @property
    def variant(self) -> tuple[bool, bool, bool, tuple[str, bool] | None]:
        """Which kernels run: with shadows, with gloss, with a choice of lights, with what kind of medium."""
        gloss = bool(self.calls_for & {"glossy", "specular"})
        medium = self.world.medium
        fog = None if medium is None else (medium.kind, medium.noisy)
        return "shadows" in self.calls_for, gloss, "light selection" in self.calls_for, fog

    @property
    def kernels(self) -> str:
        """The variant in words, as reports give it."""
        *flags, medium = self.variant
        names = ("shadows", "gloss", "light selection")
        fog = [] if medium is None else [f"{medium[0]} medium", *(["noise"] if medium[1] else [])]
        return " + ".join(["direct", *(name for name, on in zip(names, flags, strict=True) if on), *fog])

    def count(self, traced: NDArray[np.int32]) -> None:
        """Add shadow rays and density queries, (B, 3), to those so far."""
        for name, total in zip(self.rays, traced.sum(axis=0, dtype=np.int64).tolist(), strict=True):
            self.rays[name] += total

    def evaluate(self, x: Tensor, known: Tensor | None = None) -> Observation:
        """One pass for every point x (B, N, 6); `known` is what `direct_known.known` gives, if it is at hand."""
        batch, n = x.shape[:2]
        value, density = np.zeros((batch, n, 2, 3)), np.zeros((batch, n, 2, 2))
        extra, traced = np.zeros((batch, n, 2, kernels_fused.EXTRA)), np.zeros((batch, 3), np.int32)
        arguments = [
            self.world.struct,
            rows_of(kernels_bsdf.Surface, self.surfaces),
            array(np.ascontiguousarray(x.cpu().numpy()), wp.float64),
            array(value, wp.vec3d),
            array(density, wp.float64),
            array(extra, wp.float64),
            array(traced, wp.int32),
        ]
        launch(kernels_fused.kernel("observe", *self.variant), batch, arguments)
        self.count(traced)
        seen = torch.from_numpy(extra)
        features = {name: seen[..., first : first + size] for name, (first, size) in LAYOUT.items()}
        features["pss"] = torch.stack([x[..., axes] for axes in _PSS], dim=2)
        features["incident"] = torch.from_numpy(value)
        known = direct_known.known(self, n) if known is None else known
        light = features["light"].long()
        own = known.gather(1, light.clamp_min(0).flatten(1)[..., None].expand(-1, -1, 3)).view(batch, n, 2, 3)
        features["known"] = torch.where(light >= 0, own, 0.0)
        features["known_all"] = known.sum(dim=1)[:, None, None].expand(batch, n, 2, 3)
        through = torch.from_numpy(np.ascontiguousarray(self.surfaces["through"]))[:, None, None]
        features["expected"] = features["bsdf"] * features["radiance"] * features["lambert"] * through
        return Observation(
            torch.from_numpy(value), features, technique_pdf=torch.from_numpy(density), queries=2 * batch * n
        )

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        """The classical, the structured and the learned rules on the points that suit them, in one pass."""
        if type(rule) is KnownLight:
            return direct_known.compiled(self, sampler, n)
        if isinstance(rule, Model):
            return direct_student.compiled(self, sampler, rule, n)
        kinds: dict[type, str] = {BalanceHeuristic: "balance", UnhiddenLight: "structured"}
        kind = kinds.get(type(rule))
        if kind is None or type(sampler) not in (Random, Pmj):
            return None
        pmj = isinstance(sampler, Pmj)

        def whole(stream: Stream) -> Whole:
            return self._fused(kind, pmj, n, stream)

        return whole

    def _fused(self, kind: str, pmj: bool, n: int, stream: Stream) -> Whole:
        """Draw the points and combine what they bring in the kernel `kind`."""
        mean, spread = np.zeros((self.batch, 3)), np.zeros((self.batch, 3))
        traced = np.zeros((self.batch, 3), np.int32)
        if kind == "structured":
            most = max(len(scene.lights) for scene in self.world.scenes)
            middle = [sure_chance("pmj" if pmj else "random", n), array(np.zeros((self.batch, most, 4)), wp.vec4d)]
            out = [mean]
        else:
            middle, out = [], [mean, spread]
        arguments = [
            self.world.struct,
            rows_of(kernels_bsdf.Surface, self.surfaces),
            array(np.ascontiguousarray(self.rows.cpu().numpy()), wp.int64),
            numbers(stream, self.batch, n, pmj=pmj),
            n,
            *middle,
            *(array(result, wp.vec3d) for result in out),
            array(traced, wp.int32),
        ]
        launch(kernels_fused.kernel(kind, *self.variant), self.batch, arguments)
        self.count(traced)
        m2 = torch.from_numpy(spread) if kind == "balance" and not pmj and n > 1 else None
        fallback = torch.zeros(self.batch, dtype=torch.bool)
        return Whole(torch.from_numpy(mean), fallback, 2 * self.batch * n, m2)

    def take(self, index: slice | Tensor) -> DirectProblem:
        at = index if isinstance(index, slice) else index.cpu().numpy()
        return replace(self, surfaces=self.surfaces[at], rows=self.rows[index])

    def reference(self) -> NDArray[np.float64]:
        """Means of 16 independent runs of 256 passes, (B, 3)."""
        from nqr_geom.integrator.estimate import run

        return run(self, Pmj(), BalanceHeuristic(), 256, replicates=16, seed=2**31 - 1).value
