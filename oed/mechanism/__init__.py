"""A closure made to move: forward and inverse kinematics, slopes, pose errors.

AssemblyError        a closure that cannot be satisfied: out of reach, or singular
BatchedFunction      a CasADi function over many points at once
Controller           what a compensated controller holds of its machine
ErrorModel           linear pose errors of a machine at commands
Kinematics           both directions of a machine, and their derivatives
MachineFrame         what an instrument sees of a machine, in symbols
NO_TOOL              the reference tool
closest_closure      where a machine that does not assemble meets its equations best
generated_functions  the kinematics of a machine as C functions
pose_error           the exact twist error of a machine at joints
symbols              a symbolic vector of coordinates or parameters
twist_between        displacement from frames to others
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.mechanism.batch import BatchedFunction
    from oed.mechanism.c_code import generated_functions
    from oed.mechanism.expressions import MachineFrame, symbols
    from oed.mechanism.inverse import AssemblyError
    from oed.mechanism.kinematics import Controller, Kinematics
    from oed.mechanism.least_squares_closure import closest_closure
    from oed.mechanism.pose_errors import NO_TOOL, ErrorModel, pose_error, twist_between
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
