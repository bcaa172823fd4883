"""The report's chapter on the gap: sound for every verdict, its figures legible."""

import re
from typing import Any

import gap_fixture
import msgspec
import pytest
import report_fixture
from matplotlib.figure import Figure
from msgspec.structs import replace
from report_fixture import check_inside, result_of, text_of
from sketches import Sketches

from oed.result import AnswerRecord, GapSection, StudyResult, Trace
from pkm_reports import missing, sections, style, text, write_report
from pkm_reports.page import Document, document
from pkm_reports.sections import gap as chapter
from pkm_reports.sections import gap_figures
from pkm_studies.base import Silent
from pkm_studies.stages import RunState
from pkm_studies.stages.gap.diagnosis import gap_section
from pkm_studies.study import Study

pytestmark = pytest.mark.pictures


@pytest.fixture(scope="module")
def gap(tmp_path_factory: pytest.TempPathFactory) -> GapSection:
    """The gap of the diagnosis by hand, as it comes back from result.json."""
    path = gap_fixture.written(tmp_path_factory.mktemp("gap"))
    diagnosis = gap_fixture.diagnosis(gap_fixture.problem(path))
    effects = RunState.start(Study.load(path), 3, Silent(), None).resolved.gap.effects
    section = gap_section(diagnosis, effects)
    return msgspec.json.decode(msgspec.json.encode(section), type=GapSection)


def _result(gap: GapSection | dict[str, Any]) -> StudyResult:
    """A result that holds nothing but the machine and a diagnosis."""
    return result_of(report_fixture.bare() | {"gap": gap})


# -- chapter ---------------------------------------------------------------------------
def test_the_chapter_is_there_only_where_there_is_a_diagnosis(gap):
    assert sections.chapters(_result(gap))[-1].anchor == "gap"
    without = sections.chapters(result_of(report_fixture.bare()))
    assert "gap" not in [section.anchor for section in without]


def test_the_page_has_findings_causes_places_and_closure(gap, tmp_path):
    page, book = write_report(_result(gap), tmp_path)
    assert book.read_bytes().startswith(b"%PDF")
    source = page.read_text(encoding="utf-8")
    shown = " ".join(text_of(source).replace("\N{NO-BREAK SPACE}", " ").split())
    for words in (
        "The residual error comes from backlash or friction (probability 98 %)",
        "If it is backlash: preload the screws",
        "96 % 91 % to 99 %",  # closure within runs, with its interval
        "stretches of runs",
        "These readings cannot tell the effects of a group from one another",
        "temp_frame_C",
        "leg 2 90 % 0.0020",
    ):
        assert words in shown, words
    assert "nan" not in shown.lower().split()
    assert source.count('class="picture"') == 4


@pytest.mark.parametrize("verdict", ["none", "unknown", "class", "mixture"])
def test_every_verdict_has_a_page(gap, verdict, monkeypatch):
    """Its figures are drawn and not written."""
    monkeypatch.setattr(document, "drawn_image", lambda p: Sketches()(p))
    section = replace(gap, verdict=verdict)
    if verdict in ("none", "unknown"):
        section = _without_effects(section)
    report = Document.from_result(_result(section))
    page = report.html()
    assert page.rstrip().endswith(b"</html>")
    assert report.pdf().startswith(b"%PDF")
    explained_by_noise = "no effect: noise alone" in text_of(page.decode())
    assert explained_by_noise == (verdict in ("none", "class", "mixture"))


def _without_effects(gap: GapSection) -> GapSection:
    """A diagnosis that found no effect: all of the gap has an unknown form, or none."""
    effects = ["unknown"] if gap.verdict == "unknown" else []
    traces = [
        replace(
            trace,
            explained=[0.0] * len(trace.at),
            after=trace.before,
            unexplained=trace.before,
        )
        for trace in gap.traces
    ]
    return replace(
        gap,
        answers=[AnswerRecord(effects, 0.9)],
        selected=[],
        sizes=[],
        coefficients=[],
        closure=[],
        confusable=[],
        next=[],
        traces=traces,
    )


def test_nothing_but_the_contract_s_own_keys_is_needed(gap):
    stored = msgspec.to_builtins(gap)
    contract = (
        "verdict", "answers", "set95", "where", "closure", "not_testable", "confusable",
    )  # fmt: skip
    old = {key: stored[key] for key in contract}
    assert Document.from_result(_result(old)).pdf().startswith(b"%PDF")


# -- tables ----------------------------------------------------------------------------
def test_the_largest_coefficient_stands_first(gap):
    (table,) = chapter._coefficients(gap)
    names = ["leg 2", "leg 3", "leg 1"]
    assert [row[1] for row in table.rows] == [f"{name} [µm]" for name in names]
    assert float(table.rows[0][-1].split()[0]) == pytest.approx(3.0, abs=0.1)


def test_a_coefficient_without_an_expected_size_has_none(gap):
    unknown = [replace(c, prior_sd=None) for c in gap.coefficients]
    (table,) = chapter._coefficients(replace(gap, coefficients=unknown))
    assert {row[-1] for row in table.rows} == {text.MISSING}


def test_one_of_many_is_not_named_before_the_others():
    few, many = ["friction", "backlash"], ["step", *(f"effect_{k}" for k in range(6))]
    answer = AnswerRecord(["friction", "step", "unknown"], 0.4, [few, many])
    explanation, percent, others = chapter.explanation_row(answer)
    assert explanation == "friction, one of 7 and an effect of unknown form"
    assert percent == text.percent(0.4)
    assert others.startswith("backlash, step, effect 0")


def test_the_set_is_shown_where_it_has_more_than_one(gap):
    likely = AnswerRecord(["friction"], 0.97, [["friction"]])
    other = AnswerRecord(["step"], 0.03, [["step"]])
    bare = replace(gap, answers=[likely, other], sizes=[])
    assert len(chapter.explanation_blocks(replace(bare, set95=[likely]))) == 1
    assert len(chapter.explanation_blocks(replace(bare, set95=[likely, other]))) == 2
    assert not chapter.explanation_blocks(replace(bare, answers=[]))


# -- figures ---------------------------------------------------------------------------
def test_figures_without_data_say_so(gap):
    with style.applied():
        for figure in (gap_figures.draw_traces([]), chapter.draw_map([], "um")):
            assert not figure.axes
            assert re.search(r"No .* are stored", figure.texts[0].get_text())
        assert "No run" in chapter.draw_circles([]).texts[0].get_text()
        empty = gap_figures.draw_effects(replace(gap, marginal={}))
        assert "No effect" in empty.texts[0].get_text()


def test_figures_keep_all_words_inside(gap):
    with style.applied():
        for figure in _figures(gap):
            check_inside(figure)


def _figures(gap: GapSection) -> list[Figure]:
    return [
        gap_figures.draw_effects(gap),
        gap_figures.draw_traces(gap.traces),
        chapter.draw_circles(gap.traces),
        chapter.draw_map(gap.spots, gap.spots_unit),
    ]


def test_the_likeliest_cause_is_at_the_top_and_coloured(gap):
    marginal = {f"effect_{k:02d}": 0.01 * k for k in range(14)} | {"backlash": 0.98}
    with style.applied():
        bars, sizes = gap_figures.draw_effects(replace(gap, marginal=marginal)).axes
    labels = [label.get_text() for label in bars.get_yticklabels()]
    assert labels[:2] == ["backlash", "effect 13"]
    assert len(labels) == gap_figures.MAX_EFFECTS
    first, second = bars.patches[:2]
    assert first.get_width() == pytest.approx(98.0)
    assert first.get_facecolor() != second.get_facecolor()
    rms = gap.sizes[0].rms["length"]
    assert sizes.patches[0].get_width() == pytest.approx(rms)


def _scaled(trace: Trace, k: int) -> Trace:
    """Run `rk`, with larger residuals where k mod 5 is larger."""
    before = [value * (1 + k % 5) for value in trace.before]
    return replace(trace, run=f"r{k}", before=before)


def test_only_the_runs_with_the_largest_residuals_are_drawn(gap):
    many = [_scaled(gap.traces[0], k) for k in range(20)]
    shown = [trace.run for trace in gap_figures.choose_traces(many)]
    assert len(shown) == gap_figures.MAX_TRACES
    largest = ["r4", "r9", "r14", "r19"]
    assert [run for run in shown if run in largest] == largest
    assert "r0" not in shown
    with style.applied():
        panels = [
            axes for axes in gap_figures.draw_traces(many).axes if axes.get_visible()
        ]
    assert len(panels) == gap_figures.MAX_TRACES


def test_both_ways_of_a_circle_share_a_panel(gap):
    passes = chapter.gap_circles(gap.traces).values()
    directions = [[trace.direction for trace in runs] for runs in passes]
    assert directions == [[1, -1], [1, -1]]
    with style.applied():
        figure = chapter.draw_circles(gap.traces)
    entries = [entry.get_text() for entry in figure.legends[0].get_texts()]
    assert entries == ["forward", "backward"]
    lines = {line.get_label(): line for line in figure.axes[0].lines}
    before = missing.array(gap.traces[0].before)
    largest = max(abs(value) for trace in gap.traces[:2] for value in trace.before)
    radius = 1.0 + chapter.SWING * before / largest
    drawn = list(lines["forward"].get_ydata())[: len(before)]
    assert drawn == pytest.approx(radius.tolist())


def test_a_machine_in_a_plane_has_one_view_and_one_in_space_two():
    flat = missing.table([[0.0, 10.0 * k, 100.0 * (k % 3)] for k in range(9)])
    assert chapter.map_views(flat) == [(1, 2)]
    solid = missing.table(
        [[300.0 * (k % 2), 10.0 * k, 100.0 * (k % 3)] for k in range(9)]
    )
    assert chapter.map_views(solid) == [(0, 1), (0, 2)]


def test_what_is_too_small_to_be_seen_is_said_to_be():
    for unseen, words in (
        (0.0, "an effect of unknown form"),
        (0.13, "an effect too small for these readings to show"),
    ):
        answer = AnswerRecord(("unknown",), 0.13, (), unseen)
        assert chapter.explanation_row(answer)[0] == words


def test_no_gap_closes_by_more_than_all_of_it(gap):
    """Held-out readings that lie closer than the noise expects leave no less than none."""
    closer = replace(gap.closure[0], value=1.24, low=0.7, high=1.31)
    (table,) = chapter._closure(replace(gap, closure=[closer]))
    cells = [cell.replace("\N{NO-BREAK SPACE}", " ") for cell in table.rows[0]]
    assert cells[2:4] == ["all of it", "70 % to over 100 %"]


def test_no_closure_is_reported_where_no_effect_is(gap):
    assert chapter._closure(gap)
    assert not chapter._closure(replace(gap, verdict="none"))


def test_a_caption_names_the_part_of_no_known_form_only_where_it_is_drawn():
    plain = Trace(
        setup="bar", run="1", base="1", channel="length", unit="um", kind="points",
        at=[0.0, 1.0], before=[1.0, -1.0], explained=[0.0, 0.0], unexplained=[0.0, 0.0],
        after=[1.0, -1.0],
    )  # fmt: skip
    assert "pink" not in chapter._trace_caption([plain])
    assert "pink" in chapter._trace_caption(
        [plain, replace(plain, unexplained=[0.0, 2.0])]
    )
