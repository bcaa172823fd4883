"""Fits many machines at once that were read at the same poses with the same noise.

It minimises what `oed.estimation.identification` minimises with known noise,

    |W (y - f(theta))|^2 + |u|^2,        theta = nominal + T u,

W whitening the noise, T the root of the prior covariance. The minimum is the same: where the gradient is
zero, u has no part in the directions that no reading determines. All machines take their
damped Gauss-Newton step together (Levenberg 1944), each with a damping of its own.
Machines that do not converge go to `oed.estimation.identification`, which says what is wrong.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index, Mask
from oed.estimation.identification import identify
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.noise.covariance import Noise

#: steps at most, and size of a step, in tolerances, after which a machine has converged
STEPS, CONVERGED = 60, 1e-8
#: the same before the last stage, which starts there
NEAR = 1e-3
#: relative rounding error of readings, and of costs
READINGS_ROUNDED, COST_ROUNDED = 1e-15, 1e-12
#: least damping, that after the first step that does not help, and factors after each
#: that does not and that does
LEAST_DAMPING, FIRST_DAMPING, GROWTH, DECAY = 1e-9, 1e-3, 10.0, 0.1
#: entries of the slopes of all machines that are held in memory at once
ENTRIES = 4_000_000


def fit_machines(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
) -> Array:
    """Parameters theta (m, n), SI, of m machines with readings y (m, N), SI.

    stages  patterns of parameter names, freed in turn, as in `identify`

    Raises IdentificationError where a machine cannot be fitted.
    """
    size = max(1, ENTRIES // (y.shape[1] * len(measurement.parameters)))
    parts = [
        _fit_together(measurement, series, y[start : start + size], stages)
        for start in range(0, len(y), size)
    ]
    return np.vstack(parts)


def _fit_together(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    stages: Sequence[Sequence[str]],
) -> Array:
    noise = measurement.noise(series)
    theta = np.repeat(measurement.nominal[None], len(y), axis=0)
    converged = np.ones(len(y), dtype=bool)
    for k, patterns in enumerate(stages, 1):
        free = np.flatnonzero(measurement.freed(patterns))
        problem = _Problem(measurement, series, noise, y, free)
        theta, settled = problem.solve(theta, CONVERGED if k == len(stages) else NEAR)
        converged &= settled
    for row in np.flatnonzero(~converged):
        theta[row] = identify(measurement, series, y[row], stages=stages).theta
    return theta


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """Readings y (m, N) to fit over the free places of theta."""

    measurement: Measurement
    series: Sequence[Series]
    noise: Noise
    y: Array
    free: Index

    def solve(self, theta: Array, last_step: float) -> tuple[Array, Mask]:
        """Minima (m, n) from theta (m, n), and the mask (m,) of those that converged.

        last_step  size of the step, in tolerances, after which a machine has converged
        """
        theta = theta.copy()
        converged = np.zeros(len(theta), dtype=bool)
        damping = np.full(len(theta), LEAST_DAMPING)
        residual, cost = self._evaluate(theta, np.arange(len(theta)))
        active = np.flatnonzero(np.isfinite(cost))
        for _ in range(STEPS):
            if not active.size:
                break
            slopes = self._slopes(theta[active])
            if slopes is None:
                break
            step = self._step(theta[active], residual[active], slopes, damping[active])
            trial = theta[active].copy()
            trial[:, self.free] += step @ self._root.T
            new_residual, new_cost = self._evaluate(trial, active)
            better = new_cost <= cost[active] + self._rounding(active, residual, cost)
            accepted = active[better]
            theta[accepted], residual[accepted] = trial[better], new_residual[better]
            cost[accepted] = new_cost[better]
            damping[accepted] = np.maximum(damping[accepted] * DECAY, LEAST_DAMPING)
            refused = active[~better]
            damping[refused] = np.maximum(damping[refused] * GROWTH, FIRST_DAMPING)
            done = better & (np.abs(step).max(axis=1) < last_step)
            converged[active[done]] = True
            active = active[~done]
        return theta, converged

    def _rounding(self, rows: Index, residual: Array, cost: Array) -> Array:
        """Changes (rows,) of the costs that rounding alone may make."""
        of_readings: Array = np.abs(self.y[rows]) * READINGS_ROUNDED / self.noise.sigma
        of_costs: Array = 2.0 * (np.abs(residual[rows]) * of_readings).sum(axis=1)
        return of_costs + COST_ROUNDED * cost[rows]

    @functools.cached_property
    def _root(self) -> Array:
        """Root (free, free) of the prior covariance, SI."""
        freed = np.zeros(len(self.measurement.nominal), dtype=bool)
        freed[self.free] = True
        return self.measurement.prior_root(freed)[np.ix_(self.free, self.free)]

    def _deviation(self, theta: Array) -> Array:
        """u (m, free): deviations from nominal, standard normal a priori."""
        change = theta[:, self.free] - self.measurement.nominal[self.free]
        return np.asarray(np.linalg.solve(self._root, change.T).T, dtype=float)

    def _evaluate(self, theta: Array, rows: Index) -> tuple[Array, Array]:
        """Whitened residuals (m, N) and costs (m,), infinite where not assembled."""
        predicted = self.measurement.try_readings(self.series, theta)
        residual = self.noise.whiten_last(self.y[rows] - predicted)
        deviation = self._deviation(theta)
        cost = (residual**2).sum(axis=1) + (deviation**2).sum(axis=1)
        return residual, np.where(np.isfinite(cost), cost, np.inf)

    def _slopes(self, theta: Array) -> Array | None:
        """Whitened slopes (m, N, free) over u; None where a pose is singular."""
        try:
            rows = self.measurement.jacobian(self.series, theta)
        except AssemblyError:
            return None
        scaled = rows[:, :, self.free] @ self._root
        return (
            self.noise.whiten(scaled.swapaxes(0, 1).reshape(rows.shape[1], -1))
            .reshape(rows.shape[1], len(theta), -1)
            .swapaxes(0, 1)
        )

    def _step(
        self, theta: Array, residual: Array, slopes: Array, damping: Array
    ) -> Array:
        """Damped Gauss-Newton steps (m, free) of u."""
        transposed = slopes.swapaxes(1, 2)
        descent = (transposed @ residual[:, :, None])[:, :, 0] - self._deviation(theta)
        normal = transposed @ slopes + np.eye(len(self.free))
        diagonal = np.einsum("mkk->mk", normal)
        damped = normal.copy()
        np.einsum("mkk->mk", damped)[...] += damping[:, None] * diagonal
        return np.asarray(np.linalg.solve(damped, descent[:, :, None])[:, :, 0])
