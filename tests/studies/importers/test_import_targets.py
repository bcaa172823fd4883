"""Several nests of one tracker: one frame, and orientations where they were measured."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shipped_models import hexapod

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from pkm_studies.resolve import resolve

#: mm, on the platform
NESTS = {"N1": [60.0, 0.0, 20.0], "N2": [-30.0, 50.0, 0.0], "N3": [-30.0, -50.0, 10.0]}
FRAME = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
SHIFT = np.array([3000.0, -500.0, 800.0])
MAP = """\
machine = "hexapod"
{instrument}
[targets]
N1 = [60, 0, 20]
N2 = [-30, 50, 0]
N3 = [-30, -50, 10]
[columns]
setup = "nest"
"""
WITH_ANGLES = MAP + '[orientation]\nquaternion = ["qw", "qx", "qy", "qz"]\n'
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


def write(folder: Path, *, angles: bool) -> Path:
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
    file = write(folder, angles=angles)
    study, _ = import_files("tracker", [file], folder, column_map=folder / "m.toml")
    return oed.load_study(study)


def test_nests_share_the_frame_of_their_tracker(tmp_path):
    """Six unknowns, and not eighteen; exact points of an exact machine fit exactly."""
    study = imported(tmp_path, MAP.format(instrument=""))
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
    text = MAP.format(instrument="").replace("N3 =", "N4 =")
    with pytest.raises(InputError, match=r"targets = N3|targets.*N3.*no such target"):
        imported(tmp_path, text)
