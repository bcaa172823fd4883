"""Drift over sessions against one least-squares fit of all."""

import numpy as np
import pytest

from oed.history.sessions import MachineSessions, Session

N = 4
NAMES = [f"p{k}" for k in range(N)]
TOLERANCE = np.array([1.0, 0.1, 2.0, 0.5])
NOMINAL = np.array([10.0, 0.0, -3.0, 1.0])
TIMES = np.array([0.0, 30.0, 70.0, 90.0, 180.0])


def measured(rng, machine):
    """Slopes and readings of one session, and its posterior by normal equations."""
    h = 20.0 * rng.standard_normal((25, N)) / TOLERANCE
    y = h @ machine + rng.standard_normal(25)
    covariance = np.linalg.inv(h.T @ h + np.diag(TOLERANCE**-2.0))
    return h, y, Session(NOMINAL + covariance @ h.T @ y, covariance)


def drifting_sessions(rng, rate, knock=0.0):
    """Design, readings and sessions of a machine that drifts, and may be knocked."""
    start = TOLERANCE * rng.standard_normal(N)
    rows, readings, sessions = [], [], []
    for time in TIMES:
        machine = start + rate * (time - TIMES[-1])
        machine[0] += knock * (time > 60.0) * (time < 80.0)
        h, y, session = measured(rng, machine)
        rows.append(np.hstack([h, h * (time - TIMES[-1])]))
        readings.append(y)
        sessions.append(session)
    return np.vstack(rows), np.concatenate(readings), sessions


def test_the_drift_is_that_of_one_fit_of_all_sessions():
    rate = np.array([2e-3, 0.0, 0.0, 0.0])
    design, y, sessions = drifting_sessions(np.random.default_rng(2), rate)
    drifted = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).drift(TIMES)
    fitted, _, _, _ = np.linalg.lstsq(design, y)
    covariance = np.linalg.inv(design.T @ design)[N:, N:]
    assert drifted.rate == pytest.approx(fitted[N:], rel=1e-5, abs=1e-8)
    assert drifted.widening == 1.0
    assert np.diag(drifted.covariance) == pytest.approx(np.diag(covariance), rel=1e-4)
    misfit = float(np.sum((y - design @ fitted) ** 2))
    own = sum(
        float(np.linalg.lstsq(h[:, :N], v)[1][0])
        for h, v in zip(np.split(design, 5), np.split(y, 5), strict=True)
    )
    assert drifted.rest == pytest.approx(misfit - own, rel=1e-3)
    assert drifted.rest_dof == 3 * N
    surest = drifted.combinations[0]
    assert surest.coefficients == pytest.approx({"p0": 1.0})
    assert surest.p_value < 1e-6


def test_a_knock_is_not_reported_as_an_even_drift():
    _, _, sessions = drifting_sessions(np.random.default_rng(3), np.zeros(N), knock=0.5)
    drifted = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).drift(TIMES)
    assert drifted.widening > 2.0
    assert drifted.p_value > 0.001


def test_intervals_hold_the_true_rate():
    rng, rate = np.random.default_rng(4), np.array([1e-3, 2e-4, 0.0, -1e-3])
    inside = []
    for _ in range(150):
        _, _, sessions = drifting_sessions(rng, rate)
        d = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).drift(TIMES)
        inside.append(np.abs(d.rate - rate) < 1.96 * np.sqrt(np.diag(d.covariance)))
    assert 0.92 < np.mean(inside) < 0.98


def test_the_next_calibration_is_when_the_error_reaches_its_limit():
    rate = np.array([2e-3, 0.0, 0.0, 0.0])
    _, _, sessions = drifting_sessions(np.random.default_rng(5), rate)
    d = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).drift(TIMES)
    maps = np.zeros((7, N))
    maps[:, 0] = 1.0
    rng = np.random.default_rng(6)
    due = d.next_calibration(maps, after=0.3, limit=0.5, rng=rng)
    # the median of 4000 draws
    assert due.time == pytest.approx(0.4 / d.rate[0], rel=2e-3)
    assert due.low < due.time < due.high
    assert due.low < 200.0 < due.high
    late = d.next_calibration(maps, after=0.6, limit=0.5, rng=rng)
    assert late.time == 0.0


def test_a_drift_of_the_provable_size_is_proven_as_often_as_said():
    """Sessions of the oracle, drifting in random directions by the size for 5 of them."""
    rng = np.random.default_rng(8)
    maps = rng.standard_normal((9, N)) / TOLERANCE
    _, _, sessions = drifting_sessions(rng, np.zeros(N))
    growth = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).provable_growth(
        maps, [5], 0.9, rng
    )
    times = np.arange(5.0)
    proven = 0
    for _ in range(200):
        direction = TOLERANCE * rng.standard_normal(N)
        rate = direction * growth[0] / np.sqrt(np.mean((maps @ direction) ** 2))
        start = TOLERANCE * rng.standard_normal(N)
        drifting = [measured(rng, start + t * rate)[2] for t in times]
        found = MachineSessions(NAMES, NOMINAL, TOLERANCE, drifting).drift(times)
        proven += found.p_value < 0.01
    assert 0.83 < proven / 200 < 0.96
