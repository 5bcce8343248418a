"""The page's charts: error against queries and against time, time by stage, coverage of error bars."""

from __future__ import annotations

from math import log10
from typing import Any

from nqr_geom import check
from nqr_geom.reporting.contenders import KINDS
from nqr_geom.reporting.findings import frontier_of, points_of, reference_budget
from nqr_geom.reporting.page_text import kurtosis, micro

__all__ = ["HEIGHT", "coverage_chart", "error_chart", "library", "stage_chart", "to_html"]

Record = dict[str, Any]

HEIGHT = 500
_SMALLEST = 1e-20  # errors below 1e-10 count as none: where an answer is exact the logarithm has to end
_ROUNDING = 1e-16  # of the largest error: what is below is exact but for rounding, and does not stretch the axis

# Shades of one hue for each kind (after Okabe and Ito, safe for colour-blind readers), a marker for each method.
_SHADES = {
    "classical": ("#16324f", "#0072b2", "#56b4e9", "#5b7083", "#3a5fcd", "#8aa4b8", "#2f4858", "#7b9ce0", "#9fb3c2"),
    "tracking": ("#7a6a00", "#b59f00", "#57502a"),
    "library": ("#777777",),
    "structured": ("#009e73", "#006b4e"),
    "student": ("#e69f00", "#a87300"),
    "learned": ("#d55e00", "#cc79a7", "#8f3f00", "#8e3b72", "#ff8a3d"),
    "exact": ("#000000", "#000000", "#000000", "#000000"),
}
_MARKERS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "x", "cross", "pentagon", "hexagon", "star")
_HOLLOW = ("star-open", "diamond-tall-open", "hourglass-open", "square-cross-open")
_WIDE = ("structured", "student", "learned")


def library() -> Any:
    """The plotly module, or one sentence about the extra that brings it."""
    check.require("plotly", "report", "report pages")
    import plotly.graph_objects as graph

    return graph


def to_html(figure: Any, name: str) -> str:
    """A chart as a piece of HTML that expects plotly.js on the page."""
    from plotly.io import to_html as convert

    config = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}
    text: str = convert(figure, config=config, include_plotlyjs=False, full_html=False, div_id=name)
    return text


def _look(figure: Any, height: int) -> None:
    font = {"family": "Georgia, 'Times New Roman', serif", "size": 13, "color": "#1a1a1a"}
    figure.update_layout(
        template="simple_white",
        height=height,
        font=font,
        margin={"l": 70, "r": 10, "t": 36, "b": 56},
        hoverlabel={"font": {"family": "monospace", "size": 12}},
    )
    figure.update_xaxes(showgrid=True, gridcolor="#e8e8e8", ticks="outside")
    figure.update_yaxes(showgrid=True, gridcolor="#e8e8e8", ticks="outside")


def _styles(record: Record) -> dict[str, dict[str, Any]]:
    """Colour, marker and width of every method."""
    styles: dict[str, dict[str, Any]] = {}
    for kind, shades in _SHADES.items():
        names = list(dict.fromkeys(cell["method"] for cell in record["cells"] if cell["kind"] == kind))
        markers = _HOLLOW if kind == "exact" else _MARKERS
        for k, name in enumerate(names):
            styles[name] = {
                "color": shades[k % len(shades)],
                "symbol": markers[k % len(markers)],
                "width": 2.6 if kind in _WIDE else 1.3,
                "dash": "dot" if kind == "exact" else "solid" if k < len(shades) else "dash",
            }
    return styles


def _range(record: Record) -> tuple[float, float]:
    """Errors shown: all that sampled methods reach short of rounding."""
    errors = [max(cell["point"]["mse"], _SMALLEST) for cell in points_of(record)]
    top = max(errors)
    return min(error for error in errors if error >= _ROUNDING * top) / 4.0, 4.0 * top


def _hover(cell: Record) -> str:
    point = cell["point"]
    low, high = point["mse_interval"]
    what = f"n = {cell['n']}" if cell["n"] else cell["setting"]
    lines = [
        f"<b>{cell['method']}</b> {what}".strip(),
        f"MSE {point['mse']:.3g}  [{low:.2g}, {high:.2g}]",
        f"{1e6 * point['seconds']:.3g} us an integral",
    ]
    if point["queries"] is not None:
        lines.append(f"{point['queries']:.4g} queries")
    if point["ratio"] is not None:
        lines.append(f"{point['ratio']:.3g} times Monte Carlo's accuracy")
    return "<br>".join(lines)


def _trace(cells: list[Record], x: list[float], style: Record, floor: float, legend: Record) -> Any:
    """One method: a line through its points with 95% intervals; what is below the floor stands on it."""
    y = [max(cell["point"]["mse"], floor) for cell in cells]
    low, high = ([max(cell["point"]["mse_interval"][end], floor) for cell in cells] for end in (0, 1))
    bars = {
        "type": "data",
        "symmetric": False,
        "array": [max(0.0, top - at) for top, at in zip(high, y, strict=True)],
        "arrayminus": [max(0.0, at - bottom) for bottom, at in zip(low, y, strict=True)],
        "thickness": 1,
        "width": 0,
    }
    exact = cells[0]["kind"] == "exact"
    return library().Scatter(
        x=x,
        y=y,
        error_y=bars,
        mode="markers" if exact and len(cells) == 1 else "lines+markers",
        line={"color": style["color"], "width": style["width"], "dash": style["dash"]},
        marker={"symbol": style["symbol"], "size": 12 if exact else 7, "color": style["color"], "line": {"width": 1.5}}
        if exact
        else {"symbol": style["symbol"], "size": 7, "color": style["color"]},
        text=[_hover(cell) for cell in cells],
        hovertemplate="%{text}<extra></extra>",
        cliponaxis=False,
        **legend,
    )


def error_chart(record: Record) -> Any:
    """Error against queries (left) and against time (right); what needs no samples stands right only.

    Parameters
    ----------
    record : dict
        An application's record.

    Returns
    -------
    plotly Figure
        A click on a name in the legend hides or shows that method in both halves.
    """
    library()
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.03)
    styles, (floor, top) = _styles(record), _range(record)
    for rank, (kind, title) in enumerate(KINDS.items()):
        cells = [cell for cell in record["cells"] if cell["kind"] == kind and cell["point"]]
        for k, name in enumerate(dict.fromkeys(cell["method"] for cell in cells)):
            own = [cell for cell in cells if cell["method"] == name]
            legend: Record = {"name": name, "legendgroup": name, "legendrank": 100 * rank + k}
            if k == 0:
                legend["legendgrouptitle"] = {"text": title}
            seconds = [1e6 * cell["point"]["seconds"] for cell in own]
            if kind != "exact":
                queries = [cell["point"]["queries"] for cell in own]
                figure.add_trace(_trace(own, queries, styles[name], floor, legend | {"showlegend": False}), 1, 1)
            figure.add_trace(_trace(own, seconds, styles[name], floor, legend), 1, 2)
    _envelope(figure, record, floor)
    figure.update_xaxes(type="log", title_text="integrand queries per integral", dtick="D1", row=1, col=1)
    figure.update_xaxes(type="log", title_text="wall time per integral, microseconds", row=1, col=2)
    figure.update_yaxes(type="log", exponentformat="power", dtick=1 if top / floor < 1e9 else 2)
    figure.update_yaxes(title_text="mean squared error", row=1, col=1)
    figure.update_yaxes(range=[log10(floor), log10(top)])
    _look(figure, HEIGHT)
    figure.update_xaxes(dtick=1, exponentformat="none")
    methods = len({cell["method"] for cell in record["cells"] if cell["point"]})
    figure.update_layout(
        height=max(HEIGHT, 24 * methods + 200),
        legend={"font": {"size": 12}, "tracegroupgap": 2, "grouptitlefont": {"size": 12, "weight": "bold"}},
        margin={"r": 10},
    )
    return figure


def _envelope(figure: Any, record: Record, floor: float) -> None:
    """The best error within each time, as a pale step line behind the methods."""
    points = sorted((p for p in frontier_of(record).points if p.kind == "sampled"), key=lambda p: (p.seconds, p.mse))
    x, y, best = [], [], float("inf")
    for point in points:
        if point.mse < best:
            best = point.mse
            x.append(1e6 * point.seconds)
            y.append(max(best, floor))
    line = {"color": "rgba(0,0,0,0.18)", "width": 9, "shape": "hv"}
    legend = {"name": "envelope", "legendgroup": "envelope", "legendrank": 990}
    trace = library().Scatter(x=x, y=y, mode="lines", line=line, hoverinfo="skip", **legend)
    figure.add_trace(trace, 1, 2)


def stage_chart(record: Record) -> Any:
    """Where the time of each method goes, as shares, with the time itself beside the bar."""
    graph = library()
    n = reference_budget(record)
    cells = [cell for cell in points_of(record) if cell["n"] == n and cell["point"]["stages"]]
    cells.sort(key=lambda cell: -cell["point"]["seconds"])
    stages = list(dict.fromkeys(stage for cell in cells for stage in cell["point"]["stages"]))
    colours = {"draw": "#56b4e9", "combine": "#e69f00", "compiled": "#009e73", "all": "#999999"}
    figure = graph.Figure()
    names = [cell["method"] for cell in cells]
    totals = [sum(cell["point"]["stages"].values()) or 1.0 for cell in cells]
    for stage in stages:
        spent = [cell["point"]["stages"].get(stage, 0.0) for cell in cells]
        figure.add_trace(
            graph.Bar(
                y=names,
                x=[100.0 * s / total for s, total in zip(spent, totals, strict=True)],
                customdata=[1e6 * s for s in spent],
                orientation="h",
                name=stage,
                marker={"color": colours.get(stage, "#cc79a7"), "line": {"width": 0}},
                hovertemplate="%{y}, " + stage + ": %{customdata:.3g} us an integral<extra></extra>",
            )
        )
    for name, cell in zip(names, cells, strict=True):
        text = micro(cell["point"]["seconds"])
        place = {"x": 1.0, "xref": "paper", "xshift": 6, "xanchor": "left", "y": name}
        figure.add_annotation(text=text, showarrow=False, font={"size": 12}, **place)
    _look(figure, 24 * len(names) + 120)
    figure.update_layout(barmode="stack", bargap=0.35, legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"})
    figure.update_layout(margin={"l": 10, "r": 80, "t": 40})
    figure.update_xaxes(range=[0, 100], title_text="share of the time by stage, per cent")
    figure.update_yaxes(automargin=True, showgrid=False)
    return figure


def coverage_chart(record: Record) -> Any:
    """Coverage of 95% intervals against the kurtosis of the terms, a line for each number of samples."""
    graph = library()
    figure = graph.Figure()
    shades = ("#9ecae1", "#56b4e9", "#0072b2", "#16324f", "#000000")
    bins = sorted({row["low"] for row in record["coverage"]})
    labels = {row["low"]: kurtosis(row) for row in record["coverage"]}
    for k, n in enumerate(sorted({row["n"] for row in record["coverage"]})):
        rows = {row["low"]: row for row in record["coverage"] if row["n"] == n}
        shown = [low for low in bins if low in rows]
        figure.add_trace(
            graph.Scatter(
                x=[labels[low] for low in shown],
                y=[100.0 * rows[low]["covered"] for low in shown],
                mode="lines+markers",
                name=f"n = {n}",
                marker={"symbol": _MARKERS[k], "size": 8},
                line={"color": shades[k % len(shades)], "width": 2},
            )
        )
    figure.add_hline(y=95.0, line={"dash": "dash", "color": "#d55e00", "width": 1.5})
    _look(figure, 300)
    figure.update_layout(title={"text": record["title"], "font": {"size": 14}, "x": 0.02})
    figure.update_layout(showlegend=True, legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0.35})
    categories = [labels[low] for low in bins]
    figure.update_xaxes(title_text="kurtosis of the terms", categoryorder="array", categoryarray=categories)
    figure.update_yaxes(title_text="intervals that hold the truth, %", range=[40, 101])
    return figure
