"""Every figure that this project set out to reach, beside what its benchmarks have measured: docs/targets.md.

`python benchmarks/tables.py` writes the page. What is missed stands there as well as what is reached.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

from page import Row, markdown, short

__all__ = ["TARGETS", "Target", "page"]

Values = Sequence[float]


@dataclass(frozen=True)
class Target:
    """One figure to reach.

    Parameters
    ----------
    about, goal : str
        What is measured, and what it should be.
    benchmark : str
        Script that measures it.
    found : callable
        Its rows to the values, none if it has not measured them.
    met : callable
        Whether a value is as it should be.
    """

    about: str
    goal: str
    benchmark: str
    found: Callable[[list[Row]], Values]
    met: Callable[[float], bool]


def of(key: str, **where: object) -> Callable[[list[Row]], Values]:
    """The values under `key` of all rows that agree; a wanted value may be a test."""

    def found(rows: list[Row]) -> Values:
        return [row[key] for row in rows if row.get(key) is not None and all(_is(row, *want) for want in where.items())]

    return found


def _is(row: Row, name: str, want: object) -> bool:
    have = row.get(name)
    return want(have) if callable(want) else have == want


def quotient(key: str, above: dict[str, object], below: dict[str, object]) -> Callable[[list[Row]], Values]:
    """How many times larger a value is in one row than in another."""

    def found(rows: list[Row]) -> Values:
        upper, lower = (of(key, **where)(rows) for where in (above, below))
        return [a / b for a, b in zip(upper, lower, strict=True)]

    return found


def any_of(*names: str) -> Callable[[object], bool]:
    return lambda have: have in names


def starts(*names: str) -> Callable[[object], bool]:
    return lambda have: isinstance(have, str) and have.startswith(names)


def _least(goal: float) -> tuple[str, Callable[[float], bool]]:
    return f"{goal:,g} or more", lambda value: value >= goal


def _most(goal: float) -> tuple[str, Callable[[float], bool]]:
    return f"{goal:,g} or less", lambda value: value <= goal


def _near(goal: float, part: float = 0.3) -> tuple[str, Callable[[float], bool]]:
    return f"{goal:g}, {part:.0%} off at most", lambda value: abs(value / goal - 1.0) <= part


def _within(low: float, high: float) -> tuple[str, Callable[[float], bool]]:
    return f"{low:g} to {high:g}", lambda value: low <= value <= high


def target(
    about: str,
    goal: tuple[str, Callable[[float], bool]],
    benchmark: str,
    found: Callable[[list[Row]], Values],
) -> Target:
    return Target(about, goal[0], benchmark, found, goal[1])


def _off(key: str = "ratio_off", **where: object) -> Callable[[list[Row]], Values]:
    values = of(key, **where)
    return lambda rows: [max((abs(v) for v in values(rows)), default=0.0)]


_OUTSIDE = ("laplace, letter", "laplace, comb", "laplace, coast")
_BANDS = {"X": (0.9, 4.4), "f'": (0.25, 0.9), "I": (0.5, 1.1)}
_LARGEST = {"resolution": 128, "n": 32}

_EQUAL_SAMPLES = (
    target("toy, nine baseline rows of the paper, largest part off", _most(0.3), "toy_calibration", _off("off")),
    target("toy, INet on random samples", _least(25), "learned",
           of("ratio", problem="toy", design="random", rule="inet-toy-structured")),
    target("toy, INet on random samples, uniform base", _least(25), "learned",
           of("ratio", problem="toy", design="random", rule="inet-toy-uniform")),
    target("the same, told what the structured rule would have samples count", _least(25), "learned",
           of("ratio", problem="toy", design="random", rule="inet-toy-told")),
    target("toy, INet on stratified samples", _least(70), "learned",
           of("ratio", problem="toy", design="stratified", rule="inet-toy-structured")),
    target("toy, SNet + INet", _least(4000), "learned",
           lambda rows: [max(of("ratio", problem="toy", design=starts("snet-toy"), rule=starts("inet-"))(rows))]),
    target("toy, structured rule with its own sampler", _least(4000), "toy_methods",
           of("ratio", method="structured", n=32)),
    target("Fig. 10: INet from x and f alone, times better than the trapezoid", _least(1), "toy_ablation",
           quotient("mse", {"problem": "held-out integrands", "rule": "trapezoid"},
                    {"problem": "held-out integrands", "rule": "weights from x and f alone"})),
    target("Fig. 8: weights, times better than values", _least(1), "toy_ablation",
           quotient("mse", {"problem": "held-out integrands", "rule": "values"},
                    {"problem": "held-out integrands", "rule": "weights"})),
    *(
        target(f"Table 8: error over Monte Carlo's with {name} randomised, five integrands", _within(*band),
               "toy_inputs", of("times_mc", randomised=name, problem=any_of(*"12345")))
        for name, band in _BANDS.items()
    ),
    target("gwn, squared error of Monte Carlo", _near(0.34), "gwn_methods",
           of("mse", problem="gwn, family", method="mc", n=32)),
    target("gwn, squared error of stratified samples, median over shapes", _near(0.23), "gwn_methods",
           of("mse", problem="gwn, family", method="stratified, median over shapes")),
    target("gwn, INet on random samples", _least(25), "learned",
           of("ratio", problem="gwn", design="random", rule="inet-gwn-structured")),
    target("gwn, INet on random samples, uniform base", _least(25), "learned",
           of("ratio", problem="gwn", design="random", rule="inet-gwn-uniform")),
    target("gwn, INet on stratified samples, uniform base", _least(100), "learned",
           of("ratio", problem="gwn", design="stratified", rule="inet-gwn-uniform")),
    target("gwn, SNet + INet", _least(500), "learned",
           of("ratio", problem="gwn", design="snet-gwn-nqr", rule="inet-gwn-nqr")),
    target("gwn, structured, black-box quadratics: share within 1e-10", _least(0.999), "gwn_methods",
           of("right", problem="gwn, black-box quadratics")),
    target("gwn, structured, Lissajous and Fourier curves", _least(300), "gwn_methods",
           of("ratio", problem="gwn, Lissajous and Fourier", method="structured")),
    target("Fig. 25: INet on stratified samples outside the family, in parts, five shapes", _least(20), "gwn_outside",
           of("ratio", strategy="decomp", design="stratified", rule="inet-gwn-uniform")),
    target("sd, SNet + INet", _least(30), "sd_methods", of("ratio", design="snet-sd-nqr", rule="inet-sd-nqr", n=32)),
    target("sd, INet, squared bias", _least(10), "sd_methods",
           of("ratio", design="stratified", rule="inet-sd-uniform", runs=256)),
    target("transmittance, rows of Table 12, largest part off", _most(0.3), "transmittance", _off(set="clouds")),
    target("transmittance, INet", _least(80), "learned_transmittance",
           of("ratio", set="clouds", design="uniform-jitter", rule="inet-transmittance-uniform", support="bounds")),
    *(
        target(f"transmittance, SNet + INet, {name}", _least(goal), "learned_transmittance",
               of("ratio", set=name, design="snet-transmittance-nqr", rule="inet-transmittance-nqr", support="bounds"))
        for name, goal in (("clouds", 350), ("donut", 515), ("letters", 134))
    ),
    target("transmittance, INet on letters, times better than stratified", _least(1), "learned_transmittance",
           quotient("mse", {"set": "letters", "design": "uniform-jitter", "rule": "mc", "support": "bounds"},
                    {"set": "letters", "design": "uniform-jitter", "rule": "inet-transmittance-uniform",
                     "support": "bounds"})),
    target("WoS, Latin hypercube", _near(1.5), "wos_baselines", of("ratio", method="latin-hypercube")),
    target("WoS, trapezoid over sorted walks", _near(1.1), "wos_baselines", of("ratio", method="trapezoid")),
    target("WoS, INet on random walks", _least(15), "learned_walks",
           of("ratio", problem="laplace", design="random", rule="inet-laplace-uniform")),
    target("WoS, INet on Latin hypercube walks", _least(20), "learned_walks",
           of("ratio", problem="laplace", design="latin-hypercube", rule="inet-laplace-uniform")),
    target("WoS, SNet + INet", _least(40), "learned_walks",
           of("ratio", problem="laplace", design="snet-laplace-nqr", rule="inet-laplace-nqr")),
    target("WoS, structured", _least(15), "learned_walks",
           of("ratio", problem="laplace", design="walk-spread", rule="walk-fit")),
    target("Fig. 33: structured on 107, 96 and 286 edges", _least(5), "learned_walks",
           of("ratio", problem=any_of(*_OUTSIDE), design="walk-spread", rule="walk-fit")),
    target("Fig. 33: INet on 107, 96 and 286 edges", _least(5), "learned_walks",
           of("ratio", problem=any_of(*_OUTSIDE), design="walk-spread", rule="inet-laplace-spread")),
    target("Fig. 50: p = 3, times better than the exact solution for p = 2", _least(20), "p_walks",
           of("ratio", polygons=starts("bent"), rule="inet-p-laplace")),
    target("direct light, stratified passes", _near(4.1), "direct_light", of("ratio", method="MC stratified")),
    target("direct light, regression on random passes", _near(0.34), "direct_light", of("ratio", method="Poly random")),
    target("direct light, regression on stratified passes", _near(0.45), "direct_light",
           of("ratio", method="Poly stratified")),
    target("direct light, INet on random passes", _least(10), "direct_light", of("ratio", method="INet random")),
    target("direct light, INet on stratified passes", _least(17), "direct_light",
           of("ratio", method="INet stratified")),
    target("direct light, SNet + INet", _least(30), "direct_light", of("ratio", method="SNet + INet")),
    *(
        target(f"direct light, best network on the scene like {name}", _least(goal), "direct_light",
               lambda rows, name=name: [max(of(f"{name}, x", method=starts("INet", "SNet"))(rows), default=0.0)])
        for name, goal in (("teaser", 15), ("white-room", 10.6), ("living-room", 24), ("staircase", 5.7))
    ),
    target("direct light, INet on plates and lights, times better than stratified", _least(1), "direct_light",
           quotient("plates", {"method": "MC stratified"}, {"method": "INet stratified"})),
)  # fmt: skip

_TIME = (
    *(
        target(f"gwn, {label}", _most(goal), "gwn_time", of("times_mc", method=method, **_LARGEST))
        for label, method, goal in (
            ("structured", "structured", 5),
            ("distilled student", "stratified+inet-gwn-student", 20),
            ("INet, structured base", "stratified+inet-gwn-structured", 150),
            ("INet, uniform base", "stratified+inet-gwn-uniform", 150),
        )
    ),
    target(
        "gwn, SNet + INet", _most(1000), "snet_time", of("times_mc", method="SNet + INet, compiled", resolution=128)
    ),
    *(
        target(f"WoS, {label}", _most(goal), "walks_time", of("times_mc", method=method, **_LARGEST))
        for label, method, goal in (
            ("structured", "structured", 3),
            ("walk-fit on Latin hypercube walks", "walk-fit on LHS", 3),
            ("INet on Latin hypercube walks", "INet on LHS", 3),
            ("INet", "inet", 3),
            ("SNet + INet", "nqr", 20),
        )
    ),
    *(
        target(
            f"direct light, 16 passes, {label}, two scenes",
            _most(goal),
            "direct_time",
            of("times_mc", method=method, resolution=128, n=16),
        )
        for label, method, goal in (("structured", "structured", 2), ("INet", "inet", 8), ("SNet + INet", "nqr", 20))
    ),
)

_IN_TIME = tuple(
    target(f"{name}: its squared error over the best other's within the time of 4, 8 .. 256 samples (0: none fits)",
           _least(goal), "equal_time", of("ratio", application=name, kind="equal time"))
    for name, goal in (("toy", 10), ("gwn", 10), ("sd", 10), ("laplace", 1), ("transmittance", 1), ("direct", 1))
)  # fmt: skip

_EXACT = (
    target("winding numbers of 10,000 segments, times faster than libigl: star, spiral, zigzag", _least(100),
           "exact_gwn", of("ratio", case=lambda case: case.endswith("10,000 segments"))),
    target("winding numbers of 100 segments, times faster than libigl", _least(1), "exact_gwn",
           of("ratio", case="star, 100 segments")),
    target("their largest difference from libigl's", _most(1e-12), "exact_gwn",
           lambda rows: [max(of("largest_difference")(rows))]),
    target("closest points, times libigl's speed, eight shapes", _least(0.5), "exact_distance", of("ratio")),
    target("boundary solver, 19 edges, seconds", _most(1), "boundary_solver",
           of("seconds", case=starts("star of 19", "L-shape", "jump"))),
    target("boundary solver, 19 edges, largest error", _most(1e-8), "boundary_solver",
           of("error", case=starts("star of 19", "L-shape", "jump"))),
    target("boundary solver, 300 edges, seconds", _most(20), "boundary_solver",
           of("seconds", case=starts("star of 300"))),
    target("boundary solver, 300 edges, largest error", _most(1e-6), "boundary_solver",
           of("error", case=starts("star of 300"))),
    target("p-Laplacian, order of P1 in L2, p from 1.2 to 10", _within(1.9, 2.1), "fem_orders",
           lambda rows: [row["observed_orders"][-1] for row in rows
                         if row["order_of_elements"] == 1 and 1.2 <= row["p"] <= 10.0]),
    target("million walks a second over zombie's, one thread, 19 and 286 edges", _least(1), "wos_speed",
           lambda rows: [r["million_walks_a_second"] / r["zombie"] for r in rows]),
    target("direct light, times faster than Mitsuba 3, five scenes", _least(1), "mitsuba_direct", of("ratio")),
)  # fmt: skip

_PLANS = (
    target("answers within a tolerance that was said to be met, least share of any application", _least(0.95),
           "planner", of("within")),
    target("cost over the cheapest fixed method's, median over applications and tolerances", _most(2), "planner",
           lambda rows: [median(of("cost")(rows))]),
)  # fmt: skip

TARGETS: dict[str, tuple[Target, ...]] = {
    "Squared error of Monte Carlo over the method's at equal samples, held-out problems": _EQUAL_SAMPLES,
    "Time over Monte Carlo's, 128 x 128, 32 samples where nothing else is said": _TIME,
    "In equal processor time, against the best classical rule": _IN_TIME,
    "Exact answers and speed": _EXACT,
    "Plans by tolerance": _PLANS,
}


def page(rows_of: Callable[[str], list[Row] | None]) -> str:
    """The page, from the rows of every benchmark, None where it has not been run."""
    parts = [
        "# Targets\n\nWhat this project set out to reach, and what its benchmarks measured. Several values are several "
        "problems, shapes or methods; a target is reached where all of them are as they should be. This page is "
        "written by `benchmarks/tables.py`.\n"
    ]
    for title, targets in TARGETS.items():
        lines = []
        for one in targets:
            rows = rows_of(one.benchmark)
            values = [] if rows is None else list(one.found(rows))
            told = ", ".join(short(value) for value in _few(values)) or "not measured"
            reached = "yes" if values and all(one.met(value) for value in values) else "no"
            lines.append([one.about, one.goal, told, reached, f"`python benchmarks/{one.benchmark}.py`"])
        parts.append(f"\n**{title}**\n\n" + markdown(["", "goal", "measured", "reached", "command"], lines))
    return "".join(parts)


def _few(values: list[float]) -> list[float]:
    """The values, or the ends of a long list."""
    return values if len(values) <= 7 else [min(values), max(values)]
