"""Readings: what is read back is what was written; what cannot be used is refused."""

import dataclasses
import math
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import sample
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oed import csv_text, dataset
from oed.dataset import Dataset, ReadingsError, table
from oed.measurement import Measurement


def loaded(text: str, measurement: Measurement, folder: Path) -> Dataset:
    path = folder / "x.readings.csv"
    path.write_text(text, encoding="utf-8")
    return dataset.load(path, measurement)


def refused(text: str | bytes, measurement: Measurement, folder: Path) -> ReadingsError:
    path = folder / "x.readings.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ReadingsError) as error:
        dataset.load(path, measurement)
    return error.value


@pytest.fixture(scope="module")
def head() -> Measurement:
    return sample.resolved().measurement


@pytest.fixture(scope="module")
def delta() -> Measurement:
    return sample.resolved(sample.DELTA).measurement


def test_commands_covariates_and_readings_come_in_si(head, tmp_path):
    found = loaded(sample.READINGS, head, tmp_path)
    np.testing.assert_allclose(found.y, [0.300001, 0.300002, 0.299999], rtol=1e-15)
    (series,) = found.series
    np.testing.assert_allclose(
        series.reading_commands()[1], [1.146, math.pi / 2, math.pi / 6], rtol=1e-14
    )
    assert list(series.run) == ["low", "low", "high"]
    assert list(found.covariates["order"]) == [1, 2, 1]
    assert list(found.covariates["time"]) == [0.0, 6.0, 20.0]
    assert list(found.covariates["row"]) == [2, 3, 5]
    assert math.isnan(found.covariates["temp_bar"][1])
    assert found.dropped == 1


def test_the_first_row_of_a_run_is_its_reference(delta, tmp_path):
    found = loaded(sample.DELTA_READINGS, delta, tmp_path)
    assert found.setups == ("probe", "calliper")
    probe, calliper = found.series
    assert len(probe) == 2
    assert calliper.index.tolist() == [[1, 0], [3, 2]]
    np.testing.assert_allclose(calliper.q[calliper.index[1, 1]], [0.400, 0.400, 0.410])
    np.testing.assert_allclose(found.y[found.spans[1]], [0.0647, 0.0648])
    assert head_of(found.take(["calliper"])) == ["calliper", "calliper"]
    assert len(found.take([])) == 0
    with pytest.raises(KeyError, match="no readings"):
        found.take(["cup"])


def head_of(found: Dataset) -> list[str]:
    return list(found.covariates["setup"])


def test_a_run_without_readings_goes_with_its_reference(delta, tmp_path):
    text = sample.changed(sample.DELTA_READINGS, (",64.8", ","))
    found = loaded(text, delta, tmp_path)
    assert found.dropped == 1
    assert [len(s) for s in found.series] == [2, 1]
    assert list(found.series[1].run) == ["d1"]


def test_rows_are_taken_in_time(head, tmp_path):
    first, *rows = sample.READINGS.splitlines()
    found = loaded("\n".join([first, *reversed(rows)]), head, tmp_path)
    assert list(found.covariates["order"]) == [1, 1, 2]
    assert list(found.covariates["run"]) == ["high", "low", "low"]


def test_files_are_taken_together_and_must_not_meet(head, tmp_path):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    paths[0].write_text(sample.READINGS, encoding="utf-8")
    paths[1].write_text(
        sample.READINGS.replace(",low,", ",again,").replace(",high,", ",top,"),
        encoding="utf-8",
    )
    assert len(dataset.load(paths, head)) == 6
    with pytest.raises(ReadingsError, match="used twice"):
        dataset.load([paths[0], paths[0]], head)


# -- round trip ------------------------------------------------------------------------
number = st.floats(min_value=-1.0, max_value=1.0, allow_nan=False, width=64)
SHARED = [HealthCheck.function_scoped_fixture]
row = st.tuples(
    st.floats(1.066, 1.266),
    st.floats(-2.0 * math.pi, 2.0 * math.pi),
    st.floats(0.0, math.radians(39.9)),
    st.sampled_from(["1", "a,b", 'say "x"', "ü"]),
    number,
    st.one_of(st.just(math.nan), st.floats(0.0, 1e6)),
)


@settings(max_examples=40, deadline=None, suppress_health_check=SHARED)
@given(rows=st.lists(row, min_size=1, max_size=12))
def test_what_is_written_is_read_back(rows, head, tmp_path):
    rows = sorted(
        rows, key=lambda r: [r[3] for r in rows].index(r[3])
    )  # runs come one after the other
    command, y = np.array([r[:3] for r in rows]), np.array([r[4] for r in rows])
    covariates = pd.DataFrame(
        {"time": [r[5] for r in rows], "feed": [abs(r[4]) for r in rows]}
    )
    made = dataset.from_series(
        [head.series("cup", command, [r[3] for r in rows])], y, head, covariates
    )
    path = tmp_path / "round.readings.csv"
    path.write_text(dataset.to_csv(made), "utf-8")
    again = dataset.load(path, head)
    np.testing.assert_allclose(again.y, y, rtol=1e-14, atol=1e-300)
    np.testing.assert_allclose(
        again.series[0].reading_commands(), command, rtol=1e-14, atol=1e-300
    )
    np.testing.assert_allclose(again.series[0].q, made.series[0].q, rtol=1e-12)
    assert list(again.series[0].run) == [r[3] for r in rows]
    for name in ("order", "time", "feed"):
        np.testing.assert_allclose(
            again.covariates.get(name, np.nan),
            made.covariates[name].astype(float),
            rtol=1e-14,
        )
    assert list(tmp_path.iterdir()) == [path]


@settings(max_examples=15, deadline=None, suppress_health_check=SHARED)
@given(
    lengths=st.lists(st.integers(2, 4), min_size=1, max_size=4),
    seed=st.integers(0, 2**32 - 1),
)
def test_joints_and_references_are_read_back(lengths, seed, delta, tmp_path):
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.38, 0.42, (sum(lengths), 3))
    run = [f"run {k}" for k, n in enumerate(lengths) for _ in range(n)]
    series = [
        delta.series_from_joints("probe", q[:2]),
        delta.series_from_joints("calliper", q, run),
    ]
    y = rng.uniform(0.01, 0.1, sum(len(s) for s in series))
    made = dataset.from_series(series, y, delta)
    path = tmp_path / "round.readings.csv"
    path.write_text(dataset.to_csv(made), "utf-8")
    again = dataset.load(path, delta)
    np.testing.assert_allclose(again.y, y, rtol=1e-14)
    for old, new in zip(made.series, again.series, strict=True):
        np.testing.assert_allclose(new.q[new.index], old.q[old.index], rtol=1e-14)
    pd.testing.assert_frame_equal(
        again.covariates.drop(columns="row"), made.covariates, check_dtype=False
    )


def test_series_of_one_set_up_keep_their_runs_apart(delta):
    q = np.full((3, 3), 0.400) + np.arange(3)[:, None] * 0.001
    twice = [
        delta.series_from_joints("calliper", q),
        delta.series_from_joints("calliper", q),
    ]
    made = dataset.from_series(twice, np.arange(4.0), delta)
    assert list(made.covariates["run"]) == ["1", "1", "1 (2)", "1 (2)"]
    assert list(made.covariates["order"]) == [2, 3, 2, 3]


def test_a_plan_to_fill_in_has_empty_readings(head, tmp_path):
    series = head.series("cup", np.array([[1.1, 0.0, 0.5]]))
    text = dataset.to_csv(dataset.from_series([series], np.array([np.nan]), head))
    assert text.splitlines()[1].endswith(",")
    assert "no reading was taken" in str(refused(text, head, tmp_path))


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
    "name twice": (("time_s", "z_mm"), 1, "z_mm", "keep one of them"),
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


@pytest.mark.parametrize(
    "above",
    [
        "# made at the machine\n# psi_deg: from x to y, in degrees\n",
        '"# psi_deg: from x to y, in degrees"\n\n"# again; with ""quotes"""\n',
        "\n# a blank line above, and one below\n\n",
        "sep=,\n# Excel's line first\n",
    ],
)
def test_comments_above_the_header_are_no_rows(tmp_path, head, above):
    """Read as without them; errors count the lines as the file has them."""
    plain, commented = tmp_path / "a.csv", tmp_path / "b.csv"
    plain.write_text(sample.READINGS)
    commented.write_text(above + sample.READINGS)
    first, second = (dataset.load(path, head) for path in (plain, commented))
    assert second.y == pytest.approx(first.y)
    commented.write_text(above + sample.READINGS.replace("300.002", "many"))
    with pytest.raises(dataset.ReadingsError) as caught:
        dataset.load(commented, head)
    lines = above.removeprefix("sep=,\n").count("\n")
    assert f"row {lines + 3}, column length_mm" in str(caught.value)


def test_comments_alone_are_no_readings(tmp_path, head):
    path = tmp_path / "c.csv"
    path.write_text("# nothing else\n")
    with pytest.raises(dataset.ReadingsError, match="no header below the comments"):
        dataset.load(path, head)
