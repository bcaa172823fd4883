"""Likelihood of every mistake in the linear model: which of them are worth a fit.

Readings are linear about the nominal machine, y = f + H z + s e, with z ~ N(0, I), e of
the stated noise, and a scale s of it that is free. The log evidence of residuals r and
whitened slopes H is

    -1/2 [ N log s^2 + sum log(1 + l_i / s^2) + (r^T r - sum b_i^2 / (l_i + s^2)) / s^2 ],

l_i the eigenvalues of H^T H, b the components of H^T r; its maximum over s counts. Slopes of
one residual alone need no eigenvalues: Householder's tridiagonal form of the products
[r H]^T [r H] leaves r in its place, and its pivots d_i from the last one on, with s^2 added
to all but the first, are those of H^T H + s^2 and, the first of them, what remains of r:

    -1/2 [ N log s^2 + sum log(d_i / s^2) + d_0 / s^2 ].
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import scipy

from oed.base import Array, Mask
from oed.checks.fit import Fit
from oed.checks.mistakes.suspect import Suspect
from oed.checks.mistakes.trial import MistakeTrial
from oed.checks.session import SessionReadings
from oed.fit_limits import GUESS_RATIO
from oed.linear_algebra import explained_energy
from oed.measurement import reading_structure
from oed.noise import Laws, Noise, ReadingStructure
from oed.noise_law import NoisePrior, ResidualModel, log_prior_of_scale

MIN_SCALE = 0.5  #: least scale of the noise over the stated one
SCALE_STEP = 1.5  #: factor between scales of the noise
RESOLVED_SHARE = 1e-6  #: scale over the largest one that sums of squares resolve
#: log of the range of sizes that an amount may have: a factor of 10^5 is as good as all
LOG_SIZE_RANGE = float(np.log(np.log(1e5)))


@dataclasses.dataclass(frozen=True, slots=True)
class Score:
    """Log evidence in the linear model, and the scale of the noise that goes with it."""

    log_evidence: float
    scale: float

    def plus(self, log_factor: float) -> "Score":
        """The score with a factor on the density."""
        return Score(self.log_evidence + log_factor, self.scale)


IMPOSSIBLE = Score(-np.inf, 1.0)  #: of what cannot be


class Screening:
    """Log evidences of trials in the linear model, up to a common constant."""

    def __init__(self, data: Suspect) -> None:
        session = data.session
        self.data = data
        self.noise: Noise = session.measurement.noise(session.series)
        white = self.noise.whiten(data.slopes)
        directions, sizes, _ = np.linalg.svd(white, full_matrices=False)
        #: (N, r) slopes turned until they are orthogonal, and (r,) their squares
        self._turned, self._energies = directions * sizes, sizes**2
        self._residual = self.noise.whiten(session.y - data.predicted)
        self.scales = scales_of_noise(self._residual)
        setups = session.measurement.setups.values()
        is_assumed = all(setup.statement.is_assumed for setup in setups)
        self._prior = log_prior_of_scale(self.scales, is_assumed=is_assumed)

    def as_given(self) -> Score:
        """Score of the readings as given."""
        return self._scores_of(self._residual[:, None])[0]

    def scores(self, trials: Sequence[MistakeTrial]) -> list[Score]:
        """Score of each trial."""
        result = [IMPOSSIBLE] * len(trials)
        values_of = [_values_alone(trial) for trial in trials]
        alone = {k: y for k, y in enumerate(values_of) if y is not None}
        if alone:
            values = np.column_stack(list(alone.values()))
            white = self.noise.whiten(values - self.data.predicted[:, None])
            for k, score in zip(alone, self._scores_of(white), strict=True):
                result[k] = score
        for k, one in enumerate(trials):
            if one.columns is not None:
                result[k] = self._columns_score(one, one.columns)
            elif k not in alone:
                result[k] = self._any_score(one)
        return [s.plus(t.log_scale) for s, t in zip(result, trials, strict=True)]

    # -- one residual under all scales -------------------------------------------------
    def _scores_of(self, white: Array) -> list[Score]:
        """Scores of whitened residuals (N, m) with the slopes as given."""
        return [self._best(column) for column in self._densities_by_scale(white).T]

    def _best(self, by_scale: Array) -> Score:
        k = int(np.argmax(by_scale))
        return Score(float(by_scale[k]), float(self.scales[k]))

    def _weights(self, count: int) -> Array:
        """Log evidences (S,) of the scales for `count` values."""
        return np.asarray(self._prior - count * np.log(self.scales))

    def _densities_by_scale(self, white: Array) -> Array:
        """Log evidences (S, m), by scale, of whitened residuals (N, m)."""
        squares = (white.T @ self._turned) ** 2
        energy = (white**2).sum(axis=0)
        density = log_density_by_scale(self._energies, squares, energy, self.scales)
        return np.asarray(density.T + self._weights(len(white))[:, None])

    # -- amounts in the readings -------------------------------------------------------
    def _columns_score(self, trial: MistakeTrial, columns: Array) -> Score:
        """Score with amounts of unknown size, of columns (N, k)."""
        both = np.column_stack([self._residual, self.noise.whiten(columns)])
        components = self._turned.T @ both
        whole = both.T @ both
        alone = self._densities_by_scale(both[:, :1])[:, 0]
        square = self.scales[:, None, None] ** 2
        weights = 1.0 / (self._energies + square)
        grams = (whole - (components.T * weights) @ components) / square
        gains, amounts = gains_of_amounts(grams)
        scaling = np.array([trial.scaling(some) for some in amounts])
        return self._best(alone + gains + scaling)

    # -- other poses, missing values, several machines ---------------------------------
    def _any_score(self, trial: MistakeTrial) -> Score:
        data = self.data
        y = data.session.y if trial.y is None else trial.y
        predicted, slopes = data.predicted, data.slopes
        if trial.table is not None:
            inside = trial.scope.values
            predicted = np.where(inside, trial.table.predicted, predicted)
            slopes = np.where(inside[:, None], trial.table.slopes, slopes)
            amount = np.where(inside[:, None], trial.table.by_amount, 0.0)
            slopes = np.hstack([slopes, amount])
        if not (np.isfinite(predicted).all() and np.isfinite(slopes).all()):
            return IMPOSSIBLE
        white = self.noise.whiten(y - predicted)
        slopes = self.noise.whiten(slopes)
        if trial.noise is not None:
            white, slopes = white / trial.noise, slopes / trial.noise[:, None]
            score = self._rows_score(white, slopes, np.ones(len(y), dtype=bool))
            return score.plus(-float(np.log(trial.noise).sum()))
        if trial.parts is not None:
            sides = (trial.parts, ~trial.parts)
            one, other = (self._rows_score(white, slopes, side) for side in sides)
            return dataclasses.replace(one, scale=other.scale).plus(other.log_evidence)
        if trial.missing is None:
            return self._rows_score(white, slopes, np.ones(len(y), dtype=bool))
        # the evidence leaves out the constants that the density has
        constants = np.log(data.sigma[trial.missing]) + 0.5 * np.log(2.0 * np.pi)
        score = self._rows_score(white, slopes, ~trial.missing)
        return score.plus(trial.log_density_missing + float(constants.sum()))

    def _rows_score(self, white: Array, slopes: Array, rows: Mask) -> Score:
        """Score of some rows; 0 for none."""
        count = int(rows.sum())
        if not count:
            return Score(0.0, 1.0)
        density = log_density_of_one(slopes[rows], white[rows], self.scales)
        return self._best(density + self._weights(count))


def scales_of_noise(residual: Array) -> Array:
    """Scales that noise may have, of residuals (N,) over the stated one."""
    largest = 2.0 * float(np.sqrt(np.mean(residual**2))) + 2.0
    least = max(MIN_SCALE, RESOLVED_SHARE * largest)
    count = int(np.ceil(np.log(largest / least) / np.log(SCALE_STEP)))
    return np.asarray(least * SCALE_STEP ** np.arange(max(count, 4)))


def log_density_by_scale(
    values: Array, squares: Array, energy: Array, scales: Array
) -> Array:
    """Log density (..., S) of residuals for scales, but for N log s, from eigenvalues
    of H^T H and squared components of H^T r (..., r), and r^T r (...,).
    """
    variances = scales**-2.0
    gain, log_determinant = explained_energy(values, squares, variances)
    return -0.5 * (log_determinant + energy[..., None] * variances - gain * variances)


def log_density_of_one(slopes: Array, residual: Array, scales: Array) -> Array:
    """The same (S,) of one residual (n,) with slopes (n, r).

    Where rounding of the products exceeds s^2, the pivots are those of what it is.
    """
    both = np.column_stack([residual, slopes])
    _, diagonal, off_diagonal, _, _ = scipy.linalg.lapack.dsytrd(both.T @ both, lower=1)
    squares = scales[:, None] ** 2
    rounding = both.shape[1] * np.finfo(float).eps * diagonal.max()
    # all scales one after the other, parted by 0
    shifted = diagonal[:0:-1] + np.maximum(squares, rounding)
    linked = np.tile(np.append(off_diagonal[:0:-1], 0.0), len(scales))[:-1]
    factored, _, _ = scipy.linalg.lapack.dpttrf(shifted.ravel(), linked)
    pivots = factored.reshape(shifted.shape)
    remaining = diagonal[0] - off_diagonal[0] ** 2 / pivots[:, -1]
    log_determinant = np.log(pivots / squares).sum(axis=1)
    return np.asarray(-0.5 * (log_determinant + remaining / squares[:, 0]))


def gains_of_amounts(grams: Array) -> tuple[Array, Array]:
    """Log evidences (S,) that amounts of unknown size add, and the amounts (S, k).

    grams  products (S, 1 + k, 1 + k) under precisions of the readings: of the residual,
           then of the columns

    Their prior sd is what the readings say of their size, at the cost of that choice.
    """
    precision, slope = grams[:, 1:, 1:], grams[:, 1:, 0]
    unit = np.sqrt(np.maximum(np.diagonal(precision, axis1=1, axis2=2), 1e-300))
    scaled, part = precision / (unit[:, :, None] * unit[:, None]), slope / unit
    values, vectors = np.linalg.eigh(scaled)
    along = np.einsum("sij,si->sj", vectors, part)
    is_known = values > 1e-9 * values[:, -1:]
    solved = np.divide(along, values, out=np.zeros_like(along), where=is_known)
    amounts = np.einsum("sij,sj->si", vectors, solved)
    size = np.mean(amounts**2, axis=1)
    inner = 1.0 + size[:, None] * np.maximum(values, 0.0)
    gain = 0.5 * size * (along**2 / inner).sum(axis=1) - 0.5 * np.log(inner).sum(axis=1)
    is_large = size > 1.0
    gain = np.where(is_large, gain, 0.0) - LOG_SIZE_RANGE
    return gain, np.where(is_large[:, None], amounts / unit, 0.0)


def _values_alone(trial: MistakeTrial) -> Array | None:
    """The values (N,) of a trial that changes values alone; None for another one."""
    others = (trial.table, trial.missing, trial.columns, trial.parts, trial.noise)
    return trial.y if all(one is None for one in others) else None


# Log evidence of readings: parameters, noise law and tolerances integrated out.
#
# At the most probable parameters the readings are linear in them. Their density is that of
# normal errors of each of a grid of laws (a scale, an error of a run, one that is carried
# along it), with the prior of the laws as weight, and of rivals that no law holds:
# tolerances that are too narrow, and more noise in one channel of several.

#: coordinates of the laws that are looked at: of the error of a run
LEVELS = (-2.0, 0.0, 1.5, 3.0)
SHARES = (-1.5, 0.3, 1.8)  #: of the share that is carried over
REACHES = (0.0, 1.5)  #: of the reach in readings
NO_RIVAL_PROBABILITY = 0.6  #: prior probability of no rival
RIVAL_PROBABILITY = 0.4  #: prior probability of all rivals together
SIZE_STEP = 4.0  #: factor between sizes of a rival


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
    terms = [float(np.log(NO_RIVAL_PROBABILITY)) + alone]
    # a rival stands for what the less likely laws hold
    best = np.argsort(-weights)[:4]
    few_weights = weights[best] - scipy.special.logsumexp(weights[best])
    few = laws.take(best), few_weights
    rivalling = rivals(session) if with_rivals else []
    for rival in rivalling:
        log_share = float(np.log(RIVAL_PROBABILITY / len(rivalling)))
        terms.append(log_share + _rival_density(linear, rival, *few, scales))
    constant = structure.log_unit + 0.5 * len(structure) * float(np.log(2.0 * np.pi))
    return float(scipy.special.logsumexp(terms)) - constant


def rivals(session: SessionReadings) -> list[Mask | None]:
    """Values (N,) of one channel of several that may be noisier; None: tolerances."""
    channel = session.values.groupby(["setup", "channel"], sort=False).ngroup()
    number = channel.to_numpy()
    groups = np.unique(number)
    return [None, *(number == g for g in groups if len(groups) > 1)]


def _rival_density(
    linear: ResidualModel,
    noisier: Mask | None,
    laws: Laws,
    weights: Array,
    scales: Array,
) -> float:
    """Log density with a rival of unknown size: a factor on tolerances, or on noise."""
    largest = 100.0
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
    return float(scipy.special.logsumexp(values)) - float(np.log(len(values)))


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
    return prior.laws(u), log_prior - scipy.special.logsumexp(log_prior)


def _log_marginal(
    linear: ResidualModel,
    slopes: Array,
    laws: Laws,
    weights: Array,
    scales: Array,
    most: float = GUESS_RATIO,
) -> float:
    """Log density over the unit, by laws of all scales, runs' errors up to `most`."""
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
    prior = prior - scipy.special.logsumexp(prior)
    is_noise = laws.level[:, None] * scales <= most
    log_density += weights[:, None] + prior
    return float(scipy.special.logsumexp(log_density[is_noise]))
