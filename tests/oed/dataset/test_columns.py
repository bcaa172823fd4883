"""Columns, dialects, rows and deviations of readings, also as spreadsheets save them."""

import codecs
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import sample
from scipy.optimize import least_squares
from shipped_models import (
    a3_head,
    ball_bar,
    cables_planar,
    laser_ball_bar,
    linear_delta,
    planar_2dof,
    pose_tracker,
    relative,
)

from oed import Measurement, dataset, mount
from oed.base import consecutive_slices
from oed.dataset import ReadingsError, columns, csv_input, data, table
from oed.dataset.csv_input import with_stretch
from oed.dataset.readings_file import ReadingsFile
from oed.dataset.table import check_rows
from oed.estimation import identify
from oed.gap import prepare
from oed.measurement import reading_structure
from oed.posterior import draw_approximation
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


laser = laser_ball_bar.position
position = pose_tracker.position
machine = linear_delta.machine

SIGMA_UM = np.array([5.0, 5.0, 20.0])
PLACES = [(x, y, z) for x in (-60, 0, 60) for y in (-60, 0, 60) for z in (40, 120)]


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    """A delta under a tracker whose frame is known."""
    fixed = {n.name: 0.0 for n in position.nuisances}
    sigma = list(1e-6 * SIGMA_UM)
    setup = mount(position, "tracker", sigma=sigma, tolerances=fixed)
    return Measurement(machine, [setup])


@pytest.fixture(scope="module")
def text(measurement: Measurement) -> str:
    """Readings with errors of their own size; a third of the rows states none in z."""
    rng = np.random.default_rng(2)
    own = SIGMA_UM * rng.uniform(0.2, 8.0, (len(PLACES), 3))
    own[::3, 2] = SIGMA_UM[2]
    truth = measurement.nominal + 1e-4 * rng.normal(size=len(measurement.nominal))
    series = measurement.series("tracker", 1e-3 * np.array(PLACES, dtype=float))
    read = measurement.readings([series], truth).reshape(-1, 3)
    read += 1e-6 * own * rng.normal(size=own.shape)
    head = "setup,run,order,x_mm,y_mm,z_mm,read_x_mm,read_y_mm,read_z_mm"
    lines = [head + ",sigma_read_x_um,sigma_read_y_um,sigma_read_z_mm"]
    for k, (place, y, sd) in enumerate(zip(PLACES, read, own, strict=True)):
        z = "" if k % 3 == 0 else repr(float(1e-3 * sd[2]))
        cells = [*place, *(1e3 * y), sd[0], sd[1]]
        lines.append(
            f"tracker,1,{k + 1}," + ",".join(map(repr, map(float, cells))) + f",{z}"
        )
    return "\n".join(lines)


def stated(text: str) -> np.ndarray:
    """Standard deviations (N,), SI, out of the text alone."""
    rows = [line.split(",")[-3:] for line in text.splitlines()[1:]]
    factors = (1e-6, 1e-6, 1e-3)
    default = 1e-6 * SIGMA_UM
    values = [
        [float(c) * f if c else d for c, f, d in zip(r, factors, default, strict=True)]
        for r in rows
    ]
    return np.ravel(values)


def loaded(text: str, measurement: Measurement, folder: Path) -> dataset.Dataset:
    path = folder / "a.readings.csv"
    path.write_text(text)
    return dataset.load(path, measurement)


def test_the_fit_is_weighted_least_squares(measurement, text, tmp_path):
    data = loaded(text, measurement, tmp_path)
    sd = stated(text)
    np.testing.assert_allclose(measurement.sigma(data.series), sd, rtol=1e-12)
    estimate = identify(measurement, data.series, data.y, estimate_noise=False)
    free = measurement.free
    tolerance = measurement.tolerance[free]

    def residual(z: np.ndarray) -> np.ndarray:
        theta = measurement.nominal
        theta[free] += tolerance * z
        misfit = (measurement.readings(data.series, theta) - data.y) / sd
        return np.concatenate([misfit, z])

    fit = least_squares(residual, np.zeros(free.sum()), xtol=1e-14, ftol=1e-14)
    change = (estimate.theta - measurement.nominal)[free]
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(tolerance, tolerance)
    spread = np.sqrt(np.diag(covariance))
    assert np.abs(change - tolerance * fit.x).max() < 1e-3 * spread.max()
    own = estimate.covariance[np.ix_(free, free)]
    np.testing.assert_allclose(np.diag(own), np.diag(covariance), rtol=1e-3)


def test_every_step_takes_the_noise_of_the_readings(measurement, text, tmp_path):
    data = loaded(text, measurement, tmp_path)
    sd = stated(text)
    structure = reading_structure(measurement, data.series, measurement.nominal)
    np.testing.assert_allclose(structure.unit, sd, rtol=1e-12)
    assert np.sqrt(structure.variances.sum(axis=1)[2]) == pytest.approx(
        np.sqrt(np.mean(sd[2::3] ** 2))
    )
    diagnosed = prepare(measurement, data.series, data.y, data.covariates)
    np.testing.assert_allclose(diagnosed.sigma, sd, rtol=1e-12)
    estimate = identify(measurement, data.series, data.y)
    draws = draw_approximation(
        measurement, data.series, data.y, estimate, np.random.default_rng(1)
    )
    spread = np.sqrt(np.diag(estimate.covariance))[measurement.free]
    np.testing.assert_allclose(
        draws.theta.std(axis=0)[measurement.free], spread, rtol=0.35
    )
    # rows taken in another order keep theirs
    (series,) = data.series
    order = np.array([5, 1, 7])
    taken = measurement.sigma([series.take(order)]).reshape(-1, 3)
    np.testing.assert_allclose(taken, sd.reshape(-1, 3)[order], rtol=1e-12)


def test_a_file_written_back_has_the_same_noise(measurement, text, tmp_path):
    data = loaded(text, measurement, tmp_path)
    again = loaded(dataset.to_csv(data), measurement, tmp_path)
    np.testing.assert_allclose(
        measurement.sigma(again.series), measurement.sigma(data.series), rtol=1e-12
    )
    assert "sigma_read_x_mm" in dataset.to_csv(data).splitlines()[0]


def test_channels_of_common_sources_scale_with_their_reading():
    """A laser ball bar's error inside grows with the stated one of each channel."""
    setup = mount(laser, "bar", at_x=0.0, at_y=0.0, at_z=-0.4)
    bar = Measurement(machine, [setup])
    series = bar.series("bar", 1e-3 * np.array(PLACES[:4], dtype=float))
    factor = np.array([1.0, 2.0, 3.0, 0.5])[:, None] * np.ones(len(setup.sigma))
    own = dataclasses.replace(series, sigma=factor * np.array(setup.sigma))
    before, after = bar.sigma([series]), bar.sigma([own])
    np.testing.assert_allclose(after / before, factor.ravel(), rtol=1e-12)


@pytest.mark.parametrize(("cell", "words"), [
    ("0", "no reading has such"), ("-3", "no reading has such"), ("x", "finite"),
])  # fmt: skip
def test_what_is_no_standard_deviation_is_refused(cell, words, measurement, tmp_path):
    lines = [
        "setup,run,order,x_mm,y_mm,z_mm,read_x_mm,read_y_mm,read_z_mm,sigma_read_x_um",
        f"tracker,1,1,0,0,40,0,0,40,{cell}",
    ]
    with pytest.raises(ReadingsError, match=words) as caught:
        loaded("\n".join(lines), measurement, tmp_path)
    assert "sigma_read_x_um" in str(caught.value)


def test_the_noise_of_a_channel_that_nobody_reads_is_refused(measurement, tmp_path):
    lines = [
        "setup,run,order,x_mm,y_mm,z_mm,read_x_mm,read_y_mm,read_z_mm,sigma_height_um",
        "tracker,1,1,0,0,40,0,0,40,5",
    ]
    with pytest.raises(ReadingsError, match="unknown column"):
        loaded("\n".join(lines), measurement, tmp_path)
