"""A reading far from what all others predict, and whether several are off alike.

A gross error is of one reading. Neighbours of a run that are off the same way, and many
readings of one sign, are the work of an effect that is not in the model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.checks.fit import LeaveOneOut
from oed.checks.session import SessionReadings

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


def measure(
    session: SessionReadings,
    prediction: LeaveOneOut,
    readings: Sequence[int],
    aside: Sequence[int],
) -> tuple[FarReading, ...]:
    """How far readings are from what all but those `aside` predict, farthest first."""
    reading = session.reading_of_value
    records = []
    for one in readings:
        members = np.flatnonzero(np.isin(reading, [k for k in aside if k != one]))
        gradient, diagonal = prediction.without(members)
        pulls = gradient / np.sqrt(diagonal)
        values = np.flatnonzero(reading == one)
        worst = int(values[np.argmax(np.abs(pulls[values]))])
        error = float(gradient[worst] / diagonal[worst])
        records.append(FarReading(one, float(pulls[worst]), error, worst))
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
