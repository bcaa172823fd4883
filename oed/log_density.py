"""Log posterior density of the readings in identifiable coordinates, for a sampler.

    log p(z, t | y) = -|z|^2 / 2 - sum_g [ N_g t_g + exp(-2 t_g) |(y - f(theta(z))) /
    sigma|_g^2 / 2 + t_g^2 / (2 s^2) ]

z are the identifiable coordinates (`oed.coordinates`). t_g is the log of the noise
factor of set-up g, sampled where the noise is to be estimated, so that few readings
give wide tails.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.estimate import Estimate
from oed.measurement import Measurement, Series

#: prior standard deviation s of a log noise factor
LOG_NOISE_SD = 1.0
#: standard deviation of a log noise factor's proposals, times the root of its readings
NOISE_PROPOSAL = 0.7
#: degrees of freedom of the independent proposals' Student tails
PROPOSAL_DOF = 20.0
#: Gauss-Newton steps that keep the readings as they were along null directions
CORRECTIONS = 2


class LogDensity:
    """Log density over points (z, log noise factors), for all walkers at once.

    coordinates   identifiable coordinates of the estimate
    noise_groups  set-ups whose noise factor is sampled
    r             number of identifiable coordinates
    dimensions    r plus the number of noise groups
    moving        indices of the parameters that identifiable coordinates move
    centre, root  (dimensions,) and (dimensions, dimensions): mean of the Laplace
                  approximation, and a root of its covariance
    interrupted   whether Ctrl-C arrived during an evaluation
    """

    def __init__(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        y: Array,
        estimate: Estimate,
    ) -> None:
        scale = estimate.noise_scale
        labels = np.array(measurement.setup_of_readings(series))
        factors = np.array([1.0 / scale[name] for name in labels])
        jacobian = measurement.jacobian(series, estimate.theta)
        self.coordinates = estimate.coordinates
        self.noise_groups = tuple(scale) if estimate.noise_estimated else ()
        self.r = self.coordinates.basis.shape[1]
        self.dimensions = self.r + len(self.noise_groups)
        largest = np.abs(self.coordinates.basis).max(axis=1)
        self.moving = np.flatnonzero(largest > 0)
        self.interrupted = False
        self._y = y
        self._readings = measurement.readings_near(series, estimate.theta)
        self._members = [labels == name for name in self.noise_groups]
        self._noise = estimate.noise
        self._stated_noise = estimate.noise.scaled(factors)
        self._slope = estimate.noise.whiten(jacobian) @ self.coordinates.basis
        log_noise = np.log([scale[name] for name in self.noise_groups])
        self.centre = np.concatenate([estimate.z, log_noise])
        self.root = self._laplace_root()

    def __call__(self, points: Array) -> Array:
        """Log density (walkers,) at points (walkers, dimensions).

        The sampler prints a traceback of whatever is raised here, so that Ctrl-C is
        only noted.
        """
        try:
            return self._log_density(points)
        except KeyboardInterrupt:
            self.interrupted = True
            return np.full(len(points), -np.inf)

    def _log_density(self, points: Array) -> Array:
        z, log_noise = points[:, : self.r], points[:, self.r :]
        residual = self._readings(self.coordinates.to_theta(z)) - self._y
        square = self._stated_noise.whiten_last(residual) ** 2
        normalisation = np.zeros(len(points))
        for k, members in enumerate(self._members):
            square[:, members] *= np.exp(-2.0 * log_noise[:, k])[:, None]
            normalisation += members.sum() * log_noise[:, k]
        prior = np.sum(z**2, axis=1)
        noise_prior = np.sum((log_noise / LOG_NOISE_SD) ** 2, axis=1)
        value = -0.5 * (square.sum(axis=1) + prior + noise_prior)
        return np.where(np.isfinite(value), value - normalisation, -np.inf)

    def propose(
        self, points: Array, random: np.random.RandomState
    ) -> tuple[Array, Array]:
        """Independent proposals for points (walkers, dimensions).

        They are Student t about the Laplace approximation. Returns the proposals and
        log q(old) - log q(new).
        """
        normal = random.standard_normal(points.shape)
        chi2 = random.chisquare(PROPOSAL_DOF, size=(len(points), 1))
        new = normal / np.sqrt(chi2 / PROPOSAL_DOF)
        proposed = self.centre + new @ self.root.T
        old = np.linalg.solve(self.root, (points - self.centre).T).T
        return proposed, self._log_proposal(old) - self._log_proposal(new)

    def _log_proposal(self, white: Array) -> Array:
        """Log density (walkers,), up to a constant, of whitened proposals."""
        power = -0.5 * (PROPOSAL_DOF + self.dimensions)
        return np.asarray(power * np.log1p(np.sum(white**2, axis=1) / PROPOSAL_DOF))

    def _laplace_root(self) -> Array:
        """Root of the covariance of the Laplace approximation."""
        precision = self._slope.T @ self._slope + np.eye(self.r)
        values, vectors = np.linalg.eigh(precision)
        counts = [max(1.0, members.sum()) for members in self._members]
        noise_sd = [NOISE_PROPOSAL / np.sqrt(count) for count in counts]
        root = np.zeros((self.dimensions, self.dimensions))
        root[: self.r, : self.r] = vectors / np.sqrt(values)
        root[self.r :, self.r :] = np.diag(noise_sd)
        return root

    def move_along_null(self, theta: Array, change: Array) -> Array:
        """Move draws (..., n) by null changes (..., n) with the readings as they were.

        A null direction is straight to first order only: turning joints by a
        millimetre's tolerance moves a reading by a micrometre to second order. Two
        Gauss-Newton steps over the identifiable coordinates take that out.
        """
        if not self.coordinates.null_basis.size:
            return theta
        before = theta.reshape(-1, theta.shape[-1])
        wanted = self._readings(before)
        after = before + change.reshape(before.shape)
        step = np.linalg.pinv(self._slope).T @ self.coordinates.basis.T
        for _ in range(CORRECTIONS):
            excess = self._readings(after) - wanted
            after = after - self._noise.whiten_last(excess) @ step
        return after.reshape(theta.shape)
