"""What makes a model: a family of integrals with known answers, a base rule, a network, and how it is trained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nqr_geom import registry
from nqr_geom.integrator.learn.inet import INetConfig, UniformWeights
from nqr_geom.integrator.learn.tokens import Extra
from nqr_geom.integrator.problem import ExpLink, Link, LogLink, Problem, Samples
from nqr_geom.integrator.rules import Rule
from nqr_geom.streams import Stream

__all__ = ["Batch", "Recipe", "draw_samples", "inner_answer"]

_FAINTEST = 1e-300
_LARGEST = 600.0  # exponent that float64 holds with room to spare


@dataclass(frozen=True)
class Batch:
    """Integrals of a family with their answers.

    Parameters
    ----------
    problem : Problem
        B integrals.
    answer : Tensor, (B, C), float64
        True G(F).
    weight : Tensor, (B,), float64, optional
        How often each is met in the family over how often it is drawn, where training looks at some more than at
        others. Without it a network would take what it is shown for what there is.
    """

    problem: Problem
    answer: Tensor
    weight: Tensor | None = None

    def take(self, index: Tensor) -> Batch:
        """Some of the integrals."""
        weight = None if self.weight is None else self.weight[index]
        return Batch(self.problem.take(index), self.answer[index], weight)


@dataclass(frozen=True)
class Recipe:
    """How one model is made.

    Parameters
    ----------
    name : str
        Of the model.
    problem : str
        Name of the problem it is for.
    family : callable
        (rows (B,) int64, seed, split) to a Batch; a pure function of its arguments.
    base : str
        Registry name of the rule that the network corrects, or "uniform" for W = 1.
    consistent : str
        Registry name of the rule that the estimate tends to as N grows.
    config : INetConfig
        Network.
    sees : tuple of str
        Features that samples of the problem bring; samples with others are of another problem.
    extra : Extra, optional
        The application's own token quantities.
    sizes : tuple of (int, float)
        Numbers of samples and their shares of the iterations.
    designs : tuple of str
        Samplers; every batch is divided evenly among them.
    largest : int
        Samples beyond which the network is not called, because attention costs more than it brings.
    surplus : int
        Integrals that are drawn for one that is learned from. A network that corrects only what its base rule flags
        (`INetConfig.doubtful_only`) learns from flagged integrals alone.
    huber : float
        Errors beyond it count linearly instead of squared, so that one near singularity does not drown a batch.
    unit : float
        Size of an error, in which errors and `huber` count, where the base rule tells none: an optimiser does not tell
        gradients far below 1e-8 from nothing. Lessons by parts (`missed`) on weights add it to what is in doubt.
    alike : bool
        Every iteration counts alike: by its loss over that loss itself, taken as a number. Where errors fall fast with
        the number of samples, iterations with few of them would otherwise outweigh all others.
    inner, outer : float
        Shares of the losses before and behind the link (Eq. 53); the identity link has only one.
    missed : callable, optional
        (batch, sorted samples of a training family) to what the base rule misses beside each sample, (B, N); together
        that is its error. A network that only shifts the base, or one of 0 layers that only adds to its weights, then
        learns from each of them instead of from their sum, in which the others are noise.
    trusts : tuple of float
        Doubts of the consistent rule at which the network may count half of its share (`Card.trust`); the one with the
        least error on validation integrals is taken. 0: that is not asked.
    """

    name: str
    problem: str
    family: Callable[[Tensor, int, str], Batch]
    base: str
    consistent: str
    config: INetConfig
    sees: tuple[str, ...] = ()
    extra: Extra | None = None
    sizes: tuple[tuple[int, float], ...] = ((32, 1.0),)
    designs: tuple[str, ...] = ("random", "stratified")
    largest: int = 4096
    surplus: int = 1
    huber: float = 1.0
    unit: float = 1.0
    alike: bool = False
    inner: float = 0.2
    outer: float = 0.8
    missed: Callable[[Batch, Samples], Tensor] | None = None
    trusts: tuple[float, ...] = (0.0,)

    def base_rule(self) -> Rule:
        """The rule that the network corrects."""
        rule: Rule = UniformWeights() if self.base == "uniform" else registry.make("rule", self.base)
        return rule

    def size(self, stream: Stream, iteration: int) -> int:
        """Samples per integral of an iteration, drawn with the given shares."""
        at = float(stream.uniform(torch.tensor(iteration)))
        total = sum(share for _, share in self.sizes)
        for n, share in self.sizes:
            at -= share / total
            if at < 0.0:
                return n
        return self.sizes[-1][0]


def draw_samples(problem: Problem, designs: tuple[str, ...], n: int, stream: Stream) -> Samples:
    """Samples of all integrals, each by the design that its global row modulo their number names.

    A network is told nothing of the design but the points themselves and their densities, if all designs have one.
    """
    if len(designs) == 1:
        return registry.make("sampler", designs[0]).draw(problem, n, stream)
    which = problem.rows % len(designs)
    parts = [
        registry.make("sampler", designs[k]).draw(problem.take((which == k).nonzero()[:, 0]), n, stream)
        for k in which.unique().tolist()
    ]
    bare = {"design": "+".join(designs), "independent": False, "stratum": None, "volume": None}
    if any(part.pdf is None for part in parts):
        bare["pdf"] = None
    plain = [replace(part, **bare) for part in parts]
    return Samples.stack(plain).take(which.argsort(stable=True).argsort())


def inner_answer(answer: Tensor, link: Link) -> Tensor:
    """The inner integral F of a true answer G(F), (B, C)."""
    if isinstance(link, LogLink):
        return torch.exp((-link.alpha * (answer - link.shift)).clamp(-_LARGEST, _LARGEST))
    if isinstance(link, ExpLink):
        return -torch.log(answer.clamp_min(_FAINTEST))
    if link.name == "identity":
        return answer
    raise ValueError(f"link: expected identity, log or exp, got {link.name!r}")


def training_link(link: Link, inner: Tensor, floor: float = 1e-8) -> Tensor:
    """G of an estimate that may still be negative: the logarithm of its clamped absolute value (Eq. 56), and the
    exponential as it is, so that it pulls back."""
    if isinstance(link, LogLink):
        return replace(link, floor=floor)(inner.abs())
    if isinstance(link, ExpLink):
        return torch.exp(-inner.clamp_min(-1.0))
    return link(inner)
