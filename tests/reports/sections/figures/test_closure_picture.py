"""The picture of a machine that does not assemble, on the tutorial's planar robot.

With cranks of 200 mm and rods of 20 mm no limb spans the 250 mm between a motor, 350 mm
from the middle, and a plate joint, 100 mm from it: 30 mm are missing in each.
"""

from pathlib import Path

import numpy as np
import pytest
from shipped_models import cable_robot, hexapod, tripod_passive_leg

from oed.mechanism import closest_closure
from oed.model import Machine
from pkm_reports import style
from pkm_reports.sections import draw_closure
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.commands import main
from pkm_studies.user_code import Origin

MY_MACHINE = Path(__file__).parents[4] / "docs" / "tutorial" / "my_machine.py"
DRAWING = "BASE, PLATE, CRANK, ROD = 0.350, 0.100, 0.200, "
JOINTS = (("q1",), ("q2",), ("q3",))


def _file(folder: Path, rod: str) -> Path:
    text = MY_MACHINE.read_text(encoding="utf-8")
    assert f"{DRAWING}0.220" in text
    path = folder / "my.py"
    path.write_text(text.replace(f"{DRAWING}0.220", DRAWING + rod), encoding="utf-8")
    return path


def _machine(path: Path) -> Machine:
    machine = catalogue.machine(
        "my.py", Origin(path.parent), Location("x"), assembled=False
    )
    assert isinstance(machine, Machine)
    return machine


def test_rods_that_are_too_short_miss_by_their_shortage(tmp_path):
    machine = _machine(_file(tmp_path, "0.020"))
    closest = closest_closure(machine, machine.home_command)
    assert closest.still_open == (0, 1, 2)
    assert closest.joints == JOINTS
    assert closest.line_joints == (*JOINTS, ())  # three limbs, and the plate
    missed = np.abs(closest.nearest.equations)
    np.testing.assert_allclose(missed, 0.030, atol=1e-6)
    assert np.linalg.norm(closest.nearest.tool) < 1e-6
    crank = closest.nearest.lines[0][1] - closest.nearest.lines[0][0]
    assert np.linalg.norm(crank) == pytest.approx(0.200)


@pytest.mark.parametrize("module", [hexapod, cable_robot, tripod_passive_leg])
def test_a_sound_machine_closes(module):
    machine = module.machine  # type: ignore[attr-defined]
    closest = closest_closure(machine, machine.home_command)
    assert closest.still_open == ()
    assert closest.nearest.struts.shape == (len(machine.joints), 2, 3)


def test_the_command_draws_what_does_not_close(tmp_path, capsys):
    path, picture = _file(tmp_path, "0.020"), tmp_path / "home.svg"
    arguments = ["check", str(path), "--picture", str(picture)]
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert "does not close at its home pose: equation 1 (q1) by 0.03," in printed.out
    assert "the home pose does not assemble" in printed.err
    assert style.RED in picture.read_text(encoding="utf-8")
    assert main(arguments) == 2  # nothing is overwritten
    assert "it is not overwritten" in capsys.readouterr().err


def test_the_command_draws_a_sound_machine(tmp_path, capsys):
    path, picture = _file(tmp_path, "0.220"), tmp_path / "home.svg"
    assert main(["check", str(path), "--picture", str(picture)]) == 0
    printed = capsys.readouterr().out
    assert "home.svg: closes at its home pose" in printed
    assert "my_machine has 3 joints and 21 parameters" in printed
    assert style.RED not in picture.read_text(encoding="utf-8")


def test_a_study_whose_numbers_do_not_assemble_is_drawn(tmp_path, capsys):
    """A strut shorter than the way to its guide; the guess has no value there."""
    study = tmp_path / "tripod.study.toml"
    study.write_text(
        'schema = 1\nname = "tripod"\n[machine]\nmodel = "tripod_prs"\n'
        "[machine.geometry]\nstrut_mm = [120, 600, 600]\n"
        '[[setup]]\nname = "tracker"\ninstrument = "pose_tracker"\n',
        encoding="utf-8",
    )
    picture = tmp_path / "home.png"
    assert main(["check", str(study), "--picture", str(picture)]) == 2
    assert "equation 1 (q1) by 0.01" in capsys.readouterr().out
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_another_kind_of_picture_is_refused(tmp_path, capsys):
    arguments = ["check", "a3_ball_bar", "--picture", str(tmp_path / "home.bmp")]
    assert main(arguments) == 2
    assert ".png, .svg, .pdf" in capsys.readouterr().err


def test_amounts_stand_beside_their_bars(tmp_path):
    machine = _machine(_file(tmp_path, "0.020"))
    closest = closest_closure(machine, machine.home_command)
    with style.applied():
        figure = draw_closure(closest, "title", ["q1", "q2", "q3"])
    (bars,) = [axes for axes in figure.axes if axes.get_title(loc="left")]
    words = [text.get_text().strip() for text in bars.texts]
    assert words == ["0.2", "0.03"] * 3
    assert [label.get_text() for label in bars.get_yticklabels()] == [
        "1 (q1)",
        "2 (q2)",
        "3 (q3)",
    ]
