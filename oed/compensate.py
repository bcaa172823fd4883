"""Compensation: the joints that a controller must be sent, and what stays uncorrected.

A command asks for as many quantities as the machine has degrees of freedom (its
compensatable pose components). With X = dx/dq, A = dx/dp and C = d commanded/dx at the
nominal pose, Eqs. (22)-(25) of Tian et al. (2016) read

    dq_m = -(C X)^-1 C A dp,            remaining = (A - X (C X)^-1 C A) dp,

and C remaining = 0. `compensated_joints` does the same exactly: it is the inverse
kinematics with the identified parameters.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from oed.arrays import Array
from oed.kinematics import Kinematics

#: the reference tool
NO_TOOL = np.zeros(3)


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """Linear pose error of a machine at n commands, as slopes over np parameters; SI.

    command    (n, n_dof)
    rotation   (n, 3, 3) nominal orientation
    point      (n, 3) nominal tool point
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
    """Error model at commands (n, n_dof), SI, about the nominal machine.

    Raises AssemblyError for commands out of reach.
    """
    p = kinematics.machine.nominal
    x, q = kinematics.inverse(command, p, tool)
    by_joint = kinematics.joint_sensitivity(x, q, p)
    by_parameter = kinematics.parameter_sensitivity(x, q, p)
    commanded = kinematics.commanded_jacobian(x, tool)
    inverse = np.linalg.pinv(commanded @ by_joint)
    joints = -inverse @ (commanded @ by_parameter)
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
    """Joints (n, nq) that hold commands (n, n_dof) on a machine with these parameters.

    `parameters` are (np,) or (n, np), SI. Raises AssemblyError.
    """
    return kinematics.inverse(command, parameters, tool)[1]


def pose_error(
    kinematics: Kinematics,
    command: Array,
    q: Array,
    truth: Array,
    tool: Array = NO_TOOL,
) -> Array:
    """Exact twist error (n, 6) [m, rad] of a machine sent to joints q (n, nq).

    The machine has parameters `truth` (np,) and ought to be at commands (n, n_dof).
    Raises AssemblyError.
    """
    x, _ = kinematics.inverse(command, kinematics.machine.nominal, tool)
    wanted_rotation, wanted_point, _ = kinematics.frames(x, tool)
    rotation, point, _ = kinematics.frames(kinematics.forward(q, truth, x), tool)
    return twist_between(wanted_rotation, wanted_point, rotation, point)


def twist_between(
    rotation: Array, point: Array, other_rotation: Array, other_point: Array
) -> Array:
    """Displacement (n, 6) from one frame to another: [points, rotation vector].

    Rotations (n, 3, 3), points (n, 3), all in the base frame.
    """
    turn = Rotation.from_matrix(other_rotation @ np.swapaxes(rotation, 1, 2))
    return np.hstack([other_point - point, turn.as_rotvec()])
