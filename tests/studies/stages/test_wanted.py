"""The accuracy that [prediction] wants: beside the predicted one, with pass or fail."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
import report_fixture
import sample
from report_fixture import result_of

from oed import verdict
from oed.result import StudyResult, VerdictRecord, VerificationSection
from pkm_reports.blocks import Table
from pkm_reports.sections import answer
from pkm_studies import result_folder
from pkm_studies import sessions as advice
from pkm_studies.commands import main
from pkm_studies.study import Study

WANTED = "[prediction]\nz_mm = 1146.0\npsi_deg = [0.0, 120.0]\ntheta_deg = 20.0\n"


def _study(folder: Path, wanted: str) -> Path:
    path = folder / "mine.study.toml"
    table = f"{WANTED}wanted = {{ {wanted} }}\n\n[posterior]\nenabled = false\n\n"
    text = sample.changed(sample.STUDY, ("[design]", f"{table}[design]"))
    path.write_text(text, encoding="utf-8")
    return path


def _result(folder: Path) -> StudyResult:
    raw = (folder / "result.json").read_bytes()
    return msgspec.json.decode(raw, type=StudyResult)


def test_verdicts_stand_beside_the_predicted(tmp_path, capsys):
    """A plan's verdict holds usual effects; x has no drive and stays geometry alone.

    What does not pass exits with 1.
    """
    study = _study(tmp_path, "z_mm = 100, theta_arcsec = 1e-6, x_um = 1e6")
    out = tmp_path / "out"
    assert main(["run", str(study), "--out", str(out), "--quiet"]) == 1
    capsys.readouterr()
    result = _result(out)
    section = result.prediction
    assert section.wanted == pytest.approx({"z": 1e5, "theta": 1e-6, "x": 1e6})
    stated = {name: v.judgement for name, v in result.verdicts.items()}
    assert stated == {"z": "pass", "theta": "fail", "x": "cannot tell"}
    assert result.verdicts["x"].scope == verdict.GEOMETRY_ALONE
    assert result.verdicts["z"].rms >= section.components["z"].after.rms
    (sentence,) = [s for s in result.headline if s.startswith("Wanted accuracy")]
    x = section.components["x"]
    assert "of 100000 um, pass, predicted (probability over 99 %)" in sentence
    assert f"x {x.known.rms:.3g} of 1e+06 um, cannot tell" in sentence
    assert "arcsec, fail" in sentence
    assert "x has no drive and is judged by its unknown part." in sentence
    (table, *_) = answer.accuracy_blocks(result)
    assert isinstance(table, Table)
    verdicts = {row[0].split()[0]: row[-1] for row in table.rows}
    assert verdicts["z"] == "✓ pass, predicted"
    assert verdicts["x"] == "? cannot tell"
    assert verdicts["theta"] == "✗ fail"


@pytest.mark.parametrize(("rms", "stated"), [(2.0, "pass"), (9.0, "cannot tell")])
def test_stored_verdicts_follow_an_acceptance_test(tmp_path, rms, stated):
    """A test that meets 5 um confirms what is wanted; one that fails takes the pass."""
    study, out = _study(tmp_path, "z_mm = 100"), tmp_path / "out"
    assert main(["run", str(study), "--out", str(out), "--quiet"]) == 0
    result = _result(out)
    assert not result.verdicts["z"].confirmed
    meets = rms <= 5.0
    tested = VerdictRecord(rms, rms, 6.0, 5.0, "um", meets)
    section = VerificationSection(meets, 6, {"z": tested})
    result_folder.rewrite(out, msgspec.structs.replace(result, verification=section))
    again = _result(out).verdicts["z"]
    assert (again.judgement, again.confirmed) == (stated, meets)


def test_the_study_s_limits_guide_the_next_reading(tmp_path):
    study = _study(tmp_path, "z_mm = 0.02")
    adviser = advice.Adviser(Study.load(study))
    limits = dict(zip(adviser.maps.names, adviser.limits, strict=True))
    assert limits.pop("z") == pytest.approx(2e-5)
    assert np.isnan(list(limits.values())).all()
    sheet = tmp_path / "poses.csv"
    sheet.write_text(
        "setup,run,order,z_mm,psi_deg,theta_deg,length_mm\ncup,1,1,1146,15,20,\n",
        encoding="utf-8",
    )
    lines = adviser.advice_sentences(adviser.advise(sheet))
    (line,) = [line for line in lines if "wanted 20: " in line]
    assert line.endswith("fail (within it with under 1 %)")
    option = advice.Adviser(Study.load(study), "z_um=5")
    assert np.nanmin(option.limits) == pytest.approx(5e-6)


def test_the_prediction_s_limit_wins_over_that_of_a_design():
    raw = report_fixture.sample()
    raw["prediction"]["wanted"] = {"z": 3.0}
    raw["design"]["how_many"]["wanted"] = {"z_um": 9.0, "x_um": 8.0}
    assert answer.wanted_accuracy(result_of(raw)) == {"z_um": 3.0, "x_um": 8.0}


@pytest.mark.parametrize(("wanted", "words"), [
    ("q_um = 3", "unknown field"),
    ("z_arcsec = 3", "no unit for z"),
    ("z_um = -3", "> 0"),
    ("z_um = 3, z_mm = 1", "given twice"),
])  # fmt: skip
def test_a_limit_that_makes_no_sense_is_refused(tmp_path, capsys, wanted, words):
    assert main(["check", str(_study(tmp_path, wanted))]) == 2
    error = capsys.readouterr().err
    assert "prediction.wanted" in error
    assert words in error
