"""The exact compensator: joints through the closure, for an unchanged controller."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np

from oed.base.arrays import Array
from oed.compensate.setpoint import Conditions, Setpoint, undriven_components
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL, component_errors
from oed.model.expressions import machine_expressions

#: Gauss-Newton steps from a command to a corrected one, and the step that ends them
STEPS, STEP_TOLERANCE = 20, 1e-12


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
    return np.asarray(needed - modelled)


def corrected_commands(
    kinematics: Kinematics, command: Array, parameters: Array, tool: Array = NO_TOOL
) -> Array:
    """Commands (n, n_dof) that make a controller with the nominal model hold `command`.

    parameters  (np,) of the real machine, SI

    Where a coordinate has no meaning (the direction of a tilt of zero), the command
    nearest to the given one is returned; `oed.compensate.compensated_joints` has no
    such poses. Raises AssemblyError.
    """
    nominal = kinematics.machine.nominal
    start, _ = kinematics.inverse(command, nominal, tool)
    joints = compensated_joints(kinematics, command, parameters, tool)
    reached = kinematics.forward(joints, nominal, start)
    return _command_of_pose(kinematics, reached, command, tool)


def _command_of_pose(
    kinematics: Kinematics, pose: Array, start: Array, tool: Array
) -> Array:
    """Command (n, n_dof) whose target is that of poses (n, nx), by Gauss-Newton."""
    e = machine_expressions(kinematics.machine)
    target = ca.vertcat(*e.target)
    held = BatchedFunction("held", [e.x, e.tool], [ca.vertcat(*e.commanded)])
    wanted = BatchedFunction("wanted", [e.c], [target, ca.jacobian(target, e.c)])
    goal = held(pose, tool)[0]
    command = np.array(start, dtype=float)
    for _ in range(STEPS):
        value, slope = wanted(command)
        step = np.linalg.pinv(slope, rcond=1e-9) @ (goal - value)[:, :, None]
        command += step[:, :, 0]
        if np.abs(step).max() < STEP_TOLERANCE:
            break
    return command


@dataclasses.dataclass(frozen=True)
class ExactCompensator:
    """Adds joint offsets that leave nothing in the components that the joints drive.

    parameters  (np,) identified, SI
    """

    kinematics: Kinematics
    parameters: Array
    tool: Array = dataclasses.field(default_factory=lambda: NO_TOOL)

    def apply(self, setpoint: Setpoint, conditions: Conditions) -> Setpoint:
        """The setpoint with further joint offsets. Raises AssemblyError."""
        command, tool = setpoint.command, self.tool
        modelled = self.kinematics.inverse(command, setpoint.parameters, tool)[1]
        needed = compensated_joints(self.kinematics, command, self.parameters, tool)
        offset = setpoint.joint_offset + needed - modelled
        return dataclasses.replace(setpoint, joint_offset=offset)

    def remaining(self, command: Array) -> Array:
        """Errors (n, k) of the pose components that stay, SI. Raises AssemblyError."""
        joints = compensated_joints(
            self.kinematics, command, self.parameters, self.tool
        )
        return component_errors(
            self.kinematics, command, joints, self.parameters, self.tool
        )

    def limits(self, command: Array) -> tuple[str, ...]:
        """What stays uncorrected over commands (n, n_dof), in sentences."""
        machine = self.kinematics.machine
        return undriven_components(machine, self.remaining(command))
