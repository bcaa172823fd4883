"""Exact compensation of the gantry against its closed form."""

import dataclasses

import numpy as np
import pytest
from oracles import planar_cables, planar_geometry
from shipped_models import a3_head, cables_planar, cables_spatial, planar_2dof

from oed.compensate.further import joint_corrections
from oed.mechanism import AssemblyError, Kinematics, pose_error

PLANAR = Kinematics(planar_2dof.machine)
COMMAND = np.array([[0.0, 0.0], [1.0, 0.5], [-1.3, 1.4]])


@pytest.fixture
def truth(rng: np.random.Generator) -> np.ndarray:
    machine = planar_2dof.machine
    sd = np.array([p.tolerance for p in machine.parameters])
    return machine.nominal + sd * rng.standard_normal(len(sd))


def test_corrections_join_those_of_a_nominal_controller(truth):
    nominal = planar_geometry.inverse(COMMAND)
    joints = nominal + joint_corrections(PLANAR, COMMAND, truth)
    assert planar_geometry.forward(joints, truth) == pytest.approx(COMMAND, abs=1e-10)


def test_a_redundant_machine_holds_the_command_by_the_corrected_one(rng):
    """Four cables for two coordinates: real joints belong to no nominal command."""
    kinematics = Kinematics(cables_planar.build({"anchor": planar_cables.ANCHORS}))
    machine = kinematics.machine
    robot = planar_cables.drawn(rng)
    far = dataclasses.replace(robot, zeros=10.0 * robot.zeros)
    truth = np.array([far.by_name()[p.name] for p in machine.parameters])
    command = rng.uniform(-0.4, 0.4, (5, 2))
    sent = kinematics.corrected_commands(command, truth)
    drawing = planar_cables.Robot(planar_cables.ANCHORS, np.zeros(4), np.zeros(4))
    held = [planar_cables.settled(far, drums) for drums in drawing.lengths(sent)]
    assert np.abs(sent - command).max() > 1e-2
    assert np.array(held) == pytest.approx(command, abs=2e-8)


def test_a_command_that_no_nominal_one_holds_is_refused():
    """Cables this far off turn a platform over on the way; the other poses are exact."""
    kinematics = Kinematics(cables_spatial.machine)
    machine, rng = kinematics.machine, np.random.default_rng(0)
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    share, place = rng.uniform(size=(2, 6, len(low)))
    command = 0.5 * share * (low + (high - low) * place - machine.home_command)
    command += machine.home_command
    tolerance = np.array([p.tolerance for p in machine.parameters])
    truth = machine.nominal + tolerance * rng.standard_normal(len(tolerance))
    with pytest.raises(AssemblyError, match="give the controller the parameters") as e:
        kinematics.corrected_commands(command, truth)
    held = np.delete(command, e.value.indices, axis=0)
    assert e.value.indices.tolist() == [1]
    joints = kinematics.inverse(kinematics.corrected_commands(held, truth))[1]
    twist = pose_error(kinematics, held, joints, truth)
    left = kinematics.error_components(held, twist)
    assert np.abs(left).max() < 1e-9


def test_a_command_near_a_tilt_of_zero_is_found():
    """A tilt of 0.3 deg, sought from an upright tool whose direction is any other."""
    kinematics = Kinematics(a3_head.machine)
    command = np.tile([1.2676, 1.3, 0.006], (36, 1))
    pose, _ = kinematics.inverse(command)
    turned = 1.3 + np.deg2rad(10.0 * np.arange(36) + 2.0)
    start = np.column_stack([command[:, 0], turned, np.zeros(36)])
    reached = kinematics.command_of_pose(pose, start, np.zeros(3))

    def axis(c: np.ndarray) -> np.ndarray:
        return np.column_stack([np.cos(c[:, 1]), np.sin(c[:, 1])]) * np.sin(c[:, 2:])

    assert reached[:, 0] == pytest.approx(command[:, 0], abs=1e-9)
    assert axis(reached) == pytest.approx(axis(command), abs=1e-9)
