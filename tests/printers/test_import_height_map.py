"""`oed import rrf` with heightmap.csv, in the three forms that the firmware has had."""

from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import rrf
from oracles.firmware.geometry import delta

import oed
from pkm_printers.bed_mesh import BedMesh, ProbedPoint, distinct
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from printers.delta_printer import take
from printers.test_import_rrf import FILES, TILT_CONFIG

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
