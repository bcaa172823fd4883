"""Compensation: Eqs. (19)-(25) through the oracle, and exactly on its machines."""

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import delta_trilateration as delta
from scipy.spatial.transform import Rotation
from shipped_models import a3_head, linear_delta

from kernel.cases import CASES
from oed import compensate
from oed.mechanism import ErrorModel, Kinematics, pose_error, twist_between

A3, DELTA = Kinematics(a3_head.machine), Kinematics(linear_delta.machine)
SPREAD = np.r_[np.full(21, 1e-3), np.full(3, 10e-3)]


def commands(rng: np.random.Generator, n: int) -> np.ndarray:
    c = CASES["a3_head"].commands(rng, n)
    return np.column_stack([c[:, :2], np.maximum(c[:, 2], np.deg2rad(1))])


def test_joint_corrections_are_eq_24_and_what_remains_is_eq_25(rng):
    command = commands(rng, 200)
    model = ErrorModel.of(A3, command)
    oracle = a3.compensator(*command.T)
    assert np.abs(model.joints - oracle.dq).max() < 1e-11 * np.abs(oracle.dq).max()
    left = A3.error_components_jacobian(command) @ model.remaining
    assert (
        np.abs(left[:, [0, 1, 5]] - oracle.dc).max() < 1e-11 * np.abs(oracle.dc).max()
    )
    assert np.abs(left[:, [2, 3, 4]]).max() < 1e-11 * np.abs(oracle.dc).max()
    assert np.abs(model.raw - a3.linear_model(*command.T)).max() < 1e-12
    tip, rotation = a3.nominal_pose(*command.T)
    assert np.abs(model.point - tip).max() < 1e-13
    assert np.abs(model.rotation - rotation).max() < 1e-13


def test_a_longer_tool_holds_its_own_point(rng):
    """z of the longer tool's point is held: the joints of Eq. (24) put no error there."""
    command, tool = commands(rng, 50) + np.array([0.1, 0, 0]), np.array([0, 0, 0.1])
    model = ErrorModel.of(A3, command, tool)
    assert np.abs(model.raw - a3.linear_model(*command.T, 0.1)).max() < 1e-12
    left = A3.error_components_jacobian(command) @ model.remaining
    assert np.abs(left[:, 2:5]).max() < 1e-11
    q = a3.inverse_nominal(*command.T, 0.1)
    by_joint = (
        a3.forward(np.zeros(24), q[:, None] + 1e-30j * np.eye(3), 0.1).tip.imag / 1e-30
    )
    z = model.raw[:, 2] + np.einsum("njk,njp->nkp", by_joint, model.joints)[:, 2]
    assert np.abs(z).max() < 1e-11


def test_a_known_machine_reaches_its_commands_exactly(rng):
    """Joints from the true parameters, sent to the oracle's machine: z, psi, theta as commanded."""
    command = commands(rng, 60)
    for p in SPREAD * rng.standard_normal((5, 24)):
        reached = a3.forward(p, compensate.compensated_joints(A3, command, p))
        psi, theta, _ = a3.euler(reached.R)
        assert np.abs(reached.tip[:, 2] - command[:, 0]).max() < 1e-13
        assert np.abs(np.angle(np.exp(1j * (psi - command[:, 1])))).max() < 1e-11
        assert np.abs(theta - command[:, 2]).max() < 1e-12
    machine = linear_delta.machine.nominal + 2e-3 * rng.standard_normal(10)
    point = CASES["linear_delta"].commands(rng, 60)
    q = compensate.compensated_joints(DELTA, point, machine)
    reached = delta.nozzle(q, machine[0], machine[1:4], machine[4:7], machine[7:])
    assert np.abs(reached - point).max() < 1e-13


def test_pose_errors_are_the_oracles(rng):
    command, p = commands(rng, 60), 3.0 * SPREAD * rng.standard_normal(24)
    q = a3.inverse_nominal(*command.T)
    tip, rotation = a3.nominal_pose(*command.T)
    real = a3.forward(p, q)
    turn = Rotation.from_matrix(real.R @ np.swapaxes(rotation, 1, 2)).as_rotvec()
    assert (
        np.abs(pose_error(A3, command, q, p) - np.hstack([real.tip - tip, turn])).max()
        < 1e-12
    )


@pytest.mark.parametrize("angle", [0.0, 1e-15, 1e-9, 1e-3, 0.1, 1.0, 3.0, np.pi - 1e-6])
def test_twists_of_finite_turns_are_scipys(rng, angle):
    axis = rng.standard_normal((20, 3))
    turn = Rotation.from_rotvec(
        angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    )
    start = Rotation.random(20, rng=rng)
    point = rng.standard_normal((20, 3))
    other = rng.standard_normal((20, 3))
    twist = twist_between(start.as_matrix(), point, (turn * start).as_matrix(), other)
    assert twist[:, :3] == pytest.approx(other - point)
    assert np.abs(twist[:, 3:] - turn.as_rotvec()).max() < (
        1e-14 if angle < 3 else 1e-8
    )
