"""What a check says: figures, rows and columns of its sentences."""

import blunder_machines as machines
import numpy as np
import pytest

from oed.checks import sentences
from oed.checks.copies import CoarseReadings, EqualReadings
from oed.checks.findings import Severity
from oed.checks.session import Ranges, SessionReadings


@pytest.fixture(scope="module")
def session() -> SessionReadings:
    return machines.session("a3", machines.readings("a3", 2))


def test_nothing_is_explained_by_no_mistake():
    assert sentences.explained([]) == []
    assert sentences.no_fit().severity == Severity.BAD_FIT


def test_equal_readings_are_named_by_their_rows(session):
    group = EqualReadings((3, 4), same_pose=False)
    finding = sentences.doubled(session, [group])
    rows = session.values["row"].to_numpy()[[3, 4]]
    assert finding.rows == tuple(rows)
    assert f"rows {rows[0]} and {rows[1]}." in finding.sentence
    assert "at other poses" in finding.sentence


def test_a_step_is_in_the_unit_of_its_column(session):
    coarse = CoarseReadings("length", 1e-5, tuple(range(len(session))))
    sentence = sentences.coarse(session, coarse).sentence
    assert "readings of length_mm are multiples of 0.01:" in sentence


def test_a_value_outside_its_range_is_the_farthest(session, rng):
    ranges: Ranges = session.predict_ranges(rng)
    y = session.y.copy()
    y[4] += 20.0 * ranges.sd[4]
    y[9] -= 90.0 * ranges.sd[9]
    finding = sentences.outside(session.with_y(y), ranges, np.array([4, 9]))
    rows = session.values["row"].to_numpy()[[4, 9]]
    assert finding.rows == tuple(sorted(rows))
    assert finding.sentence.startswith("2 readings lie outside")
    assert f"row {rows[1]}, column length_mm = {1e3 * y[9]:.7g}" in finding.sentence
