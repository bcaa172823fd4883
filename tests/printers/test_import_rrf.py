"""`oed import rrf`: which words of which file the firmware reads, and height maps."""

import re
from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import fit, rrf
from oracles.firmware.geometry import bed, delta

import oed
from pkm_printers.bed_mesh import BedMesh, ProbedPoint, distinct
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from printers.delta_printer import (
    compensate,
    endstops,
    fitted,
    nominal,
    said,
    take,
    with_known_noise,
)

CONFIG = """\
M574 X2 Y2 Z2 S1
M665 L241.987 R124.309 H260.519 B120 X0 Y0 Z0
M666 X0.73 Y0.06 Z-0.80
M558 P1 H5 F120
G31 X23 Y0 Z1.5 P500
"""
PLACES = np.array(
    [
        (0, 80), (69.28, 40), (69.28, -40), (0, -80), (-69.28, -40), (-69.28, 40),
        (0, 40), (34.64, -20), (-34.64, -20), (0, 0)
    ]
)  # fmt: skip
LOG = (
    "G32 bed probe heights: -0.152 -0.456 0.170 1.264 1.261 0.463 -0.047 0.186 0.764"
    " 0.256, mean 0.371, deviation from mean 0.545\n"
)
TILT_CONFIG = """\
M665 L260.0 R131.5 H210.0 B105.0 X-0.200 Y0.200 Z0.000
M666 X-1.36 Y1.11 Z0.25 A0.60 B-0.35
"""
TILT_PLACES = 1.25 * np.round(PLACES, 1)
TILT_LOG = "G32 bed probe heights: 0.071 0.092 0.094 0.061 0.029 0.044 0.015 0.028 -0.007 -0.007\n"
FILES = {"config.g": CONFIG, "bed.g": rrf.bed_file(PLACES), "log.txt": LOG}


def places(folder: Path, **changes: str) -> list[tuple[float, float]]:
    """Places of the nozzle, mm, that an import of changed files has."""
    _, imported = take("rrf", FILES | changes, folder)
    return [(float(row["x_mm"]), float(row["y_mm"])) for row in imported.rows]


def best_fit(config: str, bed_places: np.ndarray, log: str) -> fit.Delta:
    """Least squares over the contacts of a log."""
    firmware = rrf.RepRapFirmware(config)
    heights = np.array(log.split(": ")[1].split(",")[0].split(), float)
    points = np.column_stack([bed_places - firmware.offset[:2], heights])
    stops = firmware.height + firmware.adjust
    start = delta(firmware.radius, firmware.rods, firmware.angles, stops, firmware.tilt)
    return fit.fit(firmware.travel(points), start)


def check(study: Path, wanted: fit.Delta, tolerance: float) -> None:
    """The heights are rounded to 1 um: that is their noise."""
    with_known_noise(study, 1.0)
    value = fitted(study)
    for name, number in fit.numbers(wanted).items():
        assert value[name] == pytest.approx(number, abs=tolerance), name


# -- places and bed --------------------------------------------------------------------
def test_a_probe_beside_the_nozzle_touches_where_the_nozzle_is_not(tmp_path):
    study, imported = take("rrf", FILES, tmp_path)
    assert float(imported.rows[1]["x_mm"]) == pytest.approx(46.28)
    wanted = best_fit(CONFIG, PLACES, LOG)
    assert wanted.radius[0] == pytest.approx(125.109, abs=1e-3)
    check(study, wanted, 0.02)
    printed = rrf.RepRapFirmware(compensate(study, "rrf"))
    assert np.ptp(bed(printed, wanted, 70.0)) < 0.01
    assert printed.bed == 120.0


def test_the_tilt_of_the_bed_is_read_used_and_written_back(tmp_path):
    files = {
        "config.g": TILT_CONFIG,
        "bed.g": rrf.bed_file(TILT_PLACES),
        "log.txt": TILT_LOG,
    }
    study, imported = take("rrf", files, tmp_path)
    assert "Bed: its rise is x +0.60 +- 0.00 %, y -0.3" in said(imported)
    wanted = best_fit(TILT_CONFIG, TILT_PLACES, TILT_LOG)
    check(study, wanted, 0.01)
    text = compensate(study, "rrf")
    assert " A0.6000 B-0.3500\n" in text
    assert np.ptp(bed(rrf.RepRapFirmware(text), wanted, 80.0)) < 0.005


def test_a_height_that_was_typed_is_that_of_the_nozzle(tmp_path):
    """The sentence on places names the point."""
    typed = FILES["bed.g"].replace("G30 P9 X0.00 Y0.00 Z-99999", "G30 P9 X0 Y0 Z0.256")
    assert typed != FILES["bed.g"]
    _, imported = take("rrf", FILES | {"bed.g": typed}, tmp_path)
    assert float(imported.rows[9]["x_mm"]) == 0.0
    assert float(imported.rows[0]["x_mm"]) == -23.0
    assert (
        "x -23, y +0 mm of the places of G30; the height of point 9 was typed"
        in said(imported)
    )


def test_the_place_of_the_probe_is_that_of_the_moment(tmp_path):
    """M558 P makes a probe anew, and bed.g may have a G31 of its own."""
    reset = CONFIG + "M558 P8 H5\n"
    assert places(tmp_path / "reset", **{"config.g": reset})[0] == (0.0, 80.0)
    _, imported = take("rrf", FILES | {"config.g": reset}, tmp_path / "said")
    assert "G31 of line 5 counts no more: M558 P of line 6" in said(imported)
    again = reset + "G31 X12 Y-3\n"
    assert places(tmp_path / "again", **{"config.g": again})[0] == (-12.0, 83.0)
    unchanged = CONFIG + "M558 H4\n"
    assert places(tmp_path / "same", **{"config.g": unchanged})[0] == (-23.0, 80.0)
    own = rrf.bed_file(PLACES, before="G31 X0 Y0\n") + "G31 X23 Y0\n"
    assert places(tmp_path / "own", **{"bed.g": own})[0] == (0.0, 80.0)
    changed = FILES["bed.g"].replace("G30 P5", "G31 X0 Y0\nG30 P5")
    moved = places(tmp_path / "changed", **{"bed.g": changed})
    assert moved[4:6] == [(-92.28, -40.0), (-69.28, 40.0)]


# -- which values are in force ---------------------------------------------------------
STORED = "M665 L242.5 R124.5 H260.519 B120 X0 Y0 Z0\nM666 X0.1 Y0 Z-0.1 A0.00 B0.00\n"


def test_stored_values_count_where_m501_reads_them(tmp_path):
    """They win over what stands above M501, and lose against what stands below it."""
    loads = CONFIG + "M501\n"
    given = {"config-override.g": STORED, **FILES, "config.g": loads}
    study, _ = take("rrf", given, tmp_path / "a")
    assert nominal(study)["radius_mm"] == 124.5
    controller = oed.load_study(study).controller
    assert controller.file == "config-override.g"
    study, _ = take(
        "rrf", given | {"config.g": loads + "M665 R124.9\n"}, tmp_path / "b"
    )
    assert nominal(study)["radius_mm"] == 124.9
    with pytest.raises(
        InputError, match=r"config-override\.g: no M501 is in the other"
    ):
        take("rrf", given | {"config.g": CONFIG}, tmp_path / "c")
    _, imported = take("rrf", FILES | {"config.g": loads}, tmp_path / "d")
    assert "Not read: M501 (line 6): it reads config-override.g" in said(imported)


def test_answers_of_the_firmware_win(tmp_path):
    answers = rrf.RepRapFirmware(
        "M665 L243 R124.7 H260.6 B120 X0.1 Y0.2\nM666 X0.2 Y0.1 Z-0.3 A0.1"
    ).answers()
    study, _ = take("rrf", FILES | {"log.txt": answers + LOG}, tmp_path / "a")
    values = nominal(study)
    assert values["radius_mm"] == 124.7
    assert values["arm2_mm"] == 243.0
    assert endstops(study) == pytest.approx([260.8, 260.7, 260.3])
    assert values["angle2_deg"] == pytest.approx(330.2)
    assert "bed_slope_x_ppm = 1000.0" in study.read_text()
    probe = "Z probe 0: current reading 0, threshold 500, trigger height 1.500, offsets X12.0 Y-3.0\n"
    assert places(tmp_path / "b", **{"log.txt": probe + LOG})[0] == (-12.0, 83.0)


def test_small_letters_count_as_capitals(tmp_path):
    small = CONFIG.replace("M666 X0.73 Y0.06 Z-0.80", "m666 x0.3 y-0.2 z-0.1")
    small = small.replace("M558 P1", 'm558 P1 c"^ProbeIn"')
    study, _ = take("rrf", FILES | {"config.g": small}, tmp_path / "a")
    assert endstops(study) == pytest.approx([260.819, 260.319, 260.419])
    bed_file = FILES["bed.g"].lower()
    study, _ = take("rrf", FILES | {"bed.g": bed_file}, tmp_path / "b")
    check(study, best_fit(CONFIG, PLACES, LOG), 0.02)


def test_commands_on_a_condition_are_refused(tmp_path):
    for block in ("if false\n  M665 R111\n", "while true\n  if x\n    m501\n"):
        with pytest.raises(InputError, match=r"M\d+ .*stands under .*of line \d"):
            take("rrf", FILES | {"config.g": CONFIG + block}, tmp_path)
    harmless = CONFIG + "if !exists(global.a)\n  global a = 1\n  G28 X\nelse\n  M98\n"
    study, imported = take("rrf", FILES | {"config.g": harmless}, tmp_path)
    assert "what stands under if (line 6), else (line 9) of config.g" in said(imported)
    assert nominal(study)["radius_mm"] == 124.309


def test_a_macro_without_quotes_is_a_file(tmp_path):
    """Its letters are no words: M98 PDEPLOYPROBE.G has one, P."""
    macro = FILES | {"bed.g": "M98 PDEPLOYPROBE.G\n" + FILES["bed.g"]}
    study, imported = take("rrf", macro, tmp_path)
    assert "M98 P (line 1): this file may hold further settings" in said(imported)
    assert nominal(study)["radius_mm"] == 124.309


def in_loop(lines: str, condition: str = "") -> str:
    """The usual bed.g: it probes until the deviation is small, four times at most."""
    body = "".join(f"  {condition}{line}\n" for line in lines.splitlines())
    head = 'while true\n  if iterations = 4\n    abort "no good calibration"\n'
    tail = "  if move.calibration.initial.deviation <= 0.03\n    break\n"
    return f"M561\nG28\n{head}{body}{tail}"


def test_points_of_a_loop_are_those_of_its_last_pass(tmp_path):
    looped = FILES | {"bed.g": in_loop(FILES["bed.g"])}
    study, imported = take("rrf", looped, tmp_path)
    assert re.search(r"lines \d+ to \d+ stand in a loop", said(imported))
    rows = [[float(row["x_mm"]), float(row["y_mm"])] for row in imported.rows]
    assert np.array(rows) == pytest.approx(PLACES - [23.0, 0.0])
    assert nominal(study)["radius_mm"] == 124.309


@pytest.mark.parametrize("lines", [
    in_loop("if heat.heaters[0].current > 50\n  G30 P0 X0 Y80"),
    in_loop("G31 X20\nG30 P0 X0 Y80"),
    in_loop("G30 P{iterations} X{10*iterations} Y0"),
])  # fmt: skip
def test_what_a_loop_changes_is_refused(lines, tmp_path):
    with pytest.raises(InputError, match="stands under"):
        take("rrf", FILES | {"bed.g": lines}, tmp_path)


# -- files that mislead ----------------------------------------------------------------
@pytest.mark.parametrize(("name", "old", "new", "words"), [
    ("log.txt", "G32 bed", "Calibrated 6 factors using 10 points\nG32 bed", "config-override"),
    ("bed.g", "G30 P3 X0.00 ", "G30 P3 ", "G30 X.*point 3 has no X"),
    ("log.txt", "0.764", "probing failed", "a point was not probed"),
    ("config.g", "G31 X23 Y0", "G31 T1 X9 Y0\nG31 T4 X23 Y0", "probe_offset_mm = x, y"),
    ("config.g", "M558", "M669 K0\nM558", "none of linear delta"),
    ("config.g", "M558", "M669 K6\nM558", "line 4, M669 K.*`hangprinter`"),
    ("config.g", "L241.987", "L241.987:242:242:200", "4 numbers, where 1 or 3 belong"),
    ("bed.g", FILES["bed.g"], "G28\n", r"give the bed\.g"),
    ("bed.g", "G30 P1 ", "G30 P1e999 ", r"bed\.g: line \d+.*not a finite number"),
    ("log.txt", LOG, "G28\n", "has the answer of a last G30"),
    ("log.txt", LOG, "G32 bed probe heights: 0.1 0.2, mean 0\n", "line 1.*2 heights for 10 probe points"),
])  # fmt: skip
def test_files_that_mislead_are_refused(name, old, new, words, tmp_path):
    assert old in FILES[name]
    with pytest.raises(InputError, match=words):
        take("rrf", FILES | {name: FILES[name].replace(old, new)}, tmp_path)


def test_what_is_documented_beside_the_geometry_is_no_stumbling_block(tmp_path):
    """Words of commands that have no bearing on it, and a height map with its cost."""
    lines = "G28 X Y Z\nG32 P1\nM500 P31\nM561\nG29 S1\nM375\nM851 Z-2\n"
    _, imported = take("rrf", FILES | {"config.g": CONFIG + lines}, tmp_path)
    assert "G29 S (line 10): a height map that is on bends z" in said(imported)
    assert "M851 Z (line 12)" in said(imported)


HEAD = (
    "RepRapFirmware height map file v2 generated at 2024-05-01 10:00, deviation 0.1\n"
)
GRID = "xmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum\n-40,41,-30,30,45,20,30,5,3\n"
ROWS = """\
      0,  0.100,  0.200,  0.300,      0
 -0.100,  0.010,  0.000,  0.030, -0.040
      0, -0.150,  0.250, -0.350,      0
"""
OLDEST = (
    "RepRapFirmware height map file v1\n"
    "xmin,xmax,ymin,ymax,radius,spacing,xnum,ynum\n-40,41,-20,20,45,20,5,3\n"
)
NEWEST = (
    "axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1\n"
    "X,Y,-40,41,-30,30,45,20,30,5,3\n"
)


def mesh_rows(content: str, folder: Path) -> list[tuple[float, float, float]]:
    _, imported = take("rrf", FILES | {"heightmap.csv": content}, folder)
    return [
        (float(row["x_mm"]), float(row["y_mm"]), float(row["z_mm"]))
        for row in imported.rows
        if row["setup"] == "mesh_heightmap"
    ]


def test_probed_nodes_come_in_where_the_nozzle_was(tmp_path):
    """G31 X23 puts the nozzle beside the node; 0.000 is a height, 0 is none."""
    rows = mesh_rows(HEAD + GRID + ROWS, tmp_path)
    assert len(rows) == 11
    assert rows[0] == (-20.0 - 23.0, -30.0, 0.1)
    assert (0.0 - 23.0, 0.0, 0.0) in rows
    assert rows[-1] == (20.0 - 23.0, 30.0, -0.35)


def test_all_forms_say_the_same(tmp_path):
    contents = [HEAD + GRID + ROWS, HEAD + NEWEST + ROWS, OLDEST + ROWS]
    folders = [tmp_path / str(k) for k in range(3)]
    for folder in folders:
        folder.mkdir()
    first, second, oldest = map(mesh_rows, contents, folders)
    assert first == second
    assert [(x, z) for x, _, z in oldest] == [(x, z) for x, _, z in first]


def test_the_study_predicts_the_mesh_and_says_what_was_left_out(tmp_path):
    path, imported = take(
        "rrf", FILES | {"heightmap.csv": HEAD + GRID + ROWS}, tmp_path
    )
    said = " ".join(imported.statements)
    assert "11 heights of the mesh heightmap" in said
    assert "4 nodes are left out: they were not probed" in said
    assert 'predict = ["mesh_heightmap"]' in path.read_text()


def test_a_map_alone_calibrates_a_bed_that_leans(tmp_path):
    """Heights by the oracle of the firmware: a true delta, M666 with A and B, no G32."""
    firmware = rrf.RepRapFirmware(TILT_CONFIG)
    place = np.arange(-80.0, 81.0, 20.0)
    x, y = map(np.ravel, np.meshgrid(place, place))
    bed_places = np.column_stack([x, y])
    stops = firmware.height + firmware.adjust
    true = delta(
        firmware.radius + 0.4,
        firmware.rods,
        firmware.angles,
        stops + 0.2,
        firmware.tilt,
    )
    heights = np.zeros(len(x))
    for _ in range(20):
        at = firmware.travel(np.column_stack([bed_places, heights]))
        heights = heights - true.over_bed(at)
    inside = np.hypot(x, y) <= 85.0
    cells = [
        f"{h:.3f}" if used else "0" for h, used in zip(heights, inside, strict=True)
    ]
    rows = "\n".join(",".join(cells[k : k + 9]) for k in range(0, 81, 9))
    grid = NEWEST.splitlines()[0] + "\nX,Y,-80,80,-80,80,85,20,20,9,9\n"
    files = {"config.g": TILT_CONFIG, "heightmap.csv": HEAD + grid + rows}
    with pytest.raises(InputError, match="--mesh readings"):
        take("rrf", files, tmp_path / "held")
    folder = tmp_path / "read"
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_text(content)
    paths = [folder / name for name in files]
    path, _ = import_files("rrf", paths, folder / "out", mesh="readings")
    estimate = oed.identify(oed.read_readings(oed.load_study(path))).section
    assert estimate.readings == inside.sum()
    radius = estimate.parameters["radius"]
    assert radius.value == pytest.approx(firmware.radius + 0.4, abs=0.01)


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("20,30,5,3", "20,30,5,4", "3 rows of heights"),
    ("20,30,5,3", "20,30,6,3", "5 heights"),
    ("0.250", "x", "x is no number"),
    ("0.250", "nan", "nan is no number"),
    ("0.250", "0_25", "0_25 is no number"),
    ("0.250", "٢", "is no number"),
    (GRID, "a,b\n1,2\n", "heightmap.csv"),
    ("0.250", "1e400", "1e400 is no number"),
    ("20,30,5,3", "20,30,nan,3", "nan is no number"),
    ("20,30,5,3", "0,30,5,3", "no grid"),
    ("-40,41", "-40,30", "beyond its xmax"),
    ("xspacing", "step", "not known"),
])  # fmt: skip
def test_a_broken_map_is_refused(before, after, problem, tmp_path):
    content = (HEAD + GRID + ROWS).replace(before, after)
    with pytest.raises(InputError, match=problem) as caught:
        mesh_rows(content, tmp_path)
    assert "heightmap.csv" in str(caught.value)
    assert "give" not in caught.value.problem


def test_a_map_has_at_most_4_megabytes(tmp_path):
    """Blank lines at its end say nothing, and count."""
    content = HEAD + GRID + ROWS
    full = content + "\n" * (4_000_000 - len(content))
    assert len(mesh_rows(full, tmp_path / "full")) == 11
    with pytest.raises(InputError, match="a height map has at most 4 MB"):
        mesh_rows(full + "\n", tmp_path / "more")


def test_a_map_of_other_axes_is_refused(tmp_path):
    with pytest.raises(InputError, match="its axes are XZ"):
        mesh_rows(HEAD + NEWEST.replace("X,Y", "X,Z") + ROWS, tmp_path)


def test_meshes_of_names_alike_have_set_ups_of_their_own():
    names = ("warm bed", "warm_bed", "ä", "ö")
    meshes = [
        BedMesh(name, (ProbedPoint(0.0, 0.0, 0.1 * k),)) for k, name in enumerate(names)
    ]
    chosen, _ = distinct(meshes)
    setups = [mesh.setup for mesh in chosen]
    assert setups == ["mesh_warm_bed", "mesh_warm_bed_2", "mesh", "mesh_2"]
