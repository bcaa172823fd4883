"""A run that is killed and called again ends as the unbroken one."""

import json
from pathlib import Path

import pytest
import sample
import xarray as xr

from oed.posterior import Checkpoint
from pkm_studies.commands import main

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
