"""Columns of a map with a factor and an offset, a noise of each reading, braces."""

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from oed import dataset
from pkm_studies.base import InputError
from pkm_studies.importers import import_files

MAP = """\
machine = "linear_delta"
instrument = "height_probe"

[columns]
"q{1,2,3}_mm" = { column = "turns {a,b,c}", factor = [40.0, 40.5, 41.0], offset = 300.0 }
height_in = "H"
sigma_height_um = { column = "U95 H", factor = 1000.0, k = 2 }
"""
TEXT = """\
turns a;turns b;turns c;H;U95 H
0,5;0,5;0,5;0,4;0,02
0,75;;0,7;0,5;0,02
1;1;1,2;-0,25;0,05
"""
UR10 = """\
machine = {{ model = "delta", geometry = {{ radius_mm = 3000, arm_mm = 5000, endstop_mm = 4000 }} }}
instrument = "pose_tracker_position"{further}
[columns]
"{{x,y,z}}_m" = "Goal {{x,y,z}}"
"read_{{x,y,z}}_mm" = "measurement_{{x,y,z}}"
"sigma_read_{{x,y,z}}_mm" = "measurement_std_{{x,y,z}}"
temp_robot_C = "measurement_temperature"
"""


def imported(
    text: str, column_map: str, folder: Path, kind: str = "columns"
) -> tuple[list[dict[str, str]], list[str], Path]:
    """Rows of the readings file, the sentences, and the study's path."""
    (folder / "a.csv").write_text(text)
    (folder / "a.map").write_text(column_map)
    path, result = import_files(
        kind, [folder / "a.csv"], folder / "out", column_map=folder / "a.map"
    )
    with (folder / "out" / "a.readings.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    return rows, list(result.statements), path


def test_a_column_has_a_factor_an_offset_and_a_coverage_factor(tmp_path):
    rows, sentences, _ = imported(TEXT, MAP, tmp_path)
    assert [row["order"] for row in rows] == ["1", "3"]
    assert any(
        "Left out: 1 rows in which some joints are empty" in s for s in sentences
    )
    assert any("turns b times 40.5 plus 300 as q2_mm" in s for s in sentences)
    joints = [[float(row[f"q{k}_mm"]) for k in (1, 2, 3)] for row in rows]
    np.testing.assert_allclose(joints, [[320, 320.25, 320.5], [340, 340.5, 349.2]])
    # U95 in mm with k = 2, as um
    assert [float(row["sigma_height_um"]) for row in rows] == [10.0, 25.0]
    assert [float(row["height_in"]) for row in rows] == [0.4, -0.25]


def test_the_written_map_reads_the_same(tmp_path):
    rows, _, path = imported(TEXT, MAP, tmp_path)
    again = tmp_path / "again"
    again.mkdir()
    written = (path.parent / "a.map.toml").read_text()
    assert imported(TEXT, written, again)[0] == rows
    source = tomllib.loads(written)["columns"]["q2_mm"]
    assert source == {"column": "turns b", "factor": 40.5, "offset": 300.0}


@pytest.mark.parametrize(("line", "field", "problem"), [
    ('q1_mm = { column = "H", factor = 0 }', "q1_mm.factor", "leaves nothing"),
    ('q1_mm = { column = "H", k = 2 }', "q1_mm.k", "coverage factor"),
    ('"q{1,2}_mm" = "turns {a,b,c}"', "q{1,2}_mm", "2 columns of readings, 3"),
    ('"q{1,2}_{mm,m}" = "H"', "q{1,2}_{mm,m}", "two pairs"),
    ('"q{1,2}_mm" = { column = "turns {a,b}", factor = [1.0] }', "factor", "1 numbers for 2"),
    ('sigma_height_um = { column = "H", offset = 1 }', "sigma_height_um.offset", "no offset"),
    ('order = { column = "H", factor = 2 }', "order", "no unit"),
])  # fmt: skip
def test_what_a_source_may_not_have(line, field, problem, tmp_path):
    head = 'machine = "linear_delta"\ninstrument = "height_probe"\n[columns]\n'
    with pytest.raises(InputError) as caught:
        imported(TEXT, head + line, tmp_path)
    assert problem in str(caught.value)
    assert field in str(caught.value)


def test_the_tracker_of_a_robot_needs_seven_lines(shared_data, tmp_path):
    """Decimal commas, semicolons, and a standard deviation for each reading."""
    file = shared_data / "ur10_tracker" / "series_b.csv"
    text = file.read_text()
    column_map = UR10.format(further='\nregistration = "known"')
    assert len(column_map.splitlines()) <= 10
    rows, _, _ = imported(text, column_map, tmp_path)
    plain = list(csv.DictReader(text.replace(",", ".").splitlines(), delimiter=";"))
    assert len(rows) == len(plain) == 1495
    for axis in "xyz":
        for name, source in (
            (f"read_{axis}_mm", f"measurement_{axis}"),
            (f"sigma_read_{axis}_mm", f"measurement_std_{axis}"),
            (f"{axis}_m", f"Goal {axis}"),
        ):
            own = [float(row[name]) for row in rows]
            assert own == [float(line[source]) for line in plain]
    # laid onto the machine, the spread turns with the frame: its sum of squares stays
    other = tmp_path / "fitted"
    other.mkdir()
    turned, sentences, _ = imported(text, UR10.format(further=""), other, "tracker")
    assert any("1.7 mm rms are left" in sentence for sentence in sentences)
    names = [f"sigma_read_{axis}_mm" for axis in "xyz"]
    for before, after in zip(rows[::100], turned[::100], strict=True):
        squares = [sum(float(row[n]) ** 2 for n in names) for row in (before, after)]
        assert squares[0] == pytest.approx(squares[1], rel=1e-6)


def test_the_jugglebot_needs_fourteen_lines(shared_data, tmp_path):
    """Motor revolutions, quaternions, a geometry of its own: no code."""
    k = np.arange(6)
    base = np.radians(200 + 100 * (k // 2) + 20 * ((k + 1) // 2))
    platform = np.radians(
        154.3012223 + 8.6024446 * (k // 2) + 111.3975554 * ((k + 1) // 2)
    )
    circles = [
        radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * k], axis=1)
        for radius, angle in ((410.0, base), (219.075, platform))
    ]
    zero = np.linalg.norm(circles[1] + [0.0, 0.0, 565.0] - circles[0], axis=1)[0]
    factors = [75.69, 71.20, 72.34, 70.80, 70.62, 71.26]
    column_map = f"""\
instrument = "pose_tracker"
[machine]
model = "hexapod_ups"
[machine.geometry]
base_mm = {circles[0].tolist()}
platform_mm = {circles[1].tolist()}
home_mm = [0, 0, 700]
reach_mm = 250
tilt_deg = 30
[columns]
"q{{1,2,3,4,5,6}}_mm" = {{ column = "leg_length_{{1,2,3,4,5,6}}", factor = {factors}, offset = {zero} }}
"read_{{x,y,z}}_mm" = "position_{{x,y,z}}"
[orientation]
quaternion = ["orientation_w", "orientation_x", "orientation_y", "orientation_z"]
"""
    assert len(column_map.splitlines()) <= 15
    text = (shared_data / "jugglebot" / "poses_108.csv").read_text()
    rows, sentences, _ = imported(text, column_map, tmp_path, "tracker")
    assert len(rows) == 108
    assert any("best fit to the nominal poses" in sentence for sentence in sentences)
    # the leg equation by numpy alone, leg by leg: what the wrong conversion of leg 1 leaves
    pose = np.array(
        [[float(row[f"read_{n}"]) for n in ("x_mm", "y_mm", "z_mm")] for row in rows]
    )
    angles = np.radians(
        [
            [float(row[f"read_{n}_deg"]) for n in ("alpha", "beta", "gamma")]
            for row in rows
        ]
    )
    turned = Rotation.from_euler("XYZ", angles)
    legs = np.array([[float(row[f"q{i}_mm"]) for i in range(1, 7)] for row in rows])
    scales = []
    for i in range(6):

        def misfit(v: np.ndarray, i: int = i) -> np.ndarray:
            foot = pose + turned.apply(circles[1][i] + v[:3]) - circles[0][i] - v[3:6]
            read = legs[:, i] - zero
            return np.linalg.norm(foot, axis=1) - zero - v[6] - (1.0 + v[7]) * read

        fit = least_squares(misfit, np.zeros(8), x_scale=[1.0] * 7 + [0.01])
        assert np.sqrt(np.mean(fit.fun**2)) < 0.6  # mm
        scales.append(fit.x[7])
    assert scales[0] == pytest.approx(-0.061, abs=0.005)
    assert np.abs(scales[1:]).max() < 0.015


def test_readings_in_inches_are_metres():
    assert dataset.ReadingsColumn.parse("height_in").factor == 25.4e-3
