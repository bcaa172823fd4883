"""Inverse and forward kinematics of a machine and their derivatives, from its closure.

A redundant machine has more equations than pose components: joints that disagree leave
no pose with phi = 0. It settles where the sum of squares of phi is least, as on equally
stiff legs: phi_x^T phi = 0. These equations take the place of phi, so that poses and
slopes are exact whatever the misfit. Where legs are not equally stiff, scale the rows
of the closure by their compliance.
"""

import copy
import dataclasses
import functools
from collections.abc import Callable

import casadi as ca
import numpy as np

from oed.base import Array, Index, Mask
from oed.mechanism import newton
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import MachineExpressions, strut_ends, twist_slope
from oed.mechanism.inverse import PATH_STEPS, AssemblyError, InverseKinematics, listed
from oed.mechanism.pose_slopes import PoseEquations
from oed.model import Machine

# Commands at which a controller with the nominal model holds given poses.

#: Gauss-Newton steps from a command to a corrected one: some five are needed
MAX_STEPS = 20
#: times that a step is halved which leads away from the target, at most
MAX_HALVINGS = 20
STEP_TOLERANCE = 1e-12  #: step that ends them, m or rad
#: how far a target may be off where the steps do not end, m or rad
TARGET_TOLERANCE = 1e-9


#: steps in which joints without a command are followed from the home pose
HOMING_STEPS = 20
FINER_HOMING_STEPS = 400  #: the same, where the first steps are too long

#: what is added (n, nq) to the joints at commands (n, n_dof) that mean poses (n, nx), SI
Corrections = Callable[[Array, Array], Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Controller:
    """A controller that an earlier calibration compensated."""

    parameters: Array  #: (np,) of its inverse kinematics, SI
    #: that it adds to these joints; None where it has no such table
    corrections: Corrections | None = None

    def corrected(self, command: Array, pose: Array, joints: Array) -> Array:
        """Joints (n, nq) to which it drives, from pose and joints of its parameters."""
        if self.corrections is None:
            return joints
        return np.asarray(joints + self.corrections(command, pose))


class Kinematics:
    """Numeric kinematics of one machine.

    Shapes: n poses, m parameter vectors, nx pose coordinates, nq joints, np parameters.
    """

    #: what the controller holds; None: nominal parameters
    controller: Controller | None = None

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        #: symbols and expressions of the machine
        self.expressions = e = MachineExpressions(machine)
        self._inverse = InverseKinematics(machine, e)
        #: the equations of a pose; as `slopes` for what they say of those
        self.equations = self.slopes = PoseEquations(machine, e)
        twist = ca.SX.sym("twist", 6)
        entries = [twist[i] for i in range(6)]
        components = ca.vertcat(*machine.read_error(e.c_by_name, entries))
        slope = ca.jacobian(components, twist)
        self._components = BatchedFunction("components", [e.c, twist], [components])
        self._components_slope = BatchedFunction("components_slope", [e.c], [slope])
        ends = strut_ends(machine, e)
        self._struts: BatchedFunction | None = None
        if ends is not None:
            self._struts = BatchedFunction("struts", [e.x, e.q, e.p], ends)
        self._lines = [
            BatchedFunction(f"line{i}", [e.x, e.q, e.p], [line])
            for i, line in enumerate(e.lines)
        ]

    def with_priors_of(self, machine: Machine) -> "Kinematics":
        """The same for other tolerances and bounds. Raises ValueError for more."""
        same = machine.closure is self.machine.closure
        if not same or not np.array_equal(machine.nominal, self.machine.nominal):
            raise ValueError(f"{machine.name} has another geometry")
        shared = copy.copy(self)
        shared.machine = machine
        return shared

    def with_controller(self, controller: Controller | None) -> "Kinematics":
        """The same machine under a controller; None: one with nominal parameters."""
        shared = copy.copy(self)
        shared.controller = controller
        return shared

    @property
    def held(self) -> Array:
        """Parameters (np,) of the controller, SI."""
        controller = self.controller
        return self.machine.nominal if controller is None else controller.parameters

    @functools.cached_property
    def _frame(self) -> BatchedFunction:
        e = self.expressions
        frame = [e.rotation, e.tip, twist_slope(e.rotation, e.tip, e.x)]
        return BatchedFunction("frame", [e.x, e.tool], frame)

    # -- the controller ----------------------------------------------------------------
    def inverse(
        self, command: Array, p: Array | None = None, tool: Array | None = None
    ) -> tuple[Array, Array]:
        """Pose (n, nx) and joints (n, nq) that hold the command (n, n_dof).

        p     (np,) or (n, np) parameters of the controller; nominal by default
        tool  (3,) tool point relative to the reference tool's, m

        Raises AssemblyError, with the poses out of reach.
        """
        command = np.atleast_2d(np.asarray(command, dtype=float))
        parameters = self.machine.nominal if p is None else p
        tool = np.zeros(3) if tool is None else np.asarray(tool, dtype=float)
        return self._inverse.solve(command, parameters, tool)

    def joint_slopes(
        self, x: Array, q: Array, p: Array, command: Array, tool: Array
    ) -> Array:
        """Slopes (n, nq, np) over the parameters of what `inverse` returned, the joints."""
        return self._inverse.joint_slopes(x, q, p, command, tool)

    def corrected_commands(
        self, command: Array, parameters: Array, tool: Array | None = None
    ) -> Array:
        """Commands (n, n_dof) that make a controller with the nominal model hold `command`.

        parameters  (np,) of the real machine, SI

        Where the machine is redundant, the joints that hold `command` belong to no command of
        the nominal model: poses, joints and command are sought together. Where a coordinate
        has no meaning (the direction of a tilt of zero), the command nearest to the given one
        is returned; joints have no such poses. Raises
        AssemblyError, also where no command is found.
        """
        nominal = self.machine.nominal
        tool = np.zeros(3) if tool is None else tool
        x, q = self.inverse(command, nominal, tool)
        nx = x.shape[1]
        equations = _compensated_equations(self.machine, self.expressions)
        longest = newton.longest_step(self.machine.lever)

        def solve(z: Array, p: Array, rows: Index) -> tuple[Array, Mask]:
            def unmet(values: Array, entries: Index) -> list[Array]:
                return equations(values, p, command[rows[entries]], tool)

            return newton.solve(unmet, z, limited=2 * nx, longest=longest)

        z = np.hstack([x, x, q])
        start = z.copy()
        missed = np.ones(len(x), dtype=bool)
        for steps in (1, *PATH_STEPS):
            rows = np.flatnonzero(missed)
            followed = start[rows]
            lost = np.zeros(rows.size, dtype=bool)
            for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
                p = nominal + share * (parameters - nominal)
                followed, failed = solve(followed, p, rows)
                lost |= failed
            z[rows], missed[rows] = followed, lost
        if missed.any():
            poses = np.flatnonzero(missed)
            raise AssemblyError(
                f"{self.machine.name}: no command of the nominal model was found that"
                f" holds pose numbers {listed(poses)} at these parameters; give the"
                " controller the parameters, or corrections of its joints",
                poses,
            )
        return self.command_of_pose(z[:, nx : 2 * nx], command, tool)

    def command_of_pose(self, pose: Array, start: Array, tool: Array) -> Array:
        """Command (n, n_dof) whose target is that of poses (n, nx), by Gauss-Newton.

        Raises AssemblyError where no such command is found.
        """
        e = self.expressions
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
                f"{self.machine.name}: no command was found whose target is that of"
                f" pose numbers {listed(poses)}",
                poses,
            )
        return command

    @property
    def home_mode(self) -> Array:
        """Signs (2 + nq,) of the assembly mode, of home. Raises AssemblyError."""
        return self._inverse.home()[1]

    def sent(self, command: Array, tool: Array | None = None) -> tuple[Array, Array]:
        """Pose (n, nx) that the controller means by commands, and joints that it sends.

        The pose is that of its own parameters. Raises AssemblyError.
        """
        x, q = self.inverse(command, self.held, tool)
        if self.controller is not None:
            q = self.controller.corrected(np.atleast_2d(command), x, q)
        return x, q

    # -- the machine -------------------------------------------------------------------
    def forward(self, q: Array, p: Array, start: Array) -> Array:
        """Pose x with phi(x, q, p) = 0, from a start in the wanted assembly mode.

        q      (n, nq), or (m, n, nq): each vector's own
        p      (np,) or (m, np)
        start  (n, nx) or (m, n, nx)

        Returns (n, nx) or (m, n, nx). Raises AssemblyError.
        """
        x, failed = self.try_forward(q, p, start)
        if failed.any():
            poses = np.unique(np.argwhere(failed)[:, -1])
            raise AssemblyError(
                f"{self.machine.name}: {int(failed.sum())} of {failed.size} poses cannot"
                f" be assembled (pose numbers {listed(poses)}): the joints do not close"
                " at these parameters, or the pose is singular; check joint values and"
                " their unit, the parameters' size, and the distance to singular poses",
                poses,
            )
        return x

    def try_forward(
        self,
        q: Array,
        p: Array,
        start: Array,
        step_tolerance: float = newton.STEP_TOLERANCE,
        wanted: Mask | None = None,
    ) -> tuple[Array, Mask]:
        """As `forward`, with a mask (n,) or (m, n) of failed poses in place of an
        error; Newton stops after a step (m, rad) below `step_tolerance`. Not `wanted`
        (m, n) are failed.
        """
        q, vectors = np.atleast_2d(q), np.atleast_2d(p)
        arguments = (q, vectors, start, step_tolerance)
        x, failed = self.equations.solve_all(*arguments, wanted)
        return (x[0], failed[0]) if p.ndim == 1 else (x, failed)

    def forward_per_pose(self, q: Array, p: Array, start: Array) -> Array:
        """As `forward`, with one parameter vector a pose: p (n, np), result (n, nx)."""
        x, failed = self.equations.solve((start, q, p), newton.STEP_TOLERANCE)
        if failed.any():
            poses = np.flatnonzero(failed)
            raise AssemblyError(
                f"{self.machine.name}: pose numbers {listed(poses)} cannot be"
                " assembled with their changes; make the effects smaller, or keep away"
                " from singular poses",
                poses,
            )
        return x

    def struts(self, x: Array, q: Array, p: Array) -> tuple[Array, Array, Array]:
        """Ends of the struts at base and platform, each (n, nq, 3), m, and joint change.

        The last (n, nq) is the joint change that equals a strut longer by 1 m. Raises
        ValueError where the machine states no struts.
        """
        if self._struts is None:
            raise ValueError(
                f"machine {self.machine.name} does not state its struts: give Machine.struts"
            )
        base, platform, by_joint = self._struts(x, q, p)
        return base.swapaxes(1, 2), platform.swapaxes(1, 2), -1.0 / by_joint

    def start_poses(self, q: Array, *, patient: bool = True) -> Array:
        """Start poses (n, nx) for joints (n, nq) without a command.

        They are followed from the home pose in small steps, in finer ones where that
        fails and one is `patient`. Raises AssemblyError.
        """
        home_x, home_q = self.inverse(self.machine.home_command)
        try:
            return self._follow_joints(home_x, home_q, q, HOMING_STEPS)
        except AssemblyError:
            if not patient:
                raise
            return self._follow_joints(home_x, home_q, q, FINER_HOMING_STEPS)

    def _follow_joints(
        self, home_x: Array, home_q: Array, q: Array, steps: int
    ) -> Array:
        """Poses (n, nx) followed from home to joints q (n, nq). Raises AssemblyError."""
        p = self.machine.nominal
        x = np.broadcast_to(home_x, (q.shape[0], home_x.shape[1]))
        side = self.assembly_side(home_x, home_q, p)
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            joints = home_q + share * (q - home_q)
            x = self.forward(joints, p, x)
            crossed = np.flatnonzero(side * self.assembly_side(x, joints, p) < 0.0)
            if crossed.size:
                raise AssemblyError(
                    f"{self.machine.name}: pose numbers {listed(crossed)} change the"
                    " assembly mode on the way from the home pose; check joint values"
                    " and their unit, or give the commanded poses",
                    crossed,
                )
        return x

    def assembly_side(self, x: Array, q: Array, p: Array) -> Array:
        """Sign (n,) of det(phi_x), which differs between assembly modes on either side
        of a singularity; 0 for a redundant machine.
        """
        phi_x = self.slopes.closure_slopes(x, q, p)
        if phi_x.shape[1] != phi_x.shape[2]:
            return np.zeros(len(x))
        return np.asarray(np.linalg.slogdet(phi_x)[0])

    # -- tool frame and pose errors ----------------------------------------------------
    def frames(self, x: Array, tool: Array) -> tuple[Array, Array, Array]:
        """Rotation (n, 3, 3), tool point (n, 3), twist slope (n, 6, nx)."""
        rotation, tip, twist = self._frame(x, tool)
        return rotation, tip, twist

    def reference_tool_commands(self, command: Array, tool: Array) -> Array:
        """Commands (n, n_dof) of the reference tool at the poses of those of a tool (3,).

        A tool beside the axis moves with the platform's turn. Where one of the poses
        cannot be assembled, all are turned as home is.
        """
        if not np.any(tool):
            return command
        try:
            x, _ = self.inverse(command, None, tool)
        except AssemblyError:
            return self.machine.with_tool(command, -tool)
        from_point = self.frames(x, np.zeros(3))[1] - self.frames(x, tool)[1]
        moved = [
            self.machine.with_tool(c, d)
            for c, d in zip(command, from_point, strict=True)
        ]
        return np.array(moved)

    def error_components(self, command: Array, twist: Array) -> Array:
        """Pose error components (n, k) of twists (n, 6) [m, rad] at commands (n, n_dof)."""
        return self._components(command, twist)[0]

    def error_components_jacobian(self, command: Array) -> Array:
        """Linear map (n, k, 6) from twists to pose error components."""
        return self._components_slope(command)[0]

    def skeleton(self, x: Array, q: Array, p: Array) -> list[Array]:
        """Polylines (points, 3), m, of one pose (nx,) for a drawing."""
        point = (x[None], q[None], p[None])
        return [line(*point)[0][0].T for line in self._lines]


def _compensated_equations(machine: Machine, e: MachineExpressions) -> BatchedFunction:
    """Equations of a machine over its real pose, the pose that a controller of the
    nominal model means, and the joints, and their slopes; inputs are parameters,
    commands, tool.
    """
    believed = ca.SX.sym("believed", e.x.numel())
    nominal = ca.SX(ca.DM(machine.nominal))
    (controller,) = ca.substitute([e.phi], [e.x, e.p], [believed, nominal])
    unmet = ca.vertcat(e.balance, controller, e.unmet_command)
    z = ca.vertcat(e.x, believed, e.q)
    outputs = [unmet, ca.jacobian(unmet, z)]
    return BatchedFunction("compensated", [z, e.p, e.c, e.tool], outputs)
