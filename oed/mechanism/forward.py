"""Forward kinematics: poses at joints and parameters, and slopes of the equations there.

Many poses are solved together (`oed.mechanism.systems`). Where the steps do not show that a
pose is solved, careful steps from the start follow (`oed.mechanism.newton`).
"""

import functools

import casadi as ca
import numpy as np

from oed.base import Array, Index, Mask
from oed.mechanism import newton
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import MachineExpressions
from oed.model import Machine


class ForwardKinematics:
    """Equations of one machine's poses: its closure, balanced where it is redundant.

    Shapes: n poses, m parameter vectors, nx pose coordinates, nq joints, np parameters.

    equations  value (n, nx) and slope (n, nx, nx) over the pose
    """

    def __init__(self, machine: Machine, e: MachineExpressions) -> None:
        self.machine, self._expressions = machine, e
        balance = e.balance
        inputs = [e.x, e.q, e.p]
        by_x = ca.jacobian(balance, e.x)
        self.equations = BatchedFunction("forward", inputs, [balance, by_x])

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
        longest = newton.longest_step(self.machine.lever)
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
