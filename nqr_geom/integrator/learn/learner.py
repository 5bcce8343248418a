"""A network with its optimiser, its averaged weights and its learning rate over time."""

from __future__ import annotations

from typing import Any, Generic, Literal, Protocol, TypeVar

import torch
from torch import Tensor, nn

__all__ = ["Learner", "Optimizer", "Schedule", "learning_rate"]

Optimizer = Literal["adamw", "muon"]


class Schedule(Protocol):
    """How many iterations, and how the rate rises and falls."""

    @property
    def iterations(self) -> int: ...
    @property
    def rate(self) -> float: ...
    @property
    def warmup(self) -> int: ...
    @property
    def decay(self) -> int: ...


def learning_rate(config: Schedule, iteration: int) -> float:
    """Linear rise over `warmup` iterations, stable, linear fall to zero over the last `decay`.

    Examples
    --------
    >>> from nqr_geom.integrator.learn.train import TrainConfig
    >>> config = TrainConfig(iterations=100, warmup=10, decay=20, rate=1.0)
    >>> [learning_rate(config, i) for i in (0, 50, 90)]
    [0.1, 1.0, 0.5]
    """
    rise = min(1.0, (iteration + 1) / max(config.warmup, 1))
    fall = min(1.0, (config.iterations - iteration) / config.decay) if config.decay else 1.0
    return config.rate * rise * fall


Net = TypeVar("Net", bound=nn.Module)


class Learner(Generic[Net]):
    """A network that is trained.

    Parameters
    ----------
    fabric : lightning_fabric.Fabric
        Where and how it runs.
    net, average : nn.Module
        The network, and another of the same weights that holds their exponential average.
    rate, weight_decay : float
        Of the optimiser.
    keep : float
        Decay of the average; less in the first iterations.
    clip : float
        Largest norm of a gradient.
    optimizer : {"adamw", "muon"}
        Muon steps along the nearest orthogonal matrix to the gradient of each weight matrix inside blocks, as far as
        AdamW would go; AdamW does the rest, or everything.

    Attributes
    ----------
    model : callable
        The network as Fabric wraps it: call this one where gradients are wanted.

    References
    ----------
    Muon: Jordan et al. 2024, https://kellerjordan.github.io/posts/muon; step lengths of Liu et al. 2025,
    arXiv:2502.16982.
    """

    def __init__(
        self,
        fabric: Any,
        net: Net,
        average: Net,
        rate: float,
        weight_decay: float,
        keep: float,
        clip: float,
        optimizer: Optimizer = "adamw",
    ) -> None:
        average.load_state_dict(net.state_dict())
        self.fabric, self.net, self.average, self.keep, self.clip = fabric, net, average, keep, clip
        inner: list[nn.Parameter] = []
        others: list[nn.Parameter] = []
        for name, weight in net.named_parameters():
            by_muon = optimizer == "muon" and weight.ndim == 2 and name.startswith("blocks.")
            (inner if by_muon else others).append(weight)
        self.optimizers: dict[str, torch.optim.Optimizer] = {  # by their names in a checkpoint
            "optimizer": torch.optim.AdamW(others, lr=rate, betas=(0.9, 0.98), weight_decay=weight_decay, fused=True)
        }
        if inner:
            self.optimizers["muon"] = torch.optim.Muon(
                inner, lr=rate, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw"
            )
        self._weights: list[Tensor] = []
        self._averaged: list[Tensor] = []

    def begin(self) -> None:
        """Hand everything to Fabric, once the state is in place."""
        self.model, *self.steppers = self.fabric.setup(self.net, *self.optimizers.values())
        self.average.to(self.fabric.device)
        self._weights, self._averaged = [*self.net.parameters()], [*self.average.parameters()]

    def step(self, loss: Tensor, rate: float, iteration: int) -> None:
        """One step down the gradient of `loss`."""
        for optimizer in self.optimizers.values():
            for group in optimizer.param_groups:
                group["lr"] = rate
        self.fabric.backward(loss)
        self.fabric.clip_gradients(self.model, self.steppers[0], max_norm=self.clip, error_if_nonfinite=False)
        for stepper in self.steppers:
            stepper.step()
            stepper.zero_grad()
        keep = min(self.keep, (1 + iteration) / (10 + iteration))
        with torch.no_grad():
            torch._foreach_lerp_(self._averaged, self._weights, 1.0 - keep)

    def state(self) -> dict[str, Any]:
        """Weights, average and optimisers, for a checkpoint."""
        steps = {name: optimizer.state_dict() for name, optimizer in self.optimizers.items()}
        return {"net": self.net.state_dict(), "average": self.average.state_dict(), **steps}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.net.load_state_dict(state["net"])
        self.average.load_state_dict(state["average"])
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(state[name])
