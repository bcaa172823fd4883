"""Reports: both files whole, self-contained, escaped, the same each time, and sound
where parts are missing.
"""

from __future__ import annotations

import html
import json
import os
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib.style
import msgspec
import pytest
import report_fixture
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from oed.result import StudyResult
from pkm_reports import document, sections, style, words, write_report
from pkm_reports import html as html_writer
from pkm_reports import pdf as pdf_writer
from pkm_reports.figures import (
    accuracy,
    budget,
    compared,
    corner,
    held_out,
    how_many,
    kappa,
    machine,
    parameters,
    path,
    predicted,
    residuals,
    robust,
    singular,
    workspace,
)

NASTY = '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$ \u202e 漢 \x00 {{ 1 }} </script>'
VOID = {"meta", "img", "link", "br", "hr", "input"}


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_report(
        _stored(report_fixture.sample()),
        tmp_path_factory.mktemp("report") / "new folder",
    )


def _stored(result: dict[str, Any]) -> dict[str, Any]:
    """The result as it comes back from result.json."""
    decoded: dict[str, Any] = json.loads(msgspec.json.encode(result))
    return decoded


def _shown(page: str) -> str:
    """Text of a page without tags, entities resolved."""
    return html.unescape(re.sub(r"<[^>]*>", " ", page))


class Tags(HTMLParser):
    """Collects tags with attributes; raises on a tag closed out of order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize(
    "build", [report_fixture.sample, report_fixture.bare, report_fixture.delta]
)
def test_fixture_conforms_to_the_schema(build: Callable[[], dict[str, Any]]) -> None:
    raw = build()
    for entry in raw[
        "kappa_maps"
    ]:  # NaN is stored as null, which the schema's floats refuse
        entry["kappa"] = [
            [1e9 if k is None else k for k in row] for row in entry["kappa"]
        ]
    decoded = msgspec.json.decode(msgspec.json.encode(raw), type=StudyResult)
    assert len(decoded.machine.parameters) == 18


def test_both_files_are_whole(full: tuple[Path, Path]) -> None:
    page, book = full
    assert page.name == "report.html"
    assert page.read_bytes().rstrip().endswith(b"</html>")
    assert book.name == "report.pdf"
    assert book.read_bytes().startswith(b"%PDF")
    assert b"%%EOF" in book.read_bytes()[-32:]
    assert sorted(p.name for p in page.parent.iterdir()) == [
        "report.html",
        "report.pdf",
    ]


def test_page_is_small_and_loads_nothing(full: tuple[Path, Path]) -> None:
    page = full[0].read_text(encoding="utf-8")
    assert len(page) < 3_000_000
    tags = Tags(page)
    assert not tags.open
    assert not {tag for tag, _ in tags.found} & {
        "script",
        "link",
        "iframe",
        "object",
        "embed",
    }
    for tag, attributes in tags.found:
        for name in ("src", "href", "srcset", "poster"):
            value = attributes.get(name) or ""
            assert value.startswith(("data:image/", "#")) or not value, (
                tag,
                value[:60],
            )
    assert not re.search(r"url\(|@import", page)


def test_every_heading_is_there_and_linked(full: tuple[Path, Path]) -> None:
    page = full[0].read_text(encoding="utf-8")
    headings = [_shown(h).strip() for h in re.findall(r"<h2>(.*?)</h2>", page)]
    assert headings == [
        f"{k} {chapter.TITLE}" for k, chapter in enumerate(sections.CHAPTERS, 1)
    ]
    anchors = set(re.findall(r'id="([^"]+)"', page))
    assert {target for target in re.findall(r'href="#([^"]+)"', page)} <= anchors


def test_the_question_and_the_answers_come_first(full: tuple[Path, Path]) -> None:
    result, shown = (
        report_fixture.sample(),
        _shown(full[0].read_text(encoding="utf-8").partition("<h2>")[0]),
    )
    for text in (
        result["title"],
        result["question"],
        *result["headline"],
        *[c["claim"] for c in result["claims"]],
    ):
        assert text in shown
    assert "not met" in shown


def test_every_figure_has_a_caption_with_a_number(full: tuple[Path, Path]) -> None:
    page = full[0].read_text(encoding="utf-8")
    figures = re.findall(r'<figure class="picture">.*?</figure>', page, re.DOTALL)
    assert len(figures) == 15
    for k, figure in enumerate(figures, 1):
        caption = _shown(figure.partition("<figcaption>")[2])
        assert f"Figure {k}." in caption
        assert re.search(r"\d", caption.partition(".")[2])
        assert 'alt="' in figure


def test_the_study_file_and_the_seed_are_shown(full: tuple[Path, Path]) -> None:
    page = full[0].read_text(encoding="utf-8")
    assert report_fixture.TEXT.strip() in html.unescape(page)
    assert "20240607" in page
    assert "<tags>" not in page


def test_the_same_result_gives_the_same_page(
    full: tuple[Path, Path], tmp_path: Path
) -> None:
    page, book = write_report(_stored(report_fixture.sample()), tmp_path)
    assert page.read_bytes() == full[0].read_bytes()
    assert book.read_bytes() == full[1].read_bytes()


def test_users_settings_change_nothing(tmp_path: Path) -> None:
    result = {**report_fixture.bare(), "drawing": report_fixture.sample()["drawing"]}
    plain = html_writer.render(document.build(result))
    with matplotlib.style.context(
        {"font.size": 30.0, "axes.grid": False, "text.usetex": False}
    ):
        assert html_writer.render(document.build(result)) == plain


def test_nothing_but_the_heads_is_needed(tmp_path: Path) -> None:
    page, book = write_report(_stored(report_fixture.bare()), tmp_path)
    assert book.stat().st_size > 1000
    shown = _shown(page.read_text(encoding="utf-8"))
    assert shown.count("was not part of this study") == 7
    assert "makes no claims" in shown


@pytest.mark.parametrize(
    "missing",
    [
        "versions",
        "question",
        "headline",
        "held_out",
        "claims",
        "warnings",
        "seconds",
        "title",
    ],
)
def test_a_result_of_an_older_version_lacks_a_key(missing: str) -> None:
    result = report_fixture.bare()
    result.pop(missing, None)
    assert pdf_writer.render(document.build(result)).startswith(b"%PDF")


def test_text_of_the_study_is_never_markup(tmp_path: Path) -> None:
    result = _stored(report_fixture.sample())
    result |= {
        "title": NASTY,
        "question": NASTY,
        "headline": [NASTY],
        "warnings": [NASTY],
        "study_text": NASTY,
    }
    result["claims"][0]["claim"] = NASTY
    result["drawing"]["reading_of"] = [NASTY] * 30
    result["kappa_maps"][0]["title"] = NASTY
    result["estimate"]["parameters"] = {NASTY: result["estimate"]["parameters"]["dq1"]}
    result["posterior"]["directions"] = [NASTY, "$a$", "b", "c", "d"]
    result["held_out"][0]["name"] = NASTY
    for key in ("setup", "run"):
        result["design"]["poses"][0][key] = NASTY
    design = result["design"]
    design |= {
        "words": NASTY,
        "setups": [NASTY],
        "refused": {NASTY: 2},
        "criterion": NASTY,
    }
    design["plans"][1]["name"] = design["compared"][1]["name"] = NASTY
    design["polished"] |= {"words": NASTY, "setups": {NASTY: {NASTY: 1.0}}}
    design["order"]["setups"] = [NASTY, "b"]
    design["how_many"] |= {"words": NASTY, "accuracy": {NASTY: [1.0] * 6}}
    page, book = write_report(result, tmp_path)
    text = page.read_text(encoding="utf-8")
    assert "<b>&" not in text
    assert "</script>" not in text
    assert '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$' in html.unescape(text)
    assert not Tags(text).open
    assert book.read_bytes().startswith(b"%PDF")


EMPTY: list[tuple[Callable[[Any], Figure], Any]] = [
    (machine.draw, {"lines": [], "tool_points": [], "reading_of": [], "bars": []}),
    (
        kappa.draw,
        [{"title": "t", "circles": [2], "points": [3, 4], "kappa": [[None, None]]}],
    ),
    (singular.draw, {"singular_values": [], "rank": 0, "n": 0, "tolerance": 1e-9}),
    (parameters.draw, {}),
    (residuals.draw, {"residuals": [], "residuals_before": [], "unit": "um"}),
    (corner.draw, {"directions": [], "corner": []}),
    (accuracy.draw, {"components": {}}),
    (budget.draw, {"x": {"budget": {}}}),
    (workspace.draw, {"components": {}, "map": []}),
    (held_out.draw, [{"residuals": []}]),
    (compared.draw, {"compared": []}),
    (predicted.draw, [{"name": "chosen"}]),
    (path.draw, [{"setup": "a", "command": {}}]),
    (robust.draw, {"values": [None], "nominal_values": []}),
    (how_many.draw, {"sizes": [10, 20], "accuracy": {"z_um": [None, None]}}),
]


@pytest.mark.parametrize(
    ("draw", "part"),
    EMPTY,
    ids=[draw.__module__.rpartition(".")[2] for draw, _ in EMPTY],
)
def test_a_figure_without_data_says_so(
    draw: Callable[[Any], Figure], part: Any
) -> None:
    with style.applied():
        figure = draw(part)
        assert not figure.axes
        assert re.search(r"No .* (is|are) stored", figure.texts[0].get_text())
        assert style.render(figure).kind == "svg"


@pytest.mark.parametrize("build", [report_fixture.sample, report_fixture.delta])
def test_figures_keep_all_words_inside(build: Callable[[], dict[str, Any]]) -> None:
    result = build()
    parts: list[tuple[Callable[[Any], Figure], Any]] = [
        (machine.draw, result["drawing"]),
        (singular.draw, result["identifiability"]),
        (parameters.draw, result["estimate"]["parameters"]),
        (accuracy.draw, result["prediction"]),
        (budget.draw, result["prediction"]["components"]),
        (workspace.draw, result["prediction"]),
        (compared.draw, result["design"]),
        (predicted.draw, result["design"]["plans"]),
        (path.draw, result["design"]["poses"]),
        (robust.draw, result["design"]["robust"]),
        (how_many.draw, result["design"]["how_many"]),
    ]
    with style.applied():
        for draw, part in parts:
            _check_inside(draw(part))


def _check_inside(figure: Figure) -> None:
    """Nothing drawn reaches beyond the figure; of 3-D axes only their frame and labels
    are asked.
    """
    figure.draw_without_rendering()
    renderer: Any = FigureCanvasAgg(figure).get_renderer()
    for axes in figure.axes:
        solid = isinstance(axes, Axes3D)
        parts = (axes.xaxis, axes.yaxis, axes.zaxis) if solid else (axes,)
        for box in [part.get_tightbbox(renderer) for part in parts]:
            assert box is not None
            assert min(box.x0, box.y0) > -2.0
            assert box.x1 < figure.bbox.width + 2.0
            assert box.y1 < figure.bbox.height + 2.0


def test_a_plan_of_other_machines_is_drawn() -> None:
    spots = [
        {
            "command": {"z_mm": float(k), "a_deg": 2.0 * k},
            "before": {"z": 1.0},
            "after": {"z": 0.1 * k},
        }
        for k in range(5)
    ]
    one = [
        {
            "command": {"z_mm": s["command"]["z_mm"]},
            "before": s["before"],
            "after": s["after"],
        }
        for s in spots
    ]
    part = report_fixture.delta()["prediction"]
    with style.applied():
        for points in (spots, one):
            drawn = workspace.draw(
                {
                    "components": {"z": part["components"]["z"]},
                    "unit": {"z": "um"},
                    "map": points,
                }
            )
            assert drawn.axes


def test_a_figure_of_many_marks_becomes_pixels(tmp_path: Path) -> None:
    result = _stored(report_fixture.bare())
    result["estimate"] = report_fixture.sample()["estimate"]
    values = [float(k % 17) for k in range(6000)]
    result["estimate"] |= {
        "residuals": values,
        "residuals_before": values,
        "channels": ["length"] * 6000,
    }
    made = document.build(result)
    assert made.images["residuals"].kind == "png"
    assert b"data:image/png" in html_writer.render(made)
    assert pdf_writer.render(made).startswith(b"%PDF")


def test_a_failed_write_leaves_the_old_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "report.html").write_text("old")

    def fail(*_: Any) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="disk full"):
        write_report(report_fixture.bare(), tmp_path)
    assert os.listdir(tmp_path) == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "old"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (None, "–"),
        (float("inf"), "∞"),
        (3748.2, "3748"),
        (0.00124, "0.00124"),
        (-58.684, "−58.7"),
        (9.996, "10.0"),
        (18, "18"),
        (3.2e-7, "3.2×10⁻⁷"),
        (1e-9, "10⁻⁹"),
        (True, "–"),
    ],
)
def test_numbers_as_a_person_writes_them(value: Any, text: str) -> None:
    assert words.num(value) == text


def test_words() -> None:
    assert words.heading("z_mm") == "z [mm]"
    assert words.heading("theta_deg") == "theta [°]"
    assert words.heading("order") == "order"
    assert words.quantity(5.2, "um") == "5.20\N{NO-BREAK SPACE}µm"
    assert words.labelled("psi_deg", 30.0) == "psi\N{NO-BREAK SPACE}30°"
    assert words.plain(0.5) == "0.5"
    assert words.plain(1000.0) == "1000"
    assert words.percent(0.9767) == "98\N{NO-BREAK SPACE}%"
    assert words.column([0.0, 24.0, None, 33.8908]) == [
        "0.0000",
        "24.0000",
        "–",
        "33.8908",
    ]
    assert words.listing(["a", "b", "c"]) == "a, b and c"
    assert words.combination({"a": -0.5, "b": 1.0}) == "b − 0.5\N{NO-BREAK SPACE}a"
    assert words.fixed(-0.0001, 2) == "0.00"
    assert words.certain(0.99999) == "99.9\N{NO-BREAK SPACE}%"
    assert words.certain(0.973) == "97.3\N{NO-BREAK SPACE}%"
    assert words.parted("psi_arcsec") == ("psi", "arcsec")
    assert words.parted("no_unit") == ("no unit", "")
    assert words.factor(3.046) == "3.05×"
