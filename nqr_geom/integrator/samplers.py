"""Where to look: samplers place N points in [0,1]^D. These are the fixed designs; adaptive ones look first.

One verb: `draw(problem, n, stream) -> Samples`. All randomness is keyed by the integral's global row, so the same
integral sees the same points whatever the tiling.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from nqr_geom.integrator.problem import Problem, Samples
from nqr_geom.streams import Stream

__all__ = [
    "BayesianDesign",
    "GaussLegendreNodes",
    "Grid",
    "JitterPair",
    "LatinHypercube",
    "Pmj",
    "Random",
    "Sampler",
    "Sobol",
    "Stratified",
    "UniformJitter",
    "cells_per_axis",
    "scrambled",
]

_MASK32 = 0xFFFFFFFF
BELOW_ONE = 1.0 - 2.0**-53
_CERTAIN = 1e-8  # posterior variance, relative to the prior's, that counts as none


class Sampler(ABC):
    """Places samples; adaptive samplers may evaluate the problem as they go."""

    name: str = "sampler"

    @abstractmethod
    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        """Draw n samples for every integral of the problem and observe them.

        Parameters
        ----------
        problem : Problem
            B integrals over [0,1]^D.
        n : int
            Samples per integral, >= 1.
        stream : Stream
            Source of the random numbers.
        """


class FixedDesign(Sampler):
    """A sampler that places points without looking at the integrand."""

    uniform = True  # each point alone is uniform on the cube: the density is 1
    independent = False
    stratified = False  # point i lies in cell i of `cells_per_axis`
    only_1d = False

    @abstractmethod
    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        """Positions (B, n, dim) float64 for the integrals with global indices `rows` (B,)."""

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        if self.only_1d and problem.dim != 1:
            raise ValueError(f"sampler: {self.name!r} needs a 1-D problem, {problem.name!r} has {problem.dim}")
        # A sum like (cell + u) / n may round up to 1, where floor(pieces * x) would leave its range.
        x = self.points(problem.rows, n, problem.dim, stream).clamp_max(BELOW_ONE)
        batch = problem.batch
        pdf = x.new_ones(batch, n, problem.techniques) if self.uniform else None
        stratum = volume = None
        if self.stratified:
            stratum = torch.arange(n, device=x.device).expand(batch, n)
            volume = x.new_full((batch, n), 1.0 / n)
        return Samples(x, problem.evaluate(x), pdf, self.name, self.independent, stratum, volume)


def counters(rows: Tensor, n: int, dim: int) -> tuple[Tensor, Tensor, Tensor]:
    """Broadcastable counters (B,1,1), (n,1), (dim,) that key one number each."""
    device = rows.device
    return rows[:, None, None], torch.arange(n, device=device)[:, None], torch.arange(dim, device=device)


@lru_cache(maxsize=256)
def cells_per_axis(n: int, dim: int) -> tuple[int, ...]:
    """Split n cells over `dim` axes as evenly as its factors allow, largest first.

    Examples
    --------
    >>> cells_per_axis(32, 2)
    (8, 4)
    >>> cells_per_axis(7, 2)
    (7, 1)
    """
    factors = []
    rest = n
    for prime in range(2, math.isqrt(n) + 1):
        while rest % prime == 0:
            factors.append(prime)
            rest //= prime
    if rest > 1:
        factors.append(rest)
    axes = [1] * dim
    for factor in sorted(factors, reverse=True):
        axes[axes.index(min(axes))] *= factor
    return tuple(sorted(axes, reverse=True))


def _cells(n: int, dim: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Integer corner of cell i (n, dim) and the number of cells on each axis (dim,)."""
    axes = cells_per_axis(n, dim)
    corner = np.stack(np.unravel_index(np.arange(n), axes), axis=-1)
    return torch.as_tensor(corner, device=device), torch.as_tensor(axes, device=device)


class Random(FixedDesign):
    """Independent uniform points."""

    name = "random"
    independent = True

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        return stream.uniform(*counters(rows, n, dim))


class Stratified(FixedDesign):
    """One uniform point in each of n equal cells (jittered sampling)."""

    name = "stratified"
    stratified = True

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        corner, axes = _cells(n, dim, rows.device)
        return (corner + stream.uniform(*counters(rows, n, dim))) / axes


class UniformJitter(FixedDesign):
    """The same uniform place in each of n equal cells: one random shift of a grid (uniform jitter).

    References
    ----------
    Ramamoorthi, Anderson, Meyer, Nowrouzezahrai, A theory of Monte Carlo visibility sampling, 2012.
    """

    name = "uniform-jitter"
    stratified = True

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        corner, axes = _cells(n, dim, rows.device)
        shift = stream.uniform(*counters(rows, 1, dim))
        return (corner + shift) / axes


class JitterPair(FixedDesign):
    """Two independent uniformly jittered sets of half the points each; `stratum` tells them apart."""

    name = "jitter-pair"
    only_1d = True

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        first = UniformJitter().points(rows, n - n // 2, dim, stream.child("first"))
        if n == 1:
            return first
        return torch.cat([first, UniformJitter().points(rows, n // 2, dim, stream.child("second"))], dim=1)

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        samples = super().draw(problem, n, stream)
        half = (torch.arange(n, device=samples.x.device) >= n - n // 2).long()
        volume = torch.where(half == 0, n - n // 2, n // 2).double() / n
        return replace(samples, stratum=half.expand(problem.batch, n), volume=volume.expand(problem.batch, n))


class Grid(FixedDesign):
    """Centres of n equal cells."""

    name = "grid"
    uniform = False
    stratified = True

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        corner, axes = _cells(n, dim, rows.device)
        return ((corner + 0.5).double() / axes).expand(rows.shape[0], n, dim)


@lru_cache(maxsize=64)
def gauss_legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of n-point Gauss-Legendre quadrature on [0, 1] (weights sum to 1)."""
    from scipy.special import roots_legendre

    nodes, weights = roots_legendre(n)  # from a banded matrix: NumPy's leggauss needs n^2 numbers
    return (nodes + 1.0) / 2.0, weights / 2.0


class GaussLegendreNodes(FixedDesign):
    """Nodes of the (tensor-product) Gauss-Legendre rule with n points in all."""

    name = "gauss-legendre"
    uniform = False

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        axes = cells_per_axis(n, dim)
        mesh = np.meshgrid(*(gauss_legendre(k)[0] for k in axes), indexing="ij")
        nodes = np.stack([m.ravel() for m in mesh], axis=-1)
        return torch.as_tensor(nodes, device=rows.device).expand(rows.shape[0], n, dim)


class LatinHypercube(FixedDesign):
    """Each axis cut into n strata, every stratum hit once, the axes shuffled independently."""

    name = "latin-hypercube"

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        keys = counters(rows, n, dim)
        order = stream.child("order").bits(*keys).argsort(dim=1)
        return (order + stream.uniform(*keys)) / n


def _reverse32(x: Tensor) -> Tensor:
    """Bit reversal of 32-bit integers held in int64."""
    x = ((x & 0x55555555) << 1) | ((x >> 1) & 0x55555555)
    x = ((x & 0x33333333) << 2) | ((x >> 2) & 0x33333333)
    x = ((x & 0x0F0F0F0F) << 4) | ((x >> 4) & 0x0F0F0F0F)
    x = ((x & 0x00FF00FF) << 8) | ((x >> 8) & 0x00FF00FF)
    return ((x & 0x0000FFFF) << 16) | ((x >> 16) & 0x0000FFFF)


def _owen(reversed_bits: Tensor, key: Tensor) -> Tensor:
    """Hash-based nested uniform scrambling of bit-reversed 32-bit fractions; gives the fraction's bits.

    Laine and Karras 2011 with the constants of Vegdahl 2021, as in Burley, Practical hash-based Owen scrambling.
    """
    x = reversed_bits
    x = (x ^ (x * 0x3D20ADEA)) & _MASK32
    x = (x + key) & _MASK32
    x = (x * ((key >> 16) | 1)) & _MASK32
    x = (x ^ (x * 0x05526C56)) & _MASK32
    x = (x ^ (x * 0x53A22864)) & _MASK32
    return _reverse32(x)


@lru_cache(maxsize=32)
def sobol_reversed(n: int, dim: int) -> np.ndarray:
    """First n points of the Sobol' sequence as bit-reversed 32-bit integers, (n, dim) int64."""
    from scipy.stats import qmc

    levels = max(0, math.ceil(math.log2(n)))
    points = qmc.Sobol(dim, scramble=False, bits=32).random_base2(levels)[:n]
    return _reverse32(torch.as_tensor((points * 2.0**32).astype(np.int64))).numpy()


def scrambled(reversed_bits: Tensor, keys: tuple[Tensor, ...], stream: Stream) -> Tensor:
    """Scramble every axis of every row with its own key; the digits below 2^-32 are random."""
    rows, samples, axes = keys
    scramble = stream.child("scramble").bits(rows, axes) & _MASK32
    digits = _owen(reversed_bits, scramble)
    return (digits + stream.uniform(rows, samples, axes)) * 2.0**-32


class Sobol(FixedDesign):
    """Sobol' points with an independent Owen scrambling per integral."""

    name = "sobol"

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        base = torch.as_tensor(sobol_reversed(n, dim), device=rows.device)
        return scrambled(base, counters(rows, n, dim), stream)


class Pmj(FixedDesign):
    """Progressive multi-jittered (0,2) points in every pair of axes, the pairs shuffled against each other.

    An Owen-scrambled (0,2)-sequence is stratified in every elementary interval at every power of two (Christensen,
    Kensler, Kilpatrick 2018); the shuffle is nested too, so the pairs keep that property.
    """

    name = "pmj"

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        keys = counters(rows, n, dim)
        base = torch.as_tensor(sobol_reversed(n, 2), device=rows.device)
        index = _reverse32(torch.arange(n, device=rows.device))
        columns = []
        for first in range(0, dim, 2):
            width = min(2, dim - first)
            pair = base[None, :, :width].expand(rows.shape[0], n, width)
            if first > 0:
                key = stream.child(f"shuffle {first}").bits(rows[:, None]) & _MASK32
                order = _owen(index[None], key).argsort(dim=1)
                pair = torch.gather(pair, 1, order[..., None].expand_as(pair))
            columns.append(pair)
        return scrambled(torch.cat(columns, dim=-1), keys, stream)


@lru_cache(maxsize=4096)
def _least_certain(first: int, n: int, candidates: int, length: float) -> np.ndarray:
    """Indices of n grid points, each where the posterior variance given the ones before is largest.

    The variance does not depend on the values, so the greedy choice is a pivoted Cholesky factorisation of the
    kernel matrix. Where nothing is uncertain any more the point farthest from all others comes next.
    """
    index = np.arange(candidates)
    variance = np.ones(candidates)
    apart = np.full(candidates, candidates)
    factor = np.zeros((n, candidates))
    chosen = [first]
    for i in range(n - 1):
        pivot = chosen[-1]
        apart = np.minimum(apart, np.abs(index - pivot))
        if variance.max() > _CERTAIN:
            kernel = np.exp(-0.5 * ((index - pivot) / (candidates * length)) ** 2)
            spread = math.sqrt(max(variance[pivot], _CERTAIN))
            factor[i] = (kernel - factor[:i, pivot] @ factor[:i]) / spread
            variance -= factor[i] ** 2
            variance[apart == 0] = 0.0
        # Rounded, so that a tie is not decided by the last bit.
        rank = np.round(variance, 9) if variance.max() > _CERTAIN else apart
        chosen.append(int(rank.argmax()))
    return np.array(chosen)


@dataclass(frozen=True)
class BayesianDesign(FixedDesign):
    """Sequential Bayesian quadrature: the first point is random, each next one where the posterior variance is largest.

    See Osborne et al. 2012 and Fig. 43. On a grid the choice depends on the first point alone, so it is made once.

    Parameters
    ----------
    length : float
        Length scale of the squared-exponential kernel, in units of the interval.
    candidates : int
        Points of the candidate grid, shifted at random for each integral.
    """

    length: float = 0.015
    candidates: int = 256

    name = "bayesian-quadrature"
    uniform = False
    only_1d = True

    def points(self, rows: Tensor, n: int, dim: int, stream: Stream) -> Tensor:
        candidates = max(self.candidates, 4 * n)
        shift, first = stream.uniform(rows[:, None], torch.arange(2, device=rows.device)).unbind(dim=1)
        pivots = (first * candidates).long().tolist()
        order = np.stack([_least_certain(pivot, n, candidates, self.length) for pivot in pivots])
        return ((torch.as_tensor(order, device=rows.device) + shift[:, None]) / candidates)[..., None]
