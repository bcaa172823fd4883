"""Pose errors: where joints put a machine, against where it ought to be.

Exact ones, and linear ones with the joint corrections that null them.

A command asks for as many quantities as the machine has degrees of freedom (its
compensatable pose components). With X = dx/dq, A = dx/dp and C = d commanded/dx at the
nominal pose, Eqs. (22)-(25) of Tian et al. (2016) read

    dq_m = -(C X)^-1 C A dp,            remaining = (A - X (C X)^-1 C A) dp,

and C remaining = 0. The joints of a redundant machine are not determined by C X alone:
dq_m is the slope of those at which all its equations hold, as in `Kinematics.inverse`.
"""

import dataclasses

import numpy as np

from oed.base import Array
from oed.mechanism.kinematics import Kinematics

NO_TOOL: Array = np.zeros(3)  #: the reference tool


def pose_error(
    kinematics: Kinematics,
    command: Array,
    q: Array,
    truth: Array,
    tool: Array = NO_TOOL,
) -> Array:
    """Exact twist error (n, 6) [m, rad] of a machine sent to joints q (n, nq).

    The machine has parameters `truth` (np,) and ought to be at commands (n, n_dof). Of m
    machines it is (m, n, 6), with parameters (m, np), and joints of each (m, n, nq) or the
    same for all. Raises AssemblyError.
    """
    x, _ = kinematics.inverse(command, kinematics.machine.nominal, tool)
    wanted_rotation, wanted_point, _ = kinematics.frames(x, tool)
    reached = kinematics.forward(q, truth, x)
    rotation, point, _ = kinematics.frames(reached.reshape(-1, x.shape[1]), tool)
    shape = (*reached.shape[:-1], 3)
    return twist_between(
        wanted_rotation, wanted_point, rotation.reshape(*shape, 3), point.reshape(shape)
    )


def twist_between(
    rotation: Array, point: Array, other_rotation: Array, other_point: Array
) -> Array:
    """Displacement (..., 6) from frames (..., 3, 3), (..., 3) to others, base frame."""
    from scipy.spatial.transform import Rotation  # kinematics alone need none

    turn = other_rotation @ np.swapaxes(rotation, -1, -2)
    vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec()
    shift = other_point - point
    return np.concatenate([shift, vector.reshape(shift.shape)], axis=-1)


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """Linear pose error of a machine at n commands, as slopes over np parameters; SI."""

    command: Array  #: (n, n_dof)
    rotation: Array  #: (n, 3, 3) nominal orientation
    point: Array  #: (n, 3) nominal tool point
    #: (n, nq, np) compensating joint correction, dq_m = joints @ dp, Eq. (24)
    joints: Array
    #: (n, 6, np) twist error [tool point, rotation vector] without compensation
    raw: Array
    #: (n, 6, np) twist error with the compensatable components nulled, Eq. (25)
    remaining: Array

    @classmethod
    def of(
        cls,
        kinematics: Kinematics,
        command: Array,
        tool: Array = NO_TOOL,
        parameters: Array | None = None,
    ) -> "ErrorModel":
        """Error model at commands (n, n_dof), SI, about parameters (np,), nominal by
        default. Raises AssemblyError.
        """
        p = kinematics.machine.nominal if parameters is None else parameters
        x, q = kinematics.inverse(command, p, tool)
        by_joint = kinematics.slopes.pose_by_joint(x, q, p)
        by_parameter = kinematics.slopes.pose_by_parameter(x, q, p)
        joints = kinematics.joint_slopes(x, q, p, command, tool)
        rotation, point, twist = kinematics.frames(x, tool)
        return cls(
            command=command,
            rotation=rotation,
            point=point,
            joints=joints,
            raw=twist @ by_parameter,
            remaining=twist @ (by_parameter + by_joint @ joints),
        )
