"""Tables laid out like the paper's, for the toy family and winding numbers, with the pictures that belong to them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from page import NAMES, Row, markdown, picture, short, span

DOCS = Path(__file__).resolve().parents[1] / "docs"
FIXED = ("random", "stratified")
# Mean squared errors that the paper prints: Tables 1 and 2 (two runs of five integrands), and means over Table 11.
PAPER_TOY = {
    ("random", "mc"): 1.55e-2,
    ("random", "trapezoid"): 3.99e-3,
    ("random", "regression-3"): 1.30e-2,
    ("random", "regression-5"): 3.26e-2,
    ("random", "inet-toy-uniform"): 6.85e-4,
    ("stratified", "mc"): 1.20e-3,
    ("stratified", "trapezoid"): 9.52e-4,
    ("stratified", "regression-3"): 1.17e-3,
    ("stratified", "regression-5"): 1.16e-3,
    ("stratified", "inet-toy-uniform"): 2.74e-4,
}
PAPER_GWN = {
    ("random", "mc"): 0.337,
    ("stratified", "mc"): 0.352,
    ("stratified", "trapezoid"): 0.354,
    ("random", "inet-gwn-uniform"): 0.0221,
    ("stratified", "inet-gwn-uniform"): 5.52e-3,
}


def _find(rows: list[Row], **wanted: str | int) -> Row | None:
    """The first row with these entries."""
    return next((row for row in rows if all(row.get(key) == value for key, value in wanted.items())), None)


def _cell(row: Row | None, key: str = "mse") -> str:
    return "" if row is None or row.get(key) is None else short(row[key])


def _different(rows: list[Row], key: str) -> list[str]:
    return list(dict.fromkeys(row[key] for row in rows))


def _method(design: str, rule: str) -> str:
    return f"{NAMES.get(rule, rule)}, {design}"


def _pictures(names: Sequence[tuple[str, str]]) -> str:
    """Those of the pictures that have been drawn."""
    return "\n".join(picture(name, what) for name, what in names if (DOCS / name).exists()) + "\n"


def toy_tables(rows: list[Row]) -> str:
    """Tables 1, 2, 7 and 9: errors by integrand, then ratios, then the samplers that look before they place."""
    fixed = [row for row in rows if row["design"] in FIXED]
    rules = [rule for rule in NAMES if _find(fixed, rule=rule)]
    cases = _different(rows, "problem")
    lines = []
    for case in cases:
        for design in FIXED:
            found = [_find(rows, problem=case, design=design, rule=rule) for rule in rules]
            if not any(found):
                continue
            lines.append([f"{case}, {design}", *map(_cell, found)])
            if case.startswith("average"):
                told = [_cell(_find(rows, problem=case, design=design, rule=r), "variance") for r in rules]
                paper = [_cell({"mse": PAPER_TOY.get((design, rule))}) for rule in rules]
                lines += [[f"variance, {design}", *told], [f"the paper's average, {design}", *paper]]
    errors = markdown(["mean squared error", *(NAMES[rule] for rule in rules)], lines)
    ratios = []
    for case in (case for case in cases if not case.isdigit()):
        for design in FIXED:
            found = [_find(rows, problem=case, design=design, rule=rule) for rule in rules]
            if any(found):
                ratios.append([f"{case}, {design}", *(_cell(row, "ratio") for row in found)])
        if case == cases[-1]:
            for design in FIXED:
                found = [_find(rows, problem=case, design=design, rule=rule) for rule in rules]
                spans = [span(row.get("ratio_interval")) if row else "" for row in found]
                ratios.append([f"95%, {design}", *spans])
    gains = markdown(["x Monte Carlo, random", *(NAMES[rule] for rule in rules)], ratios)
    adaptive = [row for row in rows if row["design"] not in FIXED]
    pairs = list(dict.fromkeys((row["design"], row["rule"]) for row in adaptive))
    cases = [case for case in cases if _find(adaptive, problem=case)]
    looks = [
        [
            _method(*pair),
            *(_cell(_find(adaptive, problem=case, design=pair[0], rule=pair[1])) for case in cases),
            _cell(_find(adaptive, problem=cases[-1], design=pair[0], rule=pair[1]), "ratio"),
        ]
        for pair in pairs
    ]
    return errors + "\n" + gains + "\n" + markdown(["adaptive samples", *cases, "x Monte Carlo"], looks)


def toy_inputs(rows: list[Row]) -> str:
    """Table 8: errors, and as multiples of Monte Carlo's."""
    inputs = _different(rows, "randomised")
    head = ["integrand", "MC", *("nothing randomised" if what == "none" else f"random {what}" for what in inputs)]
    lines = []
    for case in _different(rows, "problem"):
        found = [_find(rows, problem=case, randomised=what) for what in inputs]
        cells = [f"{short(row['mse'])} ({short(row['times_mc'], 2)} x MC)" for row in found if row]
        lines.append([case, short(found[0]["mc"]) if found[0] else "", *cells])
    return markdown(head, lines)


def toy_ablation(rows: list[Row]) -> str:
    """Figs. 8 and 10: the held-out mean with its ratio, and five integrands."""
    cases = _different(rows, "problem")
    lines = []
    for rule in _different(rows, "rule"):
        first, *others = (_find(rows, problem=case, rule=rule) for case in cases)
        assert first is not None
        ratio = [short(first["ratio"]), span(first["ratio_interval"])]
        lines.append([NAMES.get(rule, rule), short(first["mse"]), *ratio, *map(_cell, others)])
    table = markdown(["short trainings, 32 random samples", "held out", "x Monte Carlo", "95%", *cases[1:]], lines)
    return _pictures([("toy-ablation.png", "weights against values, with and without information")]) + table


def learning_speed(rows: list[Row]) -> str:
    """toy-uniform without one thing at a time, and when the first of the rows was as good."""
    lines = [
        [row["variant"], short(row["mse"]), short(row["ratio"]), short(row["as_good_at"]) if row["as_good_at"] else ""]
        for row in rows
    ]
    picture = _pictures([("learning-speed.png", "error against iterations of training")])
    head = ["the network", "mean squared error at the end", "x Monte Carlo", "iterations until the first was as good"]
    return picture + markdown(head, lines)


def joint_training(rows: list[Row]) -> str:
    """Begun from nothing or on a base sampler, by gaps or by a grid; frozen samplers show the integrator's own part."""
    return _pictures([("joint-training.png", "error against iterations of joint training")]) + _trainings(rows)


def step_ablation(rows: list[Row]) -> str:
    """Fig. 31: what a sampler of walks sees before it chooses a direction."""
    return _pictures([("step-ablation.png", "error against iterations of joint training")]) + _trainings(rows)


def _trainings(rows: list[Row]) -> str:
    return markdown(
        ["the sampler", "mean squared error early", "at the end", "x Monte Carlo"],
        [[row["variant"], short(row["first"]), short(row["mse"]), short(row["ratio"])] for row in rows],
    )


def toy_convergence(rows: list[Row]) -> str:
    """Figs. 9 and 15: the mean over held-out integrands, by number of samples."""
    mine = [row for row in rows if row["problem"] == "held out"]
    sizes = sorted({row["n"] for row in mine})
    lines = [
        [_method(*pair), *(_cell(_find(mine, design=pair[0], rule=pair[1], n=n)) for n in sizes)]
        for pair in dict.fromkeys((row["design"], row["rule"]) for row in mine)
    ]
    table = markdown(["mean squared error, samples", *map(str, sizes)], lines)
    return _pictures([("toy-convergence.png", "error against samples")]) + table


def toy_strategy(rows: list[Row]) -> str:
    """Fig. 16: how many of each four samples land next to a break."""
    fours = len(rows[0]["near_by_fours"])
    head = ["share within 0.01 of a break, samples", *(f"{4 * k + 1} to {4 * k + 4}" for k in range(fours))]
    table = markdown(
        [*head, "distance of a break"],
        [
            [row["method"], *(f"{at:.0%}" for at in row["near_by_fours"]), short(row["median_distance_of_breaks"], 2)]
            for row in rows
        ],
    )
    drawn = [(f"toy-strategy-{row['method']}.png", f"{row['method']} samples in order") for row in rows]
    return _pictures(drawn) + table


def gwn_tables(rows: list[Row]) -> str:
    """Table 11: shape by shape."""
    shapes = len(rows[0]["by_shape"])
    head = ["samples, rule", *map(str, range(shapes)), "mean", "x MC, random", "95%", "the paper's mean"]
    lines = []
    for row in rows:
        pair = (row["design"], row["rule"])
        paper = _cell({"mse": PAPER_GWN.get(pair)})
        mean = [short(row["mse"]), short(row["ratio"]), span(row["ratio_interval"])]
        lines.append([_method(*pair), *map(short, row["by_shape"]), *mean, paper])
    return markdown(head, lines)


def gwn_outside(rows: list[Row]) -> str:
    """Fig. 25: a line for each shape, strategy and design."""
    rules = ("gwn-hermite", "inet-gwn-structured", "inet-gwn-uniform")
    rules += tuple(rule for rule in _different(rows, "rule") if rule not in (*rules, "mc"))
    lines = []
    for shape in _different(rows, "problem"):
        mine = [row for row in rows if row["problem"] == shape]
        plain = mine[0]
        for design in dict.fromkeys(row["design"] for row in mine):
            for strategy in _different(mine, "strategy"):
                found = [_find(mine, design=design, strategy=strategy, rule=rule) for rule in rules]
                cells = ["" if r is None else f"{short(r['mse'])} ({short(r['ratio'])} x)" for r in found]
                if any(cells):
                    lines.append([f"{shape}, {strategy}, {design}", short(plain["mse"]), *cells])
    table = markdown(["shape", "MC, random, as many samples", *(NAMES.get(rule, rule) for rule in rules)], lines)
    return _pictures([("gwn-outside.png", "shapes outside the family: fields and errors")]) + table


def gwn_strategy(rows: list[Row]) -> str:
    """Fig. 26: pictures, and how weights depend on the query."""
    table = markdown(
        ["32 samples", "weight, queries far away", "weight of the nearest sample, near queries", "nearest sample"],
        [
            [
                row["method"],
                short(row["median_weight_far_queries"]),
                short(row["median_weight_of_nearest_sample_near_queries"]),
                short(row["median_distance_of_nearest_sample"]),
            ]
            for row in rows
        ],
    )
    return _pictures([(f"gwn-strategy-{row['method']}.png", f"{row['method']} samples") for row in rows]) + table


def gwn_huber(rows: list[Row]) -> str:
    """What the robust loss does."""
    return markdown(
        ["loss", "mean squared error", "95%", "median", "99%", "largest", "plain loss's over its", "95%"],
        [
            [
                "squared" if row["knee"] > 1e3 else f"pseudo-Huber, knee {row['knee']:g}",
                short(row["mse"]),
                span(row["mse_interval"]),
                *(short(row[key]) for key in ("median", "p99", "largest", "ratio")),
                interval_or_none(row),
            ]
            for row in rows
        ],
    )


def interval_or_none(row: Row) -> str:
    """The interval of a ratio that is not 1 by definition."""
    return "" if row["ratio"] == 1.0 else span(row["ratio_interval"])
