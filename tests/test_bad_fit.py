"""A bad fit is loud: first line, exit code, and no accuracy predicted from it."""

from __future__ import annotations

import json
from pathlib import Path

import bar_readings
import numpy as np
import pytest
import sample

from pkm_studies.commands import main

STUDY = """\
schema = 1
name = "loud"

[machine]
model = "a3_head"

[[setup]]
name = "cup"
instrument = "ball_bar"
length_mm = 300.0
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }

[[setup]]
name = "long_tool"
instrument = "ball_bar"
length_mm = 300.0
tool_mm = [0.0, 0.0, 100.0]
teach = { z_mm = 1386.0, psi_deg = 0.0, theta_deg = 0.0 }

[noise]
length_um = 0.5

[identify]
effects = "none"

[posterior]
enabled = false

[prediction]
reference = "home"
z_mm = [1166.0]
psi_deg = [0.0, 120.0, 240.0]
theta_deg = 20.0

[report]
pdf = false
"""


#: the same study where its report is not the matter
WITHOUT_REPORT = sample.changed(STUDY, ("pdf = false", "html = false\npdf = false"))


def write(
    folder: Path, readings: bar_readings.Readings, text: str = STUDY
) -> tuple[Path, Path]:
    """The study, and the readings as their file."""
    rows = ["setup,run,order,z_mm,psi_deg,theta_deg,length_mm"]
    y = iter(1e3 * readings.y)
    for setup, command in readings.command.items():
        for k, (z, psi, theta) in enumerate(command):
            run = f"{setup} {k // bar_readings.POINTS + 1}"
            pose = f"{1e3 * z:.9g},{np.rad2deg(psi):.12g},{np.rad2deg(theta):.12g}"
            rows.append(
                f"{setup},{run},{k % bar_readings.POINTS + 1},{pose},{next(y):.9g}"
            )
    study, table = folder / "loud.study.toml", folder / "r.csv"
    study.write_text(text, encoding="utf-8")
    table.write_text("\n".join([*rows, ""]), encoding="utf-8")
    return study, table


def identify(folder: Path, readings: bar_readings.Readings, text: str = STUDY) -> int:
    study, table = write(folder, readings, text)
    out = str(folder / "fit")
    return main(["identify", str(study), "--readings", str(table), "--out", out])


def test_a_mistake_is_the_first_line_and_predicts_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    readings = bar_readings.a3_readings(0)
    turned = readings.with_y(2.0 * bar_readings.LENGTH - readings.y)
    assert identify(tmp_path, turned) == 1
    out = capsys.readouterr().out
    first = "The readings look mistaken: the sign of the deviations of length_mm"
    lines = out.splitlines()
    stages = lines.index("report") + 1
    assert lines[stages].startswith(first)
    assert "The predicted accuracy is withheld" in out
    result = json.loads((tmp_path / "fit/result.json").read_text())
    assert result["prediction"] is None
    assert result["goodness"]["bad_fit"]
    assert "is reversed" in result["goodness"]["mistakes"][0]["what"]
    page = (tmp_path / "fit/report.html").read_text(encoding="utf-8")
    assert 0 < page.index(first) < page.index('id="identif')


def test_an_outlier_is_named_and_set_aside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    readings = bar_readings.a3_readings(0)
    y = readings.y.copy()
    y[17] += 50 * bar_readings.SIGMA
    assert identify(tmp_path, readings.with_y(y), WITHOUT_REPORT) == 0
    assert "Row 19, column length_mm" in capsys.readouterr().out
    result = json.loads((tmp_path / "fit/result.json").read_text())
    assert [o["row"] for o in result["goodness"]["outliers"]] == [19]
    assert result["estimate"]["readings"] == len(y) - 1
    assert result["prediction"] is not None
