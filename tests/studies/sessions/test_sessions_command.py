"""`oed compare` and `oed history`, and a second visit as a user does it."""

import json
import re
import shlex
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
import sample

from oed.result import ChosenRun, GapSection, SecondVisitRecord, StudyResult
from pkm_reports.blocks import Paragraph, Table
from pkm_reports.sections import gap_before
from pkm_studies.commands import main
from pkm_studies.sessions import next_reading
from pkm_studies.stages.gap import diagnosis
from pkm_studies.study import Study

#: offset dq1 (mm) of the machine by date
STILL = {"2026-01-01": 0.10, "2026-01-11": 0.10}
DRIFTING = {"2026-01-01": 0.10, "2026-01-31": 0.16, "2026-03-02": 0.22}


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the machine's sessions, by their dates."""
    folder = tmp_path_factory.mktemp("sessions")
    plan = sample.changed(
        sample.STUDY,
        ("[[design.candidates]]", '[[design.reference]]\nname = "circles"'),
        ("[expect]", "[posterior]\nenabled = false\n[expect]"),
    )
    for seed, (date, dq1) in enumerate((STILL | DRIFTING).items()):
        study = folder / f"{date}.study.toml"
        simulated = f"[readings]\nsimulate = true\ntruth = {{ dq1_mm = {dq1} }}\n"
        study.write_text(f"{plan}{simulated}", encoding="utf-8")
        out = folder / "machine" / date
        call = ["run", study, "--out", out, "--seed", seed, "--quiet"]
        assert main([str(a) for a in call]) == 0
    return folder / "machine"


@pytest.fixture
def drifting(machine: Path, tmp_path: Path) -> Path:
    for date in DRIFTING:
        shutil.copytree(machine / date, tmp_path / "drifting" / date)
    return tmp_path / "drifting"


def test_a_change_is_reported_with_its_cause(machine, oed):
    before, same, after = (machine / d for d in (*STILL, "2026-03-02"))
    code, out, _ = oed("compare", before, same)
    assert code == 0
    assert out.startswith("No change: chi2")
    code, out, _ = oed("compare", before, after)
    assert code == 0
    assert out.startswith("The machine changed: chi2")
    cause = out.partition("alone explains")[2].partition("dq1: ")[2].split()
    assert (cause[1], cause[4]) == ("mm,", "mm;")
    assert float(cause[0]) == pytest.approx(0.12, abs=4 * float(cause[3]))


def test_no_session_is_compared_with_itself(machine, tmp_path, oed):
    first = machine / "2026-01-01"
    code, _, error = oed("compare", first, tmp_path)
    assert code == 2
    assert "no such result" in error
    shutil.copytree(first, tmp_path / "copy")
    for again in (first, tmp_path / "copy"):
        for command in ("compare", "history"):
            code, _, error = oed(command, first, again)
            assert code == 2
            assert "the readings are equal" in error


def test_a_fit_that_is_bad_is_not_compared_without_a_word(machine, tmp_path, oed):
    first, second = (machine / date for date in STILL)
    shutil.copytree(second, tmp_path / "bad")
    make_bad(tmp_path / "bad")
    code, out, _ = oed("compare", first, tmp_path / "bad")
    assert code == 1
    assert "bad is not to be trusted: the residuals are" in out


def make_bad(folder: Path) -> None:
    """Make the stored fit one whose residuals are 10 times the stated noise."""
    path = folder / "result.json"
    result = json.loads(path.read_text("utf-8"))
    goodness = result["goodness"]
    goodness |= {"chi2": 100.0 * goodness["dof"], "p_high": 0.0, "bad_fit": True}
    path.write_text(json.dumps(result), encoding="utf-8")


def test_the_command_tells_the_drift_and_the_next_date(drifting, oed):
    code, out, _ = oed("history", drifting, "--limit", "z_um=100")
    assert code == 0
    assert out.startswith("3 sessions over 60 days.\nThe machine drifts")
    assert "100 um are reached after" in out
    assert "Calibrate again by 2026-" in out
    (cause,) = out.partition("alone explains all of it:\n")[2].splitlines()[:1]
    name, rate, unit, *_ = cause.split()
    assert (name, unit) == ("dq1:", "mm")
    assert float(rate) == pytest.approx(0.002, rel=0.2)  # mm a day
    code, _, error = oed("history", drifting, "--limit", "z_um=-5")
    assert code == 2
    assert "not a positive number" in error
    code, _, error = oed("history", drifting / "2026-01-01")
    assert code == 2
    assert "two sessions" in error


def test_two_sessions_have_one_test_and_no_date_where_nothing_drifts(machine, oed):
    """Of two seeds of one machine `compare` and `history` say the same."""
    folders = [machine / date for date in STILL]
    _, compared, _ = oed("compare", *folders)
    code, followed, _ = oed("history", *folders)
    assert code == 0
    test = re.compile(r"chi2 ([\d.]+) for (\d+) combinations.*p ([\d.]+)")
    numbers = [test.search(out) for out in (compared, followed)]
    assert numbers[0] is not None
    assert numbers[1] is not None
    assert numbers[0].groups() == numbers[1].groups()
    assert "No drift is proven" in followed
    assert "Calibrate again" not in followed
    assert "one every 10 days, prove with probability 0.9" in followed
    sizes = re.findall(r"([\d.]+) um \((\d+) sessions\)", followed)
    assert [count for _, count in sizes[:3]] == ["3", "4", "8"]
    assert float(sizes[0][0]) > float(sizes[1][0]) > float(sizes[2][0]) > 0.0


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
