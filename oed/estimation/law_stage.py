"""The last stage of a fit with the noise law estimated and integrated over."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.estimation.coordinates import IdentifiableCoordinates
from oed.estimation.estimate import Estimate
from oed.estimation.fit_stages import ReadingsFit, last_stage
from oed.estimation.law_check import LawCheck, check_law
from oed.measurement import reading_structure
from oed.noise.covariance import Noise
from oed.noise.law_noise import noise_under
from oed.noise.marginal import ResidualModel, integrate, most_probable
from oed.noise.outliers import robust_residuals
from oed.noise.prior import (
    COURSE,
    KNOWN_TO,
    LEAST_FREEDOM,
    NoisePrior,
    noise_prior,
)
from oed.noise.process import Laws, stated_laws
from oed.noise.structure import ReadingStructure

#: rounds of fit and noise law, and change of a law's coordinates, in prior standard
#: deviations, below which they have settled
NOISE_ROUNDS, SETTLED = 6, 0.03


@dataclasses.dataclass(frozen=True, eq=False)
class SettledLaw:
    """The most probable law, and the linear model about the fit with it.

    prior        of the law
    mode         (d,) its coordinates
    noise        under it
    coordinates  of the fit
    robust       the fit, with readings far off replaced
    iterations   of the last fit
    """

    model: ResidualModel
    law: Laws
    prior: NoisePrior
    mode: Array
    noise: Noise
    coordinates: IdentifiableCoordinates
    robust: ReadingsFit
    iterations: int


def integrated_stage(
    fit: ReadingsFit,
    stated: Noise,
    theta: Array,
    start_residuals: Array,
    patterns: Sequence[str],
    near: Estimate | None = None,
) -> Estimate:
    """The last stage from theta (n,), with the noise law integrated over.

    near  an estimate from these readings, whose law is where the law is sought from

    Where the readings speak against the law's weights (`oed.estimation.law_check`), they
    have the stated ones, and the parameters the covariance that the law then gives them.
    What the model lacks passes for a course through the session where poses change
    smoothly. So the law has a course where it is not contradicted without one, or where
    single readings scatter as stated beside the course.
    """
    first = last_stage(fit, stated, theta, start_residuals, patterns)
    structure, with_course = structure_and_prior(fit, first)
    prior = with_course.without(COURSE)
    settled = settle_law(fit, stated, first, structure, prior, mode_of(near, prior))
    model = settled.model
    about_nominal = model.residual + model.slopes @ model.centre
    check = check_law(structure, settled.law, about_nominal, model.slopes)
    robust = settled.robust
    if COURSE in with_course.names:
        mode = mode_of(near, with_course)
        settled = settle_law(fit, stated, first, structure, with_course, mode)
    if not check.is_contradicted:
        estimate = integrate_settled(fit, first, settled)
        return dataclasses.replace(estimate, law_check=check)
    if COURSE in with_course.names and _scatters_as_stated(settled.law):
        return integrate_settled(fit, first, settled)
    return _by_stated_weights(robust, fit, stated, first, check)


def _scatters_as_stated(law: Laws) -> bool:
    """Whether single readings and levels of runs are within what a statement is good for."""
    scatter = law.scale[0] * np.hypot(1.0, law.level[0])
    return bool(scatter.max() <= KNOWN_TO)


def _by_stated_weights(
    robust: ReadingsFit,
    fit: ReadingsFit,
    stated: Noise,
    first: Estimate,
    check: LawCheck,
) -> Estimate:
    """The fit with stated weights, its intervals as wide as the readings' law makes them.

    robust  the fit with readings far off replaced;  first  with the stated noise
    """
    (stage,) = first.stages
    before = first.residuals_before
    by_stated = last_stage(robust, stated, first.theta, before, stage.patterns)
    estimate = by_stated.widened(check.widening)
    residuals = fit.residuals(estimate.theta)
    white = stated.whiten(residuals)
    return dataclasses.replace(
        estimate,
        residuals=residuals,
        stages=(dataclasses.replace(stage, iterations=estimate.stages[-1].iterations),),
        chi2=float(white @ white),
        dof=first.dof,
        robust_readings=robust.y,
        law_check=check,
    )


def structure_and_prior(
    fit: ReadingsFit, first: Estimate, effects: int = 0
) -> tuple[ReadingStructure, NoisePrior]:
    """Structure of the readings at an estimate, and prior of their noise law.

    effects  number of their coefficients. Where these leave no freedom, no reading tells
             of an assumed noise, and the assumption holds as if it were stated
    """
    structure = reading_structure(fit.measurement, fit.series, first.theta)
    freedom = len(structure) - first.coordinates.basis.shape[1] - effects
    prior = noise_prior(structure, freedom)
    if effects:  # which have courses of their own
        prior = prior.without(COURSE)
    if effects and freedom < LEAST_FREEDOM:
        statement = dataclasses.replace(structure.statement, is_assumed=False)
        prior = dataclasses.replace(prior, statement=statement)
    return structure, prior


def mode_of(estimate: Estimate | None, prior: NoisePrior) -> Array | None:
    """Coordinates (d,) of an estimate's law under a prior; None where it lacks some."""
    if estimate is None or estimate.noise_posterior is None:
        return None
    posterior = estimate.noise_posterior
    by_name = dict(zip(posterior.prior.names, posterior.mode, strict=True))
    if not by_name.keys() >= set(prior.names):
        return None
    return np.array([by_name[name] for name in prior.names])


def settle_law(
    fit: ReadingsFit,
    stated: Noise,
    first: Estimate,
    structure: ReadingStructure,
    prior: NoisePrior,
    near: Array | None = None,
) -> SettledLaw:
    """Fit, outliers and law in turn from an estimate.

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
        before, probable = mode, most_probable(model, prior, mode)
        mode = probable
        law = prior.laws(probable[None])
        noise = noise_under(structure, law)
        if before is not None and np.abs(probable - before).max() < SETTLED:
            break
    return SettledLaw(
        model, law, prior, probable, noise, coordinates, robust, iterations
    )


def integrate_settled(
    fit: ReadingsFit, first: Estimate, settled: SettledLaw
) -> Estimate:
    """The estimate with the law integrated over.

    first  estimate with the stated noise
    """
    coordinates = settled.coordinates
    posterior = integrate(settled.model, settled.prior, settled.mode)
    theta = coordinates.to_theta(settled.model.centre)
    theta = fit.closing(theta, coordinates.to_theta(posterior.mean))
    residuals = fit.residuals(theta)
    white = first.noise.whiten(residuals)
    basis, null = coordinates.basis, coordinates.null_basis
    stage = dataclasses.replace(first.stages[-1], iterations=settled.iterations)
    return dataclasses.replace(
        first,
        theta=theta,
        covariance=basis @ posterior.covariance @ basis.T + null @ null.T,
        coordinates=coordinates,
        z=posterior.mean,
        residuals=residuals,
        chi2=float(white @ white),
        noise=settled.noise,
        stages=(stage,),
        noise_posterior=posterior,
        robust_readings=settled.robust.y,
    )
