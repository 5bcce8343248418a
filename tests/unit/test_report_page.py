"""The page in a real browser: it needs nothing from elsewhere, its charts are drawn and answer to clicks."""

from __future__ import annotations

import re
import shutil
from html import escape

import pytest

from nqr_geom import render
from nqr_geom.reporting.effects import of_scene
from nqr_geom.reporting.pages import render_page
from tests.reports import tiny

HOSTILE = "<img src=x onerror=alert(1)>"
HARD = [
    {"name": "a spiral", "error": 2e-13, "bound": 1e-12, "words": "", "holds": True},
    {"name": "a tip", "error": 3e-3, "bound": 1e-3, "words": "", "holds": False},
    {"name": "a crash", "error": None, "bound": 1e-3, "words": "Oops: no", "holds": False},
]


@pytest.fixture(scope="module")
def browser():
    """Debian's chromium; the sandbox does not work for root."""
    where = shutil.which("chromium")
    if where is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=where, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    made = tiny(folder, apps=["gwn", "toy"])
    floor = render.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0], render.Diffuse(0.5))
    camera = render.Camera([0, -3, 1], [0, 0, 0], width=2, height=2)
    scene = render.Scene(camera, [floor], [render.SphereLight([0, 0, 2], 0.5, 10.0)])
    made |= {
        "effects": [of_scene("a floor", scene, 1)],
        "hard": [
            {
                "group": "winding",
                "cases": 4,
                "reason": None,
                "results": [one | {"group": "winding", "seconds": 0.1} for one in HARD],
            },
            {"group": "direct", "cases": 0, "reason": 'it needs the extra "render"', "results": []},
        ],
        "input": HOSTILE,
    }
    (folder / "whole.html").write_text(render_page(made), encoding="utf-8")
    return folder, made


@pytest.fixture(scope="module")
def page(browser, report):
    opened = browser.new_page(viewport={"width": 1366, "height": 800})
    opened.trouble = []
    opened.on("console", lambda message: opened.trouble.append(f"{message.type}: {message.text}"))
    opened.on("pageerror", lambda error: opened.trouble.append(f"error: {error}"))
    opened.on("request", lambda request: opened.trouble.append(f"request: {request.url}"))
    opened.goto((report[0] / "whole.html").as_uri())
    opened.wait_for_function("document.querySelectorAll('.js-plotly-plot .main-svg').length > 0")
    yield opened
    opened.close()


def test_nothing_is_fetched_and_nothing_complains(page, report):
    address = (report[0] / "whole.html").as_uri()
    fetched = [told for told in page.trouble if not told.startswith(("request: data:", "request: blob:"))]
    assert fetched == [f"request: {address}"]


def test_every_chart_is_drawn(page, report):
    names = ["gwn", "toy"]
    expected = [f"{kind}-{name}" for name in names for kind in ("error", "stage")] + [f"coverage-{n}" for n in names]
    drawn = page.eval_on_selector_all(".js-plotly-plot", "all => all.map(one => one.id)")
    assert sorted(drawn) == sorted(expected)
    for name in names:
        record = next(one for one in report[1]["applications"] if one["name"] == name)
        sampled = {c["method"] for c in record["cells"] if c["point"] and c["kind"] != "exact"}
        exact = {c["method"] for c in record["cells"] if c["point"] and c["kind"] == "exact"}
        lines = page.locator(f"#error-{name} .scatterlayer .trace").count()
        assert lines == 2 * len(sampled) + len(exact) + 1  # both halves, what needs no samples once, the envelope
        legend = page.eval_on_selector_all(
            f"#error-{name} .legend .legendtext", "all => all.map(one => one.textContent)"
        )
        assert all(legend.count(method) == 1 for method in sampled | exact | {"envelope"})
        assert page.locator(f"#stage-{name} .barlayer .trace").count() >= 2
    size = page.locator("#error-gwn .main-svg").first.bounding_box()
    assert size["width"] > 1000
    assert size["height"] > 400


def shown(page):
    """Traces of the winding numbers' chart that are visible, by method."""
    return page.evaluate(
        "document.getElementById('error-gwn')._fullData.filter(t => t.visible === true).map(t => t.name)"
    )


def test_a_click_in_the_legend_hides_a_method_in_both_halves(page):
    before = shown(page)
    assert before.count("trapezoid") == 2
    entry = page.locator("#error-gwn .legend .traces", has_text="trapezoid").first
    entry.locator(".legendtoggle").click()
    page.wait_for_timeout(600)  # a second click within this time would be a double click
    after = shown(page)
    assert [name for name in before if name != "trapezoid"] == [name for name in after if name != "trapezoid"]
    hidden = {"trapezoid", "uniform-jitter+trapezoid"} - set(after)
    assert len(hidden) == 1
    assert len(before) - len(after) == 2


def test_axes_are_logarithmic_with_units(page):
    layout = page.evaluate(
        "(({xaxis, xaxis2, yaxis}) => [xaxis, xaxis2, yaxis].map(a => [a.type, a.title.text]))"
        "(document.getElementById('error-gwn')._fullLayout)"
    )
    assert [kind for kind, _ in layout] == ["log"] * 3
    assert "queries" in layout[0][1]
    assert "microseconds" in layout[1][1]
    assert "mean squared error" in layout[2][1]


def test_contents_lead_somewhere_and_the_page_is_not_too_wide(page):
    targets = page.eval_on_selector_all("nav a", "all => all.map(one => one.getAttribute('href'))")
    assert "#gwn" in targets
    assert "#hard" in targets
    for target in targets:
        assert page.locator(target).count() == 1
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


def test_the_figures_on_the_page_are_the_measured_ones(page, report):
    from nqr_geom.reporting.page_text import error

    for record in report[1]["applications"]:
        cell = next(c for c in record["cells"] if c["method"] == "mc" and c["n"] == 16)
        heading = page.locator("h3", has_text="Methods at n = 16").nth(report[1]["applications"].index(record))
        row = heading.locator("xpath=following-sibling::div[1]").locator("tr", has=page.get_by_text("mc", exact=True))
        shown = row.first.locator("td").all_inner_texts()
        assert shown[0] == "mc"
        assert shown[1] == "16"
        assert shown[2] == error(cell["point"]["mse"])
        assert shown[6] == "1"
    assert page.locator("#hard ~ p").first.inner_text().find("2 of 3 do not keep their bound") > 0
    assert "Oops: no" in page.inner_text("main")
    assert 'not run: it needs the extra "render"' in page.inner_text("main")


def test_what_a_user_names_is_text_and_not_markup(page, report):
    assert page.locator("main img").count() == 0
    assert HOSTILE in page.inner_text("main p.lead")
    assert escape(HOSTILE) in (report[0] / "whole.html").read_text(encoding="utf-8")


def test_it_prints(browser, report, tmp_path):
    printed = browser.new_page()
    printed.goto((report[0] / "whole.html").as_uri())
    paper = printed.pdf(format="A4")
    printed.close()
    assert paper.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", paper)) >= 4
