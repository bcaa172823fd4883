"""Slopes of poses over parameters and joints, and of what readings see of them.

With g = dy/dx of a reading at a pose, its slopes are g dx/dp = -(g phi_x^-1) phi_p,
where the bracket comes first: one row a reading, and not one column a parameter. Of a
pose that many readings see, as a taught one, dx/dp comes first.
"""

import functools

import casadi as ca
import numpy as np

from oed.base import Array, Index
from oed.mechanism import newton
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import MachineExpressions
from oed.mechanism.forward import ForwardKinematics
from oed.mechanism.inverse import AssemblyError, listed
from oed.model import Machine

#: reciprocal condition number of phi_x (lengths over the lever) below which a pose
#: counts as singular
SINGULAR_BELOW = 1e-6
MAX_POSE_SHARE = 0.25  #: poses over readings up to which many readings see one pose


class PoseSlopes:
    """Slopes of one machine's poses.

    Shapes: n poses, nx pose coordinates, nq joints, np parameters.
    """

    def __init__(
        self, machine: Machine, e: MachineExpressions, equations: ForwardKinematics
    ) -> None:
        self._machine, self._expressions, self._equations = machine, e, equations

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
        by_x, by_p, _ = self._equations.slopes(x, q, p)
        return -newton.solve_linear(by_x, by_p)

    def pull_back(
        self, x: Array, q: Array, p: Array, slopes: Array
    ) -> tuple[Array, Array]:
        """Slopes (n, channels, np) over the parameters of what has these over the pose.

        slopes  (n, channels, nx)

        Also returns bounds (n,) on the condition numbers; see `surely_regular`.
        """
        rows, condition = self._equations.adjoint.pull_back(
            [x, q, p], slopes, self._scale
        )
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
        by_x, by_p, _ = self._equations.slopes(x, q, p)
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
        by_x, _, by_q = self._equations.slopes(x, q, p)
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

    def __init__(self, slopes: PoseSlopes, x: Array, q: Array, p: Array) -> None:
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
