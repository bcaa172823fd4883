"""Log evidence of readings: parameters, noise law and tolerances integrated out.

At the most probable parameters the readings are linear in them. Their density is that of
normal errors of each of a grid of laws (a scale, an error of a run, one that is carried
along it), with the prior of the laws as weight, and of rivals that no law holds:
tolerances that are too narrow, and more noise in one channel of several.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy import special

from oed.base import Array, Mask
from oed.checks.fit import Fit
from oed.checks.screening import log_density_by_scale, scales_of_noise
from oed.checks.session import SessionReadings
from oed.measurement import reading_structure
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePrior, ResidualModel, log_prior_of_scale
from oed.trust import GUESS_RATIO

#: coordinates of the laws that are looked at: error of a run, carried share and reach
LEVELS, SHARES, REACHES = (-2.0, 0.0, 1.5, 3.0), (-1.5, 0.3, 1.8), (0.0, 1.5)
#: share of the prior of no rival, and of all rivals
PLAIN, UNUSUAL = 0.6, 0.4
#: factor between sizes of a rival, and largest one on the tolerances
SIZE_STEP, WIDEST = 4.0, 100.0


def linear_readings(solution: Fit) -> ResidualModel:
    """Readings linear at a fit, about the prior's middle."""
    session = solution.session
    measurement, series = session.measurement, session.series
    structure = reading_structure(measurement, series, solution.theta)
    jacobian = measurement.jacobian(series, solution.theta)
    slopes = structure.standardise(jacobian @ session.prior_root())
    y = session.y - measurement.readings(series, solution.theta)
    residual = structure.standardise(y) + slopes @ solution.departure
    return ResidualModel(structure, residual, slopes, 0.0 * solution.departure)


def log_evidence(
    linear: ResidualModel, session: SessionReadings, *, with_rivals: bool
) -> float:
    """Log density of the readings, SI; with rivals that no law holds, or without."""
    structure = linear.structure
    laws, weights = law_grid(structure)
    scales = scales_of_noise(linear.residual)
    alone = _log_marginal(linear, linear.slopes, laws, weights, scales)
    terms = [float(np.log(PLAIN)) + alone]
    few = _few(laws, weights)
    rivalling = rivals(session) if with_rivals else []
    for rival in rivalling:
        log_share = float(np.log(UNUSUAL / len(rivalling)))
        terms.append(log_share + _with_rival(linear, rival, *few, scales))
    constant = structure.log_unit + 0.5 * len(structure) * float(np.log(2.0 * np.pi))
    return float(special.logsumexp(terms)) - constant


def rivals(session: SessionReadings) -> list[Mask | None]:
    """Values (N,) that may have more noise: one channel of several.

    None stands for tolerances that are too narrow.
    """
    channel = session.values.groupby(["setup", "channel"], sort=False).ngroup()
    number = channel.to_numpy()
    groups = np.unique(number)
    return [None, *(number == g for g in groups if len(groups) > 1)]


def _with_rival(
    linear: ResidualModel,
    noisier: Mask | None,
    laws: Laws,
    weights: Array,
    scales: Array,
) -> float:
    """Log density with a rival of unknown size: a factor on tolerances, or on noise."""
    largest = WIDEST
    if noisier is not None:
        largest = 3.0 * float(np.sqrt(np.mean(linear.residual**2))) + SIZE_STEP
    count = max(1, int(np.log(largest) / np.log(SIZE_STEP)))
    values = []
    for size in SIZE_STEP ** np.arange(1, count + 1):
        slopes = size * linear.slopes
        factor = np.ones(len(linear.residual))
        if noisier is not None:
            factor[noisier] = 1.0 / size
            slopes = factor[:, None] * linear.slopes
        one = dataclasses.replace(linear, residual=factor * linear.residual)
        most = GUESS_RATIO * float(factor.min())
        log_density = _log_marginal(one, slopes, laws, weights, scales, most)
        values.append(log_density + float(np.log(factor).sum()))
    return float(special.logsumexp(values)) - float(np.log(len(values)))


def law_grid(structure: ReadingStructure) -> tuple[Laws, Array]:
    """Laws (L,) of unit scale, and log prior weights (L,)."""
    # What a course takes up is a finding of these checks, not their noise.
    prior = NoisePrior.of(structure).without(NoisePrior.COURSE)
    axes: list[tuple[float, ...]] = [(0.0,)] * prior.dimensions
    for name, values in (
        (NoisePrior.RUN, LEVELS),
        (NoisePrior.CORRELATED, SHARES),
        (NoisePrior.REACH, REACHES),
    ):
        if name in prior.names:
            axes[prior.names.index(name)] = values
    u = np.array(list(itertools.product(*axes)))
    log_prior = -0.5 * (u**2).sum(axis=1)
    return prior.laws(u), log_prior - special.logsumexp(log_prior)


def _few(laws: Laws, weights: Array) -> tuple[Laws, Array]:
    """The likeliest of some laws: a rival stands for what the others hold."""
    best = np.argsort(-weights)[:4]
    some = laws.take([int(k) for k in best])
    return some, weights[best] - special.logsumexp(weights[best])


def _log_marginal(
    linear: ResidualModel,
    slopes: Array,
    laws: Laws,
    weights: Array,
    scales: Array,
    most: float = GUESS_RATIO,
) -> float:
    """Log density over the unit, by laws of every scale.

    most  error of a run over the stated noise: beyond that is a mistake, and no noise
    """
    whitening = laws.whitening(linear.structure)
    gram = whitening.gram(np.column_stack([linear.residual, slopes]))
    values, vectors = np.linalg.eigh(gram[:, 1:, 1:])
    squares = np.einsum("lij,li->lj", vectors, gram[:, 1:, 0]) ** 2
    log_density = log_density_by_scale(
        np.maximum(values, 0.0), squares, gram[:, 0, 0], scales
    )
    log_density -= 0.5 * whitening.log_determinant[:, None]
    log_density -= len(linear.residual) * np.log(scales)
    is_assumed = linear.structure.statement.is_assumed
    prior = log_prior_of_scale(scales, is_assumed=is_assumed)
    prior = prior - special.logsumexp(prior)
    is_noise = laws.level[:, None] * scales <= most
    log_density += weights[:, None] + prior
    return float(special.logsumexp(log_density[is_noise]))
