"""Exact pose errors of a compensated machine, for draws of its parameters.

The machine is driven with the identified parameters and has those of a draw. First
order maps (`oed.accuracy.maps`) miss the squares of what remains: millimetres of joint
error at ten milliradians leave ten micrometres.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from oed.base.arrays import Array
from oed.mechanism.kinematics import AssemblyError, Kinematics
from oed.mechanism.nearby_poses import NearbyPoses
from oed.mechanism.pose_errors import NO_TOOL


def compensated_errors(
    kinematics: Kinematics,
    command: Array,
    identified: Array,
    parameters: Array,
    tool: Array = NO_TOOL,
) -> Array:
    """Errors (m, n, k) of pose components at commands (n, n_dof), zeroed at home; SI.

    identified  (np,) parameters of the compensation
    parameters  (m, np) of the machine, near the identified ones

    Place is zeroed in the base frame, orientation in the platform's axes. Raises
    AssemblyError.
    """
    poses = np.vstack([command, kinematics.machine.home_command])
    wanted_x, _ = kinematics.inverse(poses, kinematics.machine.nominal, tool)
    rotation, point, _ = kinematics.frames(wanted_x, tool)
    true_rotation, true_point = _frames(kinematics, poses, identified, parameters, tool)
    place = true_point - point
    turned = true_rotation[:, :-1] @ np.swapaxes(true_rotation[:, -1:], 2, 3)
    turned = turned @ rotation[-1] @ np.swapaxes(rotation[:-1], 1, 2)
    turns = Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec()
    shift = (place[:, :-1] - place[:, -1:]).reshape(-1, 3)
    commands = np.tile(command, (len(parameters), 1))
    components = kinematics.error_components(commands, np.hstack([shift, turns]))
    return components.reshape(len(parameters), len(command), -1)


def _frames(
    kinematics: Kinematics,
    poses: Array,
    identified: Array,
    parameters: Array,
    tool: Array,
) -> tuple[Array, Array]:
    """Rotations (m, n, 3, 3) and points (m, n, 3) where the machine really stands."""
    x, q = kinematics.inverse(poses, identified, tool)
    reached = NearbyPoses(kinematics, q, identified, x).solve(parameters)
    failed = np.isnan(reached).any(axis=2)
    if failed.any():
        raise AssemblyError(
            f"{kinematics.machine.name}: a draw of the parameters cannot be assembled",
            np.flatnonzero(failed.any(axis=0)),
        )
    rotation, point, _ = kinematics.frames(reached.reshape(-1, reached.shape[2]), tool)
    shape = reached.shape[:2]
    return rotation.reshape(*shape, 3, 3), point.reshape(*shape, 3)
