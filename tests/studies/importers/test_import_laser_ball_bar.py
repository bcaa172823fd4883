"""R, theta and phi of a laser ball bar in column maps and readings files, by NumPy alone."""

from pathlib import Path

import numpy as np
import pytest
from oracles import prs_geometry as oracle
from prs_sample import BASELINE, GIMBAL, poses

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import import_files

MAP = """\
machine = "prs_spindle"
instrument = "laser_ball_bar"
[columns]
z_mm = "Z"
alpha_deg = "A"
beta_deg = "B"
"range_{a,b}_mm" = "R{1,2}"
"elevation_{a,b}_deg" = "theta{1,2}"
"azimuth_{a,b}_deg" = "phi{1,2}"
[settings]
at_x_mm = 0
at_y_mm = -700
at_z_mm = 100
baseline_mm = 100
"""
HEADER = "Z,A,B,R1,theta1,phi1,R2,theta2,phi2"


def seen() -> np.ndarray:
    """Commands (m, rad), then R, theta, phi of A and of B at the paper's 22 poses."""
    command = poses()
    tip, rotation, _ = oracle.nominal(*command.T)
    balls = [tip, tip - BASELINE * rotation[:, :, 2]]
    d = [ball - GIMBAL for ball in balls]
    polar = [
        np.column_stack(
            [
                np.linalg.norm(v, axis=1),
                np.arcsin(v[:, 2] / np.linalg.norm(v, axis=1)),
                np.arctan2(v[:, 1], v[:, 0]),
            ]
        )
        for v in d
    ]
    return np.column_stack([command, *polar])


def write(path: Path, values: np.ndarray) -> Path:
    shown = values * np.r_[1e3, [np.degrees(1)] * 2, [1e3, *[np.degrees(1)] * 2] * 2]
    rows = [",".join(f"{v:.10f}" for v in row) for row in shown]
    path.write_text("\n".join([HEADER, *rows]))
    return path


def taken(file: Path) -> Path:
    """The study of a file with the map beside it."""
    folder = file.parent
    return import_files("columns", [file], folder, column_map=folder / "m.toml")[0]


def test_position_and_axis_from_two_balls(tmp_path):
    """As the paper's readings in Cartesian coordinates would be (sections 5.1, 5.2)."""
    values = seen()
    file = write(tmp_path / "lbb.csv", values)
    (tmp_path / "m.toml").write_text(MAP)
    study = taken(file)
    readings = oed.read_readings(oed.load_study(study))
    tip, rotation, _ = oracle.nominal(*poses().T)
    wanted = oracle.laser_ball_bar(tip, rotation, GIMBAL, BASELINE)
    y = readings.state.readings.y.reshape(-1, 5)
    np.testing.assert_allclose(y, wanted, atol=1e-10)
    text = (tmp_path / "lbb.readings.csv").read_text()
    assert "range_a_mm" in text
    assert "read_x_mm" not in text.splitlines()[-23]


def test_ball_a_alone_is_a_position(tmp_path):
    file = write(tmp_path / "lbb.csv", seen())
    text = MAP.replace("{a,b}", "a").replace("{1,2}", "1")
    (tmp_path / "m.toml").write_text(text)
    study = taken(file)
    assert '"read_x"' in study.read_text()
    assert "read_alpha" not in study.read_text()
    readings = oed.read_readings(oed.load_study(study))
    tip = oracle.nominal(*poses().T)[0]
    np.testing.assert_allclose(
        readings.state.readings.y.reshape(-1, 3), tip, atol=1e-12
    )


@pytest.mark.parametrize(("old", "new", "reason"), [
    ('"range_{a,b}_mm"', '"range_{a,c}_mm"', r"columns\.range_c_mm: no column"),
    ("phi{1,2}", "psi{1,2}", r"azimuth_a_deg.*psi1.*no such column"),
    ('_deg" = "phi', '_mm" = "phi', r"columns\.azimuth_a_mm: no column"),
])  # fmt: skip
def test_words_that_are_none(old, new, reason, tmp_path):
    file = write(tmp_path / "lbb.csv", seen())
    (tmp_path / "m.toml").write_text(MAP.replace(old, new))
    with pytest.raises(InputError, match=reason):
        taken(file)


def test_a_place_beside_what_it_follows_from_is_refused(tmp_path):
    file = write(tmp_path / "lbb.csv", seen())
    (tmp_path / "m.toml").write_text(MAP)
    study = taken(file)
    readings = tmp_path / "lbb.readings.csv"
    lines = readings.read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    lines[header] += ",read_x_mm"
    lines[header + 1 :] = [f"{line},1.0" for line in lines[header + 1 :]]
    readings.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"range_a is given as well"):
        oed.read_readings(oed.load_study(study))
