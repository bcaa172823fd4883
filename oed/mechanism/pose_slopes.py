"""Poses at joints and parameters, their slopes, and those of what readings see of them.

Many poses are solved together (`oed.mechanism.systems`). Where the steps do not show that a
pose is solved, careful steps from the start follow (`oed.mechanism.newton`).

With g = dy/dx of a reading at a pose, its slopes are g dx/dp = -(g phi_x^-1) phi_p,
where the bracket comes first: one row a reading, and not one column a parameter. Of a
pose that many readings see, as a taught one, dx/dp comes first.
"""

import functools

import casadi as ca
import numpy as np

from oed.base import Array, Index, Mask
from oed.mechanism import newton
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import MachineExpressions
from oed.mechanism.inverse import AssemblyError, listed
from oed.model import Machine

#: reciprocal condition number of phi_x (lengths over the lever) below which a pose
#: counts as singular
SINGULAR_BELOW = 1e-6
MAX_POSE_SHARE = 0.25  #: poses over readings up to which many readings see one pose


class PoseEquations:
    """Equations of one machine's poses: its closure, balanced where it is redundant.

    Shapes: n poses, m parameter vectors, nx pose coordinates, nq joints, np parameters.

    equations  value (n, nx) and slope (n, nx, nx) over the pose
    """

    def __init__(self, machine: Machine, e: MachineExpressions) -> None:
        self._machine, self._expressions = machine, e
        inputs, by_x = [e.x, e.q, e.p], ca.jacobian(e.balance, e.x)
        self.equations = BatchedFunction("forward", inputs, [e.balance, by_x])

    @functools.cached_property
    def slopes(self) -> BatchedFunction:
        """Slopes (n, nx, ...) of the equations over pose, parameters and joints."""
        e = self._expressions
        balance = e.balance
        inputs = [e.x, e.q, e.p]
        slopes = [ca.jacobian(balance, over) for over in (e.x, e.p, e.q)]
        return BatchedFunction("slopes", inputs, slopes)

    @functools.cached_property
    def adjoint(self) -> BatchedFunction:
        """Slope (n, nx, nx) over the pose, factors (n, nx) times that over p."""
        e = self._expressions
        factors = ca.SX.sym("factors", e.x.numel())
        by_x = ca.jacobian(e.balance, e.x)
        row = ca.jtimes(e.balance, e.p, factors, True).T
        return BatchedFunction("adjoint", [e.x, e.q, e.p, factors], [by_x, row])

    def solve_all(
        self,
        q: Array,
        vectors: Array,
        start: Array,
        step_tolerance: float,
        wanted: Mask | None = None,
    ) -> tuple[Array, Mask]:
        """Poses (m, n, nx) at all joints (n, nq) and vectors (m, np), and which failed.

        Starts are (n, nx) or (m, n, nx), and so can joints be. Poses that are not
        `wanted` (m, n) are not solved, and count as failed.
        """
        m = len(vectors)
        n = q.shape[-2]
        starts = start if start.ndim == 3 else start[None]
        if len(starts) != m:
            starts = np.broadcast_to(starts, (m, *starts.shape[1:]))
        if wanted is None:
            return self.solve((starts, q, vectors[:, None]), step_tolerance)
        rows = np.nonzero(wanted)
        x, failed = np.full(starts.shape, np.nan), np.ones((m, n), dtype=bool)
        every_q = np.broadcast_to(q, (m, *q.shape[-2:]))
        inputs = starts[rows], every_q[rows], vectors[rows[0]]
        x[rows], failed[rows] = self.solve(inputs, step_tolerance)
        return x, failed

    def solve(
        self, inputs: tuple[Array, Array, Array], step_tolerance: float
    ) -> tuple[Array, Mask]:
        """Poses (n, nx) or (m, n, nx) from starts, joints, parameters, and failures."""
        start, q, p = inputs
        longest = newton.longest_step(self._machine.lever)
        x, solved, near = self.equations.solve(inputs, step_tolerance, longest)
        failed = np.zeros(solved.shape, dtype=bool)
        if solved.all():
            return x, failed
        rest = np.nonzero(~solved)
        first = np.where(near[rest][:, None], x[rest], start[rest])
        rest_q, rest_p = (
            np.broadcast_to(a, (*solved.shape, a.shape[-1]))[rest] for a in (q, p)
        )

        def at(x: Array, rows: Index) -> list[Array]:
            return self.equations(x, rest_q[rows], rest_p[rows])

        x[rest], failed[rest] = newton.solve(at, first, step_tolerance, longest=longest)
        return x, failed

    # -- slopes ------------------------------------------------------------------------
    @functools.cached_property
    def _closure_slope(self) -> BatchedFunction:
        e = self._expressions
        slope = ca.jacobian(e.phi, e.x)
        return BatchedFunction("closure_slope", [e.x, e.q, e.p], [slope])

    def closure_slopes(self, x: Array, q: Array, p: Array) -> Array:
        """phi_x (n, rows, nx): of a redundant machine, of all its equations."""
        return self._closure_slope(x, q, p)[0]

    def pose_by_parameter(self, x: Array, q: Array, p: Array) -> Array:
        """dx/dp (n, nx, np) at fixed joints."""
        by_x, by_p, _ = self.slopes(x, q, p)
        return -newton.solve_linear(by_x, by_p)

    def pull_back(
        self, x: Array, q: Array, p: Array, slopes: Array
    ) -> tuple[Array, Array]:
        """Slopes (n, channels, np) over the parameters of what has these over the pose.

        slopes  (n, channels, nx)

        Also returns bounds (n,) on the condition numbers; see `surely_regular`.
        """
        rows, condition = self.adjoint.pull_back([x, q, p], slopes, self._scale)
        rest = np.flatnonzero(~np.isfinite(condition))
        if rest.size:
            sensitivity, condition[rest] = self.pose_by_parameter_with_condition(
                x[rest], q[rest], p[rest]
            )
            rows[rest] = -slopes[rest] @ sensitivity
        return -rows, condition

    def pose_by_parameter_with_condition(
        self, x: Array, q: Array, p: Array
    ) -> tuple[Array, Array]:
        """dx/dp (n, nx, np), joints fixed, and |phi_x| |phi_x^-1| (n,)."""
        by_x, by_p, _ = self.slopes(x, q, p)
        identity = np.broadcast_to(np.eye(by_x.shape[1]), by_x.shape)
        inverse = newton.solve_linear(by_x, identity)
        norm = np.einsum("nij,nij->nj", by_x, by_x) @ self._scale**2
        norm_of_inverse = np.einsum("nij,nij->ni", inverse, inverse) @ self._scale**-2
        return -(inverse @ by_p), np.sqrt(norm * norm_of_inverse)

    def surely_regular(self, condition: Array) -> bool:
        """Whether bounds (n,) show all poses regular, redundant ones never."""
        if self._expressions.phi.numel() != self._expressions.x.numel():
            return False
        return bool(np.all(condition < 1.0 / SINGULAR_BELOW))

    def adjoints(self, x: Array, q: Array, p: Array) -> "PoseAdjoints":
        """Those of poses x (m, poses, nx) with joints q (m, poses, nq), p (m, np)."""
        return PoseAdjoints(self, x, q, p)

    def pose_by_joint(self, x: Array, q: Array, p: Array) -> Array:
        """dx/dq (n, nx, nq) at fixed parameters."""
        by_x, _, by_q = self.slopes(x, q, p)
        return -newton.solve_linear(by_x, by_q)

    def check_regular(self, x: Array, q: Array, p: Array) -> None:
        """Raise AssemblyError for poses so near a singular one that slopes are useless."""
        singular = self.reciprocal_condition(x, q, p) < SINGULAR_BELOW
        if singular.any():
            poses = np.flatnonzero(singular)
            raise AssemblyError(
                f"{self._machine.name}: pose numbers {listed(poses)} are singular: the"
                " machine can move there while its joints stand still, and a reading"
                " carries no information; keep a distance from them",
                poses,
            )

    def reciprocal_condition(self, x: Array, q: Array, p: Array) -> Array:
        """Reciprocal condition (n,) of phi_x, in levers; 0 where singular."""
        phi_x = self.closure_slopes(x, q, p)
        values = np.linalg.svd(phi_x * self._scale, compute_uv=False)
        return values[:, -1] / values[:, 0]

    @functools.cached_property
    def _scale(self) -> Array:
        """Pose coordinates' units (nx,) for condition numbers: the lever, or 1 rad."""
        lever = self._machine.lever
        return np.array([1.0 if c.unit == "rad" else lever for c in self._machine.pose])


class PoseAdjoints:
    """A machine's equations at poses x (m, poses, nx) of m parameter vectors p (m, np).

    q  (m, poses, nq) joints of each
    """

    def __init__(self, slopes: PoseEquations, x: Array, q: Array, p: Array) -> None:
        self._slopes, self._x, self._q, self._p = slopes, x, q, p
        self._is_regular = False

    def pull_back(self, slopes: Array, index: Index) -> Array:
        """Slopes (m, n, channels, np) of readings over the parameters.

        slopes  (m, n, channels, nx) over the pose that each reading sees
        index   (n,) that pose

        Raises AssemblyError where a pose is singular.
        """
        distinct = np.unique(index)
        if len(distinct) > MAX_POSE_SHARE * len(index):
            return self._pull_back_each(slopes, index)
        if len(distinct) == 1:
            return self._pull_back_single(slopes, distinct[0])
        rows = np.empty((*slopes.shape[:3], self._p.shape[1]))
        for pose in distinct:
            readings = index == pose
            rows[:, readings] = self._pull_back_single(slopes[:, readings], pose)
        return rows

    def _pull_back_each(self, slopes: Array, index: Index) -> Array:
        """As `pull_back`, reading by reading."""
        m, n, channels, nx = slopes.shape
        x = self._x[:, index].reshape(m * n, nx)
        q = self._q[:, index].reshape(m * n, -1)
        p = np.repeat(self._p, n, axis=0)
        right = slopes.reshape(m * n, channels, nx)
        rows, condition = self._slopes.pull_back(x, q, p, right)
        self._check(condition)
        return rows.reshape(m, n, channels, -1)

    def _pull_back_single(self, slopes: Array, pose: int) -> Array:
        """As `pull_back`, of readings that see one pose."""
        m, n, channels, nx = slopes.shape
        sensitivity, condition = self._slopes.pose_by_parameter_with_condition(
            self._x[:, pose], self._q[:, pose], self._p
        )
        self._check(condition)
        rows = slopes.reshape(m, n * channels, nx) @ sensitivity
        return rows.reshape(m, n, channels, -1)

    def _check(self, condition: Array) -> None:
        """Check all poses by their singular values where bounds (n,) do not suffice."""
        if self._is_regular or self._slopes.surely_regular(condition):
            return
        m, poses, nx = self._x.shape
        q = self._q.reshape(m * poses, -1)
        p = np.repeat(self._p, poses, axis=0)
        self._slopes.check_regular(self._x.reshape(m * poses, nx), q, p)
        self._is_regular = True
