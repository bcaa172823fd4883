"""CasADi expressions derived from a machine's closure: pose slopes, struts, misfit."""

import functools
from collections.abc import Sequence

import casadi as ca
import numpy as np

from oed.base import Array
from oed.instrument import Frame
from oed.model import Coordinate, Expr, Machine, Parameter, Values


def symbols(
    prefix: str, items: Sequence[Coordinate | Parameter]
) -> tuple[ca.SX, Values]:
    """Symbolic vector of coordinates or parameters, and its entries by name."""
    vector = ca.SX.sym(prefix, len(items))
    return vector, {item.name: vector[i] for i, item in enumerate(items)}


class MachineExpressions:
    """Symbols of a machine and the expressions of its closure and tool frame.

    x, q, p, c  pose, joints, parameters and command, vectors; `x_by_name` and so on are
                their entries by name
    tool        (3,) tool point relative to the reference tool's
    phi         closure, a vector
    rotation    (3, 3) of the tool in the base frame;  tip (3,): its point there
    commanded   quantities that the controller holds at pose x with this tool
    target      the same quantities at command c
    start       pose and joints from which Newton's method starts at c with this tool
    lines       (3, n) that the machine draws; none where it has no skeleton
    """

    def __init__(self, machine: Machine) -> None:
        self.x, self.x_by_name = symbols("x", machine.pose)
        self.q, self.q_by_name = symbols("q", machine.joints)
        self.p, self.p_by_name = symbols("p", machine.parameters)
        self.c, self.c_by_name = symbols("c", machine.command)
        self.tool = ca.SX.sym("tool", 3)
        by_name = self.x_by_name, self.q_by_name, self.p_by_name
        self.phi: Expr = ca.vertcat(*machine.closure(*by_name))
        self.rotation, origin = machine.platform(self.x_by_name)
        self.tip = origin + self.rotation @ self.tool
        self.commanded = machine.commanded(self.x_by_name, self.tip)
        self.target = machine.target(self.c_by_name)
        self.start = self._start(machine)
        drawn = machine.skeleton(*by_name) if machine.skeleton else []
        self.lines: list[Expr] = [ca.horzcat(*line) for line in drawn]

    @property
    def balance(self) -> Expr:
        """Equations that a pose obeys: phi, or phi_x^T phi for a redundant machine."""
        if self.phi.numel() == self.x.numel():
            return self.phi
        return ca.jacobian(self.phi, self.x).T @ self.phi

    @property
    def unmet_command(self) -> Expr:
        """What is held at pose x with this tool, less what command c asks for."""
        pairs = zip(self.commanded, self.target, strict=True)
        return ca.vertcat(*[held - wanted for held, wanted in pairs])

    def _start(self, machine: Machine) -> tuple[ca.SX, ca.SX]:
        """Start of pose and joints.

        The machine's is that of the reference tool, and far off for a long tool on a tilted
        platform. Coordinates that are held as commanded go back by what the tool adds.
        """
        start = machine.start(self.c_by_name, self.p_by_name)
        pose, joints = (ca.SX(ca.vertcat(*part)) for part in start)
        reference = ca.SX(self.c)
        for held, at_command in zip(self.commanded, self.target, strict=True):
            without = ca.substitute(ca.SX(held), self.tool, ca.SX.zeros(3))
            added = ca.SX(held) - without
            for k in range(self.c.numel()):
                if ca.is_equal(ca.SX(at_command), self.c[k]):
                    reference[k] -= ca.substitute(added, self.x, pose)
        return (
            ca.substitute(pose, self.c, reference),
            ca.substitute(joints, self.c, reference),
        )


def twist_slope(rotation: Expr, tip: Expr, x: Expr) -> Expr:
    """Slope (6, nx) of tool point and rotation vector: vee(dR/dx_j R^T), base frame."""
    columns = []
    for j in range(x.numel()):
        by_x = ca.reshape(ca.jacobian(ca.vec(rotation), x[j]), 3, 3)
        spin = by_x @ rotation.T
        columns.append(ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0]))
    return ca.vertcat(ca.jacobian(tip, x), ca.horzcat(*columns))


def strut_ends(machine: Machine, e: MachineExpressions) -> list[Expr] | None:
    """Struts' ends (3, nq) at base and platform, and slope (nq,) of each joint's row.

    The slope is over the joint, of the first row of the closure that holds it. None
    where the machine states no struts.
    """
    if machine.struts is None:
        return None
    ends = machine.struts(e.x_by_name, e.q_by_name, e.p_by_name)
    slopes = []
    for k in range(len(machine.joints)):
        rows = (e.phi[i] for i in range(e.phi.numel()))
        row = next(row for row in rows if ca.depends_on(row, e.q[k]))
        slopes.append(ca.jacobian(row, e.q[k]))
    base, platform = (ca.horzcat(*side) for side in zip(*ends, strict=True))
    return [base, platform, ca.vertcat(*slopes)]


def closure_misfit(phi: Expr, x: Expr) -> Expr | None:
    """Signed root mean square of a redundant machine's closure where it settles.

    None unless there is one equation more than unknowns. Then phi = g m^1/2 n where
    the machine settles. Here n is the unit vector with n^T phi_x = 0, from the signed
    minors of phi_x, m is the number of equations, and g the misfit.
    """
    rows = phi.numel()
    if rows != x.numel() + 1:
        return None
    phi_x = ca.jacobian(phi, x)
    minors = []
    for i in range(rows):
        others = [k for k in range(rows) if k != i]
        minors.append((-1) ** i * ca.det(phi_x[others, :]))
    normal = ca.vertcat(*minors)
    return ca.dot(normal, phi) / (ca.norm_2(normal) * np.sqrt(rows))


class MachineFrame(Frame):
    """What an instrument sees of a machine at a pose; what few ask for is derived then."""

    def __init__(
        self,
        machine: Machine,
        x: ca.SX,
        by_name: tuple[Values, Values, Values],
        tool: Expr,
    ) -> None:
        """Of a pose x, with a tool (3,); by_name: pose, joints and parameters."""
        self._machine, self._x, self._by_name = machine, x, by_name
        rotation, origin = machine.platform(by_name[0])
        super().__init__(rotation, origin + rotation @ tool)

    @functools.cached_property
    def passive(self) -> Values:  # type: ignore[override]
        joints = self._machine.passive(*self._by_name)
        return {joint.name: joint.value for joint in joints}

    @functools.cached_property
    def _phi(self) -> Expr:
        return ca.vertcat(*self._machine.closure(*self._by_name))

    @functools.cached_property
    def closure_misfit(self) -> Expr | None:  # type: ignore[override]
        return closure_misfit(self._phi, self._x)

    @functools.cached_property
    def null_space(self) -> Expr | None:  # type: ignore[override]
        if self._phi.numel() <= self._x.numel():
            return None
        slope = ca.jacobian(self._phi, self._x)
        return _null_space(slope, _home_null_space(self._machine))

    @functools.cached_property
    def closure_misfits(self) -> Expr | None:  # type: ignore[override]
        if self.null_space is None:
            return None
        return self.null_space.T @ self._phi / np.sqrt(self._phi.numel())


def _home_null_space(machine: Machine) -> Array:
    """Orthonormal null space (m, k) of the constraints at the start for home."""
    e = MachineExpressions(machine)
    start_values = ca.Function("start", [e.c, e.p, e.tool], list(e.start))(
        machine.home_command, machine.nominal, np.zeros(3)
    )
    slope = ca.Function("slope", [e.x, e.q, e.p], [ca.jacobian(e.phi, e.x)])
    vectors, _, _ = np.linalg.svd(np.array(slope(*start_values, machine.nominal)))
    return vectors[:, e.x.numel() :]


def _null_space(slope: Expr, reference: Array) -> Expr:
    """Orthonormal directions (m, k) across the columns of a slope (m, n).

    By Gram and Schmidt on the slope's columns, then on the reference's (m, k): smooth
    wherever no direction of the null space is square to all of the reference.
    """
    columns = [slope[:, j] for j in range(slope.shape[1])]
    columns += [ca.DM(column) for column in reference.T]
    unit: list[Expr] = []
    for column in columns:
        rest = column
        for direction in unit:
            rest = rest - ca.dot(direction, rest) * direction
        unit.append(rest / ca.norm_2(rest))
    return ca.horzcat(*unit[slope.shape[1] :])
