"""`oed import` of any CSV, against the oracles."""

from pathlib import Path

import numpy as np
import pytest
from oracles import planar_cables

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, import_files


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
