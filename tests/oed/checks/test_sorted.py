"""How many sorted readings are looked at, on one run of the head."""

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest

from oed.checks.mistakes import Suspect, sorting
from oed.checks.session import SessionReadings

#: five values are in order by chance once in 60, up or down; of 401 an assignment is slow
LEAST, MOST = 5, 400


@pytest.fixture(scope="module")
def long_run() -> SessionReadings:
    """One run of more readings than are looked at: a circle again and again."""
    circle = machines.readings("a3", 0).iloc[: machines.POINTS]
    times = 1 + MOST // len(circle)
    rows = pd.concat([circle] * times, ignore_index=True)
    rows["order"] = np.arange(1, 1 + len(rows))
    return machines.session("a3", rows)


@pytest.mark.parametrize(("count", "is_looked_at"), [
    (LEAST - 1, False), (LEAST, True), (MOST, True), (MOST + 1, False),
])  # fmt: skip
def test_from_five_to_four_hundred_sorted_readings_are_looked_at(
    long_run, count, is_looked_at
):
    part = long_run.take(np.arange(count))
    rising = part.with_y(np.sort(part.y) + 1e-6 * np.arange(count))
    trials = list(sorting.trials(Suspect(rising)))
    assert bool(trials) == is_looked_at
    assert {t.kind for t in trials} == ({"sorting"} if is_looked_at else set())
