"""What is integrated: a batch of B integrals over [0,1]^D that tell more than their value at a point.

Shape words, here and everywhere in the integrator: B integrals, N samples, D dimensions, T techniques, C channels.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nqr_geom.streams import Stream

__all__ = [
    "ExpLink",
    "Feature",
    "Link",
    "LogLink",
    "Observation",
    "Problem",
    "Samples",
    "Schema",
    "WalkProblem",
    "Whole",
]


@dataclass(frozen=True)
class Feature:
    """One auxiliary quantity that comes with every sample.

    Parameters
    ----------
    name : str
        Key into `Samples.features`.
    kind : {"position", "index", "scalar", "direction"}
        How a network may read it: positions get Fourier frequencies, indices an embedding, scalars a logarithmic
        compression, directions nothing.
    size : int
        Components.
    levels : int
        For an index, how many values it takes (0 .. levels-1).
    """

    name: str
    kind: Literal["position", "index", "scalar", "direction"]
    size: int = 1
    levels: int = 0


@dataclass(frozen=True)
class Schema:
    """The features of a problem, in the order in which a tokenizer reads them."""

    features: tuple[Feature, ...] = ()

    def __getitem__(self, name: str) -> Feature:
        for feature in self.features:
            if feature.name == name:
                return feature
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Feature names in order."""
        return tuple(feature.name for feature in self.features)


@dataclass(frozen=True)
class Observation:
    """What evaluating a problem at points x (B,N,D) gives back.

    Parameters
    ----------
    value : Tensor, (B, N, T, C), float64
        The integrand in primary sample space (already divided by a technique's density).
    features : mapping of str to Tensor, (B, N, T, size)
        The quantities that the problem's schema names.
    control : pair of Tensor, optional
        A control variate at the same points, (B, N, T, C), and its exact integral, (B, C).
    technique_pdf : Tensor, (B, N, T, T), optional
        Density of every technique (last axis) at each technique's sample, for multiple importance sampling.
    queries : int
        Evaluations of the underlying function that were needed.
    work : mapping of str to int
        Other work by kind, where the problem counts it (noise evaluations, shadow rays).
    """

    value: Tensor
    features: Mapping[str, Tensor] = field(default_factory=dict)
    control: tuple[Tensor, Tensor] | None = None
    technique_pdf: Tensor | None = None
    queries: int = 0
    work: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def join(parts: Sequence[Observation]) -> Observation:
        """Observations of the same integrals at more points, one after the other along N."""
        first = parts[0]
        control = None
        if first.control is not None:
            control = (torch.cat([p.control[0] for p in parts if p.control is not None], dim=1), first.control[1])
        densities = [p.technique_pdf for p in parts if p.technique_pdf is not None]
        return Observation(
            value=torch.cat([p.value for p in parts], dim=1),
            features={name: torch.cat([p.features[name] for p in parts], dim=1) for name in first.features},
            control=control,
            technique_pdf=torch.cat(densities, dim=1) if densities else None,
            queries=sum(p.queries for p in parts),
            work={kind: sum(p.work[kind] for p in parts) for kind in first.work},
        )

    @staticmethod
    def stack(parts: Sequence[Observation]) -> Observation:
        """Observations of different integrals, one after the other along B."""
        first = parts[0]
        control = None
        if first.control is not None:
            pairs = [p.control for p in parts if p.control is not None]
            control = (torch.cat([pair[0] for pair in pairs]), torch.cat([pair[1] for pair in pairs]))
        densities = [p.technique_pdf for p in parts if p.technique_pdf is not None]
        return Observation(
            value=torch.cat([p.value for p in parts]),
            features={name: torch.cat([p.features[name] for p in parts]) for name in first.features},
            control=control,
            technique_pdf=torch.cat(densities) if densities else None,
            queries=sum(p.queries for p in parts),
            work={kind: sum(p.work[kind] for p in parts) for kind in first.work},
        )

    def take(self, rows: slice | Tensor) -> Observation:
        """What was seen of the integrals `rows`; the work is shared out evenly."""
        value = self.value[rows]
        whole = max(1, len(self.value))
        return Observation(
            value=value,
            features={name: tensor[rows] for name, tensor in self.features.items()},
            control=self.control and (self.control[0][rows], self.control[1][rows]),
            technique_pdf=None if self.technique_pdf is None else self.technique_pdf[rows],
            queries=self.queries * len(value) // whole,
            work={kind: count * len(value) // whole for kind, count in self.work.items()},
        )


@dataclass(frozen=True)
class Samples:
    """Points with everything observed there: the only thing a rule sees.

    Parameters
    ----------
    x : Tensor, (B, N, D), float64 in [0, 1]
        Positions.
    seen : Observation
        Values and features at `x`.
    pdf : Tensor, (B, N, T), or None
        Density each point was drawn from; None for designs without one (grids, nodes, greedy choices).
    design : str
        Name of the sampler that placed the points.
    independent : bool
        Whether the N samples of a row are independent and identically distributed.
    stratum, volume : Tensor, (B, N), or None
        Stratum index of each sample and that stratum's volume.
    """

    x: Tensor
    seen: Observation
    pdf: Tensor | None
    design: str
    independent: bool = False
    stratum: Tensor | None = None
    volume: Tensor | None = None

    @property
    def value(self) -> Tensor:
        """Integrand values, (B, N, T, C)."""
        return self.seen.value

    @property
    def n(self) -> int:
        """Samples per integral, N."""
        return self.x.shape[1]

    @property
    def dim(self) -> int:
        """Dimensions, D."""
        return self.x.shape[2]

    def feature(self, name: str, rule: str) -> Tensor:
        """The feature called `name`, (B, N, T, size), or an error that says which rule wanted it."""
        if name not in self.seen.features:
            have = ", ".join(self.seen.features) or "none"
            raise ValueError(f"rule: {rule!r} needs the feature {name!r}, this problem has {have}")
        return self.seen.features[name]

    @staticmethod
    def stack(parts: Sequence[Samples]) -> Samples:
        """Samples of different integrals by one design, one after the other along B."""

        def rows(name: str) -> Tensor | None:
            tensors = [getattr(part, name) for part in parts]
            return None if tensors[0] is None else torch.cat(tensors)

        first = parts[0]
        return replace(
            first,
            x=torch.cat([part.x for part in parts]),
            seen=Observation.stack([part.seen for part in parts]),
            pdf=rows("pdf"),
            stratum=rows("stratum"),
            volume=rows("volume"),
        )

    def take(self, rows: slice | Tensor) -> Samples:
        """The samples of the integrals `rows`."""

        def maybe(tensor: Tensor | None) -> Tensor | None:
            return None if tensor is None else tensor[rows]

        return replace(
            self,
            x=self.x[rows],
            seen=self.seen.take(rows),
            pdf=maybe(self.pdf),
            stratum=maybe(self.stratum),
            volume=maybe(self.volume),
        )

    def permuted(self, order: Tensor) -> Samples:
        """The same samples in another order; `order` is (B, N) int64."""

        def pick(tensor: Tensor) -> Tensor:
            index = order.reshape(*order.shape, *([1] * (tensor.ndim - 2)))
            return torch.gather(tensor, 1, index.expand(*order.shape, *tensor.shape[2:]))

        def maybe(tensor: Tensor | None) -> Tensor | None:
            return None if tensor is None else pick(tensor)

        seen = replace(
            self.seen,
            value=pick(self.seen.value),
            features={name: pick(tensor) for name, tensor in self.seen.features.items()},
            control=self.seen.control and (pick(self.seen.control[0]), self.seen.control[1]),
            technique_pdf=maybe(self.seen.technique_pdf),
        )
        return replace(
            self,
            x=pick(self.x),
            seen=seen,
            pdf=maybe(self.pdf),
            stratum=maybe(self.stratum),
            volume=maybe(self.volume),
        )


@dataclass(frozen=True)
class Link:
    """The function outside the integral; this one is the identity, G(F) = F."""

    name: str = "identity"

    def __call__(self, inner: Tensor) -> Tensor:
        """G(F), same shape as `inner` (B, C)."""
        return inner

    def slope(self, inner: Tensor) -> Tensor:
        """G'(F), for the standard error by the delta method."""
        return torch.ones_like(inner)

    def clamped(self, inner: Tensor) -> Tensor:
        """Whether a value had to be moved into G's domain, bool (B, C)."""
        return torch.zeros_like(inner, dtype=torch.bool)


@dataclass(frozen=True)
class LogLink(Link):
    """G(F) = shift - ln(max(F, floor)) / alpha: the smoothed distance, Eqs. 50 and 56.

    Parameters
    ----------
    alpha : float, or Tensor, (B, 1)
        Sharpness, > 0.
    shift : Tensor, (B, 1)
        Distance taken out of the exponential beforehand, so that F neither under- nor overflows.
    floor : float
        F of linear rules may be negative; it is raised to `floor` and the row is flagged.
    """

    name: str = "log"
    alpha: float | Tensor = 1.0
    shift: Tensor = field(default_factory=lambda: torch.zeros(1, 1, dtype=torch.float64))
    floor: float = 1e-8

    def __call__(self, inner: Tensor) -> Tensor:
        return self.shift - torch.log(inner.clamp_min(self.floor)) / self.alpha

    def slope(self, inner: Tensor) -> Tensor:
        return -1.0 / (self.alpha * inner.clamp_min(self.floor))

    def clamped(self, inner: Tensor) -> Tensor:
        return inner < self.floor


@dataclass(frozen=True)
class ExpLink(Link):
    """G(F) = exp(-max(F, 0)): transmittance from optical depth, Eq. 6.

    A learned offset lies inside the exponential, with the weighted mean; Eq. 7 adds it outside.
    """

    name: str = "exp"

    def __call__(self, inner: Tensor) -> Tensor:
        return torch.exp(-inner.clamp_min(0.0))

    def slope(self, inner: Tensor) -> Tensor:
        return -torch.exp(-inner.clamp_min(0.0))

    def clamped(self, inner: Tensor) -> Tensor:
        return inner < 0.0


@dataclass(frozen=True)
class Whole:
    """What a compiled pass over sampler and rule gives for a batch.

    Parameters
    ----------
    inner : Tensor, (B, C)
        The estimates F.
    fallback : Tensor, (B,) bool
        Integrals where the rule gave way or is in doubt.
    queries : int
        Evaluations of the integrand.
    m2, m3, m4 : Tensor, (B, C), or None
        Sums of second to fourth powers of the deviations of n independent terms, where they are independent.
    link : Link
        The function outside.
    work : mapping of str to int
        Other work by kind, as in `Observation`.
    """

    inner: Tensor
    fallback: Tensor
    queries: int
    m2: Tensor | None = None
    link: Link = field(default_factory=Link)
    work: Mapping[str, int] = field(default_factory=dict)
    m3: Tensor | None = None
    m4: Tensor | None = None


class Problem(ABC):
    """A batch of B integrals over [0,1]^D.

    A subclass sets the class attributes below and writes `evaluate` and `take`. That is all an application owes the
    integrator; every sampler and every rule then works with it, or is refused with a clear sentence.

    Attributes
    ----------
    name : str
        Registry name of the problem.
    dim, techniques, channels : int
        D, T and C.
    schema : Schema
        Which features `evaluate` returns.
    rows : Tensor, (B,), int64
        Global index of each integral: it keys the random numbers, so that a part of a batch sees the same ones.
    """

    name: str = "problem"
    dim: int = 1
    techniques: int = 1
    channels: int = 1
    schema: Schema = Schema()
    rows: Tensor

    @property
    def batch(self) -> int:
        """Number of integrals, B."""
        return self.rows.shape[0]

    @property
    def groups(self) -> NDArray[np.int64]:
        """Shape or scene of each integral, (B,): what a bootstrap resamples. By default all differ."""
        return self.rows.cpu().numpy()

    @property
    def effects(self) -> frozenset[str]:
        """Names of what this problem calls for; branches of absent effects do not run."""
        return frozenset()

    @abstractmethod
    def evaluate(self, x: Tensor) -> Observation:
        """Observe all integrals at x (B, N, D)."""

    @abstractmethod
    def take(self, index: slice | Tensor) -> Problem:
        """The sub-batch of integrals `index`, with their global rows."""

    def finalize(self, samples: Samples) -> tuple[Samples, Link]:
        """Last look at all samples before a rule: may rescale values, and says the link."""
        return samples, Link()

    def compiled(self, sampler: object, rule: object, n: int) -> Callable[[Stream], Whole] | None:
        """One compiled pass that places samples and combines them, where this problem has it for the pair.

        It must draw the same points and give the same answers to rounding: `run` uses it in place of the pair.
        """
        return None

    def placing(self, net: object, n: int) -> Callable[[Stream], tuple[Tensor, Tensor]] | None:
        """One compiled pass in which a sampling network places n samples, where this problem has it for the network.

        It gives points (B, n, D) and their densities (B, n), the same as the network's own to single precision.
        """
        return None

    def reference(self) -> NDArray[np.float64] | None:
        """The true answers G(F), (B, C), where they are known."""
        return None

    def peers(self) -> dict[str, Callable[[], NDArray[np.float64]]]:
        """Other solvers of the same job (exact code, other libraries), each giving (B, C)."""
        return {}


class WalkProblem(Problem):
    """A problem whose point is a walk: x[..., j] decides step j.

    A subclass writes the four verbs; `evaluate` is the loop over them. A sampler that works step by step (array-RQMC,
    a step-level network) runs the loop itself and looks at `observe` in between.
    """

    @abstractmethod
    def start(self, n: int) -> Any:
        """State of (B, n) fresh walks."""

    @abstractmethod
    def observe(self, state: Any) -> Mapping[str, Tensor]:
        """What is known before the next step, each (B, n, size)."""

    @abstractmethod
    def step(self, state: Any, x: Tensor) -> Any:
        """Advance all walks by one step with x (B, n) in [0, 1]."""

    @abstractmethod
    def finish(self, state: Any) -> Observation:
        """Values and features of the finished walks."""

    def rank(self, state: Any) -> Tensor:
        """A number for each walk, (B, n): walks with near numbers are alike. By default there is no telling."""
        return self.rows.new_zeros(self.batch, 1).expand(-1, next(iter(self.observe(state).values())).shape[1])

    def evaluate(self, x: Tensor) -> Observation:
        """Walk all steps; x is (B, N, D) with one coordinate a step."""
        state = self.start(x.shape[1])
        for j in range(self.dim):
            state = self.step(state, x[..., j])
        return self.finish(state)
