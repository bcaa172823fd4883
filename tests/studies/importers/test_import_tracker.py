"""`oed import tracker`, of the shipped delta and of a large one, against the oracle."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from oracles.delta_trilateration import nozzle, travel_to
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

import oed
from oed import units
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.importers import ImportedSession, import_files

#: the shipped delta, and a true one: mm and rad
NOMINAL = (161.75, [345.0] * 3, np.radians([210.0, 330.0, 90.0]), [420.0] * 3)
TRUE = (161.75, [345.2, 344.9, 345.0], np.radians([210.1, 330, 90]), [420.1, 420, 420])


def true_points(commanded: np.ndarray) -> np.ndarray:
    """Where the true delta puts its tool at commands (n, 3), mm."""
    return nozzle(travel_to(commanded, *NOMINAL), *TRUE)


def test_tracker_points_in_a_frame_of_their_own(tmp_path):
    """The true delta, seen by a tracker 3 m away and turned by 70 degrees."""
    grid = np.linspace(-80.0, 80.0, 4)
    mesh = np.meshgrid(grid, grid, [20.0, 150.0], indexing="ij")
    commanded = np.column_stack([m.ravel() for m in mesh])
    turned = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
    shift = np.array([3000.0, -500.0, 800.0])
    seen = turned.apply(true_points(commanded)) + shift
    lines = ["x_mm,y_mm,z_mm,X,Y,Z"]
    pairs = np.hstack([commanded, seen])
    lines += [",".join(f"{value:.6f}" for value in row) for row in pairs]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines))
    study, imported = taken([path], tmp_path / "out")
    assert any("best fit to the nominal poses" in s for s in imported.statements)
    estimate = oed.identify(oed.read_readings(oed.load_study(study))).section
    assert max(estimate.rms_after.values()) < 2.0  # um
    # lengths of arms are seen whatever the frame
    entry = estimate.parameters["arm1"]
    arm = units.number(float(units.to_si(entry.value, entry.unit)), "mm")
    assert arm == pytest.approx(TRUE[1][0], abs=0.02)
    path.write_text("\n".join(lines).replace("X,Y,Z", "X,Z,Y"))
    with pytest.raises(InputError, match="left-handed"):
        taken([path], tmp_path / "b")
    shuffled = [lines[0], *lines[20:], *lines[1:20]]
    poses = [",".join(line.split(",")[:3]) for line in lines]
    (tmp_path / "poses.csv").write_text("\n".join(poses))
    path.write_text("\n".join(",".join(line.split(",")[3:]) for line in shuffled))
    with pytest.raises(InputError, match="in one order"):
        taken([path, tmp_path / "poses.csv"], tmp_path / "c")


LARGE = (1200.0, [2600.0] * 3, np.radians([210.0, 330.0, 90.0]), [1900.0] * 3)
LARGE_MAP = """\
[machine]
model = "delta"

[machine.geometry]
radius_mm = 1200
arm_mm = 2600
endstop_mm = 1900
"""
LARGE_STUDY = (
    'schema = 1\nname = "large"\n'
    + LARGE_MAP
    + """
[[setup]]
name = "tracker"
instrument = "pose_tracker_position"
"""
)


def write_large_points(path: Path, noise: np.ndarray) -> None:
    """Points of a delta of 1.2 m with endstops 1 mm off, in a frame of their own."""
    grid = np.meshgrid([-500.0, 0.0, 500.0], [-500.0, 0.0, 500.0], [100.0, 600.0])
    commanded = np.column_stack([axis.ravel() for axis in grid])
    true = (*LARGE[:3], [1901.0, 1900.0, 1899.0])
    points = nozzle(travel_to(commanded, *LARGE), *true)
    turned = Rotation.from_euler("zyx", [130.0, 4.0, -7.0], degrees=True)
    seen = turned.apply(points) + np.array([4210.0, -1533.0, 612.0]) + noise
    rows = np.hstack([commanded, seen])
    lines = [",".join(f"{v:.6f}" for v in row) for row in rows]
    path.write_text("\n".join(["x_mm,y_mm,z_mm,X,Y,Z", *lines]))


@pytest.mark.parametrize("by_map", [True, False])
def test_points_of_a_machine_of_any_size(by_map, tmp_path, rng):
    """The map has the machine's table, or --machine a study with it."""
    path = tmp_path / "points.csv"
    write_large_points(path, 0.01 * rng.standard_normal((18, 3)))
    (tmp_path / "m.toml").write_text(LARGE_MAP)
    (tmp_path / "large.study.toml").write_text(LARGE_STUDY)
    study, imported = import_files(
        "tracker",
        [path],
        tmp_path / "out",
        machine=None if by_map else str(tmp_path / "large.study.toml"),
        column_map=tmp_path / "m.toml" if by_map else None,
    )
    loaded = oed.load_study(study)
    assert loaded.machine.geometry["arm_mm"] == 2600
    assert loaded.prediction.reference == "best_fit"  # the machine's place is unknown
    estimate = oed.identify(oed.read_readings(loaded)).section
    assert max(estimate.rms_after.values()) < 20.0  # um
    # the map that was written is complete
    kept = tmp_path / "out" / "points.map.toml"
    again = import_files("tracker", [path], tmp_path / "b", column_map=kept)[1]
    assert again.rows == imported.rows


@pytest.mark.parametrize(("registration", "words", "tolerance", "errors"), [
    ("free", "free within 10 mm and 20 mrad", 10.0, "best_fit"),
    ("best_fit", "held there", 0.0, "best_fit"),
    ("known", "taken to be in the machine's frame", 0.0, "home"),
])  # fmt: skip
def test_a_frame_is_free_held_or_known(
    registration, words, tolerance, errors, tmp_path
):
    path = tmp_path / "points.csv"
    write_large_points(path, np.zeros((18, 3)))
    text = f'registration = "{registration}"\n' + LARGE_MAP
    (tmp_path / "m.toml").write_text(text)
    study, imported = import_files(
        "tracker", [path], tmp_path / "out", column_map=tmp_path / "m.toml"
    )
    assert any(words in sentence for sentence in imported.statements)
    loaded = oed.load_study(study)
    assert loaded.setup[0].tolerance["shift_z_mm"] == tolerance
    assert loaded.prediction.reference == errors
    measured = [[float(row[f"read_{a}_mm"]) for a in "xyz"] for row in imported.rows]
    moved = np.abs(np.array(measured) - _commanded(imported.rows)).max()
    assert (moved > 1000.0) == (registration == "known")  # mm


def _commanded(rows: Sequence[Mapping[str, str]]) -> np.ndarray:
    return np.array([[float(row[f"{a}_mm"]) for a in "xyz"] for row in rows])


@pytest.mark.parametrize(
    ("noise", "code", "words"),
    [(0.03, 0, "the noise was understated"), (0.5, 1, "The fit is bad")],
)
def test_a_tracker_noisier_than_its_data_sheet(
    noise, code, words, tmp_path, rng, capsys
):
    """The importer states 10 um as a guess: more is estimated, far more is refused."""
    path = tmp_path / "points.csv"
    write_large_points(path, noise * rng.standard_normal((18, 3)))
    (tmp_path / "m.toml").write_text(LARGE_MAP)
    study, _ = import_files(
        "tracker", [path], tmp_path / "out", column_map=tmp_path / "m.toml"
    )
    assert main(["check", str(study)]) == code  # with the readings that it names
    assert words in "".join(capsys.readouterr())


def test_a_machine_table_that_does_not_fit_names_its_field(tmp_path):
    path = tmp_path / "points.csv"
    write_large_points(path, np.zeros((18, 3)))
    (tmp_path / "m.toml").write_text(LARGE_MAP.replace("arm_mm", "arms_mm"))
    with pytest.raises(
        InputError, match=r"m\.toml: machine\.geometry\.arms_mm.*arm_mm"
    ):
        import_files(
            "tracker", [path], tmp_path / "out", column_map=tmp_path / "m.toml"
        )


LEICA = (
    "X  [mm],Y  [mm],Z  [mm],U(95)  [mm],U(95) X  [mm],U(95) Y  [mm],U(95) Z  [mm],"
    "Tilt  [deg],Q0 ,Q1 ,Q2 ,Q3 ,Image RMS  [µm],Target,Temperature  [°C],"
    "Pressure  [mBar],Humidity  [%],Time Stamp,OTG Applied,Delete"
)
SPATIAL_ANALYZER = (
    "// SpatialAnalyzer 2021\n// Frame: A::WORLD\n// Axes: right-handed, cartesian\n"
    "// Collection,  Group,  Point,  X,  Y,  Z"
)


#: commands of the points in an export, mm
EXPORTED = np.column_stack(
    [
        axis.ravel()
        for axis in np.meshgrid([-60.0, 0, 60.0], [-60.0, 0, 60.0], [20.0, 120.0])
    ]
)


def taken(files: list[Path], folder: Path) -> tuple[Path, ImportedSession]:
    """An import for the shipped delta."""
    return import_files("tracker", files, folder, machine="linear_delta")


def assert_points(imported: ImportedSession, unit: str, factor: float) -> None:
    """The points at their commands, as far from one another as on the true delta."""
    rows = imported.rows
    np.testing.assert_allclose(_commanded(rows), EXPORTED, atol=1e-9)
    read = [[float(row[f"read_{a}_{unit}"]) for a in "xyz"] for row in rows]
    apart = pdist(np.array(read) / factor)
    np.testing.assert_allclose(apart, pdist(true_points(EXPORTED)), atol=1e-5)


def exported(folder: Path, header: str, line: str, points: np.ndarray) -> list[Path]:
    """Files of a tracker's export and of the poses, side by side."""
    commanded = EXPORTED
    turned = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
    shift = np.array([3000.0, -500.0, 800.0])
    seen = points * (turned.apply(true_points(commanded)) + shift)
    lines = [
        line.format(k=k, x=repr(x), y=repr(y), z=repr(z))
        for k, (x, y, z) in enumerate(seen.tolist())
    ]
    files = [folder / "points.csv", folder / "poses.csv"]
    files[0].write_text("\n".join([header, *lines]), encoding="utf-8")
    poses = [",".join(map(str, row)) for row in commanded.tolist()]
    files[1].write_text("\n".join(["x_mm,y_mm,z_mm", *poses]))
    return files


LEICA_LINE = (
    "{x},{y},{z},0.01,0.008,0.008,0.008,29.9,0.2,-0.1,0.5,0.7,0.22,TMC 30-B #5320,"
    "22.8,1018,32,'11.10.2022 15:06:{k:02d}.043,FALSE,"
)
METRES = LEICA.replace("[mm]", "[m]"), LEICA_LINE.replace("0.008", "0.000008")


@pytest.mark.parametrize("form", [(LEICA, LEICA_LINE, 1.0), (*METRES, 1e-3)])
def test_points_and_uncertainties_of_a_leica_need_no_map(form, tmp_path):
    header, line, factor = form
    files = exported(tmp_path, header, line, np.array(factor))
    study, imported = taken(files, tmp_path / "out")
    said = " ".join(imported.statements)
    assert "U(95) X" in said
    assert "over k = 2" in said
    assert "Not used: U(95)  [" in said
    oed.read_readings(oed.load_study(study))
    # 8 um of 95 % are 4 um in each coordinate, in every direction
    names = [name for name in imported.rows[0] if name.startswith("sigma_")]
    sigma = [factor * float(row[name]) for row in imported.rows for name in names]
    assert sigma == pytest.approx([4e-3 * factor**2] * 54, rel=1e-6)
    assert_points(imported, "m" if factor < 1.0 else "mm", factor)


MOTIVE = """\
Format Version,1.25,Take Name,Take 1,Capture Frame Rate,120.0,Length Units,Millimeters

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body
,Name,plate,plate,plate,plate,plate,plate,plate,plate
,ID,"A1","A1","A1","A1","A1","A1","A1","A1"
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,"""
MOTIVE_METRES = MOTIVE.replace("Millimeters", "Meters")
QUALISYS = """\
NO_OF_FRAMES\t18
NO_OF_CAMERAS\t8
NO_OF_MARKERS\t1
FREQUENCY\t100
DATA_INCLUDED\t3D
MARKER_NAMES\tnest"""
VICON = """\
Segments
120
,plate:plate,,,,,,
Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ
,,deg,deg,deg,mm,mm,mm"""


@pytest.mark.parametrize(("header", "line", "factor", "name"), [
    (MOTIVE, "{k},0.{k:02d},0,0,0,1,{x},{y},{z},0.0001", 1.0, "Position X"),
    (MOTIVE_METRES, "{k},0,0,0,0,1,{x},{y},{z},0.0001", 1e-3, "Position X"),
    (QUALISYS, "{x}\t{y}\t{z}", 1.0, "X"),
    (QUALISYS + "\nFrame\tTime\tnest X\tnest Y\tnest Z", "{k}\t0\t{x}\t{y}\t{z}", 1.0, "X"),
    ("Name;Meas X;Meas Y;Meas Z;Dev", "p{k};{x};{y};{z};0.1", 1.0, "Meas X"),
    (VICON, "{k},0,1,2,3,{x},{y},{z}", 1.0, "TX [mm]"),
])  # fmt: skip
def test_points_of_motion_capture_need_no_map(header, line, factor, name, tmp_path):
    files = exported(tmp_path, header, line, np.array(factor))
    _, imported = taken(files, tmp_path / "out")
    unit = "m" if factor < 1.0 else "mm"
    assert f"{name} as read_x_{unit}" in " ".join(imported.statements)
    assert_points(imported, unit, factor)


@pytest.mark.parametrize(("header", "line", "words"), [
    (MOTIVE.replace("Millimeters", "Centimeters"), "{k},0,0,0,0,1,{x},{y},{z},0",
     r"line 1, Length Units = Centimeters: no unit"),
    (QUALISYS.replace("nest", "a\tb"), "{x}\t{y}\t{z}\t{x}\t{y}\t{z}",
     r"the file has a X, a Y, a Z, b X"),
])  # fmt: skip
def test_words_of_motion_capture_that_are_not_read(header, line, words, tmp_path):
    files = exported(tmp_path, header, line, np.array(1.0))
    with pytest.raises(InputError, match=words):
        taken(files, tmp_path / "out")


def test_two_files_without_names_of_columns_say_so(tmp_path):
    for name in ("points.txt", "poses.txt"):
        (tmp_path / name).write_text("1.0 2.0 3.0\n4.0 5.0 6.0\n")
    files = [tmp_path / "points.txt", tmp_path / "poses.txt"]
    with pytest.raises(InputError, match="names of its columns"):
        taken(files, tmp_path / "o")


def test_an_index_without_a_name_is_no_file_without_names(tmp_path):
    """As a table of Python's has it, in both files."""
    files = exported(tmp_path, ",x,y,z", "J{k},{x},{y},{z}", np.array(1.0))
    lines = files[1].read_text().splitlines()
    indexed = [f"J{k},{line}" for k, line in enumerate(lines[1:])]
    files[1].write_text("\n".join([f",{lines[0]}", *indexed]))
    _, imported = taken(files, tmp_path / "a")
    assert len(imported.rows) == 18
    files[1].write_text("\n".join([",x,y,z", *indexed]))
    with pytest.raises(InputError, match=r"the column x is in .*points\.csv as well"):
        taken(files, tmp_path / "b")


def test_an_uncertainty_that_is_rounded_to_0_is_half_its_last_digit(tmp_path):
    line = LEICA_LINE.replace("0.008,0.008,0.008", "0.008,0.000,0.008")
    files = exported(tmp_path, LEICA, line, np.array(1.0))
    with pytest.raises(InputError, match="a standard deviation is above 0"):
        taken(files, tmp_path / "a")
    text = files[0].read_text(encoding="utf-8")
    files[0].write_text(text.replace("0.008,0.000", "0.008,0.002", 1), encoding="utf-8")
    study, imported = taken(files, tmp_path / "out")
    said = " ".join(imported.statements)
    assert (
        "sigma_read_y_mm is 0 in 17 lines, as it is rounded: 0.00025 is taken" in said
    )
    assert oed.read_readings(oed.load_study(study)).state.readings is not None
    whole = LEICA_LINE.replace("0.008,0.008,0.008", "1,0,1")
    files = exported(tmp_path, LEICA, whole, np.array(1.0))
    with pytest.raises(InputError, match="a standard deviation is above 0"):
        taken(files, tmp_path / "b")


def test_points_of_spatial_analyzer_have_their_names_in_a_comment(tmp_path):
    line = "A,  Main,  p{k},  {x},  {y},  {z}"
    files = exported(tmp_path, SPATIAL_ANALYZER, line, np.array(1.0))
    _, imported = taken(files, tmp_path / "out")
    assert "X as read_x_mm" in " ".join(imported.statements)
    # the file states no unit: another one is refused
    files = exported(tmp_path, SPATIAL_ANALYZER, line, np.array(1 / 25.4))
    with pytest.raises(InputError, match="their units"):
        taken(files, tmp_path / "b")


@pytest.mark.parametrize(("header", "line", "words"), [
    (LEICA, LEICA_LINE + "TRUE", "the point was deleted"),
    (LEICA.replace("Tilt", "x_meas"), LEICA_LINE, "may both be the measured x"),
    ("azimuth,zenith,distance", "{x},{y},{z}", r"add read_x_mm to \[columns\] of a --map file"),
    ("X [ft],Y [ft],Z [ft]", "{x},{y},{z}", r"add read_x_mm to \[columns\] of a --map file"),
])  # fmt: skip
def test_what_a_header_does_not_say_needs_a_map(header, line, words, tmp_path):
    header = header.replace("x_meas  [deg]", "x_meas")
    files = exported(tmp_path, header, line, np.array(1.0))
    with pytest.raises(InputError, match=words):
        taken(files, tmp_path / "out")


@pytest.mark.parametrize(("line", "words"), [
    ("1e300,{y},{z},1,1,1", "line 2, column X = 1e300: no number of a session"),
    ("{x},{y},{z},1,0,1", r"line 2, column U\(95\) Y \[um\] = 0: .* above 0"),
    ("{x},{y},{z},1,1,-1", r"line 2, column U\(95\) Z \[um\] = -1: .* above 0"),
])  # fmt: skip
def test_numbers_that_no_readings_file_could_have_are_refused_by_their_line(
    line, words, tmp_path
):
    header = "X,Y,Z,U(95) X [um],U(95) Y [um],U(95) Z [um]"
    files = exported(tmp_path, header, line, np.array(1.0))
    with pytest.raises(InputError, match=words):
        taken(files, tmp_path / "out")


def test_an_uncertainty_of_unknown_coverage_is_stated(tmp_path):
    files = exported(tmp_path, "X,Y,Z,Ux,Uy,Uz", "{x},{y},{z},1,1,1", np.array(1.0))
    _, imported = taken(files, tmp_path / "out")
    assert "want of a coverage factor: Ux, Uy, Uz" in " ".join(imported.statements)
