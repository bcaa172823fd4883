"""The last stage of a fit with the noise law estimated, and whether it is noise.

Hausman's test asks whether a law's weights suit the readings. In units of the stated noise,
readings about nominal are r = H z + e, with z ~ N(0, 1) and e of the law's covariance C.
Without correlated noise and levels of runs it is D. Two estimates of z are unbiased if the law is true:

    by the law        G H^T C^-1 r,      G = (1 + H^T C^-1 H)^-1,
    by D alone        A^-1 H^T D^-1 r,   A = 1 + H^T D^-1 H,

and their difference d has the covariance V = S - G (Hausman 1978, Econometrica 46:1251),
S = A^-1 (1 + H^T D^-1 C D^-1 H) A^-1. What the model lacks is no noise: the law then favours
channels that parameters can be bent to, and differences of neighbouring readings, and d is
too large. Tested is the sum of squares that the law's estimate adds, d^T H^T D^-1 H d.

Where it is too large, or the law carries along more than a stated noise can be wrong by,
readings have their stated weights, as in least squares. Noise and tolerances are the stated
ones, T, times a factor w that makes the variances of the estimate what they are under the
law, on average over its r directions (Pauli, Racugno and Ventura 2011):

    w^2 = tr[(H^T T^-1 H)^-1 H^T T^-1 C T^-1 H] / r.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy

from oed.base import Array
from oed.estimation.coordinates import IdentifiableCoordinates
from oed.estimation.estimate import Estimate
from oed.estimation.fit_stages import ReadingsFit, last_stage
from oed.measurement import reading_structure
from oed.noise import Errors, Laws, LinearFactor, Noise, ReadingStructure
from oed.noise_law import (
    KNOWN_TO,
    MIN_FREEDOM,
    NoisePrior,
    ResidualModel,
    robust_residuals,
)

MAX_ROUNDS = 6  #: rounds of fit and noise law
#: change of a law's coordinates, prior standard deviations, at which the rounds end
LAW_TOLERANCE = 0.03
#: probability of a larger difference below which the law's weights are not used: the
#: usual level of a test, as a wrong law costs far more than plain weights
P_CONTRADICTED = 0.05
#: correlated noise of a run, over the stated noise, from which it is none of the
#: instrument's: two standard deviations of what a statement is good for
MAX_CORRELATED = KNOWN_TO**2
VARIANCE_TOLERANCE = 1e-9  #: share of a variance below which it is rounding


@dataclasses.dataclass(frozen=True, eq=False)
class SettledLaw:
    """The most probable law, and the linear model about the fit with it."""

    model: ResidualModel
    law: Laws
    prior: NoisePrior  #: of the law
    mode: Array  #: (d,) its coordinates
    noise: Noise  #: under it
    coordinates: IdentifiableCoordinates  #: of the fit
    robust: ReadingsFit  #: the fit, with readings far off replaced
    iterations: int  #: of the last fit
    #: whether the law changed by less than `LAW_TOLERANCE` in the last round
    has_settled: bool


def integrated_stage(
    fit: ReadingsFit, theta: Array, patterns: Sequence[str], near: Estimate | None
) -> Estimate:
    """The last stage from theta (n,), with the noise law integrated over.

    Where readings speak against the law's weights (`check_law`), they have the stated
    ones. What the model lacks passes for a course: the law has one only where it is not
    contradicted without, or where single readings scatter as stated beside it.
    """
    first = last_stage(fit, theta, patterns)
    structure, with_course = structure_and_prior(fit, first)
    prior = with_course.without(NoisePrior.COURSE)
    settled = settle_law(fit, first, structure, prior, mode_of(near, prior))
    model = settled.model
    about_nominal = model.residual + model.slopes @ model.centre
    check = check_law(structure, settled.law, about_nominal, model.slopes)
    robust = settled.robust
    if NoisePrior.COURSE in with_course.names:
        mode = mode_of(near, with_course)
        settled = settle_law(fit, first, structure, with_course, mode)
    if not check.is_contradicted:
        estimate = integrate_settled(fit, first, settled)
        return dataclasses.replace(estimate, law_check=check)
    law = settled.law
    # of single readings and levels of runs
    scatter = law.scale[0] * np.hypot(1.0, law.level[0])
    if NoisePrior.COURSE in with_course.names and scatter.max() <= KNOWN_TO:
        return integrate_settled(fit, first, settled)
    return _stated_weights(robust, fit, first, check)


def _stated_weights(
    robust: ReadingsFit, fit: ReadingsFit, first: Estimate, check: "LawCheck"
) -> Estimate:
    """The fit, far readings replaced, by stated weights with the law's intervals."""
    (stage,) = first.stages
    by_stated = last_stage(robust, first.theta, stage.patterns)
    estimate = by_stated.widened(check.widening)
    residuals = fit.residuals(estimate.theta)
    white = fit.stated.whiten(residuals)
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
    prior = NoisePrior.of(structure, freedom)
    if effects:  # which have courses of their own
        prior = prior.without(NoisePrior.COURSE)
    if effects and freedom < MIN_FREEDOM:
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
    first: Estimate,
    structure: ReadingStructure,
    prior: NoisePrior,
    near: Array | None = None,
) -> SettledLaw:
    """Fit, outliers, law in turn, from law coordinates (d,) or as stated."""
    theta = first.theta
    noise = fit.stated
    law = Laws.stated(structure)
    if near is not None:
        law = prior.laws(near[None])
        noise = law.noise(structure)
    robust = fit
    mode = near
    has_settled = False
    for _ in range(MAX_ROUNDS):
        coordinates = fit.coordinates(theta, first.prior_sd)
        z, iterations = robust.solve(noise, coordinates, theta)
        theta = coordinates.to_theta(z)
        residual, slopes = fit.linearise(structure, coordinates, theta)
        about_nominal = residual + slopes @ z
        clean = robust_residuals(structure, law, about_nominal, slopes)
        replaced = clean - slopes @ z
        change = structure.restore(replaced - residual)
        robust = dataclasses.replace(fit, y=fit.y + change)
        model = ResidualModel(structure, replaced, slopes, z)
        before = mode
        mode = probable = model.most_probable(prior, mode)
        law = prior.laws(probable[None])
        noise = law.noise(structure)
        if before is not None and np.abs(probable - before).max() < LAW_TOLERANCE:
            has_settled = True
            break
    return SettledLaw(
        model=model,
        law=law,
        prior=prior,
        mode=probable,
        noise=noise,
        coordinates=coordinates,
        robust=robust,
        iterations=iterations,
        has_settled=has_settled,
    )


def integrate_settled(
    fit: ReadingsFit, first: Estimate, settled: SettledLaw
) -> Estimate:
    """The estimate with the law integrated over, from that with the stated noise."""
    coordinates = settled.coordinates
    posterior = settled.model.integrate(settled.prior, settled.mode)
    theta = coordinates.to_theta(settled.model.centre)
    theta = fit.closing(theta, coordinates.to_theta(posterior.mean))
    residuals = fit.residuals(theta)
    white = fit.stated.whiten(residuals)
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


@dataclasses.dataclass(frozen=True)
class LawCheck:
    """How far the estimate by a law is from the one by its variances alone."""

    ratio: float  #: of the sum of squares between them to what the law lets expect
    probability: float  #: of a larger one if what the law describes is noise
    #: w: sd of an estimate by stated weights under the law, over the stated one
    widening: float
    #: standard deviation of what readings have in common with their neighbours, over
    #: the stated noise; 0 where that is an assumption
    correlated: float = 0.0

    @property
    def is_noise(self) -> bool:
        """Whether neighbouring readings have no more in common than noise can."""
        return self.correlated <= MAX_CORRELATED

    @property
    def is_contradicted(self) -> bool:
        """Whether the readings speak against the law's weights."""
        return self.probability < P_CONTRADICTED or not self.is_noise


def check_law(
    structure: ReadingStructure, law: Laws, residual: Array, slopes: Array
) -> LawCheck:
    """The test for standardised readings about nominal.

    law       the first of them is tested
    residual  (N,) readings less those of nominal parameters
    slopes    (N, r) over z
    """
    errors = law.errors(structure)
    one = np.eye(slopes.shape[1])
    none = np.zeros(len(law))
    scale = law.scale * np.sqrt(1.0 + law.level**2)[:, None]
    same_variances = dataclasses.replace(law, scale=scale, correlated=none, level=none)
    weighted = same_variances.factor(structure).precision(slopes)
    information = slopes.T @ weighted
    by_variances = np.linalg.inv(one + information)
    between = one + errors.covariance_of(weighted)
    white = law.factor(structure).whiten(np.column_stack([residual, slopes]))
    gram = white[:, 1:].T @ white
    by_law = np.linalg.inv(one + gram[:, 1:])
    difference = by_variances @ (weighted.T @ residual) - by_law @ gram[:, 0]
    expected = information @ (by_variances @ between @ by_variances - by_law)
    total = float(difference @ information @ difference)
    ratio, probability = _satterthwaite(total, expected)
    stated = Laws.stated(structure).factor(structure)
    widening = _widening(slopes, stated, errors)
    correlated = 0.0
    if not structure.statement.is_assumed:  # of the group in which it is largest
        correlated = float(law.scale[0].max() * np.sqrt(law.correlated[0]))
    return LawCheck(ratio, probability, widening, correlated)


def _widening(slopes: Array, stated: LinearFactor, errors: Errors) -> float:
    """w, over the directions that slopes (N, r) determine."""
    weighted = stated.precision(slopes)
    values, vectors = np.linalg.eigh(slopes.T @ weighted)
    determined = values > VARIANCE_TOLERANCE * values.max(initial=0.0)
    if not determined.any():
        return 1.0
    root = vectors[:, determined] / np.sqrt(values[determined])
    variances = np.diag(errors.covariance_of(weighted @ root))
    return float(np.sqrt(np.mean(variances)))


def _satterthwaite(total: float, expected: Array) -> tuple[float, float]:
    """Ratio to the mean, and p-value, of weighted squares (Satterthwaite 1946)."""
    mean = float(np.trace(expected))
    spread = 2.0 * float(np.trace(expected @ expected))
    if mean <= VARIANCE_TOLERANCE * len(expected) or spread <= 0.0:
        return 0.0, 1.0
    dof = 2.0 * mean**2 / spread
    ratio = total / mean
    return ratio, float(scipy.special.chdtrc(dof, ratio * dof))
