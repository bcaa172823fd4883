"""`oed import marlin` and `rrf`: saved meshes and grids beside probed points."""

import csv
from pathlib import Path

import numpy as np
import pytest
from oracles.delta_trilateration import nozzle, travel_to

from pkm_printers.bed_mesh import copied_margin
from pkm_reports import text
from pkm_reports.blocks import Notice
from pkm_reports.sections import answer
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from pkm_studies.results import load_result
from printers import mesh_printer as virtual
from printers.delta_printer import said, take
from printers.test_import_marlin import OLD_LOG


def rows_of_mesh(folder: Path) -> list[dict[str, str]]:
    with next(folder.glob("*.readings.csv")).open() as file:
        lines = (line for line in file if not line.startswith("#"))
        return [r for r in csv.DictReader(lines) if r["setup"].startswith("mesh_")]


def imported(config: str, folder: Path) -> list[str]:
    (folder / "printer.cfg").write_text(config)
    _, result = import_files("klipper", [folder / "printer.cfg"], folder)
    return list(result.statements)


@pytest.mark.parametrize("section", ["probe", "scanner", "probe_eddy_current coil"])
def test_a_mesh_comes_in_without_its_margin_at_the_places_of_the_nozzle(
    section, tmp_path
):
    rng = np.random.default_rng(3)
    true = virtual.drawn(rng)
    probe = f"[{section}]\nx_offset: 4.5\ny_offset: -2.0\n"
    extra = probe + "[axis_twist_compensation]\nz_compensations: 0.1, 0.2\n[z_tilt]\n"
    mesh = virtual.mesh_heights(true, virtual.FIRMWARE, rng, 0.0)
    config = virtual.configuration(virtual.heights(true, rng, 0.0), mesh, extra)
    statements = " ".join(imported(config, tmp_path))
    rows = rows_of_mesh(tmp_path)
    assert len(rows) == np.isfinite(mesh).sum() == 49
    assert "32 nodes are left out" in statements
    assert "before it has the geometry of then" in statements
    assert "[axis_twist_compensation]" in statements
    assert "[z_tilt]" in statements
    assert f"[{section}] x_offset" in statements
    # the nozzle stands beside the probe; there the firmware had the height of the mesh
    x, y, z = (np.array([float(r[f"{a}_mm"]) for r in rows]) for a in "xyz")
    assert np.unique(np.round(x + 4.5, 6)) == pytest.approx(virtual.NODES)
    assert np.unique(np.round(y - 2.0, 6)) == pytest.approx(virtual.NODES)
    assert z == pytest.approx(mesh[np.isfinite(mesh)] + virtual.TRIGGER, abs=1e-6)


def test_contacts_of_a_mesh_lie_on_the_bed_of_the_true_printer(tmp_path):
    """By the oracle alone: rows as written, firmware's carriages, true printer."""
    rng = np.random.default_rng(4)
    true = virtual.drawn(rng)
    mesh = virtual.mesh_heights(true, virtual.FIRMWARE, rng, 0.0)
    imported(virtual.configuration(virtual.heights(true, rng, 0.0), mesh), tmp_path)
    rows = rows_of_mesh(tmp_path)
    at = np.array([[float(r[f"{axis}_mm"]) for axis in "xyz"] for r in rows])
    heights = nozzle(travel_to(at, *virtual.FIRMWARE), *true)[:, 2]
    assert heights == pytest.approx(virtual.TRIGGER, abs=2e-6)


def test_a_mesh_on_a_rectangle_has_no_margin():
    nodes = np.linspace(-1.0, 1.0, 5)
    z = np.random.default_rng(1).normal(size=(5, 5))
    assert not copied_margin(nodes, nodes, z).any()
    z[:, :] = 0.5
    assert copied_margin(nodes, nodes, z).sum() == 25 - 13


def test_a_mesh_confirms_a_correction_or_contradicts_it(tmp_path):
    rng = np.random.default_rng(5)
    true = virtual.drawn(rng)
    calibration = virtual.heights(true, rng, 0.03)
    same = virtual.mesh_heights(true, virtual.FIRMWARE, rng, 0.03)
    result = virtual.run(virtual.configuration(calibration, same), tmp_path / "same")
    (section,) = result.held_out
    assert section.verdict == "confirms"
    assert section.rms < 60.0 < section.rms_before
    assert section.coverage == np.mean(
        np.abs(section.residuals) <= np.array(section.half_widths)
    )
    # the heights are those of another printer, which the mesh does not know
    other = virtual.mesh_heights(virtual.FIRMWARE, virtual.FIRMWARE, rng, 0.03)
    result = virtual.run(virtual.configuration(calibration, other), tmp_path / "other")
    (section,) = result.held_out
    assert section.verdict == "contradicts"
    assert section.rms_before < 60.0 < section.rms
    assert "probed before the last calibration was saved" in section.words
    assert f"{section.words}." in result.headline
    assert Notice(text.sentence(section.words)) in answer.accuracy_blocks(result)


def test_heights_of_a_mesh_as_readings_estimate_the_noise(tmp_path):
    rng = np.random.default_rng(6)
    true = virtual.drawn(rng)
    mesh = virtual.mesh_heights(true, virtual.FIRMWARE, rng, 0.03)
    config = virtual.configuration(virtual.heights(true, rng, 0.03), mesh)
    result = virtual.run(config, tmp_path / "fitted", mesh="readings")
    # joints of the calibration beside commands of the mesh: the report reads them back
    assert load_result(tmp_path / "fitted" / "out").estimate is not None
    assert not result.held_out
    assert result.estimate.readings == 7 + 49
    assert result.estimate.rms_after["height"] == pytest.approx(30.0, rel=0.25)
    radius = result.estimate.parameters["radius"]
    assert abs(radius.value - true[0]) < 3.0 * radius.sd < 0.15


def test_a_round_mesh_that_was_probed_in_its_corners_is_a_forks(tmp_path):
    """Klipper fills up what lies outside the circle; on a rectangle it has no radius."""
    rng = np.random.default_rng(8)
    lines = virtual.heights(virtual.FIRMWARE, rng, 0.0)
    mesh = virtual.mesh_heights(virtual.FIRMWARE, virtual.FIRMWARE, rng, 0.0)
    mesh = np.where(np.isfinite(mesh), mesh, rng.normal(0.0, 0.05, mesh.shape))
    with pytest.raises(
        InputError, match=r"default\] points .*nodes beyond .* a fork's"
    ):
        imported(
            virtual.configuration(lines, mesh, "[bed_mesh]\nmesh_radius: 90\n"),
            tmp_path,
        )


def test_a_mesh_with_a_missing_row_is_refused(tmp_path):
    rng = np.random.default_rng(3)
    mesh = virtual.mesh_heights(virtual.FIRMWARE, virtual.FIRMWARE, rng, 0.0)
    lines = virtual.heights(virtual.FIRMWARE, rng, 0.0)
    config = virtual.configuration(lines, mesh).replace("y_count = 9", "y_count = 8")
    with pytest.raises(InputError, match="9 rows"):
        imported(config, tmp_path)


@pytest.mark.parametrize(("name", "verdict", "count"), [
    ("flsun_sr_danorder_mesh_2", "confirms", 29),
    ("flsun_sr_danorder_mesh", "agrees", 49),
])  # fmt: skip
def test_real_meshes(name, verdict, count, shared_data, tmp_path):
    config = (shared_data / "klipper_delta" / f"{name}.cfg").read_text()
    result = virtual.run(config, tmp_path / name)
    assert {section.verdict for section in result.held_out} == {verdict}
    assert {section.n for section in result.held_out} == {count}


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
