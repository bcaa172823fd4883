"""Inverse and forward kinematics and their derivatives, derived from a machine's
closure.

With closure phi(x, q, p) = 0:

* the controller (inverse): given a command c and the parameters it believes in, find
  pose and joints with phi = 0 and commanded(x) = target(c);
* the machine (forward): given joints q and true parameters p, find x with phi = 0 by
  Newton's method;
* dx/dp = -phi_x^-1 phi_p and dx/dq = -phi_x^-1 phi_q at fixed joints (implicit function
  theorem).

A redundant machine has more equations than pose components: joints that disagree leave
no pose with phi = 0. It settles where the squares of the equations' misfits are least,
as it would on equally stiff legs: phi_x^T phi = 0. These are as many equations as
unknowns and take the place of phi above, so that poses and slopes are exact whatever
the misfit. Rows of a closure are to be scaled by what the legs yield where that
differs.

All of it runs over many poses and many parameter vectors at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from oed.arrays import Array, Index, Mask
from oed.batch import BatchedFunction
from oed.machine import Coordinate, Expr, Machine, Parameter, Values

#: Newton stops once a step (m, rad) is below this: convergence is quadratic, so the
#: next is at rounding level
STEP_TOLERANCE = 1e-8
MAX_ITERATIONS = 30
#: reciprocal condition number of phi_x (lengths over the lever) below which a pose
#: counts as singular
SINGULAR_BELOW = 1e-6
#: longest Newton step (m, rad): longer ones are shortened, so that the assembly mode of
#: the start is kept
MAX_STEP = 0.2


class AssemblyError(RuntimeError):
    """The closure could not be satisfied at some poses: out of reach, or singular.

    `indices` are the flat indices of the failing poses.
    """

    def __init__(self, message: str, indices: Index) -> None:
        super().__init__(message)
        self.indices = indices


def symbols(
    prefix: str, items: Sequence[Coordinate | Parameter]
) -> tuple[ca.SX, Values]:
    """A symbolic vector and its entries by name."""
    vector = ca.SX.sym(prefix, len(items))
    return vector, {item.name: vector[i] for i, item in enumerate(items)}


class Kinematics:
    """Numeric kinematics of one machine. Shapes: n poses, nx pose, nq joint, np
    parameter coordinates.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        x, xs = symbols("x", machine.pose)
        q, qs = symbols("q", machine.joints)
        p, ps = symbols("p", machine.parameters)
        c, cs = symbols("c", machine.command)
        tool = ca.SX.sym("tool", 3)
        phi = ca.vertcat(*machine.closure(xs, qs, ps))
        rotation, point = machine.platform(xs)
        tip = point + rotation @ tool
        wish = ca.vertcat(
            *[
                a - b
                for a, b in zip(
                    machine.commanded(xs, tip), machine.target(cs), strict=True
                )
            ]
        )
        phi_x = ca.jacobian(phi, x)
        settled = phi if phi.numel() == x.numel() else phi_x.T @ phi
        settled_x = ca.jacobian(settled, x)
        xq = ca.vertcat(x, q)
        both = ca.vertcat(phi, wish)
        guess_x, guess_q = machine.guess(cs)
        twist = _twist(rotation, tip, x)
        error = ca.SX.sym("error", 6)

        self._forward = BatchedFunction("forward", [x, q, p], [settled, settled_x])
        self._closure_slope = BatchedFunction("closure_slope", [x, q, p], [phi_x])
        self._inverse = BatchedFunction(
            "inverse", [x, q, p, c, tool], [both, ca.jacobian(both, xq)]
        )
        self._guess = BatchedFunction(
            "guess", [c], [ca.vertcat(*guess_x), ca.vertcat(*guess_q)]
        )
        self._slopes = BatchedFunction(
            "slopes",
            [x, q, p],
            [settled_x, ca.jacobian(settled, p), ca.jacobian(settled, q)],
        )
        self._held = BatchedFunction(
            "held", [x, tool], [ca.jacobian(ca.vertcat(*machine.commanded(xs, tip)), x)]
        )
        self._frame = BatchedFunction("frame", [x, tool], [rotation, tip, twist])
        components = ca.vertcat(*machine.read_error(cs, [error[i] for i in range(6)]))
        self._components = BatchedFunction("components", [c, error], [components])
        self._components_slope = BatchedFunction(
            "components_slope", [c], [ca.jacobian(components, error)]
        )
        self._home_sign: float | None = None
        self._struts = _struts(machine, (x, q, p), (xs, qs, ps), phi)
        self._skeleton = (
            None
            if machine.skeleton is None
            else [
                BatchedFunction(f"line{i}", [x, q, p], [ca.horzcat(*line)])
                for i, line in enumerate(machine.skeleton(xs, qs, ps))
            ]
        )

    # -- the controller ----------------------------------------------------------------

    def inverse(
        self, command: Array, p: Array | None = None, tool: Array | None = None
    ) -> tuple[Array, Array]:
        """Pose (n, nx) and joints (n, nq) at which a machine with parameters p holds
        the command (n, n_dof).

        `p` (np,) or (n, np) defaults to nominal. Raises AssemblyError naming the poses
        out of reach.
        """
        command = np.atleast_2d(np.asarray(command, dtype=float))
        p = self.machine.nominal if p is None else p
        tool = np.zeros(3) if tool is None else np.asarray(tool, dtype=float)
        x, q = self._guess(command)
        z, bad = _newton(
            lambda z, keep: self._inverse(
                z[:, : x.shape[1]],
                z[:, x.shape[1] :],
                _take(p, keep),
                command[keep],
                tool,
            ),
            np.hstack([x, q]),
            posed=x.shape[1],
        )
        x, q = z[:, : x.shape[1]], z[:, x.shape[1] :]
        if bad.any():
            raise AssemblyError(
                self._told(command, bad, "out of reach or singular"),
                np.flatnonzero(bad),
            )
        mirrored: Mask = np.less(self._side(x, q, p) * self._home_side(), 0.0)
        if mirrored.any():
            raise AssemblyError(
                self._told(command, mirrored, "in another assembly mode"),
                np.flatnonzero(mirrored),
            )
        return x, q

    def _side(self, x: Array, q: Array, p: Array) -> Array:
        """Sign of det(phi_x) (n,): assembly modes on either side of a singularity
        differ in it; 0 if redundant.
        """
        phi_x = self._closure_slope(x, q, p)[0]
        if phi_x.shape[1] != phi_x.shape[2]:
            return np.zeros(len(x))
        return np.asarray(np.linalg.slogdet(phi_x)[0])

    def _home_side(self) -> float:
        if self._home_sign is None:
            self._home_sign = 0.0  # the home pose itself is taken as it comes
            x, q = self.inverse(self.machine.home_command)
            self._home_sign = float(self._side(x, q, self.machine.nominal)[0])
        return self._home_sign

    # -- the machine -------------------------------------------------------------------

    def forward(self, q: Array, p: Array, start: Array) -> Array:
        """Pose x with phi(x, q, p) = 0, from a start in the wanted assembly mode.

        q (n, nq), p (np,) or (m, np), start (n, nx) or (m, n, nx); result (n, nx) or
        (m, n, nx). Raises AssemblyError where a pose cannot be assembled.
        """
        x, bad = self.try_forward(q, p, start)
        if bad.any():
            where = np.unique(np.argwhere(bad)[:, -1])
            shown = _listed(where)
            raise AssemblyError(
                f"{self.machine.name}: {int(bad.sum())} of {bad.size} poses cannot be"
                f" assembled (pose numbers {shown}): the joints do not close at these"
                " parameters, or the pose is singular; check joint values and their"
                " unit, the parameters' size, and the distance to singular poses",
                where,
            )
        return x

    def try_forward(
        self, q: Array, p: Array, start: Array, step: float = STEP_TOLERANCE
    ) -> tuple[Array, Mask]:
        """As `forward`, but tells failures as a mask (n,) or (m, n) instead of raising.

        Newton stops after a step (m, rad) shorter than `step`; the error left is about
        step^2 / lever.
        """
        q = np.atleast_2d(q)
        n, single = q.shape[0], p.ndim == 1
        draws = np.atleast_2d(p)
        m = draws.shape[0]
        wide_q = np.broadcast_to(q, (m, *q.shape)).reshape(m * n, -1)
        wide_p = np.repeat(draws, n, axis=0)
        wide_x = np.broadcast_to(start, (m, n, start.shape[-1])).reshape(m * n, -1)
        x, bad = _newton(
            lambda z, keep: self._forward(z, wide_q[keep], wide_p[keep]),
            wide_x.copy(),
            step,
        )
        return (x, bad) if single else (x.reshape(m, n, -1), bad.reshape(m, n))

    def forward_per_pose(self, q: Array, p: Array, start: Array) -> Array:
        """As `forward`, with parameters p (n, np) of its own for each pose; result (n,
        nx). Raises AssemblyError.
        """
        x, bad = _newton(
            lambda z, keep: self._forward(z, q[keep], p[keep]),
            np.array(start, dtype=float),
        )
        if bad.any():
            where = np.flatnonzero(bad)
            raise AssemblyError(
                f"{self.machine.name}: pose numbers {_listed(where)} cannot be"
                " assembled with their changes; make the effects smaller, or keep away"
                " from singular poses",
                where,
            )
        return x

    def struts(self, x: Array, q: Array, p: Array) -> tuple[Array, Array, Array]:
        """Ends (n, nq, 3) of the struts at base and platform, and change of joint (n,
        nq) per metre of strut.

        Raises ValueError for a machine that does not tell its struts.
        """
        if self._struts is None:
            raise ValueError(
                f"machine {self.machine.name} does not tell its struts: give"
                " Machine.struts"
            )
        base, platform, by_joint = self._struts(x, q, p)
        return base.swapaxes(1, 2), platform.swapaxes(1, 2), -1.0 / by_joint

    def start_poses(self, q: Array) -> Array:
        """Start poses (n, nx) for joints without a command: followed from the home pose
        in small steps.
        """
        home_x, home_q = self.inverse(self.machine.home_command)
        x = np.broadcast_to(home_x, (q.shape[0], home_x.shape[1]))
        for share in np.linspace(0.0, 1.0, 21)[1:]:
            x = self.forward(home_q + share * (q - home_q), self.machine.nominal, x)
        return x

    def parameter_sensitivity(self, x: Array, q: Array, p: Array) -> Array:
        """dx/dp (n, nx, np) at fixed joints."""
        by_x, by_p, _ = self._slopes(x, q, p)
        return -_solve(by_x, by_p)

    def check_regular(self, x: Array, q: Array, p: Array) -> None:
        """Raise AssemblyError where a pose is so near a singular one that slopes mean
        nothing.
        """
        near = self.reciprocal_condition(x, q, p) < SINGULAR_BELOW
        if near.any():
            where = np.flatnonzero(near)
            raise AssemblyError(
                f"{self.machine.name}: pose numbers {_listed(where)} are singular: the"
                " machine can move there with its joints held, and a reading would"
                " tell nothing; keep a distance from them",
                where,
            )

    def joint_sensitivity(self, x: Array, q: Array, p: Array) -> Array:
        """dx/dq (n, nx, nq) at fixed parameters."""
        by_x, _, by_q = self._slopes(x, q, p)
        return -_solve(by_x, by_q)

    def reciprocal_condition(self, x: Array, q: Array, p: Array) -> Array:
        """Reciprocal condition number (n,) of phi_x, lengths in units of the machine's
        lever: 0 where singular.
        """
        scale = np.array(
            [1.0 if c.unit == "rad" else self.machine.lever for c in self.machine.pose]
        )
        values = np.linalg.svd(
            self._closure_slope(x, q, p)[0] * scale, compute_uv=False
        )
        return np.asarray(values[:, -1] / values[:, 0])

    # -- how a pose is read ------------------------------------------------------------

    def commanded_jacobian(self, x: Array, tool: Array) -> Array:
        """d commanded / dx (n, n_dof, nx)."""
        return self._held(x, tool)[0]

    def frames(self, x: Array, tool: Array) -> tuple[Array, Array, Array]:
        """Rotation (n, 3, 3), tool point (n, 3) and twist slope (n, 6, nx): d[tip,
        rotation vector]/dx.
        """
        rotation, tip, twist = self._frame(x, tool)
        return rotation, tip, twist

    def error_components(self, command: Array, twist: Array) -> Array:
        """Pose error components (n, k) of twists (n, 6) [m, rad] at commands (n,
        n_dof).
        """
        return self._components(command, twist)[0]

    def error_components_jacobian(self, command: Array) -> Array:
        """Linear map (n, k, 6) from twist to components."""
        return self._components_slope(command)[0]

    def skeleton(self, x: Array, q: Array, p: Array) -> list[Array]:
        """Polylines (points, 3) of one pose for a drawing."""
        if self._skeleton is None:
            return []
        return [line(x[None], q[None], p[None])[0][0].T for line in self._skeleton]

    def _told(self, command: Array, bad: Mask, why: str) -> str:
        first = command[np.flatnonzero(bad)[0]]
        told = ", ".join(
            f"{c.name} = {v:.6g} {c.unit}"
            for c, v in zip(self.machine.command, first, strict=True)
        )
        return (
            f"{self.machine.name}: {int(bad.sum())} of {bad.size} commanded poses"
            f" cannot be assembled, the first at {told}: {why}; move it into the"
            " workspace, check tool and unit, or, well inside, the machine's guess"
        )


def _listed(indices: Index) -> str:
    return ", ".join(str(i) for i in indices[:8]) + (" ..." if indices.size > 8 else "")


def _take(p: Array, keep: Index) -> Array:
    return p if p.ndim == 1 else p[keep]


def _twist(rotation: ca.SX, tip: ca.SX, x: ca.SX) -> ca.SX:
    """Slope of [tip, rotation vector] in the base frame: column j of the angular part
    is vee(dR/dx_j R^T).
    """
    columns = []
    for j in range(x.numel()):
        spin = ca.reshape(ca.jacobian(ca.vec(rotation), x[j]), 3, 3) @ rotation.T
        columns.append(ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0]))
    return ca.vertcat(ca.jacobian(tip, x), ca.horzcat(*columns))


def _struts(
    machine: Machine, vectors: Sequence[Expr], named: Sequence[Values], phi: Expr
) -> BatchedFunction | None:
    """Struts' ends (3, nq) at base and platform, and slope of the row that holds each
    joint over it.
    """
    if machine.struts is None:
        return None
    ends, slopes = machine.struts(*named), []
    for k in range(len(machine.joints)):
        q = vectors[1][k]
        row = next(phi[i] for i in range(phi.numel()) if ca.depends_on(phi[i], q))
        slopes.append(ca.jacobian(row, q))
    base, platform = (ca.horzcat(*side) for side in zip(*ends, strict=True))
    return BatchedFunction(
        "struts", list(vectors), [base, platform, ca.vertcat(*slopes)]
    )


def closure_misfit(phi: Expr, x: Expr) -> Expr | None:
    """By how much the equations of a redundant machine miss each other where it
    settles.

    None unless there is one equation more than unknowns. Then phi = g m^1/2 n there,
    where n is the unit vector with n^T phi_x = 0 (the signed minors of phi_x) and m the
    number of equations: g is the root mean square of phi, with a sign.
    """
    if phi.numel() != x.numel() + 1:
        return None
    phi_x, rows = ca.jacobian(phi, x), phi.numel()
    minors = [
        (-1) ** i * ca.det(phi_x[[k for k in range(rows) if k != i], :])
        for i in range(rows)
    ]
    normal = ca.vertcat(*minors)
    return ca.dot(normal, phi) / (ca.norm_2(normal) * np.sqrt(rows))


def _solve(matrix: Array, right: Array) -> Array:
    """Batched solve. An exactly singular matrix gives NaN: its pose is singular, which
    callers report by name.
    """
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        singular = np.linalg.matrix_rank(np.nan_to_num(matrix)) < matrix.shape[-1]
        safe = np.where(singular[:, None, None], np.eye(matrix.shape[-1]), matrix)
        return np.where(singular[:, None, None], np.nan, np.linalg.solve(safe, right))


def _newton(
    evaluate: Callable[[Array, Index], list[Array]],
    z: Array,
    tolerance: float = STEP_TOLERANCE,
    posed: int | None = None,
) -> tuple[Array, Mask]:
    """Newton on all rows of z at once; rows leave as they converge. Returns z and the
    mask of failed rows.

    The first `posed` entries of a row (all by default) are its pose, whose steps are
    limited; joints may count turns.
    """
    bad = np.zeros(z.shape[0], dtype=bool)
    todo = np.arange(z.shape[0])
    for _ in range(MAX_ITERATIONS):
        value, slope = evaluate(z[todo], todo)
        step = _solve(slope, value[..., None])[..., 0]
        size = np.abs(step).max(axis=1)
        moved = np.abs(step[:, :posed]).max(axis=1)
        sound = np.isfinite(size)
        bad[todo[~sound]] = True
        short = (
            step[sound]
            * np.minimum(1.0, MAX_STEP / np.maximum(moved[sound], MAX_STEP))[:, None]
        )
        z[todo[sound]] -= short
        todo = todo[sound & (size > tolerance)]
        if not todo.size:
            break
    bad[todo] = True
    return z, bad
