"""Sessions of one machine against one least-squares fit, and priors from a fleet."""

import numpy as np
import pytest
from scipy import integrate, stats

from oed.base import Array
from oed.history import FleetPrior, MachineInformation, fleet_prior
from oed.history.sessions import CombinationChange, MachineSessions, Session

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


FIVE, SETUP = 5, 2
NAMES_OF_FIVE = [f"p{k}" for k in range(FIVE)]
TOLERANCES = np.array([1.0, 0.1, 2.0, 0.5, 30.0])
NOMINALS = np.array([10.0, 0.0, -3.0, 1.0, 500.0])


def slopes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Readings that see p3 and p4 only in one sum, and a set-up of their own."""
    h = rng.standard_normal((count, FIVE + SETUP)) * 20.0
    h[:, :FIVE] /= TOLERANCES
    h[:, 4] = 0.5 * h[:, 3] * TOLERANCES[3] / TOLERANCES[4]
    return h


def session(h: np.ndarray, y: np.ndarray) -> Session:
    """The posterior by the normal equations, y about the nominal machine."""
    prior = np.diag(1.0 / np.concatenate([TOLERANCES, np.ones(SETUP)]) ** 2)
    covariance = np.linalg.inv(h.T @ h + prior)
    mean = covariance @ h.T @ y
    return Session(NOMINALS + mean[:FIVE], covariance[:FIVE, :FIVE])


def readings(rng, h, machine):
    state = np.concatenate([machine, rng.standard_normal(SETUP)])
    return np.asarray(h @ state + rng.standard_normal(len(h)))


def test_the_change_is_that_of_one_fit_of_both_sessions():
    """Least squares over machine, change and both set-ups, without tolerances."""
    rng = np.random.default_rng(3)
    h1, h2 = slopes(rng, 30), slopes(rng, 40)
    machine = TOLERANCES * rng.standard_normal(FIVE)
    y1 = readings(rng, h1, machine)
    y2 = readings(rng, h2, machine + np.array([0.9, 0, 0, 0, 0]))
    change = MachineSessions(
        NAMES_OF_FIVE, NOMINALS, TOLERANCES, [session(h1, y1), session(h2, y2)]
    ).change()
    assert (change.dof, change.undetermined) == (4, 1)
    # columns: machine, change, set-up 1, set-up 2; then their prior rows
    rows1 = np.hstack([h1[:, :FIVE], 0 * h1[:, :FIVE], h1[:, FIVE:], 0 * h1[:, FIVE:]])
    rows2 = np.hstack([h2[:, :FIVE], h2[:, :FIVE], 0 * h2[:, FIVE:], h2[:, FIVE:]])
    prior = np.hstack([np.zeros((2 * SETUP, 2 * FIVE)), np.eye(2 * SETUP)])
    scale = np.concatenate([TOLERANCES, TOLERANCES, np.ones(2 * SETUP)])
    design = np.vstack([rows1, rows2, prior]) * scale
    inverse = np.linalg.pinv(design, rcond=1e-9)
    fitted = inverse @ np.concatenate([y1, y2, np.zeros(2 * SETUP)])
    covariance = inverse @ inverse.T
    d = slice(FIVE, 2 * FIVE)
    for combination in change.combinations:
        row = np.zeros(FIVE)
        for name, coefficient in combination.coefficients.items():
            row[NAMES_OF_FIVE.index(name)] = coefficient
        row = row * TOLERANCES
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
        for h, machine in ((h1, np.zeros(FIVE)), (h2, moved))
    ]
    change = MachineSessions(NAMES_OF_FIVE, NOMINALS, TOLERANCES, sessions).change()
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
        h = 200.0 * rng.standard_normal((30, FIVE))
        h -= np.outer(h @ open_direction, open_direction)
        covariance = np.linalg.inv(h.T @ h + np.eye(FIVE))
        mean = covariance @ h.T @ rng.standard_normal(30)
        scale = np.outer(TOLERANCES, TOLERANCES)
        sessions.append(Session(NOMINALS + TOLERANCES * mean, covariance * scale))
    return sessions


def test_what_no_session_determines_hides_no_other_change():
    """p0 is determined by both, however their open directions are turned."""
    sessions = turned_sessions(1e-4)
    change = MachineSessions(NAMES_OF_FIVE, NOMINALS, TOLERANCES, sessions).change()
    assert (change.dof, change.undetermined) == (4, 1)
    (single,) = [c for c in change.combinations if c.coefficients == {"p0": 1.0}]
    variances = [s.covariance[0, 0] for s in sessions]
    assert single.sd == pytest.approx(np.sqrt(sum(variances)), rel=0.02)
    value = sessions[1].mean[0] - sessions[0].mean[0]
    assert single.change == pytest.approx(value, abs=0.1 * single.sd)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 1e-3])
def test_a_drift_of_two_sessions_is_their_change(angle):
    sessions = turned_sessions(angle)
    change = MachineSessions(NAMES_OF_FIVE, NOMINALS, TOLERANCES, sessions).change()
    times = np.array([0.0, 2.0])
    drifted = MachineSessions(NAMES_OF_FIVE, NOMINALS, TOLERANCES, sessions).drift(
        times
    )
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
        machine = TOLERANCES * rng.standard_normal(FIVE)
        sessions = [session(h, readings(rng, h, machine)) for h in (h1, h2)]
        change = MachineSessions(NAMES_OF_FIVE, NOMINALS, TOLERANCES, sessions).change()
        p_values.append(change.p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


def test_a_combination_in_words_has_one_unit():
    coefficients = {"z2": 1.0, "z1": -1.00001, "D": 0.5, "beta1": -2.0}
    change = CombinationChange(coefficients, 0.1, 0.1, 0.3)
    unit = {"z1": "mm", "z2": "mm", "D": "mm", "beta1": "mrad"}
    words = "z2 less z1 plus 0.5 times D less 2 mm per mrad of beta1"
    assert change.in_words(unit) == (words, "mm")


def exact(values: list[float], sd: float) -> tuple[float, float]:
    """Mean and variance of a further machine of one parameter, by quadrature."""
    y, n = np.array(values), len(values)

    def moments(s: float) -> Array:
        covariance = (1 - s**2) * np.ones((n, n)) + (s**2 + sd**2) * np.eye(n)
        weight = stats.multivariate_normal(np.zeros(n), covariance).pdf(y)
        gain = (1 - s**2) * np.linalg.solve(covariance, np.ones(n))
        mean = gain @ y
        variance = 1.0 - gain.sum() * (1 - s**2)
        return weight * np.array([1.0, mean, variance + mean**2])

    parts = [integrate.quad(lambda s, k=k: moments(s)[k], 0, 1)[0] for k in range(3)]
    mean = parts[1] / parts[0]
    return mean, parts[2] / parts[0] - mean**2


@pytest.mark.parametrize(
    "values", [[1.5], [1.0, 1.1], [1.0, -1.0], [0.5, 0.7, 0.6, 0.55], [2.0, 2.1, -0.5]]
)
def test_one_parameter_against_quadrature(values):
    sd = 0.1
    machines = [
        MachineInformation(np.eye(1) / sd**2, np.array([v / sd**2])) for v in values
    ]
    prior = fleet_prior(machines)
    mean, variance = exact(values, sd)
    assert prior.mean[0] == pytest.approx(mean, abs=0.01)
    assert prior.covariance[0, 0] == pytest.approx(variance, rel=0.03, abs=0.002)


def test_machines_that_say_nothing_leave_the_tolerances():
    blank = MachineInformation(np.zeros((3, 3)), np.zeros(3))
    prior = fleet_prior([blank, blank])
    np.testing.assert_allclose(prior.mean, 0.0, atol=1e-12)
    np.testing.assert_allclose(prior.covariance, np.eye(3), atol=1e-12)
    with pytest.raises(ValueError, match="at least one"):
        fleet_prior([])


def test_what_readings_say_is_the_posterior_without_its_prior(rng):
    slopes = rng.standard_normal((2, 3))  # fewer readings than parameters
    truth, nominal = rng.standard_normal(3), np.array([4.0, 5.0, 6.0])
    tolerance = np.array([0.5, 2.0, 1.0])
    y = slopes @ truth + 0.1 * rng.standard_normal(2)
    covariance = np.linalg.inv(100.0 * slopes.T @ slopes + np.diag(tolerance**-2))
    value = covariance @ (100.0 * slopes.T @ y + nominal / tolerance**2)
    own = MachineInformation.from_posterior(value, covariance, nominal, tolerance)
    other, wide = nominal + 0.3, 1.5 * tolerance
    moved = own.rescaled(wide / tolerance, (nominal - other) / wide)
    scaled = slopes * wide
    np.testing.assert_allclose(moved.matrix, 100.0 * scaled.T @ scaled, atol=1e-6)
    expected = 100.0 * scaled.T @ (y - slopes @ other)
    np.testing.assert_allclose(moved.vector, expected, atol=1e-6)


def drawn(count, rng, slopes):
    """Parameters (count + 1, p) of a fleet, and what is read of all but the last."""
    p = slopes.shape[1]
    spread = rng.uniform(0.05, 0.6, p)
    x = np.sqrt(1 - spread**2) * rng.standard_normal(p)
    x = x + spread * rng.standard_normal((count + 1, p))
    matrix = slopes.T @ slopes
    noise = rng.standard_normal((count, len(slopes)))
    machines = [
        MachineInformation(matrix, matrix @ x[j] + slopes.T @ noise[j])
        for j in range(count)
    ]
    return x, machines


def within(prior: FleetPrior, x: Array) -> Array:
    return np.abs(x - prior.mean) < 1.96 * np.sqrt(np.diag(prior.covariance))


@pytest.mark.parametrize("count", [2, 10])
def test_bands_of_a_further_machine_hold(count, rng):
    """Fifty fleets of machines of which readings see two thirds of the directions."""
    slopes = 20.0 * rng.standard_normal((4, 6))
    inside, squares = [], []
    for _ in range(50):
        x, machines = drawn(count, rng, slopes)
        prior = fleet_prior(machines)
        inside.append(within(prior, x[-1]))
        root = np.linalg.cholesky(prior.covariance)
        squares.append(np.sum(np.linalg.solve(root, x[-1] - prior.mean) ** 2))
        assert (np.diag(prior.covariance) < 1.2).all()
    assert 0.9 <= np.mean(inside) <= 1.0
    assert 0.5 <= np.mean(squares) / 6 <= 1.25
