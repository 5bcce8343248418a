"""Array-RQMC: walks that are alike stand side by side, and neighbours are sent in different directions."""

from __future__ import annotations

import torch

from nqr_geom.integrator.problem import Problem, Samples, WalkProblem
from nqr_geom.integrator.samplers import BELOW_ONE, Sampler, scrambled, sobol_reversed
from nqr_geom.streams import Stream

__all__ = ["ArrayRqmc"]


class ArrayRqmc(Sampler):
    """Sort the walks before each step and spread the next coordinates evenly over any run of neighbours.

    The k-th walk in the order of `WalkProblem.rank` takes the k-th point of a van der Corput sequence, scrambled anew
    for every integral and step: with k/n it is a (0,2)-net, so any run of neighbours has its coordinates well spread.
    Each walk alone is still uniform, so means stay unbiased.

    References
    ----------
    L'Ecuyer, Lecot, Tuffin, A randomized quasi-Monte Carlo simulation method for Markov chains, 2008.

    Examples
    --------
    >>> from nqr_geom.wos.problems import LaplaceProblem
    >>> samples = ArrayRqmc().draw(LaplaceProblem.family(2, points=3), 32, Stream(0))
    >>> samples.x.shape, samples.independent
    (torch.Size([6, 32, 12]), False)
    """

    name = "array-rqmc"

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        if not isinstance(problem, WalkProblem):
            raise ValueError(f"sampler: {self.name!r} needs a problem whose samples are walks, got {problem.name!r}")
        rows = problem.rows
        base = torch.as_tensor(sobol_reversed(n, 1), device=rows.device)
        index = torch.arange(n, device=rows.device)[:, None]
        state, columns = problem.start(n), []
        for j in range(problem.dim):
            axis = torch.tensor([j], device=rows.device)
            spread = scrambled(base, (rows[:, None, None], index, axis), stream)[..., 0].clamp_max(BELOW_ONE)
            # Equal ranks keep their order: which walk is which means nothing.
            order = problem.rank(state).argsort(dim=1, stable=True)
            columns.append(torch.empty_like(spread).scatter(1, order, spread))
            state = problem.step(state, columns[-1])
        x = torch.stack(columns, dim=-1)
        return Samples(x, problem.finish(state), x.new_ones(problem.batch, n, problem.techniques), self.name)
