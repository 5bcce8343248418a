"""A network with its optimiser, its averaged weights and its learning rate over time."""

from __future__ import annotations

from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor, nn

__all__ = ["Learner", "Schedule", "learning_rate"]


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
        AdamW's.
    keep : float
        Decay of the average; less in the first iterations.
    clip : float
        Largest norm of a gradient.

    Attributes
    ----------
    model : callable
        The network as Fabric wraps it: call this one where gradients are wanted.
    """

    def __init__(
        self, fabric: Any, net: Net, average: Net, rate: float, weight_decay: float, keep: float, clip: float
    ) -> None:
        average.load_state_dict(net.state_dict())
        self.fabric, self.net, self.average, self.keep, self.clip = fabric, net, average, keep, clip
        self.optimizer = torch.optim.AdamW(
            net.parameters(), lr=rate, betas=(0.9, 0.98), weight_decay=weight_decay, fused=True
        )
        self._weights: list[Tensor] = []
        self._averaged: list[Tensor] = []

    def begin(self) -> None:
        """Hand everything to Fabric, once the state is in place."""
        self.model, self.stepper = self.fabric.setup(self.net, self.optimizer)
        self.average.to(self.fabric.device)
        self._weights, self._averaged = [*self.net.parameters()], [*self.average.parameters()]

    def step(self, loss: Tensor, rate: float, iteration: int) -> None:
        """One step down the gradient of `loss`."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.fabric.backward(loss)
        self.fabric.clip_gradients(self.model, self.stepper, max_norm=self.clip, error_if_nonfinite=False)
        self.stepper.step()
        self.stepper.zero_grad()
        keep = min(self.keep, (1 + iteration) / (10 + iteration))
        with torch.no_grad():
            torch._foreach_lerp_(self._averaged, self._weights, 1.0 - keep)

    def state(self) -> dict[str, Any]:
        """Weights, average and optimiser, for a checkpoint."""
        return {
            "net": self.net.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.net.load_state_dict(state["net"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
