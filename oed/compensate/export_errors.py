"""Pose errors that a compensation file adds to those of exact compensation.

They come from printed digits, from what the controller's model cannot hold, and from
interpolation between the commands of a table. All are against a stated reference, like
the predicted accuracy that they join.
"""

import numpy as np

from oed.accuracy import Reference, components_against
from oed.base import Array
from oed.compensate import (
    FurtherAxes,
    InterpolationTable,
    compensated_joints,
    joint_corrections,
)
from oed.compensate.command_grid import CommandGrid
from oed.mechanism import Kinematics, pose_error

#: places in a table's box over which its interpolation error is averaged
N_POSITIONS = 1000


def joint_errors(
    kinematics: Kinematics,
    command: Array,
    joints: Array,
    parameters: Array,
    reference: Reference,
    further: FurtherAxes | None = None,
    offsets: Array | None = None,
) -> Array:
    """Errors (n, k) of the pose components at commands (n, n_dof), SI.

    joints      (n + 1, nq) to which the controller drives at the commands, then at home
    parameters  (np,) of the machine
    further     axes that take back `offsets` (n + 1, m), likewise; none by default

    They are on top of what exact compensation leaves. Raises AssemblyError.
    """
    machine = kinematics.machine
    home = machine.home_command[None]
    poses = np.vstack([command, home])
    exact = compensated_joints(kinematics, poses, parameters)
    twist = pose_error(kinematics, poses, joints, parameters)
    twist -= pose_error(kinematics, poses, exact, parameters)
    if further is not None and offsets is not None:
        missed = offsets - further.offsets(poses, parameters)
        twist -= further.twists(poses, missed)
    return components_against(kinematics, command, twist, reference)


def interpolation_errors(
    kinematics: Kinematics,
    grid: CommandGrid,
    parameters: Array,
    reference: Reference,
    rng: np.random.Generator,
    further: FurtherAxes,
) -> Array:
    """Errors (n, k), SI, at random places of a table of joint corrections and offsets,
    which a controller of the nominal model interpolates alike, at home too. Raises
    AssemblyError.
    """
    nominal = kinematics.machine.nominal
    nq = len(kinematics.machine.joints)
    values = [
        joint_corrections(kinematics, grid.commands, parameters),
        further.offsets(grid.commands, parameters),
    ]
    table = InterpolationTable(
        tuple(axis.name for axis in grid.axes),
        grid.knots,
        np.hstack(values).reshape(*grid.counts, -1),
        grid.turns,
    )
    low, high = np.array([axis.evaluated for axis in grid.axes]).T
    positions = rng.uniform(low, high, (N_POSITIONS, len(low)))
    home = kinematics.machine.home_command[None]
    joints_at_home = compensated_joints(kinematics, home, parameters)
    offsets_at_home = further.offsets(home, parameters)
    if all(axis.holds(p) for axis, p in zip(grid.axes, home[0], strict=True)):
        tabled = table.at(home)
        joints_at_home = compensated_joints(kinematics, home, nominal) + tabled[:, :nq]
        offsets_at_home = tabled[:, nq:]
    tabled = table.at(positions)
    joints = compensated_joints(kinematics, positions, nominal) + tabled[:, :nq]
    return joint_errors(
        kinematics,
        positions,
        np.vstack([joints, joints_at_home]),
        parameters,
        reference,
        further,
        np.vstack([tabled[:, nq:], offsets_at_home]),
    )
