"""Slopes of readings over a machine's parameters, by adjoints of its equations.

With g = dy/dx of a reading at a pose, its slopes over the parameters are

    g dx/dp = -(g phi_x^-1) phi_p,

where the bracket comes first: one row a reading, and not one column a parameter. Of a
pose that many readings see, as a taught one, dx/dp comes first.
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index
from oed.mechanism.kinematics import Kinematics

#: poses over readings up to which many readings see one pose
FEW = 0.25


class PoseAdjoints:
    """A machine's equations at poses x (m, poses, nx) of m parameter vectors p (m, np).

    q  (m, poses, nq) joints of each
    """

    def __init__(self, kinematics: Kinematics, x: Array, q: Array, p: Array) -> None:
        self._kinematics, self._x, self._q, self._p = kinematics, x, q, p
        self._is_regular = False

    def pull_back(self, slopes: Array, index: Index) -> Array:
        """Slopes (m, n, channels, np) of readings over the parameters.

        slopes  (m, n, channels, nx) over the pose that each reading sees
        index   (n,) that pose

        Raises AssemblyError where a pose is singular.
        """
        distinct = np.unique(index)
        if len(distinct) > FEW * len(index):
            return self._of_many(slopes, index)
        if len(distinct) == 1:
            return self._of_one(slopes, distinct[0])
        rows = np.empty((*slopes.shape[:3], self._p.shape[1]))
        for pose in distinct:
            readings = index == pose
            rows[:, readings] = self._of_one(slopes[:, readings], pose)
        return rows

    def _of_many(self, slopes: Array, index: Index) -> Array:
        """As `pull_back`, reading by reading."""
        m, n, channels, nx = slopes.shape
        x = self._x[:, index].reshape(m * n, nx)
        q = self._q[:, index].reshape(m * n, -1)
        p = np.repeat(self._p, n, axis=0)
        right = slopes.reshape(m * n, channels, nx)
        rows, condition = self._kinematics.pull_back(x, q, p, right)
        self._check(condition)
        return rows.reshape(m, n, channels, -1)

    def _of_one(self, slopes: Array, pose: int) -> Array:
        """As `pull_back`, of readings that see one pose."""
        m, n, channels, nx = slopes.shape
        sensitivity, condition = self._kinematics.sensitivity(
            self._x[:, pose], self._q[:, pose], self._p
        )
        self._check(condition)
        rows = slopes.reshape(m, n * channels, nx) @ sensitivity
        return np.asarray(rows.reshape(m, n, channels, -1))

    def _check(self, condition: Array) -> None:
        """Check all poses by their singular values where bounds (n,) do not suffice."""
        if self._is_regular or self._kinematics.surely_regular(condition):
            return
        m, poses, nx = self._x.shape
        q = self._q.reshape(m * poses, -1)
        p = np.repeat(self._p, poses, axis=0)
        self._kinematics.check_regular(self._x.reshape(m * poses, nx), q, p)
        self._is_regular = True
