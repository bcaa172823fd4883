"""Wrong readings are set aside, and no sound ones: A3 heads of the oracle, two circles."""

import dataclasses
import functools

import numpy as np
import pytest

from kernel import a3_plans
from kernel.a3_machines import NOISE, exact, measured
from oed import checks
from oed.measurement import Measurement, Series

POINTS = 30


@functools.cache
def plan() -> tuple[Measurement, Series]:
    m = a3_plans.measurement()
    return m, a3_plans.circles(m, POINTS)


@pytest.mark.parametrize(("count", "size", "seed"), [(1, 50.0, 0), (3, 10.0, 60)])
def test_wrong_readings_are_named_and_no_others(count, size, seed):
    """One, or three of which two are neighbours."""
    m, series = plan()
    rng = np.random.default_rng([26, seed])
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = measured(series, truth, rng)
    rows = rng.choice(2 * POINTS, 3, replace=False)[:count]
    y[rows] += size * NOISE * rng.choice([-1, 1], 3)[:count]
    session = checks.session_readings(m, [series], y)
    checked = checks.check_session(session, m, np.random.default_rng(0))
    wrong = {int(k) for k in rows}
    assert set(checked.set_aside) == wrong
    rows = {row for finding in checked.findings for row in finding.rows}
    assert rows == {k + 2 for k in wrong}


#: laws of sound readings, in units of the stated noise
LAWS = ("white", "heavy", "carried", "offset")


def sound_errors(law: str, rng: np.random.Generator) -> np.ndarray:
    """Errors (2 POINTS,) of two circles: white, Student t of 4, AR(1), run offsets."""
    white = rng.standard_normal((2, POINTS))
    if law == "heavy":
        white = rng.standard_t(4.0, (2, POINTS)) / np.sqrt(2.0)
    if law == "offset":
        white += 2.0 * rng.standard_normal((2, 1))
    if law == "carried":
        for k in range(1, POINTS):
            white[:, k] = 0.7 * white[:, k - 1] + np.sqrt(0.51) * white[:, k]
    return white.ravel()


@pytest.mark.parametrize("law", LAWS)
def test_no_sound_reading_is_set_aside(law):
    """Clean sessions also have no bad fit."""
    m, series = plan()
    by_circle = dataclasses.replace(series, run=np.repeat(["1", "2"], POINTS))
    for seed in range(5):
        rng = np.random.default_rng([27, seed])
        truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
        y = exact(series, truth) + NOISE * sound_errors(law, rng)
        session = checks.session_readings(m, [by_circle], y)
        checked = checks.check_session(session, m, np.random.default_rng(0))
        assert not checked.set_aside, seed
        assert not checked.bad_fit, seed
