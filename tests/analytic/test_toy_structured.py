"""The structured toy rule and sampler: exact where the samples determine the pieces, and as accurate as they claim."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch
from torch import Tensor

from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.problem import Observation, Problem, Samples
from nqr_geom.integrator.samplers import Random, Sampler, Stratified
from nqr_geom.streams import Stream
from nqr_geom.toy.family import PIECES, Pieces
from nqr_geom.toy.law import fit, fit_pairs, propagate, stumpff
from nqr_geom.toy.problem import ToyProblem
from nqr_geom.toy.split import ToySplit
from nqr_geom.toy.structured import ToyHermite

RULE = ToyHermite()


def observed(problem: ToyProblem, x: Tensor) -> Samples:
    """Samples at x (B, N)."""
    return Samples(x[..., None], problem.evaluate(x[..., None]), None, "given")


def made_up(x: list[float], value: list[float], slope: list[float], piece: list[int]) -> Samples:
    """One row of samples that no problem gave."""
    x_, value_, slope_ = (torch.tensor([t], dtype=torch.float64)[..., None] for t in (x, value, slope))
    features = {"derivative": slope_[..., None], "piece": torch.tensor([piece])[..., None, None]}
    return Samples(x_, Observation(value_[..., None], features), None, "given")


def estimate(samples: Samples) -> np.ndarray:
    return RULE.combine(samples).estimate(samples).numpy()


def parabolas(batch: int, seed: int = 0) -> ToyProblem:
    """Random integrands of lines and parabolas."""
    problem = ToyProblem(batch, seed)
    wave = problem.pieces.alpha > 0.0
    p = problem.pieces
    pieces = replace(p, alpha=torch.zeros_like(p.alpha), curvature=torch.where(wave, p.slope, p.curvature))
    return ToyProblem(problem.rows, seed, pieces=pieces)


def fenced(pieces: Pieces, inner: int) -> Tensor:
    """Both ends of every piece, to the last bit, and `inner` points between: no gap hides a break, (B, N)."""
    left, right = pieces.edges[:, :-1, None], pieces.edges[:, 1:, None]
    between = left + (right - left) * (torch.arange(1, inner + 1) / (inner + 1.3))
    return torch.cat([left, between, torch.nextafter(right, left)], dim=2).flatten(1)


@pytest.mark.parametrize("z", [0.0, 1e-12, 1e-3, 0.2499, 0.2501, 1.0, 9.0])
def test_stumpff_functions_are_their_series(z: float) -> None:
    exact = Fraction(z)
    got = stumpff(torch.tensor(z, dtype=torch.float64))
    for k, c in enumerate(got):
        series = sum((-exact) ** j / math.factorial(k + 2 * j) for j in range(25))
        assert c.item() == pytest.approx(float(series), rel=5e-15, abs=1e-15)


def test_three_samples_of_a_piece_tell_its_law() -> None:
    x = torch.tensor([[0.11, 0.13, 0.2, 0.4, 0.5, 0.9]], dtype=torch.float64)
    piece = torch.tensor([[0, 0, 0, 1, 1, 2]])
    omega = 71.0
    wave, line = x[:, :3] * omega, x[:, 3:5]
    value = torch.cat([2.0 + 0.7 * torch.sin(wave), 3.0 * line**2 - line, x[:, 5:]], dim=1)
    slope = torch.cat([0.7 * omega * torch.cos(wave), 6.0 * line - 1.0, x[:, 5:]], dim=1)
    law = fit(x, value, slope, piece, PIECES)
    assert law.known.tolist() == [[True] * 5 + [False]]
    assert not law.foreign.any()
    torch.testing.assert_close(law.alpha[0, :3], torch.full((3,), omega**2, dtype=torch.float64), rtol=1e-9, atol=0.0)
    torch.testing.assert_close(law.curvature[:, :3], -(omega**2) * (value[:, :3] - 2.0), rtol=1e-8, atol=1e-6)
    torch.testing.assert_close(law.curvature[0, 3:5], torch.full((2,), 6.0, dtype=torch.float64), rtol=1e-12, atol=0.0)


def test_two_samples_within_a_period_tell_a_wave() -> None:
    x = torch.tensor([[0.30, 0.34]], dtype=torch.float64)
    piece = torch.zeros(1, 2, dtype=torch.int64)
    for omega in (5.0, 40.0, 109.0):
        value, slope = 1.0 + torch.sin(omega * x + 0.4), omega * torch.cos(omega * x + 0.4)
        law = fit_pairs(fit(x, value, slope, piece, PIECES), x, value, slope, piece, 110.0)
        assert law.known.all()
        there, _ = propagate(law.alpha, 0.1 - x, value, slope, law.curvature)
        torch.testing.assert_close(there, 1.0 + torch.sin(omega * torch.full_like(x, 0.1) + 0.4), rtol=1e-9, atol=1e-9)
        # Two periods are possible once the samples may be farther apart than the shortest one.
        law = fit_pairs(fit(x, value, slope, piece, PIECES), x, value, slope, piece, 200.0)
        assert not law.known.any()


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5])
def test_close_samples_of_a_wave_do_not_pass_for_a_parabola(step: float) -> None:
    x, piece = torch.tensor([[0.137, 0.137 + step]], dtype=torch.float64), torch.zeros(1, 2, dtype=torch.int64)
    omega = 106.0
    value, slope = 2.0 + torch.sin(omega * x), omega * torch.cos(omega * x)
    law = fit(x, value, slope, piece, PIECES)
    assert not law.known.any()
    law = fit_pairs(law, x, value, slope, piece, 110.0)
    assert law.known.all()
    assert law.alpha[0, 0].sqrt().item() == pytest.approx(omega, rel=1e-2)


# Two samples of nearly equal value, on either side of an extremum: squares of f and f' tell nothing of them.
FACING = [[0.0, 0.07, -0.0700001, 0.1], [0.02, -0.0200002, 0.055], [0.021, -0.021, 0.05], [-0.06, 0.059999999, 0.08]]


def facing(at: list[float], omega: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Samples around an extremum at 0.5, of a wave or (omega = 0) a parabola."""
    t = torch.tensor([sorted(at)], dtype=torch.float64)
    if omega:
        value, slope = 1.3 + 0.8 * torch.cos(omega * t), -0.8 * omega * torch.sin(omega * t)
    else:
        value, slope = 1.3 - 9.0 * t**2, -18.0 * t
    return 0.5 + t, value, slope, torch.full_like(t, 2, dtype=torch.int64)


@pytest.mark.parametrize("at", FACING)
@pytest.mark.parametrize("omega", [0.0, 7.0, 31.0, 60.0, 109.0])
def test_samples_of_equal_values_tell_a_law_too(at: list[float], omega: float) -> None:
    samples = facing(at, omega)
    law = fit_pairs(fit(*samples, PIECES), *samples, 110.0)
    assert law.known.all()
    assert not law.foreign.any()
    x, value, slope, _ = samples
    there, _ = propagate(law.alpha, 0.63 - x, value, slope, law.curvature)
    truth = 1.3 + 0.8 * math.cos(omega * 0.13) if omega else 1.3 - 9.0 * 0.13**2
    torch.testing.assert_close(there, torch.full_like(there, truth), rtol=0.0, atol=3e-6)


def test_samples_of_no_law_stay_unknown() -> None:
    x, value, slope, piece = facing(FACING[1], 31.0)
    slope = slope + torch.tensor([[0.0, 0.0, 1e-2]], dtype=torch.float64)
    law = fit_pairs(fit(x, value, slope, piece, PIECES), x, value, slope, piece, 110.0)
    assert not law.known.any()
    assert law.foreign.all()


def test_pieces_that_come_again_are_not_mixed_up() -> None:
    """Of data of other makers, only neighbours make a pair."""
    x, value, slope, _ = facing([-0.03, -0.01, 0.02, 0.024], 40.0)
    piece = torch.tensor([[1, 2, 1, 1]])
    law = fit_pairs(fit(x, value, slope, piece, PIECES), x, value, slope, piece, 110.0)
    assert law.known[0, 2:].all()
    torch.testing.assert_close(law.alpha[0, 2:], torch.full((2,), 1600.0, dtype=torch.float64), rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("slope", [60.0, -200.0])
def test_two_samples_that_no_wave_of_the_family_explains_tell_nothing(slope: float) -> None:
    x, value = (torch.tensor([t], dtype=torch.float64) for t in ([0.30, 0.34], [0.0, 1.0]))
    slopes, piece = torch.full_like(x, slope), torch.zeros(1, 2, dtype=torch.int64)
    # h (f0' + f1') / (f1 - f0) is 4.8, more than any wave has, and -16, which needs omega = 140.
    law = fit_pairs(fit(x, value, slopes, piece, PIECES), x, value, slopes, piece, 110.0)
    assert not law.known.any()


@pytest.mark.parametrize(("problem", "inner"), [(ToyProblem(300), 1), (ToyProblem(300, 8), 6), (parabolas(300), 0)])
def test_exact_where_no_gap_hides_a_break(problem: ToyProblem, inner: int) -> None:
    error = estimate(observed(problem, fenced(problem.pieces, inner))) - problem.reference()
    # Three samples may lie so that they hardly tell omega from a parabola's bend.
    assert np.abs(error).max() < 1e-9
    assert np.quantile(np.abs(error), 0.9) < 1e-13


@pytest.mark.parametrize(("bend", "tolerance"), [(0.0, 1e-14), (6.0, 1e-6)])
def test_one_function_is_exact_wherever_it_is_cut(bend: float, tolerance: float) -> None:
    # A line to rounding; a parabola to the eight positions of a break that are tried (third order in the gap).
    problem = ToyProblem(400)
    start = problem.pieces.edges[:, :-1]
    value, slope = 2.0 - start + 0.5 * bend * start**2, bend * start - 1.0
    pieces = Pieces(problem.pieces.edges, value, slope, torch.full_like(start, bend), torch.zeros_like(start))
    cut = ToyProblem(problem.rows, pieces=pieces)
    samples = Stratified().draw(cut, 64, Stream(0))
    assert np.abs(estimate(samples) - 1.5 - bend / 6.0).max() < tolerance


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_cubics_are_exact_between_samples(degree: int) -> None:
    x = [0.0, 0.1, 0.35, 0.6, 0.61, 1.0]
    slope = [degree * t ** max(degree - 1, 0) for t in x]
    # All samples in one piece; the others hide in gaps of no width at 1.
    samples = made_up(
        [*x, *[1.0] * 4], [t**degree for t in [*x, *[1.0] * 4]], [*slope, *[slope[-1]] * 4], [0] * 6 + [1, 2, 3, 4]
    )
    assert estimate(samples)[0, 0] == pytest.approx(1.0 / (degree + 1), abs=1e-12)


def test_one_hidden_break_is_averaged_over_the_gap() -> None:
    # Constant pieces 0 and 1 (so small a jump is likely anywhere) and a break in [0.4, 0.6].
    x = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0, 1.0]
    samples = made_up(x, [1.0] * 3 + [2.0] * 6, [0.0] * 9, [0, 0, 0, 1, 1, 1, 2, 3, 4])
    assert estimate(samples)[0, 0] == pytest.approx(1.5, abs=1e-14)


CASES = {
    "one sample": ([0.3], [1.7], [4.0], [1]),
    "sample at 0": ([0.0], [1.7], [4.0], [0]),
    "sample at 1": ([1.0], [1.7], [-80.0], [4]),
    "equal samples": ([0.5] * 4, [2.0] * 4, [30.0] * 4, [2] * 4),
    "all in the first piece": ([0.1, 0.2, 0.3, 0.4], [1.0, 2.0, 1.0, 3.0], [5.0, -60.0, 7.0, 0.0], [0] * 4),
    "first and last piece alone": ([0.1, 0.9], [1.0, 2.0], [0.0, 0.0], [0, 4]),
    "neighbouring numbers": ([0.5, float(np.nextafter(0.5, 1.0))], [1.0, 2.0], [0.0, 9.0], [1, 3]),
    "constant": ([0.2, 0.5, 0.7], [3.0, 3.0, 3.0], [0.0, 0.0, 0.0], [0, 2, 4]),
    "huge": ([0.2, 0.21, 0.3, 0.7], [1e200, -1e200, 1e180, 1e200], [1e201, 0.0, 1e200, -1e202], [0, 0, 0, 1]),
    "tiny": ([0.2, 0.21, 0.3, 0.7], [1e-200, 0.0, 1e-180, 0.0], [1e-200, 0.0, 1e-200, 0.0], [0, 0, 0, 1]),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_hard_samples_give_numbers(case: tuple[list[float], list[float], list[float], list[int]]) -> None:
    got = estimate(made_up(*case))[0, 0]
    assert np.isfinite(got)
    if not any(case[2]) and len(set(case[1])) == 1:
        assert got == pytest.approx(case[1][0], rel=1e-14)


@pytest.mark.parametrize("sampler", [Random(), ToySplit()], ids=lambda sampler: sampler.name)
@pytest.mark.parametrize("n", [1, 2, 5, 32])
def test_a_row_has_the_same_bits_in_any_batch(sampler: Sampler, n: int) -> None:
    problem = ToyProblem(1_000)
    whole = run(problem, sampler, RULE, n).value
    assert np.isfinite(whole).all()
    for index in (slice(17, 18), slice(3, 400), torch.tensor([999, 0])):
        part = run(problem.take(index), sampler, RULE, n).value
        assert np.array_equal(part, whole[index])


def test_order_of_samples_does_not_matter() -> None:
    problem = ToyProblem(200)
    samples = Random().draw(problem, 32, Stream(0))
    order = torch.rand(200, 32, generator=torch.manual_seed(0)).argsort(dim=1)
    np.testing.assert_allclose(estimate(samples.permuted(order)), estimate(samples), rtol=1e-13)


def test_more_samples_keep_the_first_ones() -> None:
    problem = ToyProblem(100)
    long = ToySplit().draw(problem, 40, Stream(0)).x
    for n in (6, 7, 20):
        assert torch.equal(ToySplit().draw(problem, n, Stream(0)).x, long[:, :n])
    assert not (ToySplit().draw(problem, 6, Stream(1)).x == long[:, :6]).any()


def test_sampler_closes_in_on_every_break() -> None:
    problem = ToyProblem(500)
    points = ToySplit().draw(problem, 40, Stream(0)).x[..., 0]
    distance = (points[:, :, None] - problem.pieces.edges[:, None, 1:-1]).abs().amin(dim=1)
    assert distance.max() < 0.01


def test_an_end_is_looked_at_though_the_tangent_there_is_flat() -> None:
    # The first piece is a parabola that ends just right of the first sample, where its top is.
    rows = torch.arange(100)
    top = Stratified().points(rows, 6, 1, Stream(0))[:, 0]
    edges = torch.cat([0.0 * top, top + 1e-9, torch.tensor([0.4, 0.6, 0.8, 1.0]).double().expand(100, 4)], dim=1)
    table = torch.zeros(100, PIECES, dtype=torch.float64)
    bend = torch.zeros_like(table)
    bend[:, 0] = -300.0
    problem = ToyProblem(rows, pieces=Pieces(edges, table + 2.0, -top * bend, bend, torch.zeros_like(table)))
    error = estimate(ToySplit().draw(problem, 32, Stream(0))) - problem.reference()
    assert np.abs(error).max() < 5e-3


def test_structured_beats_monte_carlo_four_thousand_times() -> None:
    problem = ToyProblem(2_000, seed=1)
    errors = {}
    for sampler in (Random(), Stratified(), ToySplit()):
        value = run(problem, sampler, RULE, 32, seed=1).value
        errors[sampler.name] = (value - problem.reference()) ** 2
    x = Random().draw(problem, 32, Stream(1, "test", "samples/0"))
    mc = (x.value.mean(dim=(1, 2)).numpy() - problem.reference()) ** 2
    resample = Bootstrap.of(problem.groups, 1, 0)
    low, _ = resample.ratio(mc, errors["toy-split"]) or (0.0, 0.0)
    assert low > 4_000.0
    # The same rule on the paper's samples; breaks alone would leave 33 and 119 to a rule that knows the pieces.
    for name, least in (("random", 10.0), ("stratified", 120.0)):
        low, _ = resample.ratio(mc, errors[name]) or (0.0, 0.0)
        assert low > least


class Plain(Problem):
    """A problem that shows values alone."""

    name = "plain"
    rows = torch.arange(3)

    def evaluate(self, x: Tensor) -> Observation:
        return Observation(x[..., None], queries=x.numel())

    def take(self, index: slice | Tensor) -> Plain:
        return self


def test_other_problems_are_refused() -> None:
    problem = Plain()
    with pytest.raises(ValueError, match="sampler: 'toy-split' needs a 1-D problem with the features 'derivative' and"):
        ToySplit().draw(problem, 8, Stream(0))
    with pytest.raises(ValueError, match="rule: 'toy-hermite' needs the feature 'derivative'"):
        run(problem, Random(), RULE, 8)
    with pytest.raises(ValueError, match=r"piece: expected indices 0 \.\. 4, got 2 \.\. 7"):
        RULE.combine(made_up([0.2, 0.7], [1.0, 1.0], [0.0, 0.0], [2, 7]))
    with pytest.raises(ValueError, match="first: expected an integer >= 1, got 0"):
        ToySplit(first=0)
