"""Rules on the same samples: what the benchmarks of learned rules have in common.

A network is never shown alone. Beside it stand its base rule and the network on the uniform base (the paper's form), on
the very same samples, as ratios of mean squared errors to plain Monte Carlo with as many random samples. A trained
sampler (`method="nqr"` of a problem) joins every comparison as soon as the registry names it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from nqr_geom import registry
from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.frontier import refusal
from nqr_geom.integrator.learn.inet import UniformWeights
from nqr_geom.integrator.problem import Problem, Samples
from nqr_geom.integrator.rules import Rule
from nqr_geom.integrator.samplers import Sampler
from nqr_geom.streams import Stream

Floats = NDArray[np.float64]
Pair = tuple[str, str]  # sampler, rule

N = 32
SEED = 0
PLAIN: Pair = ("random", "mc")
DESIGNS = ("random", "stratified")
CLASSICAL = ("mc", "trapezoid", "regression-3", "regression-5")
# Structure-aware rule, network on it, network on the uniform base, and one there that is told the first one's weights.
LEARNED = {"toy": ("toy-hermite", "inet-toy-structured", "inet-toy-uniform", "inet-toy-told"),
           "gwn": ("gwn-hermite", "inet-gwn-structured", "inet-gwn-uniform")}  # fmt: skip
# Pairs of the paper's form beside a pair on a structured sampler.
UNIFORM_PAIRS = {"toy": ("toy-nqr-uniform",)}
# Small networks that stand for them in compiled code.
STUDENTS = {"gwn": ("inet-gwn-student", "inet-gwn-student-uniform")}


def trained_sampler(problem: str) -> Pair | None:
    """Sampler and rule of the problem's `method="nqr"`, or None while there is none."""
    return registry.method("nqr", problem) if f"{problem}:nqr" in registry.ALIASES else None


def base_of(rule: str, design: str = "random") -> str | None:
    """The rule that a network corrects, None for what is no network.

    The uniform base is "mc" on uniform points and, as no registry knows it, "uniform" (W = 1) elsewhere.
    """
    from nqr_geom import recipes

    pairs = {name: pair.rule for name, pair in getattr(recipes, "JOINT", {}).items()}
    recipe = (recipes.RECIPES | pairs).get(rule.removeprefix("inet-"))
    if recipe is None or not rule.startswith("inet-"):
        return None
    return "mc" if recipe.base == "uniform" and design in DESIGNS else recipe.base


def rule_named(name: str) -> Rule:
    """A rule of the registry, or W = 1."""
    rule: Rule = UniformWeights() if name == "uniform" else registry.make("rule", name)
    return rule


def pairs_for(problem: str, classical: Sequence[str] = CLASSICAL, designs: Sequence[str] = DESIGNS) -> list[Pair]:
    """Every rule on fixed designs, the structured method and networks that learned on its samples, and the trained
    sampler under every rule that can count."""
    from nqr_geom.recipes import RECIPES

    rules = (*classical, *LEARNED[problem], *STUDENTS.get(problem, ()))
    pairs = [(design, rule) for design in designs for rule in rules]
    place, rule = registry.method("structured", problem)
    pairs.append((place, rule))
    networks = [name for name in LEARNED[problem] if name.startswith("inet-")]
    pairs += [(place, name) for name in networks if place in RECIPES[name.removeprefix("inet-")].designs]
    joint = trained_sampler(problem)
    if joint is not None:
        base = base_of(*joint[::-1])
        weighing = dict.fromkeys((base or LEARNED[problem][0], LEARNED[problem][0], joint[1], LEARNED[problem][2]))
        pairs += [(joint[0], rule) for rule in weighing]
    for name in UNIFORM_PAIRS.get(problem, ()):
        pairs += [(f"snet-{name}", rule) for rule in ("uniform", LEARNED[problem][0], f"inet-{name}")]
    return pairs


@dataclass(frozen=True)
class Errors:
    """What a pair did on a problem.

    Parameters
    ----------
    deviations : ndarray, (B, R)
        Estimate minus truth, for R seeds.
    fallback : float
        Share of integrals that were flagged.
    microseconds : float
        Of the fastest run, an integral.
    """

    deviations: Floats
    fallback: float
    microseconds: float

    @property
    def squared(self) -> Floats:
        """Squared errors, (B, R)."""
        return self.deviations**2


@dataclass
class Remembered(Sampler):
    """A trained sampler that draws once for all rules: it takes far longer than they do.

    Parameters
    ----------
    inner : Sampler
        What draws.
    kept : dict
        Samples by integrals, number and stream, with the seconds that they took.
    spent : float
        Seconds of drawing that remembering has saved.
    """

    inner: Sampler
    kept: dict[tuple[int, ...], tuple[Samples, float]] = field(default_factory=dict)
    spent: float = 0.0

    def draw(self, problem: Problem, n: int, stream: Stream) -> Samples:
        key = (stream.key, n, *problem.rows.tolist())
        if key in self.kept:
            samples, seconds = self.kept[key]
            self.spent += seconds
            return samples
        start = time.perf_counter()
        samples = self.inner.draw(problem, n, stream)
        self.kept[key] = samples, time.perf_counter() - start
        return samples


def errors_of(
    problem: Problem, pair: Pair, runs: int = 1, n: int = N, seed: int = SEED, sampler: Sampler | None = None
) -> Errors:
    """Run a pair `runs` times, with seeds from `seed` on; `sampler` may be the pair's, remembered."""
    truth = problem.reference()
    assert truth is not None
    place = sampler or registry.make("sampler", pair[0])
    rule = rule_named(pair[1])
    parts, seconds = [], []
    for r in range(runs):
        before = getattr(place, "spent", 0.0)
        parts.append(run(problem, place, rule, n, seed=seed + r))
        seconds.append(parts[-1].seconds + getattr(place, "spent", 0.0) - before)
    return Errors(
        np.concatenate([part.value - truth for part in parts], axis=1),
        float(np.mean([part.fallback.mean() for part in parts])),
        1e6 * min(seconds) / problem.batch,
    )


def rows_of(
    label: str,
    problem: Problem,
    pairs: Sequence[Pair],
    runs: int = 1,
    n: int = N,
    *,
    repeated: bool = False,
    shapes: bool = False,
) -> list[dict[str, Any]]:
    """One row for each pair that fits, with its ratio to Monte Carlo and, for a network, to its own base.

    Ratios are of means, with 95% bootstrap intervals over the problem's groups. Where the batch is one integral
    `repeated`, the variance around the mean estimate is told too; with `shapes`, every group's mean squared error.
    """
    groups = problem.groups
    bootstrap = Bootstrap.of(groups, runs, SEED)
    fits = (p for p in dict.fromkeys((PLAIN, *pairs)) if p[1] == "uniform" or refusal(problem, *p, n) is None)
    chosen = list(fits)
    samplers = {design: registry.make("sampler", design) for design, _ in chosen}
    joint = trained_sampler(problem.name)
    if joint is not None and joint[0] in samplers:
        samplers[joint[0]] = Remembered(samplers[joint[0]])
    found = {pair: errors_of(problem, pair, runs, n, sampler=samplers[pair[0]]) for pair in chosen}
    plain = found[PLAIN].squared
    rows = []
    for pair in chosen:
        e = found[pair].squared
        row = {
            "problem": label,
            "design": pair[0],
            "rule": pair[1],
            "n": n,
            "mse": float(e.mean()),
            "mse_error": bootstrap.standard_error(e),
            "median": float(np.median(e)),
            "p99": float(np.quantile(e, 0.99)),
            "ratio": float(plain.mean() / e.mean()),
            "ratio_interval": bootstrap.ratio(plain, e),
            "fallback": found[pair].fallback,
            "microseconds": found[pair].microseconds,
        }
        if repeated:
            row["variance"] = float(found[pair].deviations.var())
        if shapes:
            row["by_shape"] = [float(e[groups == shape].mean()) for shape in np.unique(groups)]
        base = base_of(pair[1], pair[0])
        if base is not None and (pair[0], base) in found:
            under = found[pair[0], base].squared
            row |= {"base": base, "gain": float(under.mean() / e.mean()), "gain_interval": bootstrap.ratio(under, e)}
        rows.append(row)
    return rows


def show(title: str, rows: list[dict[str, Any]]) -> None:
    """Print rows as a table."""
    head = ("problem", "samples", "rule", "MSE", "median", "p99", "x MC", "95%", "x own base", "95%")
    table = Table(*head, title=title)
    for row in rows:
        gain = [f"{row['gain']:.3g}", span(row["gain_interval"])] if "gain" in row else ["", ""]
        table.add_row(
            row["problem"],
            row["design"],
            row["rule"],
            *(f"{row[key]:.2e}" for key in ("mse", "median", "p99")),
            f"{row['ratio']:.3g}",
            span(row["ratio_interval"]),
            *gain,
        )
    Console(width=150).print(table)


def span(interval: tuple[float, float] | None) -> str:
    """An interval for people."""
    return "unbounded" if interval is None else f"{interval[0]:.3g} .. {interval[1]:.3g}"
