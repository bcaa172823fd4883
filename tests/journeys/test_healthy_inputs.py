"""Healthy machines with turns between their poses, and nests beside the axis, end to end."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from pkm_studies.commands import main

pytestmark = pytest.mark.slow
GAP = re.compile(r"\[gap\]\neffects = \[.*\]\n")


def result(
    folder: Path, out: Path, command: str, gap: str, identify: str
) -> dict[str, Any]:
    """The result of an input with another [gap] and [identify]."""
    shutil.copytree(folder, out)
    study = out / "case.study.toml"
    study.chmod(0o644)
    text, count = GAP.subn(gap, study.read_text(encoding="utf-8"))
    assert count == 1
    study.write_text(f"{text}\n{identify}", encoding="utf-8")
    readings, folder = out / "case.readings.csv", out / "d"
    arguments = [command, study, "--readings", readings, "--out", folder, "--quiet"]
    assert main([*map(str, arguments), "--allow-code"]) in (0, 1)
    loaded: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return loaded


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("cable_healthy", 45.0, 70.0), ("h4_none_controller", 24.0, 38.0)],
)
def test_effects_that_do_not_act_cost_no_accuracy(
    shared_data, tmp_path, name, low, high
):
    """By least squares alone x errs by 55 um (cables) and by 30 um (H4)."""
    folder = shared_data.parent / "inputs" / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    allowed = '[identify]\neffects = "catalogue"\n'
    found = result(folder, tmp_path / "case", "identify", "", allowed)
    mixture = found["gap"]["mixture"]
    assert low < mixture["prediction"]["components"]["x"]["after"]["rms"] < high
    for parameter, value in mixture["controller"].items():
        estimate = found["estimate"]["parameters"][parameter]
        assert abs(value - estimate["value"]) < 2.0 * estimate["prior_sd"]


def test_nests_beside_the_axis_have_a_diagnosis(shared_data, tmp_path):
    folder = shared_data.parent / "inputs" / "rss_off_axis_nest"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    gap = '[gap]\neffects = ["servo_lag", "gravity"]\n'
    found = result(folder, tmp_path / "case", "diagnose", gap, "")
    mixture = found["gap"]["mixture"]
    assert mixture["prediction"]["components"]["x"]["after"]["rms"] < 30.0
    assert mixture["sent"] != "nothing"
