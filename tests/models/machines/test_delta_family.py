"""Deltas of any size: readings against trilateration, the mode, refusals in studies."""

import dataclasses

import numpy as np
import pytest
from oracles import delta_trilateration
from sample import refused, resolved

from oed.mechanism import AssemblyError, Kinematics
from pkm_models.machines import delta, delta_printer, linear_delta
from pkm_studies.resolve import unreachable

STUDY = """\
schema = 1
name = "my_delta"

[machine]
model = "delta"
geometry = { radius_mm = 800, arm_mm = [2000, 2001, 2002], endstop_mm = 1500 }

[[setup]]
name = "probe"
instrument = "height_probe"
"""
SMALL = """\
schema = 1
name = "small_delta"

[machine]
model = "linear_delta"
workspace = { x_mm = [-40, 40], y_mm = [-40, 40], z_mm = [0, 100] }

[machine.nominal]
radius_mm = 60
arm1_mm = 130
arm2_mm = 130
arm3_mm = 130
endstop1_mm = 150
endstop2_mm = 150
endstop3_mm = 150

[[setup]]
name = "probe"
instrument = "height_probe"
"""


def test_deltas_hang_where_trilateration_puts_them(rng):
    machine = delta.build(
        {"arm": [0.3, 0.31, 0.32], "angle": np.deg2rad([200, 330, 95])}
    )
    value = {p.name: p.nominal for p in machine.parameters}
    arms, angles, endstops = (
        [value[f"{n}{i}"] for i in (1, 2, 3)] for n in ("arm", "angle", "endstop")
    )
    command = rng.uniform([-0.08, -0.08, 0.0], [0.08, 0.08, 0.3], (50, 3))
    _, q = Kinematics(machine).inverse(command)
    point = delta_trilateration.nozzle(q, value["radius1"], arms, angles, endstops)
    assert np.abs(point - command).max() < 1e-14


def test_an_upright_delta_is_the_one_with_a_common_radius(rng):
    drawn = linear_delta.machine
    common = delta.build({"endstop": linear_delta.ENDSTOP})
    command = rng.uniform([-0.1, -0.1, 0.0], [0.1, 0.1, 0.3], (30, 3))
    _, expected = Kinematics(drawn).inverse(command)
    _, q = Kinematics(common).inverse(command)
    assert np.abs(q - expected).max() < 1e-14


def test_a_study_describes_a_delta_by_its_geometry():
    machine = resolved(STUDY).machine
    nominal = {p.name: p.nominal for p in machine.parameters}
    assert nominal["radius3"] == 0.8
    assert [nominal[f"arm{i}"] for i in (1, 2, 3)] == pytest.approx([2.0, 2.001, 2.002])
    assert unreachable(Kinematics(machine)) is None


def test_another_size_by_nominal_hangs_below_its_carriages():
    machine = resolved(SMALL).machine
    x, q = Kinematics(machine).inverse(np.array([[0.0, 0.0, 0.02]]))
    above = 0.150 - q[0] + np.sqrt(0.130**2 - 0.060**2)
    assert above == pytest.approx(0.02 + np.sqrt(0.130**2 - 0.060**2))
    assert x[0] == pytest.approx([0.0, 0.0, 0.02])


def test_poses_of_the_workspace_out_of_reach_are_named():
    text = SMALL.replace("radius_mm = 60", "radius_mm = 110")
    sentence = unreachable(resolved(text).measurement.kinematics)
    assert sentence is not None
    assert "of 27 poses" in sentence
    assert "x = -40 mm" in sentence


@pytest.mark.parametrize(("old", "new", "said"), [
    ("radius_mm = 800", "radius_mm = 2100", "an arm is shorter than its radius"),
    ("radius_mm = 800", "radius_kg = 800", '"kg" is no unit for radius'),
    ("radius_mm = 800", "radius_mm = [800, 800]", "2 numbers, where 3 belong"),
    ("radius_mm = 800", "radius_mm = -800", "radius must be above 0"),
    ('"delta"', '"a3_head"', "a3_head has one geometry"),
])  # fmt: skip
def test_a_geometry_that_makes_no_delta_is_refused(old, new, said):
    assert said in str(refused(STUDY, (old, new)))


@pytest.mark.parametrize(("old", "new", "said"), [
    ("radius_mm = 60", "radius_mm = 160", "the home pose fails"),
    ("z_mm = [0, 100]", "z_mm = [50, 100]", "outside the workspace"),
    ("z_mm = [0, 100]", "z_mm = [50, 10]", "the range is empty"),
])  # fmt: skip
def test_numbers_of_another_machine_are_refused(old, new, said):
    assert said in str(refused(SMALL, (old, new)))


def test_a_guess_that_leads_below_is_followed_to_the_mode_of_home():
    """A start that suits one size alone: other sizes are reached through it."""

    def guess(c, p):  # type: ignore[no-untyped-def]
        return [c["x"], c["y"], c["z"]], [0.420 - c["z"]] * 3

    drawn = dataclasses.replace(linear_delta.machine, guess=guess)
    numbers = {"radius": 0.06, "arm": 0.13, "endstop": 0.15}
    other = drawn.with_parameters(
        [
            dataclasses.replace(p, nominal=numbers.get(p.name.rstrip("123"), p.nominal))
            for p in drawn.parameters
        ]
    )
    command = np.array([[0.0, 0.0, 0.02], [0.03, -0.02, 0.08]])
    _, q = Kinematics(other).inverse(command)
    exact = dataclasses.replace(other, guess=linear_delta.guess)
    assert q == pytest.approx(Kinematics(exact).inverse(command)[1], abs=1e-12)


def test_joints_past_a_singular_pose_are_refused():
    kinematics = Kinematics(delta.machine)
    with pytest.raises(AssemblyError, match=r"cannot be assembled|assembly mode"):
        kinematics.start_poses(np.array([[0.0, 0.9, 0.9]]))


def test_the_effector_is_level_in_the_middle_of_the_bed():
    """Whatever the towers' errors: tilts count from there."""
    kinematics = Kinematics(delta_printer.machine)
    names = [p.name for p in delta_printer.machine.parameters]
    p = np.array([p.nominal for p in delta_printer.machine.parameters])
    for name in ("angle1", "turn1", "turn2", "pair3"):
        p[names.index(name)] += 1e-3
    poses, _ = kinematics.inverse(np.zeros((1, 3)), p)
    assert np.abs(poses[0, 3:]).max() < 1e-12
