"""Labels of the drawing stand where their parameters act; plans state the joints."""

import dataclasses

import gap_fixture
import numpy as np
import pytest
from oracles import a3_geometry
from shipped_models import a3_head, delta, hexapod

from oed.mechanism import Kinematics
from pkm_reports.sections import machine_figures
from pkm_studies import describe
from pkm_studies import describe as drawing_labels
from pkm_studies.base import Silent
from pkm_studies.stages import RunState
from pkm_studies.stages.design.section import planned_readings
from pkm_studies.stages.readings import planned_series
from pkm_studies.study import Study


def _labels(machine: object) -> dict[str, tuple[str, np.ndarray]]:
    kinematics = Kinematics(machine)  # type: ignore[arg-type]
    x, q = kinematics.inverse(kinematics.machine.home_command)
    labels = drawing_labels.parameter_labels(kinematics, x[0], q[0])
    return {n: (lab.text, np.array(lab.at)) for lab in labels for n in lab.parameters}


def test_a_joint_s_errors_stand_at_the_joint():
    labels = _labels(a3_head.machine)
    angle = a3_head.PHI[2]
    base = a3_head.B * np.array([np.cos(angle), np.sin(angle), 0.0])
    assert labels["db2x"][1] == pytest.approx(base, abs=1e-5)
    home = a3_head.D  # height of the platform joints at home, m
    text, place = labels["da1y"]
    assert text == "da1x, y, z"
    assert place == pytest.approx([0.0, -a3_head.A, home], abs=1e-5)


def test_a_leg_s_errors_stand_in_the_middle_of_the_leg():
    labels = _labels(a3_head.machine)
    middle = [0.0, -(a3_head.A + a3_head.B) / 2.0, a3_head.D / 2.0]
    for name in ("dq1", "beta1"):
        assert labels[name][1] == pytest.approx(middle, abs=1e-5)
        assert labels[name][0] == "dq1 beta1"


def test_what_only_chooses_the_frame_has_no_label():
    labels = _labels(a3_head.machine)
    names = {p.name for p in a3_head.machine.parameters}
    assert set(labels) == names - set(a3_head.machine.frame)


@pytest.mark.parametrize("machine", [delta.machine, hexapod.machine])
def test_every_parameter_of_other_machines_has_a_place(machine):
    labels = _labels(machine)
    names = {p.name for p in machine.parameters}  # type: ignore[attr-defined]
    assert names - set(machine.frame) <= set(labels)  # type: ignore[attr-defined]


def test_planned_readings_state_the_joints_of_the_nominal_machine(tmp_path):
    """Against the lengths of the oracle, which shares no code with the kinematics."""
    state = RunState.start(Study.load(gap_fixture.written(tmp_path)), 3, Silent(), None)
    (series,) = planned_series(state)[:1]
    readings = planned_readings(state.measurement, [series])
    z, psi, theta = (
        np.array([reading.command[key] for reading in readings])
        for key in ("z_mm", "psi_deg", "theta_deg")
    )
    expected = a3_geometry.inverse_nominal(1e-3 * z, np.radians(psi), np.radians(theta))
    joints = [list(reading.joints.values()) for reading in readings]
    assert list(readings[0].joints) == ["q1_mm", "q2_mm", "q3_mm"]
    np.testing.assert_allclose(joints, 1e3 * expected, atol=1e-6)


def test_a_machine_without_a_skeleton_has_no_labels():
    """As most files of a user's own are at first."""
    assert _labels(dataclasses.replace(delta.machine, skeleton=None)) == {}


MIXED = """\
schema = 1
name = "mixed"

[machine]
model = "a3_head"

[[setup]]
name = "camera"
instrument = "camera_known_frame"

[[setup]]
name = "cup"
instrument = "ball_bar_free_cup"
length_mm = 300.0
at_x_mm = 0.0
at_y_mm = 0.0
at_z_mm = 1286.0

[[design.reference]]
name = "both"
setup = "camera"
z_mm = 1146.0
psi_deg = [0.0, 90.0]
theta_deg = 20.0

[[design.reference]]
name = "both"
setup = "cup"
z_mm = 1146.0
psi_deg = { from = 0.0, to = 360.0, count = 6, endpoint = false }
theta = "hold"
"""


def test_each_tool_point_has_its_own_far_end_or_none(tmp_path):
    """Set-ups with a cup and without one: no reading gets the bar of another."""
    path = tmp_path / "mixed.study.toml"
    path.write_text(MIXED, "utf-8")
    state = RunState.start(Study.load(path), None, Silent(), None)
    plan = state.resolved.reference_plans[0]
    measurement = state.resolved.measurement_with(plan.setups)
    drawn = describe.drawing(measurement, plan.series)
    assert drawn.reading_of == ["camera"] * 2 + ["cup"] * 6
    assert drawn.bars[:2] == [[], []]
    for bar, tip in zip(drawn.bars[2:], drawn.tool_points[2:], strict=True):
        assert bar == [[0.0, 0.0, 1.286], tip]
    shown = machine_figures.scene_of(drawn)
    for owner, tip, bar in zip(shown.setups, shown.tips, shown.bars, strict=True):
        assert len(bar) == (0 if owner == "camera" else 2)
        if owner == "cup":
            assert bar[1] == pytest.approx(tip)
