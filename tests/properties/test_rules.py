"""Laws of every rule in the registry: what it is exact on, what it may look at, and what must not disturb it."""

from __future__ import annotations

import copy
import re
from dataclasses import fields, replace
from itertools import product

import numpy as np
import pytest
import torch

from nqr_geom import registry
from nqr_geom.integrator.problem import Samples
from nqr_geom.integrator.samplers import cells_per_axis
from nqr_geom.registry import Entry
from tests import fixtures

SIZES = (1, 2, 5, 8, 32)
every_rule = pytest.mark.parametrize("rule", fixtures.RULES, ids=lambda entry: entry.name)


def estimate(entry: Entry, samples: Samples) -> np.ndarray:
    return registry.make("rule", entry.name).combine(samples).estimate(samples).numpy()


def close(got, expected, tolerance):
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), rtol=tolerance, atol=tolerance)


# --- what a rule accepts ------------------------------------------------------------------------------


@every_rule
def test_a_rule_accepts_what_it_declares_and_refuses_the_rest_by_name(rule):
    accepted = {(name, sampler) for name, sampler, _ in fixtures.accepted(rule, 8)}
    made = registry.make("rule", rule.name)
    for name in fixtures.PROBLEMS.keys() - set(fixtures.FOR_NETWORKS):
        for sampler in fixtures.samplers_for(name):
            samples = fixtures.draw(name, sampler, 8)
            if (name, sampler) in accepted:
                made.combine(samples)
            else:
                with pytest.raises(ValueError, match=f"rule: '{re.escape(made.name)}'"):
                    made.combine(samples)


# --- what it is exact on ------------------------------------------------------------------------------


def constants(rule, n):
    for _, _, samples in fixtures.accepted(rule, n):
        values = torch.full_like(samples.value[:1, :1], 2.5)
        if rule.needs == "pdf" and samples.pdf is not None:
            values = 2.5 * samples.pdf[..., None]  # constant as a quotient: of importance samples more cannot be asked
        close(estimate(rule, fixtures.with_values(samples, values)), 2.5, 1e-12)


def polynomials(rule, n, degree):
    """Products of monomials up to a total degree, wherever the points determine them."""
    for _, _, samples in fixtures.accepted(rule, n):
        powers = [e for e in product(range(degree + 1), repeat=samples.dim) if sum(e) <= degree]
        columns = [(samples.x ** torch.tensor(e)).prod(dim=-1) for e in powers]
        design = np.polynomial.legendre.legvander(2.0 * samples.x[..., 0].numpy() - 1.0, degree)
        if samples.dim > 1:
            design = np.stack([column.numpy() for column in columns], axis=-1)
        if samples.pdf is not None:  # the fit weighs samples by their share of the cube
            design = design / np.sqrt(samples.pdf[:, :, :1].numpy())
        determined = [n >= len(powers) and np.linalg.cond(row) < 1e4 for row in design]
        if not any(determined):
            continue
        for power, column in zip(powers, columns, strict=True):
            got = estimate(rule, fixtures.with_values(samples, column[..., None, None]))[determined]
            close(got, np.prod([1.0 / (k + 1) for k in power]), 1e-9)


def gauss(rule, n):
    for _, _, samples in fixtures.accepted(rule, n):
        for axis, k in enumerate(cells_per_axis(n, samples.dim)):
            for power in {0, 1, k, 2 * k - 1}:
                value = samples.x[..., axis, None, None] ** power
                close(estimate(rule, fixtures.with_values(samples, value)), 1.0 / (power + 1), 1e-13)
            # One degree more is not exact; it shows that the test can tell (the gap falls as 16^-k).
            if k <= 5:
                value = samples.x[..., axis, None, None] ** (2 * k)
                missed = estimate(rule, fixtures.with_values(samples, value)) - 1.0 / (2 * k + 1)
                assert (np.abs(missed) > 1e-7).all()


def control(rule, n):
    for _, _, samples in fixtures.accepted(rule, n):
        h, integral = samples.seen.control
        close(estimate(rule, fixtures.with_values(samples, h)), integral.numpy(), 1e-12)


def quadratic_pieces(rule, n):
    """Six quadratic pieces from the sampler made for them: exact wherever the rule does not say otherwise."""
    if n < 32:
        return  # three samples a piece determine it
    from nqr_geom.integrator.estimate import run

    problem = fixtures.problem(rule.needs)
    sampler, name = registry.method("structured", rule.needs)
    assert name == rule.name
    answer = run(problem, registry.make("sampler", sampler), registry.make("rule", name), n)
    assert answer.fallback.mean() <= 0.2
    sound = ~answer.fallback
    close(answer.value[sound], problem.reference()[sound], 1e-9)


def nothing(rule, n):
    """Nothing is promised but a finite number."""
    for _, _, samples in fixtures.accepted(rule, n):
        assert np.isfinite(estimate(rule, samples)).all()


EXACT = {
    "constants": constants,
    "control": control,
    "degree 1": lambda rule, n: polynomials(rule, n, 1),
    "degree 3": lambda rule, n: polynomials(rule, n, 3),
    "degree 5": lambda rule, n: polynomials(rule, n, 5),
    "degree 2N-1": gauss,
    "quadratic pieces": quadratic_pieces,
    "nothing": nothing,
}


@every_rule
@pytest.mark.parametrize("n", SIZES)
def test_a_rule_is_exact_on_what_it_declares(rule, n):
    assert rule.exact in EXACT, f"{rule.name!r} declares {rule.exact!r}, which no test can check yet"
    EXACT[rule.exact](rule, n)


# --- what it may look at ------------------------------------------------------------------------------


@every_rule
def test_weights_and_additive_term_of_a_linear_rule_do_not_look_at_the_values(rule):
    made = registry.make("rule", rule.name)
    looked = False
    for _, _, samples in fixtures.accepted(rule, 8):
        before = made.combine(samples)
        value = samples.value * 3.0 - torch.linspace(0, 1, 8, dtype=torch.float64)[:, None, None]
        changed = replace(samples, seen=replace(samples.seen, value=value))
        after = made.combine(changed)
        same = torch.equal(before.weights, after.weights) and (
            before.offset is None or torch.equal(before.offset, after.offset)
        )
        looked |= not same
        if rule.linear:
            assert same
            both = replace(samples, seen=replace(samples.seen, value=2.0 * samples.value - 5.0 * value))
            zero = replace(samples, seen=replace(samples.seen, value=torch.zeros_like(value)))
            parts = [estimate(rule, s) - estimate(rule, zero) for s in (samples, changed, both)]
            close(2.0 * parts[0] - 5.0 * parts[1], parts[2], 1e-12)
    if not rule.linear and rule.needs == "toy":
        assert looked, f"{rule.name!r} declares itself non-linear but never looked at the values"


@every_rule
@pytest.mark.parametrize("n", [1, 2, 5, 32])
def test_the_order_of_the_samples_does_not_matter(rule, n):
    for name, _, samples in fixtures.accepted(rule, n):
        order = torch.stack([torch.randperm(n, generator=torch.Generator().manual_seed(r)) for r in samples.x[:, 0, 0]
                             .mul(1e6).long().tolist()])  # fmt: skip
        once, again = estimate(rule, samples), estimate(rule, samples.permuted(order))
        assert np.abs(once - again).max() <= 1e-12 * max(1.0, np.abs(once).max()), name


@every_rule
def test_inputs_are_left_alone_and_answers_are_double(rule):
    for _, _, samples in fixtures.accepted(rule, 5):
        before = copy.deepcopy(samples)
        combination = registry.make("rule", rule.name).combine(samples)
        assert combination.weights.dtype == torch.float64
        assert combination.offset is None or combination.offset.dtype == torch.float64
        assert combination.estimate(samples).dtype == torch.float64
        _same(before, samples)


def _same(before, after):
    """Every tensor in two (nested) records is equal, bit for bit."""
    if isinstance(before, torch.Tensor):
        assert torch.equal(before, after)
    elif isinstance(before, dict):
        for key in before:
            _same(before[key], after[key])
    elif isinstance(before, tuple):
        for one, two in zip(before, after, strict=True):
            _same(one, two)
    elif hasattr(before, "__dataclass_fields__"):
        for field in fields(before):
            _same(getattr(before, field.name), getattr(after, field.name))
    else:
        assert before == after


# --- rows ---------------------------------------------------------------------------------------------


@every_rule
@pytest.mark.parametrize("factor", [1e60, float("nan")])
def test_rows_do_not_disturb_each_other(rule, factor):
    """A row of size 1e60, or of NaN, changes no bit of the others."""
    for name, _, samples in fixtures.accepted(rule, 8):
        value = samples.value.clone()
        value[1] *= factor
        features = {key: feature.clone() for key, feature in samples.seen.features.items()}
        if "derivative" in features:
            features["derivative"][1] *= factor
        once = estimate(rule, samples)
        again = estimate(rule, replace(samples, seen=replace(samples.seen, value=value, features=features)))
        others = np.arange(len(once)) != 1
        np.testing.assert_array_equal(once[others], again[others], err_msg=name)
        if rule.linear and factor == 1e60 and rule.exact != "control":
            np.testing.assert_allclose(again[1], 1e60 * once[1], rtol=1e-12)


@every_rule
@pytest.mark.parametrize("n", [1, 8, 33])
def test_a_row_has_the_same_bits_alone_and_in_a_batch(rule, n):
    """33 rows' matrices do not start on cache lines of their own accord; see integrator/sums.py."""
    made = registry.make("rule", rule.name)
    for name, sampler, samples in fixtures.accepted(rule, n):
        whole = made.combine(samples).estimate(samples)
        for row in range(1, len(whole)):
            alone = fixtures.draw(name, sampler, n, row=row)
            assert torch.equal(made.combine(alone).estimate(alone), whole[row : row + 1]), (name, sampler)
