"""The page: records of measured applications, put into one file that needs nothing else."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from nqr_geom import check
from nqr_geom.reporting import charts, findings
from nqr_geom.reporting.applications import APPLICATIONS
from nqr_geom.reporting.contenders import KINDS
from nqr_geom.reporting.page_text import FILTERS, micro

__all__ = ["render_page"]

Record = dict[str, Any]

_SHOWN = 10  # rows of an envelope


def render_page(report: Record) -> str:
    """The whole page as HTML text; `report` is what `report.json` holds.

    Parameters
    ----------
    report : dict
        As `nqr_geom.report` returns it.

    Raises
    ------
    ImportError
        If plotly or jinja2 is missing.
    """
    jinja2 = check.require("jinja2", "report", "report pages")
    charts.library()
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    folder = files("nqr_geom.reporting") / "page"
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters |= FILTERS
    template = environment.from_string((folder / "page.html.j2").read_text(encoding="utf-8"))
    applications = [_application(record, Markup) for record in report["applications"]]
    bars = [app for app in applications if app["coverage"]]
    text: str = template.render(
        **{key: value for key, value in report.items() if key not in ("applications", "hard")},
        applications=applications,
        bars=bars,
        walk_bias=any(app["name"] == "laplace" for app in bars),
        titles={name: title for name, (title, _) in APPLICATIONS.items()},
        style=Markup((folder / "style.css").read_text(encoding="utf-8")),
        plotly=Markup(get_plotlyjs()),
        **_hard(report["hard"]),
    )
    return text


def _application(record: Record, safe: Any) -> Record:
    """A record with everything that its section shows."""
    n = findings.reference_budget(record)
    baseline = next(
        (c["point"] for c in findings.points_of(record) if c["method"] == record["baseline"] and c["n"] == n), None
    )
    envelope = findings.frontier_of(record).envelope()
    points = [cell for cell in record["cells"] if cell["point"]]
    name = record["name"]
    made = {
        "what": APPLICATIONS[name][1],
        "n": n,
        "headline": findings.headline(record),
        "envelope": envelope[-_SHOWN:],
        "envelope_words": _words(envelope),
        "equal_time": findings.equal_time(record),
        "break_even": findings.break_even_costs(record),
        "methods": _methods(record, n, baseline),
        "left_out": [cell for cell in record["cells"] if cell["refused"]],
        "measured": len(points),
        "has_exact": any(cell["kind"] == "exact" for cell in points),
        "stages": any(cell["point"]["stages"] for cell in points),
        "error_chart": safe(charts.to_html(charts.error_chart(record), f"error-{name}")),
        "stage_chart": safe(charts.to_html(charts.stage_chart(record), f"stage-{name}")),
    }
    if record["coverage"]:
        made["coverage_chart"] = safe(charts.to_html(charts.coverage_chart(record), f"coverage-{name}"))
    return record | made


def _words(envelope: list[Record]) -> str:
    """The envelope in a sentence."""
    if not envelope:
        return ""
    parts = [f"{row['method']} from {micro(row['seconds'])} an integral on" for row in envelope[-4:]]
    begin = (
        "Of the methods that spend samples the best is " if len(envelope) <= 4 else "At the larger times the best is "
    )
    return begin + ", then ".join(parts) + "."


def _methods(record: Record, n: int, baseline: Record | None) -> list[Record]:
    """Cells at n by kind, the best of those that spend samples marked; others at all their settings."""
    at = [cell for cell in findings.points_of(record) if cell["n"] == n]
    best = min((cell["point"]["mse"] for cell in at), default=0.0)
    groups = []
    for kind, title in KINDS.items():
        cells = findings.points_of(record, "exact") if kind == "exact" else [c for c in at if c["kind"] == kind]
        if cells:
            told = [
                cell
                | {
                    "best": kind != "exact" and cell["point"]["mse"] == best,
                    "slower": cell["point"]["seconds"] / baseline["seconds"] if baseline else None,
                }
                for cell in cells
            ]
            groups.append({"title": title, "cells": told})
    return groups


def _hard(groups: list[Record]) -> Record:
    """The table of hard cases: how many keep their bound, and which is closest to it."""

    def closeness(result: Record) -> float:
        """Error in units of the bound; what failed to give one comes first."""
        if result["error"] is None:
            return float("inf")
        return result["error"] / result["bound"] if result["bound"] > 0.0 else float(result["error"] > 0.0)

    rows = []
    for group in groups:
        results = group["results"]
        row = {"group": group["group"], "cases": group["cases"], "ran": len(results), "reason": group["reason"]}
        if results:
            row |= {
                "kept": sum(result["holds"] for result in results),
                "worst": max(results, key=closeness),
                "seconds": sum(result["seconds"] for result in results),
            }
        rows.append(row)
    everything = [result for group in groups for result in group["results"]]
    failed = [result for result in everything if not result["holds"]]
    told = {"hard_total": len(everything), "hard_left": sum(row["cases"] - row["ran"] for row in rows)}
    return {"hard": rows, "hard_failed": failed, **told}
