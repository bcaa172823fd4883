"""Compensation: what the controller must be told, and what it cannot correct.

A command asks for as many quantities as the machine has degrees of freedom (its
compensatable pose components). With X = dx/dq, A = dx/dp and C = d commanded/dx at the
nominal pose, Eqs. (22)-(25) of Tian et al. (2016) read

    dq_m = -(C X)^-1 C A dp,            remaining = (A - X (C X)^-1 C A) dp,

and C remaining = 0. `joints` does the same exactly: the inverse kinematics with the
identified parameters.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.kinematics import Kinematics

NO_TOOL = np.zeros(3)


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """Linear pose error of a machine at n commands, as slopes over its parameters.

    command    (n, n_dof) SI
    rotation   (n, 3, 3) nominal orientation;  point (n, 3) nominal tool point
    joints     (n, nq, np) compensating joint correction, dq_m = joints @ dp, Eq. (24)
    raw        (n, 6, np) twist error [tool point, rotation vector] without compensation
    remaining  (n, 6, np) twist error with the compensatable components nulled, Eq. (25)
    """

    command: Array
    rotation: Array
    point: Array
    joints: Array
    raw: Array
    remaining: Array


def error_model(
    kinematics: Kinematics, command: Array, tool: Array = NO_TOOL
) -> ErrorModel:
    """Error model at commands (n, n_dof), about the nominal machine."""
    p = kinematics.machine.nominal
    x, q = kinematics.inverse(command, p, tool)
    by_joint, by_parameter = (
        kinematics.joint_sensitivity(x, q, p),
        kinematics.parameter_sensitivity(x, q, p),
    )
    held = kinematics.commanded_jacobian(x, tool)
    joints = -np.linalg.pinv(held @ by_joint) @ (held @ by_parameter)
    rotation, point, twist = kinematics.frames(x, tool)
    return ErrorModel(
        command=command,
        rotation=rotation,
        point=point,
        joints=joints,
        raw=twist @ by_parameter,
        remaining=twist @ (by_parameter + by_joint @ joints),
    )


def compensated_joints(
    kinematics: Kinematics, command: Array, parameters: Array, tool: Array = NO_TOOL
) -> Array:
    """Joint values (n, nq) that hold the commands (n, n_dof) on a machine with these
    parameters (np,) or (n, np).
    """
    return kinematics.inverse(command, parameters, tool)[1]


def pose_error(
    kinematics: Kinematics,
    command: Array,
    q: Array,
    truth: Array,
    tool: Array = NO_TOOL,
) -> Array:
    """Exact twist error (n, 6) of a machine with parameters `truth` (np,) sent to
    joints q (n, nq).
    """
    x, _ = kinematics.inverse(command, kinematics.machine.nominal, tool)
    wanted_rotation, wanted_point, _ = kinematics.frames(x, tool)
    rotation, point, _ = kinematics.frames(kinematics.forward(q, truth, x), tool)
    return twist_between(wanted_rotation, wanted_point, rotation, point)


def twist_between(
    rotation: Array, point: Array, other_rotation: Array, other_point: Array
) -> Array:
    """Small displacement (n, 6) from one frame to another: point difference, rotation
    vector, base frame.
    """
    turn = other_rotation @ np.swapaxes(rotation, 1, 2)
    skew = 0.5 * np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(skew, axis=1, keepdims=True)
    angle = np.arctan2(sine, 0.5 * (np.trace(turn, axis1=1, axis2=2)[:, None] - 1.0))
    vector = skew * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-12)
    return np.hstack([other_point - point, vector])
