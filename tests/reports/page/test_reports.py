"""Reports: complete, self-contained and escaped files, also where sections are missing."""

import base64
import hashlib
import html
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib.style
import pytest
import report_fixture
from report_fixture import result_of, shown_text, text_of

from oed import safe_files
from oed.result import StudyResult
from pkm_reports import sections, style, write_report
from pkm_reports.blocks import Picture
from pkm_reports.page import Document, document
from pkm_studies import result_folder
from pkm_studies.results import load_result

pytestmark = pytest.mark.pictures

NASTY = '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$ \u202e 漢 \x00 {{ 1 }} </script>'
VOID = {"meta", "img", "link", "br", "hr", "input"}
LOADING_TAGS = {"link", "iframe", "object", "embed"}
LOADING_ATTRIBUTES = ("src", "href", "srcset", "poster")
SAMPLES = [report_fixture.sample, report_fixture.bare, report_fixture.delta]
#: keys that results of older versions lack
NEWER_KEYS = [
    "title", "question", "study_text", "versions", "headline", "setups", "held_out",
    "claims", "warnings", "identifiability_of", "kappa_maps", "gap", "gap_before",
]  # fmt: skip


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    folder = tmp_path_factory.mktemp("report") / "new folder"
    return write_report(result_of(report_fixture.sample()), folder)


@pytest.fixture
def result() -> StudyResult:
    """The whole sample."""
    return result_of(report_fixture.sample())


class Tags(HTMLParser):
    """Collects tags with attributes; raises on a tag closed out of order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


# -- files -----------------------------------------------------------------------------
@pytest.mark.parametrize("build", SAMPLES)
def test_fixture_conforms_to_the_schema(build):
    assert len(result_of(build()).machine.parameters) == 18


def test_both_files_are_whole(full):
    page, book = full
    assert page.name == "report.html"
    assert page.read_bytes().rstrip().endswith(b"</html>")
    assert book.name == "report.pdf"
    assert book.read_bytes().startswith(b"%PDF")
    assert b"%%EOF" in book.read_bytes()[-32:]
    files = sorted(p.name for p in page.parent.iterdir())
    assert files == [safe_files.LIST_NAME, "report.html", "report.pdf"]


def test_page_is_small_and_loads_nothing(full):
    page = full[0].read_text(encoding="utf-8")
    assert len(page) < 3_000_000
    parsed = Tags(page)
    assert not parsed.open
    assert not {tag for tag, _ in parsed.tags} & LOADING_TAGS
    for tag, attributes in parsed.tags:
        for name in LOADING_ATTRIBUTES:
            value = attributes.get(name) or ""
            local = value.startswith(("data:image/", "#"))
            assert local or not value, (tag, value[:60])
    assert not re.search(r"url\(|@import", page)


def test_only_the_script_of_the_package_runs(full):
    """By its digest; the data for the views are no script."""
    page = full[0].read_text(encoding="utf-8")
    allowed = re.findall(r"script-src 'sha256-([^']*)'", page)
    bodies = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digests = [hashlib.sha256(body.encode()).digest() for body in bodies]
    assert [base64.b64encode(digest).decode() for digest in digests] == allowed
    assert len(bodies) == 1
    others = re.findall(r"<script ([^>]*)>", page)
    assert others == ['type="application/json" id="view-data"']
    assert "default-src 'none'" in page


def test_every_heading_is_there_and_linked(full):
    page = full[0].read_text(encoding="utf-8")
    chapters = page.partition('class="chapter"')[2]
    headings = re.findall(r"<h2>(.*?)</h2>", chapters)
    result = result_of(report_fixture.sample())
    titles = [section.title for section in sections.chapters(result)]
    expected = [f"{k} {title}" for k, title in enumerate(titles, 1)]
    expected += ["A Claims", "B Record"]
    # A space parts number and title even where tags are dropped.
    assert [re.sub(r"<[^>]*>", "", heading) for heading in headings] == expected
    anchors = set(re.findall(r'id="([^"]+)"', page))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= anchors


def test_the_question_and_the_answers_come_first(full, result):
    first, _, rest = full[0].read_text(encoding="utf-8").partition('class="chapter"')
    shown, appendix = text_of(first), text_of(rest)
    parts = [part.title for part in sections.answer_parts(result)]
    for words in (result.title, result.question, *parts):
        assert words in shown
    claims = [claim.claim for claim in result.claims]
    for words in claims:
        assert words in appendix
    assert "misses a claim: spindle axis, rms [arcsec]" in shown


def test_every_figure_has_a_caption_with_a_number(full):
    page = full[0].read_text(encoding="utf-8")
    figures = re.findall(r'<figure class="picture">.*?</figure>', page, re.DOTALL)
    assert len(figures) == 16
    for k, figure in enumerate(figures, 1):
        caption = text_of(figure.partition("<figcaption>")[2])
        assert f"Figure {k}." in caption
        assert re.search(r"\d", caption.partition(".")[2])
        assert 'alt="' in figure


def test_the_study_file_and_the_seed_are_shown(full):
    page = full[0].read_text(encoding="utf-8")
    assert report_fixture.TEXT.strip() in html.unescape(page)
    assert "20240607" in page
    assert "<tags>" not in page


def test_users_settings_change_nothing(tmp_path):
    drawing = report_fixture.sample()["drawing"]
    drawn = result_of(report_fixture.bare() | {"drawing": drawing})
    expected = Document.from_result(drawn).html()
    settings = {"font.size": 30.0, "axes.grid": False, "text.usetex": False}
    with matplotlib.style.context(settings):
        assert Document.from_result(drawn).html() == expected


def test_a_failed_write_leaves_the_old_report(tmp_path, monkeypatch):
    (tmp_path / "report.html").write_text("old")

    def fail(*_: Any) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="disk full"):
        write_report(result_of(report_fixture.bare()), tmp_path)
    assert os.listdir(tmp_path) == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "old"


# -- missing sections and older results ------------------------------------------------
def test_a_report_needs_no_optional_section(tmp_path):
    page, book = write_report(result_of(report_fixture.bare()), tmp_path)
    assert book.stat().st_size > 1000
    shown = text_of(page.read_text(encoding="utf-8"))
    headings = re.findall(r"<h2><span>\w+</span> (.*?)</h2>", page.read_text("utf-8"))
    assert headings == ["Machine and plan", "Record"]
    assert "not part of this study" not in shown


@pytest.mark.parametrize("missing", NEWER_KEYS)
def test_a_result_of_an_older_version_lacks_a_key(missing):
    raw = report_fixture.bare()
    raw.pop(missing, None)
    report = Document.from_result(result_of(raw))
    assert report.pdf().startswith(b"%PDF")


def test_a_result_file_of_an_older_version_still_loads(tmp_path):
    """With nothing but the contract's own keys at the top."""
    full = report_fixture.sample()
    keys = ("schema", "version", "study", "seed", "seconds", "machine", "design")
    old = {key: full[key] for key in keys}
    file = tmp_path / "result.json"
    file.write_text(json.dumps(old), encoding="utf-8")
    loaded = load_result(tmp_path)
    assert loaded.design.value == full["design"]["value"]
    assert (loaded.headline, loaded.claims, loaded.gap) == ([], [], None)
    result_folder.write_report(tmp_path, pdf=False)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "How good the plan is" in page
    assert "Residual accuracy" not in page


def test_a_parameter_that_is_not_sampled_has_no_diagnostics():
    """Its R-hat and effective sample size are null in the file."""
    raw = report_fixture.bare() | {"posterior": report_fixture.sample()["posterior"]}
    raw["posterior"]["marginals"]["dq1"] |= {"rhat": None, "ess": None}
    shown = shown_text(result_of(raw))
    assert "Every marginal is well sampled" in shown
    assert "nan" not in shown.split()


def test_independent_draws_have_no_diagnostics_of_chains():
    raw = report_fixture.bare() | {"posterior": report_fixture.sample()["posterior"]}
    raw["posterior"] |= {
        "sampler": "importance",
        "pareto_k": 0.18,
        "proposals": 1600,
        "draws": 1200,
        "acceptance": None,
        "walkers": 0,
        "autocorrelation": None,
    }
    for marginal in raw["posterior"]["marginals"].values():
        marginal["rhat"] = None
    shown = shown_text(result_of(raw))
    assert "1200 draws: 1600 independent points" in shown
    assert "Pareto k = 0.18; up to 0.69" in shown
    assert "Every marginal is well sampled" in shown
    for word in ("R-hat", "walker", "autocorrelation time", "accepted", "mixed"):
        assert word not in shown
    raw["posterior"] |= report_fixture.sample()["posterior"]
    raw["posterior"] |= {"sampler": "emcee", "pareto_k": 0.93}
    assert "Pareto k = 0.93 (reliable up to 0.69)" in shown_text(result_of(raw))


# -- names are never markup ------------------------------------------------------------
def _with_nasty_names() -> dict[str, Any]:
    raw = report_fixture.sample()
    raw |= {"title": NASTY, "question": NASTY, "study_text": NASTY}
    raw |= {"headline": [NASTY], "warnings": [NASTY]}
    raw["claims"][0]["claim"] = NASTY
    raw["drawing"]["reading_of"] = [NASTY] * 30
    raw["kappa_maps"][0]["title"] = NASTY
    raw["estimate"]["parameters"] = {NASTY: raw["estimate"]["parameters"]["dq1"]}
    raw["posterior"]["directions"] = [NASTY, "$a$", "b", "c", "d"]
    raw["held_out"][0]["name"] = NASTY
    design = raw["design"]
    design["poses"][0] |= {"setup": NASTY, "run": NASTY}
    design |= {"words": NASTY, "setups": [NASTY], "criterion": NASTY}
    design["refused"] = {NASTY: 2}
    design["plans"][1]["name"] = design["compared"][1]["name"] = NASTY
    design["polished"] |= {"words": NASTY, "setups": {NASTY: {NASTY: 1.0}}}
    design["order"]["setups"] = [NASTY, "b"]
    design["how_many"] |= {"words": NASTY, "accuracy": {NASTY: [1.0] * 6}}
    return raw


def test_text_of_the_study_is_never_markup(tmp_path, monkeypatch):
    monkeypatch.setattr(document, "drawn_image", report_fixture.sketched)
    page, book = write_report(result_of(_with_nasty_names()), tmp_path)
    source = page.read_text(encoding="utf-8")
    assert "<b>&" not in source
    assert source.count("</script>") == 2
    assert '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$' in html.unescape(source)
    assert not Tags(source).open
    assert book.read_bytes().startswith(b"%PDF")


def test_a_print_alone_draws_none_of_the_screens_pictures(monkeypatch):
    drawn: list[str] = []

    def sketch(picture: Picture) -> style.Image:
        drawn.append(picture.name)
        return report_fixture.sketched(picture)

    monkeypatch.setattr(document, "drawn_image", sketch)
    report = Document.from_result(result_of(report_fixture.sample()))
    report.pdf()
    printed = [
        block["name"]
        for section in (*report.printed["answer"], *report.printed["sections"])
        for block in section["blocks"]
        if block["kind"] == "picture"
    ]
    assert sorted(drawn) == sorted(printed)
    report.html()
    assert len(drawn) > len(printed)
    assert len(drawn) == len(set(drawn))  # each once, for print and screen


def test_the_print_is_short(monkeypatch):
    """At most 4 pages for all that a study can ask, in order; in full more."""
    monkeypatch.setattr(document, "drawn_image", report_fixture.sketched)
    report = Document.from_result(result_of(report_fixture.sample()))
    pages = [
        max(int(n) for n in re.findall(rb"/Count (\d+)", report.pdf(full=full)))
        for full in (False, True)
    ]
    assert pages[0] <= 4
    assert pages[1] > 2 * pages[0]
    printed = report.printed["sections"]
    (more,) = [s for s in printed if s["anchor"] == "more"]
    (words,) = [b["text"] for b in more["blocks"] if b["kind"] == "paragraph"]
    shown = [s["title"] for s in printed]
    titles = [s["title"] for s in report.page["sections"]]
    assert all(title in words or title in shown for title in titles)
