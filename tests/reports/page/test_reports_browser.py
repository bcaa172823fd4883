"""The page in a browser: no error, no overflow, accessible, and its views do what they say.

The tests need a Chromium of the system, and are skipped where there is none.
"""

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import report_fixture
import result_sample
from report_fixture import result_of

from oed.base import Array
from oed.result import StudyResult
from pkm_reports import write_report

pytestmark = [pytest.mark.slow, pytest.mark.pictures]
WIDTHS = {390: 844, 768: 1024, 1440: 900}
SERIOUS = {"serious", "critical"}


@pytest.fixture(scope="module")
def result() -> StudyResult:
    """A head with a plan, a fit, an error map, and a diagnosis with circles."""
    return result_of(result_sample.with_places())


@pytest.fixture(scope="module")
def address(result: StudyResult, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("page")
    page: Path = write_report(result, folder, pdf=False)[0]
    return page.as_uri()


@pytest.fixture
def opened(browser: Any, address: str) -> Iterator[Any]:
    """Opens the page; at the end no error has reached the console."""
    contexts, said = [], []

    def open_page(width: int = 1440, scheme: str = "light", **settings: Any) -> Any:
        size = {"width": width, "height": WIDTHS[width]}
        context = browser.new_context(viewport=size, color_scheme=scheme, **settings)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(address)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []


def unfold(page: Any) -> None:
    """Open all chapters, as a reader does one by one."""
    for heading in page.locator("details.chapter > summary").all():
        heading.click()


def test_a_link_opens_the_chapter_that_it_names(opened):
    page = opened(1440)
    chapter = page.locator("details#identification")
    assert chapter.get_attribute("open") is None
    page.click("nav a[href='#identification']")
    page.wait_for_selector("details#identification[open]")
    assert page.locator("details.chapter[open]").count() == 1


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_overflows(opened, width, scheme):
    page = opened(width, scheme)
    unfold(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1440, "dark")])
def test_everyone_can_read_the_page(opened, width, scheme):
    from axe_playwright_python.sync_playwright import Axe

    page = opened(width, scheme)
    found = Axe().run(page).response["violations"]
    faults = [f"{v['id']}: {v['nodes'][0]['target']}" for v in found
              if v["impact"] in SERIOUS]  # fmt: skip
    assert faults == []


def test_the_first_screen_answers_what_how_long_how_accurate(opened):
    page = opened(1440)
    for anchor in ("short", "measure", "how-accurate"):
        box = page.locator(f"#{anchor} h2").bounding_box()
        assert box["y"] + box["height"] < WIDTHS[1440]
    rows = page.locator("#how-accurate tbody tr").last.bounding_box()
    assert rows["y"] + rows["height"] < WIDTHS[1440]


def test_letters_of_figures_can_be_read_on_a_telephone(opened):
    """Drawn at 8 points for 6.7 inches: at least 9 pixels high at 390 pixels."""
    page = opened(390)
    unfold(page)
    widths = page.eval_on_selector_all(
        "figure.picture img:not(.small)", "images => images.map(i => i.clientWidth)"
    )
    assert len(widths) > 5
    drawn = 6.7 * 96.0
    assert min(widths) / drawn * 8.0 * 96.0 / 72.0 >= 9.0


def test_the_button_changes_the_theme(opened):
    page = opened(1440, "light")
    paper = "getComputedStyle(document.body).backgroundColor"
    assert page.evaluate(paper) == "rgb(255, 255, 255)"
    page.click("#theme")
    red, *_ = page.evaluate(paper).removeprefix("rgb(").split(",")
    assert int(red) < 60
    page.click("#theme")
    assert page.evaluate(paper) == "rgb(255, 255, 255)"


def test_a_table_is_saved_as_csv(opened, result):
    page = opened(1440)
    unfold(page)
    figure = page.locator("figure.table", has=page.locator("tr[data-reading]"))
    with page.expect_download() as download:
        figure.locator("button.export").click()
    text = Path(download.value.path()).read_text(encoding="utf-8-sig")
    rows = list(csv.reader(io.StringIO(text)))
    assert len(rows) == 1 + len(result.design.poses)
    column = rows[0].index("z [mm]")
    values = [float(row[column]) for row in rows[1:]]
    assert values == pytest.approx([p.command["z_mm"] for p in result.design.poses])


# -- the view to turn ------------------------------------------------------------------
def _seen_from(points: Array, at: Array, azimuth: float, elevation: float) -> Array:
    """Where a point (3,) is drawn, in units of the scale, right and up of the middle.

    Rotation about z by the azimuth, then about the horizontal by the elevation.
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    a, e = math.radians(azimuth), math.radians(elevation)
    about_z = np.array(
        [
            [math.cos(a), math.sin(a), 0.0],
            [-math.sin(a), math.cos(a), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    tilt = np.array(
        [
            [math.cos(e), 0.0, math.sin(e)],
            [0.0, 1.0, 0.0],
            [-math.sin(e), 0.0, math.cos(e)],
        ]
    )
    _, right, up = tilt @ about_z @ (at - middle)
    return np.array([right, up])


def _picked_place(page: Any) -> Array:
    """Middle (2,) of what is drawn in the colour of a picked reading, canvas pixels."""
    return np.array(
        page.evaluate(
            """() => {
        const canvas = document.getElementById('scene');
        const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        const places = [];
        for (let k = 0; k < pixels.length; k += 4) {
          const [r, g, b, a] = pixels.slice(k, k + 4);
          if (a > 200 && Math.abs(r - 194) + Math.abs(g - 24) + Math.abs(b - 91) < 12)
            places.push([k / 4 % canvas.width, Math.floor(k / 4 / canvas.width)]);
        }
        return [0, 1].map(j => places.reduce((sum, p) => sum + p[j], 0) / places.length);
      }"""
        )
    )


def _points(result: StudyResult) -> tuple[Array, Array]:
    drawing = result.drawing
    tips = 1e3 * np.array(drawing.tool_points)
    corners = [np.array(line.points) for line in drawing.lines]
    bars = [np.array(bar) for bar in drawing.bars]
    return 1e3 * np.vstack([*corners, *bars, np.array(drawing.tool_points)]), tips


def test_the_view_turns_and_the_picked_reading_is_where_it_belongs(opened, result):
    page = opened(1440)
    canvas = page.locator("#scene")
    canvas.scroll_into_view_if_needed()
    page.uncheck("[data-layer=bars]")
    row = page.locator("#reading-list tr[data-reading='4']")
    row.click()
    assert canvas.get_attribute("data-picked") == "4"
    everything, tips = _points(result)
    places = []
    for _ in range(2):
        azimuth = float(canvas.get_attribute("data-azimuth"))
        elevation = float(canvas.get_attribute("data-elevation"))
        size = page.evaluate("[scene.clientWidth, scene.clientHeight]")
        radius = np.linalg.norm(np.ptp(everything, axis=0)) / 2.0
        scale = 0.46 * min(size) / radius
        right, up = scale * _seen_from(everything, tips[4], azimuth, elevation)
        expected = np.array([size[0] / 2.0 + right, size[1] / 2.0 - up])
        # The number beside the dot draws the middle towards it.
        assert np.abs(_picked_place(page) - expected).max() < 22.0
        places.append((azimuth, expected))
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + 200, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 320, box["y"] + 230, steps=5)
        page.mouse.up()
    assert places[0][0] != pytest.approx(places[1][0])
    assert np.linalg.norm(places[0][1] - places[1][1]) > 22.0
    assert canvas.get_attribute("data-picked") == "4"


def test_a_reading_is_found_in_table_residuals_and_circle(opened):
    page = opened(1440)
    unfold(page)
    page.locator("figure.table tr[data-reading='7']").click()
    marked = page.locator("[data-reading].picked")
    assert {node.get_attribute("data-reading") for node in marked.all()} == {"7"}
    kinds = {node.evaluate("n => n.tagName.toLowerCase()") for node in marked.all()}
    assert kinds == {"tr", "rect", "circle"}
    words = page.text_content("#picked")
    assert words.startswith("Reading 8: short tool")
    bar = page.locator("#residual-bars rect.picked title").text_content()
    assert bar.startswith("reading 8:")


def test_a_reading_is_touched_in_the_drawing(opened, result):
    page = opened(390, has_touch=True)
    canvas = page.locator("#scene")
    canvas.scroll_into_view_if_needed()
    everything, tips = _points(result)
    radius = np.linalg.norm(np.ptp(everything, axis=0)) / 2.0
    width, height = page.evaluate("[scene.clientWidth, scene.clientHeight]")
    azimuth = float(canvas.get_attribute("data-azimuth"))
    elevation = float(canvas.get_attribute("data-elevation"))
    drawn = np.array([_seen_from(everything, t, azimuth, elevation) for t in tips])
    drawn *= 0.46 * min(width, height) / radius
    apart = np.linalg.norm(drawn[:, None] - drawn[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    loneliest = int(np.argmax(apart.min(axis=1)))
    box = canvas.bounding_box()
    right, up = drawn[loneliest]
    x, y = box["x"] + width / 2.0 + right, box["y"] + height / 2.0 - up
    page.touchscreen.tap(x, y)
    assert canvas.get_attribute("data-picked") == str(loneliest)


def test_the_magnification_of_a_circle_can_be_changed(opened):
    page = opened(1440)
    chart = page.locator("#polars .chart").first
    assert chart.count() == 1

    def farthest() -> float:
        """Largest distance of a mark from the circle, drawn units."""
        marks = chart.locator("circle.mark").evaluate_all(
            "ms => ms.map(m => [+m.getAttribute('cx') - 150, +m.getAttribute('cy') - 150])"
        )
        return max(abs(math.hypot(*mark) - 86.0) for mark in marks)

    assert farthest() == pytest.approx(40.0, abs=0.5)
    chart.locator("input[type=range]").fill("4")
    assert farthest() == pytest.approx(20.0, abs=0.5)


def test_the_error_map_is_drawn_with_its_scale(opened, result):
    page = opened(1440)
    page.select_option("#field", label="error of z")
    page.select_option("#state", "before")
    sizes = [point.before["z"] for point in result.prediction.map]
    words = page.text_content("#ramp")
    assert f"{max(sizes):.3g}".rstrip("0") in words
    assert "µm" in words


def test_a_page_of_a_bare_result_has_no_view(browser, tmp_path):
    (path,) = write_report(result_of(report_fixture.bare()), tmp_path, pdf=False)
    page = browser.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(path.as_uri())
    assert page.locator("#view").count() == 0
    assert errors == []
    page.close()
