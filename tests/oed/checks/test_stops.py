"""Where a joint may have stood at a stop, and in which orders joints are tried."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from oed.checks.mistakes.joints import _likely_stops, likely_orders

TRAVEL = np.array([0.3, 0.9, 0.1, 0.7, 0.5, 0.8, 0.2, 0.6, 0.4])


def stops(far: np.ndarray, sign: float) -> list[float]:
    """Likely stops of sign * TRAVEL where these of its readings are ten sigma off."""
    session = SimpleNamespace(
        joints=sign * TRAVEL[:, None],
        y=np.where(far, 10.0, 1.0),
        reading_of_value=np.arange(len(TRAVEL)),
    )
    data = SimpleNamespace(session=session, predicted=np.zeros(9), spread=np.ones(9))
    return _likely_stops(data, 0, sign)  # type: ignore[arg-type]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stop_lies_between_readings_that_fit_and_those_beyond(sign):
    between, lowest = stops(TRAVEL > 0.75, sign)
    assert between * sign == pytest.approx(0.75)
    assert lowest * sign == pytest.approx(0.7)
    one_fits = (TRAVEL > 0.65) & (TRAVEL != 0.8)
    assert sign * stops(one_fits, sign)[0] == pytest.approx(0.65)


@pytest.mark.parametrize("far", [TRAVEL < 0.25, TRAVEL > 0.55, TRAVEL > 1.0])
def test_no_stop_at_the_other_end_nor_of_many_nor_of_none(far):
    assert stops(far, 1.0) == []


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_orders_of_joints_are_turns_reflections_and_exchanges(count):
    """A symmetric search: each order is tried once, and so is what undoes it."""
    orders = likely_orders(count)
    steps = np.arange(count)
    wanted = {tuple(np.roll(steps[::way], k)) for k in steps for way in (1, -1)}
    for i, k in itertools.combinations(steps, 2):
        swapped = steps.copy()
        swapped[[i, k]] = k, i
        wanted.add(tuple(swapped))
    assert set(orders) == wanted - {tuple(steps)}
    assert len(set(orders)) == len(orders)
    assert {tuple(np.argsort(order)) for order in orders} == set(orders)
