"""Log evidence of readings: parameters, noise law and unmodelled effects integrated out.

At the most probable parameters the readings are linear in them. Their density is that of
normal errors of each of a grid of laws (a scale, an error of a run, one that is carried
along it), with the prior of the laws as weight, and of rivals that no law holds: a drift
through the session, a smooth error over the poses, tolerances that are too narrow.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy import special

from oed.base.arrays import Array, Mask
from oed.checks.fit import Fit
from oed.checks.screening import log_density_by_scale, scales_of_noise
from oed.checks.session import SessionReadings
from oed.measurement.reading_structure import reading_structure
from oed.noise.marginal import ResidualModel
from oed.noise.prior import (
    CARRIED,
    COURSE,
    REACH,
    RUN,
    log_prior_of_scale,
    noise_prior,
)
from oed.noise.process import Laws, Whitening
from oed.noise.structure import ReadingStructure
from oed.result.trust import GUESS

#: coordinates of the laws that are looked at: error of a run, carried share and reach
LEVELS, SHARES, REACHES = (-2.0, 0.0, 1.5, 3.0), (-1.5, 0.3, 1.8), (0.0, 1.5)
#: share of the prior of no effect, and of all rivals
PLAIN, UNUSUAL = 0.6, 0.4
#: factor between sizes of an effect
SIZE_STEP = 4.0
#: degree of a drift in the order of readings
DEGREE = 3


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


def _log_unit(structure: ReadingStructure) -> float:
    """Sum of the logs of the units of readings, SI."""
    if structure.decouple is None:
        return float(np.log(structure.unit).sum())
    return -float(np.log(structure.decouple.diagonal()).sum())


def log_evidence(
    linear: ResidualModel, session: SessionReadings, *, with_effects: bool
) -> float:
    """Log density of the readings, SI; with effects that no law holds, or without."""
    structure = linear.structure
    laws, weights = law_grid(structure)
    scales = scales_of_noise(linear.residual)
    alone = _log_marginal(linear, linear.slopes, laws, weights, scales)
    terms = [float(np.log(PLAIN)) + alone]
    few = _few(laws, weights)
    rivalling = rivals(session) if with_effects else []
    for rival in rivalling:
        log_share = float(np.log(UNUSUAL / len(rivalling)))
        terms.append(log_share + _with_rival(linear, rival, *few, scales))
    constant = _log_unit(structure) + 0.5 * len(structure) * float(np.log(2.0 * np.pi))
    return float(special.logsumexp(terms)) - constant


def _with_rival(
    linear: ResidualModel, rival: Rival, laws: Laws, weights: Array, scales: Array
) -> float:
    """Log density with an effect of unknown size."""
    largest = 3.0 * float(np.sqrt(np.mean(linear.residual**2))) + SIZE_STEP
    if rival.is_factor:
        largest = 100.0
    count = max(1, int(np.log(largest) / np.log(SIZE_STEP)))
    sizes = SIZE_STEP ** np.arange(1, count + 1)
    values = []
    for size in sizes:
        factor = np.where(rival.noisier, 1.0 / size, np.ones(len(linear.residual)))
        one = dataclasses.replace(linear, residual=factor * linear.residual)
        slopes = factor[:, None] * rival.slopes(linear.slopes, size)
        most = GUESS * float(factor.min())
        log_density = _log_marginal(one, slopes, laws, weights, scales, most)
        values.append(log_density + float(np.log(factor).sum()))
    return float(special.logsumexp(values)) - float(np.log(len(values)))


def law_grid(structure: ReadingStructure) -> tuple[Laws, Array]:
    """Laws (L,) of unit scale, and log prior weights (L,)."""
    # What a course takes up is a finding of these checks, not their noise.
    prior = noise_prior(structure).without(COURSE)
    axes: list[tuple[float, ...]] = [(0.0,)] * prior.dimensions
    for name, values in ((RUN, LEVELS), (CARRIED, SHARES), (REACH, REACHES)):
        if name in prior.names:
            axes[prior.names.index(name)] = values
    u = np.array(list(itertools.product(*axes)))
    log_prior = -0.5 * (u**2).sum(axis=1)
    return prior.laws(u), log_prior - special.logsumexp(log_prior)


def _few(laws: Laws, weights: Array) -> tuple[Laws, Array]:
    """The likeliest of some laws: an effect stands for what the others hold."""
    best = np.argsort(-weights)[:4]
    some = laws.take([int(k) for k in best])
    return some, weights[best] - special.logsumexp(weights[best])


def _log_marginal(
    linear: ResidualModel,
    slopes: Array,
    laws: Laws,
    weights: Array,
    scales: Array,
    most: float = GUESS,
) -> float:
    """Log density over the unit, by laws of every scale.

    most  error of a run over the stated noise: beyond that is a mistake, and no noise
    """
    whitening = Whitening(linear.structure, laws)
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


# -- what may act without a mistake ----------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """An effect of unknown size.

    columns    (N, k) its forms, of unit size, in units of the stated noise
    is_factor  whether its size is a factor on the tolerances
    noisier    values, by mask (N,), on whose noise its size is a factor
    """

    columns: Array | None = None
    is_factor: bool = False
    noisier: Mask | bool = False

    def slopes(self, slopes: Array, size: float) -> Array:
        """Slopes (N, r + k) with the effect at a size."""
        if self.columns is not None:
            return np.hstack([slopes, size * self.columns])
        return size * slopes if self.is_factor else slopes


def rivals(session: SessionReadings) -> list[Rival]:
    """Drift, smooth error over the poses, tolerances too narrow, and more noise in one
    channel of several.
    """
    frame = session.values
    group = frame.groupby(["setup", "channel"], sort=False).ngroup().to_numpy()
    groups = np.unique(group)
    noisier = [group == g for g in groups if len(groups) > 1]
    return [
        Rival(_by_group(_drift(session), group)),
        Rival(_by_group(_smooth(session), group)),
        Rival(is_factor=True),
        *(Rival(noisier=one) for one in noisier),
    ]


def _by_group(forms: Array, group: Array) -> Array:
    """Forms (N, k), for each group its own."""
    parts = [np.where((group == g)[:, None], forms, 0.0) for g in np.unique(group)]
    columns = np.hstack(parts)
    return columns[:, columns.any(axis=0)]


def _drift(session: SessionReadings) -> Array:
    """Legendre polynomials (N, k) in the order of the readings."""
    _, order = np.unique(session.values["row"].to_numpy(), return_inverse=True)
    place = _centred(order.astype(float))
    powers = [np.polynomial.Legendre.basis(k)(place) for k in range(1, DEGREE + 1)]
    return np.column_stack(powers)


def _smooth(session: SessionReadings) -> Array:
    """Monomials (N, k) of first and second degree in the poses."""
    joints = session.joints[session.reading_of_value]
    place = np.apply_along_axis(_centred, 0, joints)
    k = range(place.shape[1])
    pairs = itertools.combinations_with_replacement(k, 2)
    return np.column_stack([place, *[place[:, i] * place[:, j] for i, j in pairs]])


def _centred(values: Array) -> Array:
    """Values (n,) brought to -1..1."""
    low, high = float(values.min()), float(values.max())
    return (2.0 * values - low - high) / max(high - low, 1e-300)
