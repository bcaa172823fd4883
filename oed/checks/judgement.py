"""How readings fit: by the stated noise, or by the law that a fit estimates.

Errors that the readings of a run share, errors that are carried along it, and heavy tails
are noise and no misfit: they are estimated, with the prior that an identification has.
Whether single readings scatter as stated is judged after them.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg, special

from oed.base import Array, Index, Mask
from oed.checks.fit import (
    Fit,
    Goodness,
    goodness,
    goodness_of,
    goodness_of_estimate,
    residual_weights,
)
from oed.checks.outliers import OutlierSearch, find_outliers
from oed.checks.screening import linear_readings
from oed.checks.session import CheckedLaw, SessionReadings
from oed.estimation import Estimate
from oed.fit_limits import ALARM_PROBABILITY, GUESS_RATIO
from oed.measurement import Measurement, Series
from oed.noise import Laws, ReadingStructure
from oed.noise_law import (
    KNOWN_TO,
    MIN_FREEDOM,
    NoisePrior,
    ResidualModel,
    robust_residuals,
)


@dataclasses.dataclass(frozen=True)
class Judgement:
    """How the readings of a session fit."""

    #: readings far from what all others predict; None where there is no fit
    outliers: OutlierSearch | None
    fitted: Goodness | None  #: residuals of the others against the noise
    sound: bool  #: whether nothing asks for an explanation, by the law
    stated: bool  #: the same by the stated noise
    #: `fitted` by the stated noise, where an estimated law explains more; None elsewhere
    as_stated: Goodness | None = None


def judge(
    session: SessionReadings, suspects: Index, *, estimated: bool, robust: bool
) -> Judgement:
    """Judge readings, those of `suspects` (by number) left out of the first fit."""
    search = find_outliers(session, suspects, robust=robust)
    if search is None:
        return Judgement(None, None, sound=False, stated=False)
    solution = search.rest
    fitted = goodness(solution)
    p_strain = probability_of_strain(solution.slopes, solution.linear_residual())
    stated = _judgement(search, fitted, p_strain)
    # parameters outside their tolerances may have taken a mistake in
    strained = p_strain < ALARM_PROBABILITY
    fits = not (fitted.too_large or fitted.too_small or strained)
    ratio = fitted.ratio
    if not estimated or ratio is None or fitted.dof < MIN_FREEDOM:
        return stated
    is_tiny = fitted.too_small and ratio < KNOWN_TO**-2
    fits = (fits and not search.exhausted) or is_tiny
    if fits or ratio > GUESS_RATIO:
        return stated
    suspects = np.union1d(suspects, np.array(search.readings, dtype=np.intp))
    by_law = _judge_by_law(session, suspects, solution, robust=robust)
    if by_law is None:
        return stated
    return dataclasses.replace(by_law, stated=stated.sound, as_stated=fitted)


def _judge_by_law(
    session: SessionReadings, suspects: Index, solution: Fit, *, robust: bool
) -> Judgement | None:
    """The same by a law estimated at a fit; None where that explains no more."""
    law, _ = estimated_law(solution)
    ruled = dataclasses.replace(session, law=law.with_scale(1.0, np.inf))
    search = find_outliers(ruled, suspects, robust=robust)
    if search is None:
        return None
    law, model = estimated_law(search.rest)
    if law.size(model.structure) > GUESS_RATIO:
        return None
    p_low, p_high, p_strain = _probabilities_under(law, model)
    fitted = dataclasses.replace(
        goodness(search.rest), law_p_low=p_low, law_p_high=p_high
    )
    if fitted.too_large:
        return None
    return _judgement(search, fitted, p_strain)


def _judgement(search: OutlierSearch, fitted: Goodness, p_strain: float) -> Judgement:
    few = len(search.readings) < 2 and not search.exhausted
    sound = few and not fitted.too_large and p_strain >= ALARM_PROBABILITY
    return Judgement(search, fitted, sound=sound, stated=sound)


def probability_of_strain(slopes: Array, residual: Array) -> float:
    """Probability that correct parameters leave their tolerances as far.

    Of whitened slopes (N, r) with singular values s, components vary by 1 + s^2.
    """
    directions, singular, _ = linalg.svd(slopes, full_matrices=False)
    scaled = (directions.T @ residual) / np.hypot(1.0, singular)
    return float(special.chdtrc(len(singular), float(scaled @ scaled)))


def estimated_law(solution: Fit) -> tuple[CheckedLaw, ResidualModel]:
    """The most probable law of readings linear at a fit, and these without their tails."""
    linear = linear_readings(solution)
    structure = linear.structure
    prior = NoisePrior.of(structure, len(structure) - linear.slopes.shape[1])
    laws: Laws = Laws.stated(structure)
    z = solution.departure
    mode = None
    for _ in range(3):
        clean = robust_residuals(structure, laws, linear.residual, linear.slopes)
        model = ResidualModel(structure, clean - linear.slopes @ z, linear.slopes, z)
        mode = model.most_probable(prior, mode)
        laws = prior.laws(mode[None])
        z = model.solve(laws).mean[0]
    return _checked_law(structure, laws, solution.theta), model


def _checked_law(structure: ReadingStructure, laws: Laws, theta: Array) -> CheckedLaw:
    scale = dict(zip(structure.names, laws.scale[0].tolist(), strict=True))
    return CheckedLaw(scale, laws, theta)


def goodness_of_delivered(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    doubtful: Mask | None = None,
) -> Goodness:
    """Goodness of delivered parameters, of readings y (N,), SI, without `doubtful` (N,)
    ones, by the law as well where it is estimated.
    """
    fitted = goodness_of_estimate(measurement, series, estimate, doubtful)
    posterior, robust = estimate.noise_posterior, estimate.robust_readings
    if posterior is None or robust is None:
        return fitted
    structure = posterior.structure
    jacobian = measurement.jacobian(series, estimate.theta)
    slopes = structure.standardise(jacobian @ estimate.coordinates.basis)
    residual = structure.standardise(estimate.residuals + robust - y)
    model = ResidualModel(structure, residual, slopes, estimate.z)
    laws = posterior.prior.laws(posterior.mode[None])
    law = _checked_law(structure, laws, estimate.theta)
    p_low, p_high, _ = _probabilities_under(law, model)
    return dataclasses.replace(fitted, law_p_low=p_low, law_p_high=p_high)


def _probabilities_under(
    law: CheckedLaw, model: ResidualModel
) -> tuple[float, float, float]:
    """Probabilities of less and of more, and that of strain, under a law of the
    largest or the least scale that a stated one is good for.
    """
    stated, p_stated = _scaled_probabilities(law, model, 1.0)
    large, p_large = _scaled_probabilities(law, model, KNOWN_TO)
    small, _ = _scaled_probabilities(law, model, 1.0 / KNOWN_TO)
    p_low, p_high = max(stated.p_low, small.p_low), max(stated.p_high, large.p_high)
    return p_low, p_high, max(p_stated, p_large)


def _scaled_probabilities(
    law: CheckedLaw, model: ResidualModel, scale: float
) -> tuple[Goodness, float]:
    """The same where single readings scatter by a factor on the stated noise."""
    structure = model.structure
    laws = law.with_scale(scale, scale).laws(structure)
    misfit = float(model.solve(laws).misfit[0])
    about_nominal = model.residual + model.slopes @ model.centre
    both = np.column_stack([about_nominal, model.slopes])
    white = laws.factor(structure).whiten(both)
    p_strain = probability_of_strain(white[:, 1:], white[:, 0])
    return goodness_of(misfit, residual_weights(white[:, 1:])), p_strain
