"""Quaternions, rotation vectors, directions and several nests in column maps, against SciPy."""

from pathlib import Path

import numpy as np
import pytest
from sample import table_lines
from scipy.spatial.transform import Rotation
from shipped_models import hexapod, prs_spindle

import oed
from oed.mechanism import Kinematics
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, import_files
from pkm_studies.resolve import resolve

MAP = """\
machine = "hexapod"
instrument = "pose_tracker"
registration = "known"

[columns]
x_mm = "cx"
y_mm = "cy"
z_mm = "cz"
rx_deg = "ca"
ry_deg = "cb"
spin_deg = "cc"
read_x_mm = "X"
read_y_mm = "Y"
read_z_mm = "Z"

[orientation]
"""
COMMANDED = ["cx", "cy", "cz", "ca", "cb", "cc"]
FORMS = {
    'quaternion = ["w", "i", "j", "k"]\n': lambda r: r.as_quat(scalar_first=True),
    'rotation_vector_deg = ["w", "i", "j"]\n': lambda r: np.degrees(r.as_rotvec()),
    'rotation_vector_rad = ["w", "i", "j"]\n': lambda r: r.as_rotvec(),
    'quaternion = ["w", "i", "j", "k"]\ninverse = true\n': lambda r: r.inv().as_quat(scalar_first=True),
}  # fmt: skip


def poses(rng: np.random.Generator, n: int = 12) -> np.ndarray:
    """Commands of the hexapod (n, 6), mm and degrees."""
    m = hexapod.machine
    low, high = np.array([(c.lower, c.upper) for c in m.command]).T
    return rng.uniform(0.6 * low, 0.6 * high, (n, 6)) + 0.4 * m.home_command


def stand(command: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """Orientation and tool point (n, 3), m, of the nominal hexapod, by hand."""
    tilt = Rotation.from_rotvec(np.column_stack([command[:, 3:5], 0 * command[:, 0]]))
    return tilt * Rotation.from_euler("z", command[:, 5:]), command[:, :3]


def write(path: Path, command: np.ndarray, point: np.ndarray, form: np.ndarray) -> None:
    shown = np.hstack(
        [1e3 * command[:, :3], np.degrees(command[:, 3:]), 1e3 * point, form]
    )
    names = [*COMMANDED, "X", "Y", "Z", *"wijk"[: form.shape[1]]]
    rows = [",".join(f"{v:.12f}" for v in row) for row in shown]
    path.write_text("\n".join([",".join(names), *rows]))


def taken(folder: Path, kind: str = "columns") -> tuple[Path, ImportedSession]:
    """The study of p.csv and m.toml in a folder."""
    return import_files(
        kind, [folder / "p.csv"], folder / "out", column_map=folder / "m.toml"
    )


def imported_angles(study: Path) -> np.ndarray:
    """Angles (n, 3) of the imported readings, rad."""
    readings = oed.read_readings(oed.load_study(study)).state.readings
    return readings.y.reshape(-1, 6)[:, 3:]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["columns", "tracker"])
def test_other_forms_of_an_orientation_come_in(form, kind, tmp_path, rng):
    """They become Rx(alpha) Ry(beta) Rz(gamma), which is what the tracker reads."""
    command = poses(rng)
    rotation, point = stand(command)
    write(tmp_path / "p.csv", command, point, FORMS[form](rotation))
    (tmp_path / "m.toml").write_text(MAP + form)
    study, imported = taken(tmp_path, kind)
    angles = imported_angles(study)
    assert angles == pytest.approx(rotation.as_euler("XYZ"), abs=1e-10)
    assert any("R = Rx(read_alpha) Ry(read_beta)" in s for s in imported.statements)
    kept = (tmp_path / "out" / "p.map.toml").read_text()
    assert "[orientation]" in kept


def test_a_tracker_s_frame_turns_the_orientations_too(tmp_path, rng):
    """Seen by a tracker that stands 3 m away, turned by 70 degrees."""
    command = poses(rng)
    rotation, point = stand(command)
    turned = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
    seen = turned.apply(point) + np.array([3.0, -0.5, 0.8])
    write(
        tmp_path / "p.csv",
        command,
        seen,
        (turned * rotation).as_quat(scalar_first=True),
    )
    text = MAP.replace('"known"', '"best_fit"') + 'quaternion = ["w", "i", "j", "k"]\n'
    (tmp_path / "m.toml").write_text(text)
    study, _ = taken(tmp_path, "tracker")
    assert imported_angles(study) == pytest.approx(rotation.as_euler("XYZ"), abs=1e-8)


#: what a file may have, what the map says of it, and what is to be named
MISTAKEN = {
    "scalar last": (lambda r: r.as_quat(), 'quaternion = ["w", "i", "j", "k"]\n',
     r'quaternion = \["k", "w", "i", "j"\]'),
    "scalar second": (lambda r: np.roll(r.as_quat(scalar_first=True), 1, axis=1),
     'quaternion = ["w", "i", "j", "k"]\n', r'quaternion = \["i", "j", "k", "w"\]'),
    "inverse": (lambda r: r.inv().as_quat(scalar_first=True), 'quaternion = ["w", "i", "j", "k"]\n',
     "inverse = true"),
    "scalar last and not inverse": (lambda r: r.as_quat(),
     'quaternion = ["w", "i", "j", "k"]\ninverse = true\n',
     r'quaternion = \["k", "w", "i", "j"\], and write inverse = false'),
    "inverse vector": (lambda r: r.inv().as_rotvec(), 'rotation_vector_rad = ["w", "i", "j"]\n',
     "inverse = true"),
    "target turned by 90 deg": (lambda r: (r * Rotation.from_rotvec([0, 0, np.pi / 2])).as_quat(scalar_first=True),
     'quaternion = ["w", "i", "j", "k"]\n', "90 deg rms off .* by the same turn at all poses"),
    "rows of another order": (lambda r: Rotation.from_quat(r.as_quat()[::-1]).as_quat(scalar_first=True),
     'quaternion = ["w", "i", "j", "k"]\n', "check rows and machine"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["columns", "tracker"])
@pytest.mark.parametrize("mistake", MISTAKEN)
def test_orientations_of_another_order_or_sense_are_named(mistake, kind, tmp_path, rng):
    written, form, words = MISTAKEN[mistake]
    command = poses(rng)
    rotation, point = stand(command)
    turned = Rotation.identity()
    text = MAP
    if kind == "tracker":  # which stands elsewhere
        turned = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
        text = MAP.replace('"known"', '"free"')
    write(tmp_path / "p.csv", command, turned.apply(point), written(turned * rotation))
    (tmp_path / "m.toml").write_text(text + form)
    with pytest.raises(InputError, match=words):
        taken(tmp_path, kind)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_angles_of_the_inverse_rotation_are_refused(sense, tmp_path, rng):
    """Angles, too, may be those of the passive rotation; noise of .1 deg is none."""
    command = poses(rng)
    rotation, point = stand(command)
    error = Rotation.from_rotvec(np.radians(rng.normal(0.0, 0.06, (len(command), 3))))
    seen = error * rotation if sense > 0 else (error * rotation).inv()
    write(tmp_path / "p.csv", command, point, seen.as_euler("XYZ", degrees=True))
    columns = "\n".join(
        f'read_{n}_deg = "{c}"'
        for n, c in zip(("alpha", "beta", "gamma"), "wij", strict=True)
    )
    text = MAP.replace("\n[orientation]\n", columns).replace('"known"', '"free"')
    (tmp_path / "m.toml").write_text(text)
    if sense > 0:
        taken(tmp_path, "tracker")
        return
    with pytest.raises(InputError, match="angles of the inverse rotations"):
        taken(tmp_path, "tracker")


LASER = """\
machine = "prs_spindle"
instrument = "laser_ball_bar"

[settings]
at_x_mm = 0
at_y_mm = -700
at_z_mm = 100

[columns]
z_mm = "z"
alpha_deg = "alpha"
beta_deg = "beta"
read_x_mm = "X"
read_y_mm = "Y"
read_z_mm = "Z"

[orientation]
direction = ["u", "v", "w"]
"""


def test_the_direction_of_a_laser_ball_bar(tmp_path):
    """From B to A, in any length; a row may lack it."""
    command = np.array([[0.2, 0.3, -0.2], [0.1, -0.4, 0.1], [0.3, 0.0, 0.0]])
    kinematics = Kinematics(prs_spindle.machine)
    x, _ = kinematics.inverse(command)
    _, point, _ = kinematics.frames(x, np.zeros(3))
    alpha, beta = command[:, 1], command[:, 2]
    n = [np.sin(beta), -np.sin(alpha) * np.cos(beta), np.cos(alpha) * np.cos(beta)]
    rows = np.column_stack(
        [1e3 * command[:, 0], np.degrees(command[:, 1:]), 1e3 * point]
    )
    lines = [
        ",".join(f"{v:.12f}" for v in [*r, *(100 * d)])
        for r, d in zip(rows, np.array(n).T, strict=True)
    ]
    lines[2] = ",".join([*lines[2].split(",")[:6], "", "", ""])
    (tmp_path / "p.csv").write_text("\n".join(["z,alpha,beta,X,Y,Z,u,v,w", *lines]))
    (tmp_path / "m.toml").write_text(LASER)
    study, imported = taken(tmp_path)
    assert any("as the direction of the tool axis" in s for s in imported.statements)
    assert imported.rows[2]["read_alpha_deg"] == ""
    found = [
        [float(r[f"read_{a}_deg"]) for a in ("alpha", "beta")]
        for r in imported.rows[:2]
    ]
    assert np.radians(found) == pytest.approx(command[:2, 1:], abs=1e-12)
    text = (tmp_path / "out" / "p.readings.csv").read_text()
    assert "# read_alpha_deg: angle about x" in text
    assert "from ball B to ball A" in text
    assert table_lines(text)[0].startswith("setup,run,order")
    assert oed.load_study(study).name == "p"


@pytest.mark.parametrize(("change", "words"), [
    (('["w", "i", "j", "k"]', '["i", "j", "k", "X"]'), "the order w, x, y, z"),
    (('["w", "i", "j", "k"]', '["w", "i", "j", "q"]'), "no such column"),
    (('quaternion = ["w", "i", "j", "k"]', ""), "one form is needed"),
    (("[orientation]\n", '[orientation]\ndirection = ["w", "i", "j"]\n'), "two forms"),
    (('"pose_tracker"', '"pose_tracker_position"'), "reads no orientation"),
    (("[orientation]\n", 'read_alpha_deg = "w"\n[orientation]\n'), "column of its own"),
])  # fmt: skip
def test_a_map_that_states_no_orientation_is_refused(change, words, tmp_path, rng):
    command = poses(rng)
    rotation, point = stand(command)
    write(tmp_path / "p.csv", command, point, rotation.as_quat(scalar_first=True))
    text = MAP + 'quaternion = ["w", "i", "j", "k"]\n'
    assert change[0] in text
    (tmp_path / "m.toml").write_text(text.replace(*change))
    with pytest.raises(InputError, match=words):
        taken(tmp_path)


#: mm, on the platform
NESTS = {"N1": [60.0, 0.0, 20.0], "N2": [-30.0, 50.0, 0.0], "N3": [-30.0, -50.0, 10.0]}
FRAME = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
SHIFT = np.array([3000.0, -500.0, 800.0])
NEST_MAP = """\
machine = "hexapod"
{instrument}
[targets]
N1 = [60, 0, 20]
N2 = [-30, 50, 0]
N3 = [-30, -50, 10]
[columns]
setup = "nest"
"""
WITH_ANGLES = NEST_MAP + '[orientation]\nquaternion = ["qw", "qx", "qy", "qz"]\n'
COMMANDS = "x_mm,y_mm,z_mm,rx_deg,ry_deg,spin_deg"


def seen(count: int = 12) -> list[tuple[np.ndarray, Rotation, str, np.ndarray]]:
    """Command (6,), mm and deg, attitude, nest and point as the tracker sees it, mm."""
    rng = np.random.default_rng(8)
    m = hexapod.machine
    low, high = np.array([(c.lower, c.upper) for c in m.command]).T
    command = rng.uniform(0.5 * low, 0.5 * high, (count, 6)) + 0.5 * m.home_command
    rows = []
    for c in command:
        tilt = Rotation.from_rotvec([c[3], c[4], 0.0]) * Rotation.from_euler("z", c[5])
        shown = np.r_[1e3 * c[:3], np.degrees(c[3:])]
        for name, place in NESTS.items():
            point = 1e3 * c[:3] + tilt.apply(place)
            rows.append((shown, FRAME * tilt, name, FRAME.apply(point) + SHIFT))
    return rows


def write_nests(folder: Path, *, angles: bool) -> Path:
    """The file; of every second pose, N1 has its orientation as well."""
    header = f"{COMMANDS},nest,X,Y,Z" + ",qw,qx,qy,qz" * angles
    lines = [header]
    for k, (command, attitude, name, point) in enumerate(seen()):
        cells = [*(f"{v:.9f}" for v in command), name, *(f"{v:.9f}" for v in point)]
        if angles:
            quaternion = attitude.as_quat(scalar_first=True)
            has = name == "N1" and (k // 3) % 2 == 0
            cells += [f"{v:.12f}" for v in quaternion] if has else [""] * 4
        lines.append(",".join(cells))
    path = folder / "nests.csv"
    path.write_text("\n".join(lines))
    return path


def imported(folder: Path, text: str, *, angles: bool = False) -> oed.Study:
    (folder / "m.toml").write_text(text)
    file = write_nests(folder, angles=angles)
    study, _ = import_files("tracker", [file], folder, column_map=folder / "m.toml")
    return oed.load_study(study)


def test_nests_share_the_frame_of_their_tracker(tmp_path):
    """Six unknowns, and not eighteen; exact points of an exact machine fit exactly."""
    study = imported(tmp_path, NEST_MAP.format(instrument=""))
    measurement = resolve(study, readings=()).measurement
    names = [n for n in measurement.names if "." in n]
    assert len(names) == 6
    assert {n.partition(".")[0] for n in names} == {"tracker"}
    readings = oed.read_readings(study).state.readings
    assert len(readings.y) == 3 * 36
    predicted = measurement.readings(readings.series, measurement.nominal)
    assert np.abs(predicted - readings.y).max() < 1e-8


def test_an_orientation_that_was_not_measured_stays_out(tmp_path):
    """No row is lost for it: 36 points, and 6 orientations of one nest."""
    text = WITH_ANGLES.format(instrument='instrument = "pose_tracker"')
    study = imported(tmp_path, text, angles=True)
    measurement = resolve(study, readings=()).measurement
    readings = oed.read_readings(study).state.readings
    assert len(readings.y) == 3 * 36 + 3 * 6
    assert len([n for n in measurement.names if "." in n]) == 6
    predicted = measurement.readings(readings.series, measurement.nominal)
    assert np.abs(predicted - readings.y).max() < 1e-8
    channels = {s.name: s.channels for s in study.setup}
    assert channels["N2"] == ["read_x", "read_y", "read_z"]


def test_a_nest_without_a_place_is_refused(tmp_path):
    text = NEST_MAP.format(instrument="").replace("N3 =", "N4 =")
    with pytest.raises(InputError, match=r"targets = N3|targets.*N3.*no such target"):
        imported(tmp_path, text)
