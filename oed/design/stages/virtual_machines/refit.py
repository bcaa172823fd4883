"""Fast maximum a posteriori fits after a stage, for virtual machines by the hundred.

They minimise what `oed.estimation.identification` minimises, |W (y - f(theta))|^2 + |z|^2, W
whitening the noise, over all free parameters at once,

    theta = nominal + T R z,

T the tolerances, R R^T the prior covariance in units of them. Gauss-Newton starts from
what was believed before the stage, mostly near the end. A step that does not help is
halved. A fit stops where a further step promises to lower the sum by less than
`ENOUGH`: that moves the parameters by a small share of their standard deviation, and no
interval. The readings and slopes of all machines are computed together. Where a fit
fails with the tolerances as prior, `oed.estimation.identification` takes over: it is slower, and says
what is wrong.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index, Mask
from oed.estimation.identification import IdentificationError, identify
from oed.identifiability.information import posterior_covariance
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
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
    """Fit readings y (N,), SI, of one machine from theta `start` (n,).

    root  R (free, free) of the prior; the identity by default

    Raises IdentificationError where the fit does not converge.
    """
    everything = np.ones(len(y), dtype=bool)
    readings = _MachineReadings(everything, measurement.noise(series), y)
    problem = _RefitProblem.of(measurement, series, [readings], start[None], root)
    (fit,) = problem.solve()
    if fit is not None:
        return fit
    if root is not None:
        raise IdentificationError(
            "the fit of a virtual machine does not converge; start from a smaller"
            " covariance"
        )
    slow = identify(measurement, series, y, start=start)
    return Refit(slow.theta, slow.covariance)


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
    readings = [
        _MachineReadings(c, measurement.noise(s) if s else None, y_k)
        for c, s, y_k in zip(captured, by_machine, y, strict=True)
    ]
    fits = _RefitProblem.of(measurement, series, readings, start, root).solve()
    # one machine whose poses cannot be assembled stops those fitted with it
    return [
        refit(measurement, s, y_k[c], start_k, root) if fit is None else fit
        for fit, s, y_k, c, start_k in zip(
            fits, by_machine, y, captured, start, strict=True
        )
    ]


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
class _MachineReadings:
    """Readings of one machine.

    captured  (N,) which of the planned readings it gives
    noise     of the captured ones; None where there are none
    y         (N,) SI; what is not captured does not count
    """

    captured: Mask
    noise: Noise | None
    y: Array

    def whiten(self, values: Array) -> Array:
        """Whitened values (captured, ...) of values (N, ...)."""
        captured = values[self.captured]
        return captured if self.noise is None else self.noise.whiten(captured)


@dataclasses.dataclass(frozen=True, eq=False)
class _RefitProblem:
    """Readings of m machines to fit over z: theta[free] = nominal + scale @ z."""

    measurement: Measurement
    series: Sequence[Series]
    readings: Sequence[_MachineReadings]
    free: Index
    scale: Array
    start: Array

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        series: Sequence[Series],
        readings: Sequence[_MachineReadings],
        start: Array,
        root: Array | None,
    ) -> _RefitProblem:
        """The problem of machines whose prior has the root R; None: the identity."""
        free = np.flatnonzero(measurement.free)
        prior_root = np.eye(len(free)) if root is None else root
        scale = measurement.tolerance[free, None] * prior_root
        return cls(measurement, series, readings, free, scale, start)

    def solve(self) -> list[Refit | None]:
        """Gauss-Newton for all machines, until each converges or fails."""
        fits: list[Refit | None] = [None] * len(self.readings)
        offsets = self.start[:, self.free] - self.measurement.nominal[self.free]
        z = np.asarray(np.linalg.lstsq(self.scale, offsets.T, rcond=None)[0].T, float)
        active = list(range(len(fits)))
        points = dict(zip(active, self._points(active, z), strict=True))
        for _ in range(STEPS):
            try:
                theta = np.array([points[k].theta for k in active])
                jacobian = self.measurement.jacobian(self._series_of(active), theta)
            except AssemblyError:
                break
            steps = {}
            for k, slopes in zip(active, jacobian, strict=True):
                h = self.readings[k].whiten(slopes[:, self.free]) @ self.scale
                step, decrease = _gauss_newton_step(h, points[k])
                if decrease < ENOUGH:
                    fits[k] = Refit(points[k].theta, self._covariance(h))
                else:
                    steps[k] = step
            active = self._line_search(points, steps)
            if not active:
                break
        return fits

    def _line_search(
        self, points: dict[int, _Point], steps: dict[int, Array]
    ) -> list[int]:
        """Moves points to the first halving of their step that lowers the cost.

        Returns the machines that have one.
        """
        searching, moved = list(steps), list[int]()
        for halvings in range(HALVINGS):
            if not searching:
                break
            z = [points[k].z + 0.5**halvings * steps[k] for k in searching]
            trials = zip(searching, self._points(searching, np.array(z)), strict=True)
            lower = {k: trial for k, trial in trials if trial.cost < points[k].cost}
            points.update(lower)
            moved += lower
            searching = [k for k in searching if k not in lower]
        return sorted(moved)

    def _points(self, machines: Sequence[int], z: Array) -> list[_Point]:
        """Points of some machines at z (m, free).

        The cost is infinite where a captured reading's pose cannot be assembled.
        """
        theta = self.start[list(machines)]
        theta[:, self.free] = self.measurement.nominal[self.free] + z @ self.scale.T
        expected = self.measurement.try_readings(self._series_of(machines), theta)
        points = []
        for k, z_k, theta_k, expected_k in zip(
            machines, z, theta, expected, strict=True
        ):
            residual = self.readings[k].whiten(self.readings[k].y - expected_k)
            cost = float(residual @ residual + z_k @ z_k)
            cost = cost if np.isfinite(cost) else np.inf
            points.append(_Point(z_k, theta_k, residual, cost))
        return points

    def _series_of(self, machines: Sequence[int]) -> list[Series]:
        return [s.of_machines(np.array(machines)) for s in self.series]

    def _covariance(self, h: Array) -> Array:
        """Posterior covariance (n, n), SI, from whitened slopes h over z."""
        size = len(self.measurement.nominal)
        covariance = np.zeros((size, size))
        of_free = self.scale @ posterior_covariance(h) @ self.scale.T
        covariance[np.ix_(self.free, self.free)] = of_free
        return covariance


@dataclasses.dataclass(frozen=True, eq=False)
class _Point:
    """A point of a fit: z, theta (n,), whitened residual of what is captured, cost."""

    z: Array
    theta: Array
    residual: Array
    cost: float


def _gauss_newton_step(h: Array, point: _Point) -> tuple[Array, float]:
    """Step over z from whitened slopes h, and the decrease of the cost it promises."""
    descent = h.T @ point.residual - point.z
    normal = h.T @ h + np.eye(len(point.z))
    step = np.asarray(np.linalg.solve(normal, descent), dtype=float)
    return step, float(descent @ step)
