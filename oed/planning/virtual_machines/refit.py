"""Fast maximum a posteriori fit after a stage, for virtual machines by the hundred.

It minimises what `oed.identification` minimises, |W (y - f(theta))|^2 + |z|^2, W whitening
the noise, over all free parameters at once,

    theta = nominal + T R z,

T the tolerances, R R^T the prior covariance in units of them. Gauss-Newton starts from
what was believed before the stage, mostly near the end. A step that does not help is
halved. The fit stops where a further step promises to lower the sum by less than
`ENOUGH`: that moves the parameters by a small share of their standard deviation, and no
interval. Where it fails with the tolerances as prior, `oed.identification` takes over: it is
slower, and says what is wrong.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.identification import IdentificationError, identify
from oed.information import posterior_covariance
from oed.kinematics import AssemblyError
from oed.measurement import Measurement, Series
from oed.noise.covariance import Noise

#: decrease of the sum of squares below which a step is not worth taking
ENOUGH = 1e-5
#: steps at most, and halvings of a step at most
STEPS, HALVINGS = 30, 12


@dataclasses.dataclass(frozen=True, eq=False)
class Refit:
    """theta (n,) and its covariance (n, n), SI; zero for fixed parameters."""

    theta: Array
    covariance: Array


def refit(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    start: Array,
    root: Array | None = None,
) -> Refit:
    """Fit readings y (N,), SI, from theta `start` (n,).

    root  R (free, free) of the prior; the identity by default

    Raises IdentificationError where the fit does not converge.
    """
    free = np.flatnonzero(measurement.free)
    prior_root = np.eye(len(free)) if root is None else root
    scale = measurement.tolerance[free, None] * prior_root
    problem = _RefitProblem(measurement, series, y, free, scale)
    offset = start[free] - measurement.nominal[free]
    z = np.asarray(np.linalg.lstsq(scale, offset, rcond=None)[0], dtype=float)
    fit = problem.solve(z, start)
    if fit is not None:
        return fit
    if root is not None:
        raise IdentificationError(
            "the fit of a virtual machine does not converge; start from a smaller"
            " covariance"
        )
    slow = identify(measurement, series, y, start=start)
    return Refit(slow.theta, slow.covariance)


@dataclasses.dataclass(frozen=True, eq=False)
class _RefitProblem:
    """Readings to fit over z: theta[free] = nominal + scale @ z."""

    measurement: Measurement
    series: Sequence[Series]
    y: Array
    free: Index
    scale: Array

    def solve(self, z: Array, start: Array) -> Refit | None:
        """Gauss-Newton from z; None where it does not converge.

        Fixed parameters stay as in `start`.
        """
        noise = self.measurement.noise(self.series)
        point = self._point(noise, z, start)
        for _ in range(STEPS):
            try:
                jacobian = self.measurement.jacobian(self.series, point.theta)
            except AssemblyError:
                return None
            h = noise.whiten(jacobian[:, self.free]) @ self.scale
            descent = h.T @ point.residual - point.z
            normal = h.T @ h + np.eye(len(z))
            step = np.asarray(np.linalg.solve(normal, descent), dtype=float)
            if descent @ step < ENOUGH:
                return Refit(point.theta, self._covariance(h))
            lower = self._line_search(noise, point, step, start)
            if lower is None:
                return None
            point = lower
        return None

    def _line_search(
        self, noise: Noise, point: _Point, step: Array, start: Array
    ) -> _Point | None:
        """The first halving of a step that lowers the cost; None where none does."""
        for halvings in range(HALVINGS):
            trial = self._point(noise, point.z + 0.5**halvings * step, start)
            if trial.cost < point.cost:
                return trial
        return None

    def _covariance(self, h: Array) -> Array:
        """Posterior covariance (n, n), SI, from whitened slopes h over z."""
        size = len(self.measurement.nominal)
        covariance = np.zeros((size, size))
        of_free = self.scale @ posterior_covariance(h) @ self.scale.T
        covariance[np.ix_(self.free, self.free)] = of_free
        return covariance

    def _point(self, noise: Noise, z: Array, start: Array) -> _Point:
        """Residual and cost at z; infinite cost where a pose cannot be assembled."""
        theta = start.copy()
        theta[self.free] = self.measurement.nominal[self.free] + self.scale @ z
        expected = self.measurement.try_readings(self.series, theta)
        residual = noise.whiten(self.y - expected)
        cost = float(residual @ residual + z @ z)
        return _Point(z, theta, residual, cost if np.isfinite(cost) else np.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class _Point:
    """A point of the fit: z, theta (n,), whitened residual (N,), cost."""

    z: Array
    theta: Array
    residual: Array
    cost: float
