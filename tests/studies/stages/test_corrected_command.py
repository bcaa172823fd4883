"""`oed identify --with`: parameters and effects together, and who takes them."""

import contextlib
import csv
import io
import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest
import sample

from oed.estimation import IdentificationError
from oed.result import StudyResult
from pkm_studies.commands import main
from pkm_studies.results import load_result
from pkm_studies.stages.correct import corrected


def run(*arguments: str | Path) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The planar machine that gives under load, identified with both its effects."""
    folder = tmp_path_factory.mktemp("corrected")
    readings = folder / "loads.readings.csv"
    assert run("simulate", "planar_gap", "--out", readings) == 0
    study = folder / "loads.study.toml"
    text = _shipped("planar_gap").split("[readings]")[0]
    options = "[posterior]\nenabled = false\n[report]\npdf = false\n"
    study.write_text(text + options)
    options = ["--with", "gravity,frame_bending", "--out", folder / "out"]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run("identify", study, "--readings", readings, *options)
    assert code == 0
    (folder / "printed.txt").write_text(out.getvalue(), encoding="utf-8")
    (folder / "errors.txt").write_text(err.getvalue(), encoding="utf-8")
    page = (folder / "out" / "report.html").read_bytes()  # verify writes it again
    (folder / "page.html").write_bytes(page)
    return folder


def _shipped(name: str) -> str:
    from pkm_studies import shipped

    return shipped.study_path(Path(name)).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def result(folder: Path) -> StudyResult:
    return load_result(folder / "out")


def test_corrected_parameters_are_within_their_deviations(folder, result):
    truth = json.loads((folder / "loads.truth.json").read_text())
    assert result.estimate is not None
    factor = {"mm": 1e-3, "mrad": 1e-3}
    worst_plain = 0.0
    for name, p in result.corrected.parameters.items():
        true = truth[name]["value"] / factor[p.unit]
        assert abs(p.value - true) < 4.0 * p.sd, name
        plain = result.estimate.parameters[name]
        worst_plain = max(worst_plain, abs(plain.value - true) / plain.sd)
    assert worst_plain > 3.0


def test_coefficients_have_a_readers_unit(result):
    struts = result.corrected.effects["gravity: struts"]
    assert struts.unit == "um"
    assert abs(struts.value - 60.0) < 4.0 * struts.sd


def test_the_prediction_states_its_conditions(result):
    corrected = result.corrected
    assert any("payload" in sentence for sentence in corrected.conditions)
    z = corrected.prediction.components["z"]
    assert z.after.rms < 0.2 * corrected.parameters_only["z"].rms


def test_exports_hold_tables_of_the_effects_or_say_so(folder, result, capsys):
    corrected = result.corrected
    assert {t.state for t in corrected.tables} >= {"payload_N"}
    out = folder / "out"
    assert run("compensate", out, "--to", "csv") == 0
    printed = capsys.readouterr().out
    assert "joint corrections by" in printed.lower()
    lines = (out / "compensation_effects.csv").read_text().splitlines()
    written = csv.DictReader(lines)
    for t in corrected.tables:
        for value, of_value in zip(t.values, t.table, strict=True):
            for joints in of_value:
                row = next(written)
                assert (row["effect"], row["state"]) == (t.effect, t.state)
                assert float(row["value"]) == pytest.approx(value)
                read = [float(row[name]) for name in t.joints]
                assert read == pytest.approx(joints, abs=0.51e-6)
    assert next(written, None) is None
    assert run("compensate", out, "--to", "json") == 0
    document = json.loads((out / "compensation.json").read_text())
    assert [t["effect"] for t in document["effects"]] == [
        t.effect for t in corrected.tables
    ]
    capsys.readouterr()
    assert run("compensate", out, "--to", "gcode") in (0, 2)
    assert "joint corrections by" not in capsys.readouterr().out.lower()


def test_interpolation_of_the_effects_tables_is_in_the_budget(folder, result):
    """A bound: the errors of all tables in the same sense."""
    costs = [t.interpolation for t in result.corrected.tables]
    assert all(cost["y"] > 0.0 for cost in costs)
    out = folder / "out"
    assert run("compensate", out, "--to", "json") == 0
    budget = json.loads((out / "compensation_budget.json").read_text())
    (line,) = (n for n in budget["lines"] if n["kind"] == "interpolation")
    for name in "yz":
        assert line["size"][name] == pytest.approx(sum(cost[name] for cost in costs))


@pytest.mark.slow
def test_a_file_without_the_effects_has_them_in_its_budget(folder, result):
    """Its accuracy is then that with the parameters alone; with tables nothing lacks."""
    assert result.corrected is not None
    (folder / "plain.py").write_text(
        "import dataclasses\n"
        "from pkm_studies.compensation.formats import json_file\n"
        "controller = dataclasses.replace(json_file.controller, tables=False)\n"
    )
    out = folder / "out"
    for to, kinds in (
        (f"{folder}/plain.py:controller", ["rounding", "left out"]),
        ("json", ["rounding"]),
    ):
        assert run("compensate", out, "--to", to) == 0
        budget = json.loads((out / "compensation_budget.json").read_text())
        added = [line for line in budget["lines"] if line["kind"] in kinds]
        assert [line["kind"] for line in added] == kinds
        if len(kinds) == 2:
            for name, alone in result.corrected.parameters_only.items():
                assert budget["predicted"][name] == pytest.approx(alone.rms, rel=0.01)
        for name in budget["predicted"]:
            total = sum(line["share"][name] for line in budget["lines"])
            assert total == pytest.approx(1.0, abs=0.01)


def test_an_effect_that_the_readings_cannot_show_is_refused(folder, capsys):
    study, readings = folder / "loads.study.toml", folder / "loads.readings.csv"
    options = ["--with", "backlash", "--out", str(folder / "no")]
    assert run("identify", study, "--readings", readings, *options) == 2
    assert "direction" in capsys.readouterr().err
    assert not (folder / "no/result.json").exists()  # before any fit


# -- the alarm of a bad fit ------------------------------------------------------------
def test_the_first_line_is_true_of_the_corrected_fit(folder):
    lines = (folder / "printed.txt").read_text(encoding="utf-8").splitlines()
    model = "With gravity and frame bending in the model the residuals"
    (first,) = (line for line in lines if model in line)
    assert "Without them the check says: The " in first
    assert "the fit is bad" not in (folder / "errors.txt").read_text(encoding="utf-8")
    assert not any(line.startswith("The fit is bad") for line in lines)
    result = json.loads((folder / "out/result.json").read_text(encoding="utf-8"))
    assert not result["goodness"]["bad_fit"]
    corrected = result["corrected"]
    ratio = (corrected["chi2"] / corrected["dof"]) ** 0.5
    assert f"residuals are {ratio:.1f} times" in first
    assert 0.5 < ratio < 1.5
    assert "<p>The fit is bad" not in (folder / "page.html").read_text(encoding="utf-8")


# -- acceptance ------------------------------------------------------------------------
@pytest.fixture(scope="module")
def planned(folder: Path, result: StudyResult) -> Path:
    """The acceptance file of the result, to fill in."""
    assert result.corrected is not None
    exact = ["--uncertainty", "y_um=0.01,z_um=0.01"]
    assert run("verify", folder / "out", "--poses", "6", *exact) == 0
    return folder / "out" / "acceptance.csv"


def fill_in(planned: Path, to: Path, factor: float) -> Path:
    """Errors of a factor on the promise, with alternating signs, at every pose."""
    acceptance = load_result(planned.parent).acceptance
    assert acceptance is not None
    header, *rows = sample.table_lines(planned.read_text())
    names = header.split(",")
    lines = [header]
    for k, row in enumerate(rows):
        cells = dict(zip(names, row.split(","), strict=True))
        for name, demand in acceptance.components.items():
            size = factor * demand.promised * (-1) ** k
            cells[f"error_{name}_{demand.unit}"] = f"{size:.6f}"
        lines.append(",".join(cells.values()))
    to.write_text("\n".join(lines) + "\n")
    return to


def test_acceptance_poses_are_not_those_of_the_calibration(planned, folder):
    result = load_result(folder / "out")
    acceptance, estimate = result.acceptance, result.estimate
    known = {tuple(f"{v:g}" for v in c.values()) for c in estimate.commands}
    rows = {tuple(line.split(",")[3:5]) for line in _readings(folder)}
    assert known == rows  # the poses that relative readings start from as well
    assert len(acceptance.poses) == 6
    assert all(0.0 < d.power < 1.0 for d in acceptance.components.values())
    read = {tuple(line.split(",")[3:5]) for line in _readings(folder)}
    for pose in acceptance.poses:
        assert tuple(f"{v:g}" for v in pose.values()) not in read


def _readings(folder: Path) -> list[str]:
    return (folder / "loads.readings.csv").read_text().splitlines()[1:]


def test_a_good_machine_passes_and_a_bad_one_fails(planned, tmp_path, capsys):
    out = planned.parent
    unsure = Path(shutil.copytree(out, tmp_path / "unsure"))
    coarse = ["--uncertainty", "y_um=100,z_um=100"]
    assert run("verify", unsure, "--poses", "4", *coarse) == 0
    readings = fill_in(unsure / "acceptance.csv", tmp_path / "unsure.csv", 0.5)
    assert run("verify", unsure, "--readings", readings) == 1
    assert "this test cannot tell" in capsys.readouterr().out
    more = Path(shutil.copytree(out, tmp_path / "more"))
    exact = ["--uncertainty", "y_um=0.01,z_um=0.01"]
    assert run("verify", more, "--poses", "30", *exact) == 0
    good = fill_in(more / "acceptance.csv", tmp_path / "good.csv", 0.5)
    assert run("verify", more, "--readings", good) == 0
    bad = fill_in(planned, tmp_path / "bad.csv", 1.5)
    assert run("verify", out, "--readings", bad) == 1
    assert "does not meet" in capsys.readouterr().out
    stored = load_result(out).verification
    assert not stored.passed


def test_a_file_that_lacks_a_pose_is_refused(planned, tmp_path):
    whole = fill_in(planned, tmp_path / "whole.csv", 0.9)
    part = tmp_path / "part.csv"
    part.write_text("\n".join(whole.read_text().splitlines()[:-1]) + "\n")
    assert run("verify", planned.parent, "--readings", part) == 2


def test_the_report_has_the_corrected_model_and_the_acceptance_test(planned, tmp_path):
    bad = fill_in(planned, tmp_path / "bad.csv", 1.5)
    assert run("verify", planned.parent, "--readings", bad) == 1
    page = (planned.parent / "report.html").read_text(encoding="utf-8")
    headings = ("Corrected model", "Without effects", "Acceptance test")
    for text in (*headings, "Uncertainty budget", "sizes of the effects"):
        assert text in page
    assert "The acceptance test is failed" in page


@pytest.fixture
def state(monkeypatch: pytest.MonkeyPatch) -> mock.MagicMock:
    """A fit whose correction for a step fails; its warnings are returned."""
    error = IdentificationError("the fit did not converge")
    effects = [SimpleNamespace(name="step")]
    monkeypatch.setattr(corrected, "_effects", lambda *given: effects)
    readings = mock.MagicMock()
    readings.return_value.estimate.side_effect = error
    monkeypatch.setattr(corrected, "readings_with_covariates", readings)
    state = mock.MagicMock(with_effects=())
    state.add_warnings = lambda *warnings: warnings
    return state


def test_a_diagnosis_stands_where_its_correction_fails(state):
    (warning,) = corrected.correct_for_effects(state)
    assert warning.startswith("nothing is corrected for step")
    assert "did not converge" in warning


def test_effects_that_were_named_are_refused(state):
    state.with_effects = ("step",)
    with pytest.raises(IdentificationError):
        corrected.correct_for_effects(state)
