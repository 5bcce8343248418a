"""Models that ship: weights as safetensors beside a card, checked against each other, and kept within what they know.

A model answers only for data like its family's: integrals outside the card's box get the consistent rule and are
flagged. As N grows beyond training the answer fades from the network to the consistent rule (Appendix C.2), by shares
that minimise the error on validation integrals, and where the share is 0 the network is not called.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from nqr_geom import check, registry
from nqr_geom.integrator.learn.card_page import page
from nqr_geom.integrator.learn.inet import INet, INetConfig, LearnedRule
from nqr_geom.integrator.learn.recipe import Recipe
from nqr_geom.integrator.learn.snet import LearnedSampler, SNet, SNetConfig
from nqr_geom.integrator.learn.tokens import Extra, sort_samples
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Combination, Rule

__all__ = ["BLEND_SIZES", "Card", "Model", "checked", "load", "mix", "save", "trusted", "write_card"]

BLEND_SIZES = (8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096)
_MARGIN = 0.1  # of the trained range, beyond either end
_SAMPLER = "sampler."  # begins the names of a sampling network's weights


@dataclass(frozen=True)
class Card:
    """What a model is, where it comes from and what it may be used for.

    Parameters
    ----------
    name, problem, base, consistent : str
        Of the model; of its problem; registry names of the rule it corrects and of the one it fades to.
    config : INetConfig
        Architecture.
    iterations, batch, seed : int
        Of the training run.
    hours : float
        Wall time of it.
    family : dict
        Constants of the training family, and its splits.
    low, high : tuple of float
        Trained range of the application's checked quantities.
    sizes, shares : tuple
        At N = sizes[i] the network counts shares[i], the consistent rule the rest.
    table : dict
        Errors measured on test integrals, by the command in `command`.
    command : str
        What made the weights, and what measured them.
    sha256 : str
        Of the weights file.
    sampler : SNetConfig, optional
        Architecture of the sampling network that was trained with it; its weights lie in the same file.
    group : int
        Sequences for an integral in joint training.
    trust : float
        Where the consistent rule tells its doubt d, the share is multiplied by d / (d + trust): what that rule knows
        is not left to a network. 0: it counts the same everywhere.
    """

    name: str
    problem: str
    base: str
    consistent: str
    config: INetConfig
    iterations: int
    batch: int
    seed: int
    hours: float
    family: dict[str, Any]
    low: tuple[float, ...]
    high: tuple[float, ...]
    sizes: tuple[int, ...] = BLEND_SIZES
    shares: tuple[float, ...] = ()
    table: dict[str, Any] = field(default_factory=dict)
    command: str = ""
    sha256: str = ""
    sampler: SNetConfig | None = None
    group: int = 0
    trust: float = 0.0

    def to_json(self) -> str:
        """The card as JSON text; `from_json` is its inverse."""
        data = {**asdict(self), "config": self.config.to_dict()}
        if self.sampler is None:
            del data["sampler"], data["group"]
        else:
            data["sampler"] = self.sampler.to_dict()
        if not self.trust:
            del data["trust"]
        return json.dumps(data, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Card:
        """The card that `to_json` wrote."""
        data = json.loads(text)
        for name in ("low", "high", "sizes", "shares"):
            data[name] = tuple(data[name])
        if "sampler" in data:
            data["sampler"] = SNetConfig.from_dict(data["sampler"])
        return cls(**{**data, "config": INetConfig.from_dict(data["config"])})

    @property
    def box(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Where the model answers: the trained range of the checked quantities and a tenth of it beyond either end."""
        slack = [_MARGIN * (high - low) for low, high in zip(self.low, self.high, strict=True)]
        return (
            tuple(low - more for low, more in zip(self.low, slack, strict=True)),
            tuple(high + more for high, more in zip(self.high, slack, strict=True)),
        )

    def share(self, n: int) -> float:
        """How much the network counts at n samples: linear in log n between the measured sizes, 0 beyond them.

        Examples
        --------
        >>> card = Card("m", "toy", "mc", "trapezoid", INetConfig(), 0, 0, 0, 0.0, {}, (), (), (32, 128), (1.0, 0.5))
        >>> card.share(8), card.share(64), card.share(129)
        (1.0, 0.75, 0.0)
        """
        if n > self.sizes[-1]:
            return 0.0
        for k in range(1, len(self.sizes)):
            low, high = self.sizes[k - 1 : k + 1]
            if n <= high:
                at = max(0.0, math.log(n / low) / math.log(high / low))
                return self.shares[k - 1] * (1.0 - at) + self.shares[k] * at
        return self.shares[0]


def save(folder: str | Path, net: INet, card: Card, sampler: SNet | None = None) -> Card:
    """Write NAME.safetensors, NAME.json and NAME.md; returns the card with the hash of the weights."""
    safetensors = check.require("safetensors.torch", "learn", "models")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    tensors = dict(net.state_dict())
    if sampler is not None:
        tensors |= {_SAMPLER + name: tensor for name, tensor in sampler.state_dict().items()}
    weights = safetensors.save({name: tensor.contiguous() for name, tensor in tensors.items()})
    card = Card(**{**vars(card), "sha256": hashlib.sha256(weights).hexdigest()})
    (folder / f"{card.name}.safetensors").write_bytes(weights)
    write_card(folder, card)
    return card


def write_card(folder: str | Path, card: Card) -> None:
    """Write NAME.json and, for people, NAME.md."""
    (Path(folder) / f"{card.name}.json").write_text(card.to_json())
    (Path(folder) / f"{card.name}.md").write_text(page(card))


def _read(folder: str | Path, name: str) -> tuple[Card, dict[str, Tensor]]:
    """Card and weights of a model, checked against each other."""
    safetensors = check.require("safetensors.torch", "learn", "models")
    paths = [Path(folder) / f"{name}{suffix}" for suffix in (".json", ".safetensors")]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        raise ValueError(f"recipe: expected a trained model {name!r}, {' and '.join(missing)} not there")
    card, weights = Card.from_json(paths[0].read_text()), paths[1].read_bytes()
    digest = hashlib.sha256(weights).hexdigest()
    if digest != card.sha256:
        raise ValueError(f"card: expected weights with sha256 {card.sha256}, got {digest}")
    return card, safetensors.load(weights)


def _agree(card: Card, *wanted: tuple[str, object, object]) -> None:
    for name, mine, theirs in wanted:
        if mine != theirs:
            raise ValueError(f"card: expected {name} {mine}, got {theirs}")


def _fill(net: nn.Module, tensors: dict[str, Tensor]) -> None:
    """Load weights into a network of the same architecture."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    expected = {name: tuple(tensor.shape) for name, tensor in net.state_dict().items()}
    if shapes != expected:
        wrong = sorted(shapes.items() ^ expected.items())
        raise ValueError(f"card: expected weights of the shapes of its architecture, these differ: {wrong}")
    net.load_state_dict(tensors)
    net.eval()


def load(folder: str | Path, recipe: Recipe) -> Model:
    """The model of a recipe from its weights and card.

    Parameters
    ----------
    folder : path
        Where NAME.safetensors and NAME.json lie.
    recipe : Recipe
        How it was made.

    Raises
    ------
    ValueError
        If there is no such model, or card, weights and recipe do not belong together.
    """
    card, tensors = _read(folder, recipe.name)
    _agree(
        card,
        ("config", recipe.config, card.config),
        ("base", recipe.base, card.base),
        ("consistent", recipe.consistent, card.consistent),
        ("checked quantities", len(recipe.extra.checked) if recipe.extra else 0, len(card.low)),
    )
    net = INet(card.config)
    _fill(net, {name: tensor for name, tensor in tensors.items() if not name.startswith(_SAMPLER)})
    learned = LearnedRule(net, recipe.base_rule(), recipe.extra)
    return Model(card, learned, registry.make("rule", card.consistent), recipe.sees)


def load_sampler(folder: str | Path, name: str, net: SNet) -> LearnedSampler:
    """The sampling network of a pair from the file of its integrator.

    Parameters
    ----------
    folder, name
        As for `load`; `name` is the pair's.
    net : SNet
        A fresh network of its recipe, which gets the weights.

    Raises
    ------
    ValueError
        If there is no such model, or card, weights and recipe do not belong together.
    """
    card, tensors = _read(folder, name)
    _agree(card, ("sampler", net.config, card.sampler))
    _fill(net, {key.removeprefix(_SAMPLER): value for key, value in tensors.items() if key.startswith(_SAMPLER)})
    return LearnedSampler(net, card.problem, name=f"snet-{name}")


def checked(samples: Samples, extra: Extra | None) -> Tensor:
    """The quantities of samples that tell whether data resemble a family, (B, N T, K)."""
    if extra is None or not extra.checked:
        return samples.x.new_zeros(samples.x.shape[0], 1, 0)
    if extra.check is not None:
        return extra.check(samples).flatten(1, 2)
    return extra.compute(sort_samples(samples))[..., list(extra.checked)].flatten(1, 2)


@dataclass(frozen=True)
class Model(Rule):
    """A learned rule within its card's limits.

    Parameters
    ----------
    card : Card
        Limits and shares.
    learned : LearnedRule
        The network on its base rule.
    consistent : Rule
        What answers beyond the limits.
    sees : tuple of str
        Features that samples of its problem bring.
    """

    card: Card
    learned: LearnedRule
    consistent: Rule
    sees: tuple[str, ...] = ()

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"inet-{self.card.name}"

    def inside(self, samples: Samples) -> Tensor:
        """Integrals that resemble the training family, (B,) bool."""
        seen = checked(samples, self.learned.extra)
        low, high = (seen.new_tensor(end) for end in self.card.box)
        inside = ((seen >= low) & (seen <= high)).all(dim=2).all(dim=1)
        for feature in self.card.config.tokens.features:
            if feature.kind == "index":
                inside &= (samples.feature(feature.name, self.name) < feature.levels).flatten(1).all(dim=1)
        if self.learned.extra is not None and self.learned.extra.foreign is not None:
            inside &= ~self.learned.extra.foreign(samples)
        return inside

    def combine(self, samples: Samples) -> Combination:
        taught = self.learned.extra.taught if self.learned.extra else ()
        features = set(samples.seen.features).difference(taught)
        if samples.dim != self.card.config.tokens.dim or features != set(self.sees):
            have = ", ".join(samples.seen.features) or "none"
            raise ValueError(f"rule: {self.name!r} needs samples of {self.card.problem!r}, these have features {have}")
        safe = self.consistent.combine(samples)
        share, inside = self.card.share(samples.n), self.inside(samples)
        if share == 0.0 or not inside.any():
            return replace(safe, fallback=self._gave_way(torch.ones_like(inside), safe))
        learned = self.learned.combine(samples)
        part = share * trusted(safe.doubt, self.card.trust) * inside.to(samples.value.dtype)
        return replace(
            learned,
            weights=mix(part[:, None, None, None], learned.weights, safe.weights),
            offset=_mix_offsets(part, learned, safe),
            fallback=self._gave_way(~inside | (share < 0.5 * max(self.card.shares)), safe, learned),
        )

    def _gave_way(self, unknown: Tensor, *combinations: Combination) -> Tensor:
        """Integrals to flag, (B,): those where the network should have answered, and what either rule doubts."""
        doubts = [c.fallback for c in combinations if c.fallback is not None]
        if self.card.config.doubtful_only:
            unknown = torch.zeros_like(unknown)  # elsewhere the base is sure of itself, and flags the rest
        return torch.stack([unknown, *doubts]).any(dim=0)


def trusted(doubt: Tensor | None, trust: float) -> Tensor | float:
    """What a network counts beside a rule that is in doubt, (B,), see `Card.trust`.

    Examples
    --------
    >>> trusted(torch.tensor([0.0, 0.01, 1.0]), 0.01).tolist()[:2], trusted(None, 0.01)
    ([0.0, 0.5], 1.0)
    """
    if doubt is None or trust == 0.0:
        return 1.0
    return doubt / (doubt + trust)


def mix(part: Tensor, learned: Tensor, safe: Tensor) -> Tensor:
    """part learned + (1 - part) safe, exactly either where part is 1 or 0 (and whatever the other one is there)."""
    return torch.where(part == 1.0, learned, torch.where(part == 0.0, safe, part * learned + (1.0 - part) * safe))


def _mix_offsets(part: Tensor, learned: Combination, safe: Combination) -> Tensor | None:
    if learned.offset is None and safe.offset is None:
        return None
    zero = part.new_zeros(1, 1)
    mine, theirs = (zero if c.offset is None else c.offset for c in (learned, safe))
    most = max(mine.ndim, theirs.ndim)
    mine, theirs = (offset[:, None] if offset.ndim < most else offset for offset in (mine, theirs))
    return mix(part.reshape(-1, *[1] * (most - 1)), mine, theirs)
