"""`oed import` of any CSV: columns with factors and offsets, laser ball bars, by NumPy alone."""

from pathlib import Path

import numpy as np
import pytest
from oracles import planar_cables
from oracles import prs_geometry as oracle
from prs_sample import BASELINE, GIMBAL, poses

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, import_files, read_tables


def taken(
    folder: Path, name: str, column_map: str = "m.toml"
) -> tuple[Path, ImportedSession]:
    return import_files(
        "columns", [folder / name], folder, column_map=folder / column_map
    )


def test_columns_by_a_map_that_is_kept(tmp_path):
    (tmp_path / "a.csv").write_text(
        "# made by hand\nname|X set|Y set|Z set|touch|remark\n"
        "1|0|0|10|0,02|good\n2|50|0|10||\n3|0|50|10|-0,01|fine\n"
    )
    (tmp_path / "m.toml").write_text(
        'machine = "linear_delta"\ninstrument = "height_probe"\n[columns]\n'
        'x_mm = "X set"\ny_mm = "Y set"\nz_mm = "Z set"\nheight_mm = "touch"\n'
    )
    given = (tmp_path / "m.toml").read_text()
    (tmp_path / "typo.toml").write_text(given.replace("x_mm", "xx_mm"))
    with pytest.raises(
        InputError, match=r"columns\.xx_mm: no column of readings.*x_mm"
    ):
        taken(tmp_path, "a.csv", "typo.toml")
    study, imported = taken(tmp_path, "a.csv")
    assert "Not used: name, remark." in imported.statements
    assert [row["height_mm"] for row in imported.rows] == ["0.02", "", "-0.01"]
    readings = oed.read_readings(oed.load_study(study))
    np.testing.assert_allclose(readings.state.readings.y, [2e-5, -1e-5])


CABLES_MAP = """\
instrument = "redundancy"
[machine]
model = "cables_planar"
[machine.geometry]
anchor_mm = [[-1000, -800], [1000, -800], [1000, 800], [-1000, 800]]
tolerance_mm = 5
[noise]
gap1_um = 50
gap2_um = 50
[columns]
q1_mm = "A"
q2_mm = "B"
q3_mm = "C"
q4_mm = "D"
"""


def test_cable_lengths_alone_come_in(tmp_path, rng):
    """Recorded joints of a machine with two spare ones are its readings."""
    robot = planar_cables.drawn(rng)
    wanted = rng.uniform(-0.5, 0.5, (30, 2))
    noise = np.full(4, 1e-4)
    drums = 1e3 * planar_cables.recorded(robot, wanted, noise, rng)
    lines = [",".join(f"{v:.6f}" for v in row) for row in drums]
    (tmp_path / "l.csv").write_text("\n".join(["A,B,C,D", *lines]))
    (tmp_path / "m.toml").write_text(CABLES_MAP)
    (tmp_path / "n.csv").write_text((tmp_path / "l.csv").read_text())
    study, imported = taken(tmp_path, "l.csv")
    assert "The readings are 0: the machine's closure." in imported.statements
    loaded = oed.load_study(study)
    assert loaded.prediction.reference == "best_fit"
    after = oed.identify(oed.read_readings(loaded)).section.rms_after
    assert sorted(after) == ["gap1", "gap2"]
    assert max(after.values()) < 100.0  # um: half the drums' noise
    wrong = CABLES_MAP.replace("gap1_um", "gap_um")
    (tmp_path / "m.toml").write_text(wrong)
    with pytest.raises(InputError, match=r"noise\.gap_um.*gap1_mm"):
        taken(tmp_path, "n.csv")


def test_channels_that_were_not_read_are_left_out(tmp_path):
    """A camera that looks from above reads x and y; z is missing, not 0."""
    (tmp_path / "c.csv").write_text(
        "x_mm,y_mm,z_mm,read_x_mm,read_y_mm\n0,0,10,0.1,0.0\n50,0,10,50.1,0.1\n"
    )
    (tmp_path / "m.toml").write_text('machine = "linear_delta"\ninstrument = "camera"')
    study, imported = taken(tmp_path, "c.csv")
    assert "Not read: read_z; these channels count nothing." in imported.statements
    (setup,) = oed.load_study(study).setup
    assert setup.channels == ["read_x", "read_y"]
    readings = oed.read_readings(oed.load_study(study)).state.readings
    assert readings.y.size == 4


def test_contacts_alone_come_in(tmp_path):
    """Poses at which a probe stopped the machine need no column of readings."""
    (tmp_path / "p.csv").write_text("x_mm,y_mm,z_mm\n0,0,0.02\n50,0,0.01\n0,50,0.04\n")
    text = 'machine = "linear_delta"\ninstrument = "contact_probe"\n'
    (tmp_path / "m.toml").write_text(text)
    study, imported = taken(tmp_path, "p.csv")
    assert "The readings are 0: the poses are the measurement." in imported.statements
    loaded = oed.load_study(study)
    assert loaded.prediction.reference == "home"
    np.testing.assert_array_equal(oed.read_readings(loaded).state.readings.y, 0.0)


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


def study_of(file: Path) -> Path:
    """The study of a file with the map beside it."""
    folder = file.parent
    return import_files("columns", [file], folder, column_map=folder / "m.toml")[0]


def test_position_and_axis_from_two_balls(tmp_path):
    """As the paper's readings in Cartesian coordinates would be (sections 5.1, 5.2)."""
    values = seen()
    file = write(tmp_path / "lbb.csv", values)
    (tmp_path / "m.toml").write_text(MAP)
    study = study_of(file)
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
    study = study_of(file)
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
        study_of(file)


def test_a_place_beside_what_it_follows_from_is_refused(tmp_path):
    file = write(tmp_path / "lbb.csv", seen())
    (tmp_path / "m.toml").write_text(MAP)
    study = study_of(file)
    readings = tmp_path / "lbb.readings.csv"
    lines = readings.read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    lines[header] += ",read_x_mm"
    lines[header + 1 :] = [f"{line},1.0" for line in lines[header + 1 :]]
    readings.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"range_a is given as well"):
        oed.read_readings(oed.load_study(study))


@pytest.mark.parametrize("times", ["clock", "number"])
def test_a_table_with_the_newest_line_first_is_refused(times, tmp_path):
    cells = [f"10:0{k}:00" if times == "clock" else f"17000000{k}.25" for k in range(6)]
    lines = [f"{cell},{k}.5,{k * k}.5" for k, cell in enumerate(cells)]
    file = tmp_path / "t.csv"
    file.write_text("\n".join(["stamp,x,y", *lines]))
    assert len(read_tables([file])[0]) == 6
    file.write_text("\n".join(["stamp,x,y", *lines[::-1]]))
    with pytest.raises(InputError, match="the newest stands first"):
        read_tables([file])
    # a time that begins anew with each run is in order
    file.write_text("\n".join(["time,x,y", *lines, *lines]))
    assert len(read_tables([file])[0]) == 12
