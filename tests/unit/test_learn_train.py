"""Training: keyed fresh data, exact continuation, a schedule that can be extended, and that it learns at all."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from nqr_geom.cli import main
from nqr_geom.curves.families import control_points
from nqr_geom.curves.training import NEAREST, gwn_batch, near_distance, quadratic_winding
from nqr_geom.integrator.learn.inet import INet, INetConfig
from nqr_geom.integrator.learn.learner import Learner, Optimizer
from nqr_geom.integrator.learn.recipe import Batch, Recipe, draw_samples, inner_answer, training_link
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.learn.train import TrainConfig, alike, launch, learning_rate, loss, train
from nqr_geom.integrator.problem import Link, LogLink, Observation, Problem
from nqr_geom.recipes import JOINT, RECIPES
from nqr_geom.streams import Stream


@dataclass(frozen=True)
class Lines(Problem):
    """a + b x with random a and b: the simplest family that a plain mean gets wrong."""

    rows: Tensor
    terms: Tensor  # (B, 2)

    name = "lines"

    def evaluate(self, x: Tensor) -> Observation:
        value = self.terms[:, None, :1] + self.terms[:, None, 1:] * x
        return Observation(value[..., None], queries=value.numel())

    def take(self, index: slice | Tensor) -> Lines:
        return Lines(self.rows[index], self.terms[index])


def lines(rows: Tensor, seed: int, split: str) -> Batch:
    terms = 2.0 * Stream(seed, split, "lines").uniform(rows[:, None], torch.arange(2)) - 1.0
    return Batch(Lines(rows, terms), terms[:, :1] + 0.5 * terms[:, 1:])


TINY = Recipe(
    name="lines",
    problem="lines",
    family=lines,
    base="mc",
    consistent="trapezoid",
    config=INetConfig(TokenConfig(frequencies=2), layers=1, width=16, unit_mass=True),
    sizes=((8, 1.0),),
    designs=("random",),
)
SHORT = TrainConfig(iterations=12, batch=16, warmup=4, every=4, validation=32)


@pytest.fixture(autouse=True)
def quiet() -> None:
    """Two threads or sixteen must not matter here; one keeps the small products fast."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "loss.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def run(folder: Path, config: TrainConfig, recipe: Recipe = TINY) -> INet:
    return train(recipe, folder, config, precision="32-true", progress=False)


def test_a_tiny_network_beats_its_base_in_seconds(tmp_path: Path) -> None:
    config = TrainConfig(
        iterations=150, batch=64, rate=1e-2, warmup=10, decay=50, average=0.9, every=150, validation=512
    )
    run(tmp_path, config)
    last = curve(tmp_path)[-1]
    assert float(last["validation_mse"]) < 0.3 * float(last["base_mse"])
    assert 0.5 < float(last["base_mse"]) * 96.0 * 3.0 < 2.0  # E[b^2] / (12 N) with b uniform in (-1, 1)
    assert (tmp_path / "loss.png").stat().st_size > 1000


def test_muon_trains_the_matrices_inside_blocks_alone(tmp_path: Path) -> None:
    before = INet(TINY.config)
    fabric = launch(TINY.config, 1, 1, "cpu", "32-true")
    learner = Learner(fabric, before, INet(TINY.config), 1e-3, 0.0, 0.9, 1.0, "muon")
    others, inner = ({id(weight) for weight in one.param_groups[0]["params"]} for one in learner.optimizers.values())
    names = {name for name, weight in before.named_parameters() if id(weight) in inner}
    assert names == {f"blocks.0.{name}.weight" for name in ("qkv", "out", "up", "down")}
    assert others == {id(weight) for weight in before.parameters()} - inner
    long = TrainConfig(iterations=150, batch=64, rate=1e-2, warmup=10, decay=50, average=0.9, every=150, validation=512)
    run(tmp_path, replace(long, optimizer="muon"))
    last = curve(tmp_path)[-1]
    assert float(last["validation_mse"]) < 0.3 * float(last["base_mse"])


@pytest.mark.parametrize("optimizer", ["adamw", "muon"])
def test_a_killed_run_goes_on_as_if_it_had_not_been(tmp_path: Path, optimizer: Optimizer) -> None:
    config = replace(SHORT, optimizer=optimizer)
    whole = run(tmp_path / "whole", config)
    run(tmp_path / "parts", replace(config, iterations=8))
    # What a kill between checkpoints leaves behind: a line that the checkpoint does not know.
    with (tmp_path / "parts" / "loss.csv").open("a") as file:
        file.write("10,1,1,1,1,1\n")
    parts = run(tmp_path / "parts", config)
    for a, b in zip(whole.parameters(), parts.parameters(), strict=True):
        assert torch.equal(a, b)
    one, two = curve(tmp_path / "whole"), curve(tmp_path / "parts")
    assert [line["iteration"] for line in two] == ["4", "8", "12"]
    assert [line["train_loss"] for line in one] == [line["train_loss"] for line in two]


def test_a_finished_run_is_left_alone(tmp_path: Path) -> None:
    first = run(tmp_path, SHORT)
    second = run(tmp_path, SHORT)
    for a, b in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(a, b)
    assert len(curve(tmp_path)) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "expected a run with seed 1, found one with 0"),
        ({"batch": 8}, "expected a run with batch 8, found one with 16"),
        ({"optimizer": "muon"}, "expected a run with optimizer muon, found one with adamw"),
    ],
)
def test_another_run_is_not_continued(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    run(tmp_path, replace(SHORT, iterations=4))
    with pytest.raises(ValueError, match=message):
        run(tmp_path, replace(SHORT, **change))
    wider = replace(TINY, config=replace(TINY.config, width=32))
    with pytest.raises(ValueError, match="out: expected a run with config"):
        run(tmp_path, SHORT, wider)


def test_a_run_from_before_there_was_a_choice_of_optimiser_goes_on(tmp_path: Path) -> None:
    run(tmp_path, replace(SHORT, iterations=4))
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    identity = json.loads(state["identity"])
    del identity["optimizer"]
    torch.save({**state, "identity": json.dumps(identity)}, tmp_path / "checkpoint.pt")
    run(tmp_path, SHORT)
    assert curve(tmp_path)[-1]["iteration"] == "12"


def test_a_run_may_start_from_another(tmp_path: Path) -> None:
    first = run(tmp_path / "first", SHORT)
    other = replace(TINY, name="other", base="trapezoid", config=replace(TINY.config, offset=True))
    no_step = replace(SHORT, iterations=1, rate=1e-30)
    second = train(
        other, tmp_path / "second", no_step, start_from=tmp_path / "first", precision="32-true", progress=False
    )
    for (name, a), b in zip(first.named_parameters(), second.parameters(), strict=True):
        np.testing.assert_allclose(b.detach(), 0.0 if name.startswith("head.") else a.detach(), atol=1e-20)
    again = train(TINY, tmp_path / "again", replace(no_step, batch=8), start_from=tmp_path / "first", progress=False)
    for a, b in zip(first.parameters(), again.parameters(), strict=True):  # heads included
        np.testing.assert_allclose(b.detach(), a.detach(), rtol=1e-6, atol=1e-9)
    wide = replace(TINY, config=replace(TINY.config, width=32))
    with pytest.raises(ValueError, match="start_from: expected a run of the same tokens and width"):
        train(wide, tmp_path / "third", no_step, start_from=tmp_path / "first", progress=False)
    with pytest.raises(ValueError, match="start_from: expected a folder with a checkpoint"):
        train(TINY, tmp_path / "fourth", no_step, start_from=tmp_path / "nothing", progress=False)


@pytest.mark.parametrize("more", [{"reach": 2, "direct": True}, {"layers": 3}, {"expansion": 4, "reach": 1}])
def test_what_a_run_has_beyond_another_one_weighs_nothing_at_first(tmp_path: Path, more: dict[str, int]) -> None:
    """Neighbours on both sides, tokens in the heads, blocks, hidden units: the answers are the first network's."""
    first = run(tmp_path / "first", SHORT)
    larger = replace(TINY, config=replace(TINY.config, **more))
    still = replace(SHORT, iterations=1, rate=1e-30)
    again = train(
        larger, tmp_path / "second", still, start_from=tmp_path / "first", precision="32-true", progress=False
    )
    tokens = torch.randn(4, 8, TINY.config.tokens.width, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        torch.testing.assert_close(again(tokens), first(tokens), rtol=1e-5, atol=1e-7)
        assert first(tokens).abs().max() > 1e-3
    learned = train(
        larger, tmp_path / "third", SHORT, start_from=tmp_path / "first", precision="32-true", progress=False
    )
    for weight in learned.parameters():  # and all of it learns, but for what no input of these rows reaches
        assert (weight != 0.0).float().mean() > 0.8


def test_two_processes_train_together(tmp_path: Path) -> None:
    """Over gloo: each sees its half of every batch, and the gradients are averaged."""
    import subprocess
    import sys

    script = tmp_path / "ddp.py"
    script.write_text(
        "import sys, torch\n"
        "from dataclasses import replace\n"
        "from nqr_geom.integrator.learn.train import TrainConfig, train\n"
        "from nqr_geom.recipes import RECIPES\n"
        "if __name__ == '__main__':\n"
        "    torch.set_num_threads(1)\n"
        "    recipe = RECIPES['toy-uniform']\n"
        "    recipe = replace(recipe, config=replace(recipe.config, layers=1, width=8), sizes=((8, 1.0),))\n"
        "    config = TrainConfig(iterations=4, batch=32, warmup=2, every=4, validation=32)\n"
        "    train(recipe, sys.argv[1], config, devices=int(sys.argv[2]), precision='32-true', progress=False)\n"
    )
    for devices in (1, 2):
        done = subprocess.run(
            [sys.executable, str(script), str(tmp_path / str(devices)), str(devices)], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    one, two = (torch.load(tmp_path / d / "checkpoint.pt", weights_only=True)["average"] for d in ("1", "2"))
    assert any(tensor.abs().max() > 0.0 for name, tensor in one.items() if name.startswith("head"))
    for name, tensor in one.items():
        np.testing.assert_allclose(two[name], tensor, atol=5e-4)  # a wrong half of a batch moves them by 1e-2


def test_schedule_rises_stays_and_falls() -> None:
    config = TrainConfig(iterations=1000, warmup=100, decay=200, rate=1.0)
    rates = [learning_rate(config, i) for i in range(1000)]
    assert rates[0] == 0.01
    assert rates[100:800] == [1.0] * 700
    assert np.all(np.diff(rates[:100]) > 0.0)
    assert np.all(np.diff(rates[800:]) < 0.0)
    assert rates[-1] == pytest.approx(1 / 200)
    assert learning_rate(replace(config, decay=0), 999) == 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"iterations": 0}, "iterations: expected an integer >= 1, got 0"),
        ({"warmup": -1}, "warmup: expected an integer >= 0, got -1"),
        ({"rate": 0.0}, "rate: expected a number > 0.0, got 0.0"),
        ({"average": 1.5}, "average: expected a number >= 0.0 and <= 1.0, got 1.5"),
        ({"optimizer": "sgd"}, "optimizer: expected one of adamw, muon, got 'sgd'"),
    ],
)
def test_bad_configurations_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(SHORT, **change)


def test_number_of_samples_follows_its_shares() -> None:
    recipe = replace(TINY, sizes=((32, 3.0), (8, 1.0)))
    stream = Stream(0, "train", "sizes")
    drawn = [recipe.size(stream, i) for i in range(2000)]
    assert abs(drawn.count(32) / 2000 - 0.75) < 4.0 * np.sqrt(0.75 * 0.25 / 2000)
    assert set(drawn) == {8, 32}


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_training_and_test_integrals_never_meet(name: str) -> None:
    family = RECIPES[name].family
    rows = torch.arange(50)
    answers = [family(rows, 0, split).answer for split in ("train", "validation", "test")]
    # Nothing absorbs light where there is nothing, and what no lamp reaches is dark.
    told = [answer[((answer != 1.0) & (answer != 0.0)).any(dim=1)] for answer in answers]
    assert all(len(answer) > 10 for answer in told)
    for i in range(3):
        for j in range(i):
            same = torch.isclose(told[i][:, None], told[j][None], rtol=1e-9, atol=0.0)
            assert not same.all(dim=-1).any()
    assert torch.equal(family(rows[10:20], 0, "train").answer, answers[0][10:20])


def test_designs_share_a_batch() -> None:
    problem = lines(torch.arange(6), 0, "train").problem
    x = draw_samples(problem, ("random", "stratified"), 10, Stream(0, "train")).x[..., 0]
    cells = (x * 10).floor()
    assert (cells[1::2] == torch.arange(10)).all()
    assert not (cells[0::2] == torch.arange(10)).all(dim=1).any()


def test_winding_numbers_of_the_family_against_quadrature() -> None:
    batch = gwn_batch(torch.arange(40), 5, "validation")
    m = 2**14
    nodes, weights = np.polynomial.legendre.leggauss(8)
    cells = (torch.arange(m // 8).double()[:, None] + torch.from_numpy(0.5 * (nodes + 1.0))) / (m // 8)
    # Whole cells a piece, so that no rule straddles a joint.
    s = ((cells[None] + torch.arange(6.0).double()[:, None, None]) / 6.0).reshape(1, -1, 1).expand(40, -1, 1)
    w = torch.from_numpy(0.5 * weights).repeat(6 * (m // 8)) / (6 * (m // 8))
    value = batch.problem.evaluate(s).value[..., 0, 0]
    np.testing.assert_allclose((value * w).sum(dim=1), batch.answer[:, 0], atol=1e-9)


def test_near_distance_is_right_where_it_matters() -> None:
    control = control_points(torch.arange(300), 1, "validation")
    p0, p1, p2 = (control[:, :, k, None] for k in range(3))

    def at(t: Tensor) -> Tensor:
        t = t[..., None]
        return (1 - t) ** 2 * p0 + 2 * t * (1 - t) * p1 + t**2 * p2  # (300, 6, M, 2)

    coarse = torch.linspace(0.0, 1.0, 2001, dtype=torch.float64)
    for offset in (5e-4, 2e-3):
        points = at(coarse)[:, 3, 777] + offset * torch.tensor([0.6, 0.8], dtype=torch.float64)
        near = torch.linalg.vector_norm(at(coarse) - points[:, None, None], dim=-1).argmin(dim=-1)
        fine = coarse[near][..., None] + torch.linspace(-5e-4, 5e-4, 501, dtype=torch.float64)
        true = torch.linalg.vector_norm(at(fine.clamp(0.0, 1.0)) - points[:, None, None], dim=-1).amin(dim=(1, 2))
        mine = near_distance(control, points)
        assert (mine >= true - 1e-6).all()
        assert (mine <= true * 1.001 + 1e-6).double().mean() > 0.98  # cusps are what it may miss


def test_training_queries_keep_their_distance() -> None:
    batch = gwn_batch(torch.arange(2000), 2, "train")
    nearest = near_distance(control_points(torch.arange(2000), 2, "train"), batch.problem.points)
    assert nearest.min() >= NEAREST
    assert batch.problem.points.abs().max() <= 1.0


def test_quadratic_winding_of_a_closed_shape() -> None:
    """Four arcs around the origin, counter-clockwise: 1 inside, 0 outside."""
    corner = torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], dtype=torch.float64)
    middle = corner + corner.roll(-1, 0)
    shape = torch.stack([corner, middle, corner.roll(-1, 0)], dim=1)[None]
    points = torch.tensor([[0.2, -0.3], [2.0, 0.1]], dtype=torch.float64)
    np.testing.assert_allclose(quadratic_winding(shape.expand(2, -1, -1, -1), points), [1.0, 0.0], atol=1e-14)


def test_links_are_inverted_and_clamped_for_training() -> None:
    link = LogLink(alpha=35.0, shift=torch.tensor([[0.3]], dtype=torch.float64))
    inner = torch.tensor([[0.02]], dtype=torch.float64)
    np.testing.assert_allclose(inner_answer(link(inner), link), inner, rtol=1e-13)
    assert torch.equal(training_link(link, -inner), link(inner))
    assert training_link(link, 0.0 * inner).isfinite().all()
    with pytest.raises(ValueError, match="link: expected identity, log or exp, got 'cube'"):
        inner_answer(inner, Link("cube"))


def test_loss_is_the_mean_squared_error_of_small_errors() -> None:
    recipe = replace(TINY, huber=1e3)
    batch = lines(torch.arange(64), 0, "validation")
    samples = draw_samples(batch.problem, ("random",), 8, Stream(0, "validation"))
    expected = (samples.value.mean(dim=1)[:, 0] - batch.answer).square().mean()
    np.testing.assert_allclose(loss(recipe, INet(recipe.config), batch, samples).item(), expected, rtol=1e-6)


def test_iterations_count_alike_whatever_their_errors() -> None:
    fabric, recipe = launch(TINY.config, 1, 1, "cpu", "32-true"), replace(TINY, alike=True)
    value = torch.tensor([4.0, 4e-6], requires_grad=True)
    for each in value:
        alike(recipe, each * each, fabric).backward()
    np.testing.assert_allclose(value.grad, 2.0 / value.detach(), rtol=1e-6)  # of log value^2
    assert torch.equal(alike(TINY, value, fabric), value)
    assert alike(recipe, torch.zeros(()), fabric).item() == 0.0


def test_checkpoints_say_what_they_are(tmp_path: Path) -> None:
    run(tmp_path, replace(SHORT, iterations=4))
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert json.loads(state["train"])["iterations"] == 4
    assert json.loads(state["identity"])["recipe"] == "lines"
    assert not list(tmp_path.glob("*.new*"))


def test_the_command_line_trains_and_publishes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = str(tmp_path / "run")
    words = ["train", "toy-uniform", "--out", out, "--iterations", "1", "--batch", "8", "--optimizer", "muon"]
    assert main(words) == 0
    config = json.loads(torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["train"])
    assert (config["batch"], config["optimizer"]) == (8, "muon")
    told: list[str] = []

    def made(recipe: Recipe, run: Path, folder: Path, command: str) -> SimpleNamespace:
        told.append(command)
        return SimpleNamespace(name=recipe.name)

    monkeypatch.setattr("nqr_geom.integrator.learn.publish.publish", made)
    assert main([*words, "--publish", "models", "--start-from", out]) == 0
    options = "--iterations 1 --decay 0 --optimizer muon --seed 0 --batch 8"
    assert told == [f"nqr-geom train toy-uniform {options} --start-from {out}"]
    assert main(["train", "nothing", "--out", out, "--iterations", "1"]) == 2
    assert f"name: expected one of {', '.join(sorted([*RECIPES, *JOINT]))}, got 'nothing'" in capsys.readouterr().err
    pair = str(tmp_path / "pair")
    assert main(["train", "toy-nqr", "--out", pair, "--iterations", "1", "--batch", "2", "--start-from", out]) == 2
    assert (
        "start_from: expected a run of 'toy-structured' or 'toy-nqr', found one of 'toy-uniform'"
        in capsys.readouterr().err
    )
