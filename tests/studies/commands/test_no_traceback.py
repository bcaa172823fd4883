"""Odd studies and readings that once ended in a traceback."""

import json
from pathlib import Path

import pytest
import sample

from pkm_studies.commands import main

LINES = """\
schema = 1
name = "lines"

[machine]
model = "planar_2dof"

[[setup]]
name = "rm4"
instrument = "rm4"

[[setup]]
name = "rm5"
instrument = "rm5"

[identify]
effects = "none"

[posterior]
enabled = false

[report]
html = false
pdf = false

[design]
readings = 2

[[design.candidates]]
setup = "rm4"
y_mm = [0.0, 500.0]
z_mm = [0.0, 500.0, 1000.0]
runs_by = "y"
"""
#: readings of the set-up that the design does not use
OTHER = """\
setup,run,order,y_mm,z_mm,dy_mm,dz_mm
rm5,1,1,0,0,0,0
rm5,1,2,500,0,500.01,0.01
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "s.study.toml"
    path.write_text(LINES, encoding="utf-8")
    return path


def test_readings_of_a_set_up_that_the_design_does_not_use(study, tmp_path):
    readings, out = tmp_path / "r.csv", tmp_path / "out"
    readings.write_text(OTHER, encoding="utf-8")
    call = ["identify", study, "--readings", readings, "--out", out, "--quiet"]
    assert main([str(a) for a in call]) == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["estimate"]["readings"] == 2
    assert any("no readings of rm5" in warning for warning in result["warnings"])


@pytest.mark.parametrize(("change", "words"), [
    (("[0.0, 500.0, 1000.0]", "[0.0]"), "design.candidates[1]: every run is one"),
    (("[design]", '[readings]\nsimulate = true\nfit = ["rm2"]\n[design]'),
     'readings.fit[1] = "rm2": no such set-up'),
    (("[design]", "[prediction]\nvirtual_machines = 1000000000\n[design]"),
     "prediction.virtual_machines = 1000000000"),
])  # fmt: skip
def test_studies(change, words, study, capsys):
    study.write_text(sample.changed(LINES, change), encoding="utf-8")
    assert main(["check", str(study)]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("change", "words"), [
    (("low,1", "low,-1"), "column order = -1"),
    (("30,6,1", "30,-6,1"), "column time_s = -6"),
    (("direction", "repeat"), "column repeat = -1"),
])  # fmt: skip
def test_readings(change, words, tmp_path, capsys):
    path = tmp_path / "r.csv"
    path.write_text(sample.changed(sample.READINGS, change), encoding="utf-8")
    assert main(["check", str(path)]) == 2
    assert words in capsys.readouterr().err
