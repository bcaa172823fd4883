"""Poses of a machine whose parameters are near known ones.

With the pose x0 at parameters p0, the pose at p is x0 + dx/dp (p - p0) to first order.
Steps with the slope at x0,

    x <- x - phi_x(x0)^-1 phi(x, q, p),

need neither new slopes nor new factorisations (the chord method; Ortega and Rheinboldt
1970, section 7.1). Each step leaves a share of the error that is the same for all
steps, so that two steps s1 and s2 tell the error that remains: s2^2 / s1. Where it is
too large, Newton's method takes over.
"""

from __future__ import annotations

import numpy as np

from oed.base import Array
from oed.mechanism import newton
from oed.mechanism.kinematics import Kinematics

#: error (m, rad) that the last step may leave, and longest second step
NEAR_ERROR, LONGEST = 1e-12, 1e-8
#: last step of Newton's method where it takes over: leaves an error of 1e-11 m
NEAR_STEP_TOLERANCE = 2e-6


class NearbyPoses:
    """Poses at joints q (n, nq) near those x (n, nx) at parameters p (np,)."""

    def __init__(self, kinematics: Kinematics, q: Array, p: Array, x: Array) -> None:
        self._kinematics, self._q, self._p, self._x = kinematics, q, p, x
        by_x, by_p, _ = kinematics.equations.slopes(x, q, p)
        identity = np.broadcast_to(np.eye(by_x.shape[1]), by_x.shape)
        self._inverse = newton.solve_linear(by_x, identity)
        self._sensitivity = -(self._inverse @ by_p)

    def solve(self, vectors: Array) -> Array:
        """Poses (m, n, nx) at parameters (m, np); NaN where one cannot be assembled."""
        m, (n, nx) = len(vectors), self._x.shape
        change = (vectors - self._p) @ self._sensitivity.reshape(n * nx, -1).T
        start = self._x + change.reshape(m, n, nx)
        q = np.broadcast_to(self._q, (m, *self._q.shape)).reshape(m * n, -1)
        p = np.repeat(vectors, n, axis=0)
        x, sizes = start.reshape(m * n, nx).copy(), []
        for _ in range(2):
            (misfit,) = self._kinematics.equations.misfit(x, q, p)
            step = (self._inverse @ misfit.reshape(m, n, nx, 1)).reshape(m * n, nx)
            x -= step
            sizes.append(np.sqrt(np.einsum("ij,ij->i", step, step)))
        first, second = sizes
        near = (second**2 <= NEAR_ERROR * first) & (second <= LONGEST)
        far = np.flatnonzero(~near)
        if far.size:
            again = start.reshape(m * n, nx)[far]
            x[far], failed = self._kinematics.try_forward_per_pose(
                q[far], p[far], again, NEAR_STEP_TOLERANCE
            )
            x[far[failed]] = np.nan
        return x.reshape(m, n, nx)
