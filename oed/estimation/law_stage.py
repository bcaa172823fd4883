"""The last stage of a fit with the noise law estimated and integrated over."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.estimation.estimate import Estimate
from oed.estimation.fit_stages import ReadingsFit, last_stage
from oed.estimation.law_check import LawCheck, check_law
from oed.measurement.reading_structure import reading_structure
from oed.noise.covariance import Noise
from oed.noise.law_noise import noise_under
from oed.noise.marginal import ResidualModel, integrate, most_probable
from oed.noise.prior import (
    COURSE,
    LEAST_FREEDOM,
    SCALE_SD,
    NoisePrior,
    noise_prior,
)
from oed.noise.process import Laws, stated_laws
from oed.noise.robust import robust_residuals
from oed.noise.structure import ReadingStructure

#: rounds of fit and noise law, and change of a law's coordinates, in prior standard
#: deviations, below which they have settled
NOISE_ROUNDS, SETTLED = 6, 0.03
#: factor to which a stated noise is good
KNOWN_TO = float(np.exp(SCALE_SD))


@dataclasses.dataclass(frozen=True, eq=False)
class LawFit:
    """An estimate with its law integrated over, and the linear model that this is of."""

    estimate: Estimate
    model: ResidualModel
    law: Laws


def integrated_stage(
    fit: ReadingsFit,
    stated: Noise,
    theta: Array,
    start_residuals: Array,
    patterns: Sequence[str],
) -> Estimate:
    """The last stage from theta (n,), with the noise law integrated over.

    Where the readings speak against the law's weights (`oed.estimation.law_check`), they
    have the stated ones, and the parameters the covariance that the law then gives them.
    What the model lacks passes for a course through the session where poses change
    smoothly. So the law has a course where it is not contradicted without one, or where
    single readings scatter as stated beside the course.
    """
    first = last_stage(fit, stated, theta, start_residuals, patterns)
    structure, with_course = structure_and_prior(fit, first)
    prior = with_course.without(COURSE)
    by_law = integrate_law(fit, stated, first, structure, prior)
    model = by_law.model
    about_nominal = model.residual + model.slopes @ model.centre
    check = check_law(structure, by_law.law, about_nominal, model.slopes)
    if COURSE in with_course.names:
        course = integrate_law(fit, stated, first, structure, with_course)
        if not check.is_contradicted:
            return dataclasses.replace(course.estimate, law_check=check)
        if _scatters_as_stated(course.law):
            return course.estimate
    if not check.is_contradicted:
        return dataclasses.replace(by_law.estimate, law_check=check)
    return _by_stated_weights(fit, stated, first, by_law.estimate, check)


def _scatters_as_stated(law: Laws) -> bool:
    """Whether single readings and levels of runs are within what a statement is good for."""
    scatter = law.scale[0] * np.hypot(1.0, law.level[0])
    return bool(scatter.max() <= KNOWN_TO)


def _by_stated_weights(
    fit: ReadingsFit, stated: Noise, first: Estimate, by_law: Estimate, check: LawCheck
) -> Estimate:
    """The fit with stated weights, of a noise that the readings' law makes wider.

    first   estimate with the stated noise;  by_law  with the estimated law
    """
    y = fit.y if by_law.robust_readings is None else by_law.robust_readings
    robust = dataclasses.replace(fit, y=y)
    wider = stated.scaled(np.full(len(y), check.widening))
    (stage,) = first.stages
    before = first.residuals_before
    estimate = last_stage(robust, wider, first.theta, before, stage.patterns)
    return dataclasses.replace(
        estimate,
        residuals=fit.residuals(estimate.theta),
        stages=(dataclasses.replace(stage, iterations=estimate.stages[-1].iterations),),
        chi2=first.chi2,
        dof=first.dof,
        robust_readings=y,
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


def integrate_law(
    fit: ReadingsFit,
    stated: Noise,
    first: Estimate,
    structure: ReadingStructure,
    prior: NoisePrior,
    near: Array | None = None,
) -> LawFit:
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
    estimate = dataclasses.replace(
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
    return LawFit(estimate, model, law)
