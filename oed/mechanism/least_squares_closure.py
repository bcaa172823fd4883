"""How near a machine comes to assembled at a command, and which equations stay open.

Where Newton's method fails, least squares still leads somewhere: it minimises the
closure's equations together with those that hold the command. What remains of an
equation is by how much it cannot be met.
"""

import casadi as ca
import numpy as np
import scipy  # its parts load when first used

from oed.base import Array
from oed.mechanism.expressions import MachineExpressions
from oed.model import Expr, Machine
from oed.result import ClosestClosure, MachineShape

OPEN_SHARE = 1e-6  #: an equation is open above this share of the machine's lever
#: weight of the command against the closure: what remains shows in the closure
COMMAND_WEIGHT = 10.0


def closest_closure(machine: Machine, command: Array) -> ClosestClosure:
    """The machine at a command (n_dof,), SI, by least squares from its guess.

    What is no number in the guess, such as the root of a length too short, is 0 instead
    where the search begins, or the middle of its range.
    """
    e = MachineExpressions(machine)
    command = np.asarray(command, dtype=float)
    begin = ca.Function("start", [e.c, e.p, e.tool], list(e.start))
    start = begin(command, machine.nominal, np.zeros(3))
    z = np.concatenate([np.array(part).ravel() for part in start])
    guess = _shape(machine, e, z)
    ends = [(c.lower, c.upper) for c in (*machine.pose, *machine.joints)]
    middles = np.array([0.5 * (low + high) for low, high in ends])
    usable = np.where(np.isfinite(z), z, np.where(np.isfinite(middles), middles, 0.0))
    nearest = _shape(machine, e, _least_squares(machine, e, command, usable))
    met = np.abs(nearest.equations) <= OPEN_SHARE * machine.lever
    still_open = tuple(int(k) for k in np.flatnonzero(~met))
    joints = [_joints(machine, e, e.phi[k]) for k in range(e.phi.numel())]
    moving = [_joints(machine, e, line) for line in e.lines]
    return ClosestClosure(guess, nearest, tuple(joints), tuple(moving), still_open)


def _least_squares(
    machine: Machine, e: MachineExpressions, command: Array, start: Array
) -> Array:
    """Pose and joints (nx + nq,) at which closure and command are met best."""
    z = ca.vertcat(e.x, e.q)
    rows = ca.vertcat(e.phi, COMMAND_WEIGHT * e.unmet_command)
    rows = ca.substitute(
        rows, ca.vertcat(e.p, e.c, e.tool), [*machine.nominal, *command, 0.0, 0.0, 0.0]
    )
    value = ca.Function("rows", [z], [rows])
    slope = ca.Function("slope", [z], [ca.jacobian(rows, z)])
    solution = scipy.optimize.least_squares(
        lambda z: np.nan_to_num(np.array(value(z)).ravel(), nan=1e3),
        start,
        jac=lambda z: np.nan_to_num(np.array(slope(z))),
        x_scale="jac",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return np.asarray(solution.x)


def _shape(machine: Machine, e: MachineExpressions, z: Array) -> MachineShape:
    """The machine at pose and joints (nx + nq,)."""
    count = e.x.numel()

    def value(expression: Expr) -> Array:
        function = ca.Function("value", [e.x, e.q, e.p], [expression])
        return np.array(function(z[:count], z[count:], machine.nominal))

    by_name = e.x_by_name, e.q_by_name, e.p_by_name
    struts = [] if machine.struts is None else machine.struts(*by_name)
    rotation, point = machine.platform(e.x_by_name)
    ends = [value(ca.horzcat(*strut)).T for strut in struts]
    return MachineShape(
        equations=value(e.phi).ravel(),
        lines=tuple(value(line).T for line in e.lines),
        struts=np.array(ends).reshape(-1, 2, 3),
        tool=value(point).ravel(),
        axes=value(rotation),
    )


def _joints(
    machine: Machine, e: MachineExpressions, expression: Expr
) -> tuple[str, ...]:
    """Names of the joints on which an expression depends."""
    names = [c.name for c in machine.joints]
    return tuple(n for n in names if ca.depends_on(expression, e.q_by_name[n]))
