"""What all other readings predict of each, and how far readings are from it.

With C the covariance of readings about those of the nominal machine (`oed.checks.fit`) and
P its inverse, all others predict a value to within (P r)_i / P_ii, of variance 1 / P_ii.
A gross error is of one reading. Neighbours of a run that are off the same way, and many
readings of one sign, are the work of an effect that is not in the model.

A person may have typed another number: digits exchanged, a sign, a point.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg, special

from oed.base import Array, Index
from oed.checks.fit import CANNOT_BE, Fit
from oed.checks.session import SessionReadings
from oed.dataset.columns import column_name, parse_column
from oed.measurement import Series
from oed.noise import Noise

#: neighbours of a run that are off the same way from which on they are no single errors;
#: probability of signs as equal by chance, likewise
NEIGHBOURS, SAME_SIGN = 3, 1e-3
#: how many times the usual error of such readings one is that may be a single error
BEYOND = 3.0


@dataclasses.dataclass(frozen=True)
class FarReading:
    """A reading far from what all others predict.

    reading  its number
    pull     how far it is, in standard deviations of its prediction
    error    how far it is, SI, of the value that is farthest
    value    number of that value
    """

    reading: int
    pull: float
    error: float
    value: int


@dataclasses.dataclass(frozen=True)
class LeaveOneOut:
    """Each reading against what all others predict, by the precision P = C^-1.

    gradient  (N,) P r
    diagonal  (N,) of P
    factor    (N, r) B, with P = S^-1 - B B^T
    noise     of covariance S
    reading   (N,) number of the reading that each value belongs to
    """

    gradient: Array
    diagonal: Array
    factor: Array
    noise: Noise
    reading: Index

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
            gradient, diagonal = self._without_independent(members)
        else:
            gradient, diagonal = self._without_related(members)
        gradient[members], diagonal[members] = 0.0, 1.0
        return gradient, np.maximum(diagonal, 1e-12 * self.diagonal)

    def _without_independent(self, members: Index) -> tuple[Array, Array]:
        """The same where S is diagonal: what is left out changes B B^T alone.

        With U the rows of B that are left out, and D their part of S^-1, it becomes
        B K^-1 B^T, K = 1 - U^T D^-1 U (Woodbury): linear in the number of readings,
        however many are left out.
        """
        alone = self.noise.precision_diagonal()
        out = self.factor[members]
        scaled = out / alone[members, None]
        lower = linalg.cholesky(np.eye(out.shape[1]) - out.T @ scaled, lower=True)
        known = linalg.cho_solve((lower, True), scaled.T @ self.gradient[members])
        half = linalg.solve_triangular(lower, self.factor.T, lower=True)
        diagonal = alone - np.einsum("ij,ij->j", half, half)
        return self.gradient + self.factor @ known, diagonal

    def _without_related(self, members: Index) -> tuple[Array, Array]:
        """The same for any S, by the columns of P that are left out."""
        columns = self.columns(members)
        lower = linalg.cholesky(columns[members], lower=True)
        half = linalg.solve_triangular(lower, columns.T, lower=True)
        known = linalg.solve_triangular(lower, self.gradient[members], lower=True)
        gradient = self.gradient - half.T @ known
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
    """Far readings, by number, to which one thing happens: they are no single errors.

    Neighbours of a run that are off the same way, or all of one sign where signs are not
    random. One that is far beyond the others may be a single error as well.
    """
    groups = [_of_one_sign(far), *_neighbours(session, far)]
    alike: set[int] = set()
    for group in groups:
        if not group:
            continue
        usual = float(np.median([abs(one.pull) for one in group]))
        alike |= {one.reading for one in group if abs(one.pull) < BEYOND * usual}
    return tuple(sorted(alike))


def _of_one_sign(far: Sequence[FarReading]) -> list[FarReading]:
    """The far readings of the commoner sign, where chance does not explain so many."""
    positive = [one for one in far if one.error > 0.0]
    negative = [one for one in far if one.error <= 0.0]
    commoner = max(positive, negative, key=len)
    chance = 2.0 * special.bdtrc(len(commoner) - 1, len(far), 0.5)
    return commoner if chance < SAME_SIGN else []


def _neighbours(
    session: SessionReadings, far: Sequence[FarReading]
) -> list[list[FarReading]]:
    """Groups of far readings that follow each other in a run and are off the same way."""
    place = session.values[["setup", "run", "channel"]].to_numpy()
    groups: list[list[FarReading]] = []
    for one in sorted(far, key=lambda reading: reading.reading):
        last = groups[-1][-1] if groups else one
        follows = one.reading == last.reading + 1 and one.error * last.error > 0.0
        if follows and (place[one.value] == place[last.value]).all():
            groups[-1].append(one)
        else:
            groups.append([one])
    return [group for group in groups if len(group) >= NEIGHBOURS]


#: standard deviations of what all others predict within which another number fits, and
#: from which on the one of the file is so far off that a fitting one says something
FITS, FAR = 4.0, 40.0
#: digits of a command beyond which a program wrote it, and no hand
TYPED = 5


def other_number(session: SessionReadings, solution: Fit, one: FarReading) -> str:
    """Which slip of the hand explains a far reading, as a sentence; empty for none.

    solution  fit of the other readings
    """
    if abs(one.pull) < FAR:
        return ""
    return _other_reading(session, one) or _other_command(session, solution, one)


def _other_reading(session: SessionReadings, one: FarReading) -> str:
    factor = session.column(str(session.values["channel"].iloc[one.value])).factor
    value = float(session.y[one.value]) / factor
    predicted = value - one.error / factor
    sd = abs(one.error / one.pull) / factor
    fitting = [
        (abs(number - predicted), words, number)
        for words, number in _slips(value)
        if abs(number - predicted) < FITS * sd
    ]
    if not fitting:
        return ""
    _, words, number = min(fitting)
    return f" With {words} it is {number:.9g}, which fits."


def _other_command(session: SessionReadings, solution: Fit, one: FarReading) -> str:
    """The same of one command of the row, in all that was read there."""
    measurement = session.measurement
    part = session.take(np.array([one.reading]))
    sigma = measurement.sigma(part.series)
    tried = []
    for words, series in _with_other_commands(part):
        error = np.abs(part.y - measurement.try_readings([series], solution.theta))
        if np.isfinite(error).all():
            tried.append((float((error / sigma).max()), words, series, error))
    if not tried:
        return ""
    _, words, series, error = min(tried, key=lambda one: one[0])
    jacobian = measurement.jacobian([series], solution.theta)
    spread = jacobian @ session.prior_root() @ solution.half_covariance()
    fits = (error < FITS * np.hypot(sigma, np.linalg.norm(spread, axis=1))).all()
    return f" With {words}, it fits." if fits else ""


def _with_other_commands(part: SessionReadings) -> Iterator[tuple[str, Series]]:
    """A reading with each slip in a command of its row undone, in words."""
    (series,), measurement = part.series, part.measurement
    place = series.index[0, 0]
    tool = np.array(measurement.setups[series.setup].tool)
    for k, coordinate in enumerate(measurement.machine.command):
        column = column_name(coordinate.name, coordinate.unit)
        factor = parse_column(column).factor
        written = float(series.command[place, k]) / factor
        if len(f"{abs(written):.9g}".replace(".", "")) > TYPED:
            continue
        for words, number in _slips(written):
            command = series.command.copy()
            command[place, k] = number * factor
            try:
                x, q = measurement.kinematics.sent(command, tool)
            except CANNOT_BE:
                continue
            there = dataclasses.replace(series, q=q, start=x, command=command)
            yield f"{words} of the command, {column} = {number:.9g}", there


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
