"""A closure made to move: forward and inverse kinematics, slopes, linear pose errors.

NO_TOOL            the reference tool
AssemblyError      a closure that cannot be satisfied: out of reach, or singular
InverseKinematics  the controller: commands to poses and joints
Kinematics         both directions of a machine, and their derivatives
pose_error         the exact twist error of a machine at joints
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.mechanism.inverse import AssemblyError, InverseKinematics
    from oed.mechanism.kinematics import Kinematics
    from oed.mechanism.pose_errors import NO_TOOL, pose_error
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
