"""Readings of a long session near known parameters, interpolated from a few of them.

Readings along traces change smoothly from one to the next, and near known parameters they
are nearly linear in them: changes of all N readings lie in a space of few dimensions. An
interpolative decomposition (Cheng, Gimbutas, Martinsson and Rokhlin 2005, SIAM J. Sci.
Comput. 26, 1389-1404) of the changes D (m, N) at m points finds k readings and a matrix T
(k, N) with

    D = D_k T + E,

by a QR decomposition with pivots. The machine is then solved exactly at k readings alone.
E is as small as what the solver leaves; points of their own check it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import linalg

from oed.base import Array, Index
from oed.mechanism import Kinematics

#: readings from which on interpolation is faster
LEAST_READINGS = 1000
#: points that the decomposition is of, and that it is checked at
POINTS, CHECKS = 200, 20
#: readings of points that are solved at once
AT_ONCE = 300_000
#: error over the noise of a reading that is left out, or that over what the solver leaves
LEFT_OUT, OVER_SOLVER = 1e-6, 3.0
#: error that the checks may show, over that
LARGEST_ERROR = 10.0

#: readings (m, k) at parameters (m, n), NaN where a machine cannot be assembled
Readings = Callable[[Array], Array]


@dataclasses.dataclass(frozen=True, eq=False)
class InterpolatedReadings:
    """Readings (m, N) at parameters (m, n) near those it was made at.

    few     the k readings, solved exactly
    middle  (N,) readings that changes are from
    rows    (k,) numbers of the few
    matrix  (k, N) T
    """

    few: Readings
    middle: Array
    rows: Index
    matrix: Array

    def __call__(self, theta: Array) -> Array:
        """Readings (m, N) at parameters (m, n); NaN where a machine is not assembled."""
        change = self.few(theta) - self.middle[self.rows]
        return self.middle + change @ self.matrix


def interpolate(
    exact: Readings,
    some: Callable[[Index], Readings],
    points: Array,
    sigma: Array,
) -> Readings:
    """Interpolated readings for parameters like `points`; exact ones where they are few.

    some    the readings of some rows, by their numbers
    points  (POINTS + CHECKS, n) parameters that cover where the readings are wanted
    sigma   (N,) noise of the readings, SI

    They are exact as well where too many readings would be needed, or a check fails.
    """
    if len(sigma) < LEAST_READINGS:
        return exact
    step = max(AT_ONCE // len(sigma), 1)
    parts = [exact(points[k : k + step]) for k in range(0, len(points), step)]
    values = np.concatenate(parts)
    assembled = np.isfinite(values).all(axis=1)
    if assembled.sum() < len(points) - CHECKS // 2:
        return exact
    middle = values[assembled][0]
    changes = (values[assembled] - middle) / sigma
    snapshots, checks = changes[1:-CHECKS], changes[-CHECKS:]
    triangle, order = linalg.qr(snapshots, mode="r", pivoting=True, check_finite=False)
    left_out = max(LEFT_OUT, OVER_SOLVER * Kinematics.nearby_error / float(sigma.min()))
    count = int((np.abs(np.diag(triangle)) > left_out).sum())
    if not 0 < count < len(snapshots):
        return exact
    rows = np.sort(order[:count])
    inverse = linalg.solve_triangular(triangle[:count, :count], triangle[:count])
    matrix = np.empty((count, len(sigma)))
    matrix[:, order] = inverse[np.argsort(order[:count])]
    if np.abs(checks[:, rows] @ matrix - checks).max() > LARGEST_ERROR * left_out:
        return exact
    matrix *= sigma / sigma[rows, None]
    return InterpolatedReadings(some(rows), middle, rows, matrix)
