"""Joint training: the sampler learns what helps the integrator, runs go on as if they had not been interrupted."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from nqr_geom.integrator.learn.inet import INet, INetConfig
from nqr_geom.integrator.learn.joint import JointConfig, JointRecipe, advantages, roll_out, train_jointly
from nqr_geom.integrator.learn.publish import publish
from nqr_geom.integrator.learn.recipe import Batch, Recipe
from nqr_geom.integrator.learn.snet import SNet, SNetConfig
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.learn.train import TrainConfig, train
from nqr_geom.integrator.learn.zoo import load, load_sampler
from nqr_geom.integrator.problem import Observation, Problem
from nqr_geom.streams import Stream


@dataclass(frozen=True)
class Steps(Problem):
    """a for x < 1/4, else 0: with plain weights and four samples the answer is exact if one of them falls below 1/4."""

    rows: Tensor
    height: Tensor  # (B,)

    name = "steps"

    def evaluate(self, x: Tensor) -> Observation:
        value = torch.where(x < 0.25, self.height[:, None, None], 0.0)
        return Observation(value[..., None], queries=value.numel())

    def take(self, index: slice | Tensor) -> Steps:
        return Steps(self.rows[index], self.height[index])


def steps(rows: Tensor, seed: int, split: str) -> Batch:
    height = 1.0 + Stream(seed, split, "steps").uniform(rows)
    return Batch(Steps(rows, height), 0.25 * height[:, None])


TOKENS = TokenConfig(frequencies=2)
RULE = Recipe(
    name="steps",
    problem="steps",
    family=steps,
    base="mc",
    consistent="mc",
    config=INetConfig(TOKENS, layers=1, width=8),
    sizes=((4, 1.0),),
    designs=("random",),
)
PAIR = JointRecipe(
    replace(RULE, name="steps-nqr", base="uniform"),
    "steps",
    SNetConfig(TokenConfig(frequencies=2, unit=1.0), layers=1, width=16, head="grid", grid=((8,),)),
)
SHORT = JointConfig(iterations=6, batch=4, group=4, warmup=2, every=2, validation=64)


@pytest.fixture(autouse=True)
def quiet() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "loss.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def run(folder: Path, config: JointConfig, **options: object) -> tuple[INet, SNet]:
    return train_jointly(PAIR, folder, config, precision="32-true", progress=False, **options)  # type: ignore[arg-type]


def exact(net: SNet) -> float:
    """How often exactly one does: what plain weights want."""
    problem = steps(torch.arange(512), 0, "validation").problem
    with torch.no_grad():
        x = net.sample(problem, 4, Stream(0, "validation")).samples.x
    return float(((x < 0.25).sum(dim=1) == 1).double().mean())


def test_the_sampler_learns_what_helps_the_integrator(tmp_path: Path) -> None:
    config = JointConfig(
        iterations=60, batch=32, group=8, rate=1e-5, sampler_rate=2e-2, warmup=5, average=0.9, every=60, validation=256
    )
    assert 0.35 < exact(PAIR.snet()) < 0.5  # by chance: 4 (1/4) (3/4)^3
    _, sampler = run(tmp_path, config)
    assert exact(sampler) > 0.8
    assert float(curve(tmp_path)[-1]["validation_mse"]) < 0.5 * float(curve(tmp_path)[-1]["base_mse"])


def test_the_integrator_learns_too(tmp_path: Path) -> None:
    """With the sampler all but fixed: W = 1/(4 p) is what it should find for uniform samples of this family."""
    config = JointConfig(
        iterations=80, batch=16, group=4, rate=1e-2, sampler_rate=1e-9, warmup=5, average=0.9, every=80, validation=256
    )
    run(tmp_path, config)
    assert float(curve(tmp_path)[-1]["validation_mse"]) < 0.7 * float(curve(tmp_path)[-1]["base_mse"])


def test_a_killed_run_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    whole = run(tmp_path / "whole", SHORT)
    run(tmp_path / "parts", replace(SHORT, iterations=4))
    parts = run(tmp_path / "parts", SHORT)
    for one, two in zip(whole, parts, strict=True):
        for a, b in zip(one.parameters(), two.parameters(), strict=True):
            assert torch.equal(a, b)
    assert [line["iteration"] for line in curve(tmp_path / "parts")] == ["2", "4", "6"]


@pytest.mark.parametrize("change", [{"batch": 8}, {"group": 2}, {"seed": 1}])
def test_a_run_of_another_kind_is_refused(tmp_path: Path, change: dict[str, int]) -> None:
    run(tmp_path, replace(SHORT, iterations=1))
    with pytest.raises(ValueError, match=f"out: expected a run with {next(iter(change))}"):
        run(tmp_path, replace(SHORT, **change))


def test_a_pair_begins_with_a_trained_integrator(tmp_path: Path) -> None:
    net = train(RULE, tmp_path / "rule", TrainConfig(4, batch=8, every=4, validation=32), progress=False)
    begun, _ = run(tmp_path / "pair", replace(SHORT, iterations=1, rate=1e-30), start_from=tmp_path / "rule")
    for a, b in zip(net.parameters(), begun.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-9)
    other = replace(PAIR, rule=replace(RULE, name="other-nqr"), begin="other")
    with pytest.raises(ValueError, match="start_from: expected a run of 'other' or 'other-nqr', found one of 'steps'"):
        train_jointly(other, tmp_path / "other", SHORT, start_from=tmp_path / "rule", progress=False)
    with pytest.raises(ValueError, match="start_from: expected a folder with a checkpoint"):
        run(tmp_path / "none", SHORT, start_from=tmp_path / "nowhere")


def test_a_pair_begins_with_both_networks_of_another_run_of_it(tmp_path: Path) -> None:
    first = run(tmp_path / "first", replace(SHORT, rate=1e-2))
    still = replace(SHORT, iterations=1, batch=8, group=2, rate=1e-30, sampler_rate=1e-30, seed=1)
    second = run(tmp_path / "second", still, start_from=tmp_path / "first")
    for one, two in zip(first, second, strict=True):
        for a, b in zip(one.parameters(), two.parameters(), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-9)


def test_a_sampler_without_a_rate_stays_as_it_is(tmp_path: Path) -> None:
    early, late = (
        run(tmp_path / str(n), replace(SHORT, iterations=n, sampler_rate=0.0)) for n in (1, SHORT.iterations)
    )
    for changes, net, other in zip((True, False), early, late, strict=True):
        weights = zip(net.parameters(), other.parameters(), strict=True)
        assert any((a != b).any() for a, b in weights) == changes


def test_a_pair_may_have_a_larger_integrator_than_it_begins_with(tmp_path: Path) -> None:
    net = train(RULE, tmp_path / "rule", TrainConfig(4, batch=8, every=4, validation=32), progress=False)
    config = replace(RULE.config, layers=RULE.config.layers + 1, expansion=RULE.config.expansion + 1)
    larger = replace(PAIR, rule=replace(PAIR.rule, config=config))
    short = replace(SHORT, iterations=1, rate=1e-30)
    begun, _ = train_jointly(
        larger, tmp_path / "pair", short, precision="32-true", progress=False, start_from=tmp_path / "rule"
    )
    tokens = torch.randn(4, 8, RULE.config.tokens.width, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        torch.testing.assert_close(begun(tokens), net(tokens), rtol=1e-5, atol=1e-7)


def test_a_gate_that_the_run_before_lacks_begins_shut(tmp_path: Path) -> None:
    net = train(RULE, tmp_path / "rule", TrainConfig(4, batch=8, every=4, validation=32), progress=False)
    gated = replace(PAIR, rule=replace(PAIR.rule, config=replace(RULE.config, gated=True)))
    short = replace(SHORT, iterations=1, rate=1e-30)
    begun, _ = train_jointly(
        gated, tmp_path / "pair", short, precision="32-true", progress=False, start_from=tmp_path / "rule"
    )
    torch.testing.assert_close(begun.head.weight[:-1], net.head.weight, rtol=1e-6, atol=1e-9)
    assert begun.head.weight[-1].abs().max() < 1e-20
    assert begun.head.bias[-1].abs() < 1e-20


def test_a_published_pair_is_the_trained_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nqr_geom.integrator.learn.publish._BLEND_SAMPLES", 2**11)
    _, sampler = run(tmp_path / "run", SHORT)
    card = publish(PAIR, tmp_path / "run", tmp_path / "models", command="a test")
    assert (card.group, card.batch, card.iterations) == (4, 4, 6)
    loaded = load_sampler(tmp_path / "models", "steps-nqr", PAIR.snet())
    problem = steps(torch.arange(20), 0, "test").problem
    stream = Stream(7)
    with torch.no_grad():
        expected = sampler.sample(problem.take(torch.arange(256).clamp_max(19)), 4, stream).samples
    samples = loaded.draw(problem, 4, stream)
    np.testing.assert_array_equal(samples.x, expected.x[:20])
    assert load(tmp_path / "models", PAIR.rule).name == "inet-steps-nqr"
    assert samples.design == loaded.name == "snet-steps-nqr"
    other = replace(PAIR.sampler, grid=((16,),))
    with pytest.raises(ValueError, match="card: expected sampler"):
        load_sampler(tmp_path / "models", "steps-nqr", SNet(other))


def test_sequences_of_one_integral_differ_and_train_is_not_validation() -> None:
    lesson, rollout = roll_out(PAIR, PAIR.snet(), torch.arange(3), 4, SHORT)
    x = rollout.samples.x.view(3, SHORT.group, 4)
    assert len(torch.unique(x)) == x.numel()
    assert torch.equal(lesson.answer.view(3, SHORT.group), lesson.answer.view(3, SHORT.group)[:, :1].expand(3, 4))
    again = roll_out(PAIR, PAIR.snet(), torch.arange(3), 4, SHORT)[1].samples.x
    assert torch.equal(rollout.samples.x, again)
    drawn = PAIR.snet().sample(lesson.problem, 4, Stream(SHORT.seed, "validation", "rollouts")).samples.x
    assert not np.intersect1d(drawn.numpy(), rollout.samples.x.numpy()).size


def test_advantages_compare_within_the_group_only() -> None:
    error = torch.tensor([[1.0, 2.0, 3.0], [1e-9, 2e-9, 3e-9]], dtype=torch.float64)
    gain = advantages(error)
    torch.testing.assert_close(gain[0], gain[1], rtol=1e-9, atol=1e-12)
    assert gain[0, 0] > 0.0 > gain[0, 2]
    assert torch.equal(advantages(torch.ones(2, 3)), torch.zeros(2, 3))


def test_bad_lengths_are_named() -> None:
    with pytest.raises(ValueError, match="group"):
        JointConfig(iterations=1, group=1)
    with pytest.raises(ValueError, match="sampler_rate"):
        JointConfig(iterations=1, sampler_rate=-1.0)
