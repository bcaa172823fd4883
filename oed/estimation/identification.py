"""Identification: a fit of the exact nonlinear readings, with tolerance priors.

Where asked for, the noise law is estimated from the readings too and integrated over
(`oed.noise_law.marginal`): theta is the mean over laws, its covariance holds what is
not known of the noise. Many machines at once, with known noise, are fitted over u,
theta = nominal + T u, T the root of the prior covariance: at the minimum u has no part
in directions that no reading determines.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import scipy

from oed.base import Array, Index
from oed.estimation.coordinates import IdentifiableCoordinates, ReadingsProblem
from oed.estimation.discrepancy import (
    Discrepancy,
    EffectDraws,
    SampledEffects,
    sample_effects,
)
from oed.estimation.estimate import Estimate, add_warnings
from oed.estimation.fit_stages import (
    IdentificationError,
    ReadingsFit,
    last_stage,
    preliminary_stage,
)
from oed.estimation.fitter import MAX_LAST_STEP, minimise
from oed.estimation.law_stage import (
    integrate_settled,
    integrated_stage,
    mode_of,
    settle_law,
    structure_and_prior,
)
from oed.linear_algebra import precision_root
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.noise import Laws, Noise, ReadingStructure
from oed.noise_law import NoisePrior, ResidualModel, robust_residuals

# Parameters, effects and noise law together: the effects' draws.
#
# Residuals about nominal parameters are r = H z + G b + e, with z ~ N(0, I), the effects'
# coefficients b of an uncertain common size and e of a noise law. In turn, size and
# coefficients are drawn under a law (`oed.estimation.discrepancy`), and the most probable
# law is found with the effects at the sizes drawn. A large error can pass for noise or for an
# effect: both the stated law and that of a fit without effects are starts, weighed by evidence.

N_ROUNDS = 3  #: rounds of effects and law
#: draws of the effects in a round: their root mean square is known to a tenth
ROUND_DRAWS = 150
N_DRAWS = 400  #: draws of the effects at the end: they are those of the result
#: singular values of the effects' columns, over the noise, below which they are left out
#: of the covariance
MIN_SIZE = 0.1


def stage_with_effects(
    fit: ReadingsFit,
    theta: Array,
    patterns: Sequence[str],
    discrepancy: Discrepancy,
    rng: np.random.Generator,
    near: Estimate | None,
) -> Estimate:
    """The last stage from theta (n,), with effects and noise law integrated over."""
    exact = last_stage(fit, theta, patterns)
    structure, prior = structure_and_prior(fit, exact, discrepancy.columns.shape[1])
    mode = mode_of(near, prior)
    if mode is None:
        settled = settle_law(fit, exact, structure, prior)
        theta = settled.coordinates.to_theta(settled.model.centre)
        mode = settled.mode
    starts: list[tuple[Array, Array | None]] = [(theta, mode)]
    if not discrepancy.is_small:  # what is large can pass for noise
        starts.insert(0, (exact.theta, None))
    alternation = _Alternation(fit, exact, structure, prior, discrepancy, rng)
    fits = [alternation.run(*start) for start in starts]
    weights = scipy.special.softmax([one.log_evidence for one in fits])
    number = rng.choice(len(fits), size=N_DRAWS, p=weights)
    best = fits[int(np.argmax(weights))]
    parts = [one.taken(np.flatnonzero(number == k)) for k, one in enumerate(fits)]
    coefficients, sizes, thetas, means = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    sampled = SampledEffects(
        discrepancy=discrepancy,
        coefficients=coefficients,
        size=sizes,
        theta=thetas,
        log_evidence=best.log_evidence - alternation.log_evidence_without(best),
    )
    theta = fit.closing(exact.theta, means.mean(axis=0))
    offsets = means - means.mean(axis=0)
    covariance = offsets.T @ offsets / len(offsets)
    for weight, one in zip(weights, fits, strict=True):
        covariance += weight * one.parameter_covariance()
    first = dataclasses.replace(exact, theta=theta)
    wide = dataclasses.replace(structure, effects=alternation.widened(sizes))
    final = settle_law(fit, first, wide, prior, best.mode)
    estimate = integrate_settled(fit, first, final)
    null = estimate.coordinates.null_basis
    residuals = fit.residuals(theta)
    white = fit.stated.whiten(residuals - sampled.changes)
    law_alone = prior.laws(best.mode[None]).noise(structure)
    jacobian = fit.measurement.jacobian(fit.series, theta)
    return dataclasses.replace(
        estimate,
        theta=theta,
        chi2=float(white @ white),
        dof=len(fit.y) - sampled.freedom(law_alone, jacobian),
        z=estimate.coordinates.from_theta(theta),
        covariance=covariance + null @ null.T,
        residuals=residuals,
        effects=sampled,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _LinearReadings:
    """Standardised readings to first order about some parameters."""

    coordinates: IdentifiableCoordinates  #: identifiable ones, z (r,)
    residual: Array  #: (N,) about nominal parameters, z = 0
    slopes: Array  #: (N, r) over z


@dataclasses.dataclass(frozen=True, eq=False)
class _Settled:
    """Draws of effects under a most probable law, and their evidence."""

    linear: _LinearReadings
    clean: Array  #: (N,) residuals about nominal, with those far off replaced
    draws: EffectDraws
    #: (m, r) of the coordinates, drawn given each draw of the effects, and means
    z: Array
    means: Array
    root: Array  #: (r, r) of the covariance of z given the effects
    mode: Array
    log_evidence: float

    def taken(self, rows: Index) -> tuple[Array, Array, Array, Array]:
        """Coefficients, sizes, parameters and mean parameters of some draws."""
        draws, to_theta = self.draws, self.linear.coordinates.to_theta
        return (
            draws.coefficients[rows],
            draws.size[rows],
            to_theta(self.z[rows]),
            to_theta(self.means[rows]),
        )

    def parameter_covariance(self) -> Array:
        """Covariance (n, n) of the parameters given the effects, SI."""
        spread = self.linear.coordinates.basis @ self.root
        return np.asarray(spread @ spread.T)


@dataclasses.dataclass(frozen=True, eq=False)
class _Alternation:
    """Effects and law in turn."""

    fit: ReadingsFit
    exact: Estimate
    structure: ReadingStructure
    prior: NoisePrior
    discrepancy: Discrepancy
    rng: np.random.Generator

    @functools.cached_property
    def columns(self) -> Array:
        """Columns (N, k) of the effects, standardised."""
        return self.structure.standardise(self.discrepancy.columns)

    def linearise(self, theta: Array) -> _LinearReadings:
        """Readings about parameters (n,), or nearer to those without effects."""
        fit = self.fit
        theta = fit.closing(self.exact.theta, theta)
        coordinates = fit.coordinates(theta, self.exact.prior_sd)
        residual, slopes = fit.linearise(self.structure, coordinates, theta)
        about_nominal = residual + slopes @ coordinates.from_theta(theta)
        return _LinearReadings(coordinates, about_nominal, slopes)

    def run(self, theta: Array, mode: Array | None) -> _Settled:
        """From parameters (n,) and coordinates (d,) of a law; None: the stated one."""
        law = Laws.stated(self.structure)
        if mode is None:
            mode = np.zeros(len(self.prior.names))
        else:
            law = self.prior.laws(mode[None])
        linear = self.linearise(theta)
        gram = self._gram(law, linear, linear.residual)
        draws = self._draw(gram, ROUND_DRAWS)
        for _ in range(N_ROUNDS):
            linear = self.linearise(theta)
            clean = self._clean(law, linear, draws)
            draws = self._draw(self._gram(law, linear, clean), ROUND_DRAWS)
            slopes = np.hstack([linear.slopes, self.widened(draws.size)])
            mode = self._most_probable_law(slopes, clean, mode)
            law = self.prior.laws(mode[None])
            gram = self._gram(law, linear, clean)
            means, _ = self._coordinates(gram, draws)
            theta = linear.coordinates.to_theta(means.mean(axis=0))
        draws = self._draw(gram, N_DRAWS)
        means, root = self._coordinates(gram, draws)
        z = means + self.rng.standard_normal(means.shape) @ root.T
        evidence = self._log_evidence(linear, clean, mode) + draws.log_evidence
        return _Settled(linear, clean, draws, z, means, root, mode, evidence)

    def log_evidence_without(self, fit: _Settled) -> float:
        """Log evidence without effects, under its own most probable law."""
        mode = self._most_probable_law(fit.linear.slopes, fit.clean, fit.mode)
        return self._log_evidence(fit.linear, fit.clean, mode)

    def widened(self, size: Array) -> Array:
        """Principal columns (N, k) that count, at the root mean square of sizes (m,)."""
        scaled = np.sqrt((size**2).mean()) * self.columns
        squares, axes = np.linalg.eigh(scaled.T @ scaled)
        return np.asarray(scaled @ axes[:, squares > MIN_SIZE**2])

    def _clean(self, law: Laws, linear: _LinearReadings, draws: EffectDraws) -> Array:
        """Residuals (N,) about nominal, with those far off replaced."""
        structure = dataclasses.replace(
            self.structure, effects=self.widened(draws.size)
        )
        return robust_residuals(structure, law, linear.residual, linear.slopes)

    def _gram(self, law: Laws, linear: _LinearReadings, clean: Array) -> Array:
        """Products, under a law, of the r slopes, clean residuals and effects' columns."""
        values = np.column_stack([linear.slopes, clean, self.columns])
        return np.asarray(law.whitening(self.structure).gram(values)[0])

    def _draw(self, gram: Array, count: int) -> EffectDraws:
        """Draws of the effects, with the parameters integrated out."""
        r = len(gram) - 1 - self.columns.shape[1]
        precision = gram[:r, :r] + np.eye(r)
        reduced = gram[r:, r:] - gram[r:, :r] @ np.linalg.solve(precision, gram[:r, r:])
        return sample_effects(
            0.5 * (reduced[1:, 1:] + reduced[1:, 1:].T),
            reduced[1:, 0],
            self.discrepancy.sizes,
            self.rng,
            count,
        )

    def _most_probable_law(self, slopes: Array, clean: Array, near: Array) -> Array:
        """Coordinates (d,) of the most probable law, unknowns of slopes integrated out."""
        return self._model(slopes, clean, near).most_probable(self.prior, near)

    def _log_evidence(
        self, linear: _LinearReadings, clean: Array, mode: Array
    ) -> float:
        """Log evidence without effects under a law at coordinates (d,), with their prior."""
        model = self._model(linear.slopes, clean, mode)
        solved = model.solve(self.prior.laws(mode[None]))
        return float(solved.log_marginal[0]) - 0.5 * float(mode @ mode)

    def _model(self, slopes: Array, clean: Array, mode: Array) -> ResidualModel:
        """Clean residuals as a linear model about its solution under a law."""
        middle = np.zeros(slopes.shape[1])
        model = ResidualModel(self.structure, clean, slopes, middle)
        centre = model.solve(self.prior.laws(mode[None])).mean[0]
        residual = clean - slopes @ centre
        if slopes.shape[1] > len(slopes):  # as many directions as readings are enough
            turned, triangle = np.linalg.qr(slopes.T)
            slopes, centre = triangle.T, turned.T @ centre
        return ResidualModel(self.structure, residual, slopes, centre)

    def _coordinates(self, gram: Array, draws: EffectDraws) -> tuple[Array, Array]:
        """Means (m, r) of z given each draw of the effects, and root (r, r) of its
        covariance.
        """
        r = len(gram) - 1 - self.columns.shape[1]
        root = precision_root(gram[:r, :r] + np.eye(r))
        score = gram[:r, r, None] - gram[:r, r + 1 :] @ draws.coefficients.T
        return np.asarray((score.T @ root) @ root.T), root


def identify(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
    estimate_noise: bool = False,
    noise: Noise | Array | None = None,
    start: Array | None = None,
    near: Estimate | None = None,
    max_iterations: int = 100,
    discrepancy: Discrepancy | None = None,
    rng: np.random.Generator | None = None,
) -> Estimate:
    """Fit all readings y (N,), SI.

    stages          patterns of parameter names, freed in turn ("dq*", then "*"). Stages
                    before the last only find a start: large errors of few parameters
                    are gone before the others are free. The tolerances hold about
                    nominal in all of them
    estimate_noise  estimate the noise law from the readings, and integrate over it;
                    otherwise the noise is as stated
    noise           of the readings; as stated by default
    start           (n,) where to begin; by default nominal, or as the controller holds
    near            an estimate of the same parameters from these readings, as with other
                    effects: its noise law is where that of this fit is sought from
    max_iterations  of each solution
    discrepancy     what effects that the model lacks can do to the readings. They are
                    integrated over with the noise law, which is then estimated
    rng             for their draws; a fixed seed by default

    Raises IdentificationError, and AssemblyError where the start cannot be assembled.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> deviations = (estimate.theta - truth) / estimate.sd
    >>> bool(np.abs(deviations[measurement.free]).max() < 4.0)
    True
    """
    stated = measurement.noise(series) if noise is None else Noise.of(noise)
    fit = ReadingsFit(measurement, series, y, stated, max_iterations)
    fit.check_readings()
    theta = measurement.start if start is None else start
    residuals_before = fit.residuals(theta)
    try:
        done = []
        for patterns in stages[:-1]:
            theta, stage = preliminary_stage(fit, theta, patterns)
            done.append(stage)
        if discrepancy is not None:
            rng = np.random.default_rng(0) if rng is None else rng
            estimate = stage_with_effects(
                fit, theta, stages[-1], discrepancy, rng, near
            )
        elif estimate_noise:
            estimate = integrated_stage(fit, theta, stages[-1], near)
        else:
            estimate = last_stage(fit, theta, stages[-1])
    except AssemblyError as error:
        raise IdentificationError(
            "every reading has a pose at the start, and after a step of the fit"
            f" {error.indices.size} poses do not close; give smaller tolerances, or free"
            " fewer parameters in a stage before"
        ) from error
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            "the fit went where readings or their slopes are not finite; give smaller"
            " tolerances, or free fewer parameters in a stage before"
        ) from error
    estimate = dataclasses.replace(
        estimate, residuals_before=residuals_before, stages=(*done, *estimate.stages)
    )
    return add_warnings(measurement, estimate)


#: distance to the minimum, in posterior standard deviations, at which a stage before the
#: last ends: it finds a start
MAX_LAST_START_STEP = 0.1
#: entries of the slopes of all machines that are computed at once: 32 MB
BATCH_ENTRIES = 4_000_000


def fit_machines(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
) -> Array:
    """Parameters theta (m, n), SI, of m machines with readings y (m, N), SI, freed in
    stages as in `identify`. Raises IdentificationError.
    """
    size = max(1, BATCH_ENTRIES // (y.shape[1] * len(measurement.parameters)))
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
        freed = measurement.freed(patterns)
        basis = measurement.prior_root(freed)[:, freed]
        origin = np.where(freed, measurement.nominal, theta)
        offset = (theta - origin)[:, freed]
        start = np.asarray(np.linalg.solve(basis[freed], offset.T).T, dtype=float)
        problem = ReadingsProblem(measurement, series, noise, y, origin, basis)
        precision = MAX_LAST_STEP if k == len(stages) else MAX_LAST_START_STEP
        minima = minimise(problem, start, precision=precision)
        theta = origin + minima.z @ basis.T
        converged &= minima.converged
    # a fit of its own says what is wrong
    for row in np.flatnonzero(~converged):
        theta[row] = identify(measurement, series, y[row], stages=stages).theta
    return theta
