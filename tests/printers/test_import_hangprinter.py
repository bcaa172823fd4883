"""`oed import hangprinter`: config.g, motors and places of the real HP4."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import oed
from oed.mechanism import Kinematics
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from pkm_studies.resolve import study_machine

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
