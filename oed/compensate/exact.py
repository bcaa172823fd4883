"""Joints and commands through the closure, for an unchanged controller."""

from __future__ import annotations

import casadi as ca
import numpy as np

from oed.base.arrays import Array
from oed.base.text import quantity
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL
from oed.model.expressions import machine_expressions
from oed.model.machine import Machine

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
    return needed - modelled


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
    return command_of_pose(kinematics, reached, command, tool)


def command_of_pose(
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


def undriven_components(machine: Machine, remaining: Array) -> tuple[str, ...]:
    """A sentence on components without a drive, from their errors (n, k), SI.

    None for a machine that drives all its components.
    """
    largest = np.abs(remaining).max(axis=0)
    parts = [
        f"{component.name} {quantity(size, component.unit)}"
        for component, size in zip(machine.components, largest, strict=True)
        if not component.compensatable
    ]
    if not parts:
        return ()
    return (f"no joint drives these components, at most: {', '.join(parts)}",)
