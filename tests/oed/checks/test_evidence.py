"""Evidence of readings and of mistakes against densities written out."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from shipped_models import a3_head, ball_bar

from kernel.dense_noise import dense_covariance
from oed import checks
from oed.base import Array
from oed.checks import screening
from oed.checks.explain import candidates
from oed.checks.fit import fit, fit_amounts
from oed.checks.mistakes import Suspect, trials
from oed.instrument import mount
from oed.measurement import Measurement
from oed.noise import Laws
from oed.noise_law import log_prior_of_scale
from oed.noise_law.prior import scale_over_stated

VALUES = {"correlated": 0.4, "reach": 3.0, "level": 0.7, "seat": 0.5}
ONE = Laws(np.array([[1.3]]), **{name: np.array([x]) for name, x in VALUES.items()})


def circles(runs: int = 3, count: int = 12) -> checks.SessionReadings:
    """Circles of a ball bar in one set-up, read on a drawn machine."""
    setup = mount(ball_bar.instrument, "bar", teach=(1.2, 0.0, 0.0), sigma=[0.5e-6])
    m = Measurement(a3_head.machine, [setup])
    psi = np.linspace(-3.0, 3.0, count)
    heights = np.repeat(np.linspace(1.15, 1.25, runs), count)
    tilt = np.full(len(heights), 0.4)
    command = np.column_stack([heights, np.tile(psi, runs), tilt])
    series = [m.series("bar", command, run=[f"z {z:.3f}" for z in heights])]
    rng = np.random.default_rng(3)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = m.readings(series, truth)
    return checks.session_readings(m, series, y + 0.5e-6 * rng.standard_normal(len(y)))


@pytest.fixture(scope="module")
def bar() -> checks.SessionReadings:
    return circles()


def test_the_log_marginal_is_that_of_a_normal_density(bar):
    solution = fit(bar)
    linear = screening.linear_readings(solution)
    unit = dataclasses.replace(ONE, scale=np.ones((1, 1)))
    scale = 1.7
    one = screening._log_marginal(
        linear, linear.slopes, unit, np.zeros(1), np.array([scale])
    )
    covariance = scale**2 * dense_covariance(linear.structure, unit)
    covariance = covariance + linear.slopes @ linear.slopes.T
    expected = stats.multivariate_normal.logpdf(
        linear.residual, np.zeros(len(covariance)), covariance
    )
    normalisation = 0.5 * len(linear.residual) * np.log(2.0 * np.pi)
    assert one == pytest.approx(expected + normalisation, abs=1e-5)
    about = linear.residual - linear.slopes @ solution.departure
    predicted = bar.measurement.readings(bar.series, solution.theta)
    assert about * 0.5e-6 == pytest.approx(bar.y - predicted, abs=1e-15)


def test_the_screening_maximises_a_normal_density(bar):
    given = Suspect(bar)
    screen = screening.Screening(given)
    slopes = given.slopes / 0.5e-6
    residual = (bar.y - given.predicted) / 0.5e-6

    def best(r: Array, h: Array) -> float:
        values = []
        for scale in screen.scales:
            covariance = scale**2 * np.eye(len(r)) + h @ h.T
            density = stats.multivariate_normal.logpdf(r, np.zeros(len(r)), covariance)
            weight = log_prior_of_scale(np.array([scale]), is_assumed=False)[0]
            values.append(density + weight + 0.5 * len(r) * np.log(2.0 * np.pi))
        return float(max(values))

    of_given = screen.as_given().log_evidence
    assert of_given == pytest.approx(best(residual, slopes), abs=1e-4)
    # slopes whose squares hide the noise leave a number, and no likely one
    hidden = screening.log_density_of_one(1e9 * slopes, residual, screen.scales)
    assert (hidden < of_given).all()
    every = list(trials(given))
    of_values = next(t for t in every if t.kind == "sign")
    of_poses = next(t for t in every if t.kind == "pose" and t.table is not None)
    scores = screen.scores([of_values, of_poses])
    assert of_values.y is not None
    moved = (of_values.y - given.predicted) / 0.5e-6
    assert scores[0].log_evidence == pytest.approx(best(moved, slopes), rel=1e-6)
    elsewhere = (bar.y - of_poses.table.predicted) / 0.5e-6
    there = of_poses.table.slopes / 0.5e-6
    assert scores[1].log_evidence == pytest.approx(best(elsewhere, there), rel=1e-6)


def test_scales_have_the_prior_of_their_coordinate():
    u = np.array([-3.0, -0.5, 0.0, 0.7, 3.0, 6.0])
    scale = scale_over_stated(u)
    density = log_prior_of_scale(scale, is_assumed=False)
    assert density == pytest.approx(-0.5 * u**2, abs=1e-9)
    decades = log_prior_of_scale(10.0**u, is_assumed=True)
    assert decades == pytest.approx(-0.5 * u**2, abs=1e-9)


def test_an_offset_is_estimated_as_by_generalised_least_squares(bar):
    moved = bar.with_y(bar.y + 3e-4)
    every = trials(Suspect(moved))
    offset = next(t for t in every if t.kind == "offset" and t.scope.level == "file")
    fitted = fit_amounts(offset, 1.0)
    m = bar.measurement
    h = m.jacobian(bar.series, fitted.theta) * m.tolerance
    covariance = h @ h.T + (0.5e-6) ** 2 * np.eye(len(bar))
    ones = np.ones(len(bar))
    precision = float(ones @ np.linalg.solve(covariance, ones))
    assert fitted.sd[0] == pytest.approx(precision**-0.5, rel=1e-3)
    assert abs(fitted.amounts[0] - 3e-4) < 4.0 * fitted.sd[0]


def long_session() -> checks.SessionReadings:
    """3 circles of 40 readings, of which rows 55 to 81 of the file are in um."""
    session = circles(3, 40)
    y = session.y.copy()
    y[53:80] *= 1e3
    return session.with_y(y)


def test_long_sessions_are_cut_where_a_mistake_begins():
    """In the linear model: the likeliest coarse part leads to the row."""
    given = Suspect(long_session())
    assert given.cut_step > 1
    assert len(given.parts) < 300
    first, _ = candidates(given, screening.Screening(given), thorough=True)
    likeliest = max(first, key=lambda one: one.log_posterior).trial
    assert (likeliest.kind, likeliest.scope.name) == ("unit", "rows 55 to 81")


def test_scopes_are_the_file_its_setups_and_runs(bar):
    levels = [scope.level for scope in Suspect(bar).scopes]
    assert levels == ["file", "run", "run", "run"]
    one = Suspect(bar.take(np.arange(12)))
    assert [scope.level for scope in one.scopes] == ["file"]
