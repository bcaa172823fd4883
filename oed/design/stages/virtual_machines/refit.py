"""Fast maximum a posteriori fits after a stage, for virtual machines by the hundred.

They minimise what `oed.estimation.identification` minimises, |W (y - f(theta))|^2 + |z|^2, W
whitening the noise, over all free parameters at once,

    theta = nominal + T R z,

T the tolerances, R R^T the prior covariance in units of them. Steps start from
what was believed before the stage, mostly near the end. Where a fit
fails with the tolerances as prior, `oed.estimation.identification` says what is wrong.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.estimation import IdentificationError, identify, minimise
from oed.identifiability import posterior_covariance
from oed.measurement import Measurement, Series
from oed.noise import Noise

#: distance to the minimum, in posterior standard deviations, of the last step: its square
#: is a small share of any interval
NEAR = 3e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Refit:
    """theta (n,) and its covariance (n, n), SI; zero for fixed parameters."""

    theta: Array
    covariance: Array


def refit_machines(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    captured: Mask,
    start: Array,
    root: Array | None = None,
) -> list[Refit]:
    """Fit the readings y (m, N), SI, of m machines from theta `start` (m, n).

    series    planned readings, with joints of each machine or the same for all
    captured  (m, N) which of them are captured
    root      R (free, free) of the prior; the identity by default

    Fixed parameters stay as in `start`. Raises IdentificationError where a fit does not
    converge.
    """
    by_machine = [
        _captured_series(measurement, series, k, c) for k, c in enumerate(captured)
    ]
    noises = [measurement.noise(s) if s else None for s in by_machine]
    free = np.flatnonzero(measurement.free)
    basis = np.zeros((len(measurement.nominal), len(free)))
    basis[free] = np.diag(measurement.tolerance[free])
    if root is not None:
        basis = basis @ root
    origin = start.copy()
    origin[:, free] = measurement.nominal[free]
    problem = _CapturedReadings(measurement, series, noises, captured, y, origin, basis)
    offsets = (start - origin)[:, free]
    z = np.asarray(np.linalg.lstsq(basis[free], offsets.T, rcond=None)[0].T, float)
    # a pose that is not captured may be one that cannot be assembled
    return [
        _refit_alone(problem, k, by_machine[k], z[k], root is None)
        if fit is None
        else fit
        for k, fit in enumerate(_refits(problem, z))
    ]


def _refits(problem: _CapturedReadings, z: Array) -> list[Refit | None]:
    """Fits of all machines from z (m, k); None where one does not converge."""
    minima = minimise(problem, z, precision=NEAR)
    theta = problem.theta(np.arange(len(z)), minima.z)
    return [
        Refit(theta[k], _covariance(problem.basis, minima.slopes[k]))
        if minima.converged[k]
        else None
        for k in range(len(z))
    ]


def _refit_alone(
    problem: _CapturedReadings,
    machine: int,
    series: Sequence[Series],
    z: Array,
    prior_is_stated: bool,
) -> Refit:
    """The fit of one machine from z (k,) to the series of what its readings capture.

    Raises IdentificationError where it does not converge.
    """
    measurement = problem.measurement
    y = problem.y[machine, problem.captured[machine]]
    alone = dataclasses.replace(
        problem,
        series=series,
        noises=[problem.noises[machine]],
        captured=np.ones((1, len(y)), dtype=bool),
        y=y[None],
        origin=problem.origin[machine][None],
    )
    (fit,) = _refits(alone, z[None])
    if fit is not None:
        return fit
    if not prior_is_stated:
        raise IdentificationError(
            "the fit of a virtual machine does not converge; start from a smaller"
            " covariance"
        )
    start = alone.theta(np.arange(1), z[None])[0]
    estimate = identify(measurement, series, y, start=start)
    return Refit(estimate.theta, estimate.covariance)


def _covariance(basis: Array, slopes: Array) -> Array:
    """Posterior covariance (n, n), SI, from whitened slopes (N, k) over z."""
    return np.asarray(basis @ posterior_covariance(slopes) @ basis.T)


def _captured_series(
    measurement: Measurement, series: Sequence[Series], machine: int, captured: Mask
) -> list[Series]:
    """The captured readings (N,) of one machine; series without any are left out."""
    parts = []
    start = 0
    for s in series:
        channels = len(measurement.setups[s.setup].sigma)
        end = start + channels * len(s)
        rows = np.flatnonzero(captured[start:end:channels])
        start = end
        if len(rows):
            parts.append(s.of_machines(machine).take(rows))
    return parts


@dataclasses.dataclass(frozen=True, eq=False)
class _CapturedReadings:
    """Readings y (m, N), SI, of m machines that are captured in part, over z (m, k).

    noises  of what each machine's readings capture; None where that is nothing
    origin  (m, n) parameters at z = 0, SI
    basis   (n, k) changes of the parameters, SI, per z
    """

    measurement: Measurement
    series: Sequence[Series]
    noises: Sequence[Noise | None]
    captured: Mask
    y: Array
    origin: Array
    basis: Array

    @functools.cached_property
    def magnitude(self) -> Array:
        """Sizes (m, N) of the whitened readings."""
        return self._whiten(np.arange(len(self.y)), np.abs(self.y))

    def theta(self, machines: Index, z: Array) -> Array:
        """Parameters (s, n), SI."""
        return np.asarray(self.origin[machines] + z @ self.basis.T)

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (s, N); NaN where a captured pose cannot be assembled."""
        series = self._series(machines)
        expected = self.measurement.try_readings(series, self.theta(machines, z))
        return self._whiten(machines, self.y[machines] - expected)

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened slopes (s, N, k). Raises AssemblyError."""
        theta = self.theta(machines, z)
        jacobian = self.measurement.jacobian(self._series(machines), theta)
        return self._whiten(machines, jacobian @ self.basis)

    def _series(self, machines: Index) -> list[Series]:
        return [s.of_machines(machines) for s in self.series]

    def _whiten(self, machines: Index, values: Array) -> Array:
        """Values (s, N, ...), the captured ones whitened, the others 0."""
        white = np.zeros_like(values)
        for k, machine in enumerate(machines):
            captured, noise = self.captured[machine], self.noises[machine]
            if noise is not None:
                white[k, captured] = noise.whiten(values[k, captured])
        return white
