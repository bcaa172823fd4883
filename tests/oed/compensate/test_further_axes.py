"""Offsets for additional axes against heads and gantries of the oracles."""

import numpy as np
import pytest
from oracles import a3_geometry as a3
from scipy.spatial.transform import Rotation
from shipped_models import a3_head, planar_2dof

from kernel.cases import CASES
from oed.compensate.further import TURN, FurtherAxes, compensated_joints
from oed.mechanism import Kinematics

A3 = Kinematics(a3_head.machine)
TRUTH = a3.errors(*(a3.TABLE3[k] for k in ("dq", "db", "da0", "beta")))


@pytest.fixture(scope="module")
def command() -> np.ndarray:
    commands = CASES["a3_head"].commands(np.random.default_rng(2), 20)
    return commands[commands[:, 2] > np.deg2rad(2.0)]


def test_offsets_are_what_the_oracles_head_is_off(command):
    """Along x and y at the tool, and by the rotation about the tool axis."""
    further = FurtherAxes.of(A3)
    assert [axis.name for axis in further.axes][-1] == TURN
    assert len(further) == 3
    joints = compensated_joints(A3, command, TRUTH)
    real = a3.forward(TRUTH, joints)
    point, rotation = a3.nominal_pose(*command.T)
    shift = (real.tip - point)[:, :2]
    turn = Rotation.from_matrix(real.R @ rotation.transpose(0, 2, 1)).as_rotvec()
    about = np.einsum("ni,ni->n", turn, rotation[:, :, 2])
    offsets = further.offsets(command, TRUTH)
    assert np.abs(offsets[:, :2]).max() > 1e-5
    assert offsets[:, :2] == pytest.approx(shift, abs=1e-9)
    assert offsets[:, 2] == pytest.approx(about, abs=1e-8)


def test_twists_of_offsets_have_these_offsets(command):
    further = FurtherAxes.of(A3)
    offsets = np.random.default_rng(4).standard_normal((len(command), 3))
    twists = further.twists(command, offsets)
    again = np.einsum("nmi,ni->nm", further.rows(command), twists)
    assert again == pytest.approx(offsets)


def test_a_machine_that_drives_all_has_none():
    further = FurtherAxes.of(Kinematics(planar_2dof.machine))
    assert len(further) == 0
    nominal = planar_2dof.machine.nominal
    assert further.offsets(np.array([[0.0, 0.5]]), nominal).shape == (1, 0)
