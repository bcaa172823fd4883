"""[prediction] of a study: the accuracy that it wants, and the states of its use."""

from pathlib import Path

import bad_fit_sample
import bar_readings
import msgspec
import numpy as np
import pandas as pd
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
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.resolve import resolve
from pkm_studies.stages.fit.estimate import (
    displayed_states,
    extrapolated_states,
    recorded_states,
)
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


WORKSPACE = """
[prediction]
z_mm = [1100, 1200]
psi_deg = [0, 90]
theta_deg = 20
states = {states}
"""
ALLOWED = '[identify]\neffects = "catalogue"\n'


def written(folder: Path, states: str, allowed: str = ALLOWED) -> Path:
    file = folder / "small.study.toml"
    text = sample.STUDY.replace("[report]", allowed + "\n[report]")
    file.write_text(text + WORKSPACE.format(states=states), encoding="utf-8")
    return file


def test_states_are_read_with_their_units(tmp_path):
    states = "{ payload_N = [0, 500], temp_leg1_C = 30, direction = [-1, 1] }"
    resolved = resolve(Study.load(written(tmp_path, states)), readings=[])
    values = resolved.prediction.states
    assert set(values) == {"payload", "temp_leg1", "direction"}
    np.testing.assert_allclose(values["payload"], [0.0, 500.0])
    np.testing.assert_allclose(values["temp_leg1"], [30.0])


@pytest.mark.parametrize(("states", "words"), [
    ("{ payload_mm = 1 }", "no covariate"),
    ("{ wind_N = 1 }", "no covariate"),
    ("{ time_s = 1 }", "as in the session"),
    ("{ payload_N = [] }", "no value"),
    ("{ direction = [0.5, 1] }", r"\+1 or -1"),
    ("{ payload_N = [0, 1e30] }", "so large"),
    ("{ feed_mm_min = -1 }", "at least 0"),
])  # fmt: skip
def test_what_is_no_state_is_refused(tmp_path, states, words):
    with pytest.raises(InputError, match=words):
        resolve(Study.load(written(tmp_path, states)), readings=[])


def test_states_beyond_the_readings_are_said_to_be():
    """Recorded: 0 and 100 N, 293 to 296 K; what lies inside is no extrapolation."""
    rows = pd.DataFrame(
        {"payload": [0.0, 100.0, np.nan], "temp_leg1": [20.0, 23.0, 22.0]}
    )
    used = {"payload": np.array([0.0, 500.0]), "temp_leg1": np.array([21.0])}
    (sentence,) = extrapolated_states(used, rows)
    assert "payload_N 0 and 500" in sentence
    assert "0 to 100" in sentence
    used = {"payload": np.array([0.0, 100.0])}
    assert not extrapolated_states(used, rows)


def test_states_need_effects(tmp_path):
    """Where the study keeps the geometry alone."""
    bare = '[identify]\neffects = "none"\n'
    with pytest.raises(InputError, match="only effects differ"):
        resolve(Study.load(written(tmp_path, "{ payload_N = 1 }", bare)), readings=[])


def test_a_state_that_no_reading_recorded_is_refused(tmp_path, capsys):
    study, readings = bad_fit_sample.write(tmp_path, bar_readings.a3_readings(0))
    text = study.read_text().replace(
        "[prediction]\n", "[prediction]\nstates = { temp_frame_C = [18, 26] }\n"
    )
    study.write_text(text.replace('effects = "none"', 'effects = ["gravity"]'))
    out = tmp_path / "out"
    arguments = ["identify", str(study), "--readings", str(readings)]
    assert main([*arguments, "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "temp_frame_C" in message
    assert "record it in the readings" in message


def test_recorded_states_are_the_default():
    """Two directions and payloads as they are, a leg cold and warm, no bar."""
    rows = pd.DataFrame(
        {
            "direction": [1.0, -1.0, 1.0, np.nan],
            "payload": [0.0, 50.0, 200.0, 0.0],
            "feed": [0.01, 0.02, 0.01, 0.02],
            "temp_leg1": [20.0, 21.0, 23.0, 22.0],
            "temp_leg2": [20.0, 20.0, 20.0, 20.0],
            "temp_bar": [20.0, 20.5, 21.0, 20.2],
        }
    )
    states = recorded_states(rows)
    assert set(states) == {"direction", "payload", "temp_leg1"}
    np.testing.assert_allclose(states["direction"], [-1.0, 1.0])
    np.testing.assert_allclose(states["payload"], [0.0, 50.0, 200.0])
    np.testing.assert_allclose(states["temp_leg1"], [20.0, 23.0])
    shown = displayed_states(states)
    assert shown["payload_N"] == [0.0, 50.0, 200.0]
    assert shown["temp_leg1_C"] == [20.0, 23.0]
    assert recorded_states(None) == {}
