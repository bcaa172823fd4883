"""Linear pose errors and joint corrections, Eqs. (22)-(25) of Tian et al. (2016).

A command asks for as many quantities as the machine has degrees of freedom (its
compensatable pose components). With X = dx/dq, A = dx/dp and C = d commanded/dx at the
nominal pose, Eqs. (22)-(25) of Tian et al. (2016) read

    dq_m = -(C X)^-1 C A dp,            remaining = (A - X (C X)^-1 C A) dp,

and C remaining = 0. The joints of a redundant machine are not determined by C X alone:
dq_m is the slope of those at which all its equations hold, as in `oed.compensate.exact`.
"""

from __future__ import annotations

import dataclasses

from oed.base import Array
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL


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
    kinematics: Kinematics,
    command: Array,
    tool: Array = NO_TOOL,
    parameters: Array | None = None,
) -> ErrorModel:
    """Error model at commands (n, n_dof), SI.

    parameters  (np,) of the machine about which it holds; nominal by default

    Raises AssemblyError for commands out of reach.
    """
    p = kinematics.machine.nominal if parameters is None else parameters
    x, q = kinematics.inverse(command, p, tool)
    by_joint = kinematics.slopes.over_joints(x, q, p)
    by_parameter = kinematics.slopes.over_parameters(x, q, p)
    joints = kinematics.joint_slopes(x, q, p, command, tool)
    rotation, point, twist = kinematics.frames(x, tool)
    return ErrorModel(
        command=command,
        rotation=rotation,
        point=point,
        joints=joints,
        raw=twist @ by_parameter,
        remaining=twist @ (by_parameter + by_joint @ joints),
    )
