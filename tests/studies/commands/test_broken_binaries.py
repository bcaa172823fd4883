"""An error names its file: draws and tables that are no such thing."""

import numpy as np
import pytest
import xarray

from pkm_studies import csv_table
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.earlier_result import read_draws
from pkm_studies.study import PublishedFile

NAMES = ("parameter", ["a", "b"])
DIMENSIONS = ("chain", "draw", "parameter")


def netcdf(**variables: object) -> bytes:
    data = xarray.Dataset(variables)
    return bytes(data.to_netcdf(engine="h5netcdf", group="posterior"))


def draws(theta: np.ndarray) -> bytes:
    return netcdf(theta=(DIMENSIONS, theta), parameter=NAMES)


GOOD = draws(np.ones((1, 5, 2)))
BROKEN = {
    "empty": b"",
    "text": b"no netCDF\n",
    "cut": GOOD[: len(GOOD) // 2],
    "head alone": GOOD[:8],
    "no group": bytes(xarray.Dataset().to_netcdf(engine="h5netcdf")),
    "no draws": netcdf(parameter=NAMES),
    "of a number": netcdf(theta=3.0, parameter=NAMES),
    "not finite": draws(np.full((1, 5, 2), np.nan)),
    "words": draws(np.full((1, 5, 2), "x")),
    "one draw": draws(np.ones((1, 1, 2))),
}


def test_whole_draws_are_read(tmp_path):
    path = tmp_path / "posterior.nc"
    path.write_bytes(GOOD)
    read = read_draws(path, ["b"])
    assert read is not None
    np.testing.assert_array_equal(read, np.ones((5, 1)))
    assert read_draws(path, ["c"]) is None


@pytest.mark.parametrize("content", BROKEN.values(), ids=[*BROKEN])
def test_broken_draws_are_named(tmp_path, content):
    path = tmp_path / "posterior.nc"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_draws(path, ["a"])
    said = str(error.value)
    assert said.startswith(f"{path}: these are no draws of a posterior: ")
    assert "restore the file" in said


DEEP = "x = " + "[" * 5000


@pytest.mark.parametrize(("name", "command"), [
    ("c.campaign.toml", ["campaign", "c.campaign.toml"]),
    ("m.toml", ["import", "columns", "r.csv", "--map", "m.toml", "--out", "o"]),
    ("s.study.toml", ["check", "s.study.toml"]),
])  # fmt: skip
def test_nested_tables_are_named(tmp_path, monkeypatch, capsys, name, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(DEEP, encoding="utf-8")
    (tmp_path / "r.csv").write_text("x,y\n1,2\n", encoding="utf-8")
    assert main(command) == 2
    assert f"{name}: tables or lists are nested too deeply" in capsys.readouterr().err


def test_a_cell_that_no_reader_takes_is_named(tmp_path):
    """Python's reader of CSV takes 131072 characters."""
    path = tmp_path / "long.csv"
    path.write_text(f"x,y\n1,2\n3,{'9' * 200_000}\n", encoding="utf-8")
    for read in (csv_table.read, lambda p: PublishedFile(p).csv_rows(["x"])):
        with pytest.raises(InputError, match=r"long.csv: this is no CSV: field larger"):
            read(path)
