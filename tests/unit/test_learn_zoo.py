"""Models on disk: card and weights belong together, answers stay within what the card knows."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.integrator.learn.inet import INet, LearnedRule
from nqr_geom.integrator.learn.publish import fit_shares, fit_trust, measure_box, publish, refit
from nqr_geom.integrator.learn.recipe import draw_samples
from nqr_geom.integrator.learn.train import TrainConfig, train
from nqr_geom.integrator.learn.zoo import Card, Model, load, save
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.rules import Combination, Rule
from nqr_geom.recipes import RECIPES
from nqr_geom.streams import Stream

SMALL = replace(RECIPES["toy-uniform"], config=replace(RECIPES["toy-uniform"].config, layers=1, width=16))


def network() -> INet:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net = INet(SMALL.config)
        torch.nn.init.normal_(net.head.weight, std=0.05)
    return net


def card(**change: object) -> Card:
    low, high = measure_box(SMALL, 256)
    plain = Card(
        SMALL.name, SMALL.problem, SMALL.base, SMALL.consistent, SMALL.config, 1, 1, 0, 0.0, {}, low, high,
        sizes=(8, 32, 128), shares=(1.0, 1.0, 0.25),
    )  # fmt: skip
    return replace(plain, **change)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save(tmp_path, network(), card())
    return tmp_path


def seen(n: int, rows: int = 8) -> Samples:
    problem = SMALL.family(torch.arange(rows), 0, "test").problem
    return draw_samples(problem, ("random",), n, Stream(0))


def test_a_model_comes_back_as_it_was_saved(folder: Path) -> None:
    model = load(folder, SMALL)
    samples = seen(32)
    assert replace(model.card, sha256="") == card()
    mine, theirs = model.learned.net.state_dict(), network().state_dict()
    assert all(torch.equal(mine[name], tensor) for name, tensor in theirs.items())
    assert torch.equal(model.combine(samples).weights, model.learned.combine(samples).weights)
    assert (folder / "toy-uniform.safetensors").stat().st_size < 2_000_000


def test_other_weights_are_refused(folder: Path) -> None:
    path = folder / "toy-uniform.safetensors"
    weights = bytearray(path.read_bytes())
    weights[-1] ^= 1
    path.write_bytes(weights)
    with pytest.raises(ValueError, match="card: expected weights with sha256"):
        load(folder, SMALL)


@pytest.mark.parametrize(
    ("field", "value"),
    [("base", "trapezoid"), ("consistent", "mc"), ("low", [0.0, 0.0])],
)
def test_a_card_of_another_recipe_is_refused(folder: Path, field: str, value: object) -> None:
    path = folder / "toy-uniform.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), field: value}))
    with pytest.raises(ValueError, match="card: expected"):
        load(folder, SMALL)


def test_another_architecture_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="card: expected config"):
        load(folder, RECIPES["toy-uniform"])
    # The card agrees with the recipe but not with the tensors.
    wide = replace(SMALL, config=replace(SMALL.config, width=32))
    (folder / "toy-uniform.json").write_text(replace(load(folder, SMALL).card, config=wide.config).to_json())
    with pytest.raises(ValueError, match="weights of the shapes of its architecture"):
        load(folder, wide)


def test_a_model_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"'toy-uniform', toy-uniform.json and toy-uniform.safetensors not there"):
        load(tmp_path, SMALL)


def test_strange_rows_fall_back_alone(folder: Path) -> None:
    model = load(folder, SMALL)
    samples = seen(32)
    derivative = samples.seen.features["derivative"].clone()
    derivative[2] *= 1e9
    piece = samples.seen.features["piece"].clone()
    piece[5, 0] = 5
    features = {"derivative": derivative, "piece": piece}
    strange = replace(samples, seen=replace(samples.seen, features=features))
    result, plain = model.combine(strange), model.combine(samples)
    safe = registry.make("rule", "trapezoid").combine(samples)
    assert result.fallback is not None
    assert result.fallback.nonzero().flatten().tolist() == [2, 5]
    assert torch.equal(result.weights[[2, 5]], safe.weights[[2, 5]])
    others = [0, 1, 3, 4, 6, 7]
    assert torch.equal(result.weights[others], plain.weights[others])


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e300])
def test_wild_values_are_finite(folder: Path, size: float) -> None:
    samples = seen(32)
    wild = replace(samples, seen=replace(samples.seen, value=samples.value * size))
    assert load(folder, SMALL).combine(wild).estimate(wild).isfinite().all()


def test_the_answer_fades_to_the_consistent_rule(folder: Path) -> None:
    model = load(folder, SMALL)
    trapezoid = registry.make("rule", "trapezoid")
    samples = seen(64)
    mine, safe, learned = (rule.combine(samples).estimate(samples) for rule in (model, trapezoid, model.learned))
    np.testing.assert_allclose(mine, 0.625 * learned + 0.375 * safe, rtol=1e-12)
    assert not model.combine(samples).fallback.any()
    assert model.combine(seen(128)).fallback.all()  # still blended, but mostly the consistent rule


def test_far_beyond_training_the_network_is_not_called(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = load(folder, SMALL)

    def never(*_: object) -> None:
        raise AssertionError("the network was called")

    monkeypatch.setattr(INet, "forward", never)
    samples = seen(129)
    result = model.combine(samples)
    assert torch.equal(result.estimate(samples), registry.make("rule", "trapezoid").combine(samples).estimate(samples))
    assert result.fallback.all()


def test_shares_minimise_the_error_of_the_blend() -> None:
    """On fresh integrals the blend with the fitted share beats both parts."""
    net = network()
    (share,) = fit_shares(SMALL, net, (32,))
    assert 0.0 < share < 1.0
    trapezoid = registry.make("rule", "trapezoid")
    model = Model(card(sizes=(8, 32), shares=(share, share)), load_free(net), trapezoid, SMALL.sees)
    problem = SMALL.family(torch.arange(4000), 0, "test").problem
    samples = draw_samples(problem, SMALL.designs, 32, Stream(0))
    truth = torch.from_numpy(problem.reference())
    rules = (model, model.learned, model.consistent)
    blend, learned, safe = ((rule.combine(samples).estimate(samples) - truth).square().mean().item() for rule in rules)
    assert blend < min(learned, safe)


def load_free(net: INet) -> LearnedRule:

    return LearnedRule(net, SMALL.base_rule(), SMALL.extra)


class Doubting(Rule):
    """The trapezoid, wrong by one where the first value is positive, and in doubt there or everywhere else."""

    name = "doubting"

    def __init__(self, *, honest: bool) -> None:
        self.honest = honest

    def combine(self, samples: Samples) -> Combination:
        plain = registry.make("rule", "trapezoid").combine(samples)
        wrong = samples.value[:, 0, 0, 0] > 0.0
        offset = wrong[:, None].double()
        return replace(plain, offset=offset, doubt=(wrong if self.honest else ~wrong).double())


@pytest.mark.parametrize("honest", [True, False])
def test_a_doubt_is_trusted_where_it_helps(monkeypatch: pytest.MonkeyPatch, honest: bool) -> None:
    make = registry.make
    monkeypatch.setattr(
        registry,
        "make",
        lambda kind, name: Doubting(honest=honest) if name == "doubting" else make(kind, name),
    )
    monkeypatch.setattr("nqr_geom.integrator.learn.publish._BLEND_SAMPLES", 2**15)
    recipe = replace(SMALL, consistent="doubting", trusts=(0.0, 1e-3))
    assert fit_trust(recipe, INet(SMALL.config)) == (1e-3 if honest else 0.0)
    assert fit_trust(replace(recipe, trusts=(0.5,)), INet(SMALL.config)) == 0.5
    assert fit_trust(replace(recipe, consistent="trapezoid"), INet(SMALL.config)) == 0.0


def test_a_card_is_fitted_again_and_its_weights_stay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nqr_geom.integrator.learn.publish._BLEND_SAMPLES", 2**12)
    before = load(folder, SMALL).card
    made = refit(SMALL, folder)
    assert load(folder, SMALL).card == made
    assert made.shares == fit_shares(SMALL, network(), before.sizes)
    assert made == replace(before, shares=made.shares)


def test_shares_fall_beyond_training_and_stay_at_zero() -> None:
    shares = fit_shares(SMALL, INet(SMALL.config), (32, 64, 128, 256, 4096))
    assert all(b <= a for a, b in pairwise(shares[1:]))
    assert shares[-1] == 0.0  # the untrained network is Monte Carlo, far worse than the trapezoid by then


def test_a_network_that_takes_little_off_counts_nothing_beyond_training(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe, sizes = replace(SMALL, base="trapezoid", consistent="mc"), (32, 128, 256)
    monkeypatch.setattr("nqr_geom.integrator.learn.publish._BLEND_SAMPLES", 2**15)
    assert min(fit_shares(recipe, INet(SMALL.config), sizes)) > 0.5
    monkeypatch.setattr("nqr_geom.integrator.learn.publish._LEAST_GAIN", 1.0)  # no rule takes off all of it
    first, *beyond = fit_shares(recipe, INet(SMALL.config), sizes)
    assert first > 0.5
    assert beyond == [0.0, 0.0]


def test_share_is_linear_in_log_n() -> None:
    plain = card()
    assert [plain.share(n) for n in (1, 8, 32, 64, 128, 129)] == [1.0, 1.0, 1.0, 0.625, 0.25, 0.0]


def test_a_run_becomes_a_model(tmp_path: Path) -> None:
    config = TrainConfig(iterations=2, batch=8, warmup=1, every=2, validation=16)
    net = train(SMALL, tmp_path / "run", config, precision="32-true", progress=False)
    made = publish(SMALL, tmp_path / "run", tmp_path / "models", command="a test")
    assert made.family["tokens"] == "nqr_geom.toy.law_terms.law_terms"
    model = load(tmp_path / "models", SMALL)
    assert model.card == made
    assert (made.iterations, made.batch, made.seed) == (2, 8, 0)
    assert torch.equal(model.learned.net.head.weight, net.head.weight)


def test_only_a_run_of_the_recipe_becomes_a_model(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="run: expected a folder with a checkpoint"):
        publish(SMALL, tmp_path / "nothing", tmp_path / "models")
    train(
        SMALL,
        tmp_path / "run",
        TrainConfig(iterations=1, batch=8, every=1, validation=16),
        precision="32-true",
        progress=False,
    )
    with pytest.raises(ValueError, match="run: expected a run of 'other', got one of 'toy-uniform'"):
        publish(replace(SMALL, name="other"), tmp_path / "run", tmp_path / "models")


def test_a_model_of_doubts_leaves_the_rest_to_its_base(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only flagged integrals reach the network, and only they are reported, in or out of its range."""
    recipe = RECIPES["gwn-structured"]
    net = INet(recipe.config)
    torch.nn.init.constant_(net.head.bias, 0.01)
    low, high = measure_box(recipe, 256)
    made = Card(
        recipe.name, "gwn", recipe.base, recipe.consistent, recipe.config, 1, 1, 0, 0.0, {}, low, high,
        sizes=(8, 32), shares=(1.0, 1.0),
    )  # fmt: skip
    base = recipe.base_rule()
    model = Model(made, LearnedRule(net, base, recipe.extra), base, recipe.sees)
    problem = recipe.family(torch.arange(200), 0, "test").problem
    for n in (32, 33):
        samples = draw_samples(problem, ("random",), n, Stream(0))
        plain, result = base.combine(samples), model.combine(samples)
        assert torch.equal(result.fallback, plain.fallback)
        sure = ~plain.fallback
        assert 0.05 < plain.fallback.double().mean() < 0.3
        assert torch.equal(result.estimate(samples)[sure], plain.estimate(samples)[sure])
        changed = (result.estimate(samples) != plain.estimate(samples))[:, 0]
        assert changed.any() == (n == 32)
    seen_rows: list[int] = []
    forward = INet.forward
    monkeypatch.setattr(INet, "forward", lambda self, x, p=None: seen_rows.append(len(x)) or forward(self, x, p))
    doubtful = int(base.combine(draw_samples(problem, ("random",), 32, Stream(0))).fallback.sum())
    model.combine(draw_samples(problem, ("random",), 32, Stream(0)))
    assert sum(seen_rows) == 256  # one tile for some 25 rows, none for the others
    assert doubtful < 100
