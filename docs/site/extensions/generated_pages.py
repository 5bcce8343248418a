"""What the site takes from the library itself before it is built: method tables, cost charts, model cards, hard cases.

Everything lands in `generated/` beside the sources, which git ignores.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import charts
from sphinx.application import Sphinx

from nqr_geom import hard_cases, registry

SITE = Path(__file__).parents[1]
ROOT = SITE.parents[1]
GENERATED = SITE / "generated"

ONE_DIMENSIONAL = ("toy", "gwn", "sd", "transmittance")


def table(columns: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def methods_of(problem: str) -> str:
    """Every short method name that fits a problem, with its sampler, its rule and what they do."""
    rows = []
    for alias, full in registry.ALIASES.items():
        of, colon, name = alias.rpartition(":")
        sampler, rule = (
            registry.entry(kind, part) for kind, part in zip(("sampler", "rule"), full.split("+"), strict=True)
        )
        fits_anywhere = not colon and sampler.needs in ("", problem) and rule.needs not in ("techniques",)
        one = "1" in (sampler.dims, rule.dims)
        overridden = f"{problem}:{name}" in registry.ALIASES
        if of == problem or (
            fits_anywhere and not overridden and problem in (ONE_DIMENSIONAL if one else (*ONE_DIMENSIONAL, "laplace"))
        ) or (alias == "mis" and problem == "direct"):  # fmt: skip
            parts = [f"`{part.name}`: {part.summary}" for part in (sampler, rule)]
            rows.append([f'`"{name}"`', *parts])
    return table(["method", "how samples are placed", "and weighed"], rows)


def registry_page() -> str:
    """All samplers, rules and problems."""
    text = [
        "# Samplers, rules and problems\n",
        'Any sampler goes with any rule on any problem as `method="sampler+rule"`; what does not fit is refused.\n',
    ]
    for kind, title in (("sampler", "Samplers"), ("rule", "Rules"), ("problem", "Problems")):
        rows = [[f"`{e.name}`", e.summary, *([e.exact] if kind == "rule" else []), e.dims, e.needs or ""]
                for e in registry.entries(kind)]  # fmt: skip
        columns = ["name", "what it does", *(["exact on"] if kind == "rule" else []), "dimensions", "needs"]
        text += [f"## {title}\n", table(columns, rows)]
    return "\n".join(text)


def hard_case_table() -> str:
    """How many hard cases each group of the catalogue holds, and some of them."""
    rows = []
    for group in hard_cases.groups():
        if hard_cases.missing(group) is None:
            cases = hard_cases.cases(group)
            names = list(dict.fromkeys(case.base for case in cases))
            some = "; ".join(names[:: max(1, len(names) // 4)][:4])
            rows.append([f"`{group}`", str(len(names)), str(len(cases)), some])
    return table(["group", "cases", "with variants", "for example"], rows)


def write(app: Sphinx) -> None:
    shutil.rmtree(GENERATED, ignore_errors=True)
    for folder in ("methods", "models", "charts"):
        (GENERATED / folder).mkdir(parents=True)
    for entry in registry.entries("problem"):
        (GENERATED / "methods" / f"{entry.name}.md").write_text(methods_of(entry.name))
    (GENERATED / "registry.md").write_text(registry_page())
    (GENERATED / "hard_cases.md").write_text(hard_case_table())
    cards = {path.stem: path for path in ROOT.glob("nqr_geom/*/models/*.md")}
    for entry in registry.entries("model"):
        if entry.name in cards:
            shutil.copy(cards[entry.name], GENERATED / "models")
    charts.write(ROOT / "benchmarks" / "results", GENERATED / "charts")


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
