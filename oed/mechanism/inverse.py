"""Inverse kinematics: pose and joints at a command, in the machine's assembly mode.

Equations such as |A - B| = l have several solutions: a carriage above the platform or
below it, a platform over its legs or mirrored. They meet at singular poses alone, where
one of these changes its sign:

* det(phi_x), of the closure over the pose (direct singularity);
* det of closure and command over pose and joints (inverse singularity);
* the slope of a joint's equation over the joint, one a joint (a limb is stretched).

These signs are the mode. Newton's method starts at the machine's own start value. Where
it fails or ends in another mode, the solution is followed from the home pose, and the
home pose from that of the machine as drawn, in steps that keep the mode.
"""

import casadi as ca
import numpy as np

from oed.base import Array, Index, Mask
from oed.mechanism import newton
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import MachineExpressions
from oed.model import Machine

#: change of the slopes, over the largest, that is steady within Newton's last step
SLOPE_TOLERANCE = 1e-3
#: steps in which a solution is followed, first few, then more from where these end;
#: powers of two, of which shares are exact
PATH_STEPS = (8, 64, 512)
N_STARTS = 64  #: number of starts about the machine's own, for a home pose that fails
START_SPREAD = 1.0  #: how far they reach, over the lever and in radians
MAX_LISTED = 8  #: pose numbers that an error lists

OUT_OF_REACH = "out of reach or singular"
MIRRORED = (
    "the equations hold there in another (mirrored) assembly mode only, or past a"
    " singular pose"
)


class AssemblyError(RuntimeError):
    """The closure cannot be satisfied at some poses: out of reach, or singular.

    `indices` are the indices of these poses, flat. Of commanded ones, `first` is the
    command (n_dof,), SI, of the first, and `reason` why it fails.
    """

    def __init__(
        self, message: str, indices: Index, first: Array | None = None, reason: str = ""
    ) -> None:
        super().__init__(message)
        self.indices = indices
        self.first = first
        self.reason = reason


def listed(indices: Index) -> str:
    """Pose numbers for an error message, the first few."""
    numbers = ", ".join(str(i) for i in indices[:MAX_LISTED])
    return numbers + (" ..." if indices.size > MAX_LISTED else "")


class InverseKinematics:
    """The controller of one machine: commands to poses and joints.

    Shapes: n poses, nx pose coordinates, nq joints, np parameters.
    """

    def __init__(self, machine: Machine, e: MachineExpressions) -> None:
        self.machine = machine
        unmet = ca.vertcat(e.phi, e.unmet_command)
        slope = ca.jacobian(unmet, ca.vertcat(e.x, e.q))
        inputs = [e.x, e.q, e.p, e.c, e.tool]
        by_x, by_joint = ca.jacobian(e.phi, e.x), ca.vertcat(*joint_slopes(e))
        by_p = [ca.jacobian(unmet, e.p)]
        self._by_parameter = BatchedFunction("by_parameter", inputs, by_p)
        self._start = BatchedFunction("start", [e.c, e.p, e.tool], list(e.start))
        self._inverse = BatchedFunction("inverse", inputs, [unmet, slope])
        self._mode = BatchedFunction("mode", inputs, [by_x, slope, by_joint])
        self._home: tuple[Array, Array] | None = None

    def solve(self, command: Array, p: Array, tool: Array) -> tuple[Array, Array]:
        """Pose (n, nx), joints (n, nq) at commands, p (np,) or (n, np), a tool (3,).
        Raises AssemblyError, with the poses out of reach.
        """
        z = self._starts(command, p, tool)
        z, failed = self._newton(z, command, p, tool)
        home, mode = self._home_for(command, failed)
        mirrored = ~failed & _differ(self.modes(z, command, p, tool), mode)
        lost = np.flatnonzero(failed | mirrored)
        z[lost], reached = home, np.zeros(len(z))
        begin = self.machine.home_command, self.machine.nominal, np.zeros(3)
        for steps in PATH_STEPS:
            if not lost.size:
                break
            lost_command = command[lost]
            of_lost = _rows_of(p, lost)
            end = lost_command, of_lost, tool
            z[lost], reached[lost] = self._follow(
                (z[lost], reached[lost]), mode, begin, end, steps
            )
            done = reached[lost] == 1.0
            regular = self._has_slopes(z[lost], lost_command, of_lost, tool)
            again = lost[done & ~regular]
            z[again], reached[again] = home, 0.0
            lost = lost[~(done & regular)]
        if lost.size:
            reason = MIRRORED if mirrored[lost].any() else OUT_OF_REACH
            raise self._error(command, lost, reason)
        nx = len(self.machine.pose)
        return z[:, :nx], z[:, nx:]

    def _home_for(self, command: Array, failed: Mask) -> tuple[Array, Array]:
        """Home and its mode; where it fails as well, the error lists the poses."""
        try:
            return self.home()
        except AssemblyError:
            lost = np.flatnonzero(failed)
            if lost.size:
                raise self._error(command, lost, OUT_OF_REACH) from None
            raise

    def home(self) -> tuple[Array, Array]:
        """Home's pose and joints (nx + nq,), mode as drawn. Raises AssemblyError."""
        if self._home is None:
            self._home = self._assemble_home()
        return self._home

    def modes(self, z: Array, command: Array, p: Array, tool: Array) -> Array:
        """Signs (n, 2 + nq) of the mode; 0 where the machine does not define one."""
        nx = len(self.machine.pose)
        modes = np.zeros((len(z), 2 + len(self.machine.joints)))
        for rows in newton.blocks(len(z)):
            x, q = z[rows, :nx], z[rows, nx:]
            of_rows = _rows_of(p, rows), command[rows], _rows_of(tool, rows)
            by_x, slope, by_joint = self._mode(x, q, *of_rows)
            if by_x.shape[1] == by_x.shape[2]:
                modes[rows, 0] = _determinant_signs(by_x)
            modes[rows, 1] = _determinant_signs(slope)
            modes[rows, 2:] = np.sign(np.nan_to_num(by_joint))
        return modes

    # -- home --------------------------------------------------------------------------
    def _assemble_home(self) -> tuple[Array, Array]:
        machine = self.machine
        drawn = machine.drawn or machine
        tool = np.zeros(3)
        z, mode = self._drawn_home(drawn.home_command, drawn.nominal, tool)
        same = np.array_equal(drawn.nominal, machine.nominal)
        if same and np.array_equal(drawn.home_command, machine.home_command):
            return z, mode
        command, p = machine.home_command[None], machine.nominal
        direct, failed = self._newton(self._starts(command, p, tool), command, p, tool)
        solution: Array | None = direct[0]
        if (
            failed[0]
            or _differ_by_joints(self.modes(direct, command, p, tool), mode)[0]
        ):
            start = z, drawn.home_command, drawn.nominal
            solution = self._follow_from_drawn(start, command, p, tool, mode)
        if solution is None:
            solution = self._search_starts(command, p, tool, mode)
        if solution is None:
            reason = OUT_OF_REACH if failed[0] else MIRRORED
            raise self._error(command, np.array([0]), reason)
        return solution, self.modes(solution[None], command, p, tool)[0]

    def _drawn_home(self, command: Array, p: Array, tool: Array) -> tuple[Array, Array]:
        """Home of the machine as drawn, from its own start. Raises AssemblyError."""
        command = command[None]
        z, failed = self._newton(self._starts(command, p, tool), command, p, tool)
        if failed.any():
            raise self._error(command, np.array([0]), OUT_OF_REACH)
        return z[0], self.modes(z, command, p, tool)[0]

    def _follow_from_drawn(
        self,
        drawn: tuple[Array, Array, Array],
        command: Array,
        p: Array,
        tool: Array,
        mode: Array,
    ) -> Array | None:
        """Home, followed from that of the machine as drawn; None where the way ends."""
        z, drawn_command, drawn_p = drawn
        begin, end = (drawn_command, drawn_p, tool), (command, p, tool)
        followed = z[None]
        reached = np.zeros(1)
        for steps in PATH_STEPS:
            followed, reached = self._follow(
                (followed, reached), mode, begin, end, steps
            )
            if reached[0] == 1.0:
                return np.asarray(followed[0])
        return None

    def _search_starts(
        self, command: Array, p: Array, tool: Array, mode: Array
    ) -> Array | None:
        """The solution in this mode nearest to the machine's start, from several."""
        start = self._starts(command, p, tool)
        size = [_size(c.unit, self.machine.lever) for c in self.machine.pose]
        size += [_size(c.unit, self.machine.lever) for c in self.machine.joints]
        from scipy.stats import qmc  # takes a second to import

        sequence = qmc.Halton(len(size), scramble=False)
        cloud = 2.0 * sequence.random(N_STARTS) - 1.0
        z = start + START_SPREAD * np.array(size) * cloud
        commands = np.repeat(command, len(z), axis=0)
        z, failed = self._newton(z, commands, p, tool)
        z = z[~failed]
        if not len(z):
            return None
        wrong = _differ_by_joints(self.modes(z, commands[: len(z)], p, tool), mode)
        z = z[~wrong]
        if not len(z):
            return None
        distance = np.linalg.norm((z - start) / size, axis=1)
        return np.asarray(z[np.argmin(distance)])

    def joint_slopes(
        self, x: Array, q: Array, p: Array, command: Array, tool: Array
    ) -> Array:
        """See `Kinematics.joint_slopes`."""
        _, slope = self._inverse(x, q, p, command, tool)
        by_parameter = self._by_parameter(x, q, p, command, tool)[0]
        return -newton.solve_linear(slope, by_parameter)[:, x.shape[1] :]

    # -- paths -------------------------------------------------------------------------
    def _follow(
        self,
        begun: tuple[Array, Array],
        mode: Array,
        begin: tuple[Array, Array, Array],
        end: tuple[Array, Array, Array],
        steps: int,
    ) -> tuple[Array, Array]:
        """Follow solutions in steps that keep the mode, each as far as it goes.

        begun  solutions (n, nx + nq), and shares (n,) of the way at which they are
        begin  command, parameters and tool where each way begins
        end    where it ends, the command (n, n_dof)

        Returns the last solutions, and their shares: 1 of those that arrived.
        """
        z, reached = begun[0].copy(), begun[1].copy()
        rows = np.flatnonzero(reached < 1.0)
        while rows.size:
            share = (np.floor(reached[rows] * steps) + 1.0) / steps
            command, p, tool = (
                a + share[:, None] * (_rows_of(b, rows) - a)
                for a, b in zip(begin, end, strict=True)
            )
            next_z, failed = self._newton(z[rows], command, p, tool)
            next_z = np.where(np.isfinite(next_z), next_z, 0.0)
            assembled = ~failed & ~_differ(self.modes(next_z, command, p, tool), mode)
            z[rows[assembled]] = next_z[assembled]
            reached[rows[assembled]] = share[assembled]
            rows = rows[assembled & (share < 1.0)]
        return z, reached

    def _has_slopes(self, z: Array, command: Array, p: Array, tool: Array) -> Mask:
        """Whether the equations have slopes at solutions (n, nx + nq).

        A leg of no length has a direction from every side, and none there: the slopes
        then change over the last step that Newton's method may leave.
        """
        nx = len(self.machine.pose)
        x, q = z[:, :nx], z[:, nx:]
        _, slope = self._inverse(x, q, p, command, tool)
        _, near = self._inverse(x + newton.STEP_TOLERANCE, q, p, command, tool)
        change = np.abs(near - slope).max(axis=(1, 2))
        regular: Mask = change < SLOPE_TOLERANCE * np.abs(slope).max(axis=(1, 2))
        return regular

    # -- equations ---------------------------------------------------------------------
    def _starts(self, command: Array, p: Array, tool: Array) -> Array:
        return np.hstack(self._start(command, p, tool))

    def _newton(
        self, z: Array, command: Array, p: Array, tool: Array
    ) -> tuple[Array, Mask]:
        nx = len(self.machine.pose)

        def equations(values: Array, rows: Index) -> list[Array]:
            x, q = values[:, :nx], values[:, nx:]
            of_rows = _rows_of(p, rows), command[rows], _rows_of(tool, rows)
            return self._inverse(x, q, *of_rows)

        longest = newton.longest_step(self.machine.lever)
        return newton.solve(equations, z.copy(), limited=nx, longest=longest)

    def _error(self, command: Array, lost: Index, reason: str) -> AssemblyError:
        values = ", ".join(
            f"{coordinate.name} = {value:.6g} {coordinate.unit}"
            for coordinate, value in zip(
                self.machine.command, command[lost[0]], strict=True
            )
        )
        return AssemblyError(
            f"{self.machine.name}: {len(lost)} of {len(command)} commanded poses"
            f" cannot be assembled, the first at {values}: {reason}; move it into the"
            " workspace, check tool and unit, or, well inside, the machine's guess",
            lost,
            command[lost[0]],
            reason,
        )


def joint_slopes(e: MachineExpressions) -> list[ca.SX]:
    """Slope of each joint's own equation over the joint; 0 where it has several."""
    slopes = []
    for k in range(e.q.numel()):
        rows = [i for i in range(e.phi.numel()) if ca.depends_on(e.phi[i], e.q[k])]
        only = len(rows) == 1
        slopes.append(ca.jacobian(e.phi[rows[0]], e.q[k]) if only else ca.SX(0.0))
    return slopes


def _determinant_signs(matrices: Array) -> Array:
    """Signs (n,) of the determinants of (n, k, k); 0 where entries are not finite."""
    finite = np.isfinite(matrices).all(axis=(1, 2))
    signs = np.zeros(len(matrices))
    signs[finite] = np.linalg.slogdet(matrices[finite])[0]
    return signs


def _rows_of(p: Array, rows: Index) -> Array:
    """Parameters of the rows, from one vector for all or one a row."""
    return p if p.ndim == 1 else p[rows]


def _differ(modes: Array, mode: Array) -> Mask:
    """Mask (n,) of the modes (n, k) that contradict one mode (k,)."""
    return np.asarray(np.any(modes * mode < 0.0, axis=1))


def _differ_by_joints(modes: Array, mode: Array) -> Mask:
    """As `_differ`, det(phi_x) aside: it changes with the order of the limbs as well."""
    return _differ(modes[:, 1:], mode[1:])


def _size(unit: str, lever: float) -> float:
    return lever if unit == "m" else 1.0
