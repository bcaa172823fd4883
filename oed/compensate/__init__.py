"""Compensation: what a controller must be sent, and what stays uncorrected.

compensated_joints    joints that hold commands on a machine with other parameters
joint_corrections     what a controller with the nominal model adds to its joints
commands_of_added     commands that a nominal controller needs for such additions
joint_motion          motion of the driven components per unit of each joint
GridAxis              a command coordinate of a table
CommandGrid           a rectilinear grid of commands
InterpolationTable    values on a rectilinear grid
FurtherAxes           motions that would correct what the joints do not
interpolation_errors  pose errors that a table's interpolation adds
joint_errors          pose errors that rounded or missing numbers add
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.compensate.command_grid import (
        CommandGrid,
        GridAxis,
        InterpolationTable,
        joint_motion,
    )
    from oed.compensate.export_errors import interpolation_errors, joint_errors
    from oed.compensate.further import (
        FurtherAxes,
        commands_of_added,
        compensated_joints,
        joint_corrections,
    )
else:
    __getattr__ = door(__name__)
