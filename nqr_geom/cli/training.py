"""The command that trains networks: `train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nqr_geom import check
from nqr_geom.cli._app import app, out_console

__all__ = ["train"]


@app.command
def train(
    name: Annotated[str, Parameter(help="A recipe such as gwn-uniform, a pair such as gwn-nqr, or toy, gwn or sd.")],
    *,
    out: Annotated[Path, Parameter(help="Folder of the run; a run that is there is continued.")],
    iterations: Annotated[int, Parameter(help="Of the whole run, those already done included.")],
    decay: Annotated[int, Parameter(help="Last iterations, in which the learning rate falls to 0.")] = 0,
    batch: Annotated[int | None, Parameter(help="Integrals an iteration: 256, or 32 for a pair.")] = None,
    rate: Annotated[float | None, Parameter(help="Highest learning rate: 2e-3, or 5e-4 for a pair.")] = None,
    optimizer: Annotated[Literal["adamw", "muon"], Parameter(help="muon: for networks with attention.")] = "adamw",
    seed: Annotated[int, Parameter(help="Of weights and data.")] = 0,
    start_from: Annotated[
        Path | None,
        Parameter(help="Run whose trunk a new run takes over; for a pair, the run of the integrator it begins with."),
    ] = None,
    accelerator: Annotated[str, Parameter(help="cpu, gpu, or what else lightning-fabric knows.")] = "cpu",
    devices: Annotated[int, Parameter(help="Processes on this machine.")] = 1,
    num_nodes: Annotated[int, Parameter(help="Machines.")] = 1,
    publish: Annotated[Path | None, Parameter(help="Folder for the weights and their card, when done.")] = None,
) -> None:
    """Train the network of a recipe or both networks of a pair, or go on with a run that was interrupted."""
    check.require("torch", "learn", "training runs")
    from nqr_geom.integrator.learn.joint import JointConfig, JointRecipe, train_jointly
    from nqr_geom.integrator.learn.publish import publish as make_model
    from nqr_geom.integrator.learn.train import TrainConfig
    from nqr_geom.integrator.learn.train import train as train_one
    from nqr_geom.recipes import named

    recipe = named(name)
    options: dict[str, Any] = {"iterations": iterations, "decay": decay, "optimizer": optimizer, "seed": seed}
    options |= {key: value for key, value in (("batch", batch), ("rate", rate)) if value is not None}
    where: dict[str, Any] = {"accelerator": accelerator, "devices": devices, "num_nodes": num_nodes}
    if isinstance(recipe, JointRecipe):
        train_jointly(recipe, out, JointConfig(**options), start_from=start_from, **where)
    else:
        train_one(recipe, out, TrainConfig(**options), start_from=start_from, **where)
    out_console.print(f"wrote {out}", highlight=False)
    if publish is not None:
        told = options | ({} if start_from is None else {"start-from": start_from})
        words = [f"--{key} {value}" for key, value in told.items()]
        card = make_model(recipe, out, publish, command=" ".join(["nqr-geom train", recipe.name, *words]))
        out_console.print(f"wrote {publish / card.name}.safetensors", highlight=False)
