"""Keyed random numbers: the same in NumPy and torch, never 0 or 1, and nothing in common between keys."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch
from scipy import stats

from nqr_geom.streams import Stream, bits, to_unit


def test_numpy_and_torch_agree_bit_for_bit():
    rows, samples = np.arange(50)[:, None], np.arange(-3, 40)
    for stream in (Stream(0), Stream(-7, "train"), Stream(2**63 + 5, name="shapes"), Stream(2**70)):
        ours = stream.bits(rows, samples)
        theirs = stream.bits(torch.from_numpy(rows), torch.from_numpy(samples))
        np.testing.assert_array_equal(ours, theirs.numpy())
        np.testing.assert_array_equal(
            stream.uniform(rows, samples), stream.uniform(*map(torch.from_numpy, (rows, samples)))
        )


def test_known_numbers():
    """SplitMix64 with seed 1234567 gives these in every implementation; ours is its finaliser over counters."""
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    got = bits(1234567, np.arange(5)).astype(np.uint64)
    assert got.tolist() == expected


def test_the_ends_of_the_interval_never_come():
    extreme = np.array([0, -1, 1, -(2**63), 2**63 - 1, 0xFFF], dtype=np.int64)
    for u in (to_unit(extreme), to_unit(torch.from_numpy(extreme)).numpy()):
        assert u.min() == 2.0**-53
        assert u.max() == 1.0 - 2.0**-53
        assert u.dtype == np.float64


def test_one_flipped_bit_flips_half_of_the_output():
    """Avalanche, for every bit of every counter and of the key."""
    base = np.arange(2000, dtype=np.int64)
    reference = bits(99, base, base * 7)

    def flips(other):
        return np.unpackbits((reference ^ other).view(np.uint8)).mean()

    for k in range(63):
        mask = np.int64(1) << k
        for other in (
            bits(99, base ^ mask, base * 7),
            bits(99, base, base * 7 ^ mask),
            bits(99 ^ int(mask), base, base * 7),
        ):
            assert abs(flips(other) - 0.5) < 0.01  # 128,000 bits: seven standard deviations


def test_every_output_bit_is_fair_and_independent_of_its_neighbour():
    words = bits(5, np.arange(20000))
    table = np.unpackbits(words.view(np.uint8)).reshape(-1, 64)
    assert np.abs(table.mean(axis=0) - 0.5).max() < 5.0 * 0.5 / np.sqrt(len(table))
    correlation = np.corrcoef(table[:-1].T, table[1:].T)[:64, 64:]
    assert np.abs(correlation).max() < 6.0 / np.sqrt(len(table))


FAMILY = {
    "seed 0": Stream(0),
    "seed 1": Stream(1),
    "train": Stream(0, "train"),
    "validation": Stream(0, "validation"),
    "other name": Stream(0, name="shapes"),
    "child": Stream(0).child("order"),
}


@pytest.mark.parametrize(("one", "two"), list(combinations(FAMILY, 2)))
def test_streams_are_independent(one, two):
    """Chi-square of the joint 8 x 8 histogram, at level 0.001 over the 15 pairs."""
    keys = np.arange(100)[:, None], np.arange(100)
    u, v = (FAMILY[name].uniform(*keys).ravel() for name in (one, two))
    counts = np.histogram2d(u, v, bins=8, range=[[0, 1], [0, 1]])[0]
    assert stats.chisquare(counts.ravel()).pvalue > 0.001 / 15
    assert not np.intersect1d(u, v).size


def test_rows_samples_and_dimensions_are_independent():
    u = Stream(3).uniform(np.arange(60)[:, None, None], np.arange(60)[:, None], np.arange(6))
    for one, two in ((u[:-1], u[1:]), (u[:, :-1], u[:, 1:]), (u[..., :-1], u[..., 1:]), (u[..., 0], u[..., 0].T)):
        counts = np.histogram2d(one.ravel(), two.ravel(), bins=8, range=[[0, 1], [0, 1]])[0]
        if one.shape == (60, 60):  # the diagonal compares a number with itself
            off = ~np.eye(60, dtype=bool)
            counts = np.histogram2d(one[off], two[off], bins=8, range=[[0, 1], [0, 1]])[0]
            counts = counts[np.triu_indices(8, 1)]  # (i, j) and (j, i) are one pair
        assert stats.chisquare(counts.ravel()).pvalue > 0.001 / 4


@pytest.mark.parametrize(
    ("make", "error", "match"),
    [
        (lambda: Stream(0, "holdout"), ValueError, "split: expected one of test, train, validation, got 'holdout'"),
        (lambda: Stream(1.5), TypeError, "seed: expected an integer, got 1.5"),
        (lambda: Stream(True), TypeError, "seed: expected an integer, got True"),
    ],
)
def test_bad_streams_are_refused(make, error, match):
    with pytest.raises(error, match=match):
        make()
