"""Log posterior density of the readings in identifiable coordinates, for a sampler.

    log p(z, u | y) = -1/2 [ |z|^2 + |u|^2 + r^T C(u)^-1 r + log |C(u)| ],
    r = y - f(theta(z)).

z are the identifiable coordinates (`oed.estimation.coordinates`), u those of the noise law
(`oed.noise_law.prior`), sampled where the law is estimated, so that few readings give wide
tails.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.estimation import Estimate
from oed.measurement import Measurement, Series
from oed.model.series import take_values
from oed.noise_law import NoisePosterior, ResidualModel
from oed.posterior.interpolated_readings import (
    CHECKS,
    LEAST_READINGS,
    POINTS,
    Readings,
    interpolate,
)

#: degrees of freedom of the independent proposals' Student tails
PROPOSAL_DOF = 20.0
#: Gauss-Newton steps that keep the readings as they were along null directions
CORRECTIONS = 2
#: readings of draws that are predicted at once
VALUES = 200_000
#: spread of the points that readings are interpolated between, over the posterior's
WIDER = 1.5

#: movement by a lost direction, in tolerances, that is rounding
STILL = 1e-9
#: draws of a start at most, until it keeps to the bounds
MOST_STARTS = 2000


class OutOfBoundsError(RuntimeError):
    """Readings and bounds contradict each other."""

    def __init__(self, measurement: Measurement, theta: Array) -> None:
        """Name the parameters of theta (m, n) that are out of their bounds most often."""
        bounded = measurement.bounded
        shares = [
            np.mean(~measurement.in_bounds(theta, np.array([k]))) for k in bounded
        ]
        names = [
            measurement.names[k]
            for k, share in zip(bounded, shares, strict=True)
            if share > 0.5 * max(shares)
        ]
        super().__init__(
            f"the readings contradict the bounds of {', '.join(names)}: hardly any value"
            " that they allow is within; check units and signs, or widen [[prior.bounds]]"
        )


class LogDensity:
    """Log density over points (z, u), for all walkers at once.

    measurement   of the readings
    coordinates   identifiable coordinates of the estimate
    noise_names   coordinates u of the noise law; none where the noise is known
    r             number of identifiable coordinates
    dimensions    r plus the number of coordinates u
    moving        indices of the parameters that identifiable coordinates move
    centre, root  (dimensions,) and (dimensions, dimensions): mean of the Laplace
                  approximation, and a root of its covariance
    interrupted   whether Ctrl-C arrived during an evaluation

    Bounds of parameters hold here where no lost direction moves a parameter; of others
    draws are left out once lost directions are drawn (`in_bounds`).
    """

    def __init__(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        y: Array,
        estimate: Estimate,
    ) -> None:
        jacobian = measurement.jacobian(series, estimate.theta)
        self.coordinates = estimate.coordinates
        self._posterior = estimate.noise_posterior
        self.noise_names = self._posterior.prior.names if self._posterior else ()
        self.r = self.coordinates.basis.shape[1]
        self.dimensions = self.r + len(self.noise_names)
        self.measurement = measurement
        lost = np.abs(self.coordinates.null_basis).max(axis=1, initial=0.0)
        bounded = measurement.bounded
        moved = lost > STILL * measurement.tolerance
        self._bounded = bounded[~moved[bounded]]
        largest = np.abs(self.coordinates.basis).max(axis=1)
        self.moving = np.flatnonzero(largest > 0)
        self.interrupted = False
        robust = estimate.robust_readings
        self._y = y if robust is None else robust
        self._series, self._theta = series, estimate.theta
        self._exact = measurement.readings_near(series, estimate.theta)
        self._noise = estimate.noise
        self._slope = estimate.noise.whiten(jacobian) @ self.coordinates.basis
        mode = self._posterior.mode if self._posterior else np.zeros(0)
        self.centre = np.concatenate([estimate.z, mode])
        self.root = self._laplace_root()

    @functools.cached_property
    def _readings(self) -> Readings:
        """Readings (m, N) at parameters (m, n) that the posterior allows."""
        return self._interpolated(np.zeros((len(self._theta), 0)))

    @functools.cached_property
    def _readings_along_null(self) -> Readings:
        """The same where lost directions are drawn from their prior as well."""
        return self._interpolated(self.coordinates.null_basis)

    def _interpolated(self, null: Array) -> Readings:
        """Readings of long sessions from a few of them (`oed.posterior.interpolated_readings`).

        null  (n, k) directions that move by their prior
        """
        if len(self._y) < LEAST_READINGS:
            return self._exact
        count = POINTS + CHECKS
        # which points they are matters little: always the same
        rng = np.random.default_rng(0)
        normal = rng.standard_normal((count, self.r + null.shape[1])) * WIDER
        root = self.root[: self.r, : self.r]
        theta = self.coordinates.to_theta(
            self.centre[: self.r] + normal[:, : self.r] @ root.T
        )
        theta = theta + normal[:, self.r :] @ null.T
        return interpolate(self._exact, self._some, theta, self._noise.sigma)

    def _some(self, rows: Index) -> Readings:
        """Readings (m, k) of some rows (k,)."""
        setups = self.measurement.setups
        channels = [len(setups[s.setup].sigma) for s in self._series]
        taken, places = take_values(self._series, channels, rows)
        measurement = self.measurement.of_taken(taken)
        parts = [some.part for some in taken]
        readings = measurement.readings_near(parts, self._theta)
        return lambda theta: readings(theta)[:, places]

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
        few = max(VALUES // len(self._y), 1)
        starts = range(0, len(points), few)
        return np.concatenate([self._part(points[k : k + few]) for k in starts])

    def _part(self, points: Array) -> Array:
        """The log density of as many points as fit into memory with their readings."""
        z, u = points[:, : self.r], points[:, self.r :]
        theta = self.coordinates.to_theta(z)
        residual = self._readings(theta) - self._y
        prior = np.sum(points**2, axis=1)
        value = -0.5 * (self._misfit(residual, u) + prior)
        possible = np.isfinite(value) & self.measurement.in_bounds(theta, self._bounded)
        return np.where(possible, value, -np.inf)

    @property
    def noise_posterior(self) -> NoisePosterior | None:
        """Posterior of the noise law in the linear model; None where noise is known."""
        return self._posterior

    def linear_model(self) -> ResidualModel:
        """Readings as a linear model about the estimate, for an estimated noise law."""
        assert self._posterior is not None
        structure, series = self._posterior.structure, self._series
        jacobian = self.measurement.jacobian(series, self._theta)
        residual = self._y - self.measurement.readings(series, self._theta)
        return ResidualModel(
            structure,
            structure.standardise(residual),
            structure.standardise(jacobian @ self.coordinates.basis),
            self.centre[: self.r],
        )

    def starts(self, rng: np.random.Generator, count: int) -> Array:
        """Points (count, dimensions) from the Laplace approximation, within bounds.

        Raises OutOfBoundsError where there are hardly any.
        """
        points = (
            self.centre + rng.standard_normal((count, self.dimensions)) @ self.root.T
        )
        for _ in range(MOST_STARTS):
            theta = self.coordinates.to_theta(points[:, : self.r])
            outside = np.flatnonzero(~self.measurement.in_bounds(theta, self._bounded))
            if not outside.size:
                return np.asarray(points)
            normal = rng.standard_normal((len(outside), self.dimensions))
            points[outside] = self.centre + normal @ self.root.T
        raise OutOfBoundsError(self.measurement, self.coordinates.to_theta(points))

    def in_bounds(self, theta: Array) -> Mask:
        """Which draws theta (..., n) keep to the bounds of all parameters."""
        return self.measurement.in_bounds(theta)

    def _misfit(self, residual: Array, u: Array) -> Array:
        """r^T C^-1 r + log |C| (walkers,) of residuals (walkers, N); infinite for NaN."""
        if self._posterior is None:
            return np.asarray(np.sum(self._noise.whiten_last(residual) ** 2, axis=1))
        structure = self._posterior.structure
        misfit = np.full(len(residual), np.inf)
        good = np.flatnonzero(np.isfinite(residual).all(axis=1))
        if good.size:
            whitening = self._posterior.prior.laws(u[good]).whitening(structure)
            standard = structure.standardise(residual[good].T).T
            square = whitening.gram(standard[:, :, None])[:, 0, 0]
            misfit[good] = square + whitening.log_determinant
        return misfit

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
        """Root of the covariance of the Laplace approximation, symmetric where it can be:

        that one does not depend on the signs of eigenvectors.
        """
        root = np.zeros((self.dimensions, self.dimensions))
        if self._posterior is not None:
            values, vectors = np.linalg.eigh(self._posterior.covariance)
            sizes = np.sqrt(np.maximum(values, 1e-12))
            root[: self.r, : self.r] = (vectors * sizes) @ vectors.T
            root[self.r :, self.r :] = self._posterior.root
            return root
        values, vectors = np.linalg.eigh(self._precision)
        return np.asarray((vectors / np.sqrt(values)) @ vectors.T)

    @property
    def _precision(self) -> Array:
        """Precision (r, r) of the identifiable coordinates under the estimate's noise."""
        return self._slope.T @ self._slope + np.eye(self.r)

    def move_along_null(self, theta: Array, change: Array) -> Array:
        """Move draws (..., n) by null changes (..., n) with the readings as they were.

        A null direction is straight to first order only: turning joints by a
        millimetre's tolerance moves a reading by a micrometre to second order. Two
        Gauss-Newton steps over the identifiable coordinates take that out. Their prior
        holds what the readings hardly determine: without it what a second-order change
        leaves there is divided by next to nothing.
        """
        if not self.coordinates.null_basis.size:
            return theta
        before = theta.reshape(-1, theta.shape[-1])
        after = before + change.reshape(before.shape)
        step = self._slope @ np.linalg.solve(self._precision, self.coordinates.basis.T)
        # readings of all draws of a long session would not fit into memory
        few, readings = max(VALUES // len(self._y), 1), self._readings_along_null
        for k in range(0, len(before), few):
            some = slice(k, k + few)
            wanted = readings(before[some])
            for _ in range(CORRECTIONS):
                excess = readings(after[some]) - wanted
                after[some] = after[some] - self._noise.whiten_last(excess) @ step
        return after.reshape(theta.shape)
