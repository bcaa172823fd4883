"""Hangprinters: motors and places in, of the real HP4 too, the firmware's numbers out."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
from oracles.firmware.hangprinter import Hangprinter, hangprinter

import oed
from oed.mechanism import Kinematics
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from pkm_studies.resolve import study_machine
from printers.delta_printer import PLAIN, compensate

CONFIG = """\
M669 K6 P2000.0 S200
M669 A0:-1620:-150 B1272.792:1272.792:-150 C-1402.961:810:-150 D2350
M666 Q0.06875 R75:75:75:75 U2:2:2:4 O1:1:1:1 L20:20:20:20 H255:255:255:255 J25:25:25:25 W2.0
"""


def taken(config: str, shared_data: Path, folder: Path) -> tuple[Path, str, list]:
    (folder / "config.g").write_text(config)
    paths = [folder / "config.g"]
    for name in ("motor_deg.csv", "known_xyz_mm.csv"):
        shutil.copy(shared_data / "hangprinter_hp4" / name, folder / name)
        paths.append(folder / name)
    path, imported = import_files("hangprinter", paths, folder / "out", name="h")
    return path, " ".join(imported.statements), list(imported.rows)


def test_the_real_machine_comes_in_and_its_lines_close(shared_data, tmp_path):
    path, sentences, rows = taken(CONFIG, shared_data, tmp_path)
    assert len(rows) == 9 + 44
    assert "Words read: M669 K A B C D" in sentences
    assert "M666 W (line 3): it is how the firmware plans forces" in sentences
    study = oed.load_study(path)
    assert study.machine.geometry["anchor_mm"][3] == [0.0, 0.0, 2350.0]
    section = oed.identify(oed.read_readings(study)).section
    # known: anchors and spools from all poses leave 0.65 mm
    assert section.rms_after["gap"] < 800.0
    assert max(section.rms_after[f"read_{axis}"] for axis in "xyz") < 2000.0


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("U2:2:2:4 ", "", "line 3, M666 U.*M666 has no U"),
    ("O1:1:1:1", "O1:1:1:2", "line 3, M666 O.*different numbers of lines"),
    ("R75:75:75:75", "R75:75:75", "line 3, M666 R.*3 numbers, where 4 belong"),
    ("D2350", "D2350 J0:0:2000", "line 2, M669 J.*five anchors at most"),
    ("D2350", "I2350", "line 2, M669 N.*4 anchors are stated as A, B, C, I"),
    ("D2350", "D2350 N5", "line 2, M669 N.*5 anchors are stated as A, B, C, D"),
    ("A0:-1620:-150", "A0:-1620", "x, y and z"),
    ("W2.0", "E20", "does not know this word"),
    ("D2350", "D1e300", "x, y and z, in mm"),
    ("M669 K6", "G20\nM669 K6", "in inches"),
    ("M669 A0", "if true\n  M669 A0", "stands under"),
])  # fmt: skip
def test_other_machines_are_refused(before, after, problem, shared_data, tmp_path):
    with pytest.raises(InputError, match=problem):
        taken(CONFIG.replace(before, after), shared_data, tmp_path)


@pytest.mark.parametrize(
    ("factor", "places"), [(np.pi / 180.0, True), (np.pi / 180.0, False), (-1.0, True)]
)
def test_motors_in_radians_or_wound_the_other_way_are_refused(
    factor, places, shared_data, tmp_path
):
    source = shared_data / "hangprinter_hp4"
    motors = np.loadtxt(source / "motor_deg.csv", delimiter=",", skiprows=1)
    rows = [",".join(map(repr, row)) for row in (factor * motors).tolist()]
    (tmp_path / "motors.csv").write_text("\n".join(["A,B,C,D", *rows]))
    (tmp_path / "config.g").write_text(CONFIG)
    files = [tmp_path / "config.g", tmp_path / "motors.csv"]
    if places:
        files.append(source / "known_xyz_mm.csv")
    with pytest.raises(InputError, match="radians times 57"):
        import_files("hangprinter", files, tmp_path / "out", name="h")


@pytest.mark.parametrize(
    ("content", "problem"),
    [("A,B,C,D\n1,2,3,4\n", "has the columns A, B, C, D too"), ("F1,F2\n1,2\n", "F1")],
)
def test_a_table_that_would_not_be_read_is_refused(content, problem, tmp_path):
    for name, text in (
        ("config.g", CONFIG.lower()),
        ("motors.csv", "A,B,C,D\n0,0,0,0\n9000,0,0,0\n"),
        ("more.csv", content),
    ):
        (tmp_path / name).write_text(text)
    paths = [tmp_path / name for name in ("config.g", "motors.csv", "more.csv")]
    with pytest.raises(InputError, match=problem):
        import_files("hangprinter", paths, tmp_path / "out", name="h")
    _, imported = import_files("hangprinter", paths[:2], tmp_path / "out")
    assert not [s for s in imported.statements if "places" in s]


def motor_turns(place: np.ndarray, buildup: float, radii: np.ndarray) -> np.ndarray:
    """Motor angles (4,), deg, at a place, mm: the firmware's k0 (sqrt(r^2 + k2 l) - r)."""
    anchors = np.array(
        [(0, -1620, -150), (1272.792, 1272.792, -150), (-1402.961, 810, -150)]
    )
    anchors = np.vstack([anchors, [0.0, 0.0, 2350.0]])
    change = np.linalg.norm(anchors - place, axis=1) - np.linalg.norm(anchors, axis=1)
    fold, gear = np.array([2.0, 2.0, 2.0, 4.0]), 255.0 / 20.0
    k2 = -fold * buildup
    turned = 2.0 / k2 * (np.sqrt(radii**2 + k2 * change) - radii) * fold * gear
    return np.degrees(turned)


@pytest.mark.parametrize("buildup", [0.103377, 0.038])
def test_the_build_up_is_that_of_the_machine(buildup, tmp_path):
    rng, radii = np.random.default_rng(2), np.array([75.1, 75.2, 75.3, 75.0])
    places = rng.uniform([-300, -300, 50], [300, 300, 1000], (12, 3))
    motors = [motor_turns(place, buildup, radii) for place in places]
    spools = "M666 Q{}\nM666 R75.1:75.2:75.3:75\nM666 U2:2:2:4\nM666 J25:25:25:25\n"
    config = CONFIG.partition("M666")[0] + spools.format(buildup)
    for name, text in (
        ("config.g", config),
        ("m.csv", rows_of("A,B,C,D", motors)),
        ("p.csv", rows_of("x,y,z", places)),
    ):
        (tmp_path / name).write_text(text)
    files = [tmp_path / name for name in ("config.g", "m.csv", "p.csv")]
    path, _ = import_files("hangprinter", files, tmp_path / "out", name="h")
    machine = study_machine(oed.load_study(path))
    turned = np.degrees(Kinematics(machine).inverse(places / 1e3)[1])
    assert turned == pytest.approx(np.array(motors), rel=1e-7)


def rows_of(header: str, rows: list[np.ndarray] | np.ndarray) -> str:
    cells = (",".join(map(repr, np.asarray(row).tolist())) for row in rows)
    return "\n".join([header, *cells])


def test_an_error_names_the_line_of_its_word(tmp_path):
    config = CONFIG.replace("U2:2:2:4", "").replace("M666", "M666 U2:2:2\nM666", 1)
    (tmp_path / "config.g").write_text(config)
    (tmp_path / "m.csv").write_text("A,B,C,D\n1,2,3,4\n5,6,7,8\n")
    (tmp_path / "p.csv").write_text("x,y,z\n1,2,3\n4,5,6\n7,8,9\n")
    files = [tmp_path / name for name in ("config.g", "m.csv", "p.csv")]
    with pytest.raises(InputError, match=r"line 3, M666 U.*M666 U2:2:2"):
        import_files("hangprinter", files[:2], tmp_path / "o")
    files[0].write_text(CONFIG)
    with pytest.raises(InputError, match="3 places, but 2 poses of the motors; give"):
        import_files("hangprinter", files, tmp_path / "o")


ANCHORS = {
    3: "N3 A0:-2000:2400 B1800:1000:2400 C-1800:1000:2400 P900",
    4: "N4 A0:-1620:-150 B1272.8:1272.8:-150 C-1403:810:-150 D0:0:2350 P900",
    5: "N5 A0:-1600:-120 B1600:0:-120 C0:1600:-120 D-1600:0:-120 I0:0:2400 P900",
}
SPOOLS = {
    3: "R75:75:75 U2:2:2 O1:1:1 H255:255:255 L20:20:20",
    4: "R75:75:75:75 U2:2:2:4 O2:2:2:2 H255:255:255:255 L20:20:20:20 W1.5 T20",
    5: "R65:65:65:65:65 U2:2:2:2:4 O1:1:1:1:1 H100:100:100:100:100 L20:20:20:20:20",
}
SHIFT, CAMERA, LINE = np.array([4.0, -6.0, 3.0]), 0.2, 0.05
SETTINGS = """\
estimate = false
read_x_mm = 0.2
read_y_mm = 0.2
read_z_mm = 0.2
{gaps}
[readings]
"""


def config(count: int, more: str = "") -> str:
    return f"M669 K6 {ANCHORS[count]}\nM666 Q0.05 {SPOOLS[count]}{more}\n"


def real_printer(believed: Hangprinter) -> Hangprinter:
    """A printer off by what a tape measures."""
    rng = np.random.default_rng(7)
    return dataclasses.replace(
        believed,
        anchors=believed.anchors + rng.uniform(-15.0, 15.0, believed.anchors.shape),
        spools=believed.spools + rng.uniform(-0.5, 0.5, len(believed.spools)),
        buildup=1.2 * believed.buildup,
    )


def places(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(
        [-400, -400, 0], [400, 400, 1200], (count, 3)
    )


def study_of(text: str, folder: Path, motors: np.ndarray, forces=None) -> Path:
    """The study of motor angles (n, m), deg, and of places that a camera sees."""
    rng, seen = np.random.default_rng(8), places(1, 30)
    seen = seen + SHIFT + CAMERA * rng.normal(size=seen.shape)
    letters = list("ABCDI"[: motors.shape[1]])
    header = letters if forces is None else [*letters, *(f"F{k}" for k in letters)]
    cells = motors if forces is None else np.hstack([motors, forces])
    for name, head, rows in (
        ("motors.csv", header, cells),
        ("places.csv", list("xyz"), seen),
    ):
        table = [",".join(head), *(",".join(map(repr, row)) for row in rows.tolist())]
        (folder / name).write_text("\n".join(table))
    (folder / "config.g").write_text(text)
    paths = [folder / name for name in ("config.g", "motors.csv", "places.csv")]
    study, _ = import_files("hangprinter", paths, folder / "study", name="p")
    spare = motors.shape[1] - 3
    gaps = {0: [], 1: ["gap_mm"], 2: ["gap1_mm", "gap2_mm"]}[spare]
    head, _, rest = study.read_text().partition("assumed = true")
    known = SETTINGS.format(gaps="\n".join(f"{gap} = {LINE}" for gap in gaps))
    end = rest.partition("[readings]")[2] + PLAIN + '[identify]\neffects = "none"\n'
    study.write_text(head + known + end)
    return study


@pytest.mark.parametrize("count", ANCHORS)
def test_the_firmware_gets_numbers_that_put_it_right(count, tmp_path):
    text = config(count)
    believed = hangprinter(text)
    real, check = real_printer(believed), places(2, 12)
    rng = np.random.default_rng(9)
    turns = np.array([real.motors(place) for place in places(1, 30)])
    turns += np.degrees(LINE / 75.0 * 2.0 * 12.75) * rng.normal(size=turns.shape)
    before = [real.place(believed.motors(place)) - place for place in check]
    export = compensate(study_of(text, tmp_path, turns), "rrf")
    firmware = hangprinter(export)
    assert firmware.buildup == pytest.approx(real.buildup, rel=0.1)
    after = np.array([real.place(firmware.motors(place)) - place for place in check])
    assert np.sqrt((np.array(before) ** 2).mean()) > 2.0
    assert np.sqrt((after**2).mean()) < 3.0 * CAMERA
    assert "P900" in export
    assert "+4." in export.split("the origin is")[1]


def test_forces_take_the_flex_out(tmp_path):
    """Columns FA to FD with S of M666: places agree as without any force."""
    text = config(4, " S40000")
    believed = hangprinter(text)
    forces = np.random.default_rng(3).uniform(10.0, 60.0, (30, 4))
    pairs = zip(places(1, 30), forces, strict=True)
    turns = np.array([believed.motors(place, force) for place, force in pairs])
    study = study_of(text, tmp_path, turns, forces)
    # the model has one compliance a line: Y over U d is that of the origin
    stiffness = oed.load_study(study).machine.geometry["stiffness_N"]
    wires = np.linalg.norm(believed.anchors - believed.anchors[3], axis=1)
    share = wires / (believed.folds * np.linalg.norm(believed.anchors, axis=1))
    assert stiffness == pytest.approx(40000.0 / (1.0 + share))
    section = oed.identify(oed.read_readings(oed.load_study(study))).section
    assert section.rms_before["read_x"] < 9000.0
    assert section.rms_after["read_x"] < 2e3 * CAMERA
    bare = tmp_path / "bare"
    bare.mkdir()
    without = oed.identify(
        oed.read_readings(oed.load_study(study_of(text, bare, turns)))
    )
    assert without.section.rms_after["gap"] > 3.0 * section.rms_after["gap"]


def test_three_lines_need_places(tmp_path):
    (tmp_path / "config.g").write_text(config(3))
    (tmp_path / "m.csv").write_text("A,B,C\n9000,0,0\n0,9000,0\n")
    paths = [tmp_path / "config.g", tmp_path / "m.csv"]
    with pytest.raises(InputError, match="three lines alone say nothing"):
        import_files("hangprinter", paths, tmp_path / "out", name="h")
