"""The report's chapter on the gap: sound for every verdict, whole where parts are
missing, its figures legible.
"""

from __future__ import annotations

import copy
import html
import json
import re
from pathlib import Path
from typing import Any

import gap_fixture
import msgspec
import pytest
import report_fixture
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from oed.gap.data import problem
from pkm_reports import document, sections, style, words, write_report
from pkm_reports import html as html_writer
from pkm_reports import pdf as pdf_writer
from pkm_reports.figures.gap import causes as gap_causes
from pkm_reports.figures.gap import map as gap_map
from pkm_reports.figures.gap import polar as gap_polar
from pkm_reports.figures.gap import trace as gap_trace
from pkm_reports.sections.gap import diagnosis as chapter
from pkm_studies.progress import Silent
from pkm_studies.run_state import start
from pkm_studies.stages.gap.section import gap_section
from pkm_studies.steps.readings import planned_series, simulate_readings
from pkm_studies.study import load

NASTY = '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$ \u202e 漢 \x00 {{ 1 }} </script>'


def test_legs_that_nothing_tells_apart_are_said_to_be(stored: dict[str, Any]) -> None:
    one = {"block": "leg 1", "p_value": 1e-9, "strength": 0.8}
    caption = "Of leg 1 and leg 2 the readings are the same"
    for other, tied in (
        ({"strength": 0.8}, True),
        ({"strength": 0.79}, False),
        ({"p_value": 0.5}, False),
    ):
        gap = {
            **stored,
            "verdict": "effect",
            "where": [one, {**one, "block": "leg 2", **other}],
        }
        assert (caption in str(chapter._places(gap)[0])) == tied


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The gap of the hand-made diagnosis, as it comes back from result.json."""
    path = gap_fixture.written(tmp_path_factory.mktemp("gap"))
    state = start(load(path), path.parent, 3, Silent(), None)
    readings = simulate_readings(state, planned_series(state)).readings
    residuals = problem.assemble(
        state.measurement,
        readings.series,
        readings.covariates,
        readings.truth,
        readings.y,
    )
    diagnosis = gap_fixture.diagnosis(residuals)
    section = gap_section(diagnosis, state.resolved.gap.effects)
    decoded: dict[str, Any] = json.loads(msgspec.json.encode(section))
    return decoded


def _result(gap: dict[str, Any]) -> dict[str, Any]:
    return {
        **json.loads(msgspec.json.encode(report_fixture.bare())),
        "gap": copy.deepcopy(gap),
    }


def _shown(page: str) -> str:
    return html.unescape(re.sub(r"<[^>]*>", " ", page))


def test_the_chapter_comes_first_and_only_where_there_is_a_diagnosis(
    stored: dict[str, Any],
) -> None:
    assert sections.chapters(_result(stored))[0].anchor == "gap"
    assert [s.anchor for s in sections.chapters(report_fixture.bare())].count(
        "gap"
    ) == 0


def test_the_page_tells_findings_causes_places_and_closure(
    stored: dict[str, Any], tmp_path: Path
) -> None:
    page, book = write_report(_result(stored), tmp_path)
    assert book.read_bytes().startswith(b"%PDF")
    shown = " ".join(
        _shown(page.read_text(encoding="utf-8"))
        .replace("\N{NO-BREAK SPACE}", " ")
        .split()
    )
    for text in (
        "The gap comes from backlash (probability 97 %)",
        "Remedy for backlash: preload the screws",
        "96 % 91 % to 99 %",  # closure within runs, with its interval
        "stretches of runs",
        "These readings cannot tell the effects of a group from one another",
        "temp_frame_C",
        "leg 2 0.0020 90 %",
    ):
        assert text in shown, text
    assert "nan" not in shown.lower().split()
    assert page.read_text(encoding="utf-8").count('class="picture"') == 4


def test_the_largest_coefficient_stands_first(stored: dict[str, Any]) -> None:
    (table,) = chapter._coefficients(stored)
    assert [row[1] for row in table.rows] == ["leg 2", "leg 3", "leg 1"]
    assert float(table.rows[0][-1].split()[0]) == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("verdict", ["none", "unknown", "class", "mixture"])
def test_every_verdict_has_a_page(stored: dict[str, Any], verdict: str) -> None:
    gap = copy.deepcopy(stored) | {"verdict": verdict}
    if verdict in ("none", "unknown"):
        gap |= {
            "selected": [],
            "sizes": [],
            "coefficients": [],
            "closure": [],
            "confusable": [],
            "next": [],
        }
        gap["answers"] = [
            {
                "effects": ["unknown"] if verdict == "unknown" else [],
                "probability": 0.9,
                "classes": [],
            }
        ]
        for t in gap["traces"]:
            t |= {
                "explained": [0.0] * len(t["at"]),
                "after": t["before"],
                "unexplained": t["before"],
            }
    made = document.build(_result(gap))
    assert html_writer.render(made).rstrip().endswith(b"</html>")
    assert pdf_writer.render(made).startswith(b"%PDF")
    told = _shown(html_writer.render(made).decode())
    assert ("no gap: noise alone" in told) == (verdict in ("none", "class", "mixture"))


def test_nothing_but_the_contract_s_own_keys_is_needed(stored: dict[str, Any]) -> None:
    kept = (
        "verdict",
        "answers",
        "set95",
        "where",
        "closure",
        "not_testable",
        "confusable",
    )
    made = document.build(_result({k: stored[k] for k in kept} | {"selected": []}))
    assert pdf_writer.render(made).startswith(b"%PDF")


def test_text_of_the_readings_is_never_markup(
    stored: dict[str, Any], tmp_path: Path
) -> None:
    gap = copy.deepcopy(stored)
    for t in gap["traces"]:
        t |= {"setup": NASTY, "run": NASTY, "base": NASTY, "channel": NASTY}
    gap |= {
        "words": [NASTY],
        "next": [NASTY],
        "noise": [NASTY],
        "not_testable": [NASTY],
    }
    gap["where"][0]["block"] = f"run {NASTY}"
    gap["marginal"] = {NASTY: 0.5}
    gap["sizes"][0]["effect"] = gap["coefficients"][0]["name"] = NASTY
    gap["answers"][0]["effects"] = [NASTY]
    page, book = write_report(_result(gap), tmp_path)
    text = page.read_text(encoding="utf-8")
    assert "<b>&" not in text
    assert "</script>" not in text
    assert book.read_bytes().startswith(b"%PDF")


def test_the_same_result_gives_the_same_bytes(stored: dict[str, Any]) -> None:
    first, second = (
        html_writer.render(document.build(_result(stored))) for _ in range(2)
    )
    assert first == second


# -- figures ---------------------------------------------------------------------------


def test_figures_without_data_say_so() -> None:
    with style.applied():
        for figure in (gap_trace.draw([]), gap_map.draw([], "um")):
            assert not figure.axes
            assert re.search(r"No .* are stored", figure.texts[0].get_text())
        assert "No run" in gap_polar.draw([]).texts[0].get_text()
        assert "No effect" in gap_causes.draw({"marginal": {}}).texts[0].get_text()


def test_figures_keep_all_words_inside(stored: dict[str, Any]) -> None:
    with style.applied():
        for figure in _figures(stored):
            figure.draw_without_rendering()
            renderer: Any = FigureCanvasAgg(figure).get_renderer()
            for axes in [a for a in figure.axes if a.get_visible()]:
                box = axes.get_tightbbox(renderer)
                assert min(box.x0, box.y0) > -2.0
                assert box.x1 < figure.bbox.width + 2.0
                assert box.y1 < figure.bbox.height + 2.0


def _figures(gap: dict[str, Any]) -> list[Figure]:
    return [
        gap_causes.draw(gap),
        gap_trace.draw(gap["traces"]),
        gap_polar.draw(gap["traces"]),
        gap_map.draw(gap["spots"], gap["spots_unit"]),
    ]


def test_the_likeliest_cause_is_at_the_top_and_coloured(stored: dict[str, Any]) -> None:
    gap = stored | {
        "marginal": (
            {f"effect_{k:02d}": 0.01 * k for k in range(14)} | {"backlash": 0.98}
        )
    }
    with style.applied():
        axes = gap_causes.draw(gap).axes
    labels = [t.get_text() for t in axes[0].get_yticklabels()]
    assert labels[:2] == ["backlash", "effect 13"]
    assert len(labels) == gap_causes.MOST
    assert axes[0].patches[0].get_width() == pytest.approx(98.0)
    assert axes[0].patches[0].get_facecolor() != axes[0].patches[1].get_facecolor()
    assert axes[1].patches[0].get_width() == pytest.approx(
        stored["sizes"][0]["rms"]["length"]
    )


def test_only_the_runs_with_the_largest_residuals_are_drawn(
    stored: dict[str, Any],
) -> None:
    one = stored["traces"][0]
    many = [
        {**one, "run": f"r{k}", "before": [v * (1 + k % 5) for v in one["before"]]}
        for k in range(20)
    ]
    kept = gap_trace.chosen(many)
    assert len(kept) == gap_trace.MOST
    assert [t["run"] for t in kept if t["run"] in ("r4", "r9", "r14", "r19")] == [
        "r4",
        "r9",
        "r14",
        "r19",
    ]
    assert "r0" not in [t["run"] for t in kept]
    with style.applied():
        assert (
            len([a for a in gap_trace.draw(many).axes if a.get_visible()])
            == gap_trace.MOST
        )


def test_both_ways_of_a_circle_share_a_panel(stored: dict[str, Any]) -> None:
    found = gap_polar.circles(stored["traces"])
    assert [[t["direction"] for t in runs] for runs in found.values()] == [
        [1, -1],
        [1, -1],
    ]
    with style.applied():
        figure = gap_polar.draw(stored["traces"])
    assert [t.get_text() for t in figure.legends[0].get_texts()] == [
        "forward",
        "backward",
    ]
    upper = figure.axes[0]
    around = next(line for line in upper.lines if line.get_label() == "forward")
    trace = stored["traces"][0]
    largest = max(abs(v) for t in stored["traces"][:2] for v in t["before"])
    expected = [1.0 + gap_polar.SWING * v / largest for v in trace["before"]]
    assert list(around.get_ydata())[: len(expected)] == pytest.approx(expected)


def test_a_machine_in_a_plane_has_one_view_and_one_in_space_two() -> None:
    flat = style.array([[0.0, 10.0 * k, 100.0 * (k % 3)] for k in range(9)])
    assert gap_map.views(flat) == [(1, 2)]
    solid = style.array(
        [[300.0 * (k % 2), 10.0 * k, 100.0 * (k % 3)] for k in range(9)]
    )
    assert gap_map.views(solid) == [(0, 1), (0, 2)]


def test_one_of_many_is_not_named_before_the_others() -> None:
    few, many = ["friction", "backlash"], ["step", *(f"effect_{k}" for k in range(6))]
    answer = {
        "effects": ["friction", "step", "unknown"],
        "probability": 0.4,
        "classes": [few, many],
    }
    said, percent, alike = chapter._row(answer)
    assert said == "friction, one of 7 and an effect of unknown form"
    assert percent == words.percent(0.4)
    assert alike.startswith("backlash, step, effect 0")


def test_the_set_is_shown_where_it_has_more_than_one() -> None:
    one = {"effects": ["friction"], "probability": 0.97, "classes": [["friction"]]}
    other = {"effects": ["step"], "probability": 0.03, "classes": [["step"]]}
    assert len(chapter._answers({"answers": [one, other], "set95": [one]})) == 1
    assert len(chapter._answers({"answers": [one, other], "set95": [one, other]})) == 2
    assert not chapter._answers({"answers": []})
