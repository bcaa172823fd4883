"""Readings files that are refused, with row and column."""

import dataclasses
import re
import tracemalloc

import pytest
import sample
from dataset_files import loaded, refused

from oed import csv_text, dataset
from oed.dataset import ReadingsError, table
from oed.measurement import Measurement


@pytest.fixture(scope="module")
def head() -> Measurement:
    return sample.resolved().measurement


@pytest.fixture(scope="module")
def delta() -> Measurement:
    return sample.resolved(sample.DELTA).measurement


LINE = "cup,low,1,1146,0,30,0,1,0.5,300.001"
BAD = {
    "nan": ((LINE, LINE.replace("300.001", "nan")), 2, "length_mm", "not a finite number"),
    "infinite": ((LINE, LINE.replace("300.001", "1e999")), 2, "length_mm", "not a finite number"),
    "words": ((LINE, LINE.replace("300.001", "n/a")), 2, "length_mm", "leave the cell empty"),
    "decimal comma": ((LINE, LINE.replace("300.001", '"300,001"')), 2, "length_mm", "with a point"),
    "repeated order": (("cup,low,2,", "cup,low,1,"), 3, "order", "used twice"),
    "broken order": (("cup,low,2,", "cup,low,1.5,"), 3, "order", "whole number"),
    "no order": (("cup,low,2,", "cup,low,,"), 3, "order", "whole number"),
    "no set-up": (("cup,low,2,", ",low,2,"), 3, "setup", "empty"),
    "unknown set-up": (("cup,high", "cop,high"), 5, "setup", "did you mean cup"),
    "direction": (("6,1,,", "6,2,,"), 3, "direction", "+1 or -1"),
    "out of the workspace": (("1146,90", "1000,90"), 3, "z_mm", "goes from 1066 to 1266"),
    "pose missing": (("1146,90", ",90"), 3, "z_mm", "cell is empty"),
    "ragged": ((LINE, LINE + ",5"), 2, "", "11 cells"),
    "unknown column": (("time_s", "tine_s"), 1, "tine_s", "did you mean time_s"),
    "unknown unit": (("length_mm", "length_kg"), 1, "length_kg", "length_mm, length_um"),
    "another unit": (("length_mm", "length_deg"), 1, "length_deg", "length_um"),
    "no unit": (("length_mm", "length"), 1, "length", "write length_m,"),
    "set-up column": (("setup,", "set,"), 1, "setup", "missing"),
    "reading column": (("length_mm", "payload_N"), 2, "length_mm", "has no column"),
    "column twice": (("time_s", "z_um"), 1, "z_um", "given twice"),
    "pose column": (("psi_deg", "payload_N"), 2, "psi", "no column for psi"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_refused_with_row_and_column(name, head, tmp_path):
    change, row, column, words = BAD[name]
    error = refused(sample.changed(sample.READINGS, change), head, tmp_path)
    assert (error.row, error.column) == (row, column)
    assert words in str(error)
    assert len(str(error)) <= 600


@pytest.mark.parametrize(("text", "words"), [
    (b"", "empty"), (b"  \n \n", "empty"), (b"setup,run,order,z_mm\n", "no readings"),
    ("setup,run,order\ncup,\xfc,1\n".encode("latin-1"), "UTF-8"),
    (b"setup,run,order\n\0", "NUL"), (b'setup,run,order\n"a,b\n', "CSV"),
    (b"setup;run;order\n1;2\n", "2 cells"),
    (b"setup,run,order," + b",".join(b"q%d_mm" % k for k in range(300)) + b"\n", "too many"),
])  # fmt: skip
def test_refused_as_text(text, words, head, tmp_path):
    assert words in str(refused(text, head, tmp_path))


def test_a_huge_file_is_refused_unread(head, tmp_path):
    path = tmp_path / "huge.csv"
    with path.open("wb") as file:
        file.truncate(table.MAX_BYTES + 1)
    with pytest.raises(ReadingsError, match="too large"):
        dataset.load(path, head)


def test_too_many_readings_are_refused_before_they_are_parsed(
    head, tmp_path, monkeypatch
):
    """The memory stays below 20 times the file, time is seconds."""
    path = tmp_path / "long.csv"
    header, *rows = sample.READINGS.splitlines()
    rows = [row.replace(",1,", ",{},", 1) for row in rows[:1]] * 10_000
    body = "\n".join(row.format(k) for k, row in enumerate(rows, start=1))
    path.write_text(f"{header}\n{body}\n", encoding="utf-8")
    monkeypatch.setattr(table, "MAX_READINGS", 5_000)
    tracemalloc.start()
    with pytest.raises(ReadingsError) as error:
        dataset.load(path, head)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "10000 rows are too many: a session has at most 5000" in str(error.value)
    assert "keep one row in 2 of each run" in str(error.value)
    assert peak < 20 * path.stat().st_size


def test_readings_are_counted_by_channel(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "MAX_READINGS", 4)
    text = sample.changed(
        sample.STUDY, ('instrument = "ball_bar"', 'instrument = "camera_known_frame"')
    )
    text = text.replace("length_mm = 300.0\n", "").replace(
        "length_um = 0.5", "read_x_um = 5"
    )
    text = re.sub(r"teach = .*\n", "", text).replace(
        'theta = "hold"', "theta_deg = 20.0"
    )
    camera = sample.resolved(text).measurement
    rows = "setup,run,order,z_mm,psi_deg,theta_deg,read_x_mm,read_y_mm,read_z_mm\n"
    rows += "cup,1,1,1146,0,20,1,2,3\n"
    assert len(loaded(rows, camera, tmp_path).y) == 3
    rows += "cup,1,2,1146,9,20,1,2,3\n"
    assert "about 6 readings are too many" in str(refused(rows, camera, tmp_path))


@pytest.mark.parametrize("cell", ["", "abc", "1e99"])
def test_one_remedy_for_a_cell_of_a_pose(cell, delta, tmp_path):
    """It may not be left empty, whatever is wrong with it."""
    text = sample.changed(sample.DELTA_READINGS, ("390,410,400", f"{cell},410,400"))
    error = refused(text, delta, tmp_path)
    assert (error.row, error.column) == (3, "q1_mm")
    remedy = "write the number: each row of a set-up has all of q1, q2, q3"
    assert error.remedy == remedy
    text = sample.changed(sample.DELTA_READINGS, ("400,18.2,", "400,abc,"))
    assert "leave the cell empty" in refused(text, delta, tmp_path).remedy


def test_a_run_may_have_any_name(head, tmp_path):
    """Also one that a spreadsheet would evaluate: it is marked, and comes back."""
    names = ("=1+1", "'=1", "@x", "-a")
    for name in names:
        text = sample.READINGS.replace(",low,", f',"{csv_text.safe(name)}",')
        read = loaded(text, head, tmp_path)
        assert name in list(read.covariates["run"])
        written = dataset.to_csv(read)
        assert f"cup,{csv_text.safe(name)},1," in written
        again = loaded(written, head, tmp_path)
        assert list(again.covariates["run"]) == list(read.covariates["run"])


def test_a_set_up_reads_only_its_own_channels(delta, tmp_path):
    text = sample.changed(sample.DELTA_READINGS, ("18.1,", "18.1,60"))
    error = refused(text, delta, tmp_path)
    assert (error.row, error.column) == (2, "length_mm")


def test_a_run_of_one_row_measures_nothing(delta, tmp_path):
    text = sample.DELTA_READINGS + "calliper,d3,1,400,400,410,,\n"
    assert "no reading" in str(refused(text, delta, tmp_path))


def test_joints_out_of_reach_are_told(delta, tmp_path):
    text = sample.changed(sample.DELTA_READINGS, ("390,410,400", "390,4100,400"))
    error = refused(text, delta, tmp_path)
    assert (error.row, error.column) == (3, "q2_mm")
    # within the range of each joint, and yet no pose
    text = sample.changed(sample.DELTA_READINGS, ("390,410,400", "-40,590,-40"))
    error = refused(text, delta, tmp_path)
    assert error.row == 3
    assert "cannot reach" in str(error)


def test_a_dataset_counts_its_readings(head, tmp_path):
    found = loaded(sample.READINGS, head, tmp_path)
    with pytest.raises(ValueError, match="readings are planned"):
        dataclasses.replace(found, y=found.y[:2])
