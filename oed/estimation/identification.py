"""Identification: a fit of the exact nonlinear readings, with tolerance priors.

Minimised is |W (y - f(theta))|^2 + |z|^2 over the identifiable coordinates z (see
`oed.estimation.coordinates`), where W whitens the noise. Where asked for, the noise law is
estimated from the readings too and integrated over (`oed.noise.marginal`): theta is the
mean over laws, its covariance holds what is not known of the noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.estimation import fit_warnings
from oed.estimation.coordinates import IdentifiableCoordinates, identifiable_coordinates
from oed.estimation.discrepancy import Discrepancy
from oed.estimation.effects_stage import EffectsStart, ReadingsAbout, fit_effects
from oed.estimation.estimate import Estimate, FitStage
from oed.estimation.fitter import minimise
from oed.estimation.readings_problem import ReadingsProblem
from oed.identifiability import information
from oed.measurement.measurement import Measurement, Series
from oed.measurement.reading_structure import reading_structure
from oed.noise.covariance import Noise, as_noise
from oed.noise.law_noise import noise_under
from oed.noise.marginal import ResidualModel, integrate, most_probable
from oed.noise.prior import NoisePrior, noise_prior
from oed.noise.process import stated_laws
from oed.noise.robust import robust_residuals
from oed.noise.structure import ReadingStructure

__all__ = ["Estimate", "IdentificationError", "identify"]

#: rounds of fit and noise law, and change of a law's coordinates, in prior standard
#: deviations, below which they have settled
NOISE_ROUNDS, SETTLED = 6, 0.03


class IdentificationError(RuntimeError):
    """The readings cannot be fitted: too few, not finite, or without convergence."""


def identify(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
    estimate_noise: bool = False,
    noise: Noise | Array | None = None,
    start: Array | None = None,
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
    fit = _Fit(measurement, series, y, max_iterations)
    fit.check_readings()
    stated = measurement.noise(series) if noise is None else as_noise(noise)
    theta = measurement.start if start is None else start
    residuals_before = residuals = fit.residuals(theta)
    done = []
    for patterns in stages[:-1]:
        theta, residuals, stage = _preliminary_stage(
            fit, stated, theta, residuals, patterns
        )
        done.append(stage)
    if discrepancy is not None:
        rng = np.random.default_rng(0) if rng is None else rng
        estimate = _stage_with_effects(
            fit, stated, theta, residuals, stages[-1], discrepancy, rng
        )
    else:
        last = _integrated_stage if estimate_noise else _last_stage
        estimate = last(fit, stated, theta, residuals, stages[-1])
    estimate = dataclasses.replace(
        estimate,
        residuals_before=residuals_before,
        stages=(*done, *estimate.stages),
    )
    sentences = fit_warnings.warnings(measurement, estimate)
    return dataclasses.replace(estimate, warnings=tuple(sentences))


@dataclasses.dataclass(frozen=True)
class _Fit:
    """Readings y (N,) of a measurement, and how they are fitted."""

    measurement: Measurement
    series: Sequence[Series]
    y: Array
    max_iterations: int

    def check_readings(self) -> None:
        """Raise IdentificationError for a wrong number of readings, or NaN."""
        expected = len(self.measurement.setup_of_readings(self.series))
        if self.y.shape != (expected,):
            raise IdentificationError(
                f"{expected} readings were planned, {self.y.shape} are given"
            )
        bad = np.flatnonzero(~np.isfinite(self.y))
        if bad.size:
            raise IdentificationError(
                f"readings number {bad[:5].tolist()} are not finite"
            )

    def tolerances(self, patterns: Sequence[str]) -> Array:
        """Prior standard deviations (n,), 0 where no pattern frees a parameter."""
        names = self.measurement.names
        freed = self.measurement.freed(patterns)
        if not freed.any():
            raise IdentificationError(
                f"the patterns {list(patterns)} free no parameter of {list(names)}"
            )
        return np.where(freed, self.measurement.tolerance, 0.0)

    def coordinates(
        self, theta: Array, noise: Noise, tolerance: Array
    ) -> IdentifiableCoordinates:
        """Identifiable coordinates with H taken at theta (n,)."""
        return identifiable_coordinates(
            self.measurement, self.series, theta, noise, tolerance
        )

    def residuals(self, theta: Array) -> Array:
        """y - f(theta) (N,), SI."""
        return self.y - self.measurement.readings(self.series, theta)

    def solve(
        self, noise: Noise, coordinates: IdentifiableCoordinates, theta: Array
    ) -> tuple[Array, int]:
        """Minimise over z, from theta (n,).

        Returns z (r,) and the number of evaluations of the readings.
        """
        problem = ReadingsProblem(
            self.measurement,
            self.series,
            noise,
            self.y[None],
            coordinates.origin[None],
            coordinates.basis,
        )
        start = coordinates.from_theta(theta)[None]
        minima = minimise(problem, start, steps=self.max_iterations)
        if not minima.converged[0]:
            rms = _rms(minima.residual[0])
            raise IdentificationError(
                f"the fit did not converge in {self.max_iterations} iterations (the"
                f" residuals are {rms:.3g} times the noise); check units and signs of the"
                " readings, or free fewer parameters in a stage before"
            )
        return minima.z[0], int(minima.evaluations[0])

    def covariance(
        self, theta: Array, noise: Noise, tolerance: Array
    ) -> tuple[Array, Array]:
        """Posterior covariance (n, n), SI, and leverage (N,) of each reading.

        The leverage is the share of a reading that the fit uses up.
        """
        freed = tolerance > 0.0
        white = noise.whiten(self.measurement.jacobian(self.series, theta))
        h = self.measurement.in_prior_units(white, freed)
        scaled = information.posterior_covariance(h)
        leverage = np.einsum("ij,jk,ik->i", h, scaled, h)
        return self.measurement.from_prior_units(scaled, freed), leverage


def _preliminary_stage(
    fit: _Fit,
    noise: Noise,
    theta: Array,
    residuals: Array,
    patterns: Sequence[str],
) -> tuple[Array, Array, FitStage]:
    """A stage that only finds a start: theta (n,), residuals (N,) there, a summary."""
    coordinates = fit.coordinates(theta, noise, fit.tolerances(patterns))
    z, iterations = fit.solve(noise, coordinates, theta)
    solution = coordinates.to_theta(z)
    after = fit.residuals(solution)
    stage = FitStage(
        patterns=tuple(patterns),
        iterations=iterations,
        rms_before=_rms(noise.whiten(residuals)),
        rms_after=_rms(noise.whiten(after)),
    )
    return solution, after, stage


def _last_stage(
    fit: _Fit,
    noise: Noise,
    theta: Array,
    start_residuals: Array,
    patterns: Sequence[str],
) -> Estimate:
    """The last stage from theta (n,), with known noise."""
    tolerance = fit.tolerances(patterns)
    # Twice: the coordinates of the result are those of H at the result.
    for _ in range(2):
        coordinates = fit.coordinates(theta, noise, tolerance)
        z, iterations = fit.solve(noise, coordinates, theta)
        theta = coordinates.to_theta(z)
    residuals = fit.residuals(theta)
    covariance, leverage = fit.covariance(theta, noise, tolerance)
    white = noise.whiten(residuals)
    stage = FitStage(
        patterns=tuple(patterns),
        iterations=iterations,
        rms_before=_rms(noise.whiten(start_residuals)),
        rms_after=_rms(white),
    )
    return Estimate(
        theta=theta,
        covariance=covariance,
        prior_sd=tolerance,
        coordinates=coordinates,
        z=z,
        residuals=residuals,
        residuals_before=start_residuals,
        noise=noise,
        dof=len(fit.y) - float(leverage.sum()),
        chi2=float(white @ white),
        stages=(stage,),
        warnings=(),
    )


def _integrated_stage(
    fit: _Fit,
    stated: Noise,
    theta: Array,
    start_residuals: Array,
    patterns: Sequence[str],
) -> Estimate:
    """The last stage from theta (n,), with the noise law integrated over.

    Fit, outliers and law are found in turn until the most probable law has settled.
    """
    first = _last_stage(fit, stated, theta, start_residuals, patterns)
    return _integrate_law(fit, stated, first, *_structure_and_prior(fit, first))


def _structure_and_prior(
    fit: _Fit, first: Estimate
) -> tuple[ReadingStructure, NoisePrior]:
    """Structure of the readings at an estimate, and prior of their noise law."""
    structure = reading_structure(fit.measurement, fit.series, first.theta)
    freedom = len(structure) - first.coordinates.basis.shape[1]
    return structure, noise_prior(structure, freedom)


def _integrate_law(
    fit: _Fit,
    stated: Noise,
    first: Estimate,
    structure: ReadingStructure,
    prior: NoisePrior,
    near: Array | None = None,
) -> Estimate:
    """Fit, outliers and law in turn from an estimate; then the law is integrated over.

    near  (d,) coordinates of the law where they begin; the stated law by default
    """
    theta, noise, law = first.theta, stated, stated_laws(structure)
    if near is not None:
        law = prior.laws(near[None])
        noise = noise_under(structure, law)
    robust = fit
    mode = near
    for _ in range(NOISE_ROUNDS):
        coordinates = fit.coordinates(theta, stated, first.prior_sd)
        z, iterations = robust.solve(noise, coordinates, theta)
        theta = coordinates.to_theta(z)
        jacobian = fit.measurement.jacobian(fit.series, theta)
        slopes = structure.standardise(jacobian @ coordinates.basis)
        residual = structure.standardise(fit.residuals(theta))
        about_nominal = residual + slopes @ z
        clean = robust_residuals(structure, law, about_nominal, slopes)
        replaced = clean - slopes @ z
        change = structure.restore(replaced - residual)
        robust = dataclasses.replace(fit, y=fit.y + change)
        model = ResidualModel(structure, replaced, slopes, z)
        before, mode = mode, most_probable(model, prior, mode)
        law = prior.laws(mode[None])
        noise = noise_under(structure, law)
        if before is not None and np.abs(mode - before).max() < SETTLED:
            break
    posterior = integrate(model, prior, mode)
    theta = coordinates.to_theta(posterior.mean)
    residuals = fit.residuals(theta)
    basis, null = coordinates.basis, coordinates.null_basis
    stage = dataclasses.replace(first.stages[-1], iterations=iterations)
    return dataclasses.replace(
        first,
        theta=theta,
        covariance=basis @ posterior.covariance @ basis.T + null @ null.T,
        coordinates=coordinates,
        z=posterior.mean,
        residuals=residuals,
        noise=noise,
        stages=(stage,),
        noise_posterior=posterior,
        robust_readings=robust.y,
    )


def _stage_with_effects(
    fit: _Fit,
    stated: Noise,
    theta: Array,
    start_residuals: Array,
    patterns: Sequence[str],
    discrepancy: Discrepancy,
    rng: np.random.Generator,
) -> Estimate:
    """The last stage from theta (n,), with effects and noise law integrated over."""
    exact = _last_stage(fit, stated, theta, start_residuals, patterns)
    structure, prior = _structure_and_prior(fit, exact)
    without = _integrate_law(fit, stated, exact, structure, prior)
    posterior = without.noise_posterior
    mode = None if posterior is None else posterior.mode
    starts = [EffectsStart(exact.theta, None), EffectsStart(without.theta, mode)]

    def linearise(about: Array) -> ReadingsAbout:
        coordinates = fit.coordinates(about, stated, exact.prior_sd)
        jacobian = fit.measurement.jacobian(fit.series, about)
        slopes = structure.standardise(jacobian @ coordinates.basis)
        z = coordinates.from_theta(about)
        residual = structure.standardise(fit.residuals(about)) + slopes @ z
        return ReadingsAbout(coordinates, residual, slopes)

    fitted = fit_effects(
        linearise,
        structure,
        prior,
        stated_laws(structure),
        discrepancy,
        starts,
        rng,
    )
    first = dataclasses.replace(exact, theta=fitted.theta)
    estimate = _integrate_law(fit, stated, first, fitted.structure, prior, fitted.mode)
    null = estimate.coordinates.null_basis
    residuals = fit.residuals(fitted.theta)
    white = stated.whiten(residuals - fitted.sampled.changes)
    law_alone = noise_under(structure, prior.laws(fitted.mode[None]))
    jacobian = fit.measurement.jacobian(fit.series, fitted.theta)
    return dataclasses.replace(
        estimate,
        theta=fitted.theta,
        chi2=float(white @ white),
        dof=len(fit.y) - fitted.sampled.freedom(law_alone, jacobian),
        z=estimate.coordinates.from_theta(fitted.theta),
        covariance=fitted.covariance + null @ null.T,
        residuals=residuals,
        effects=fitted.sampled,
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
