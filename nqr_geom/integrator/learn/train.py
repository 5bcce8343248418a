"""Training the integration network by mean squared error on a family of integrals with known answers.

Every iteration sees fresh integrals, keyed by a global counter in the split "train": none comes twice, none can be
a test integral, and a run that was killed goes on as if it had not been. The learning rate warms up, stays, and decays
at the end (so that a run can be continued from before its decay); an exponential average of the weights is what ships.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

import torch
from torch import Tensor

from nqr_geom import check
from nqr_geom.integrator.learn.inet import INet, INetConfig, correct, doubt, has_bfloat16
from nqr_geom.integrator.learn.learner import Learner, Optimizer, learning_rate
from nqr_geom.integrator.learn.recipe import Batch, Recipe, draw_samples, inner_answer, training_link
from nqr_geom.integrator.learn.run import RunFolder
from nqr_geom.integrator.learn.tokens import sort_samples, standard, tokenize
from nqr_geom.integrator.problem import ExpLink, LogLink, Samples
from nqr_geom.integrator.samplers import Sampler
from nqr_geom.integrator.sums import row_mean
from nqr_geom.streams import Stream

__all__ = ["TrainConfig", "alike", "draw_batch", "learning_rate", "loss", "residuals", "robust", "train"]

_OTHERS = 8  # parts without doubt, of which one is looked at
_BEFORE = {"optimizer": "adamw"}  # of runs that do not say, because there was no choice
_NOTHING = 1e-30  # of a loss
_SMALLEST = 1e-9  # error that counts as one: below, rounding would be learned


@dataclass(frozen=True)
class TrainConfig:
    """How long and how fast.

    Parameters
    ----------
    iterations : int
        Of the whole run, those done before a continuation included.
    batch : int
        Integrals an iteration (over all devices).
    rate : float
        Highest learning rate.
    warmup, decay : int
        Iterations of the linear rise at the start and the linear fall to zero at the end; decay 0 leaves the run
        open, to be continued.
    clip : float
        Largest norm of a gradient.
    average : float
        Decay of the exponential average of the weights.
    weight_decay : float
        Of the optimiser.
    optimizer : {"adamw", "muon"}
        As for `Learner`. By Muon attention blocks learn in 420 iterations what takes 700 by AdamW
        (`benchmarks/learning_speed.py`).
    every : int
        Iterations between checkpoints, each with a line of the loss curve.
    validation : int
        Integrals of the validation split that are measured then.
    seed : int
        Of initial weights and data.
    """

    iterations: int
    batch: int = 256
    rate: float = 2e-3
    warmup: int = 500
    decay: int = 0
    clip: float = 1.0
    average: float = 0.999
    weight_decay: float = 0.01
    optimizer: Optimizer = "adamw"
    every: int = 500
    validation: int = 4096
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("iterations", "batch", "every", "validation"):
            check.integer(name, getattr(self, name), low=1)
        for name in ("warmup", "decay"):
            check.integer(name, getattr(self, name), low=0)
        check.number("rate", self.rate, low=0.0, open_low=True)
        check.number("average", self.average, low=0.0, high=1.0)
        check.choice("optimizer", self.optimizer, get_args(Optimizer))


def draw_batch(
    recipe: Recipe, rows: Tensor, n: int, seed: int, split: str, sampler: Sampler | None = None
) -> tuple[Batch, Samples]:
    """Integrals of the global `rows` (B,) and samples by the recipe's designs or a sampler, sorted in one dimension."""
    batch, stream = recipe.family(rows, seed, split), Stream(seed, split, "samples")
    if sampler is None:
        samples = draw_samples(batch.problem, recipe.designs, n, stream)
    else:
        samples = sampler.draw(batch.problem, n, stream)
    return batch, sort_samples(samples)


def draw_lesson(recipe: Recipe, rows: Tensor, n: int, seed: int) -> tuple[Batch, Samples]:
    """What one iteration learns from: `rows` (B,), or as many of `surplus` times more rows as its base rule flags."""
    if not recipe.config.doubtful_only:
        return draw_batch(recipe, rows, n, seed, "train")
    more = (rows[:, None] * recipe.surplus + torch.arange(recipe.surplus, device=rows.device)).flatten()
    batch, samples = draw_batch(recipe, more, n, seed, "train")
    flags = recipe.base_rule().combine(samples).fallback
    chosen = torch.arange(len(more)) if flags is None else flags.nonzero()[: len(rows), 0]
    if not len(chosen):
        chosen = torch.arange(1, device=rows.device)
    return batch.take(chosen), samples.take(chosen)


def _huber(error: Tensor, knee: float) -> Tensor:
    """error^2 up to the knee, linear growth beyond (pseudo-Huber)."""
    return 2.0 * knee**2 * (torch.sqrt(1.0 + (error / knee) ** 2) - 1.0)


def residuals(
    recipe: Recipe, net: Callable[[Tensor], Tensor], batch: Batch, samples: Samples
) -> tuple[Tensor, Tensor | None]:
    """Errors of the corrected rule before and behind the link, (B, C) each; one and None where there is no link.

    With the logarithm both are relative errors of the inner integral to first order, so that neither alpha nor the
    distance weighs them: the inner error counts in units of the truth, or of the estimate where that is larger, and
    -1/alpha stays out of the outer one, as in Eq. 56. With the exponential (Eq. 6) depths above 1 count relatively,
    since nothing is seen through them.
    """
    samples, link = batch.problem.finalize(samples)
    tokens = tokenize(samples, recipe.config.tokens, recipe.extra)  # (B, N, T, width)
    b, n, t, width = tokens.shape
    raw = net(tokens.view(b, n * t, width)).view(b, n, t, -1)
    mine = correct(raw, recipe.base_rule().combine(samples), samples, recipe.config, recipe.extra)
    inner, link = mine.estimate(samples), mine.link or link
    truth = inner_answer(batch.answer, link)
    if isinstance(link, ExpLink):
        return (inner - truth) / truth.clamp_min(1.0), training_link(link, inner) - batch.answer
    if not isinstance(link, LogLink):
        return inner - truth, None
    return (inner - truth) / torch.maximum(truth, inner.detach()), link.alpha * (
        training_link(link, inner) - batch.answer
    )


def expected_error(recipe: Recipe, samples: Samples) -> Tensor | None:
    """Squared error that the base rule itself expects, (B, 1), of networks that work in units of its doubt."""
    if not recipe.config.in_doubt:
        return None
    return (row_mean(doubt(samples, recipe.extra).square()) / samples.n)[:, None]


def robust(
    recipe: Recipe, before: Tensor, behind: Tensor | None, expected: Tensor | None = None, weight: Tensor | None = None
) -> Tensor:
    """Mean (robust) squared error of residuals (Eqs. 53 to 56), in units of the expected ones or else the recipe's."""
    unit = recipe.unit if expected is None else expected.sqrt().clamp_min(_SMALLEST)
    each = _huber(before / unit, recipe.huber)
    if behind is not None:
        each = recipe.inner * each + recipe.outer * _huber(behind, recipe.huber)
    return (each if weight is None else each * weight[:, None]).mean()


def _of_offset(recipe: Recipe, net: Callable[[Tensor], Tensor], batch: Batch, samples: Samples, part: Tensor) -> Tensor:
    """Mean (robust) squared error of an offset if what it leaves of one part (B, N) tells nothing of another one."""
    config = recipe.config
    if config.weights != "kept" or config.outputs != 1 or config.in_doubt:
        raise ValueError(f"recipe: expected layers that give an offset alone, in units of the row, got {recipe.name!r}")
    raw = net(tokenize(samples, config.tokens, recipe.extra).flatten(1, 2))[..., 0]  # (B, N)
    said = raw * standard(samples.value, config.tokens)[1][:, 0, 0] / samples.n
    each = _huber((said - part) / recipe.unit, recipe.huber).sum(dim=1)
    return (each if batch.weight is None else each * batch.weight).mean()


def piecewise(recipe: Recipe, net: Callable[[Tensor], Tensor], batch: Batch, samples: Samples) -> Tensor:
    """Mean (robust) squared error of what the network says of every sample's own part.

    Attention layers give an offset, whose parts count as they are. Tokens that are read alone count in units of their
    doubt, each by its doubt over that of its whole row. By the square of it, those that leave most would be all there
    is; by none, those that leave nothing. A network that changes weights has to be right where nothing is in doubt,
    too: the recipe's unit is added to every doubt, and one in `_OTHERS` of these parts is looked at, for all of them.
    """
    if recipe.missed is None:
        raise ValueError(f"recipe: expected one that tells what its base rule misses, got {recipe.name!r}")
    if recipe.config.layers:
        return _of_offset(recipe, net, batch, samples, recipe.missed(batch, samples))
    size = doubt(samples, recipe.extra) / samples.n  # (B, N)
    chosen, counts, effect = size > 0.0, torch.ones_like(size), torch.ones_like(size)
    if not recipe.config.in_doubt:
        counts = torch.where(chosen, 1.0, float(_OTHERS))
        row, at = (torch.arange(many, device=size.device) for many in size.shape)
        chosen = chosen | ((row[:, None] + at) % _OTHERS == 0)
        size = torch.hypot(size, size.new_tensor(recipe.unit))
        effect = samples.value[..., 0, 0] / (samples.n * size)
    weight = counts * size / size.square().sum(dim=1, keepdim=True).sqrt()
    if batch.weight is not None:
        weight = weight * batch.weight[:, None]
    tokens = tokenize(samples, recipe.config.tokens, recipe.extra)[chosen]  # (M, 1, width)
    said, wanted = net(tokens)[:, 0, 0] * effect[chosen], (recipe.missed(batch, samples) / size)[chosen]
    weight = weight[chosen]
    return (weight * _huber(said - wanted, recipe.huber)).sum() / weight.sum().clamp_min(_SMALLEST)


def loss(recipe: Recipe, net: Callable[[Tensor], Tensor], batch: Batch, samples: Samples) -> Tensor:
    """Mean (robust) squared error of the corrected rule over a batch, before and behind the link."""
    if recipe.missed is not None:
        return piecewise(recipe, net, batch, samples)
    return robust(recipe, *residuals(recipe, net, batch, samples), expected_error(recipe, samples), batch.weight)


def alike(recipe: Recipe, value: Tensor, fabric: Any) -> Tensor:
    """A loss as it counts: by itself, or where all iterations count alike, over what it is for the whole batch."""
    if not recipe.alike:
        return value
    whole: Tensor = fabric.all_reduce(value.detach().clone(), reduce_op="mean")
    return value / whole.clamp_min(_NOTHING)


@torch.no_grad()
def validate(recipe: Recipe, net: INet, config: TrainConfig) -> tuple[float, float]:
    """Mean squared error of the network's rule and of its base on the validation split."""
    errors = []
    for rows in torch.arange(config.validation).split(1024):
        batch, samples = draw_batch(recipe, rows, recipe.sizes[0][0], config.seed, "validation")
        samples, link = batch.problem.finalize(samples)
        tokens = tokenize(samples, recipe.config.tokens, recipe.extra).flatten(1, 2)
        raw = net(tokens).view(*samples.value.shape[:3], -1)
        base = recipe.base_rule().combine(samples)
        mine = correct(raw, base, samples, recipe.config, recipe.extra)
        pair = [(c.link or link)(c.estimate(samples)) for c in (mine, base)]
        errors.append(torch.stack([(value - batch.answer).square().mean(dim=1) for value in pair]))
    mse, base_mse = torch.cat(errors, dim=1).mean(dim=1).tolist()
    return mse, base_mse


def train(
    recipe: Recipe,
    out: str | Path,
    config: TrainConfig,
    *,
    start_from: str | Path | None = None,
    devices: int = 1,
    num_nodes: int = 1,
    accelerator: str = "cpu",
    precision: str | None = None,
    progress: bool = True,
) -> INet:
    """Train a recipe's network, or go on with a run that was begun in the same folder.

    Parameters
    ----------
    recipe : Recipe
        What to train.
    out : path
        Folder of the run: `checkpoint.pt` (weights, average, optimiser), `loss.csv`, `loss.png`.
    config : TrainConfig
        How long and how fast. A continuation may change the length and the rates, not batch, seed or optimiser.
    start_from : path, optional
        Run of another recipe with the same width and tokens: a new run begins with its averaged weights, the
        heads aside, which start as the base rule. Those of a run of the same recipe, perhaps with another batch or
        optimiser, are taken over, too. What the other network did not read or have yet (quantities of the application,
        neighbours, tokens in the heads, hidden units, blocks) weighs nothing at first. Of one with more blocks the
        first are taken.
    devices, num_nodes, accelerator, precision
        As for `lightning_fabric.Fabric`; by default attention layers work in bfloat16 on a GPU, and on a processor
        that multiplies it by tiles (AMX).
    progress : bool
        Show a progress bar.

    Returns
    -------
    INet
        With the averaged weights.

    Raises
    ------
    ValueError
        If the folder holds a run of another recipe, batch, seed or optimiser.
    """
    fabric = launch(recipe.config, devices, num_nodes, accelerator, precision)
    run = RunFolder(Path(out))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        net = INet(recipe.config)
    if start_from is not None:
        _adopt(net, RunFolder(Path(start_from)).checkpoint, recipe.name)
    learner = Learner(
        fabric,
        net,
        INet(recipe.config),
        config.rate,
        config.weight_decay,
        keep=config.average,
        clip=config.clip,
        optimizer=config.optimizer,
    )
    sizes = Stream(config.seed, "train", "sizes")

    def lesson(iteration: int, rows: Tensor) -> Tensor:
        batch, samples = draw_lesson(recipe, rows, recipe.size(sizes, iteration), config.seed)
        value = loss(recipe, learner.model, batch, samples)
        learner.step(alike(recipe, value, fabric), learning_rate(config, iteration), iteration)
        return value

    def measure() -> tuple[float, float]:
        return validate(recipe, learner.average, config)

    follow(fabric, run, config, identity(recipe, config), learner, {}, lesson, measure, progress)
    return learner.average


def follow(
    fabric: Any,
    run: RunFolder,
    config: TrainConfig,
    wanted: Mapping[str, Any],
    learner: Learner[Any],
    others: Mapping[str, Learner[Any]],
    lesson: Callable[[int, Tensor], Tensor],
    measure: Callable[[], tuple[float, float]],
    progress: bool,
) -> None:
    """Give one lesson after the other from where the run stands, with checkpoints and a loss curve.

    Parameters
    ----------
    fabric, run, config, wanted
        Where it runs and is kept, how long, and the identity of the run.
    learner, others
        The network whose state the checkpoint is, and those with entries of their own in it.
    lesson : callable
        (iteration, global rows of this process) to the loss, with all learners one step further.
    measure : callable
        Validation error, and that of the base.
    progress : bool
        Show a progress bar.
    """
    state = fabric.broadcast(run.load() if fabric.is_global_zero else None)
    start, seconds = 0, 0.0
    if state is not None:
        refuse_other_run(state, wanted)
        learner.restore(state)
        for name, other in others.items():
            other.restore(state[name])
        start, seconds = state["iteration"], state["seconds"]
    for one in (learner, *others.values()):
        one.begin()
    began, losses = time.monotonic() - seconds, []
    with Progress(progress and fabric.is_global_zero) as advance:
        for iteration in range(start, config.iterations):
            rows = torch.arange(iteration * config.batch, (iteration + 1) * config.batch, device=fabric.device)
            losses.append(lesson(iteration, rows[fabric.global_rank :: fabric.world_size]).detach())
            done = iteration + 1
            if (done % config.every == 0 or done == config.iterations) and fabric.is_global_zero:
                seconds = time.monotonic() - began
                mean = torch.stack(losses).mean().item()
                losses = []
                run.log((done, seconds, learning_rate(config, iteration), mean, *measure()))
                run.save(
                    {
                        "identity": to_json(wanted),
                        "train": json.dumps(asdict(config)),
                        "iteration": done,
                        "seconds": seconds,
                        **learner.state(),
                        **{name: other.state() for name, other in others.items()},
                    }
                )
            advance(done, config.iterations, losses)
    if fabric.is_global_zero:
        run.plot()


def fitting_precision(config: INetConfig, accelerator: str) -> str:
    """Products in bfloat16 where that is faster and there are attention layers to gain from it."""
    half = config.layers > 0 and (accelerator != "cpu" or has_bfloat16())
    return "bf16-mixed" if half else "32-true"


def launch(config: INetConfig, devices: int, num_nodes: int, accelerator: str, precision: str | None) -> Any:
    """The launched Fabric; more than one process train by distributed data parallelism."""
    precision = precision or fitting_precision(config, accelerator)
    module = check.require("lightning_fabric", "learn", "training runs")
    strategy = "ddp" if devices * num_nodes > 1 else "auto"
    fabric = module.Fabric(
        accelerator=accelerator, devices=devices, num_nodes=num_nodes, precision=precision, strategy=strategy
    )
    fabric.launch()
    return fabric


def widen(weights: dict[str, Tensor], net: INet) -> None:
    """Fit the weights of a smaller network: what `net` reads and has beyond it weighs nothing at first.

    Quantities and tokens stand behind what was read before, neighbours on both sides of it; hidden units and blocks
    behind those that were there. What these compute begins as in an untrained network, so that they can learn.
    """
    for key, own in net.state_dict().items():
        _, _, part = key.partition("blocks.")[2].partition(".")  # of a block, "" elsewhere
        known = weights.get(key)
        if known is None and part:
            known = torch.zeros_like(own) if part.startswith(("out.", "down.")) else own
        if known is None:
            continue
        if key in ("embed_in.weight", "head.weight") or part in ("up.weight", "down.weight"):
            more = max(0, own.shape[1] - known.shape[1])
            before = more // 2 if part == "up.weight" else 0
            known = torch.nn.functional.pad(known, (before, more - before))
        if part.startswith("up."):
            known = torch.cat([known, own[len(known) :]]) if known.shape[1:] == own.shape[1:] else known
        weights[key] = known


def _adopt(net: INet, checkpoint: Path, name: str) -> None:
    """Copy another run, but for the heads of another recipe; what this one has beyond it starts with weight zero."""
    if not checkpoint.exists():
        raise ValueError(f"start_from: expected a folder with a checkpoint, got {str(checkpoint.parent)!r}")
    state = torch.load(checkpoint, weights_only=True)
    weights, same = state["average"], json.loads(state["identity"])["recipe"] == name
    widen(weights, net)
    own = {key: tensor for key, tensor in net.state_dict().items() if same or not key.startswith("head.")}
    wrong = [key for key, tensor in own.items() if key not in weights or weights[key].shape != tensor.shape]
    if wrong:
        raise ValueError(f"start_from: expected a run of the same tokens and width, these differ: {wrong}")
    net.load_state_dict({key: weights[key] for key in own}, strict=False)


def identity(recipe: Recipe, config: TrainConfig) -> dict[str, Any]:
    """What must not change when a run is continued."""
    run = {name: getattr(config, name) for name in ("batch", "seed", "optimizer")}
    return {"recipe": recipe.name, **run, "config": recipe.config}


def to_json(identity: Mapping[str, Any]) -> str:
    """An identity as a checkpoint keeps it; configurations become plain data."""
    return json.dumps({k: v.to_dict() if hasattr(v, "to_dict") else v for k, v in identity.items()})


def refuse_other_run(state: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Raise unless the checkpoint has the wanted identity."""
    found = json.loads(state["identity"])
    for name, want in wanted.items():
        have = found.get(name, _BEFORE.get(name))
        # A configuration is compared as one, so that a run goes on when a field with a default is added.
        if (type(want).from_dict(have) if hasattr(want, "from_dict") else have) != want:
            raise ValueError(f"out: expected a run with {name} {want}, found one with {have}")


class Progress:
    """A rich progress bar, or none."""

    def __init__(self, show: bool) -> None:
        self.show = show

    def __enter__(self) -> Callable[[int, int, list[Tensor]], None]:
        if not self.show:
            return lambda done, total, losses: None
        from rich import progress

        columns = progress.Progress.get_default_columns()[:-1]
        self.progress = progress.Progress(*columns, progress.TimeRemainingColumn())
        self.progress.start()
        task = self.progress.add_task("training")

        def advance(done: int, total: int, losses: list[Tensor]) -> None:
            text = f"training, loss {losses[-1].item():.2e}" if losses else "training"
            self.progress.update(task, completed=done, total=total, description=text)

        return advance

    def __exit__(self, *_: object) -> None:
        if self.show:
            self.progress.stop()
