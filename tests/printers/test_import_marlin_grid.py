"""`oed import marlin`: the bilinear grid of G29 beside probed points."""

from pathlib import Path

import pytest

from pkm_studies.base import InputError
from printers.delta_printer import said, take
from printers.test_import_marlin import OLD_LOG

GRID = """\
Recv: Bilinear Leveling Grid:
Recv:       0      1      2
Recv:  0 +9.000 +9.000 +9.000
Recv:  1 +9.000 +9.000 +9.000
Recv: ok
Send: M420 V
Recv: Bilinear Leveling Grid:
Recv:       0      1      2      3      4
Recv:  0 +0.900 +0.110 +0.120 +0.130 +0.900
Recv:  1 +0.210 +0.220 -0.230 +0.240 +0.250
Recv:  2 +0.310 =====  +0.330 +0.340 +0.350
Recv:  3 +0.410 +0.420 +0.430 +0.440 +0.450
Recv:  4 +0.900 +0.510 -0.520 +0.530 +0.900
Recv:
Recv: Subdivided with CATMULL ROM Leveling Grid:
Recv:  0 +0.110 +0.115 +0.120
Recv: ok
"""
PLACES = "mesh_x_mm = -80, 80\nmesh_y_mm = -60, 60\nprobe_offset_mm = 5, -3\n"


def mesh_rows(log: str, folder: Path) -> tuple[list[tuple[float, ...]], str]:
    _, imported = take("marlin", {"log": log}, folder)
    rows = [
        tuple(float(row[f"{axis}_mm"]) for axis in "xyz")
        for row in imported.rows
        if row["setup"] == "mesh_G29"
    ]
    return rows, said(imported)


def test_nodes_inside_the_circle_come_in_where_the_nozzle_was(tmp_path):
    """The circle through the nearer sides has 60 mm; the last grid counts."""
    rows, sentences = mesh_rows(PLACES + OLD_LOG + GRID, tmp_path)
    # by hand: 5 nodes at x = 0, 3 each at x = -40 and 40, of which one has no height
    assert rows[0] == (0.0 - 5.0, -60.0 + 3.0, 0.12)
    assert (-40.0 - 5.0, -30.0 + 3.0, 0.22) in rows
    assert len(rows) == 10
    assert "15 nodes are left out: outside the circle" in sentences
    assert "1 earlier grids" in sentences


def test_the_radius_and_the_ends_may_be_stated(tmp_path):
    log = "mesh_radius_mm = 200\n" + OLD_LOG + "Send: G29 L-80 R80 F-60 B60\n" + GRID
    rows, _ = mesh_rows(log, tmp_path)
    assert len(rows) == 24
    assert rows[0] == (-80.0, -60.0, 0.9)


def test_a_grid_without_a_place_is_named_and_not_read(tmp_path):
    rows, sentences = mesh_rows(OLD_LOG + GRID, tmp_path)
    assert not rows
    assert "add lines mesh_x_mm = from, to" in sentences


def test_heights_that_are_readings_are_no_hold_out(tmp_path):
    grid = GRID.partition("M420 V\n")[2]
    nodes = [(x, y) for y in (-60, -30, 0, 30, 60) for x in (-80, -40, 0, 40, 80)]
    points = "".join(f"Recv: Bed X: {x} Y: {y} Z: 0.01\n" for x, y in nodes)
    rows, sentences = mesh_rows(PLACES + OLD_LOG + points + grid, tmp_path)
    assert not rows
    assert "among the readings already" in sentences


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("Recv:  3 +0.410", "Recv:  5 +0.410", "does not follow"),
    ("+0.450", "+1_000", "does not follow"),
    ("+0.450", "inf", "does not follow"),
    ("+0.350", "0,35", "does not follow"),
    ("-0.520", "-52000.0", "is on no bed"),
    ("Bed X: 0.00 Y: 70.00", "Bed X: 0,00 Y: 70.00", "this is no point"),
    ("Y: 70.00 Z: 0.03", "Y: 70.00 Z: 0,03", "this is no point"),
    ("Bed X: 0.00 Y: 70.00", "Bed X: 1e12 Y: 70.00", "is on no bed"),
])  # fmt: skip
def test_a_broken_line_is_refused_and_not_left_out(before, after, problem, tmp_path):
    log = PLACES + OLD_LOG + GRID
    assert before in log
    with pytest.raises(InputError, match=problem):
        mesh_rows(log.replace(before, after), tmp_path)
