"""Runs that are killed, or whose later part fails: what was computed stays."""

import json
from pathlib import Path
from unittest import mock

import pytest
import sample
import xarray as xr
from few_poses import SIMULATED

from oed.mechanism import AssemblyError
from oed.posterior import Checkpoint
from pkm_studies.commands import main
from pkm_studies.stages import order

STUDY = (
    sample.DELTA
    + "[readings]\nfiles = ['r.csv']\n[posterior]\nsampler = 'emcee'\nsteps = 100\ness = 1000000\n"
    + "[report]\nhtml = false\npdf = false\n"
)


class KilledError(BaseException):
    """Stands for a kill after the chain is saved for the first time."""


def command(study: Path, out: Path) -> list[str]:
    return ["run", str(study), "--quiet", "--out", str(out)]


def written(folder: Path) -> tuple[bytes, dict[str, object]]:
    """Draws and result of a run, without the time that it took."""
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        draws = tree["posterior"]["theta"].to_numpy().tobytes()
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    return draws, {key: value for key, value in result.items() if key != "seconds"}


def names(folder: Path) -> set[str]:
    """Files of a folder; a kill in the middle of a write leaves a hidden one."""
    return {path.name for path in folder.iterdir() if path.name[0] != "."}


def test_run_resumes_by_itself(tmp_path, monkeypatch, capsys):
    study = tmp_path / "s.study.toml"
    study.write_text(STUDY, encoding="utf-8")
    (tmp_path / "r.csv").write_text(sample.DELTA_READINGS, encoding="utf-8")
    save = Checkpoint.save

    def kill_after_saving(chain: Checkpoint, arrays: dict[str, object]) -> None:
        save(chain, arrays)
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", kill_after_saving)
        with pytest.raises(KilledError):
            main(command(study, tmp_path / "killed"))
    assert names(tmp_path / "killed") == {"posterior.unfinished"}
    # the sample's readings are made up, so that their fit is bad
    assert main(command(study, tmp_path / "unbroken")) == 1
    capsys.readouterr()
    resumed = [a for a in command(study, tmp_path / "killed") if a != "--quiet"]
    assert main(resumed) == 1
    assert "posterior, resumed after 50 steps" in capsys.readouterr().out
    assert written(tmp_path / "killed") == written(tmp_path / "unbroken")
    assert names(tmp_path / "killed") == names(tmp_path / "unbroken")


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
