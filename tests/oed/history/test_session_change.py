"""Two sessions of one machine, against one least-squares fit of both together."""

import numpy as np
import pytest
from scipy import stats

from oed.history.sessions import CombinationChange, MachineSessions, Session

N, SETUP = 5, 2
NAMES = [f"p{k}" for k in range(N)]
TOLERANCE = np.array([1.0, 0.1, 2.0, 0.5, 30.0])
NOMINAL = np.array([10.0, 0.0, -3.0, 1.0, 500.0])


def slopes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Readings that see p3 and p4 only in one sum, and a set-up of their own."""
    h = rng.standard_normal((count, N + SETUP)) * 20.0
    h[:, :N] /= TOLERANCE
    h[:, 4] = 0.5 * h[:, 3] * TOLERANCE[3] / TOLERANCE[4]
    return h


def session(h: np.ndarray, y: np.ndarray) -> Session:
    """The posterior by the normal equations, y about the nominal machine."""
    prior = np.diag(1.0 / np.concatenate([TOLERANCE, np.ones(SETUP)]) ** 2)
    covariance = np.linalg.inv(h.T @ h + prior)
    mean = covariance @ h.T @ y
    return Session(NOMINAL + mean[:N], covariance[:N, :N])


def readings(rng, h, machine):
    state = np.concatenate([machine, rng.standard_normal(SETUP)])
    return np.asarray(h @ state + rng.standard_normal(len(h)))


def test_the_change_is_that_of_one_fit_of_both_sessions():
    """Least squares over machine, change and both set-ups, without tolerances."""
    rng = np.random.default_rng(3)
    h1, h2 = slopes(rng, 30), slopes(rng, 40)
    machine = TOLERANCE * rng.standard_normal(N)
    y1 = readings(rng, h1, machine)
    y2 = readings(rng, h2, machine + np.array([0.9, 0, 0, 0, 0]))
    change = MachineSessions(
        NAMES, NOMINAL, TOLERANCE, [session(h1, y1), session(h2, y2)]
    ).change()
    assert (change.dof, change.undetermined) == (4, 1)
    # columns: machine, change, set-up 1, set-up 2; then their prior rows
    rows1 = np.hstack([h1[:, :N], 0 * h1[:, :N], h1[:, N:], 0 * h1[:, N:]])
    rows2 = np.hstack([h2[:, :N], h2[:, :N], 0 * h2[:, N:], h2[:, N:]])
    prior = np.hstack([np.zeros((2 * SETUP, 2 * N)), np.eye(2 * SETUP)])
    scale = np.concatenate([TOLERANCE, TOLERANCE, np.ones(2 * SETUP)])
    design = np.vstack([rows1, rows2, prior]) * scale
    inverse = np.linalg.pinv(design, rcond=1e-9)
    fitted = inverse @ np.concatenate([y1, y2, np.zeros(2 * SETUP)])
    covariance = inverse @ inverse.T
    d = slice(N, 2 * N)
    for combination in change.combinations:
        row = np.zeros(N)
        for name, coefficient in combination.coefficients.items():
            row[NAMES.index(name)] = coefficient
        row = row * TOLERANCE
        assert combination.change == pytest.approx(row @ fitted[d], rel=1e-5)
        variance = row @ covariance[d, d] @ row
        assert combination.sd == pytest.approx(np.sqrt(variance), rel=1e-5)
    first = change.causes[0]
    assert list(first.changes) == ["p0"]
    assert first.changes["p0"] == pytest.approx(0.9, abs=5 * first.sds["p0"])
    assert change.p_value < 1e-6 < first.p_value


def test_two_changes_at_once_are_two_parameters():
    """No single parameter explains them; the pair has its fit by the normal equations."""
    rng = np.random.default_rng(7)
    h1, h2 = slopes(rng, 40), slopes(rng, 40)
    moved = np.array([0.9, 0.0, -1.5, 0.0, 0.0])
    sessions = [
        session(h, readings(rng, h, machine))
        for h, machine in ((h1, np.zeros(N)), (h2, moved))
    ]
    change = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).change()
    first = change.causes[0]
    assert set(first.changes) == {"p0", "p2"}
    assert first.explains_all
    for name, true in (("p0", 0.9), ("p2", -1.5)):
        assert first.changes[name] == pytest.approx(true, abs=4 * first.sds[name])
    assert first.chi2 < change.chi2 - 100.0


def turned_sessions(angle: float) -> list[Session]:
    """Two sessions that leave the sum p1 + p2 open, each in another direction."""
    rng = np.random.default_rng(11)
    sessions = []
    for sign in (-1.0, 1.0):
        open_direction = np.array([sign * angle, 1.0, 1.0, 0.0, 0.0])
        open_direction /= np.linalg.norm(open_direction)
        h = 200.0 * rng.standard_normal((30, N))
        h -= np.outer(h @ open_direction, open_direction)
        covariance = np.linalg.inv(h.T @ h + np.eye(N))
        mean = covariance @ h.T @ rng.standard_normal(30)
        scale = np.outer(TOLERANCE, TOLERANCE)
        sessions.append(Session(NOMINAL + TOLERANCE * mean, covariance * scale))
    return sessions


def test_what_no_session_determines_hides_no_other_change():
    """p0 is determined by both, however their open directions are turned."""
    sessions = turned_sessions(1e-4)
    change = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).change()
    assert (change.dof, change.undetermined) == (4, 1)
    (single,) = [c for c in change.combinations if c.coefficients == {"p0": 1.0}]
    variances = [s.covariance[0, 0] for s in sessions]
    assert single.sd == pytest.approx(np.sqrt(sum(variances)), rel=0.02)
    value = sessions[1].mean[0] - sessions[0].mean[0]
    assert single.change == pytest.approx(value, abs=0.1 * single.sd)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 1e-3])
def test_a_drift_of_two_sessions_is_their_change(angle):
    sessions = turned_sessions(angle)
    change = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).change()
    times = np.array([0.0, 2.0])
    drifted = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).drift(times)
    assert drifted.chi2 == pytest.approx(change.chi2, rel=1e-9)
    assert (drifted.dof, drifted.rest_dof) == (change.dof, 0)
    assert drifted.p_value == pytest.approx(change.p_value, rel=1e-9)
    rates = [c.change for c in drifted.combinations]
    changes = [c.change / 2.0 for c in change.combinations]
    assert rates == pytest.approx(changes, rel=1e-6)


def test_no_change_gives_uniform_p_values():
    rng = np.random.default_rng(5)
    p_values = []
    for _ in range(400):
        h1, h2 = slopes(rng, 12), slopes(rng, 9)
        machine = TOLERANCE * rng.standard_normal(N)
        sessions = [session(h, readings(rng, h, machine)) for h in (h1, h2)]
        change = MachineSessions(NAMES, NOMINAL, TOLERANCE, sessions).change()
        p_values.append(change.p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


def test_a_combination_in_words_has_one_unit():
    coefficients = {"z2": 1.0, "z1": -1.00001, "D": 0.5, "beta1": -2.0}
    change = CombinationChange(coefficients, 0.1, 0.1, 0.3)
    unit = {"z1": "mm", "z2": "mm", "D": "mm", "beta1": "mrad"}
    words = "z2 less z1 plus 0.5 times D less 2 mm per mrad of beta1"
    assert change.in_words(unit) == (words, "mm")
