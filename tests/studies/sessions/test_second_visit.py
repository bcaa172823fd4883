"""A second visit as a user does it: advised, printed, read and diagnosed with the first."""

import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec

from oed.result import ChosenRun, GapSection, SecondVisitRecord, StudyResult
from pkm_reports.blocks import Paragraph, Table
from pkm_reports.sections import gap_before
from pkm_studies.sessions import next_reading
from pkm_studies.stages.gap import diagnosis
from pkm_studies.study import Study

CONDITION = {"direction": -1.0, "feed": 1.0 / 60.0, "payload": 1500.0}


def visit(after: float) -> SecondVisitRecord:
    return SecondVisitRecord(
        runs=[ChosenRun("rm5", "line again", CONDITION, 60.0)],
        poses=[13],
        probability_now=0.5,
        probability_after=after,
        separations=[],
        inseparable=[("bar_length", "encoder_scale + gravity")],
    )


def test_words_say_what_the_visit_is_worth_and_what_it_cannot_decide():
    sure, unsure = (diagnosis.second_visit_sentences(visit(p)) for p in (0.93, 0.6))
    assert "13 poses" in sure[0]
    assert "93 %" in sure[0]
    assert "now it is 50 %" in sure[0]
    assert any("hardly decide" in words for words in unsure)
    assert not any("hardly decide" in words for words in sure)
    assert "bar length from encoder scale and gravity" in sure[-1]


def test_the_advice_of_a_diagnosis_begins_with_the_visit():
    gap = GapSection("class", [], [], [], [], [], [], next=["Preload the nuts."])
    record = SecondVisitRecord([], [], 0.5, 0.9, [], [], ["Take the poses."])
    steps = diagnosis.add_visit(gap, record).next
    assert steps == ["Take the poses.", "Preload the nuts."]


def test_the_report_has_the_visit_as_a_table():
    class Result:
        gap = GapSection("class", [], [], [], [], [], [])

    assert gap_before.visit_blocks(cast("StudyResult", Result())) == []
    Result.gap = diagnosis.add_visit(Result.gap, worded(visit(0.9)))
    paragraph, table = gap_before.visit_blocks(cast("StudyResult", Result()))
    assert isinstance(paragraph, Paragraph)
    assert isinstance(table, Table)
    assert table.rows == [
        ["rm5", "line again", "\N{MINUS SIGN}1", "1500", "1000", "13"]
    ]


def worded(record: SecondVisitRecord) -> SecondVisitRecord:
    return msgspec.structs.replace(
        record, words=diagnosis.second_visit_sentences(record)
    )


def test_next_needs_readings_or_a_diagnosis(oed, tmp_path):
    code, _, error = oed("next", "planar_gap")
    assert code == 2
    assert "--after" in error
    code, _, error = oed(
        "next", "planar_gap", "--after", tmp_path, "--wanted", "y_um=1"
    )
    assert code == 2
    assert "--wanted" in error


def test_the_advised_command_can_be_typed_as_it_stands(monkeypatch):
    """It names the study as it was given, and quotes paths with blanks."""
    gap = diagnosis.add_visit(
        GapSection("class", [], [], [], [], [], []), worded(visit(0.9))
    )
    result = SimpleNamespace(study="mine", gap=gap)
    monkeypatch.setattr(next_reading, "load_result", lambda folder: result)
    study = cast("Study", SimpleNamespace(name="mine"))
    given, folder = Path("my machines/mine.study.toml"), Path("out/first visit")
    command = next_reading.visit_lines(study, given, folder)[-1].partition(
        "then: oed "
    )[2]
    words = shlex.split(command)
    table = str(folder / "second_visit.csv")
    assert words[:4] == ["diagnose", str(given), "--readings", table]
    assert words[4:6] == ["--after", str(folder)]
