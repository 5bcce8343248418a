"""What there is: every sampler, rule, problem and model by name, where it lives and what it can do.

This table imports nothing heavy. Property tests, documentation and the command line loop over it, so a new line here
is tested and documented the day it is added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

__all__ = ["ALIASES", "Entry", "entries", "entry", "make", "method"]


@dataclass(frozen=True)
class Entry:
    """One line of the registry.

    Parameters
    ----------
    name, summary : str
        What a user types, and one line of explanation.
    target : str
        "module:attribute" of the class or factory. A problem's class has ``family(n, seed=, split=)``: its random
        family with n shapes.
    options : dict
        Keyword arguments that make this entry of its class.
    exact : str
        What a rule integrates exactly, on points of a sampler it accepts: "nothing", "constants", "degree k",
        "degree 2N-1", "control" (its control variate) or the name of a family.
    linear : bool
        Whether the estimate is linear in the values.
    dims : str
        "any", or the only number of dimensions.
    needs : str
        What samples must bring: "pdf", "strata", "halves", "control", "techniques", "nodes", the name of the
        only problem that brings it, "curves" for either problem on curves, or "".
    adaptive : bool
        Whether a sampler looks at values before it places the next point.
    pieces : int
        Pieces of a curve that a rule can take at most; 0 is any number. The public functions cut longer curves.
    """

    name: str
    target: str
    summary: str
    options: dict[str, Any] = field(default_factory=dict)
    exact: str = "nothing"
    linear: bool = True
    dims: str = "any"
    needs: str = ""
    adaptive: bool = False
    pieces: int = 0

    def load(self) -> Callable[..., Any]:
        """The class or factory behind the entry."""
        module, attribute = self.target.split(":")
        target: Callable[..., Any] = getattr(import_module(module), attribute)
        return target


_SAMPLERS = "nqr_geom.integrator.samplers:"
_RULES = "nqr_geom.integrator.rules:"
_CURVES = "nqr_geom.curves."
_TOY = "nqr_geom.toy."
_RENDER = "nqr_geom.render."

_RECIPES = "nqr_geom.recipes:"

# Trained models: recipe, problem, summary. Each is also the rule "inet-" + its name.
_MODELS = (
    ("toy-uniform", "toy", "network that corrects plain weights on piecewise smooth functions"),
    ("toy-structured", "toy", "small network that shifts what toy-hermite leaves open"),
    ("toy-told", "toy", "small network that corrects plain weights and is told those of toy-hermite"),
    ("gwn-uniform", "gwn", "network that corrects plain weights on curves"),
    ("gwn-structured", "gwn", "network that guesses what gwn-hermite has not seen"),
    ("gwn-student", "gwn", "small network for what gwn-hermite has not seen, compiled with it"),
    ("gwn-student-uniform", "gwn", "small network that corrects plain weights on curves, compiled"),
    ("sd-uniform", "sd", "network that corrects plain weights on smoothed distances"),
    ("transmittance-uniform", "transmittance", "network that corrects plain ray marching through clouds"),
    ("direct-mis", "direct", "small network that corrects the balance heuristic of direct light, compiled"),
    ("laplace-uniform", "laplace", "network that corrects plain weights of walks on spheres"),
    ("laplace-spread", "laplace", "network that weighs walks which avoid each other"),
    ("p-laplace", "laplace", "network that bends inet-laplace-uniform to p = 3"),
    ("p-laplace-range", "p-laplace", "network that bends inet-laplace-uniform to p from 1.5 to 6"),
)
# Pairs that were trained together: also the sampler "snet-" + name and the rule "inet-" + name.
_PAIRS = (
    ("gwn-nqr", "gwn", "samples placed by a network on curves, and the network that weighs them"),
    ("sd-nqr", "sd", "samples placed by a network for smoothed distances, and the network that weighs them"),
    ("transmittance-nqr", "transmittance", "samples placed by a network along rays, and the network on clamped-noise"),
    ("laplace-nqr", "laplace", "walks directed by a network step by step, and the network that weighs them"),
    ("direct-nqr", "direct", "passes placed by a network in rounds, and the network that weighs them"),
    ("toy-nqr", "toy", "samples placed by a network beside breaks, and the network on toy-hermite"),
    ("toy-nqr-uniform", "toy", "samples placed by a network that began uniform, and the network that weighs them"),
)
_DIMS = {"laplace": "12", "p-laplace": "12", "direct": "any"}  # of what networks know; else one


_TABLE: dict[str, tuple[Entry, ...]] = {
    "sampler": (
        Entry("random", _SAMPLERS + "Random", "independent uniform points"),
        Entry("stratified", _SAMPLERS + "Stratified", "one uniform point in each of n equal cells"),
        Entry("uniform-jitter", _SAMPLERS + "UniformJitter", "the same random place in each of n equal cells"),
        Entry("jitter-pair", _SAMPLERS + "JitterPair", "two independent uniformly jittered halves", dims="1"),
        Entry("grid", _SAMPLERS + "Grid", "centres of n equal cells"),
        Entry("gauss-legendre", _SAMPLERS + "GaussLegendreNodes", "nodes of the Gauss-Legendre rule"),
        Entry("sobol", _SAMPLERS + "Sobol", "Sobol' points, Owen-scrambled"),
        Entry("latin-hypercube", _SAMPLERS + "LatinHypercube", "every axis cut into n strata, each hit once"),
        Entry("pmj", _SAMPLERS + "Pmj", "progressive multi-jittered (0,2) points in pairs of axes"),
        Entry(
            "bayesian-quadrature",
            _SAMPLERS + "BayesianDesign",
            "next point where a Gaussian process is least certain",
            dims="1",
        ),
        Entry(
            "array-rqmc",
            "nqr_geom.integrator.array_rqmc:ArrayRqmc",
            "walks sorted before every step, neighbours sent in different directions",
            needs="laplace",
            adaptive=True,
        ),
        Entry(
            "walk-spread",
            "nqr_geom.wos.spread:WalkSpread",
            "walks one after the other, towards boundary that those before have not met",
            needs="laplace",
            adaptive=True,
        ),
        Entry(
            "walk-spread-full",
            "nqr_geom.wos.spread:FullWalkSpread",
            "the same with every step directed, by finer sectors",
            needs="laplace",
            adaptive=True,
        ),
        Entry(
            "curve-refine",
            _CURVES + "structured:CurveRefine",
            "piece ends and middles, then the gap that matters most to the query",
            dims="1",
            needs="curves",
            adaptive=True,
        ),
        Entry(
            "toy-split",
            _TOY + "split:ToySplit",
            "a few stratified points, then bisection of the worst gap",
            dims="1",
            needs="toy",
            adaptive=True,
        ),
        Entry(
            "noise-refine",
            _RENDER + "clamped:NoiseRefine",
            "a few jittered points, then the gaps whose density is least certain",
            dims="1",
            needs="transmittance",
            adaptive=True,
        ),
        Entry(
            "lamp-spread",
            _RENDER + "direct_sampler:LampSpread",
            "light samples shared out by what each lamp can bring, then by whether it is seen",
            needs="direct",
            adaptive=True,
        ),
        *(
            Entry(
                f"snet-{name}",
                _RECIPES + "sampler",
                summary,
                {"name": name},
                dims=_DIMS.get(problem, "1"),
                needs=problem,
                adaptive=True,
            )
            for name, problem, summary in _PAIRS
        ),
    ),
    "rule": (
        Entry("mc", _RULES + "MonteCarlo", "mean of f/pdf", exact="constants", needs="pdf"),
        Entry(
            "trapezoid",
            _RULES + "Trapezoid",
            "interval lengths; the same as the rectangle rule",
            exact="constants",
            dims="1",
        ),
        Entry("rectangle", _RULES + "Trapezoid", "the trapezoid's other name", exact="constants", dims="1"),
        Entry(
            "simpson",
            _RULES + "Simpson",
            "parabolas over pairs of similar steps",
            exact="constants",
            dims="1",
        ),
        Entry(
            "gauss-legendre",
            _RULES + "GaussLegendre",
            "Gauss-Legendre weights for their nodes",
            exact="degree 2N-1",
            needs="nodes",
        ),
        *(
            Entry(
                f"regression-{degree}",
                _RULES + "Regression",
                f"least-squares polynomial of degree {degree} as control variate",
                options={"degree": degree},
                exact=f"degree {degree}",
                needs="pdf",
            )
            for degree in (1, 3, 5)
        ),
        Entry("bayesian-quadrature", _RULES + "BayesianQuadrature", "posterior mean under a Gaussian process"),
        Entry(
            "stratification",
            _RULES + "Stratification",
            "strata by their volume",
            exact="constants",
            needs="strata",
        ),
        Entry(
            "difference-cv",
            _RULES + "DifferenceControlVariate",
            "exact integral of h plus mean of f - h",
            exact="control",
            needs="control",
        ),
        Entry(
            "ratio-cv",
            _RULES + "RatioControlVariate",
            "mean of f over mean of h, times the integral of h",
            exact="control",
            needs="control",
        ),
        Entry(
            "toy-hermite",
            _TOY + "structured:ToyHermite",
            "exact inside smooth pieces, posterior mean over hidden breaks",
            exact="constants",
            linear=False,
            dims="1",
            needs="toy",
        ),
        Entry(
            "walk-fit",
            "nqr_geom.wos.structured:WalkFit",
            "mean under the harmonic measure of the boundary that the walks have seen",
            exact="constants",
            linear=False,
            needs="laplace",
        ),
        Entry(
            "balance-heuristic",
            _RULES + "BalanceHeuristic",
            "multiple importance sampling",
            needs="techniques",
        ),
        Entry(
            "jackknife",
            _RENDER + "jackknife:Jackknife",
            "two independent depths whose exponentials' bias cancels",
            exact="constants",
            linear=False,
            dims="1",
            needs="halves",
        ),
        Entry(
            "clamped-noise",
            _RENDER + "clamped:ClampedNoise",
            "expected depth of clamped noise on a known shape",
            linear=False,
            dims="1",
            needs="transmittance",
        ),
        Entry(
            "direct-regression-1",
            _RENDER + "direct_rules:TechniqueRegression",
            "regression for each technique of direct light apart",
            options={"degree": 1},
            needs="direct",
        ),
        Entry(
            "direct-unhidden",
            _RENDER + "direct_rules:UnhiddenLight",
            "diffuse light in closed form, its visibility sampled",
            needs="direct",
        ),
        Entry(
            "direct-known",
            _RENDER + "direct_rules:KnownLight",
            "all light as it would be if nothing hid it, its visibility sampled",
            needs="direct",
        ),
        Entry(
            "gwn-hermite",
            _CURVES + "structured:GwnHermite",
            "exact winding number of the curve rebuilt by Hermite cubics",
            exact="quadratic pieces",
            linear=False,
            dims="1",
            needs="gwn",
        ),
        Entry(
            "sd-hermite",
            _CURVES + "structured:SdHermite",
            "smoothed distance of the curve rebuilt by Hermite cubics",
            exact="quadratic pieces",
            linear=False,
            dims="1",
            needs="sd",
        ),
        *(
            Entry(
                f"inet-{name}",
                _RECIPES + "model",
                summary,
                {"name": name},
                linear=False,
                dims=_DIMS.get(problem, "1"),
                needs=problem,
                pieces=6 if problem in ("gwn", "sd") else 0,
            )
            for name, problem, summary in _MODELS + _PAIRS
        ),
    ),
    "problem": (
        Entry("toy", _TOY + "problem:ToyProblem", "piecewise smooth functions with hidden breaks", dims="1"),
        Entry("gwn", _CURVES + "problems:GwnProblem", "generalised winding number of a curve", dims="1"),
        Entry("sd", _CURVES + "problems:SdProblem", "smoothed distance to a curve", dims="1"),
        Entry("laplace", "nqr_geom.wos.problems:LaplaceProblem", "harmonic function by walks on spheres"),
        Entry("transmittance", _RENDER + "problems:TransmittanceProblem", "light through a volume", dims="1"),
        Entry("direct", _RENDER + "direct_problem:DirectProblem", "light of spheres that surfaces reflect"),
    ),
    "model": tuple(
        Entry(
            name,
            _RECIPES + "model",
            summary,
            options={"name": name},
            linear=False,
            dims=_DIMS.get(problem, "1"),
            needs=problem,
        )
        for name, problem, summary in _MODELS + _PAIRS
    ),
}

# A method is "sampler+rule"; these are the short names. "structured" and the learned ones depend on the problem.
ALIASES: dict[str, str] = {
    "direct:random": "random+balance-heuristic",
    "direct:regression": "pmj+direct-regression-1",
    "direct:inet": "lamp-spread+inet-direct-mis",
    "direct:nqr": "snet-direct-nqr+inet-direct-nqr",
    "direct:structured": "lamp-spread+direct-known",
    "transmittance:random": "random+mc",
    "transmittance:stratified": "uniform-jitter+mc",
    "transmittance:trapezoid": "uniform-jitter+trapezoid",
    "transmittance:regression": "uniform-jitter+regression-3",
    "transmittance:jackknife": "jitter-pair+jackknife",
    "transmittance:structured": "noise-refine+clamped-noise",
    "transmittance:inet": "uniform-jitter+inet-transmittance-uniform",
    "transmittance:nqr": "snet-transmittance-nqr+inet-transmittance-nqr",
    "gwn:structured": "curve-refine+gwn-hermite",
    "sd:structured": "curve-refine+sd-hermite",
    "toy:structured": "toy-split+toy-hermite",
    "laplace:structured": "walk-spread+walk-fit",
    "laplace:wos-rqmc": "array-rqmc+mc",
    "laplace:wos-lhs": "latin-hypercube+mc",
    "laplace:inet": "walk-spread+inet-laplace-spread",
    "laplace:nqr": "snet-laplace-nqr+inet-laplace-nqr",
    "toy:inet": "stratified+inet-toy-structured",
    "gwn:inet": "stratified+inet-gwn-structured",
    "gwn:student": "stratified+inet-gwn-student",
    "gwn:nqr": "snet-gwn-nqr+inet-gwn-nqr",
    "sd:nqr": "snet-sd-nqr+inet-sd-nqr",
    "toy:nqr": "snet-toy-nqr+inet-toy-nqr",
    "sd:inet": "stratified+inet-sd-uniform",
    "mc": "random+mc",
    "stratified": "stratified+mc",
    "trapezoid": "stratified+trapezoid",
    "simpson": "grid+simpson",
    "gauss-legendre": "gauss-legendre+gauss-legendre",
    "bayesian-quadrature": "bayesian-quadrature+bayesian-quadrature",
    "mis": "pmj+balance-heuristic",
}


def entries(kind: str) -> tuple[Entry, ...]:
    """All entries of a kind: "sampler", "rule", "problem" or "model".

    Examples
    --------
    >>> [entry.name for entry in entries("sampler")][:2]
    ['random', 'stratified']
    """
    if kind not in _TABLE:
        raise ValueError(f"kind: expected one of {', '.join(_TABLE)}, got {kind!r}")
    return _TABLE[kind]


def entry(kind: str, name: str) -> Entry:
    """The entry called `name`, or an error that lists what there is.

    Examples
    --------
    >>> entry("rule", "simpson").dims
    '1'
    """
    for candidate in entries(kind):
        if candidate.name == name:
            return candidate
    raise ValueError(f"{kind}: expected one of {', '.join(e.name for e in entries(kind))}, got {name!r}")


def make(kind: str, name: str) -> Any:
    """Build the sampler, rule or model called `name`.

    Examples
    --------
    >>> make("rule", "regression-3").degree
    3
    """
    found = entry(kind, name)
    return found.load()(**found.options)


def method(name: str, problem: str = "") -> tuple[str, str]:
    """Sampler and rule names of a method: an alias, or "sampler+rule".

    Parameters
    ----------
    name : str
        "mc", "structured", "sobol+regression-3", ...
    problem : str
        Name of the problem; some aliases depend on it.

    Examples
    --------
    >>> method("trapezoid")
    ('stratified', 'trapezoid')
    """
    full = ALIASES.get(f"{problem}:{name}", ALIASES.get(name, name))
    sampler, plus, rule = full.partition("+")
    if not plus:
        aliases = [a.split(":")[-1] for a in ALIASES if ":" not in a or a.split(":")[0] == problem]
        raise ValueError(f"method: expected one of {', '.join(aliases)} or 'sampler+rule', got {name!r}")
    entry("sampler", sampler)
    entry("rule", rule)
    return sampler, rule
