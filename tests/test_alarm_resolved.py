"""The alarm of a bad fit, where the fit with effects in the model is good."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_corrected_command import _shipped, run

STUDY = """
[posterior]
enabled = false

[report]
pdf = false
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Study and readings of the planar machine that gives under load."""
    folder = tmp_path_factory.mktemp("alarm")
    readings = folder / "loads.readings.csv"
    assert run("simulate", "planar_gap", "--out", readings) == 0
    study = folder / "loads.study.toml"
    text = _shipped("planar_gap").split("[readings]")[0]
    study.write_text(text + STUDY, encoding="utf-8")
    return study, readings


def test_the_first_line_is_true_of_the_corrected_fit(
    session: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, readings = session
    out = tmp_path / "out"
    options = ["--with", "gravity,frame_bending", "--out", out]
    assert run("identify", study, "--readings", readings, *options) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    model = "With gravity and frame_bending in the model the residuals"
    (first,) = (line for line in lines if line.startswith(model))
    assert "Without: the " in first
    assert "the fit is bad" not in printed.err
    assert not any(line.startswith("The fit is bad") for line in lines)
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert not result["goodness"]["bad_fit"]
    corrected = result["corrected"]
    ratio = (corrected["chi2"] / corrected["dof"]) ** 0.5
    assert f"residuals are {ratio:.2g} times" in first
    assert 0.5 < ratio < 1.5
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<p>The fit is bad" not in page


def test_without_effects_the_alarm_stays(
    session: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, readings = session
    assert (
        run("identify", study, "--readings", readings, "--out", tmp_path / "out") == 1
    )
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[lines.index("report") + 1].startswith(("The fit is", "The readings"))
    assert "the fit is bad" in printed.err


@pytest.mark.slow
def test_one_effect_of_two_resolves_nothing(
    session: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, readings = session
    options = ["--with", "frame_bending", "--out", tmp_path / "out"]
    assert run("identify", study, "--readings", readings, *options) == 1
    result = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))
    assert result["goodness"]["bad_fit"]
    capsys.readouterr()
