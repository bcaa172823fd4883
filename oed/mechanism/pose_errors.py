"""Exact pose errors: where joints put a machine, against where it ought to be."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from oed.base import Array
from oed.mechanism.kinematics import Kinematics

#: the reference tool
NO_TOOL = np.zeros(3)


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
    """Displacement (..., 6) from frames to others: [points, rotation vector].

    Rotations (..., 3, 3), points (..., 3), all in the base frame.
    """
    turn = other_rotation @ np.swapaxes(rotation, -1, -2)
    vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec()
    shift = other_point - point
    return np.concatenate([shift, vector.reshape(shift.shape)], axis=-1)


def component_errors(
    kinematics: Kinematics,
    command: Array,
    joints: Array,
    parameters: Array,
    tool: Array = NO_TOOL,
) -> Array:
    """Exact errors (n, k) of the machine's pose components, SI, as in `pose_error`."""
    twist = pose_error(kinematics, command, joints, parameters, tool)
    return kinematics.error_components(command, twist)
