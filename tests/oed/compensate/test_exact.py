"""Exact compensation, and what a file adds, on gantries of the oracle."""

import dataclasses

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import planar_cables, planar_geometry
from scipy.interpolate import RegularGridInterpolator
from shipped_models import a3_head, cables_planar, cables_spatial, planar_2dof

from oed.accuracy import driven_errors
from oed.compensate.command_grid import CommandGrid, GridAxis
from oed.compensate.export_errors import interpolation_errors, joint_errors
from oed.compensate.further import FurtherAxes, joint_corrections
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


HOME = planar_2dof.machine.home_command
TRUTH = planar_geometry.NOMINAL + np.array([1e-3, -5e-4, 8e-4, 4e-4, -6e-4, 0.0, 0.0])
TWO_COMMANDS = np.array([[0.4, 0.3], [-1.2, 1.1]])


@pytest.mark.parametrize("reference", ["absolute", "home"])
def test_rounded_joints_move_the_platform(reference):
    """Errors as large as the differences of the oracle's poses."""
    poses = np.vstack([TWO_COMMANDS, HOME])
    rounded = np.round(planar_geometry.inverse(poses, TRUTH), 4)
    error = planar_geometry.forward(rounded, TRUTH) - poses
    expected = error[:-1] - (error[-1] if reference == "home" else 0.0)
    errors = joint_errors(PLANAR, TWO_COMMANDS, rounded, TRUTH, reference)
    assert np.abs(expected).max() > 1e-5
    assert errors == pytest.approx(expected, abs=1e-9)


def test_what_no_joint_drives_is_known():
    nothing = driven_errors(PLANAR, TWO_COMMANDS, TRUTH, "home", believed=TRUTH)
    assert nothing == pytest.approx(0.0, abs=1e-12)
    kinematics = Kinematics(a3_head.machine)
    truth = a3.errors(*(a3.TABLE3[k] for k in ("dq", "db", "da0", "beta")))
    command = np.array([[a3.D + a3.C + 0.1, 0.7, 0.4]])
    errors = driven_errors(kinematics, command, truth, "absolute", believed=truth)[0]
    real = a3.forward(truth, kinematics.inverse(command, truth)[1])
    shift = (real.tip - a3.nominal_pose(*command.T)[0])[0]
    names = [c.name for c in a3_head.machine.components]
    driven = [c.compensatable for c in a3_head.machine.components]
    assert errors[driven] == pytest.approx(0.0, abs=1e-9)
    assert errors[[names.index("x"), names.index("y")]] == pytest.approx(
        shift[:2], abs=1e-9
    )


def test_a_coarse_table_leaves_the_errors_of_its_interpolation():
    """At the same random places, with corrections and poses by the oracle."""
    axes = (GridAxis("y", "m", -1.2, 1.2), GridAxis("z", "m", 0.0, 1.2))
    grid = CommandGrid(axes, (3, 2), np.zeros((1, 2)), False)
    axes, rng = FurtherAxes.of(PLANAR), np.random.default_rng(8)
    found = interpolation_errors(PLANAR, grid, TRUTH, "absolute", rng, axes)
    y, z = np.linspace(-1.2, 1.2, 3), np.linspace(0.0, 1.2, 2)
    nodes = np.stack(np.meshgrid(y, z, indexing="ij"), axis=-1)
    corrections = planar_geometry.inverse(nodes, TRUTH) - planar_geometry.inverse(nodes)
    rng = np.random.default_rng(8)
    places = rng.uniform([-1.2, 0.0], [1.2, 1.2], (len(found), 2))
    tabled = RegularGridInterpolator((y, z), corrections)(places)
    joints = planar_geometry.inverse(places) + tabled
    expected = planar_geometry.forward(joints, TRUTH) - places
    assert np.abs(expected).max() > 1e-5
    assert found == pytest.approx(expected, abs=1e-9)


def test_what_no_joint_of_the_head_makes_is_a_turn_and_two_shifts():
    axes = FurtherAxes.of(Kinematics(a3_head.machine)).axes
    assert [(a.name, a.unit, a.component) for a in axes] == [
        ("x", "m", "x"),
        ("y", "m", "y"),
        ("turn", "rad", "phi"),
    ]
    assert "about the tool axis" in axes[2].about
