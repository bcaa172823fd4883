"""Columns, dialects and rows of a readings file, also as spreadsheets save them."""

import codecs
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import sample
from shipped_models import (
    a3_head,
    ball_bar,
    cables_planar,
    planar_2dof,
    pose_tracker,
    relative,
)

from oed.base import consecutive_slices
from oed.dataset import ReadingsError, columns, csv_input, data, table
from oed.dataset.csv_input import with_stretch
from oed.dataset.readings_file import ReadingsFile
from oed.dataset.table import check_rows
from oed.instrument import mount
from oed.measurement import Measurement
from oed.units import UnitError

HEADER = ["setup", "run", "order", "z_mm", "direction", "length_mm"]


def read(*rows: list[str], separator: str = ",") -> ReadingsFile:
    numbered = [(k, cells) for k, cells in enumerate([HEADER, *rows], start=1)]
    return table.from_rows(numbered, "x.csv", separator=separator)


@pytest.mark.parametrize(("name", "stem", "unit", "factor"), [
    ("z_mm", "z", "m", 1e-3),
    ("read_alpha_mrad", "read_alpha", "rad", 1e-3),
    ("feed_mm_min", "feed", "m/s", 1e-3 / 60.0), ("direction", "direction", "1", 1.0),
])  # fmt: skip
def test_a_column_states_its_unit(name, stem, unit, factor):
    column = columns.ReadingsColumn.parse(name)
    assert (column.stem, column.unit) == (stem, unit)
    assert column.factor == pytest.approx(factor)


def test_a_column_without_a_known_unit_is_refused():
    with pytest.raises(UnitError):
        columns.ReadingsColumn.parse("z_furlong")


def test_columns_are_written_as_they_are_read():
    for stem, unit, value in (("z", "m", 0.0123), ("psi", "rad", 0.5), ("q", "K", 2.0)):
        column = columns.ReadingsColumn.of(stem, unit)
        assert float(columns.cell(value, unit)) * column.factor == pytest.approx(value)
        assert column.name in columns.column_names(stem, unit)
    assert columns.cell(np.nan, "m") == ""


def test_covariates_are_known_by_their_stems():
    assert columns.temperature_body("temp_bar") == "bar"
    assert columns.temperature_body("temp_") is None
    assert columns.ReadingsColumn.from_covariate("length") is None
    tension = columns.ReadingsColumn.from_covariate("tension_2")
    assert tension.unit == "N"
    temperature = columns.ReadingsColumn.from_covariate("temp_bar")
    assert temperature == columns.ReadingsColumn("temp_bar_C", "temp_bar", "K", 1.0)
    assert columns.tension_columns(a3_head.machine) == []
    count = len(cables_planar.machine.joints)
    assert len(columns.tension_columns(cables_planar.machine)) == count


def test_rows_become_numbers_and_labels():
    rows = read(["a", "1", "2", "5,5", "-1", ""], separator=";")
    assert rows.frame["z"].tolist() == [0.0055]
    assert rows.frame["length"].isna().all()
    check_rows(rows)


@pytest.fixture(scope="module")
def planar() -> Measurement:
    return Measurement(planar_2dof.machine, [mount(relative.rm5, "ruler")])


def test_known_columns_are_those_of_machine_and_instruments(planar):
    expected = csv_input.expected_columns(planar)
    assert expected["y"] == expected["dz"] == "m"
    assert csv_input.pose_groups(planar)[0] == ["y", "z"]
    m = Measurement(
        a3_head.machine, [mount(ball_bar.instrument, "a", teach=(1.2, 0, 0))]
    )
    rows = read(["a", "1", "1", "1200", "1", "300"])
    csv_input.check_columns(rows, m)
    csv_input.check_setups(rows, m)
    with pytest.raises(ReadingsError, match="unknown column"):
        csv_input.check_columns(rows, planar)
    with pytest.raises(ReadingsError, match="no such set-up"):
        csv_input.check_setups(rows, planar)


def test_a_pose_is_filled_whole_or_not_at_all():
    rows = read(["a", "1", "1", "5", "1", "2"], ["a", "1", "2", "", "", ""])
    first, second = (np.array([k]) for k in (0, 1))
    filled = csv_input.filled_columns(rows, ["z", "length"], first)
    assert filled is not None
    np.testing.assert_allclose(filled, [[5e-3, 2e-3]])
    assert csv_input.filled_columns(rows, ["z", "length"], second) is None
    with pytest.raises(ReadingsError):
        csv_input.filled_columns(rows, ["z", "length", "q"], first)


def test_references_of_runs_are_rows_without_readings(planar):
    command = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    series = planar.series("ruler", command, run=["a"] * 3)
    readings = data.from_series([series], np.array([1e-6, 2e-6, np.nan, 4e-6]), planar)
    header, *rows = data.to_csv(readings).splitlines()
    assert header.startswith("setup,run,order,y_mm,z_mm")
    assert len(rows) == 3
    assert rows[0].endswith(",,")  # the reference
    assert rows[1].split(",")[-2:] == ["0.001", "0.002"]
    layout = data.column_layout(planar.machine, planar.setups["ruler"])
    assert layout.reference
    assert consecutive_slices([2, 0, 3]) == (slice(0, 2), slice(2, 2), slice(2, 5))


def test_a_table_has_two_hundred_columns_at_most():
    """Columns without a name count as well."""
    for spare, accepted in ((194, True), (195, False)):
        header, cells = [*HEADER, *[""] * spare], ["a", "1", "1", "5", "1", "2"]
        numbered = [(1, header), (2, [*cells, *[""] * spare])]
        if accepted:
            assert len(table.from_rows(numbered, "x.csv").columns) == len(HEADER)
            continue
        with pytest.raises(ReadingsError, match="201 columns are too many"):
            table.from_rows(numbered, "x.csv")


def test_blocks_of_rows_make_one_table(monkeypatch):
    rows = [["a", str(k % 2), str(k), f"{k}.5", "", "2"] for k in range(1, 8)]
    whole = read(*rows).frame
    monkeypatch.setattr(table, "ROWS_AT_ONCE", 3)
    pd.testing.assert_frame_equal(read(*rows).frame, whole)
    rows[1][5], rows[6][3], rows[6][5] = "late", "first", "last"
    with pytest.raises(ReadingsError, match="row 8, column z_mm = first"):
        read(*rows)  # of the first column, though an earlier block has another


def test_cables_that_stretch_are_longer_than_paid_out():
    machine = dataclasses.replace(
        cables_planar.machine,
        cable_stiffness=(1e4,) * len(cables_planar.machine.joints),
    )
    m = Measurement(machine, [mount(pose_tracker.position, "tracker")])
    command = machine.home_command + np.array([[0.0, 0.0], [0.15, -0.1]])
    series = m.series("tracker", command, run=["a"] * 2)
    tension = np.array([[10.0] * 4, [40.0, 5.0, 20.0, 10.0]])
    stretched = with_stretch(m, series, tension)
    at = stretched.start, stretched.q, m.machine.nominal
    base, platform, per_length = m.kinematics.struts(*at)
    long = np.linalg.norm(platform - base, axis=-1)
    strain = tension / 1e4
    wanted = per_length * (long - long / (1.0 + strain))
    np.testing.assert_allclose(stretched.q - series.q, wanted, atol=1e-9)
    assert m.kinematics.forward(*at[1:], at[0]) == pytest.approx(at[0], abs=1e-9)
    np.testing.assert_array_equal(with_stretch(m, series, 0.0 * tension).q, series.q)


PLAIN = sample.READINGS
GERMAN = PLAIN.replace(",", ";").replace(".", ",")


def frame(path: Path, content: bytes) -> pd.DataFrame:
    path.write_bytes(content)
    return table.read(path).frame.drop(columns=table.FILE)


def with_remarks(text: str, separator: str) -> str:
    """A remark column, an unnamed empty one, and no cells for them from row 4 on."""
    lines = text.splitlines()
    ends = ["remark", "bar warm, door open", "", None, None]
    changed = []
    for line, end in zip(lines, ends, strict=True):
        cell = "" if end is None else f'{separator}"{end}"{separator}'
        changed.append(line + cell)
    return "\r\n".join(changed) + "\r\n"


WRITTEN = {
    "semicolons": GERMAN.encode(),
    "byte order mark": codecs.BOM_UTF8 + GERMAN.encode(),
    "tabs": PLAIN.replace(",", "\t").replace(".", ",").encode(),
    "UTF-16": GERMAN.replace(";", "\t").encode("utf-16"),
    "named separator": b"sep=;\r\n" + GERMAN.replace("\n", "\r\n").encode(),
    "quoted": GERMAN.replace("300,001", '"300,001"').encode(),
    "remarks": with_remarks(GERMAN, ";").encode(),
    "remarks and commas": with_remarks(PLAIN, ",").encode(),
    "trailing cells": GERMAN.replace("\n", ";;\n").encode(),
    "points": PLAIN.replace(",", ";").encode(),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_spreadsheet_gives_the_same_readings(name, tmp_path):
    expected = frame(tmp_path / "plain.csv", PLAIN.encode())
    assert expected["length"].to_numpy()[0] == pytest.approx(0.300001)
    got = frame(tmp_path / "excel.csv", WRITTEN[name])
    pd.testing.assert_frame_equal(got, expected)


@pytest.mark.parametrize(("text", "where", "words"), [
    (GERMAN.replace("300,001", "1.300,001"), "row 2, column length_mm", "thousand"),
    (GERMAN.replace("300,001", "300,0,1"), "row 2, column length_mm", "300,0,1"),
    (PLAIN.replace("300.001", '"300,001"'), "row 2, column length_mm", "point"),
    (GERMAN.replace("300,001", "300,001;loose"), "row 2", "11 cells"),
    (GERMAN.replace(";300,001", ""), "row 2", "9 cells"),
    (GERMAN.replace("\n", ";\n").replace("300,001;", "300,001;loose"), "row 2, column", "name it in the header"),
    (GERMAN.replace("setup;", "sets;"), "row 1, column setup", "missing"),
])  # fmt: skip
def test_what_is_ambiguous_is_refused(text, where, words, tmp_path):
    path = tmp_path / "r.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ReadingsError) as error:
        table.read(path)
    assert where in str(error.value)
    assert words in str(error.value)


def test_remarks_may_be_numbered_and_are_not_read(tmp_path):
    lines = PLAIN.splitlines()
    text = "\n".join([f"{lines[0]},remark,Remark_2", *[f"{x},a,1" for x in lines[1:]]])
    got = frame(tmp_path / "r.csv", text.encode())
    assert not any("remark" in str(column).lower() for column in got.columns)
    assert np.isfinite(got["length"].to_numpy()[0])
