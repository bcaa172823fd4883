"""The most likely parameters after a stage, found fast: for virtual machines by the
hundred.

Minimised is what `oed.identify` minimises, |W (y - f(theta))|^2 + |z|^2, W whitening
the noise, over all free parameters at once,

    theta = nominal + T R z,

T the tolerances, R R^T the covariance of what was known before in units of them.
Gauss-Newton starts from what was believed before the stage, mostly near the end
already; a step that does not help is halved. It stops where a further step would change
the sum by a small share of one, that is, the parameters by a small share of their
standard deviation: tighter ends cost most of the time and change no interval. Where it
fails from the tolerances on, `oed.identify` is asked, which takes longer and tells what
is wrong.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.identify import IdentificationError, identify
from oed.information import posterior_covariance
from oed.kinematics import AssemblyError
from oed.measurement import Measurement, Series
from oed.noise.covariance import Noise

#: decrease of the sum of squares that a further step promises, below which it is not
#: worth taking
ENOUGH = 1e-5
#: steps, and times that one is halved, at the most
STEPS, HALVINGS = 30, 12


@dataclasses.dataclass(frozen=True, eq=False)
class Refit:
    """theta (n,) and its covariance (n, n), SI; zero for entries that are held."""

    theta: Array
    covariance: Array


def refit(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    start: Array,
    root: Array | None = None,
) -> Refit:
    """Fit all readings y (N,), SI, from theta `start` (n,). `root` is R (free, free),
    the identity by default.

    Raises IdentificationError where no fit is found.
    """
    free = np.flatnonzero(measurement.free)
    known = np.eye(len(free)) if root is None else root
    scale = measurement.tolerance[free, None] * known
    problem = _RefitProblem(measurement, series, y, free, scale)
    begin = np.linalg.lstsq(scale, start[free] - measurement.nominal[free], rcond=None)[
        0
    ]
    found = problem.solved(np.asarray(begin, dtype=float), start)
    if found is not None:
        return found
    if root is not None:
        raise IdentificationError(
            "the fit of a virtual machine found no end; take a smaller covariance"
            " before"
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

    def solved(self, z: Array, start: Array) -> Refit | None:
        """Gauss-Newton from z; entries that are held stay as in `start`. None where it
        finds no end.
        """
        noise = self.measurement.noise(self.series)
        theta = self._theta(z, start)
        white, cost = self._misfit(noise, theta, z)
        for _ in range(STEPS):
            try:
                slopes = self.measurement.jacobian(self.series, theta)[:, self.free]
            except AssemblyError:
                return None
            h = noise.whiten(slopes) @ self.scale
            downhill = h.T @ white - z
            step = np.linalg.solve(h.T @ h + np.eye(len(z)), downhill)
            if downhill @ step < ENOUGH:
                covariance = np.zeros((len(theta), len(theta)))
                covariance[np.ix_(self.free, self.free)] = (
                    self.scale @ posterior_covariance(h) @ self.scale.T
                )
                return Refit(theta, covariance)
            for halved in range(HALVINGS):
                trial = z + 0.5**halved * step
                there = self._theta(trial, start)
                trial_white, trial_cost = self._misfit(noise, there, trial)
                if trial_cost < cost:
                    break
            else:
                return None
            z, theta, white, cost = trial, there, trial_white, trial_cost
        return None

    def _theta(self, z: Array, start: Array) -> Array:
        theta = start.copy()
        theta[self.free] = self.measurement.nominal[self.free] + self.scale @ z
        return theta

    def _misfit(self, noise: Noise, theta: Array, z: Array) -> tuple[Array, float]:
        """Whitened misfits (N,) and the sum of squares; infinite where a pose cannot be
        assembled.
        """
        white = noise.whiten(self.y - self.measurement.try_readings(self.series, theta))
        total = float(white @ white + z @ z)
        return white, total if np.isfinite(total) else np.inf
