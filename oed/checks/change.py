"""A change between two parts of a session, each of which fits the model alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Index
from oed.checks.fit import fit
from oed.checks.mistakes.order import run_members
from oed.checks.session import SessionReadings

#: readings that a part has at least
LEAST = 6
#: places at which a session is divided first, besides the ends of runs
PLACES = 8


@dataclasses.dataclass(frozen=True)
class Change:
    """Where a session divides into two parts that fit alone.

    last_row   row of the last reading before the change
    first_row  row of the first reading after it
    ratio      residual over the stated noise of both parts together
    """

    last_row: int
    first_row: int
    ratio: float


def find_change(session: SessionReadings) -> Change | None:
    """The division that fits best; None where no part can be fitted."""
    count = 1 + int(session.reading_of_value[-1])
    places = _places(session, count)
    ratios = {place: _ratio(session, place, count) for place in places}
    step = max(1, count // PLACES)
    while step > 1:
        best = min(ratios, key=lambda place: ratios[place])
        step //= 2
        for place in (best - step, best + step):
            if LEAST <= place <= count - LEAST and place not in ratios:
                ratios[place] = _ratio(session, place, count)
    if not ratios:
        return None
    best = min(ratios, key=lambda place: ratios[place])
    if not np.isfinite(ratios[best]):
        return None
    row, reading = session.values["row"].to_numpy(), session.reading_of_value
    last, first = row[reading == best - 1][0], row[reading == best][0]
    return Change(int(last), int(first), ratios[best])


def _places(session: SessionReadings, count: int) -> list[int]:
    """Numbers of first readings after a division."""
    ends = [int(rows[0]) for rows in run_members(session)]
    even = np.linspace(0, count, PLACES + 1).astype(int).tolist()
    return sorted({k for k in [*ends, *even] if LEAST <= k <= count - LEAST})


def _ratio(session: SessionReadings, place: int, count: int) -> float:
    """Ratio of the penalised sum of squares of both parts to the number of values."""
    total = 0.0
    parts: tuple[Index, Index] = (np.arange(place), np.arange(place, count))
    for part in parts:
        solution = fit(session.take(part))
        if solution is None:
            return float(np.inf)
        total += solution.penalised
    return float(np.sqrt(total / len(session)))
