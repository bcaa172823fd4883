"""Joints through the closure, for an unchanged controller."""

from oed.base import Array
from oed.mechanism import NO_TOOL, Kinematics


def compensated_joints(
    kinematics: Kinematics, command: Array, parameters: Array, tool: Array = NO_TOOL
) -> Array:
    """Joints (n, nq) that hold commands (n, n_dof) on a machine with these parameters.

    `parameters` are (np,) or (n, np), SI. Raises AssemblyError.
    """
    return kinematics.inverse(command, parameters, tool)[1]


def joint_corrections(
    kinematics: Kinematics, command: Array, parameters: Array
) -> Array:
    """What (n, nq) a controller with the nominal model adds to its joints, at commands.

    parameters  (np,) of the real machine, SI

    Raises AssemblyError.
    """
    needed = compensated_joints(kinematics, command, parameters)
    modelled = compensated_joints(kinematics, command, kinematics.machine.nominal)
    return needed - modelled


def commands_of_added(kinematics: Kinematics, command: Array, added: Array) -> Array:
    """Commands (n, n_dof) at which the nominal model has what is `added` (n, nq) to its joints.

    Raises AssemblyError.
    """
    nominal = kinematics.machine.nominal
    start, joints = kinematics.inverse(command)
    pose = kinematics.forward(joints + added, nominal, start)
    return kinematics.command_of_pose(pose, command, NO_TOOL)
