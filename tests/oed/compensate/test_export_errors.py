"""What a compensation file adds, on gantries of the oracle."""

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import planar_geometry
from scipy.interpolate import RegularGridInterpolator
from shipped_models import a3_head, planar_2dof

from oed.accuracy import driven_errors
from oed.compensate.command_grid import CommandGrid, GridAxis
from oed.compensate.export_errors import interpolation_errors, joint_errors
from oed.compensate.further import FurtherAxes
from oed.mechanism import Kinematics

PLANAR = Kinematics(planar_2dof.machine)
HOME = planar_2dof.machine.home_command
TRUTH = planar_geometry.NOMINAL + np.array([1e-3, -5e-4, 8e-4, 4e-4, -6e-4, 0.0, 0.0])
COMMAND = np.array([[0.4, 0.3], [-1.2, 1.1]])


@pytest.mark.parametrize("reference", ["absolute", "home"])
def test_rounded_joints_move_the_platform(reference):
    """Errors as large as the differences of the oracle's poses."""
    poses = np.vstack([COMMAND, HOME])
    rounded = np.round(planar_geometry.inverse(poses, TRUTH), 4)
    error = planar_geometry.forward(rounded, TRUTH) - poses
    expected = error[:-1] - (error[-1] if reference == "home" else 0.0)
    errors = joint_errors(PLANAR, COMMAND, rounded, TRUTH, reference)
    assert np.abs(expected).max() > 1e-5
    assert errors == pytest.approx(expected, abs=1e-9)


def test_what_no_joint_drives_is_known():
    nothing = driven_errors(PLANAR, COMMAND, TRUTH, "home", believed=TRUTH)
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
