"""Poses as users give them: lists, files, circles, lines, cubes and samples."""

from pathlib import Path

import numpy as np
import pytest
import sample

from oed.units import from_si
from pkm_studies.base import InputError

TABLE = """
[design]
readings = 5

[[design.candidates]]
setup = "probe"
"""


def commands_mm(table: str, folder: Path = Path()) -> np.ndarray:
    """Commands (n, 3), mm, of the delta's candidates with a table."""
    resolved = sample.resolved(sample.DELTA + TABLE + table, folder)
    (series,) = resolved.candidates
    return from_si(series.command, "mm")


def refusal(table: str, folder: Path = Path()) -> str:
    with pytest.raises(InputError) as raised:
        sample.resolved(sample.DELTA + TABLE + table, folder)
    return str(raised.value)


def test_a_list_is_no_product():
    table = "poses = { x_mm = [0, 50, 0], y_mm = [0, 0, 60], z_mm = [10, 20, 30] }"
    wanted = [[0, 0, 10], [50, 0, 20], [0, 60, 30]]
    np.testing.assert_allclose(commands_mm(table), wanted)


def test_a_file_as_a_spreadsheet_writes_it(tmp_path):
    (tmp_path / "poses.csv").write_text("run;x_mm;y_mm;z_mm\na;0,5;1;10\nb;2;3;20,25\n")
    text = sample.DELTA + TABLE + 'file = "poses.csv"'
    (series,) = sample.resolved(text, tmp_path).candidates
    command = from_si(series.command, "mm")
    np.testing.assert_allclose(command, [[0.5, 1.0, 10.0], [2.0, 3.0, 20.25]])
    assert list(series.run) == ["a", "b"]


def test_a_circle_both_ways():
    """Worked by hand: in zx the angle runs from z to x."""
    table = (
        'circle = { centre_mm = [10, 5, 100], radius_mm = 40, plane = "zx",'
        ' direction = "both", start_deg = 90, count = 4 }'
    )
    forward = [[50, 5, 100], [10, 5, 60], [-30, 5, 100], [10, 5, 140]]
    backward = [forward[k] for k in (0, 3, 2, 1)]
    np.testing.assert_allclose(commands_mm(table), forward + backward, atol=1e-9)


def test_a_line_and_a_cube():
    table = "line = { from_mm = [0, 0, 20], to_mm = [30, 60, 20], count = 4 }"
    wanted = [[0, 0, 20], [10, 20, 20], [20, 40, 20], [30, 60, 20]]
    np.testing.assert_allclose(commands_mm(table), wanted, atol=1e-9)
    table = "cube = { centre_mm = [0, 0, 100], side_mm = 60 }"
    cube = commands_mm(table)
    assert len({tuple(np.round(point, 6)) for point in cube}) == 27
    assert cube.min(axis=0) == pytest.approx([-30, -30, 70])
    assert cube.max(axis=0) == pytest.approx([30, 30, 130])


def test_samples_fill_the_workspace_and_can_be_reached():
    points = commands_mm("")
    assert 200 < len(points) <= 500
    assert points[:, :2].min() < -120.0
    assert points[:, :2].max() > 120.0
    near = commands_mm("sample = 40\nz_mm = [10, 30]\nx_mm = 5")
    assert 10.0 <= near[:, 2].min() < 13.0
    assert 27.0 < near[:, 2].max() <= 30.0
    np.testing.assert_allclose(near[:, 0], 5.0)


def test_a_machine_commanded_in_angles_follows_a_circle():
    """An A3 head with a ball bar: all points lie on the sphere about the cup."""
    circle = (
        "circle = { centre_mm = [0, 0, 1106], radius_mm = 240,"
        ' plane = "xy", count = 12 }'
    )
    grid = sample.STUDY[
        sample.STUDY.index("z_mm = { from") : sample.STUDY.index("\n[report]")
    ]
    resolved = sample.resolved(sample.changed(sample.STUDY, (grid, circle)))
    (series,) = resolved.candidates
    tip = resolved.measurement.kinematics.frames(series.start[:12], np.zeros(3))[1]
    np.testing.assert_allclose(tip[:, 2], 1.106, atol=1e-9)
    np.testing.assert_allclose(np.hypot(tip[:, 0], tip[:, 1]), 0.240, atol=1e-9)
    angle = np.unwrap(np.arctan2(tip[:, 1], tip[:, 0]))
    np.testing.assert_allclose(np.diff(angle), np.radians(30.0), atol=1e-8)


@pytest.mark.parametrize(("table", "words"), [
    ("sample = 5\nline = { from_mm = [0,0,9], to_mm = [1,0,9] }", "line and sample"),
    ("poses = { x_mm = [0, 1], y_mm = [0, 1], z_mm = [9] }", "x 2, y 2, z 1"),
    ("poses = { x_mm = [0], y_mm = [0] }", "z_mm: missing"),
    ("circle = { centre_mm = [0,0,90], radius_mm = 900, count = 3 }", "cannot be put on 3"),
    ('circle = { centre_mm = [0,0,90], radius_mm = 9, plane = "xz" }', "zx"),
    ('file = "none.csv"', "there is no such CSV file"),
    ('file = "bad.csv"', "line 3, column y_mm = wide"),
    ("sample = 9\nz_mm = [900, 950]", "none of 9 sampled poses"),
    ('sample = 9\nz = "hold"', "sampled poses hold no reading"),
])  # fmt: skip
def test_poses_that_do_not_fit_are_refused(table, words, tmp_path):
    (tmp_path / "bad.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n1,wide,3\n")
    assert words in refusal(table, tmp_path)
