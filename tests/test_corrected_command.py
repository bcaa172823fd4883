"""`oed identify --with`: parameters and effects together, and who takes them."""

import json
from pathlib import Path

import pytest

from oed.result import StudyResult
from pkm_studies import cli, result_folder


def run(*arguments: str | Path) -> int:
    return cli.main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The planar machine that gives under load, identified with both its effects."""
    folder = tmp_path_factory.mktemp("corrected")
    readings = folder / "loads.readings.csv"
    assert run("simulate", "planar_gap", "--out", readings) == 0
    study = folder / "loads.study.toml"
    text = _shipped("planar_gap").split("[readings]")[0]
    study.write_text(text + "[posterior]\nenabled = false\n")
    code = run(
        "identify",
        study,
        "--readings",
        readings,
        "--with",
        "gravity,frame_bending",
        "--out",
        folder / "out",
    )
    assert code == 0
    return folder


def _shipped(name: str) -> str:
    from pkm_studies import shipped

    return shipped.study_path(Path(name)).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def result(folder: Path) -> StudyResult:
    return result_folder.load_result(folder / "out")


def test_corrected_parameters_are_within_their_deviations(
    folder: Path, result: StudyResult
) -> None:
    truth = json.loads((folder / "loads.truth.json").read_text())
    assert result.corrected is not None
    assert result.estimate is not None
    factor = {"mm": 1e-3, "mrad": 1e-3}
    worst_plain = 0.0
    for name, p in result.corrected.parameters.items():
        true = truth[name]["value"] / factor[p.unit]
        assert abs(p.value - true) < 4.0 * p.sd, name
        plain = result.estimate.parameters[name]
        worst_plain = max(worst_plain, abs(plain.value - true) / plain.sd)
    assert worst_plain > 30.0


def test_coefficients_have_a_readers_unit(result: StudyResult) -> None:
    assert result.corrected is not None
    struts = result.corrected.effects["gravity: struts"]
    assert struts.unit == "um"
    assert abs(struts.value - 60.0) < 4.0 * struts.sd


def test_the_prediction_states_its_conditions(result: StudyResult) -> None:
    corrected = result.corrected
    assert corrected is not None
    assert corrected.prediction is not None
    assert any("payload" in sentence for sentence in corrected.conditions)
    z = corrected.prediction.components["z"]
    assert z.after.rms < 0.2 * corrected.parameters_only["z"].rms


def test_compensation_takes_the_corrected_values(
    folder: Path, result: StudyResult
) -> None:
    assert run("compensate", folder / "out", "--to", "json") == 0
    written = (folder / "out" / "compensation.json").read_text()
    assert "section corrected" in written


def test_an_effect_that_the_readings_cannot_show_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, readings = folder / "loads.study.toml", folder / "loads.readings.csv"
    options = ["--with", "backlash", "--out", str(folder / "no")]
    assert run("identify", study, "--readings", readings, *options) == 2
    assert "direction" in capsys.readouterr().err
