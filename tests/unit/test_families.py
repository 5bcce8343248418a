"""The random shapes of Fig. 38, the shapes of Fig. 25, and the smooth black boxes."""

import numpy as np
import pytest
import shapely
import torch
from scipy import stats

from nqr_geom.curves import families


def test_random_shapes_are_uniform_and_joined_as_in_figure_38():
    points = families.control_points(np.arange(4000), seed=5, split="train")
    assert points.shape == (4000, 6, 3, 2)
    assert points.dtype == np.float64
    assert (points[:, 0, 2] == points[:, 1, 0]).all()
    assert (points[:, 2, 2] == points[:, 3, 0]).all()
    free = points.reshape(4000, 18, 2)[:, [i for i in range(18) if i not in (3, 9)]].reshape(4000, 32)
    assert len(np.unique(free)) == free.size  # nothing else is shared
    p = np.array([stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue for column in free.T])
    assert p.min() > 1e-3 / 32
    correlation = np.corrcoef(free.T)[np.triu_indices(32, 1)]
    assert np.abs(correlation).max() < 5 / np.sqrt(4000)


def test_curves_have_four_open_chains():
    for curve in families.curves(5, seed=1):
        assert curve.degree.tolist() == [2] * 6
        assert curve.chain.tolist() == [0, 0, 1, 1, 2, 3]
        assert np.abs(curve.control).max() < 1
    assert families.curves(0) == []


def test_shapes_depend_on_their_index_seed_and_split_only():
    few, many = families.curves(5, seed=2), families.curves(10, seed=2)
    assert all((a.control == b.control).all() for a, b in zip(few, many[:5], strict=True))
    tail = families.control_points(np.arange(5, 10), seed=2)
    assert (tail == [c.control[:, :3] for c in many[5:]]).all()
    worlds = [(2, "test"), (2, "train"), (2, "validation"), (3, "test")]
    first = {families.control_points(np.arange(1), *world).tobytes() for world in worlds}
    assert len(first) == 4


def test_torch_rows_give_the_same_bits():
    rows = np.array([0, 7, 123456789012])
    tensor = families.control_points(torch.from_numpy(rows), seed=4, split="train")
    assert tensor.dtype == torch.float64
    assert (tensor.numpy() == families.control_points(rows, seed=4, split="train")).all()


def test_guards():
    with pytest.raises(ValueError, match="n: expected an integer >= 0, got -1"):
        families.curves(-1)
    with pytest.raises(ValueError, match="split: expected one of"):
        families.curves(1, split="exam")
    with pytest.raises(TypeError, match="seed: expected an integer"):
        families.curves(1, seed=0.5)
    with pytest.raises(ValueError, match="a: expected an integer >= 1"):
        families.lissajous(a=0)
    with pytest.raises(ValueError, match="phase: expected a number"):
        families.lissajous(phase=np.nan)
    with pytest.raises(ValueError, match="harmonics: expected an integer >= 1"):
        families.fourier(harmonics=0)


def test_house_and_impossible_have_the_counts_of_figure_25():
    house = families.house()
    assert (len(house), house.is_closed) == (5, True)
    assert shapely.Polygon(house.control[:, 0]).exterior.is_ccw
    triangle = families.impossible()
    assert (len(triangle), triangle.chain.max(), triangle.is_closed) == (18, 2, True)
    beams = [shapely.Polygon(triangle.control[triangle.chain == i, 0]) for i in range(3)]
    assert all(beam.exterior.is_ccw and beam.is_valid for beam in beams)
    assert [a.intersection(b).area for a, b in zip(beams, beams[1:] + beams[:1], strict=True)] == pytest.approx([0] * 3)
    whole = shapely.union_all(beams)
    np.testing.assert_allclose(whole.area, sum(beam.area for beam in beams), rtol=1e-12)
    assert len(whole.interiors) == 1
    assert len(whole.exterior.simplify(1e-9).coords) - 1 == 6  # a triangle with its corners cut
    assert max(map(abs, whole.bounds)) < 1


def test_knots_are_two_smooth_closed_curves():
    knots = families.knots()
    assert (len(knots), knots.chain.max(), knots.is_closed) == (30, 1, True)
    assert (knots.degree == 2).all()
    assert max(map(abs, knots.bounds)) < 1
    j = np.arange(30)
    before = np.where(j % 15 == 0, j + 14, j - 1)
    end, start = knots.derivative((before + 1) / 30, piece=before), knots.derivative(j / 30)
    np.testing.assert_allclose(end, start, atol=1e-12)


@pytest.mark.parametrize("make", [families.lissajous, families.fourier, lambda **k: families.fourier(9, **k)])
def test_black_boxes_are_closed_smooth_and_bounded(make):
    curve = make(pieces=6)
    assert curve.n_pieces == 6
    s = np.linspace(0, 1, 401)
    x, tangent = curve.sample(s), curve.derivative(s)
    np.testing.assert_allclose(x[0], x[-1], atol=1e-12)
    np.testing.assert_allclose(tangent[0], tangent[-1], atol=1e-10)
    assert np.abs(x).max() <= 1
    assert np.ptp(x, axis=0).min() > 0.5
    h = 1e-5
    difference = (curve.sample(s[1:-1] + h) - curve.sample(s[1:-1] - h)) / (2 * h)
    np.testing.assert_allclose(tangent[1:-1], difference, atol=1e-5)


def test_fourier_curves_differ_by_seed_and_split():
    curves = [families.fourier(0), families.fourier(1), families.fourier(0, split="train")]
    assert len({curve.sample(0.1).tobytes() for curve in curves}) == 3
    assert (families.fourier(1).sample(0.1) == curves[1].sample(0.1)).all()
