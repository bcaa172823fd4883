"""Readings of another machine, and fits that mirror the machine, are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shipped_models import camera, delta

from oed.instrument import mount
from oed.measurement import Measurement
from pkm_studies.commands import main

STUDY = """\
schema = 1
name = "other"

[machine]
model = "delta"
geometry = { radius_mm = 160, arm_mm = 345, endstop_mm = 420, print_radius_mm = 80 }

[[setup]]
name = "probe"
instrument = "height_probe"

[readings]
files = ["other.readings.csv"]

[posterior]
enabled = false

[report]
html = false
pdf = false
"""


def test_readings_of_another_machine_are_exit_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = ["setup,run,order,x_mm,y_mm,z_mm,height_mm"]
    grid = [(x, y, z) for x in (-60, 0, 60) for y in (-60, 0, 60) for z in (0, 100)]
    for k, (x, y, z) in enumerate(grid, start=1):
        height = z + 0.002 * x * y + 30.0 * (-1) ** k
        rows.append(f"probe,a,{k},{x},{y},{z},{height}")
    readings = tmp_path / "other.readings.csv"
    readings.write_text("\n".join(rows) + "\n", encoding="utf-8")
    study = tmp_path / "other.study.toml"
    study.write_text(STUDY, encoding="utf-8")
    code = main(["run", str(study), "--out", str(tmp_path / "out")])
    said = capsys.readouterr()
    assert code == 1
    assert "the fit is bad" in said.err
    assert "times the stated noise" in said.out


def test_a_machine_through_its_singular_pose_is_counted() -> None:
    """A delta whose tool would be above the carriages: the mirrored solution."""
    m = Measurement(delta.machine, [mount(camera.known_frame, "camera")])
    series = m.series("camera", np.array([[0.0, 0.0, 0.1], [0.02, 0.01, 0.2]]))
    assert m.mode_jumps([series], m.nominal) == (0, 2)
    carriages = delta.machine.nominal[9] + np.sqrt(0.345**2 - 0.16175**2) - series.q
    above = series.start.copy()
    above[:, 2] = 2.0 * carriages.mean(axis=1) - above[:, 2]
    mirrored = m.kinematics.forward(series.q, m.nominal, above)
    side = m.kinematics.assembly_side(mirrored, series.q, m.nominal)
    assert (
        side * m.kinematics.assembly_side(series.start, series.q, m.nominal)
    ).tolist() == [-1.0, -1.0]
