"""Forward kinematics: poses at joints and parameters, and slopes of the equations there.

Many poses are solved together, entry by entry (`oed.array_newton`). Where its steps do
not show that a pose is solved, careful steps from the start follow (`oed.newton`).

Poses of many parameter vectors often share their starts. Newton's first step is then
almost linear in the parameters, and one factorisation at the nominal ones serves all.
"""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np

from oed import newton
from oed.arrays import Array, Index, Mask
from oed.batch import ARRAY_SIZE, BatchedFunction
from oed.expressions import MachineExpressions
from oed.machine import Machine


class ForwardKinematics:
    """Equations of one machine's poses: its closure, balanced where it is redundant.

    Shapes: n poses, m parameter vectors, nx pose coordinates, nq joints, np parameters.

    equations  value (n, nx) and slope (n, nx, nx) over the pose
    """

    def __init__(self, machine: Machine, e: MachineExpressions) -> None:
        self.machine, self._expressions = machine, e
        balance, inputs = e.balance, [e.x, e.q, e.p]
        by_x = ca.jacobian(balance, e.x)
        self.equations = BatchedFunction("forward", inputs, [balance, by_x])

    @functools.cached_property
    def slopes(self) -> BatchedFunction:
        """Slopes (n, nx, ...) of the equations over pose, parameters and joints."""
        e = self._expressions
        balance, inputs = e.balance, [e.x, e.q, e.p]
        slopes = [ca.jacobian(balance, over) for over in (e.x, e.p, e.q)]
        return BatchedFunction("slopes", inputs, slopes)

    @functools.cached_property
    def misfit(self) -> BatchedFunction:
        """Value (n, nx) of the equations."""
        e = self._expressions
        return BatchedFunction("balance", [e.x, e.q, e.p], [e.balance])

    @functools.cached_property
    def pull_back(self) -> BatchedFunction:
        """Factors (n, nx) times the slope over the parameters, (n, np)."""
        e = self._expressions
        factors = ca.SX.sym("factors", e.x.numel())
        row = ca.jtimes(e.balance, e.p, factors, True)
        return BatchedFunction("pull_back", [e.x, e.q, e.p, factors], [row])

    def solve_all(
        self, q: Array, vectors: Array, start: Array, step_tolerance: float
    ) -> tuple[Array, Mask]:
        """Poses (m, n, nx) at all joints (n, nq) and vectors (m, np), and which failed.

        Starts are (n, nx) or (m, n, nx).
        """
        m, n, nx = len(vectors), len(q), start.shape[-1]
        near = starts = np.broadcast_to(start, (m, n, nx))
        if start.ndim == 2 and m > 1 and m * n >= ARRAY_SIZE:
            near = starts + self._first_step(q, vectors, start)
        every_q = np.broadcast_to(q, (m, *q.shape)).reshape(m * n, -1)
        every_p = np.repeat(vectors, n, axis=0)
        inputs = near.reshape(m * n, nx), every_q, every_p
        x, failed = self.solve(inputs, starts.reshape(m * n, nx), step_tolerance)
        return x.reshape(m, n, nx), failed.reshape(m, n)

    def solve(
        self, inputs: tuple[Array, Array, Array], start: Array, step_tolerance: float
    ) -> tuple[Array, Mask]:
        """Poses (n, nx), and the mask (n,) of those that failed.

        inputs  poses nearby (n, nx), joints and parameters, one a pose
        start   (n, nx) from which careful steps start where others do not arrive
        """
        _, q, p = inputs
        longest = newton.longest_step(self.machine.lever)
        (x,), solved = self.equations.solve(inputs, 1, step_tolerance, longest)
        failed, rest = np.zeros(len(x), dtype=bool), np.flatnonzero(~solved)

        def equations(x: Array, rows: Index) -> list[Array]:
            return self.equations(x, q[rest[rows]], p[rest[rows]])

        if rest.size:
            x[rest], failed[rest] = newton.solve(
                equations, start[rest].astype(float), step_tolerance, longest=longest
            )
        return x, failed

    def _first_step(self, q: Array, vectors: Array, start: Array) -> Array:
        """Newton's first step (m, n, nx), with the slopes at the nominal parameters.

        It is 0 where it is longer than a step may be, and where it is not defined.
        """
        nominal = self.machine.nominal
        value = self.misfit(start, q, nominal)[0]
        by_x, by_p, _ = self.slopes(start, q, nominal)
        right = np.concatenate([value[:, :, None], by_p], axis=2)
        slopes = newton.solve_linear(by_x, right).reshape(value.size, -1)
        change = np.insert(vectors - nominal, 0, 1.0, axis=1)
        with np.errstate(all="ignore"):
            step = -(change @ slopes.T).reshape(len(vectors), *start.shape)
        longest = newton.longest_step(self.machine.lever)
        short = np.abs(step).max(axis=2, keepdims=True) <= longest
        return np.where(short, step, 0.0)
