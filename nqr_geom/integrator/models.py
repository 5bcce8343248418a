"""What a method costs and how far it is off: measured constants, shipped as a table and fitted to this machine.

`benchmarks/cost_models.py` measures them on the random families (split "validation", which no test meets) and writes
`nqr_geom/data/cost_models.json`. A cost is a sum of a few named terms, an error a table over the number of samples.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from nqr_geom.machine import cores
from nqr_geom.speed import speed

__all__ = ["TERMS", "Cost", "Law", "Model", "model", "table", "unknown"]

# Seconds per one of these; what a term costs scales with this kind of work. "log" is log2(2 + size).
TERMS: dict[str, str] = {
    "1": "calls",
    "size": "calls",
    "n": "calls",
    "rows": "numbers",
    "rows*n": "numbers",
    "rows*n*n": "numbers",
    "rows*log": "numbers",
    "rows*size": "numbers",
    "size*size": "matrices",
}


def _amounts(rows: float, n: float, size: float) -> dict[str, float]:
    """How many of each of `TERMS` there are."""
    return {
        "1": 1.0,
        "size": size,
        "n": n,
        "rows": rows,
        "rows*n": rows * n,
        "rows*n*n": rows * n * n,
        "rows*log": rows * math.log2(2.0 + size),
        "rows*size": rows * size,
        "size*size": size * size,
    }


@dataclass(frozen=True)
class Cost:
    """Seconds of one call, a sum of `TERMS`.

    Parameters
    ----------
    terms : mapping of str to float
        Seconds for one of each.

    Examples
    --------
    >>> round(Cost({"1": 1e-3, "rows*n": 1e-8}).seconds(rows=10_000, n=32), 6)
    0.0042
    """

    terms: Mapping[str, float] = field(default_factory=dict)

    def seconds(self, rows: float, n: float = 0.0, size: float = 1.0) -> float:
        """Predicted wall time for `rows` integrals of n samples on something of that size (pieces, edges)."""
        amounts = _amounts(rows, n, size)
        return sum(seconds * amounts[term] for term, seconds in self.terms.items())

    @classmethod
    def fit(cls, terms: Sequence[str], measured: Sequence[tuple[float, float, float, float]]) -> Cost:
        """The terms, none below zero, whose sum comes closest in relative error to measured (rows, n, size, seconds).

        Examples
        --------
        >>> told = [(r, n, 1.0, 1e-3 + 2e-8 * r * n) for r in (10, 1000, 10_000) for n in (8, 64)]
        >>> Cost.fit(["1", "rows*n"], told).terms["rows*n"]
        2e-08
        """
        from scipy.optimize import nnls

        spent = np.array([row[3] for row in measured])
        amounts = [_amounts(*row[:3]) for row in measured]
        matrix = np.array([[amount[term] for term in terms] for amount in amounts]) / spent[:, None]
        unit = np.where(matrix.max(axis=0) > 0.0, matrix.max(axis=0), 1.0)
        found = nnls(matrix / unit, np.ones(len(spent)))[0] / unit
        return cls({term: float(f"{value:.4g}") for term, value in zip(terms, found, strict=True) if value > 0.0})

    def on_this_machine(self, reference: Mapping[str, float], had: int, here: int) -> Cost:
        """The same constants for a machine whose loops take `speed()` instead of `reference`, with `here` cores."""
        now = speed()
        scaled = {}
        for term, seconds in self.terms.items():
            kind = TERMS[term]
            share = had / here if term.startswith("rows") else 1.0
            scaled[term] = seconds * now[kind] / reference[kind] * share
        return Cost(scaled)


@dataclass(frozen=True)
class Law:
    """Error as a function of the number of samples, in units of the problem's scale.

    Parameters
    ----------
    sizes : sequence of int
        Numbers of samples, increasing.
    typical, high : sequence of float
        Median and 95% quantile of the absolute error over integrals and runs.

    Examples
    --------
    >>> plain = Law((16, 64), (0.1, 0.05), (0.4, 0.2))
    >>> round(plain.high_at(256), 9), plain.size_for(0.2)
    (0.1, 64)
    """

    sizes: tuple[int, ...]
    typical: tuple[float, ...]
    high: tuple[float, ...]

    def _at(self, errors: Sequence[float], n: float) -> float:
        """Straight lines between logarithms; beyond the table the last line goes on, between flat and 1 / n."""
        x, y = np.log(self.sizes), np.log(np.maximum(errors, 1e-300))
        if n <= self.sizes[-1] or len(x) < 2:
            slope = (y[1] - y[0]) / (x[1] - x[0]) if len(x) > 1 else -0.5
            low = y[0] + max(min(slope, 0.0), -1.0) * (math.log(n) - x[0])
            return float(math.exp(low if n < self.sizes[0] else np.interp(math.log(n), x, y)))
        slope = max(min((y[-1] - y[-2]) / (x[-1] - x[-2]), 0.0), -1.0)
        return float(math.exp(y[-1] + slope * (math.log(n) - x[-1])))

    def typical_at(self, n: float) -> float:
        """Median error after n samples."""
        return self._at(self.typical, n)

    @lru_cache(maxsize=1024)  # noqa: B019 - laws are few, and kept anyway
    def high_at(self, n: float) -> float:
        """Error that 95 integrals in 100 stay below after n samples."""
        return self._at(self.high, n)

    def order(self, n: float) -> float:
        """How fast errors fall around n: error ~ n^-order, between 1/4 and 4."""
        return min(max(math.log2(self.high_at(n) / max(self.high_at(2.0 * n), 1e-300)), 0.25), 4.0)

    @lru_cache(maxsize=1024)  # noqa: B019
    def size_for(self, error: float, most: int = 2**22) -> int | None:
        """Fewest samples with a 95% quantile of at most `error`; None if it takes too many."""
        if self.high[0] <= error:
            return self.sizes[0]
        wanted = math.log(error)
        found = math.inf
        for k in range(1, len(self.sizes)):
            last, here = math.log(self.high[k - 1]), math.log(max(self.high[k], 1e-300))
            if here <= wanted:
                part = (last - wanted) / (last - here)
                found = self.sizes[k - 1] * (self.sizes[k] / self.sizes[k - 1]) ** part
                break
        else:
            n = float(self.sizes[-1])
            slope = math.log(self.high_at(2.0 * n) / self.high_at(n)) / math.log(2.0)
            if slope < 0.0:
                found = n * math.exp(min((wanted - math.log(self.high_at(n))) / slope, 700.0))
        return math.ceil(found * (1.0 - 1e-12)) if found <= most else None


@dataclass(frozen=True)
class Model:
    """A method's cost and error.

    Parameters
    ----------
    cost : Cost
        Already of this machine.
    law : Law
        Of the family that it was measured on.
    sizes : sequence of int
        Where `factor` was measured.
    factor : sequence of float
        What an error bound from a run of n samples is multiplied with, so that 97 in 100 hold on the family.
    size : float
        Pieces of the family where errors depend on samples a piece, 0 where they do not.
    known : bool
        Whether these are figures of this method, or no more than a guess to begin with.
    bound : Law, optional
        Of the bounds that runs state of themselves, times `factor`: what a tolerance is checked against.
    """

    cost: Cost
    law: Law
    factor: tuple[float, ...] = (1.0,)
    size: float = 0.0
    known: bool = True
    bound: Law | None = None

    @property
    def checked(self) -> Law:
        """How far it is off as far as it can tell itself."""
        return self.bound or self.law

    def factor_at(self, n: float) -> float:
        """Factor on the bounds that a run of n samples gives."""
        if len(self.factor) == 1:
            return self.factor[0]
        return float(np.interp(math.log(max(n, 1.0)), np.log(self.law.sizes), self.factor))


def unknown() -> Model:
    """A model for a method nobody has measured: the first run tells."""
    cost = Cost({"1": 1e-3, "rows*n": 2e-7})
    return Model(cost, Law((1, 1024), (0.3, 0.3 / 32), (1.0, 1.0 / 32)), (1.5,), known=False)


@cache
def table() -> dict[str, Any]:
    """The shipped file: reference machine and models by "problem:method"."""
    text = (files("nqr_geom") / "data" / "cost_models.json").read_text()
    found: dict[str, Any] = json.loads(text)
    return found


@cache
def model(problem: str, method: str) -> Model | None:
    """The measured model of a method on this machine, or None if there is none.

    Examples
    --------
    >>> from nqr_geom.integrator.models import model
    >>> fast, slow = (model("gwn", m).cost.seconds(rows=10_000, n=32) for m in ("mc", "structured"))
    >>> fast < slow
    True
    """
    whole = table()
    row = whole["models"].get(f"{problem}:{method}")
    if row is None:
        return None
    threads = cores("NUMBA_NUM_THREADS") if row["threads"] else whole["cores"]
    cost = Cost(row["cost"]).on_this_machine(whole["speed"], whole["cores"], threads)
    law = Law(tuple(row["sizes"]), tuple(row["typical"]), tuple(row["high"]))
    bound = replace(law, high=tuple(row["bound"])) if "bound" in row else None
    return Model(cost, law, tuple(row["factor"]), float(row["size"]), bound=bound)
