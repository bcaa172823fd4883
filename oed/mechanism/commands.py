"""Commands at which a controller with the nominal model holds given poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from oed.base import Array, Index, Mask
from oed.mechanism import newton
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import machine_expressions
from oed.mechanism.inverse import PATH_STEPS, AssemblyError, listed
from oed.model import Machine

if TYPE_CHECKING:
    from oed.mechanism.kinematics import Kinematics

#: Gauss-Newton steps from a command to a corrected one: some five are needed
MAX_STEPS = 20
#: times that a step is halved which leads away from the target, at most
MAX_HALVINGS = 20
#: step that ends them, m or rad
STEP_TOLERANCE = 1e-12
#: how far a target may be off where the steps do not end, m or rad
TARGET_TOLERANCE = 1e-9


def corrected_commands(
    kinematics: Kinematics, command: Array, parameters: Array, tool: Array
) -> Array:
    """Commands (n, n_dof) that make a controller with the nominal model hold `command`.

    parameters  (np,) of the real machine, SI

    Where the machine is redundant, the joints that hold `command` belong to no command of
    the nominal model: poses, joints and command are sought together. Where a coordinate
    has no meaning (the direction of a tilt of zero), the command nearest to the given one
    is returned; joints have no such poses. Raises
    AssemblyError, also where no command is found.
    """
    nominal = kinematics.machine.nominal
    x, q = kinematics.inverse(command, nominal, tool)
    nx = x.shape[1]
    equations = _compensated_equations(kinematics.machine)
    longest = newton.longest_step(kinematics.machine.lever)

    def solve(z: Array, p: Array, rows: Index) -> tuple[Array, Mask]:
        def unmet(values: Array, entries: Index) -> list[Array]:
            return equations(values, p, command[rows[entries]], tool)

        return newton.solve(unmet, z, limited=2 * nx, longest=longest)

    z = np.hstack([x, x, q])
    start = z.copy()
    missed = np.ones(len(x), dtype=bool)
    for steps in (1, *PATH_STEPS):
        rows = np.flatnonzero(missed)
        followed, lost = start[rows], np.zeros(rows.size, dtype=bool)
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            p = nominal + share * (parameters - nominal)
            followed, failed = solve(followed, p, rows)
            lost |= failed
        z[rows], missed[rows] = followed, lost
    if missed.any():
        poses = np.flatnonzero(missed)
        raise AssemblyError(
            f"{kinematics.machine.name}: no command of the nominal model was found that"
            f" holds pose numbers {listed(poses)} at these parameters; give the"
            " controller the parameters, or corrections of its joints",
            poses,
        )
    return command_of_pose(kinematics, z[:, nx : 2 * nx], command, tool)


def _compensated_equations(machine: Machine) -> BatchedFunction:
    """Equations of a machine whose controller has the nominal model, and their slopes.

    Over the real pose, the pose that the controller means, and the joints: the machine
    settles, the controller's closure holds, and the real pose is what the command wants.
    Further inputs are real parameters, commands and tool.
    """
    e = machine_expressions(machine)
    believed = ca.SX.sym("believed", e.x.numel())
    nominal = ca.SX(ca.DM(machine.nominal))
    (controller,) = ca.substitute([e.phi], [e.x, e.p], [believed, nominal])
    pairs = zip(e.commanded, e.target, strict=True)
    off = [of_pose - of_command for of_pose, of_command in pairs]
    unmet = ca.vertcat(e.balance, controller, *off)
    z = ca.vertcat(e.x, believed, e.q)
    outputs = [unmet, ca.jacobian(unmet, z)]
    return BatchedFunction("compensated", [z, e.p, e.c, e.tool], outputs)


def command_of_pose(
    kinematics: Kinematics, pose: Array, start: Array, tool: Array
) -> Array:
    """Command (n, n_dof) whose target is that of poses (n, nx), by Gauss-Newton.

    Raises AssemblyError where no such command is found.
    """
    e = machine_expressions(kinematics.machine)
    target = ca.vertcat(*e.target)
    of_pose = BatchedFunction("of_pose", [e.x, e.tool], [ca.vertcat(*e.commanded)])
    of_command = BatchedFunction(
        "of_command", [e.c], [target, ca.jacobian(target, e.c)]
    )
    goal = of_pose(pose, tool)[0]
    command = np.array(start, dtype=float)
    value, jacobian = of_command(command)
    off = np.linalg.norm(goal - value, axis=1)
    for _ in range(MAX_STEPS):
        step = np.linalg.pinv(jacobian, rcond=1e-9) @ (goal - value)[:, :, None]
        share = np.ones((len(command), 1))
        # near a tilt of zero a whole step turns its direction too far
        for _ in range(MAX_HALVINGS):
            value, jacobian = of_command(command + share * step[:, :, 0])
            remaining = np.linalg.norm(goal - value, axis=1)
            worse = remaining > off + STEP_TOLERANCE
            if not worse.any():
                break
            share[worse] /= 2.0
        command += share * step[:, :, 0]
        off = remaining
        if np.abs(step).max() < STEP_TOLERANCE:
            break
    # not the last step: a coordinate that has no meaning may go on turning at the target
    poses = np.flatnonzero(off > TARGET_TOLERANCE)
    if poses.size:
        raise AssemblyError(
            f"{kinematics.machine.name}: no command was found whose target is that of"
            f" pose numbers {listed(poses)}",
            poses,
        )
    return command
