"""`oed compare`, `oed history` and `oed adjust` on the sessions of virtual machines."""

import contextlib
import csv
import io
import itertools
import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import numpy as np
import pytest
import sample
import xarray as xr

from oed.adjustment import StepProblem, choose_steps, sizes_without
from oed.result import ChosenRun, GapSection, SecondVisitRecord, StudyResult
from pkm_reports.blocks import Paragraph, Table
from pkm_reports.sections import gap_before
from pkm_studies.commands import main
from pkm_studies.resolve import study_machine
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


STUDIES = Path(__file__).resolve().parents[3] / "studies"
QUICK = "[report]\nhtml = false\npdf = false\n\n[expect]"


def problem(rng: np.random.Generator, step: float, most: float) -> StepProblem:
    slopes = rng.standard_normal((30, 5)) @ np.diag([1.0, 1.0, 0.5, 0.2, 0.02])
    slopes[:, 1] = slopes[:, 0] + 0.3 * slopes[:, 1]  # nearly alike
    known = slopes @ np.array([3.0, -2.0, 1.0, 0.0, 1.0])
    known += 0.3 * rng.standard_normal(30)
    return StepProblem(
        errors=known,
        gradients=slopes,
        floor=0.1,
        scatter=np.full(5, 1e-3),
        step=np.full(5, step),
        most=np.full(5, most),
    )


def best_of_all(p: StepProblem, reach: int) -> dict[int, float]:
    """Smallest error of the lists of each length, over all whole steps."""
    steps = range(-reach, reach + 1)
    every = np.array(list(itertools.product(steps, repeat=5))) * p.step
    residuals = p.errors + every @ p.gradients.T
    squares = (residuals**2).sum(axis=1) + (every != 0.0) @ p.scatter + p.floor
    lengths = (every != 0.0).sum(axis=1)
    return {k: float(np.sqrt(squares[lengths == k].min())) for k in range(6)}


@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 8))]
)
def test_the_list_is_that_of_an_exhaustive_search(seed):
    p = problem(np.random.default_rng(seed), step=0.5, most=3.0)
    amounts = choose_steps(p)
    best = best_of_all(p, 6)
    lines = int((amounts != 0.0).sum())
    assert p.size(amounts) <= 1.02 * best[lines]
    assert p.size(amounts) <= 1.05**2 * min(best.values())
    assert np.abs(amounts).max() <= 3.0
    np.testing.assert_allclose(amounts / 0.5, np.rint(amounts / 0.5), atol=1e-12)
    without = sizes_without(p, amounts)
    assert (without > 1.05 * p.size(amounts)).all()


def test_no_line_where_little_is_known():
    p = problem(np.random.default_rng(1), step=0.5, most=3.0)
    unknown = StepProblem(p.errors, p.gradients, 1e5, p.scatter, p.step, p.most)
    assert not choose_steps(unknown).any()


def test_no_line_where_the_hand_errs_more_than_it_corrects():
    p = problem(np.random.default_rng(1), step=0.5, most=3.0)
    clumsy = StepProblem(p.errors, p.gradients, 0.1, np.full(5, 1e4), p.step, p.most)
    assert not choose_steps(clumsy).any()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of the shipped study, without its report."""
    folder = tmp_path_factory.mktemp("adjust")
    study = folder / "prs.study.toml"
    text = (STUDIES / "prs_adjust.study.toml").read_text(encoding="utf-8")
    study.write_text(text.replace("[expect]", QUICK), encoding="utf-8")
    assert main(["run", str(study), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder / "out"


@pytest.fixture
def folder(session: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(session, tmp_path / "out"))


@pytest.fixture(scope="module")
def adjusted_session(
    session: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str]:
    """The same after `oed adjust`, and what it said."""
    folder, said = tmp_path_factory.mktemp("adjusted") / "out", io.StringIO()
    shutil.copytree(session, folder)
    with contextlib.redirect_stdout(said):
        assert main(["adjust", str(folder)]) == 0
    return folder, said.getvalue()


@pytest.fixture
def adjusted(adjusted_session: tuple[Path, str], tmp_path: Path) -> Path:
    return Path(shutil.copytree(adjusted_session[0], tmp_path / "adjusted"))


def test_the_files_say_the_same(adjusted_session):
    folder, out = adjusted_session
    section = json.loads((folder / "result.json").read_text("utf-8"))["adjustment"]
    lines = section["lines"]
    with (folder / "adjust.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["parameter"] for row in rows[1:]] == [a["parameter"] for a in lines]
    for row, line, record in zip(rows[1:], lines, section["accuracy"][1:], strict=True):
        assert float(row["amount"]) == pytest.approx(0.02 * int(row["steps"]))
        assert float(row["amount"]) == line["amount"]
        assert float(row["total"]) == pytest.approx(record["total"], rel=1e-5)
        assert line["without"] > 1.05 * section["accuracy"][-1]["total"]
        assert f"{line['by']}: {line['amount']:+.6g} mm" in out
        assert f"whole list without this line: total {line['without']:.4g} um" in out
        assert row["total_unit"] == section["total_unit"] == "um"
    assert (folder / "adjustment.pdf").read_bytes().startswith(b"%PDF")


def test_total_and_what_software_leaves(adjusted):
    result = json.loads((adjusted / "result.json").read_text("utf-8"))
    records = result["adjustment"]["accuracy"]
    lever, arcsec = 0.340722, np.pi / 648000.0
    scale = [1.0, 1.0, 1.0, *[lever * arcsec * 1e6] * 3]
    for record in records:
        parts = np.array(list(record["corrected"].values())) * scale
        assert record["total"] == pytest.approx(np.sqrt((parts**2).sum()))
    # the readings are virtual: the prediction is that of a plan, so only what is known
    # of y, of which software corrects nothing, is near the error that stays
    assert records[0]["corrected"]["y"] > 90.0
    assert records[-1]["total"] < 0.06 * records[0]["total"]
    # without software the columns and struts stay
    assert records[-1]["plain"]["z"] > 50.0


def test_the_next_study_takes_the_adjusted_machine(adjusted):
    result = json.loads((adjusted / "result.json").read_text("utf-8"))
    table = tomllib.loads((adjusted / "adjusted.toml").read_text("utf-8"))
    nominal = table["machine"]["nominal"]
    moved = {a["parameter"]: a["amount"] for a in result["adjustment"]["lines"]}
    for name, p in result["estimate"]["parameters"].items():
        if "." not in name:
            value = p["value"] + moved.get(name, 0.0)
            assert nominal[f"{name}_mm"] == pytest.approx(value, rel=1e-8, abs=1e-9)
    text = (STUDIES / "prs_adjust.study.toml").read_text("utf-8")
    block = (adjusted / "adjusted.toml").read_text("utf-8")
    text = text.replace("[[setup]]", f"{block}\n[[setup]]")
    machine = study_machine(Study.parse(text, adjusted / "next.study.toml"))
    assert machine.nominal[machine.index("db1z")] == pytest.approx(
        1e-3 * nominal["db1z_mm"]
    )


def test_a_controller_gets_the_adjusted_machine(folder, adjusted, oed):
    code, _, error = oed("compensate", folder, "--to", "json", "--adjusted")
    assert code == 2
    assert "oed adjust DIR" in error
    table = tomllib.loads((adjusted / "adjusted.toml").read_text("utf-8"))
    call = ("compensate", adjusted, "--to", "csv", "--commands", 60)
    code, out, _ = oed(*call, "--adjusted")
    assert code == 0
    assert "after all adjustments of adjust.csv" in out
    assert "the fitter's own error comes on top" in out
    path = adjusted / "compensation_parameters.csv"
    lines = path.read_text("utf-8").splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    values = {row["name"]: float(row["value"]) for row in rows}
    expected = table["machine"]["nominal"]["db1z_mm"]
    assert values["db1z"] == pytest.approx(expected, rel=1e-6)


def test_the_fitters_own_notes_stay(adjusted, oed):
    path = adjusted / "adjust.csv"
    notes = path.read_text("utf-8") + "done by the late shift\n"
    path.write_text(notes, encoding="utf-8")
    code, out, _ = oed("adjust", adjusted)
    assert code == 0
    assert path.read_text("utf-8") == notes
    assert "adjust-2.csv" in out


def test_the_report_has_the_chapter(adjusted, oed):
    assert oed("report", adjusted)[0] == 0
    page = (adjusted / "report.html").read_text("utf-8")
    assert "Adjustments at the machine" in page
    assert "shim under ball joint 1" in page


def test_a_section_that_contradicts_itself_is_refused(adjusted, oed):
    path = adjusted / "result.json"
    result = json.loads(path.read_text("utf-8"))
    for field, change in {
        "adjustment.accuracy": lambda s: s["accuracy"].pop(),
        "adjustment.lines[1].unit": lambda s: s["lines"][0].update(unit="furlong"),
        "adjustment.accuracy[2].plain": lambda s: s["accuracy"][1]["plain"].pop("x"),
    }.items():
        broken = json.loads(json.dumps(result))
        change(broken["adjustment"])
        path.write_text(json.dumps(broken), encoding="utf-8")
        code, _, error = oed("report", adjusted)
        assert code == 2
        assert field in error


def test_what_is_wanted_counts_and_a_thread_has_no_steps(folder, oed):
    text = (folder.parent / "out" / "result.json").read_text("utf-8")
    study = folder.parent / "wanted.study.toml"
    words = json.loads(text)["study_text"].replace("step_mm = 0.02\n", "")
    study.write_text(words, encoding="utf-8")
    call = ("adjust", folder, "--study", study, "--wanted", "gamma_arcsec=5")
    code, out, _ = oed(*call)
    assert code == 0
    assert (
        "over the wanted ones (gamma_arcsec=5); x, y, z, alpha, beta count for" in out
    )
    section = json.loads((folder / "result.json").read_text("utf-8"))["adjustment"]
    for record in section["accuracy"]:
        assert record["total"] == pytest.approx(record["corrected"]["gamma"] / 5.0)
        assert f"total {record['total']:.4g} times what is wanted" in out
    assert section["lines"]
    for line in section["lines"]:
        assert (line["steps"], line["sd"]) == (None, 0.0)
        assert line["amount"] == pytest.approx(round(line["amount"], 3), abs=1e-9)


def test_the_reports_limits_do_not_change_the_adjustment(adjusted, tmp_path, oed):
    """[prediction] wanted is for a verdict: lines and total stay as without it."""
    path = adjusted / "result.json"
    result = json.loads(path.read_text("utf-8"))
    before = result["adjustment"]
    study = tmp_path / "limits.study.toml"
    limits = "[prediction]\nwanted = { gamma_arcsec = 5.0 }"
    text = result["study_text"].replace("[prediction]", limits)
    study.write_text(text, encoding="utf-8")
    code, out, _ = oed("adjust", adjusted, "--study", study)
    assert code == 0
    assert json.loads(path.read_text("utf-8"))["adjustment"] == before
    total = before["accuracy"][0]["total"]
    assert f"As it is: total {total:.4g} um (x " in out


def test_the_posterior_of_the_folder_counts(adjusted, oed):
    """Draws that scatter more than the normal approximation leave more unknown."""
    path = adjusted / "result.json"
    sections = [json.loads(path.read_text("utf-8"))["adjustment"]]
    with xr.open_dataset(
        adjusted / "posterior.nc", group="posterior", engine="h5netcdf"
    ) as data:
        wide = data.load()
    middle = wide["theta"].mean(("chain", "draw"))
    wide["theta"] = 10.0 * (wide["theta"] - middle) + middle
    (adjusted / "posterior.nc").unlink()
    wide.to_netcdf(adjusted / "posterior.nc", group="posterior", engine="h5netcdf")
    oed("adjust", adjusted)
    sections.append(json.loads(path.read_text("utf-8"))["adjustment"])
    driven = [s["accuracy"][0]["corrected"]["alpha"] for s in sections]
    assert driven[1] == pytest.approx(10.0 * driven[0], rel=0.05)


def test_a_bad_fit_is_refused(folder, oed):
    path = folder / "result.json"
    result = json.loads(path.read_text("utf-8"))
    for section in ("estimate", "goodness"):
        if result[section] is not None:
            result[section]["chi2"] = 100.0 * result[section]["dof"]
    if result["goodness"] is not None:
        result["goodness"] |= {"p_high": 0.0, "bad_fit": True}
    path.write_text(json.dumps(result), encoding="utf-8")
    code, _, error = oed("adjust", folder)
    assert code == 1
    assert "oed diagnose" in error


def test_a_plan_alone_adjusts_nothing(tmp_path, oed):
    (tmp_path / "a.study.toml").write_text(sample.STUDY, encoding="utf-8")
    out = tmp_path / "out"
    assert oed("run", tmp_path / "a.study.toml", "--out", out, "--quiet")[0] == 0
    code, _, error = oed("adjust", out)
    assert code == 2
    assert "no estimate" in error


def test_software_corrects_what_the_drives_reach(folder, oed):
    """Struts of another length are no work for a fitter."""
    text = json.loads((folder / "result.json").read_text("utf-8"))["study_text"]
    start, end = text.index("[[machine.adjust]]"), text.index("[[setup]]")
    table = '[[machine.adjust]]\nparameters = ["dl*"]\nby = "strut {i}"\n\n'
    study = folder.parent / "struts.study.toml"
    study.write_text(text[:start] + table + text[end:], encoding="utf-8")
    code, words, error = oed("adjust", folder, "--study", study)
    assert code == 0, error
    assert words.startswith("No adjustment is worth its work")
    assert not (folder / "adjustment.pdf").exists()


TABLE = '\n[[machine.adjust]]\nparameters = ["{}"]\nby = "shim {{i}}"\n{}\n'


@pytest.mark.parametrize(("names", "amounts", "words"), [
    ("db4x", "", "no parameter has this name"),
    ("d*", "step_deg = 1.0", '"deg" is no unit for step'),
    ("*", "", "parameters of different kinds"),
    ("db2x", "step_mm = -0.1", "no such amount"),
    ("db2x", "most_mm = 0.0", "no such amount"),
    ("db2x", "pitch_mm = 0.1", "unknown field"),
    ("db2y", "", "only chooses the base frame"),
])  # fmt: skip
def test_what_cannot_be_is_refused(names, amounts, words, tmp_path, oed):
    text = sample.STUDY.replace(
        '[[setup]]\nname = "cup"',
        f'{TABLE.format(names, amounts)}\n[[setup]]\nname = "cup"',
    )
    if names == "d*":
        text = text.replace('["d*"]', '["dq*"]')
    (tmp_path / "a.study.toml").write_text(text, encoding="utf-8")
    code, _, error = oed("check", tmp_path / "a.study.toml")
    assert code == 2
    assert words in error
    assert "machine.adjust" in error


def test_the_study_replaces_the_models_adjustments():
    text = sample.STUDY.replace(
        "[[setup]]",
        TABLE.format("db2x", "step_um = 5.0\nsd_um = 2.0") + "\n[[setup]]",
        1,
    )
    model = study_machine(Study.parse(sample.STUDY, Path("a.study.toml")))
    machine = study_machine(Study.parse(text, Path("a.study.toml")))
    stated = {p.name: p.adjust for p in machine.parameters if p.adjust is not None}
    assert list(stated) == ["db2x"]
    assert (stated["db2x"].by, stated["db2x"].step) == ("shim 2", pytest.approx(5e-6))
    assert stated["db2x"].error == pytest.approx(2e-6)
    by_model = {p.name for p in model.parameters if p.adjust is not None}
    assert {"beta1", "db3x"} <= by_model
    none = sample.STUDY.replace('"a3_head"', '"a3_head"\nadjust = []')
    machine = study_machine(Study.parse(none, Path("a.study.toml")))
    assert not any(p.adjust for p in machine.parameters)
