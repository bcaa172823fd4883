"""Posterior odds that a far reading is a gross error, and that it is this reading.

A mean-shift model M_S gives each value of a set S a shift d (Cook and Weisberg 1982,
sec. 2.2.2). Let r be the residuals about the nominal machine, P the inverse of their
covariance, in which tolerances and noise are, and g = P r. The likelihood of M_S at its
best shift d = P_SS^-1 g_S, over that without a shift, is exp(1/2 g_S^T P_SS^-1 g_S).
A shift has a Cauchy prior of scale GROSS times the noise: gross errors have no size of
their own. Integrated over the shifts, the log odds of M_S over no gross error are

    log w_S = 1/2 g_S^T P_SS^-1 g_S + k/2 log 2 pi - 1/2 log |P_SS|
              + sum_i log v(d_i; s_i, GROSS sigma_i) + m log(e / (1 - e)),

for k values of m readings, with s_i^2 = (P_SS^-1)_ii. v is Voigt's density, the prior
with the uncertainty s_i of the shift. e is the share of gross errors. The design enters
by its leverage h_i: P_ii = (1 - h_i) / sigma_i^2 for independent readings.

Which reading is located, and whether it is noise of heavy tails: docs/theory/noise.md. Sets
are compared, as a search by one reading at a time can take the neighbours of two outliers
for them, or stop between them (masking).
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg, special

from oed.base import Array, Index
from oed.checks.fit import CANNOT_BE, Fit
from oed.checks.session import SessionReadings
from oed.dataset import ReadingsColumn
from oed.measurement import Series
from oed.noise import Noise
from oed.noise_law import densities_over_scales

# What all other readings predict of each, and how far readings are from it.
#
# With C the covariance of readings about those of the nominal machine (`oed.checks.fit`) and
# P its inverse, all others predict a value to within (P r)_i / P_ii, of variance 1 / P_ii.
# A gross error is of one reading. Neighbours of a run that are off the same way, and many
# readings of one sign, are the work of an effect that is not in the model.
#
# A person may have typed another number: digits exchanged, a sign, a point.

#: how many times the usual error of such readings one is that may be a single error
SINGLE_ERROR_FACTOR = 3.0


@dataclasses.dataclass(frozen=True)
class FarReading:
    """A reading far from what all others predict."""

    reading: int  #: its number
    pull: float  #: how far it is, in standard deviations of its prediction
    error: float  #: how far it is, SI, of the value that is farthest
    value: int  #: number of that value


@dataclasses.dataclass(frozen=True)
class LeaveOneOut:
    """Each reading against what all others predict, by the precision P = C^-1."""

    gradient: Array  #: (N,) P r
    diagonal: Array  #: (N,) of P
    factor: Array  #: (N, r) B, with P = S^-1 - B B^T
    noise: Noise  #: of covariance S
    reading: Index  #: (N,) number of the reading that each value belongs to

    @property
    def count(self) -> int:
        """Number of readings."""
        return 1 + int(self.reading[-1])

    def values(self, readings: Sequence[int]) -> Index:
        """Places of the values of readings."""
        return np.flatnonzero(np.isin(self.reading, readings))

    def farthest(self, one: int, aside: Sequence[int]) -> FarReading:
        """How far a reading is from what all but it and those `aside` predict."""
        gradient, diagonal = self.without([k for k in aside if k != one])
        pulls = gradient / np.sqrt(diagonal)
        values = self.values([one])
        worst = int(values[np.argmax(np.abs(pulls[values]))])
        error = float(gradient[worst] / diagonal[worst])
        return FarReading(one, float(pulls[worst]), error, worst)

    def columns(self, members: Index) -> Array:
        """Columns (N, k) of P."""
        unit = np.zeros((len(self.diagonal), len(members)))
        unit[members, np.arange(len(members))] = 1.0
        alone = self.noise.precision(unit)
        return alone - self.factor @ self.factor[members].T

    def without(self, readings: Sequence[int]) -> tuple[Array, Array]:
        """Gradient and diagonal (N,) with some readings left out: 0 and 1 of theirs."""
        members = self.values(readings)
        if not len(members):
            return self.gradient, self.diagonal
        if self.noise.is_independent:
            gradient, diagonal = self._drop_independent(members)
        else:
            gradient, diagonal = self._drop_related(members)
        gradient[members], diagonal[members] = 0.0, 1.0
        return gradient, np.maximum(diagonal, 1e-12 * self.diagonal)

    def _drop_independent(self, members: Index) -> tuple[Array, Array]:
        """The same where S is diagonal: what is left out changes B B^T alone.

        With U the rows of B that are left out, and D their part of S^-1, it becomes
        B K^-1 B^T, K = 1 - U^T D^-1 U (Woodbury): linear in the number of readings,
        however many are left out.
        """
        alone = self.noise.precision_diagonal()
        out = self.factor[members]
        scaled = out / alone[members, None]
        lower = linalg.cholesky(np.eye(out.shape[1]) - out.T @ scaled, lower=True)
        explained = linalg.cho_solve((lower, True), scaled.T @ self.gradient[members])
        half = linalg.solve_triangular(lower, self.factor.T, lower=True)
        diagonal = alone - np.einsum("ij,ij->j", half, half)
        return self.gradient + self.factor @ explained, diagonal

    def _drop_related(self, members: Index) -> tuple[Array, Array]:
        """The same for any S, by the columns of P that are left out."""
        columns = self.columns(members)
        lower = linalg.cholesky(columns[members], lower=True)
        half = linalg.solve_triangular(lower, columns.T, lower=True)
        explained = linalg.solve_triangular(lower, self.gradient[members], lower=True)
        gradient = self.gradient - half.T @ explained
        diagonal = self.diagonal - np.einsum("ij,ij->j", half, half)
        return gradient, diagonal


def predict_from_others(solution: Fit) -> LeaveOneOut:
    """What all other readings predict of each reading, linear at the solution."""
    noise = solution.noise
    half = solution.half_covariance()
    shared = solution.slopes @ half
    r = solution.linear_residual()
    remainder = r - shared @ (shared.T @ r)
    factor = noise.whiten_back(shared)
    diagonal = noise.precision_diagonal() - np.einsum("ij,ij->i", factor, factor)
    reading = solution.session.reading_of_value
    return LeaveOneOut(noise.whiten_back(remainder), diagonal, factor, noise, reading)


# -- far readings ----------------------------------------------------------------------
def measure(
    prediction: LeaveOneOut, readings: Sequence[int], aside: Sequence[int]
) -> tuple[FarReading, ...]:
    """How far readings are from what all but those `aside` predict, farthest first."""
    records = [prediction.farthest(one, aside) for one in readings]
    return tuple(sorted(records, key=lambda record: -abs(record.pull)))


def alike_readings(
    session: SessionReadings, far: Sequence[FarReading]
) -> tuple[int, ...]:
    """Far readings, by number, to which one thing happens: neighbours of a run off the
    same way, or all of one sign, but one far beyond the others.
    """
    groups = [_one_signed(far), *_neighbours(session, far)]
    alike: set[int] = set()
    for group in groups:
        if not group:
            continue
        usual = float(np.median([abs(one.pull) for one in group]))
        alike |= {
            one.reading for one in group if abs(one.pull) < SINGLE_ERROR_FACTOR * usual
        }
    return tuple(sorted(alike))


def _one_signed(far: Sequence[FarReading]) -> list[FarReading]:
    """The far readings of the commoner sign, where chance does not explain so many."""
    positive = [one for one in far if one.error > 0.0]
    negative = [one for one in far if one.error <= 0.0]
    commoner = max(positive, negative, key=len)
    chance = 2.0 * special.bdtrc(len(commoner) - 1, len(far), 0.5)
    return commoner if chance < 1e-3 else []


def _neighbours(
    session: SessionReadings, far: Sequence[FarReading]
) -> list[list[FarReading]]:
    """Groups of far readings that follow each other in a run and are off the same way."""
    labels = session.values[["setup", "run", "channel"]].to_numpy()
    groups: list[list[FarReading]] = []
    for one in sorted(far, key=lambda reading: reading.reading):
        last = groups[-1][-1] if groups else one
        follows = one.reading == last.reading + 1 and one.error * last.error > 0.0
        if follows and (labels[one.value] == labels[last.value]).all():
            groups[-1].append(one)
        else:
            groups.append([one])
    return [group for group in groups if len(group) >= 3]


#: standard deviations of what all others predict within which another number fits
FITS = 4.0
#: such deviations from which on the file's number is so far off that a fitting one says
#: something
FAR = 40.0


def other_number(session: SessionReadings, solution: Fit, one: FarReading) -> str:
    """Which slip of the hand explains a far reading, by a fit of the others; or ""."""
    if abs(one.pull) < FAR:
        return ""
    return _other_reading(session, one) or _other_command(session, solution, one)


def _other_reading(session: SessionReadings, one: FarReading) -> str:
    factor = session.column(str(session.values["channel"].iloc[one.value])).factor
    value = float(session.y[one.value]) / factor
    predicted = value - one.error / factor
    sd = abs(one.error / one.pull) / factor
    fitting = [
        (abs(number - predicted), text, number)
        for text, number in _slips(value)
        if abs(number - predicted) < FITS * sd
    ]
    if not fitting:
        return ""
    _, text, number = min(fitting)
    return f" With {text} it is {number:.9g}, which fits."


def _other_command(session: SessionReadings, solution: Fit, one: FarReading) -> str:
    """The same of one command of the row, in all that was read there."""
    measurement = session.measurement
    part = session.take(np.array([one.reading]))
    sigma = measurement.sigma(part.series)
    tried = []
    for text, series in _commands_undone(part):
        error = np.abs(part.y - measurement.try_readings([series], solution.theta))
        if np.isfinite(error).all():
            tried.append((float((error / sigma).max()), text, series, error))
    if not tried:
        return ""
    _, text, series, error = min(tried, key=lambda one: one[0])
    jacobian = measurement.jacobian([series], solution.theta)
    spread = jacobian @ session.prior_root() @ solution.half_covariance()
    fits = (error < FITS * np.hypot(sigma, np.linalg.norm(spread, axis=1))).all()
    return f" With {text}, it fits." if fits else ""


def _commands_undone(part: SessionReadings) -> Iterator[tuple[str, Series]]:
    """A reading with each slip in a command of its row undone, in words."""
    (series,), measurement = part.series, part.measurement
    pose = series.index[0, 0]
    tool = np.array(measurement.setups[series.setup].tool)
    for k, coordinate in enumerate(measurement.machine.command):
        column = ReadingsColumn.of(coordinate.name, coordinate.unit)
        written = float(series.command[pose, k]) / column.factor
        if len(f"{abs(written):.9g}".replace(".", "")) > 5:
            continue
        for text, number in _slips(written):
            command = series.command.copy()
            command[pose, k] = number * column.factor
            try:
                x, q = measurement.kinematics.sent(command, tool)
            except CANNOT_BE:
                continue
            there = dataclasses.replace(series, q=q, start=x, command=command)
            yield f"{text} of the command, {column.name} = {number:.9g}", there


def _slips(value: float) -> Iterator[tuple[str, float]]:
    """Numbers that may have been meant, in words."""
    yield "the other sign", -value
    for power in (-3, -2, -1, 1, 2, 3):
        yield "its decimal point elsewhere", value * 10.0**power
    digits = list(f"{abs(value):.9g}")
    places = [k for k, digit in enumerate(digits) if digit.isdigit()]
    for j, k in itertools.pairwise(places):
        if digits[j] != digits[k]:
            other = digits.copy()
            other[j], other[k] = digits[k], digits[j]
            sign = -1.0 if value < 0.0 else 1.0
            yield "two neighbouring digits exchanged", sign * float("".join(other))


N_CANDIDATES = 60  #: readings that are combined
MAX_SET = 3  #: readings in one set, at most


def best_set(prediction: LeaveOneOut, removed: list[int], limit: float) -> list[int]:
    """The readings, by number, to leave out in place of `removed`."""
    if not 0 < len(removed) <= MAX_SET:
        return removed
    values = prediction.values(removed)
    gradient = prediction.gradient[values]
    gain = float(
        gradient @ np.linalg.solve(prediction.columns(values)[values], gradient)
    )
    best = removed
    best_value = gain - limit**2 * len(removed)
    for solutions in solve_sets(prediction, removed):
        gains = solutions.gain - limit**2 * solutions.sets.shape[1]
        k = int(np.argmax(gains))
        if gains[k] > best_value + 1e-9:
            best = [int(one) for one in solutions.sets[k]]
            best_value = float(gains[k])
    return best


@dataclasses.dataclass(frozen=True)
class SetSolutions:
    """Best shifts of the values of sets of equally many readings and values."""

    sets: Index  #: (S, m) numbers of readings
    values: Index  #: (S, k) places of their values
    #: (S, k) best shifts and their standard deviations, SI
    shift: Array
    sd: Array
    gain: Array  #: (S,) by which they lower the penalised sum of squares
    log_determinant: Array  #: (S,) of the precision of the values


def solve_sets(prediction: LeaveOneOut, members: Sequence[int]) -> list[SetSolutions]:
    """All sets of 1 to MOST of the worst predicted readings and some members."""
    pulls = np.abs(prediction.gradient) / np.sqrt(prediction.diagonal)
    largest = np.zeros(prediction.count)
    np.maximum.at(largest, prediction.reading, pulls)
    worst = np.argsort(-largest, kind="stable")[:N_CANDIDATES]
    candidates = np.union1d(worst, np.array(members, dtype=np.intp))
    places = [prediction.values([one]) for one in candidates]
    count = max(len(values) for values in places)
    whole = [k for k, values in enumerate(places) if len(values) == count]
    chosen = np.concatenate([places[k] for k in whole])
    precision = prediction.columns(chosen)[chosen]
    names = candidates[np.array(whole)]
    solutions = []
    for size in range(1, min(MAX_SET, len(whole)) + 1):
        combined = list(itertools.combinations(range(len(whole)), size))
        sets = np.array(combined, dtype=np.intp)
        places_of_sets = (count * sets[:, :, None] + np.arange(count)).reshape(
            len(sets), -1
        )
        gradient = prediction.gradient[chosen][places_of_sets]
        blocks = precision[places_of_sets[:, :, None], places_of_sets[:, None, :]]
        inverse = np.linalg.inv(blocks)
        shift = np.einsum("sij,sj->si", inverse, gradient)
        # 1 over the diagonal of a block at least
        least = 1.0 / np.einsum("sii->si", blocks)
        variances = np.maximum(np.einsum("sii->si", inverse), least)
        solutions.append(
            SetSolutions(
                sets=names[sets],
                values=chosen[places_of_sets],
                shift=shift,
                sd=np.sqrt(variances),
                gain=np.maximum(np.einsum("si,si->s", gradient, shift), 0.0),
                log_determinant=np.linalg.slogdet(blocks)[1],
            )
        )
    return solutions


LOCATED_ODDS = 100.0  #: posterior odds from which a reading is located
GROSS_ODDS = 10.0  #: posterior odds from which a reading is a gross error
GROSS_SCALE = 10.0  #: scale of a gross error's prior, in units of the noise
EXPECTED_GROSS = 8.0  #: gross errors expected in a session that has any
MAX_GROSS_SHARE = 0.12  #: share of a session's readings that are gross errors, at most
#: degrees of freedom of noise with heavy tails, and of normal noise
HEAVY_TAILS = (4.0, 6.0, 10.0)
NORMAL = (np.inf,)


@dataclasses.dataclass(frozen=True)
class OutlierOdds:
    """Odds of readings that all others contradict."""

    prediction: LeaveOneOut  #: of each value from all others
    #: degrees of freedom of the noise where a study states them
    student: float | None = None

    @property
    def share(self) -> float:
        """Share of gross errors in a session that has any."""
        return min(MAX_GROSS_SHARE, EXPECTED_GROSS / self.prediction.count)

    @property
    def log_prior(self) -> float:
        """Log odds of a reading being a gross error in such a session."""
        return float(special.logit(self.share))

    # -- which reading it is -----------------------------------------------------------
    def location_odds(self, members: Sequence[int]) -> dict[int, float]:
        """Log odds of each suspect over all sets, of up to MOST or exchanged by
        one, without it.
        """
        if len(members) > MAX_SET:
            return {one: self._exchange_odds(members, one) for one in members}
        sets, weights = self._weighted_sets(members)
        odds = {}
        for one in members:
            with_it = np.array([one in s for s in sets])
            odds[one] = float(_log_sum(weights[with_it]) - _log_sum(weights[~with_it]))
        return odds

    def likeliest(self, members: Sequence[int]) -> int:
        """The reading that is the likeliest gross error beside some."""
        return int(np.argmax(self._exchange_weights(members, None)))

    def rivals(self, members: Sequence[int], one: int) -> tuple[int, ...]:
        """Readings any of which could be the one, itself among them, the likeliest first."""
        weights = self._exchange_weights(members, one)
        ranked = np.argsort(-weights, kind="stable")
        likely = weights[ranked] > weights.max() - np.log(LOCATED_ODDS)
        return tuple(int(k) for k in ranked[likely])

    def _exchange_odds(self, members: Sequence[int], one: int) -> float:
        weights = self._exchange_weights(members, one) + self.log_prior
        others = np.append(np.delete(weights, one), 0.0)
        return float(weights[one] - _log_sum(others))

    def _exchange_weights(self, members: Sequence[int], one: int | None) -> Array:
        """Log weight (R,) for a member, or beside all; -inf of members."""
        rest = [k for k in members if k != one]
        prediction = self.prediction
        weights = np.zeros(prediction.count)
        by_value = log_weights_of_shifts(
            *prediction.without(rest), prediction.noise.sigma
        )
        np.add.at(weights, prediction.reading, by_value)
        weights[rest] = -np.inf
        return weights

    def _weighted_sets(
        self, members: Sequence[int]
    ) -> tuple[list[tuple[int, ...]], Array]:
        """All sets of up to MOST candidates, the empty one first, and their log weights."""
        sets: list[tuple[int, ...]] = [()]
        weights: list[Array] = [np.zeros(1)]
        for solutions in solve_sets(self.prediction, members):
            sets += [tuple(map(int, one)) for one in solutions.sets]
            scale = GROSS_SCALE * self.prediction.noise.sigma[solutions.values]
            density = special.voigt_profile(solutions.shift, solutions.sd, scale)
            count = solutions.values.shape[1]
            log_weight = 0.5 * (solutions.gain - solutions.log_determinant)
            log_weight += 0.5 * count * np.log(2.0 * np.pi) + np.log(density).sum(
                axis=1
            )
            weights.append(log_weight + self.log_prior * solutions.sets.shape[1])
        return sets, np.concatenate(weights)

    # -- gross error or noise ----------------------------------------------------------
    def gross_error_odds(
        self, members: Sequence[int], *, rest_fits: bool
    ) -> dict[int, float]:
        """Log odds of a gross error, and not noise, for each suspected reading."""
        errors = self._prediction_errors(members)
        if rest_fits and self.student is None:
            odds = _odds_beside_normal_noise(errors, self.share)
        else:
            tails = HEAVY_TAILS if self.student is None else (self.student,)
            odds = _odds_beside_heavy_tails(errors, self.share, tails)
        return dict(zip(members, map(float, odds), strict=True))

    def _prediction_errors(self, members: Sequence[int]) -> "_PredictionErrors":
        """The errors, with each suspect predicted without the other suspects."""
        prediction = self.prediction
        gradient, precision = prediction.without(members)
        core = ~np.isin(prediction.reading, members)
        alone = prediction.noise.precision_diagonal()
        freedom = float(np.mean(np.clip(precision[core] / alone[core], 0.0, 1.0)))
        far = [prediction.farthest(one, members) for one in members]
        values = [one.value for one in far]
        pulls = np.array([one.pull for one in far])
        sd = np.array([one.error / one.pull for one in far])
        core_pulls = gradient[core] / np.sqrt(precision[core])
        sigma = prediction.noise.sigma
        return _PredictionErrors(
            core=core_pulls,
            far=pulls,
            core_density=_density_of_gross(
                core_pulls, precision[core] ** -0.5, sigma[core]
            ),
            far_density=_density_of_gross(pulls, sd, sigma[values]),
            freedom=freedom,
        )


def log_weights_of_shifts(gradient: Array, precision: Array, sigma: Array) -> Array:
    """Log weight (N,) of a shift of each value alone, without the share of such errors."""
    shift, sd = gradient / precision, precision**-0.5
    density = special.voigt_profile(shift, sd, GROSS_SCALE * sigma)
    return np.asarray(
        0.5 * gradient * shift + np.log(np.sqrt(2.0 * np.pi) * sd * density)
    )


# -- gross error or noise --------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class _PredictionErrors:
    """Errors of predicting values from all others but the suspects."""

    core: Array  #: (C,) of the other readings' values, in their standard deviations
    far: Array  #: (m,) of the farthest value of each suspect, likewise
    core_density: Array  #: (C,) of gross errors at `core`
    far_density: Array  #: (m,) of gross errors at `far`
    freedom: float  #: share of the errors at `core` that is independent


def _odds_beside_normal_noise(errors: _PredictionErrors, share: float) -> Array:
    """Log odds (m,) of normal noise with gross errors over noise of heavy tails."""
    density, prior = densities_over_scales(errors.core, NORMAL)
    mixed = np.logaddexp(
        np.log1p(-share) + density, np.log(share * errors.core_density)
    )
    weights = prior + errors.freedom * mixed.sum(axis=2)
    far, _ = densities_over_scales(errors.far, NORMAL)
    gross = np.log(share * errors.far_density)
    mixed = np.logaddexp(np.log1p(-share) + far, gross)
    weights += mixed.sum(axis=2)
    with_gross = _log_sum((weights[..., None] + gross - mixed).reshape(-1, len(gross)))
    without = _log_sum(
        (weights[..., None] + np.log1p(-share) + far - mixed).reshape(-1, len(gross))
    )
    density, prior = densities_over_scales(errors.core, HEAVY_TAILS)
    weights = prior + errors.freedom * density.sum(axis=2)
    weights += densities_over_scales(errors.far, HEAVY_TAILS)[0].sum(axis=2)
    return with_gross - np.logaddexp(without, _log_sum(weights.ravel()))


def _odds_beside_heavy_tails(
    errors: _PredictionErrors, share: float, tails: Sequence[float]
) -> Array:
    """Log odds (m,) of a gross error over noise whose tails and scale the rest shows."""
    density, prior = densities_over_scales(errors.core, tails)
    weights = prior + errors.freedom * density.sum(axis=2)
    weights -= _log_sum(weights.ravel())
    far = weights[..., None] + densities_over_scales(errors.far, tails)[0]
    noise = np.log1p(-share) + _log_sum(far.reshape(-1, len(errors.far)))
    return np.asarray(np.log(share * errors.far_density) - noise)


def _density_of_gross(x: Array, sd: Array, sigma: Array) -> Array:
    """Density (N,) of a gross error at errors x (N,), in the sd (N,) of predicting them."""
    return np.asarray(special.voigt_profile(x, 1.0, GROSS_SCALE * sigma / sd))


def _log_sum(values: Array) -> Array:
    """Log of the sum of exponentials over the first axis; -inf of nothing."""
    if not len(values):
        return np.asarray(-np.inf)
    return np.asarray(special.logsumexp(values, axis=0))
