"""Log posterior density of the readings in identifiable coordinates, for a sampler.

Directions that no reading determines have coordinates w, standard normal a priori. They
are straight to first order only: a move by a millimetre's tolerance changes readings to
second order. z moves against it,

    theta(z, w) = origin + basis (z - b(w)) + null_basis w,        b quadratic,

a change of coordinates of Jacobian 1, so that one reading of the machine at theta(z, w)
gives the density of z and w together. b only has to be near: what it leaves is in the
density.

Without sampling, z is normal under each noise law, laws are drawn by their weight, and
lost directions from their prior, followed exactly by Gauss-Newton steps.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg

from oed.base import Array, Index
from oed.estimation import Estimate
from oed.instrument import TakenReadings
from oed.linear_algebra import covariance_root
from oed.measurement import Measurement, Series
from oed.noise_law import NoisePosterior, ResidualModel

# Readings of a long session near known parameters, interpolated from a few of them.
#
# Readings along traces change smoothly from one to the next, and near known parameters they
# are nearly linear in them: changes of all N readings lie in a space of few dimensions. An
# interpolative decomposition (Cheng, Gimbutas, Martinsson and Rokhlin 2005, SIAM J. Sci.
# Comput. 26, 1389-1404) of the changes D (m, N) at m points finds k readings and a matrix T
# (k, N) with
#
# D = D_k T + E,
#
# by a QR decomposition with pivots. The machine is then solved exactly at k readings alone.
# E is small beside the noise; points of their own check it.

MIN_READINGS = 1000  #: readings from which on interpolation is faster
POINTS = 200  #: points that the decomposition is of
CHECKS = 20  #: further points that it is checked at
AT_ONCE = 300_000  #: readings of points that are solved at once
LEFT_OUT = 1e-6  #: error over the noise of a reading that is left out
MAX_ERROR = 10.0  #: error that the checks may show, over that

#: readings (m, k) at parameters (m, n), NaN where a machine cannot be assembled
Readings = Callable[[Array], Array]


@dataclasses.dataclass(frozen=True, eq=False)
class InterpolatedReadings:
    """Readings (m, N) at parameters (m, n) near those it was made at."""

    few: Readings  #: the k readings, solved exactly
    middle: Array  #: (N,) readings that changes are from
    rows: Index  #: (k,) numbers of the few
    matrix: Array  #: (k, N) T

    def __call__(self, theta: Array) -> Array:
        """Readings (m, N) at parameters (m, n); NaN where a machine is not assembled."""
        change = self.few(theta) - self.middle[self.rows]
        return self.middle + change @ self.matrix


def interpolate(
    exact: Readings, some: Callable[[Index], Readings], points: Array, sigma: Array
) -> Readings:
    """Interpolated readings for parameters like `points`; exact ones where they are few.

    some    the readings of some rows, by their numbers
    points  (POINTS + CHECKS, n) parameters that cover where the readings are wanted
    sigma   (N,) noise of the readings, SI

    They are exact as well where too many readings would be needed, or a check fails.
    """
    if len(sigma) < MIN_READINGS:
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
    count = int((np.abs(np.diag(triangle)) > LEFT_OUT).sum())
    if not 0 < count < len(snapshots):
        return exact
    rows = np.sort(order[:count])
    inverse = linalg.solve_triangular(triangle[:count, :count], triangle[:count])
    matrix = np.empty((count, len(sigma)))
    matrix[:, order] = inverse[np.argsort(order[:count])]
    if np.abs(checks[:, rows] @ matrix - checks).max() > MAX_ERROR * LEFT_OUT:
        return exact
    matrix *= sigma / sigma[rows, None]
    return InterpolatedReadings(some(rows), middle, rows, matrix)


#: degrees of freedom of the independent proposals' Student tails, at least
MIN_DOF = 20.0
#: of these over the coordinates. Against a normal density 95 % of proposals count in any
#: dimension; with 20 degrees it would be 76 % of 36 coordinates
DOF_PER_COORDINATE = 2.5
N_DRAWS = 2000  #: draws of the parameters: their covariance is known to 2 %
MAX_ROUNDS = 30  #: rounds of draws until enough keep to the bounds
#: change of all readings together along null directions, over the noise, that a draw may
#: keep, and draws that are brought below it at once: two steps leave up to 5e-4
MAX_EXCESS = 5e-4
CORRECTED_AT_ONCE = 100
BATCH_READINGS = 200_000  #: readings of draws that are predicted at once: 2 MB
POINTS_PER_COEFFICIENT = 2  #: points that b(w) is fitted at, over its coefficients
#: such points at most: beyond, to follow each draw costs as much
MAX_BEND_POINTS = 1000
#: change of all readings together, over the noise, that b(w) may leave (root mean square):
#: with 0.45 weights scatter so much that to follow each draw is as fast
MAX_LEFT = 0.3
#: spread of the points that readings are interpolated between, over the posterior's
SPREAD_OF_POINTS = 1.5
#: movement by a lost direction, in tolerances, below which it is rounding
MOVE_TOLERANCE = 1e-9
MAX_DRAWS = 2000  #: draws of a start at most, until it keeps to the bounds


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
    law           posterior of the noise law in the linear model; None where it is known
    interrupted   whether Ctrl-C arrived during an evaluation

    Without w, bounds of parameters hold here where no lost direction moves a parameter; of
    others draws are left out once lost directions are drawn. With w all of them hold here.
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
        self.law: NoisePosterior | None = estimate.noise_posterior
        self.noise_names = self.law.prior.names if self.law else ()
        self.r = self.coordinates.basis.shape[1]
        self.dimensions = self.r + len(self.noise_names)
        self.measurement = measurement
        lost = np.abs(self.coordinates.null_basis).max(axis=1, initial=0.0)
        bounded = measurement.bounded
        moved = lost > MOVE_TOLERANCE * measurement.tolerance
        self._bounded = bounded[~moved[bounded]]
        largest = np.abs(self.coordinates.basis).max(axis=1)
        self.moving = np.flatnonzero(largest > 0)
        self.interrupted = False
        robust = estimate.robust_readings
        self._y = y if robust is None else robust
        self._series, self._theta = series, estimate.theta
        self._exact = functools.partial(measurement.try_readings, series)
        self._noise = estimate.noise
        self._slope = estimate.noise.whiten(jacobian) @ self.coordinates.basis
        mode = self.law.mode if self.law else np.zeros(0)
        self.centre = np.concatenate([estimate.z, mode])
        self.root = self._laplace_root()

    @functools.cached_property
    def _readings(self) -> Readings:
        """Readings (m, N) at parameters (m, n), of long sessions interpolated."""
        if len(self._y) < MIN_READINGS:
            return self._exact
        count = POINTS + CHECKS
        null = self.coordinates.null_basis
        # which points they are matters little: always the same
        rng = np.random.default_rng(0)
        normal = rng.standard_normal((count, self.r + null.shape[1])) * SPREAD_OF_POINTS
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
        taken, columns = TakenReadings.of_values(self._series, channels, rows)
        measurement = self.measurement.taken_measurement(taken)
        parts = [some.part for some in taken]
        return lambda theta: measurement.try_readings(parts, theta)[:, columns]

    @functools.cached_property
    def bend(self) -> Array | None:
        """Coefficients (k (k + 1) / 2, r) of b(w); None where it leaves too much."""
        r, k = self.r, self.coordinates.null_basis.shape[1]
        count = POINTS_PER_COEFFICIENT * (k * (k + 1) // 2)
        if not 0 < count <= MAX_BEND_POINTS:
            return None if count else np.zeros((0, r))
        # which points they are matters little: always the same
        rng = np.random.default_rng(0)
        w = rng.standard_normal((count, k))
        centre = np.tile(self.centre[:r], (count, 1))
        excess = self._excess(centre, centre, w)
        assembled = np.isfinite(excess).all(axis=1)
        shifts = np.linalg.solve(self._precision, self._slope.T @ excess[assembled].T).T
        bend = np.asarray(np.linalg.lstsq(_products(w[assembled]), shifts)[0])
        w = rng.standard_normal((CHECKS, k))
        z = self.centre[:r] + rng.standard_normal((CHECKS, r)) @ self.root[:r, :r].T
        remaining = self._excess(z, z - _products(w) @ bend, w)
        return bend if np.mean(np.sum(remaining**2, axis=1)) <= MAX_LEFT**2 else None

    def _excess(self, before: Array, after: Array, w: Array) -> Array:
        """Whitened change (m, N) of readings from z (m, r) to another z at w (m, k)."""
        readings, to_theta = self._readings, self.coordinates.to_theta
        moved = to_theta(after) + w @ self.coordinates.null_basis.T
        return self._noise.whiten_last(readings(moved) - readings(to_theta(before)))

    def draw_lost(self, rng: np.random.Generator, count: int) -> Array | None:
        """Coordinates w (count, k) from their prior; None where there is no b(w)."""
        if self.bend is None:
            return None
        return rng.standard_normal((count, self.coordinates.null_basis.shape[1]))

    def place(self, points: Array, w: Array | None) -> tuple[Array, Array]:
        """z - b(w) (m, r) and theta (m, n) at points (m, dimensions); w None: 0."""
        z = points[:, : self.r]
        if w is None or self.bend is None:
            return z, self.coordinates.to_theta(z)
        z = z - _products(w) @ self.bend
        return z, self.coordinates.to_theta(z) + w @ self.coordinates.null_basis.T

    def __call__(self, points: Array, w: Array | None = None) -> Array:
        """Log density (walkers,) at points (walkers, dimensions).

        w  (walkers, k) lost directions, whose prior is left out; None: 0

        The sampler prints a traceback of whatever is raised here, so that Ctrl-C is
        only noted.
        """
        try:
            parts = [
                self._log_density(points[batch], None if w is None else w[batch])
                for batch in self._batches(points)
            ]
            return np.concatenate(parts)
        except KeyboardInterrupt:
            self.interrupted = True
            return np.full(len(points), -np.inf)

    def _batches(self, points: Array) -> list[slice]:
        """Parts of some points whose readings fit into memory."""
        size = max(BATCH_READINGS // len(self._y), 1)
        return [slice(k, k + size) for k in range(0, len(points), size)]

    def _log_density(self, points: Array, w: Array | None) -> Array:
        """Log density of points whose readings fit into memory."""
        z, theta = self.place(points, w)
        u = points[:, self.r :]
        bounded = self._bounded if w is None else self.measurement.bounded
        prior = np.sum(z**2, axis=1) + np.sum(u**2, axis=1)
        value = -0.5 * (self._misfit(self._readings(theta) - self._y, u) + prior)
        possible = np.isfinite(value) & self.measurement.in_bounds(theta, bounded)
        return np.where(possible, value, -np.inf)

    def linear_model(self) -> ResidualModel:
        """Readings as a linear model about the estimate, for an estimated noise law."""
        assert self.law is not None
        structure, series = self.law.structure, self._series
        jacobian = self.measurement.jacobian(series, self._theta)
        residual = self._y - self.measurement.readings(series, self._theta)
        return ResidualModel(
            structure,
            structure.standardise(residual),
            structure.standardise(jacobian @ self.coordinates.basis),
            self.centre[: self.r],
        )

    def starts(self, rng: np.random.Generator, count: int) -> Array:
        """Points (count, dimensions) within bounds, or OutOfBoundsError."""
        points = (
            self.centre + rng.standard_normal((count, self.dimensions)) @ self.root.T
        )
        for _ in range(MAX_DRAWS):
            theta = self.coordinates.to_theta(points[:, : self.r])
            outside = np.flatnonzero(~self.measurement.in_bounds(theta, self._bounded))
            if not outside.size:
                return np.asarray(points)
            normal = rng.standard_normal((len(outside), self.dimensions))
            points[outside] = self.centre + normal @ self.root.T
        raise OutOfBoundsError(self.measurement, self.coordinates.to_theta(points))

    def _misfit(self, residual: Array, u: Array) -> Array:
        """r^T C^-1 r + log |C| (walkers,) of residuals (walkers, N); infinite for NaN."""
        if self.law is None:
            return np.asarray(np.sum(self._noise.whiten_last(residual) ** 2, axis=1))
        structure = self.law.structure
        misfit = np.full(len(residual), np.inf)
        good = np.flatnonzero(np.isfinite(residual).all(axis=1))
        if good.size:
            whitening = self.law.prior.laws(u[good]).whitening(structure)
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
        new = draw_student(random, points.shape)
        proposed = self.centre + new @ self.root.T
        old = np.linalg.solve(self.root, (points - self.centre).T).T
        return proposed, log_student(old) - log_student(new)

    def _laplace_root(self) -> Array:
        """Root of the Laplace covariance, symmetric where possible."""
        root = np.zeros((self.dimensions, self.dimensions))
        if self.law is not None:
            values, vectors = np.linalg.eigh(self.law.covariance)
            sizes = np.sqrt(np.maximum(values, 1e-12))
            root[: self.r, : self.r] = (vectors * sizes) @ vectors.T
            root[self.r :, self.r :] = self.law.root
            return root
        values, vectors = np.linalg.eigh(self._precision)
        return np.asarray((vectors / np.sqrt(values)) @ vectors.T)

    @property
    def _precision(self) -> Array:
        """Precision (r, r) of the identifiable coordinates under the estimate's noise."""
        return self._slope.T @ self._slope + np.eye(self.r)

    def draw_theta(self, rng: np.random.Generator, z: Array) -> Array:
        """Parameters (..., n) at coordinates (..., r), null directions from their prior."""
        null = self.coordinates.null_basis
        change = rng.standard_normal((*z.shape[:-1], null.shape[1])) @ null.T
        return self.move_along_null(self.coordinates.to_theta(z), change)

    def move_along_null(self, theta: Array, change: Array) -> Array:
        """Move draws (..., n) by null changes (..., n) with the readings as they were.

        A null direction is straight to first order only. Gauss-Newton steps over the
        identifiable coordinates, with their prior, take the second order out, until
        none needs a further one.
        """
        if not self.coordinates.null_basis.size:
            return theta
        before = theta.reshape(-1, theta.shape[-1])
        after = before + change.reshape(before.shape)
        step = self._slope @ np.linalg.solve(self._precision, self.coordinates.basis.T)
        readings = self._readings
        for batch in self._batches(before):
            exact = readings(before[batch])
            excess = self._noise.whiten_last(readings(after[batch]) - exact)
            moved = after[batch] - excess @ step
            farthest = np.argsort(-np.linalg.norm(excess, axis=1))
            for k in range(0, len(moved), CORRECTED_AT_ONCE):
                rows = farthest[k : k + CORRECTED_AT_ONCE]
                excess = self._noise.whiten_last(readings(moved[rows]) - exact[rows])
                moved[rows] -= excess @ step
                if not (np.linalg.norm(excess, axis=1) > MAX_EXCESS).any():
                    break
            after[batch] = moved
        return after.reshape(theta.shape)


def _products(w: Array) -> Array:
    """w_i w_j (m, k (k + 1) / 2), i <= j, of coordinates (m, k)."""
    first, second = np.triu_indices(w.shape[1])
    return np.asarray(w[:, first] * w[:, second])


def _degrees_of_freedom(coordinates: int) -> float:
    """Of proposals' Student tails."""
    return max(MIN_DOF, DOF_PER_COORDINATE * coordinates)


def draw_student(
    random: np.random.Generator | np.random.RandomState, shape: tuple[int, ...]
) -> Array:
    """Draws (m, d) of a Student t of unit scale."""
    normal = random.standard_normal(shape)
    dof = _degrees_of_freedom(shape[1])
    chi2 = random.chisquare(dof, (shape[0], 1))
    return np.asarray(normal / np.sqrt(chi2 / dof))


def log_student(white: Array) -> Array:
    """Log density (m,) of a Student t of unit scale at (m, d), up to a constant."""
    dof = _degrees_of_freedom(white.shape[1])
    power = -0.5 * (dof + white.shape[1])
    return np.asarray(power * np.log1p(np.sum(white**2, axis=1) / dof))


@dataclasses.dataclass(frozen=True)
class ApproximateDraws:
    """Draws of parameters (m, n), SI, and coordinates (m, d) of the law."""

    theta: Array
    noise_law: Array
    #: number of independent draws that they are worth; None: all
    worth: float | None = None
    #: (m, k) coefficients of effects that belong to them; k is 0 without effects
    effects: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


def draw_approximation(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    rng: np.random.Generator,
    count: int = N_DRAWS,
) -> ApproximateDraws:
    """Draws from the approximation, `count` of them or few less.

    y  (N,) the readings, SI

    Draws that cannot be assembled, or are out of bounds, are left out; in place of the
    latter others are drawn. Raises AssemblyError at the estimate, OutOfBoundsError where
    hardly any draw keeps to the bounds.
    """
    if estimate.effects is not None:
        count = len(estimate.effects.theta)
    target = LogDensity(measurement, series, y, estimate)
    parts: list[tuple[Array, Array, Array]] = []
    missing = count
    for _ in range(MAX_ROUNDS):
        z, laws, effects = draw_coordinates(estimate, rng, count)
        theta = target.draw_theta(rng, z)
        assembled = np.isfinite(theta).all(axis=1)
        inside = assembled & measurement.in_bounds(theta)
        chosen = np.flatnonzero(inside)[:missing]
        parts.append((theta[chosen], laws[chosen], effects[chosen]))
        missing -= len(chosen)
        if missing == 0 or (inside == assembled).all():
            theta, laws, effects = map(np.concatenate, zip(*parts, strict=True))
            return ApproximateDraws(theta, laws, effects=effects)
    raise OutOfBoundsError(measurement, theta[assembled])


def draw_coordinates(
    estimate: Estimate, rng: np.random.Generator, count: int
) -> tuple[Array, Array, Array]:
    """Draws of z (m, r), of law coordinates (m, d), of effects (m, k), as drawn."""
    posterior = estimate.noise_posterior
    none = np.zeros((count, 0))
    if estimate.effects is not None and posterior is not None:
        sampled = estimate.effects
        number = rng.permutation(np.arange(count) % len(sampled.theta))
        z = estimate.coordinates.from_theta(sampled.theta[number])
        return z, posterior.draw(rng, count)[1], sampled.coefficients[number]
    if posterior is not None:
        return *posterior.draw(rng, count), none
    dual = estimate.coordinates.dual
    root = covariance_root(dual @ estimate.covariance @ dual.T)
    normal = rng.standard_normal((count, len(estimate.z)))
    return estimate.z + normal @ root.T, none, none
