"""Rows whose order contradicts the sense of travel that they state."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from kernel import a3_plans, warm_head
from kernel.warm_head import turned
from oed import checks
from oed.checks.sentences import contradictions
from oed.measurement import Measurement, Series


def session(m, series, rows):
    return checks.session_readings(m, [series], np.zeros(len(rows)), rows)


@pytest.fixture(scope="module")
def planned() -> tuple[Measurement, Series, pd.DataFrame]:
    m = a3_plans.measurement()
    return (m, *warm_head.planned(m))


def test_order_and_direction_go_together(planned):
    assert not contradictions(session(*planned))
    m, series, rows = planned
    assert not contradictions(session(m, series, rows.drop(columns="direction")))
    outlined = dataclasses.replace(session(*planned)).without([3, 40, 41])
    assert not contradictions(outlined)


def test_a_wrong_direction_contradicts_every_run_of_the_same_circle(planned):
    m, series, rows = planned
    wrong = np.where(rows["run"] == "80-1", 1, rows["direction"])
    pairs = contradictions(session(m, series, rows.assign(direction=wrong)))
    assert len(pairs) == 5
    assert all("80-1" in pair.runs for pair in pairs)
    assert {pair.same_order for pair in pairs} == {True, False}


def test_rows_sorted_by_angle_are_found(planned):
    """Runs both ways, written in the order of the angle: the order is not that of travel."""
    m, series, rows = planned
    backward = [r for r in dict.fromkeys(rows["run"]) if int(r[-1]) % 2]
    found = contradictions(session(m, series, turned(rows, backward)))
    assert len(found) == 2 * 3 * 3
    assert all(pair.same_order for pair in found)
