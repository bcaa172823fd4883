"""What was computed stays where a later part of a run fails."""

import json
from pathlib import Path
from unittest import mock

import pytest
from few_poses import SIMULATED

from oed.mechanism import AssemblyError
from pkm_studies.commands import main
from pkm_studies.stages import order

FAILURE = AssemblyError("12 of 65 poses cannot be assembled", [3])


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "p.study.toml"
    path.write_text(SIMULATED, encoding="utf-8")
    return path


@pytest.mark.parametrize(("command", "step", "computed", "absent"), [
    ("run", "report_single_stage", "estimate", "plan"),
    ("diagnose", "diagnose_always", "estimate", "gap"),
    ("diagnose", "fit_parameters", "identifiability", "estimate"),
])  # fmt: skip
def test_what_came_before_a_failure_is_written(
    command, step, computed, absent, study, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(order, step, mock.Mock(side_effect=FAILURE))
    out = tmp_path / "out"
    assert main([command, str(study), "--out", str(out), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert "12 of 65 poses" in message
    assert f"What was computed before is in {out / 'result.json'}" in message
    result = json.loads((out / "result.json").read_text())
    assert result[computed] is not None
    assert result[absent] is None
    assert any("12 of 65 poses" in warning for warning in result["warnings"])


def test_a_failure_takes_no_earlier_result(study, tmp_path, monkeypatch):
    out = tmp_path / "out"
    arguments = ["run", str(study), "--out", str(out), "--quiet"]
    assert main(arguments) == 0
    whole = (out / "result.json").read_bytes()
    monkeypatch.setattr(order, "draw_machine", mock.Mock(side_effect=FAILURE))
    assert main(arguments) == 2
    assert (out / "result-earlier.json").read_bytes() == whole


def test_nothing_is_written_where_nothing_was_computed(study, tmp_path, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr(order, "take_readings", mock.Mock(side_effect=FAILURE))
    assert main(["run", str(study), "--out", str(out), "--quiet"]) == 2
    assert not (out / "result.json").exists()
